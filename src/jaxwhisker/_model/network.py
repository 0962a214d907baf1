"""Flexibility of a network: bases that springs along one axis connect to the drive."""

import copy
import itertools
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.spring import AXES, Spring

Signs = Int[Array, "_ whiskers"] | Int[np.ndarray, "_ whiskers"]


class Flexibility(NamedTuple):
    """Displacement of the bases under loads on them: displacement = offset + matrix @ load.

    If bases move along x only, there is one row per base; otherwise three, for x, y and angle. In space there are six:
    x, y, z and the angles about these axes.
    """

    matrix: Float[Array, "rows rows"]
    root: Float[Array, "rows rows"]  # matrix = root @ root.T
    offset: Float[Array, " rows"]
    consistent: Bool[Array, ""]  # rest lengths around every rigid loop add up

    def in_unit(self, length: Scalar, force: Scalar) -> "Flexibility":
        """The dimensionless flexibility of bases that move along x only."""
        stiffness = force / length
        root = self.root * jnp.sqrt(jax.lax.stop_gradient(jnp.asarray(stiffness)))
        return Flexibility(self.matrix * stiffness, root, self.offset / length, self.consistent)

    def in_space(self, length: Scalar, force: Scalar) -> "Flexibility":
        """The dimensionless flexibility with six rows per base, in the axes of the drive's frame.

        Displacements are in units of length, forces of `force` and moments of `force` times length; angles are in rad.
        """
        lengths = jnp.tile(jnp.array([length, length, length, 1.0, 1.0, 1.0], dtype=float), self.offset.size // 6)
        work = force * length
        root = self.root * jax.lax.stop_gradient(jnp.sqrt(work) / lengths)[:, None]
        matrix = self.matrix * (work / (lengths[:, None] * lengths))
        return Flexibility(matrix, root, self.offset / lengths, self.consistent)

    def in_frames(self, angle: Float[Array, " whiskers"], length: Scalar, force: Scalar) -> "Flexibility":
        """The dimensionless flexibility along all axes, each base in a frame at this angle (rad) to the drive's."""
        n = angle.size
        matrix, root, offset, consistent = along_all_axes({"x": self}) if self.offset.size == n else self
        lengths = jnp.array([length, length, 1.0], dtype=float)
        loads = jnp.array([force, force, force * length], dtype=float)
        cos, sin, none = jnp.cos(angle), jnp.sin(angle), jnp.zeros(n)
        turn = jnp.stack([cos, sin, none, -sin, cos, none, none, none, none + 1.0], axis=-1).reshape(n, 3, 3)

        def rows(matrix, by):
            return jnp.sum(by[:, :, :, None] * matrix.reshape(n, 1, 3, 3 * n), axis=2).reshape(3 * n, 3 * n)

        still, size = jax.lax.stop_gradient((turn, jnp.sqrt(loads / lengths)))
        return Flexibility(
            rows(rows(matrix, turn / lengths).T, turn * loads).T,
            rows(root, still * size),
            jnp.sum(turn / lengths * offset.reshape(n, 1, 3), axis=-1).reshape(-1),
            consistent,
        )


Index = Int[Array, " springs"] | Int[np.ndarray, " springs"]


class SpringEnds(NamedTuple):
    """The ends of springs (0 is the drive, then the bases) and the axes along which these act, as indices."""

    first: Index
    second: Index
    axis: Index

    @classmethod
    def of(cls, springs: Sequence[Spring], axes: tuple[str, ...]) -> "SpringEnds":
        """The ends of these springs, for positions along these axes."""
        first, second = np.reshape([spring.between for spring in springs], (-1, 2)).astype(int).T
        return cls(first, second, np.array([axes.index(spring.axis) for spring in springs], dtype=int))

    def lengths(self, displacement: Float[Array, "*steps whiskers axes"]) -> Float[Array, "*steps springs"]:
        """Lengths of the springs, from the positions of the bases relative to the drive."""
        nodes = jnp.concatenate([jnp.zeros_like(displacement[..., :1, :]), displacement], axis=-2)
        return nodes[..., self.second, self.axis] - nodes[..., self.first, self.axis]


def along_all_axes(parts: dict[str, Flexibility], axes: tuple[str, ...] = AXES) -> Flexibility:
    """The flexibility along all axes (x, y and angle) of every base, from those along each axis that has springs."""
    n, k = next(iter(parts.values())).offset.size, len(axes)
    matrix, root, offset = jnp.zeros((n, k, n, k)), jnp.zeros((n, k, n, k)), jnp.zeros((n, k))
    for axis, part in parts.items():
        a = axes.index(axis)
        matrix, root = matrix.at[:, a, :, a].set(part.matrix), root.at[:, a, :, a].set(part.root)
        offset = offset.at[:, a].set(part.offset)
    consistent = jnp.all(jnp.stack([part.consistent for part in parts.values()]))
    return Flexibility(matrix.reshape(n * k, n * k), root.reshape(n * k, n * k), offset.reshape(-1), consistent)


def along_axes(parts: dict[str, "Linked"]) -> Flexibility:
    """The flexibility of networks along these axes: with one row per base if it is x alone, otherwise with three."""
    each = {axis: network.flexibility() for axis, network in parts.items()}
    return each["x"] if tuple(each) == ("x",) else along_all_axes(each)


def connected(springs: tuple[Spring, ...]) -> set[int]:
    """The drive (0) and all bases that springs connect to it."""
    ends = {0}
    for _ in springs:
        ends |= {end for spring in springs for end in spring.between if ends & set(spring.between)}
    return ends


class Linked(eqx.Module):
    """Springs along one axis, with their connections as numbers: networks of as many springs share programs.

    Springs without effect make up for a smaller number in the tree or of loops.
    """

    springs: tuple[Spring, ...]  # of a spanning tree, one for each whisker, then those that close loops
    signs: Signs  # of the tree's springs on the way from the drive to each base
    across: Signs  # -1 and 1 at the first and the second end of the others

    def flexibility(self) -> Flexibility:
        """Flexibility of the network; bases without a spring are rigidly connected to the drive.

        A spring acts like a measurement of the distance between its ends with variance 1/stiffness. The variances of
        the springs in a spanning tree add up along their paths; every other spring is a rank-one update. No step
        divides by a difference of stiffnesses, and rigid springs (variance 0) need no special treatment.
        """
        count, signs = self.signs.shape[0], jnp.asarray(self.signs, dtype=float)
        softness = [spring.softness for spring in self.springs]
        # A default rest length is unknown without a whisker; then the offset is, but not the matrix.
        rest = [jnp.asarray(jnp.nan if s.rest_length is None else s.rest_length, dtype=float) for s in self.springs]
        soft = jnp.stack(softness[:count])
        matrix = jnp.sum(signs[:, None, :] * signs[None, :, :] * soft, axis=-1)
        # The root is only used for decisions; it has no derivative, because its slope at 0 is infinite.
        root = signs * jnp.sqrt(jax.lax.stop_gradient(soft))
        offset = jnp.sum(signs * jnp.stack(rest[:count]), axis=-1)
        network = Flexibility(matrix, root, offset, jnp.asarray(True))
        for k in range(len(self.springs) - count):
            across = jnp.asarray(self.across[k], dtype=float)
            network = _with_spring(network, across, softness[count + k], rest[count + k])
        return network


def linked(springs: tuple[Spring, ...], whiskers: int) -> Linked:
    """A network of springs, connected or without springs at some bases."""
    order, signs, across = _arranged(tuple(spring.between for spring in springs), whiskers)
    return Linked(tuple(_NONE if k is None else _between_any(springs[k]) for k in order), signs, across)


_NONE = Spring((0, 1), np.float64(1.0), np.float64(0.0))


@lru_cache(maxsize=256)
def _arranged(
    ends: tuple[tuple[int, int], ...], whiskers: int
) -> tuple[tuple[int | None, ...], np.ndarray, np.ndarray]:
    """Numbers of the springs with these ends in the order of `Linked`, or None, its signs, and across what they are."""
    paths, loops = _spanning_tree(ends, whiskers)
    tree = sorted(set().union(*paths.values()))
    # Loops fill a multiple of what one spring from the drive to each further base would add.
    closing = max(len(loops) + -len(loops) % max(whiskers - 1, 1), whiskers - 1)
    signs, across = np.zeros((whiskers, whiskers), dtype=int), np.zeros((closing, whiskers), dtype=int)
    for base, column in itertools.product(range(whiskers), range(len(tree))):
        signs[base, column] = paths[base + 1].get(tree[column], 0)
    for row, k in enumerate(loops):
        for end, sign in zip(ends[k], (-1, 1), strict=True):
            if end > 0:
                across[row, end - 1] = sign
    order = (*tree, *[None] * (whiskers - len(tree)), *loops, *[None] * (closing - len(loops)))
    return order, signs, across


def _between_any(spring: Spring) -> Spring:
    """The spring without its ends and its axis, which the network knows."""
    plain = copy.copy(spring)
    for name, value in (("between", (0, 1)), ("axis", "x")):
        object.__setattr__(plain, name, value)
    return plain


def _spanning_tree(ends: tuple[tuple[int, int], ...], whiskers: int) -> tuple[dict[int, dict[int, int]], list[int]]:
    """The path from the drive to each base as {spring: sign}, and the springs that are on no path."""
    sprung = {end for both in ends for end in both}
    # Bases without a spring move with the drive.
    paths: dict[int, dict[int, int]] = {end: {} for end in range(whiskers + 1) if end == 0 or end not in sprung}
    loops = list(range(len(ends)))
    while len(paths) <= whiskers:
        for k in loops:
            first, second = ends[k]
            if (first in paths) != (second in paths):
                known, new, sign = (first, second, 1) if first in paths else (second, first, -1)
                paths[new] = {**paths[known], k: sign}
                loops.remove(k)
                break
    return paths, loops


def _with_spring(
    network: Flexibility, across: Float[Array, " whiskers"], softness: Float[Array, ""], rest: Float[Array, ""]
) -> Flexibility:
    """The network with one more spring, which closes a loop."""
    matrix, root, offset, consistent = network
    gap = rest - jnp.sum(across * offset)
    column = jnp.sum(matrix * across, axis=-1)
    spread = jnp.sum(across * column)
    total = softness + spread
    rigid = total <= 0
    gain = jnp.where(rigid, 0.0, column / jnp.where(rigid, 1.0, total))
    consistent &= ~rigid | (jnp.abs(gap) <= 1e-12 * (1 + jnp.abs(rest)))
    matrix = matrix - gain[:, None] * column[None, :]
    offset = offset + gain * gap
    # Potter's form of the same update: root @ root.T stays positive semidefinite for any range of stiffnesses.
    row = jnp.sum(root * across[:, None], axis=0)
    noise, total = jax.lax.stop_gradient((softness, jnp.where(rigid, 1.0, total)))
    scale = jnp.where(rigid, 1.0, total + jnp.sqrt(noise * total))
    root = root - jnp.sum(root * row, axis=-1)[:, None] * row[None, :] / scale
    return Flexibility(matrix, root, offset, consistent)
