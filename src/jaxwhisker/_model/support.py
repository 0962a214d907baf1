"""The support: springs between the drive (0) and the bases (1 to N), and how whiskers are mounted on these."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.types import PerSpring, Scalar
from jaxwhisker._model.network import Flexibility, flexibility, reached
from jaxwhisker._model.spring import AXES, Spring


class Mount(eqx.Module):
    """How a whisker is mounted on its base: where it stands in the drive's frame if all springs have rest length 0.

    It turns about its root.

    Args:
        x: offset along x, a length.
        y: height of the base, a length.
        angle: of the unloaded whisker's root to the upright, rad, counter-clockwise (towards -x); less than a right
            angle.

    Raises:
        ValueError: if a value is not a finite number, or the angle a right one or more.
    """

    x: Scalar = 0.0
    y: Scalar = 0.0
    angle: Scalar = 0.0

    def __check_init__(self):
        for name in ("x", "y", "angle"):
            checks.number(name, getattr(self, name))
        if not checks.is_traced(self.angle) and not abs(float(self.angle)) < RIGHT_ANGLE:
            raise ValueError(f"`angle` must be less than a right angle, but is {float(self.angle):g} rad.")

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructor would have let them."""
        x, y, angle = (jnp.asarray(value, dtype=float) for value in (self.x, self.y, self.angle))
        return jnp.isfinite(x) & jnp.isfinite(y) & (jnp.abs(angle) < RIGHT_ANGLE)


RIGHT_ANGLE = 1.5707963267948966

_NAMED = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}


class Support(eqx.Module):
    """Springs between drive and bases; without any, the bases are clamped to the drive.

    Along an axis without springs a base is rigid relative to the drive.

    Args:
        springs: any network; every base from 1 to N has to occur.
        mount: how whiskers are mounted on their bases: a Mount for all, or a tuple with one per base (without springs
            their number is that of the whiskers); upright at height 0 by default.

    Raises:
        ValueError: if a base is missing, or springs along an axis do not connect it to the drive.
    """

    springs: tuple[Spring, ...] = ()
    mount: Mount | tuple[Mount, ...] | None = None

    def __check_init__(self):
        if not isinstance(self.springs, tuple) or not all(isinstance(s, Spring) for s in self.springs):
            raise ValueError(f"`springs` must be a tuple of Spring, but is {self.springs!r}.")
        mounts = self.mount if isinstance(self.mount, tuple) else (self.mount,)
        if self.mount is not None and not (mounts and all(isinstance(m, Mount) for m in mounts)):
            raise ValueError(f"`mount` must be a Mount or a tuple of them, but is {self.mount!r}.")
        if isinstance(self.mount, tuple) and self.springs and len(mounts) != self.whiskers:
            raise ValueError(f"`mount` must hold one per base ({self.whiskers}), but holds {len(mounts)}.")
        named = {end for spring in self.springs for end in spring.between}
        for axis in self.axes:
            springs = self.along(axis)
            loose = {end for s in springs for end in s.between} - reached(springs)
            missing = loose | (set(range(1, self.whiskers + 1)) - named)
            if missing:
                raise ValueError(
                    f"`springs` must connect every base from 1 to {self.whiskers} to the drive 0, but along {axis} "
                    f"base {min(missing)} is not connected (springs between {[s.between for s in springs]})."
                )
        with jax.ensure_compile_time_eval():  # known values may be checked inside jit, too
            rigid = not checks.is_traced(self.springs) and any(s.softness == 0 for s in self.springs)
            open_ = rigid and not all(flexibility(self.along(a), self.whiskers).consistent for a in self.axes)
        if open_:
            lengths = [float(s.rest_length) for s in self.springs]
            raise ValueError(f"`rest_length` must let loops of infinitely stiff springs close, but is {lengths}.")

    def along(self, axis: str) -> tuple[Spring, ...]:
        """The springs along an axis."""
        return tuple(spring for spring in self.springs if spring.axis == axis)

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes along which there are springs."""
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
        """The thesis's name of the model, `clamped`, `follicle`, or `network`."""
        between = tuple(s.between for s in self.springs)
        if self.axes in ((), ("x",)):
            return next((name for name, ends in _NAMED.items() if ends == between), "network" if between else "clamped")
        return "follicle" if set(between) == {(0, 1)} else "network"

    @classmethod
    def clamped(cls) -> "Support":
        """One whisker clamped to the drive: no springs at all."""
        return cls()

    @classmethod
    def fb(cls, stiffness: Scalar, rest_length: Scalar = 0.2) -> "Support":
        """One whisker: drive -c1- base 1."""
        return cls.named("FB", stiffness, rest_length)

    @classmethod
    def fbfb(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """Two whiskers in a row: drive -c1- base 1 -c2- base 2."""
        return cls.named("FBFB", stiffness, rest_length)

    @classmethod
    def fbfbr(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """FBFB with feedback: c3 between drive and base 2."""
        return cls.named("FBFBR", stiffness, rest_length)

    @classmethod
    def fbfbfbr(cls, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """Three whiskers in a row (c1, c2, c3), with feedback c4 to base 2 and c5 to base 3."""
        return cls.named("FBFBFBR", stiffness, rest_length)

    @classmethod
    def follicle(
        cls,
        x: Scalar | None = None,
        y: Scalar | None = None,
        phi: Scalar | None = None,
        *,
        mount: Mount | None = None,
    ) -> "Support":
        """One whisker whose base yields in up to three directions, at rest on the drive.

        Args:
            x: stiffness across the whisker, force per length; None for rigid.
            y: stiffness along it.
            phi: torsional stiffness, moment per rad.
            mount: how the whisker is mounted.
        """
        stiffness = {"x": x, "y": y, "phi": phi}
        springs = (Spring((0, 1), value, axis=axis) for axis, value in stiffness.items() if value is not None)
        return cls(tuple(springs), mount)

    @classmethod
    def named(cls, model: str, stiffness: PerSpring, rest_length: PerSpring = 0.2) -> "Support":
        """A model of the thesis by name: `clamped`, `FB`, `FBFB`, `FBFBR`, `FBFBFBR`.

        Args:
            model: its name.
            stiffness: one number for all springs or one per spring, in the order c1, c2, ...
            rest_length: one per spring, or one number for each spring of the row; a feedback spring then rests at the
                sum over the row that it spans, so that nothing is strained before contact.
        """
        if model == "clamped":
            return cls()
        if model not in _NAMED:
            raise ValueError(f"`model` must be one of clamped, {', '.join(_NAMED)}, but is {model!r}.")
        ends = _NAMED[model]
        spans = [second - first for first, second in ends]
        stiffnesses = _per_spring("stiffness", stiffness, [1] * len(ends))
        rest_lengths = _per_spring("rest_length", rest_length, spans)
        return cls(tuple(Spring(e, c, r) for e, c, r in zip(ends, stiffnesses, rest_lengths, strict=True)))

    def flexibility(self) -> Flexibility | None:
        """How the bases yield in the drive's frame; None without springs.

        Where all springs act along x a row for each base, else three: x, y, angle of the first one, and so on.
        """
        if not self.springs:
            return None
        if self.axes == ("x",):
            return flexibility(self.springs, self.whiskers)
        n, k = self.whiskers, len(AXES)
        matrix, root, offset = jnp.zeros((n, k, n, k)), jnp.zeros((n, k, n, k)), jnp.zeros((n, k))
        consistent = jnp.asarray(True)
        for axis in self.axes:
            a, one = AXES.index(axis), flexibility(self.along(axis), n)
            matrix, root = matrix.at[:, a, :, a].set(one.matrix), root.at[:, a, :, a].set(one.root)
            offset = offset.at[:, a].set(one.offset)
            consistent &= one.consistent
        return Flexibility(matrix.reshape(n * k, n * k), root.reshape(n * k, n * k), offset.reshape(-1), consistent)

    def spring_length(self, displacement: Float[Array, "*steps whiskers axes"]) -> Float[Array, "*steps springs"]:
        """Length of every spring, of torsion springs the angle, from the bases' positions relative to the drive.

        These are along x, or along all axes: see `flexibility`.
        """
        still = jnp.zeros_like(displacement[..., :1, :])
        nodes = jnp.concatenate([still, displacement], axis=-2)
        lengths = [
            nodes[..., s.between[1], AXES.index(s.axis)] - nodes[..., s.between[0], AXES.index(s.axis)]
            for s in self.springs
        ]
        return jnp.stack(lengths, axis=-1) if lengths else jnp.zeros((*displacement.shape[:-2], 0))

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructors would have let them."""
        ok = [part.valid() for part in (*self.springs, *([] if self.mount is None else self.mounts))]
        return jnp.all(jnp.stack(ok)) if ok else jnp.asarray(True)


def _per_spring(name: str, value, shares: list[int]) -> list:
    if not isinstance(value, (list, tuple)) and jnp.ndim(value) == 0:
        return [value if share == 1 else share * value for share in shares]
    if jnp.ndim(value if not isinstance(value, (list, tuple)) else 0) > 1 or len(value) != len(shares):
        raise ValueError(f"`{name}` must be one number or one per spring ({len(shares)}), but is {value!r}.")
    return list(value)
