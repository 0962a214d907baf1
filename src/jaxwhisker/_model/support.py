"""The support: springs between the drive (0) and the bases (1 to N), and the mounts of the whiskers."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import PerSpring, Scalar
from jaxwhisker._model.network import Flexibility, along_all_axes, connected, flexibility
from jaxwhisker._model.spring import AXES, Spring


class Mount(eqx.Module):
    """Mount of a whisker: where its base is in the drive's frame when all rest lengths are 0, and at which angle.

    The angle turns the whisker about its root.

    Args:
        x: offset along x, a length.
        y: height of the base, a length.
        angle: angle between the root of the unloaded whisker and the upright, rad, positive counter-clockwise (towards
            -x); less than a right angle.

    Raises:
        ValueError: if a value is not a finite number, or the angle is not less than a right angle.

    Examples:
        >>> leaning = jw.Mount(y=0.05, angle=-0.2)
        >>> jw.Support.follicle(phi=3.0, mount=leaning).mounts[0].angle
        -0.2
    """

    x: Scalar = 0.0
    y: Scalar = 0.0
    angle: Scalar = 0.0

    def __check_init__(self):
        checks.number("x", self.x)
        checks.number("y", self.y)
        checks.acute_angle("angle", self.angle)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        return checks.all_finite(self) & (jnp.abs(jnp.asarray(self.angle)) < checks.RIGHT_ANGLE)


_NAMED = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}


class Support(eqx.Module):
    """Springs between the drive and the bases; without springs, the bases are clamped to the drive.

    A base is rigidly connected to the drive along every axis that has no springs.

    Args:
        springs: any network; every base from 1 to N must occur in it.
        mount: a Mount for all whiskers, or a tuple with one per base, which also sets the number of whiskers if there
            are no springs. Default: upright at height 0.

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

    def __check_init__(self):
        if not isinstance(self.springs, tuple) or not all(isinstance(s, Spring) for s in self.springs):
            checks.fail("springs", "a tuple of Spring", repr(self.springs))
        self._check_mounts()
        self._check_connected()
        self._check_rigid_loops()

    def _check_mounts(self) -> None:
        mounts = self.mount if isinstance(self.mount, tuple) else (self.mount,)
        if self.mount is not None and not (mounts and all(isinstance(m, Mount) for m in mounts)):
            checks.fail("mount", "a Mount or a tuple of them", repr(self.mount))
        if isinstance(self.mount, tuple) and self.springs and len(mounts) != self.whiskers:
            checks.fail("mount", f"one Mount or one per base ({self.whiskers})", f"{len(mounts)} of them")

    def _check_connected(self) -> None:
        ends = {end for spring in self.springs for end in spring.between}
        for axis in self.axes:
            springs = self.along(axis)
            loose = {end for s in springs for end in s.between} - connected(springs)
            missing = loose | (set(range(1, self.whiskers + 1)) - ends)
            if missing:
                raise ValueError(
                    f"`springs` must connect every base from 1 to {self.whiskers} to the drive 0, got no connection of "
                    f"base {min(missing)} along {axis} (springs between {[s.between for s in springs]})."
                )

    def _check_rigid_loops(self) -> None:
        if checks.is_traced(self.springs) or not any(s.is_rigid() for s in self.springs):
            return
        with jax.ensure_compile_time_eval():  # concrete values are checked inside jit, too
            if not all(flexibility(self.along(a), self.whiskers).consistent for a in self.axes):
                lengths = [float(s.rest_length) for s in self.springs]
                checks.fail("rest_length", "the same along all paths of infinitely stiff springs", lengths)

    def along(self, axis: str) -> tuple[Spring, ...]:
        """The springs along an axis."""
        return tuple(spring for spring in self.springs if spring.axis == axis)

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes that have springs."""
        return tuple(axis for axis in AXES if self.along(axis))

    @property
    def mounts(self) -> tuple[Mount, ...]:
        """One Mount per base."""
        return self.mount if isinstance(self.mount, tuple) else (self.mount or Mount(),) * self.whiskers

    @property
    def whiskers(self) -> int:
        """N, the number of bases."""
        if not self.springs:
            return len(self.mount) if isinstance(self.mount, tuple) else 1
        return max(b for s in self.springs for b in s.between)

    @property
    def name(self) -> str:
        """The name of the model in the thesis, or `clamped`, `follicle`, or `network`."""
        between = tuple(s.between for s in self.springs)
        if self.axes in ((), ("x",)):
            return next((name for name, ends in _NAMED.items() if ends == between), "network" if between else "clamped")
        return "follicle" if set(between) == {(0, 1)} else "network"

    @classmethod
    def clamped(cls) -> "Support":
        """One whisker clamped to the drive, without springs."""
        return cls()

    @classmethod
    def fb(cls, stiffness: Scalar, rest_length: Scalar = 0.2) -> "Support":
        """One whisker: drive -c1- base 1. Arguments and errors are those of `named`."""
        return cls.named("FB", stiffness, rest_length)

    @classmethod
    def fbfb(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """Two whiskers in a row: drive -c1- base 1 -c2- base 2. Arguments and errors are those of `named`."""
        return cls.named("FBFB", stiffness, rest_length)

    @classmethod
    def fbfbr(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """FBFB with feedback: c3 between drive and base 2. Arguments and errors are those of `named`."""
        return cls.named("FBFBR", stiffness, rest_length)

    @classmethod
    def fbfbfbr(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """Three whiskers in a row (c1, c2, c3), with feedback c4 to base 2 and c5 to base 3.

        Arguments and errors are those of `named`.
        """
        return cls.named("FBFBFBR", stiffness, rest_length)

    @classmethod
    def follicle(
        cls, x: Scalar | None = None, y: Scalar | None = None, phi: Scalar | None = None, *, mount: Mount | None = None
    ) -> "Support":
        """One whisker whose base can move in up to three directions; at rest it is on the drive.

        Args:
            x: stiffness across the whisker, force per length; positive, or None for rigid.
            y: stiffness along the whisker, force per length; positive, or None for rigid.
            phi: torsional stiffness, moment per rad; positive, or None for rigid.
            mount: the mount of the whisker. Default: upright at height 0.

        Raises:
            ValueError: if a stiffness is not a positive number, or `mount` is not a Mount.
        """
        stiffness = {"x": x, "y": y, "phi": phi}
        springs = (Spring((0, 1), value, axis=axis) for axis, value in stiffness.items() if value is not None)
        return cls(tuple(springs), mount)

    @classmethod
    def named(cls, model: str, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """A model of the thesis by name: `clamped`, `FB`, `FBFB`, `FBFBR`, `FBFBFBR`.

        Args:
            model: name of the model.
            stiffness: one number for all springs or one per spring, in the order c1, c2, ...; force per length,
                positive.
            rest_length: one length per spring, or one length for each spring in the row. In the second case the rest
                length of a feedback spring is the sum over the springs that it spans, and no spring is strained before
                contact.

        Raises:
            ValueError: if the model is unknown, the number of values is wrong, or a value is invalid for a Spring.
        """
        if model == "clamped":
            return cls()
        if model not in _NAMED:
            checks.fail("model", f"one of clamped, {', '.join(_NAMED)}", repr(model))
        ends = _NAMED[model]
        stiffnesses = _per_spring("stiffness", stiffness, [1] * len(ends))
        rest_lengths = _per_spring("rest_length", rest_length, [second - first for first, second in ends])
        return cls(tuple(map(Spring, ends, stiffnesses, rest_lengths)))

    def flexibility(self) -> Flexibility | None:
        """Flexibility of the bases in the drive's frame; None without springs.

        If all springs act along x, there is one row per base; otherwise three: x, y, angle of base 1, then of base 2.
        """
        if not self.springs:
            return None
        parts = {axis: flexibility(self.along(axis), self.whiskers) for axis in self.axes}
        return parts["x"] if self.axes == ("x",) else along_all_axes(parts)

    def spring_length(self, displacement: Float[Array, "*steps whiskers axes"]) -> Float[Array, "*steps springs"]:
        """Length of every spring, or angle of a torsion spring, from the bases' positions relative to the drive.

        Positions have one axis (x) or three, as in `flexibility`.
        """
        still = jnp.zeros_like(displacement[..., :1, :])
        nodes = jnp.concatenate([still, displacement], axis=-2)
        first, second = np.reshape([spring.between for spring in self.springs], (-1, 2)).astype(int).T
        axis = np.array([AXES.index(spring.axis) for spring in self.springs], dtype=int)
        return nodes[..., second, axis] - nodes[..., first, axis]

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructors check."""
        parts = (*self.springs, *(() if self.mount is None else self.mounts))
        return jnp.all(jnp.array([part.valid() for part in parts], dtype=bool))


def _per_spring(name: str, value: Any, shares: list[int]) -> list:
    """One value per spring; a single number is multiplied by the share of each spring."""
    listed = isinstance(value, (list, tuple))
    if not listed and jnp.ndim(value) == 0:
        return [value if share == 1 else share * value for share in shares]
    if (not listed and jnp.ndim(value) > 1) or len(value) != len(shares):
        checks.fail(name, f"one number or one per spring ({len(shares)})", repr(value))
    return list(value)
