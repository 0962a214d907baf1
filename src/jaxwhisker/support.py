"""The support: a network of springs between the drive (0) and the bases (1 to N) of the whiskers."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker import _checks
from jaxwhisker._types import PerSpring, Scalar


class Spring(eqx.Module):
    """A linear spring along x: it pulls with stiffness * (length - rest_length), length = x_second - x_first.

    Args:
        between: (first, second): 0 is the drive, 1 to N are the bases.
        stiffness: c, force per length; positive, `jnp.inf` for a rigid link.
        rest_length: lambda, a length: where `second` rests to the right of `first`.
        compliance: 1/c, instead of the stiffness; 0 for a rigid link, with derivatives by it that do not vanish there.

    Raises:
        ValueError: if a value is out of its domain, or not exactly one of stiffness and compliance is given.
    """

    between: tuple[int, int] = eqx.field(static=True)
    stiffness: Scalar | None = None
    rest_length: Scalar = 0.0
    compliance: Scalar | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        ends = self.between
        if not (isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(e, int) and e >= 0 for e in ends)):
            raise ValueError(
                f"`between` must be a pair of ints, 0 for the drive or 1 to N for a base, but is {ends!r}."
            )
        if ends[0] == ends[1]:
            raise ValueError(f"`between` must name two different ends, but is {ends!r}.")
        if (self.stiffness is None) == (self.compliance is None):
            raise ValueError(
                f"`stiffness` or `compliance` must be given, and not both, but they are {self.stiffness!r} and "
                f"{self.compliance!r}."
            )
        if self.stiffness is not None:
            _checks.number("stiffness", self.stiffness, positive=True, finite=False)
        if self.compliance is not None:
            _checks.number("compliance", self.compliance)
            if not _checks.is_traced(self.compliance) and self.compliance < 0:
                raise ValueError(f"`compliance` must be at least 0, but is {self.compliance}.")
        _checks.number("rest_length", self.rest_length)

    @property
    def softness(self) -> Float[Array, ""]:
        """1/c, whichever of the two was given."""
        if self.compliance is not None:
            return jnp.asarray(self.compliance, dtype=float)
        return 1 / jnp.asarray(self.stiffness, dtype=float)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructor would have let them."""
        positive = self.softness >= 0 if self.stiffness is None else jnp.asarray(self.stiffness) > 0
        return positive & jnp.isfinite(self.softness) & jnp.isfinite(self.rest_length)


class Flexibility(NamedTuple):
    """How the bases of a network yield: base_x = control + offset + matrix @ force_x."""

    matrix: Float[Array, "whiskers whiskers"]
    root: Float[Array, "whiskers whiskers"]  # matrix = root @ root.T
    offset: Float[Array, " whiskers"]
    consistent: Bool[Array, ""]  # rigid loops close with their rest lengths


_NAMED = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}


class Support(eqx.Module):
    """Springs between drive and bases; without any, one base clamped to the drive.

    Args:
        springs: any connected network; every base from 1 to N has to occur.

    Raises:
        ValueError: if a base is missing or not connected to the drive.
    """

    springs: tuple[Spring, ...] = ()

    def __check_init__(self):
        if not isinstance(self.springs, tuple) or not all(isinstance(s, Spring) for s in self.springs):
            raise ValueError(f"`springs` must be a tuple of Spring, but is {self.springs!r}.")
        reached = {0}
        for _ in self.springs:
            reached |= {b for s in self.springs for b in s.between if reached & set(s.between)}
        wanted = set(range(self.whiskers + 1)) if self.springs else {0}
        if reached != wanted:
            raise ValueError(
                f"`springs` must connect every base from 1 to {self.whiskers} to the drive 0, but "
                f"base {min(wanted - reached)} is not connected (springs between {[s.between for s in self.springs]})."
            )
        with jax.ensure_compile_time_eval():  # known values may be checked inside jit, too
            rigid = not _checks.is_traced(self.springs) and any(s.softness == 0 for s in self.springs)
            flexibility = self.flexibility() if rigid else None
            loose = flexibility is not None and not flexibility.consistent
        if loose:
            lengths = [float(s.rest_length) for s in self.springs]
            raise ValueError(f"`rest_length` must let loops of infinitely stiff springs close, but is {lengths}.")

    @property
    def whiskers(self) -> int:
        """N, the number of bases."""
        return max((b for s in self.springs for b in s.between), default=1)

    @property
    def name(self) -> str:
        """The thesis's name of the model, `clamped`, or `network`."""
        between = tuple(s.between for s in self.springs)
        return next((name for name, ends in _NAMED.items() if ends == between), "network" if between else "clamped")

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
        """Flexibility matrix and rest positions of the bases; None without springs.

        A spring is a measurement of the distance of its ends with variance 1/stiffness: the springs of a spanning tree
        add up along their paths, every further one is a rank-one update. Nothing is divided by a difference of
        stiffnesses, and rigid springs (variance 0) need no path of their own.
        """
        if not self.springs:
            return None
        n = self.whiskers
        rows: dict[int, dict[int, float]] = {0: {}}  # base -> {spring of the tree: sign}
        loops = list(range(len(self.springs)))
        while len(rows) <= n:
            for k in loops:
                first, second = self.springs[k].between
                if (first in rows) != (second in rows):
                    known, new, sign = (first, second, 1.0) if first in rows else (second, first, -1.0)
                    rows[new] = {**rows[known], k: sign}
                    loops.remove(k)
                    break
        softness = [s.softness for s in self.springs]
        rest = [jnp.asarray(s.rest_length, dtype=float) for s in self.springs]
        tree = sorted(set().union(*rows.values()))
        signs = jnp.array([[rows[base].get(k, 0.0) for k in tree] for base in range(1, n + 1)])
        soft = jnp.stack([softness[k] for k in tree])
        matrix = jnp.sum(signs[:, None, :] * signs[None, :, :] * soft, axis=-1)
        root = signs * jnp.sqrt(jax.lax.stop_gradient(soft))  # for decisions only: its slope at 0 is infinite
        offset = jnp.sum(signs * jnp.stack([rest[k] for k in tree]), axis=-1)
        consistent = jnp.asarray(True)
        for k in loops:
            across = _incidence(self.springs[k].between, n)
            gap = rest[k] - jnp.sum(across * offset)
            column = jnp.sum(matrix * across, axis=-1)
            spread = jnp.sum(across * column)
            total = softness[k] + spread
            rigid = total <= 0
            gain = jnp.where(rigid, 0.0, column / jnp.where(rigid, 1.0, total))
            consistent &= ~rigid | (jnp.abs(gap) <= 1e-12 * (1 + jnp.abs(rest[k])))
            matrix = matrix - gain[:, None] * column[None, :]
            offset = offset + gain * gap
            # Potter's form of the same update keeps the root a root, whatever the range of stiffnesses.
            row = jnp.sum(root * across[:, None], axis=0)
            noise, all_ = jax.lax.stop_gradient((softness[k], jnp.where(rigid, 1.0, total)))
            scale = jnp.where(rigid, 1.0, all_ + jnp.sqrt(noise * all_))
            root = root - jnp.sum(root * row, axis=-1)[:, None] * row[None, :] / scale
        return Flexibility(matrix, root, offset, consistent)

    def spring_length(self, base_x: Float[Array, "*steps whiskers"], control: Float[Array, "*steps"]):
        """Length x_second - x_first of every spring: (*steps, springs)."""
        nodes = jnp.concatenate([control[..., None], base_x], axis=-1)
        lengths = [nodes[..., s.between[1]] - nodes[..., s.between[0]] for s in self.springs]
        return jnp.stack(lengths, axis=-1) if lengths else jnp.zeros((*control.shape, 0))

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters lie where the constructors would have let them."""
        ok = [spring.valid() for spring in self.springs]
        return jnp.all(jnp.stack(ok)) if ok else jnp.asarray(True)


def _per_spring(name: str, value, shares: list[int]) -> list:
    if not isinstance(value, (list, tuple)) and jnp.ndim(value) == 0:
        return [value if share == 1 else share * value for share in shares]
    if jnp.ndim(value if not isinstance(value, (list, tuple)) else 0) > 1 or len(value) != len(shares):
        raise ValueError(f"`{name}` must be one number or one per spring ({len(shares)}), but is {value!r}.")
    return list(value)


def _incidence(between: tuple[int, int], whiskers: int) -> Float[Array, " whiskers"]:
    first, second = between
    return jnp.array([float(base == second) - float(base == first) for base in range(1, whiskers + 1)])
