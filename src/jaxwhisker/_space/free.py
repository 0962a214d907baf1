"""Free whiskers: their unloaded shape, their distance from the surface, and the contact that begins where they touch.

Distances are the radii of balls that the object does not enter. They never exceed the distance from the object itself,
and a drive that moves the whisker by less cannot miss it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.drives import Placement
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._space.contact import Contact

INTERVALS = 32  # of a whisker, at whose ends the distance is computed
FINER, ROUNDS = 16, 5  # the interval around the least distance is divided so often; positions along it to 1e-7


class SpaceOutline(NamedTuple):
    """Shape of an unloaded whisker in the frame of its mount, at equidistant points from base to tip."""

    position: Float[Array, "points 3"]
    rotation: Float[Array, "points 3 3"]  # of the body frame; the last column is the tangent


class Nearest(NamedTuple):
    """The point of a free whisker that is nearest to the surface."""

    distance: Scalar  # negative inside
    contact: Contact  # that would begin there, without force
    phase: Int[Array, ""]


def in_scene(outline: SpaceOutline, base: Placement) -> SpaceOutline:
    """The outline of a whisker whose mount is placed in the scene."""
    rotation = base.rotation
    position = base.position + jnp.sum(rotation * outline.position[:, None, :], axis=-1)
    return SpaceOutline(position, jnp.sum(rotation[:, :, None] * outline.rotation[:, None], axis=2))


def distances_of(surface: AbstractSurface, position: Float[Array, "points 3"]) -> Float[Array, " points"]:
    """Distances of points from the surface."""
    return jax.vmap(surface.ball_before)(position)[0]


class CentreLine(NamedTuple):
    """The centre line of a whisker between points from base to tip."""

    position: Float[Array, "points 3"]
    tangent: Float[Array, "points 3"]
    spacing: Float[Array, "*intervals"]  # arc length between neighbouring points; one number if all are the same

    def interval(self, place: Float[Array, ""]) -> tuple[Cubic, Float[Array, ""]]:
        """The interval with a place, which is counted in intervals from the base, and where in it the place is."""
        k = jnp.clip(jnp.floor(place).astype(int), 0, self.position.shape[0] - 2)
        spacing = self.spacing[k] if self.spacing.ndim else self.spacing
        ends = self.position[k], self.position[k + 1]
        return Cubic(*ends, *(spacing * self.tangent[j] for j in (k, k + 1))), place - k


def nearest_place(surface: AbstractSurface, line: CentreLine) -> Float[Array, ""]:
    """The place on a line, in intervals from the base, that is nearest to the object."""
    intervals = line.position.shape[0] - 1

    def off(place):
        cubic, t = line.interval(place)
        return surface.ball_before(cubic.value(t))[0]

    def finer(_, found):
        middle, width, _, _ = found
        places = jnp.clip(middle + width * np.linspace(-1.0, 1.0, FINER + 1), 0.0, intervals)
        distances = jax.vmap(off)(places)
        return places[jnp.argmin(distances)], 2 * width / FINER, places, distances

    first, unknown = jnp.argmin(distances_of(surface, line.position)).astype(float), jnp.zeros(FINER + 1)
    # A loop, because users wait for what is compiled.
    _, width, places, distances = jax.lax.fori_loop(0, ROUNDS, finer, (first, jnp.ones(()), unknown, unknown))
    # A parabola through the least distance and its neighbours.
    k = jnp.clip(jnp.argmin(distances), 1, FINER - 1)
    before, here, after = distances[k - 1], distances[k], distances[k + 1]
    bend = before - 2 * here + after
    shift = jnp.where(bend > 0, (before - after) / (2 * jnp.where(bend > 0, bend, 1.0)), 0.0)
    place = jnp.clip(places[k] + jnp.clip(shift, -1.0, 1.0) * width, 0.0, intervals)
    return jnp.where(off(place) <= jnp.min(distances), place, places[jnp.argmin(distances)])


def nearest(surface: AbstractSurface, outline: SpaceOutline, length: Scalar, *, rolls: bool) -> Nearest:
    """The point of a whisker, placed in the scene, that is nearest to the surface.

    `rolls` tells whether the roll of its contact is an unknown.
    """
    spacing = jnp.asarray(length) / INTERVALS
    line = CentreLine(outline.position, outline.rotation[:, :, 2], spacing)
    place = nearest_place(surface, line)
    cubic, t = line.interval(place)
    point, tangent = cubic.value(t), cubic.rate(t)
    tangent = tangent / jnp.sqrt(jnp.sum(tangent**2))
    tip = place >= INTERVALS - TIP
    distance, out = surface.ball_before(point)
    beyond = jnp.where(tip, 0.0, (INTERVALS - place) * spacing)
    side = outline.rotation[jnp.round(place).astype(int), :, 0]
    return Nearest(
        distance,
        contact_at(point - distance * out, out, tangent, side if rolls else None, beyond),
        jnp.where(tip, Phase.tip, Phase.tangential),
    )


TIP = 1e-5  # intervals from the tip: nearer points are the tip


def contact_at(
    point: Float[Array, "3"],
    out: Float[Array, "3"],
    tangent: Float[Array, "3"],
    side: Float[Array, "3"] | None,
    beyond: Scalar,
) -> Contact:
    """The contact, without force, of a whisker with this tangent and first director at a point of the surface.

    Without a director, the roll is zero. `beyond` is the arc length from the contact to the tip, which touches itself
    if it is zero.
    """
    sine = jnp.clip(jnp.sum(tangent * out), -1.0, 1.0)
    ahead = tangent - sine * out
    size = jnp.sqrt(jnp.sum(ahead**2))
    # If the whisker points straight at the surface, any direction along it will do.
    other = jnp.cross(out, jnp.where(jnp.abs(out[0]) < 0.5, jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.0, 0.0])))
    ahead = jnp.where(size > 1e-9, ahead / jnp.where(size > 1e-9, size, 1.0), other / jnp.sqrt(jnp.sum(other**2)))
    roll = jnp.zeros(())
    if side is not None:
        across = jnp.cross(out, ahead)
        roll = jnp.arctan2(jnp.sum(side * across), jnp.sum(side * jnp.cross(across, tangent)))
    slack = jnp.where(beyond > 0, beyond, jnp.arcsin(sine))
    return jnp.concatenate([jnp.stack([jnp.zeros(()), roll, slack]), point, ahead, jnp.zeros(2)])
