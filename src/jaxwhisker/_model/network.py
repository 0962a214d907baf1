"""The network: how the bases yield that springs along one axis connect to the drive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.spring import Spring


class Flexibility(NamedTuple):
    """How bases yield to loads on them: displacement = offset + matrix @ load.

    Along x alone a row for each base; else three, for x, y and angle.
    """

    matrix: Float[Array, "rows rows"]
    root: Float[Array, "rows rows"]  # matrix = root @ root.T
    offset: Float[Array, " rows"]
    consistent: Bool[Array, ""]  # rigid loops close with their rest lengths

    def in_unit(self, length: Scalar, force: Scalar) -> "Flexibility":
        """The same without dimensions, along x alone."""
        stiffness = force / length
        root = self.root * jnp.sqrt(jax.lax.stop_gradient(jnp.asarray(stiffness)))
        return Flexibility(self.matrix * stiffness, root, self.offset / length, self.consistent)

    def in_frames(self, angle: Float[Array, " whiskers"], length: Scalar, force: Scalar) -> "Flexibility":
        """The same without dimensions, along all axes, each base seen in a frame turned by its angle to the drive's."""
        n = angle.size
        matrix, root, offset = self.matrix, self.root, self.offset
        if offset.size == n:
            matrix, root = (jnp.zeros((n, 3, n, 3)).at[:, 0, :, 0].set(m).reshape(3 * n, 3 * n) for m in (matrix, root))
            offset = jnp.zeros((n, 3)).at[:, 0].set(offset).reshape(-1)
        lengths = jnp.stack([jnp.asarray(v, dtype=float) for v in (length, length, 1.0)])
        loads = jnp.stack([jnp.asarray(v, dtype=float) for v in (force, force, force * length)])
        cos, sin, none = jnp.cos(angle), jnp.sin(angle), jnp.zeros(n)
        turn = jnp.stack([cos, sin, none, -sin, cos, none, none, none, none + 1.0], axis=-1).reshape(n, 3, 3)

        def rows(matrix, by):
            return jnp.sum(by[:, :, :, None] * matrix.reshape(n, 1, 3, 3 * n), axis=2).reshape(3 * n, 3 * n)

        still, size = jax.lax.stop_gradient((turn, jnp.sqrt(loads / lengths)))
        return Flexibility(
            rows(rows(matrix, turn / lengths).T, turn * loads).T,
            rows(root, still * size),
            jnp.sum(turn / lengths * offset.reshape(n, 1, 3), axis=-1).reshape(-1),
            self.consistent,
        )


def reached(springs: tuple[Spring, ...]) -> set[int]:
    """The drive, 0, and the bases that springs connect to it."""
    found = {0}
    for _ in springs:
        found |= {end for spring in springs for end in spring.between if found & set(spring.between)}
    return found


def flexibility(springs: tuple[Spring, ...], whiskers: int) -> Flexibility:
    """Flexibility of a connected network; bases without a spring are rigid.

    A spring is a measurement of the distance of its ends with variance 1/stiffness: the springs of a spanning tree
    add up along their paths, every further one is a rank-one update. Nothing is divided by a difference of
    stiffnesses, and rigid springs (variance 0) need no path of their own.
    """
    sprung = {end for spring in springs for end in spring.between}
    # Base -> {spring of the tree: sign}; what no spring moves stands where the drive does.
    rows: dict[int, dict[int, float]] = {end: {} for end in range(whiskers + 1) if end == 0 or end not in sprung}
    loops = list(range(len(springs)))
    while len(rows) <= whiskers:
        for k in loops:
            first, second = springs[k].between
            if (first in rows) != (second in rows):
                known, new, sign = (first, second, 1.0) if first in rows else (second, first, -1.0)
                rows[new] = {**rows[known], k: sign}
                loops.remove(k)
                break
    softness = [s.softness for s in springs]
    rest = [jnp.asarray(s.rest_length, dtype=float) for s in springs]
    tree = sorted(set().union(*rows.values()))
    signs = jnp.array([[rows[base].get(k, 0.0) for k in tree] for base in range(1, whiskers + 1)])
    soft = jnp.stack([softness[k] for k in tree])
    matrix = jnp.sum(signs[:, None, :] * signs[None, :, :] * soft, axis=-1)
    # For decisions only: its slope at 0 is infinite.
    root = signs * jnp.sqrt(jax.lax.stop_gradient(soft))
    root = jnp.pad(root, ((0, 0), (0, whiskers - len(tree))))
    offset = jnp.sum(signs * jnp.stack([rest[k] for k in tree]), axis=-1)
    consistent = jnp.asarray(True)
    for k in loops:
        across = _incidence(springs[k].between, whiskers)
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


def _incidence(between: tuple[int, int], whiskers: int) -> Float[Array, " whiskers"]:
    first, second = between
    return jnp.array([float(base == second) - float(base == first) for base in range(1, whiskers + 1)])
