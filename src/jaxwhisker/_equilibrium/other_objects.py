"""Clearance of a shaft from an object that it does not touch, one of several.

The distances of many points of the shaft from the object are computed. The shaft comes nearest close to the nearest of
them, where its direction is that of the object's tangent: this place is solved for, because a sharp corner may be
between two points. A small object may be passed between two states; the side on which the shaft passes it tells.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.interpolation import between
from jaxwhisker._equilibrium.clearance import DEPTH, NEAREST_ERROR, nearest
from jaxwhisker._equilibrium.shaft import Line, Shaft
from jaxwhisker._model.profile import AbstractProfile

CELLS = 64  # of each part of a shaft, at least
NEWTON_STEPS = 6
SOLVED = 1e-7  # largest residual at the place where the shaft comes nearest
CHORD = 0.01  # more than the distance between a shaft and its chords


def meets(profile: AbstractProfile, own: Shaft) -> Bool[Array, ""]:
    """Whether a shaft dips into an object that it does not touch by more than `DEPTH`."""
    lines = [_divided(line) for line in (own.to_base, own.to_tip)]
    last_below = lines[0].x.size - 1
    x, y, cos, sin, cell = (jnp.concatenate(parts) for parts in zip(*lines, strict=True))
    start = jax.lax.stop_gradient(jnp.asarray(profile.lowest(), dtype=float))
    above = y > profile.point(start).y
    # The shaft may come nearest between two points, one of which lies below the object.
    wanted = above | jnp.roll(above, 1) | jnp.roll(above, -1)
    feet = nearest(profile, start, x, y, wanted)
    at = jax.vmap(profile.point)(feet)
    gap, along = (x - at.x) * at.sin - (y - at.y) * at.cos, (x - at.x) * at.cos + (y - at.y) * at.sin
    # Where an object ends, there is no nearest point.
    gap = jnp.where(wanted & (jnp.abs(along) < NEAREST_ERROR), gap, jnp.inf)
    k = jnp.argmin(gap)
    # Curvature from the direction of the next point, or of the one before at the end of a part.
    other = jnp.where((k == last_below) | (k == gap.size - 1), k - 1, k + 1)
    size = jnp.where(other > k, cell[k], -cell[k])
    curvature = (cos[k] * sin[other] - sin[k] * cos[other]) / jnp.where(size == 0, 1.0, size)

    def apart(unknowns):
        s, foot = unknowns
        at, turn = profile.point(foot), curvature * s
        right, up = cos[k] * s - sin[k] * turn * s / 2, sin[k] * s + cos[k] * turn * s / 2
        right, up = x[k] + right - at.x, y[k] + up - at.y
        along_x, along_y = cos[k] - sin[k] * turn, sin[k] + cos[k] * turn
        residual = jnp.stack([right * at.cos + up * at.sin, along_x * at.sin - along_y * at.cos])
        return residual, right * at.sin - up * at.cos

    def newton(_, unknowns):
        ((a, b), (c, d)), (e, f) = jax.jacfwd(lambda at: apart(at)[0])(unknowns), apart(unknowns)[0]
        step = jnp.stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)
        return unknowns - jnp.where(jnp.isfinite(step), step, 0.0)

    unknowns = jax.lax.fori_loop(0, NEWTON_STEPS, newton, jnp.stack([jnp.zeros(()), feet[k]]))
    residual, least = apart(unknowns)
    solved = jnp.all(jnp.abs(residual) < SOLVED) & (jnp.abs(unknowns[0]) <= jnp.abs(cell[k]) + SOLVED)
    return (gap[k] < -DEPTH) | (jnp.isfinite(gap[k]) & solved & (least < -DEPTH))


def _divided(line: Line) -> Line:
    """A line with at least `CELLS` cells, each of which has the size of its arc."""
    parts = -(-CELLS // line.cell.size)
    t = jnp.arange(parts) / parts

    def divided(value, rate):
        cells = line.cell[:, None]
        cubic = between(value[:, None], rate[:, None], cells)
        rates = jnp.where(cells == 0, rate[:-1, None], cubic.rate(t) / jnp.where(cells == 0, 1.0, cells))
        return jnp.append(cubic.value(t), value[-1]), jnp.append(rates, rate[-1])

    (x, cos), (y, sin) = divided(line.x, line.cos), divided(line.y, line.sin)
    size = jnp.hypot(cos, sin)
    cell = jnp.repeat(line.cell / parts, parts)
    return Line(x, y, cos / size, sin / size, jnp.append(cell, cell[-1]))


def passes(profile: AbstractProfile, own: Shaft) -> Float[Array, ""]:
    """The side (+1 right, -1 left) on which a shaft passes the lowest point of an object; 0 if below it or close by."""
    x, y = (jnp.concatenate([getattr(own.to_base, name)[::-1], getattr(own.to_tip, name)]) for name in ("x", "y"))
    lowest_x, lowest_y = profile.vertex()
    crosses = (y[:-1] < lowest_y) & (y[1:] >= lowest_y)
    first = jnp.argmax(crosses)
    rise = jnp.where(crosses[first], y[first + 1] - y[first], 1.0)
    right = x[first] + (lowest_y - y[first]) / rise * (x[first + 1] - x[first]) - lowest_x
    return jnp.where(crosses[first] & (jnp.abs(right) > CHORD), jnp.sign(right), 0.0)
