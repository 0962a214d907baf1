"""The support: springs between the drive (0) and the whiskers (1 to N), and the mounts of the whiskers."""

import dataclasses
from collections import Counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import PerSpring, Scalar
from jaxwhisker._model.foundation import Foundation
from jaxwhisker._model.motion import Mount
from jaxwhisker._model.network import Flexibility, Linked, SpringEnds, along_all_axes, along_axes, connected, linked
from jaxwhisker._model.published import Published
from jaxwhisker._model.spring import AXES, AXES_IN_SPACE, Spring

_NAMED = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}


class Support(Published):
    """Springs that hold the whiskers; without springs, the bases are clamped to the drive.

    A base is rigidly connected to the drive along every axis that has no springs. An axial spring frees a base along x.

    Args:
        springs: any network; every base from 1 to N must occur in it.
        mount: a Mount for all whiskers, or a tuple with one per base, which also sets the number of whiskers if there
            are no springs. Default: upright at height 0.
        foundation: a Foundation for all whiskers, or a tuple with one or None per base, which also sets the number of
            whiskers if there are neither springs nor several mounts. Default: none.
        free: further axes ("x", "y", "phi") along which bases with springs on their shafts are free, although no spring
            acts along these axes. Example: two springs along x at different heights hold the angle, too.

    Raises:
        ValueError: if an argument has the wrong type, springs along an axis do not connect all bases to the drive, or
            the rest lengths around a loop of rigid springs do not add up.

    Examples:
        >>> print(jw.Support.fbfbr(stiffness=70.0, rest_length=0.2).springs[2].rest_length)
        0.4
        >>> springs = tuple(jw.Spring((k, k + 1), stiffness=50.0, rest_length=0.1) for k in range(4))
        >>> jw.Support(springs).whiskers
        4
    """

    springs: tuple[Spring, ...] = ()
    mount: Mount | tuple[Mount, ...] | None = None
    foundation: Foundation | tuple[Foundation | None, ...] | None = eqx.field(default=None, kw_only=True)
    free: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)

    def __check_init__(self):
        if not isinstance(self.springs, tuple) or not all(isinstance(s, Spring) for s in self.springs):
            checks.fail("springs", "a tuple of Spring", repr(self.springs))
        if not isinstance(self.free, tuple) or not set(self.free) <= set(AXES):
            checks.fail("free", f"a tuple of names out of {', '.join(AXES)}", repr(self.free))
        self._check_mounts()
        self._check_foundations()
        self._check_connected()
        self._check_rigid_loops()

    def _check_mounts(self) -> None:
        mounts = self.mount if isinstance(self.mount, tuple) else (self.mount,)
        if self.mount is not None and not (mounts and all(isinstance(m, Mount) for m in mounts)):
            checks.fail("mount", "a Mount or a tuple of them", repr(self.mount))
        if isinstance(self.mount, tuple) and self.springs and len(mounts) != self.whiskers:
            checks.fail("mount", f"one Mount or one per base ({self.whiskers})", f"{len(mounts)} of them")

    def _check_foundations(self) -> None:
        each = self.foundation if isinstance(self.foundation, tuple) else (self.foundation,)
        if not (each and all(one is None or isinstance(one, Foundation) for one in each)):
            checks.fail("foundation", "a Foundation or a tuple of them", repr(self.foundation))
        if isinstance(self.foundation, tuple) and len(each) != self.whiskers:
            checks.fail("foundation", f"one Foundation or one per base ({self.whiskers})", f"{len(each)} of them")

    def _check_connected(self) -> None:
        tissue = (Spring((0, base), 1.0) for base, one in enumerate(self.foundations, 1) if one is not None)
        ends = connected((*self.springs, *tissue))
        for axis in self.axes:
            loose = {base for base in self._held(axis) if base not in self._attached or axis not in AXES}
            missing = loose | (set(range(1, self.whiskers + 1)) - ends)
            if missing:
                raise ValueError(
                    f"`springs` must connect every base from 1 to {self.whiskers} to the drive 0, got no connection of "
                    f"base {min(missing)} along {axis} (springs between {[s.between for s in self.springs]})."
                )
        if self.free and not self._attached:
            checks.fail("free", "() without springs or a foundation on a shaft", repr(self.free))

    def _check_rigid_loops(self) -> None:
        if checks.is_traced(self.springs) or not any(s.is_rigid() for s in self.springs):
            return
        if any(s.rest_length is None for s in self.springs):  # checked when a scene sets it
            return
        with jax.ensure_compile_time_eval():  # concrete values are checked inside jit, too
            if not all(part.flexibility().consistent for part in self.linked(self.axes, self.hold(1.0, 1.0)).values()):
                lengths = [float(s.rest_length) for s in self.springs]
                checks.fail("rest_length", "the same along all paths of infinitely stiff springs", lengths)

    def in_row(self, whisker: Scalar) -> "Support":
        """The support with all rest lengths, whose default depends on the length of the first whisker."""
        if all(spring.rest_length is not None for spring in self.springs):
            return self
        return dataclasses.replace(self, springs=tuple(spring.in_row(whisker) for spring in self.springs))

    def along(self, axis: str) -> tuple[Spring, ...]:
        """The linear springs between bases along an axis."""
        return tuple(spring for spring in self.springs if spring.linear and spring.axis == axis)

    @property
    def attached(self) -> tuple[Spring, ...]:
        """The springs that do not belong to the linear network of the bases: on shafts, or not linear."""
        return tuple(spring for spring in self.springs if not spring.linear)

    @property
    def shaft_loads(self) -> int:
        """Number of the loads on each whisker that `State.shaft_loads` has room for."""
        return 3 * max(Counter(s.between[1] for s in self.attached if len(s.ends) > 1).values(), default=0)

    def attachments(self) -> list[tuple[str, int, Scalar]]:
        """Argument, whisker and arc length of everything that is attached to a shaft; of foundations, the upper end."""
        springs = [("at", whisker, at) for s in self.attached for whisker, at in s.ends]
        return springs + [("stop", base, one.stop) for base, one in enumerate(self.foundations, 1) if one is not None]

    @property
    def _attached(self) -> set[int]:
        """The whiskers that such springs or a foundation hold."""
        tissue = {base for base, one in enumerate(self.foundations, 1) if one is not None}
        return {whisker for spring in self.attached for whisker, _ in spring.ends} | tissue

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes along which bases are free, at least some."""
        acting = {"x" if spring.axis == "axial" else spring.axis for spring in self.springs}
        acting |= {"x" for one in self.foundations if one is not None} | set(self.free if self._attached else ())
        return tuple(axis for axis in AXES_IN_SPACE if axis in acting)

    def freed(self, axis: str) -> set[int]:
        """The bases that are free along an axis."""
        freed = {end for spring in self.springs for end in spring.between if spring.axis in _acting(axis)}
        if axis == "x":
            freed |= {base for base, one in enumerate(self.foundations, 1) if one is not None}
        return (freed | (self._attached if axis in self.free else set())) - {0}

    def _held(self, axis: str) -> list[int]:
        """A base of each part of the network that is free along an axis, but not connected to the drive along it."""
        held: list[int] = []
        while loose := self.freed(axis) - connected((*self.along(axis), *(Spring((0, k), 1.0) for k in held))):
            # If the part has none with a spring on its shaft, nothing holds it at all.
            held.append(min(loose & self._attached or loose))
        return held

    def _network(self, axis: str, hold: Float[Array, "whiskers axes"]) -> tuple[Spring, ...]:
        """The linear springs along an axis, and one at every base that only shaft springs hold."""

        acting = [spring for spring in self.springs if spring.axis in _acting(axis)]
        acting.sort(key=lambda spring: 0 not in spring.between)

        def rest_length(base: int, seen: tuple[int, ...] = ()) -> Scalar:
            """Where the first of these springs that leads to the drive would have the base."""
            tissue = self.foundations[base - 1]
            for spring in acting:
                if base not in spring.between or set(seen) & set(spring.between):
                    continue
                first, second = spring.between
                own = spring.rest_length if base == second else -jnp.asarray(spring.rest_length)
                other = first if base == second else second
                if other != 0:
                    return own + rest_length(other, (*seen, base))
                if spring.anchor is None or axis == "phi":
                    return own
                mount, anchor = self.mounts[base - 1], spring.anchor
                return own + (anchor[0] - mount.x if axis == "x" else anchor[1] - mount.y)
            return tissue.rest_length if axis == "x" and tissue is not None else 0.0

        stiffness = hold[:, AXES.index(axis) if axis in AXES else 0]  # along other axes, it is not used
        held = (Spring((0, base), stiffness[base - 1], rest_length(base), axis=axis) for base in self._held(axis))
        return (*self.along(axis), *held)

    def hold(self, stiffness: Scalar, torsion: Scalar) -> Float[Array, "whiskers axes"]:
        """Stiffnesses of the springs that `flexibility` contains but the support does not have; 0 where there is none.

        Args:
            stiffness: least stiffness of such a spring along x or y. It is as stiff as the springs on the shaft, so
                that displacements and forces are solved for to the same accuracy.
            torsion: its least torsional stiffness.
        """
        hold = jnp.zeros((self.whiskers, len(AXES)))
        for k, axis in enumerate(AXES):
            for base in self._held(axis):
                own = torsion if axis == "phi" else stiffness
                for spring, at in ((s, at) for s in self.attached for whisker, at in s.ends if whisker == base):
                    if not callable(spring.stiffness):
                        by_force = at**2 if axis == "phi" else 1.0
                        own += (float(axis == "phi") if spring.axis == "phi" else by_force) / spring.softness
                hold = hold.at[base - 1, k].set(own)
        return jax.lax.stop_gradient(hold)

    @property
    def mounts(self) -> tuple[Mount, ...]:
        """One Mount per base."""
        return self.mount if isinstance(self.mount, tuple) else (self.mount or Mount(),) * self.whiskers

    @property
    def foundations(self) -> tuple[Foundation | None, ...]:
        """The foundation of each base, or None."""
        return self.foundation if isinstance(self.foundation, tuple) else (self.foundation,) * self.whiskers

    @property
    def on_shafts(self) -> bool:
        """Whether springs or foundations hold the shaft of any whisker."""
        return bool(self._attached)

    @property
    def whiskers(self) -> int:
        """N, the number of bases."""
        if not self.springs:
            several = (each for each in (self.mount, self.foundation) if isinstance(each, tuple))
            return max(map(len, several), default=1)
        return max(b for s in self.springs for b in s.between)

    @property
    def name(self) -> str:
        """The name of the model in the thesis, or `clamped`, `follicle`, `shaft`, or `network`."""
        between = tuple(s.between for s in self.springs)
        if self.on_shafts:
            return "shaft" if self.whiskers == 1 else "network"
        if self.axes in ((), ("x",)):
            return next((name for name, ends in _NAMED.items() if ends == between), "network" if between else "clamped")
        return "follicle" if set(between) == {(0, 1)} else "network"

    @classmethod
    def clamped(cls) -> "Support":
        """One whisker clamped to the drive, without springs."""
        return cls()

    @classmethod
    def fb(cls, stiffness: Scalar, rest_length: Scalar | None = None) -> "Support":
        """One whisker: drive -c1- base 1. Arguments and errors are those of `named`."""
        return cls.named("FB", stiffness, rest_length)

    @classmethod
    def fbfb(cls, stiffness: PerSpring, rest_length: PerSpring | None = None) -> "Support":
        """Two whiskers in a row: drive -c1- base 1 -c2- base 2. Arguments and errors are those of `named`."""
        return cls.named("FBFB", stiffness, rest_length)

    @classmethod
    def fbfbr(cls, stiffness: PerSpring, rest_length: PerSpring | None = None) -> "Support":
        """FBFB with feedback: c3 between drive and base 2. Arguments and errors are those of `named`."""
        return cls.named("FBFBR", stiffness, rest_length)

    @classmethod
    def fbfbfbr(cls, stiffness: PerSpring, rest_length: PerSpring | None = None) -> "Support":
        """Three whiskers in a row (c1, c2, c3), with feedback c4 to base 2 and c5 to base 3.

        Arguments and errors are those of `named`.
        """
        return cls.named("FBFBFBR", stiffness, rest_length)

    @classmethod
    def follicle(
        cls,
        x: Scalar | None = None,
        y: Scalar | None = None,
        phi: Scalar | None = None,
        *,
        z: Scalar | None = None,
        phi_x: Scalar | None = None,
        phi_y: Scalar | None = None,
        mount: Mount | None = None,
    ) -> "Support":
        """One whisker whose base can move in up to three directions, in space six; at rest it is on the drive.

        Args:
            x: stiffness across the whisker, force per length; positive, or None for rigid.
            y: stiffness along the whisker, force per length; positive, or None for rigid.
            phi: torsional stiffness, moment per rad; positive, or None for rigid.
            z: stiffness along z. This and the following are for objects in space.
            phi_x: torsional stiffness about the x axis.
            phi_y: torsional stiffness about the y axis, along the upright whisker.
            mount: the mount of the whisker. Default: upright at height 0.

        Raises:
            ValueError: if a stiffness is not a positive number, or `mount` is not a Mount.
        """
        stiffness = {"x": x, "y": y, "phi": phi, "z": z, "phi_x": phi_x, "phi_y": phi_y}
        springs = (Spring((0, 1), value, axis=axis) for axis, value in stiffness.items() if value is not None)
        return cls(tuple(springs), mount)

    @classmethod
    def named(cls, model: str, stiffness: PerSpring, rest_length: PerSpring | None = None) -> "Support":
        """A model of the thesis by name: `clamped`, `FB`, `FBFB`, `FBFBR`, `FBFBFBR`.

        Args:
            model: name of the model.
            stiffness: one number for all springs or one per spring, in the order c1, c2, ...; force per length,
                positive.
            rest_length: one length per spring, or one length for each spring in the row. In the second case the rest
                length of a feedback spring is the sum over the springs that it spans, and no spring is strained before
                contact. Default: 0.2 lengths of the first whisker of the scene for each spring in the row.

        Raises:
            ValueError: if the model is unknown, the number of values is wrong, or a value is invalid for a Spring.
        """
        if model == "clamped":
            return cls()
        if model not in _NAMED:
            checks.fail("model", f"one of clamped, {', '.join(_NAMED)}", repr(model))
        ends = _NAMED[model]
        stiffnesses = _per_spring("stiffness", stiffness, [1] * len(ends))
        shares = [second - first for first, second in ends]
        rest_lengths = [None] * len(ends) if rest_length is None else _per_spring("rest_length", rest_length, shares)
        return cls(tuple(map(Spring, ends, stiffnesses, rest_lengths)))

    def flexibility(self, hold: Float[Array, "whiskers axes"] | None = None) -> Flexibility:
        """Flexibility of the bases in the drive's frame; zero without springs.

        If no spring acts along another axis than x, there is one row per base; otherwise three: x, y, angle of base 1,
        then of base 2. Bases that only springs on shafts connect to the drive have no flexibility of their own. They
        are held by a further spring, which is not part of the support, with the stiffness `hold`. The offset is NaN
        while a rest length has its default, which a scene determines.

        Raises:
            ValueError: if there are springs on shafts and `hold` is not given, or springs only for space.
        """
        self.check_in_plane()
        if hold is None and self.on_shafts:
            checks.fail("support", "without springs or foundations on shafts for this function", f"{self.name}")
        return along_axes(self.linked(self.axes or ("x",), hold))

    def flexibility_in_space(self) -> Flexibility:
        """Flexibility of the bases along all axes of the drive's frame, with six rows per base; zero without springs.

        The rows are displacements x, y, z and angles phi_x, phi_y, phi_z of base 1, then of base 2; the loads are
        forces along, and moments about, the same axes.

        Raises:
            ValueError: as `check_in_space`.
        """
        self.check_in_space()
        parts = self.linked(self.axes or ("x",))
        return along_all_axes({axis: one.flexibility() for axis, one in parts.items()}, AXES_IN_SPACE)

    def linked(self, axes: tuple[str, ...], hold: Float[Array, "whiskers axes"] | None = None) -> dict[str, Linked]:
        """The network of the bases along each of these axes; `hold` as for `flexibility`."""
        networks = ((axis, self.along(axis) if hold is None else self._network(axis, hold)) for axis in axes)
        return {axis: linked(springs, self.whiskers) for axis, springs in networks}

    def check_in_plane(self) -> None:
        """Raise a ValueError if a spring or a mount needs an object in space."""
        for part in (*self.springs, *self.mounts):
            part.check_in_plane()

    def check_in_space(self) -> None:
        """Raise a ValueError if a spring is attached to a shaft or not linear, or there is a foundation."""
        if any(one is not None for one in self.foundations):
            checks.fail("foundation", "None in space", repr(self.foundation))
        for spring in self.springs:
            spring.check_in_space()

    def spring_ends(self, axes: tuple[str, ...]) -> SpringEnds:
        """The ends of all linear springs, for positions along these axes."""
        return SpringEnds.of([spring for spring in self.springs if spring.linear], axes)

    def spring_length(self, displacement: Float[Array, "*steps whiskers axes"]) -> Float[Array, "*steps springs"]:
        """Length of every linear spring, or angle of a torsion spring, from the bases' positions relative to the drive.

        Positions have one axis (x) or three, as in `flexibility`, or six, as in `flexibility_in_space`.
        """
        axes = AXES_IN_SPACE if displacement.shape[-1] == len(AXES_IN_SPACE) else AXES
        return self.spring_ends(axes).lengths(displacement)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructors check."""
        tissue = (one for one in self.foundations if one is not None)
        parts = (*self.springs, *(() if self.mount is None else self.mounts), *tissue)
        return jnp.all(jnp.array([part.valid() for part in parts], dtype=bool))


def _acting(axis: str) -> tuple[str, ...]:
    """Axes of springs that free a base along an axis."""
    return (axis, "axial") if axis == "x" else (axis,)


def _per_spring(name: str, value: Any, shares: list[int]) -> list:
    """One value per spring; a single number is multiplied by the share of each spring."""
    listed = isinstance(value, (list, tuple))
    if not listed and jnp.ndim(value) == 0:
        return [value if share == 1 else share * value for share in shares]
    if (not listed and jnp.ndim(value) > 1) or len(value) != len(shares):
        checks.fail(name, f"one number or one per spring ({len(shares)})", repr(value))
    return list(value)
