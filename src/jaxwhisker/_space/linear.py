"""A whisker in space, linearised about a contact.

A contact on the surface has six degrees of freedom: force, roll and slack, two coordinates of the contact point, and
the direction in which the whisker runs along the surface. A straight round whisker has no roll. With a traction, there
are two more.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.drives import Placement
from jaxwhisker._space.contact import (
    AHEAD,
    POINT,
    ROLL,
    SLACK,
    TRACTION,
    UNKNOWNS,
    SpaceWhisker,
    Traction,
    base_of,
    frame_of,
    in_drive,
    on_surface,
)
from jaxwhisker._space.problem import SpaceProblem


class Linear(NamedTuple):
    """A whisker, linearised about a contact.

    There are `rows` equations of its base and as many `steps`, or with a traction two more.
    """

    correction: Float[Array, "11"]  # of the contact, back onto the surface
    directions: Float[Array, "11 steps"]
    pose: Float[Array, " rows"]  # coordinates of the base, after the correction
    load: Float[Array, " rows"]
    pose_by: Float[Array, "rows steps"]  # derivatives with respect to the steps
    load_by: Float[Array, "rows steps"]
    pose_by_u: Float[Array, " rows"]
    load_by_u: Float[Array, " rows"]
    own: Scalar  # largest residual of the surface; infinite beyond the base, or if the base points the wrong way
    frame: Float[Array, "3 3"]  # of the contact, as columns
    out_by: Float[Array, "3 steps"]  # derivatives of the normal


def step_along(z: Array, out: Array, curvature: Array, point: Array, turn: Array) -> Float[Array, "11"]:
    """The step of a contact by a step of its point and one of its direction, which turns with the surface besides."""
    turn = turn - jnp.sum(z[AHEAD] * jnp.sum(curvature * point, axis=1)) * out
    return jnp.concatenate([jnp.zeros(3), point, turn, jnp.zeros(2)])


def directions_of(z: Array, frame: Array, curvature: Array, *, rolls: bool) -> list[Array]:
    """Steps of a contact on the surface: force, (roll,) slack, the point along and across, and the direction."""
    ahead, across, out = frame.T
    still, unit = jnp.zeros(3), jnp.eye(UNKNOWNS)
    scalars = [unit[k] for k in range(3) if rolls or k != ROLL]
    ways = ((ahead, still), (across, still), (still, across))
    return [*scalars, *(step_along(z, out, curvature, point, turn) for point, turn in ways)]


def linearise(
    problem: SpaceProblem,
    body: SpaceWhisker,
    drives: tuple[Placement, Placement],
    z: Float[Array, "11"],
    phase: Int[Array, ""],
    traction: Traction | None,
) -> Linear:
    """Linearise one whisker; `drives` are the frame of the drive and its rate of change with the control."""
    surface, rows = problem.surface, problem.rows
    drive, rate = drives
    frame = frame_of(surface, z)
    out = frame[:, 2]
    off, lean, stretch = on_surface(surface, z)
    curvature = surface.curvature(z[POINT])

    def step_of(point, turn):
        return step_along(z, out, curvature, point, turn)

    tractions = [] if traction is None else list(np.eye(UNKNOWNS)[TRACTION])
    directions = jnp.stack([*directions_of(z, frame, curvature, rolls=problem.rolls), *tractions], axis=1)
    correction = step_of(-off * out, -lean * out - stretch * z[AHEAD])

    def based(z):
        return base_of(body, surface, problem.rod, z, phase, traction), z[ROLL]

    def in_rows(based, drive):
        inside = in_drive(based[0], drive, body.mount, based[1])
        return (inside.pose[:rows], inside.load[:rows]), inside.upright

    # Along the directions, the base moves, and along the control the drive: one program for both.
    ways = jnp.concatenate([directions, correction[:, None]], axis=1)
    at, at_by = jax.vmap(lambda way: jax.jvp(based, (z,), (way,)), in_axes=1, out_axes=(None, 0))(ways)
    moves = (
        jax.tree.map(lambda by: jnp.append(by, jnp.zeros_like(by[:1]), axis=0), at_by),
        jax.tree.map(lambda by: jnp.zeros((ways.shape[1] + 1, *by.shape)).at[-1].set(by), rate),
    )
    value, (pose_by, load_by), upright = jax.vmap(
        lambda at_by, rate: jax.jvp(in_rows, (at, drive), (at_by, rate), has_aux=True), out_axes=(None, -1, None)
    )(*moves)
    pose, load = (part + by[:, -2] for part, by in zip(value, (pose_by, load_by), strict=True))
    missed = jnp.max(jnp.abs(jnp.stack([off, lean, stretch])))
    return Linear(
        correction,
        directions,
        pose,
        load,
        pose_by[:, :-2],
        load_by[:, :-2],
        pose_by[:, -1],
        load_by[:, -1],
        jnp.where(upright & (z[SLACK] < body.length), missed, jnp.inf),
        frame,
        jnp.sum(curvature[:, :, None] * directions[None, POINT], axis=1),
    )
