"""Stance: which contacts may begin in space, and whether those that exist are stable and as the equations assume."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import determinant, positive_definite, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._model.drives import Placement
from jaxwhisker._rod.elastica import Shooting
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._space.contact import FORCE, LIGHT, POINT, TRACTION, UNKNOWNS, frame_of
from jaxwhisker._space.free import Nearest, in_scene
from jaxwhisker._space.linear import directions_of
from jaxwhisker._space.problem import SpaceProblem, of_each
from jaxwhisker._space.stance import FLAT, base_placement
from jaxwhisker._space_chain.contacts import SegmentsInSpace, at_rest, chain_of
from jaxwhisker._space_chain.gaps import gaps_of
from jaxwhisker._space_chain.newton import POSE, ChainNewtonStep, PhasesOfRows, of_whiskers
from jaxwhisker._space_chain.shaft import WholeShaftInSpace, shaft_of

MORE_STEPS = 1.5  # steps of a shaft that is looked at, relative to those of the equations


class ChainStanceInSpace(NamedTuple):
    """What the march asks about a point of the path, besides its equations."""

    candidates: Nearest  # contacts that may begin; fields (whiskers, candidates, ...)
    distance: Float[Array, " whiskers"]  # from the nearest object
    outside: Bool[Array, ""]  # whether no base is inside an object
    opens: Bool[Array, ""]  # whether object and shaft part on both sides of every contact
    speed: Scalar  # largest speed of any point of a whisker whose base does not yield, per control
    stable: Bool[Array, ""]
    stiffness: Scalar  # the determinant of the sliding stiffness: vanishes where stability is lost
    sound: Bool[Array, ""]  # whether whiskers run the right way at their contacts and bases


def steps_of(problem: SpaceProblem) -> int:
    """Number of steps of each segment of a shaft that is looked at."""
    assert isinstance(problem.rod, Shooting)
    one = problem.section[0] if isinstance(problem.section, tuple) else problem.section
    assert isinstance(one, SpaceSection)
    return int(np.ceil(MORE_STEPS * problem.rod.steps)) * (1 if one.uniform else 2)


def chains_of(problem: SpaceProblem, u: Scalar, z: RowsOfContacts, phase: PhasesOfRows) -> SegmentsInSpace:
    """The segments of all whiskers; fields (whiskers, ...)."""
    drive = problem.drive(u)

    def one(body, z, phase):
        unused = at_rest(problem.surface, drive.position + jnp.sum(drive.rotation * body.mount.position, axis=1))
        return chain_of(body, problem.surface, z, phase, unused)

    return of_each(problem, one, *of_whiskers(problem, (z, phase)))


def bases_of(problem: SpaceProblem, u: Scalar, pose: Float[Array, "whiskers 6"]) -> Placement:
    """Where bases with these coordinates are; fields (whiskers, ...)."""
    drive = problem.drive(u)
    return of_each(problem, lambda body, pose: base_placement(problem, drive, body.mount, pose), pose)


def shafts_of(
    problem: SpaceProblem, u: Scalar, pose: Float[Array, "whiskers 6"], z: RowsOfContacts, phase: PhasesOfRows
) -> WholeShaftInSpace:
    """The shafts of all whiskers; fields (whiskers, ...)."""
    own = chains_of(problem, u, z, phase), of_whiskers(problem, phase), bases_of(problem, u, pose)
    steps = steps_of(problem)
    return of_each(problem, lambda body, *own: shaft_of(body, steps, *own), *own)


def stance_of(problem: SpaceProblem, point: Point, phase: PhasesOfRows, newton: ChainNewtonStep) -> ChainStanceInSpace:
    """The stance at a point of the path, near which whiskers are linearised."""
    shafts = shafts_of(problem, point.u, newton.pose, point.z, phase)
    gaps = of_each(problem, lambda body, shaft: gaps_of(problem.surface, shaft), shafts)
    parts = spreads(problem, point.z, phase, shafts)

    def bases(u):
        return bases_of(problem, u, jnp.zeros_like(newton.pose))

    def fastest(body, rate, outline):
        del body
        return jnp.max(jnp.sum(in_scene(outline, rate).position ** 2, axis=-1))

    rate = jax.jvp(bases, (point.u,), (jnp.ones_like(point.u),))[1]
    sliding = sliding_stiffness(problem, point.z, phase, newton)
    return ChainStanceInSpace(
        candidates=gaps.candidates,
        distance=gaps.distance,
        outside=jnp.all(gaps.base > 0),
        opens=jnp.all(parts > -FLAT),
        speed=jnp.sqrt(jnp.max(of_each(problem, fastest, rate, problem.outline))),
        stable=positive_definite(sliding),
        stiffness=determinant(sliding),
        sound=newton.sound,
    )


def spreads(
    problem: SpaceProblem, z: RowsOfContacts, phase: PhasesOfRows, shafts: WholeShaftInSpace
) -> Float[Array, " rows"]:
    """How fast whisker and surface part on both sides of a tangential contact, a curvature; infinite for other ones."""

    def one(z, phase, tangent, bend):
        out = problem.surface.normal(z[POINT])
        curved = jnp.sum(tangent * jnp.sum(problem.surface.curvature(z[POINT]) * tangent, axis=1))
        return jnp.where(phase == Phase.tangential, jnp.sum(out * bend) + curved, jnp.inf)

    at_contacts = (jnp.reshape(leaf[:, 1:, 0], (-1, 3)) for leaf in (shafts.tangent, shafts.bend))
    return jax.vmap(one)(z, phase, *at_contacts)


def sliding_stiffness(
    problem: SpaceProblem, z: RowsOfContacts, phase: PhasesOfRows, newton: ChainNewtonStep
) -> Float[Array, "n n"]:
    """Forces along the surface per displacement along it, two rows for each contact; see sliding.py of space.

    Light contacts slide freely: rods are nearly rigid along their axes there. For them it is the identity, and so it is
    for places that are not used.
    """
    surface, rows = problem.surface, phase.size
    free = phase == Phase.free
    light = ~free & (z[:, FORCE] < LIGHT)

    def ways(z):
        unit = np.eye(UNKNOWNS)[TRACTION]
        own = directions_of(z, frame_of(surface, z), surface.curvature(z[POINT]), rolls=True)
        return jnp.stack([*own, *unit], axis=1)

    # Force, roll, slack, along, across, turn, and two tractions.
    directions = jax.vmap(ways)(z)
    by = jnp.reshape(newton.own_by, (rows, POSE, rows, UNKNOWNS))
    by = jnp.sum(by[..., None] * directions[None, None], axis=3)
    columns = jnp.transpose(by, (2, 0, 1, 3)).reshape(rows, rows * POSE, -1)
    # Where the material point of a contact stays, a contact on the shaft may still roll along the surface.
    rolls = jnp.where((phase == Phase.tangential)[:, None], columns[:, :, 3], 0.0)
    held = columns.at[:, :, 2].add(-rolls)[:, :, np.array([0, 1, 2, 5, 6, 7])]
    passive = jnp.where(light[:, None, None], columns[:, :, :POSE], held)
    still, fixed = jnp.repeat(free, POSE), jnp.repeat(free | light, 2)
    system = jnp.transpose(passive, (1, 0, 2)).reshape(rows * POSE, rows * POSE)
    system = jnp.where(still[:, None] | still[None, :], jnp.eye(rows * POSE), system)
    active = jnp.transpose(columns[:, :, 3:5], (1, 0, 2)).reshape(rows * POSE, 2 * rows)
    moved = -solve(system, jnp.where(still[:, None] | fixed[None, :], 0.0, active))
    forces = jnp.reshape(moved, (rows, POSE, 2 * rows))[:, -2:].reshape(2 * rows, 2 * rows)
    return jnp.where(fixed[:, None] | fixed[None, :], jnp.eye(2 * rows), forces)
