"""Stance: where free whiskers stand, and whether contacts are as the equations assume."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._model.drives import Placement
from jaxwhisker._space.contact import base_of, in_drive, spread
from jaxwhisker._space.free import Nearest, in_scene, nearest
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import SpaceProblem, of_each


class Stance(NamedTuple):
    """What the march asks about a point of the path, besides its equations."""

    free: Bool[Array, " whiskers"]
    nearest: Nearest  # of free whiskers
    speed: Scalar  # largest speed of any point of a whisker whose base does not yield, per control
    sound: Bool[Array, ""]  # whether bases point the way of their mounts
    opens: Bool[Array, ""]  # whether object and shaft part on both sides of every tangential contact


def bases(problem: SpaceProblem, point: Point, phase: Phases):
    """Coordinates and loads of all bases, and whether they point the right way."""
    drive, rows = problem.drive(point.u), problem.rows

    def one(body, z, phase):
        base = base_of(body, problem.surface, problem.rod, z, phase, problem.rod)
        return in_drive(base, drive, body.mount, z[1])

    at = of_each(problem, one, point.z, phase)
    free = (phase == Phase.free)[:, None]
    load = jnp.where(free, 0.0, at.load)
    rest = jnp.zeros_like(at.pose)
    if problem.springs is not None:
        moved = problem.springs.offset + problem.displacement(load[:, :rows])
        rest = rest.at[:, :rows].set(moved)
    return jnp.where(free, rest, at.pose), load, at.upright | free[:, 0]


def stance_of(problem: SpaceProblem, point: Point, phase: Phases) -> Stance:
    """The stance at a point of the path."""
    pose, _, upright = bases(problem, point, phase)
    free = phase == Phase.free

    def placements(u):
        return of_each(problem, lambda body, pose: base_placement(problem, problem.drive(u), body.mount, pose), pose)

    placed, rate = jax.jvp(placements, (point.u,), (jnp.ones_like(point.u),))

    def near(body, placement, rate, outline):
        outline_now = in_scene(outline, placement)
        moving = in_scene(outline, rate)
        return nearest(problem.surface, outline_now, body.length, rolls=problem.rolls), jnp.max(jnp.sum(moving.position**2, axis=-1))

    found, speeds = of_each(problem, near, placed, rate, problem.outline)
    opens = of_each(problem, lambda body, z, phase: spread(body, problem.surface, z, phase), point.z, phase)
    return Stance(free, found, jnp.sqrt(jnp.max(speeds)), jnp.all(upright), jnp.all((opens > 0) | (phase != Phase.tangential)))


def base_placement(problem: SpaceProblem, drive: Placement, mount: Placement, pose) -> Placement:
    """Where a base with these coordinates is in the scene."""
    from jaxwhisker._base.rotation import rotation_matrix

    position = drive.position + jnp.sum(drive.rotation * (mount.position + pose[:3]), axis=1)
    rotation = drive.rotation
    if problem.rolls:
        rotation = jnp.sum(rotation[:, :, None] * rotation_matrix(pose[3:]), axis=1)
    return Placement(position, jnp.sum(rotation[:, :, None] * mount.rotation, axis=1))


def clearance(problem: SpaceProblem, u: Scalar) -> Scalar:
    """Least distance of the unloaded whiskers from the object at a control."""
    n = problem.length.size
    rest = jnp.zeros((n, 6))
    if problem.springs is not None:
        rest = rest.at[:, : problem.rows].set(problem.springs.offset)
    drive = problem.drive(u)

    def distance(body, pose, outline):
        placed = base_placement(problem, drive, body.mount, pose)
        return nearest(problem.surface, in_scene(outline, placed), body.length, rolls=problem.rolls).distance

    return jnp.min(of_each(problem, distance, rest, problem.outline))
