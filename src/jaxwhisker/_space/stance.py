"""Stance: where free whiskers stand, and whether contacts are stable and as the equations assume."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import determinant, positive_definite
from jaxwhisker._base.rotation import rotation_matrix
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._model.drives import Placement
from jaxwhisker._space.contact import POINT, spread
from jaxwhisker._space.free import INTERVALS, Nearest, distances_of, in_scene, nearest
from jaxwhisker._space.linear import Linear
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import SpaceProblem, of_each
from jaxwhisker._space.sliding import sliding_stiffness

SHALLOW = 5e-8  # lengths: dips of free whiskers of this depth may be missed
LONGEST_ADVANCE = 2e-4  # lengths by which whiskers may move before a flat object, although they might dip into it
FLAT = 1e-12  # curvatures that are rounding errors: a straight whisker lies on a flat object
STILL = 1e-12  # speeds that are rounding errors


class SpaceStance(NamedTuple):
    """What the march asks about a point of the path, besides its equations."""

    free: Bool[Array, " whiskers"]
    nearest: Nearest  # of free whiskers
    advance: Float[Array, " whiskers"]  # lengths by which a free whisker may move without missing the object
    speed: Scalar  # largest speed of any point of a whisker whose base does not yield, per control
    stable: Bool[Array, ""]  # not known with friction, where stability is lost if the drive turns
    stiffness: Scalar  # the determinant of the sliding stiffness: vanishes where stability is lost
    sound: Bool[Array, ""]  # whether bases point the way of their mounts
    grip: Float[Array, " whiskers"] | None  # margin to sticking or slipping, positive before; None without friction
    opens: Bool[Array, ""]  # whether shafts stay outside the object beside every contact


def stance_of(problem: SpaceProblem, point: Point, phase: Phases, at: Linear, grip: Array | None) -> SpaceStance:
    """The stance at a point of the path, near which whiskers are linearised with tractions."""
    free, z = phase == Phase.free, point.z
    if grip is None:
        sliding = sliding_stiffness(problem, z, phase, at)
        stiffness, stable = determinant(sliding), positive_definite(sliding)
    else:
        stiffness, stable = jnp.asarray(1.0), jnp.asarray(True)
    pose = jnp.zeros((phase.size, 6))
    if problem.springs is not None:
        moved = problem.springs.offset + problem.displacement(jnp.where(free[:, None], problem.on_free, at.load))
        pose = pose.at[:, : problem.rows].set(moved)

    def placements(u):
        drive = problem.drive(u)
        return of_each(problem, lambda body, pose: base_placement(problem, drive, body.mount, pose), pose)

    placed, rate = jax.jvp(placements, (point.u,), (jnp.ones_like(point.u),))

    def near(body, placement, rate, outline):
        found = nearest(problem.surface, in_scene(outline, placement), body.length, rolls=problem.rolls)
        # A chord of this length through the object is no deeper.
        bend = jnp.sqrt(jnp.sum(problem.surface.curvature(found.contact[POINT]) ** 2))
        chord = jnp.minimum(jnp.sqrt(8 * SHALLOW / jnp.maximum(bend, SHALLOW)), LONGEST_ADVANCE)
        advance = jnp.maximum(found.distance, 0.0) + chord
        return found, advance, jnp.max(jnp.sum(in_scene(outline, rate).position ** 2, axis=-1))

    found, advance, speeds = of_each(problem, near, placed, rate, problem.outline)
    opens = of_each(problem, lambda body, z, phase: spread(body, problem.surface, z, phase), z, phase)
    return SpaceStance(
        free=free,
        nearest=found,
        advance=advance,
        speed=jnp.sqrt(jnp.max(speeds)),
        stable=stable,
        stiffness=stiffness,
        sound=jnp.all(free | jnp.isfinite(at.own)),
        grip=grip,
        opens=jnp.all(free | (opens > -FLAT)),
    )


def bases_at_rest(problem: SpaceProblem, u: Scalar) -> Placement:
    """The placements of all bases at a control while no whisker is loaded; fields (whiskers, ...)."""
    rest = jnp.zeros((problem.length.size, 6))
    if problem.springs is not None:
        rest = rest.at[:, : problem.rows].set(problem.rest)
    drive = problem.drive(u)
    return of_each(problem, lambda body, pose: base_placement(problem, drive, body.mount, pose), rest)


def clearance(problem: SpaceProblem, u: Scalar) -> Float[Array, ""]:
    """A lower bound of the distance of the unloaded whiskers from the object at a control, which compiles faster."""

    def of_whisker(body, placement, outline):
        # No place is farther from these points than half of the interval between them.
        distances = distances_of(problem.surface, in_scene(outline, placement).position)
        return jnp.min(distances) - body.length / (2 * INTERVALS)

    return jnp.min(of_each(problem, of_whisker, bases_at_rest(problem, u), problem.outline))


def distance(problem: SpaceProblem, u: Scalar) -> Float[Array, ""]:
    """The distance of the unloaded whiskers from the object at a control, negative inside; to first order."""

    def of_whisker(body, placement, outline):
        return nearest(problem.surface, in_scene(outline, placement), body.length, rolls=problem.rolls).distance

    return jnp.min(of_each(problem, of_whisker, bases_at_rest(problem, u), problem.outline))


def leaves(problem: SpaceProblem, u: Scalar, way: Scalar) -> Bool[Array, ""]:
    """Whether every point of the unloaded whiskers moves away from all objects if the drive moves along a line.

    A plane between a point and an object from which the point moves away, or along which it moves, shows that it will
    not meet the object. `way` is the sign of the control's change.
    """

    def placements(u):
        return bases_at_rest(problem, u)

    placed, rate = jax.jvp(placements, (u,), (jnp.asarray(way, dtype=float),))

    def slowest(body, placement, rate, outline):
        del body
        position, velocity = in_scene(outline, placement).position, rate.position
        distances, normals = problem.surface.of_each(lambda one: jax.vmap(one.plane_before)(position))
        away = jnp.sum(normals * velocity, axis=-1)
        # Points inside a convex hull are before no plane. Those inside a convex object are known to be there.
        convex = all(one.is_convex for one in problem.surface.objects)
        return jnp.min(away if convex else jnp.where(distances > 0, away, -jnp.inf))

    return jnp.all(of_each(problem, slowest, placed, rate, problem.outline) > -STILL)


def base_placement(problem: SpaceProblem, drive: Placement, mount: Placement, pose: Float[Array, "6"]) -> Placement:
    """Where a base with these coordinates is in the scene, and its body frame."""
    position = drive.position + jnp.sum(drive.rotation * (mount.position + pose[:3]), axis=1)
    rotation = drive.rotation
    if problem.rolls:
        rotation = jnp.sum(rotation[:, :, None] * rotation_matrix(pose[3:]), axis=1)
    return Placement(position, jnp.sum(rotation[:, :, None] * mount.rotation, axis=1))
