"""Newton's method for whiskers in space with several contacts, on their network of springs.

The unknowns are the contacts of all whiskers, one after the other, and the control. Every whisker is linearised with
respect to its own contacts; the network couples the loads and poses of the bases.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point
from jaxwhisker._equilibrium.solver import StructuredNewton
from jaxwhisker._model.drives import Placement
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._space.contact import POINT, SLACK, TRACTION, UNKNOWNS, InDrive, SpaceWhisker, in_drive, on_surface
from jaxwhisker._space.newton import LARGEST_NOISE, ROUNDED
from jaxwhisker._space.problem import SpaceProblem, of_each
from jaxwhisker._space_chain.contacts import ChainAtBase, PhaseRows, Rows, at_rest, base_of_chain, last_used

POSE = 6  # equations of a segment that end it at the next contact, or at the base
PhasesOfRows = Int[Array, "*batch rows"]


class MotionOfChain(NamedTuple):
    """How contacts slide after a loss of stability, from the start of a time step on."""

    start: Float[Array, "*contacts 11"]
    time: Scalar
    flows: Bool[Array, ""]  # whether they slide; otherwise there is no traction


class ChainInSpace(NamedTuple):
    """The equations of one whisker."""

    own: Rows  # residuals; those of the pose of the last contact are the coordinates of its base
    load: Float[Array, "6"]  # on the base, in the frame of the drive
    at: ChainAtBase
    inside: InDrive


def of_whiskers(problem: SpaceProblem, tree):
    """Contacts of all whiskers one after the other, as arrays (whiskers, contacts, ...)."""
    shape = problem.length.shape[0], problem.contacts
    return jax.tree.map(lambda leaf: jnp.reshape(leaf, (*shape, *leaf.shape[1:])), tree)


def outermost(problem: SpaceProblem) -> np.ndarray:
    """Rows of the contacts that are nearest to the tips."""
    return np.arange(problem.length.size * problem.contacts) % problem.contacts == 0


def phases_in_flow(z: Rows, phase: PhaseRows) -> PhaseRows:
    """Phases of one whisker's contacts while they slide: the outermost one changes with the sign of its slack."""
    by_slack = jnp.where(z[0, SLACK] > 0, int(Phase.tangential), int(Phase.tip))
    return phase.at[0].set(jnp.where(phase[0] == Phase.free, phase[0], by_slack))


def displaced(frame: Array, z: Array, phase: Array, start: Array) -> Float[Array, "2"]:
    """How far the material point at a contact has moved over the surface, along the whisker and across."""
    ahead, across, _ = frame.T
    moved = z[POINT] - start[POINT]
    beyond = jnp.where(phase == Phase.tangential, z[SLACK], 0.0) - jnp.maximum(start[SLACK], 0.0)
    return jnp.stack([jnp.sum(moved * ahead) + beyond, jnp.sum(moved * across)])


def equations(
    problem: SpaceProblem,
    body: SpaceWhisker,
    drive: Placement,
    z: Rows,
    phase: PhaseRows,
    motion: MotionOfChain | None = None,
    rates: AbstractRod | None = None,
) -> ChainInSpace:
    """The equations of one whisker with these contacts; without a motion, there are no tractions."""
    surface, touches = problem.surface, phase != Phase.free
    unused = at_rest(surface, drive.position + jnp.sum(drive.rotation * body.mount.position, axis=1))
    at = base_of_chain(body, surface, problem.rod, z, phase, unused, rates)
    inside = in_drive(at.base, drive, body.mount, jnp.zeros(()))
    meets = jnp.where(last_used(touches)[:, None], inside.pose, at.meets)
    on = jax.vmap(lambda z: on_surface(surface, z))(jnp.where(touches[:, None], z, unused))
    law = z[:, TRACTION]
    if motion is not None:
        slid = jax.vmap(displaced)(at.chain.frame, z, phase, motion.start)
        law = jnp.where(motion.flows, slid + motion.time * law, law)
    return ChainInSpace(jnp.concatenate([meets, on, law], axis=1), inside.load, at, inside)


class ChainNewtonStep(NamedTuple):
    """A Newton step, the tangent of the path from the same linear system, and what it is made of."""

    step: Point
    tangent: Point  # condition . tangent = 1
    residual: Scalar  # largest residual of any equation, before the step
    own_by: Float[Array, "whiskers contacts 6 rows 11"]  # derivatives of the poses by all contacts, springs included
    pose: Float[Array, "whiskers 6"]  # of the bases, before the step
    tangent_pose: Float[Array, "whiskers 6"]
    sound: Bool[Array, ""]  # whether whiskers run the right way at their contacts and bases


def newton_step(
    problem: SpaceProblem, phase: PhasesOfRows, condition: PathCondition, motion: MotionOfChain, point: Point
) -> ChainNewtonStep:
    """Solve the linearised equations of all whiskers, the network and the condition."""
    n, k = problem.length.shape[0], problem.contacts
    rows = n * k
    z, each, start = of_whiskers(problem, (point.z, phase, motion.start))
    each = jnp.where(motion.flows, jax.vmap(phases_in_flow)(z, each), each)
    drive, rate = jax.jvp(problem.drive, (point.u,), (jnp.ones_like(point.u),))

    def linearised(body, z, phase, start):
        def values(flat):
            here = equations(problem, body, drive, jnp.reshape(flat, z.shape), phase, motion._replace(start=start))
            return (here.own, here.load), here

        by, here = jax.jacfwd(values, has_aux=True)(jnp.ravel(z))

        def by_drive(drive):
            inside = in_drive(here.at.base, drive, body.mount, jnp.zeros(()))
            return inside.pose, inside.load

        return here, *by, *jax.jvp(by_drive, (drive,), (rate,))[1]

    here, own_by, load_by, pose_by_u, load_by_u = of_each(problem, linearised, z, each, start)
    touches = each != Phase.free
    last, touching = jax.vmap(last_used)(touches), touches[:, 0]
    load, load_by, load_by_u = (
        jnp.where(touching.reshape(n, *[1] * (part.ndim - 1)), part, 0.0) for part in (here.load, load_by, load_by_u)
    )
    wanted, moved, flexible = jnp.zeros((n, POSE)), pose_by_u, None
    block = np.eye(n)[:, None, None, :, None] * own_by[:, :, :, None, :]  # (whiskers, contacts, 11, whiskers, 11 k)
    if problem.springs is not None:
        wanted = problem.springs.offset + problem.displacement(load)
        moved = pose_by_u - problem.displacement(load_by_u)
        flexible = jnp.reshape(problem.springs.matrix, (n, POSE, n, POSE))
        yields = jnp.sum(flexible[:, :, :, :, None] * load_by[None, None], axis=3)
        block = block.at[:, :, :POSE].add(-jnp.where(last[:, :, None, None, None], yields[:, None], 0.0))
    residual = here.own.at[:, :, :POSE].add(-jnp.where(last[:, :, None], wanted[:, None], 0.0))
    by_u = jnp.zeros_like(residual).at[:, :, :POSE].set(jnp.where(last[:, :, None], moved[:, None], 0.0))
    used, size = touches[:, :, None], rows * UNKNOWNS
    residual, by_u = jnp.where(used, residual, 0.0), jnp.where(used, by_u, 0.0)
    identity = np.reshape(np.eye(size), block.shape)
    block = jnp.where(used[:, :, :, None, None], block, identity)
    system = jnp.block([
        [jnp.reshape(block, (size, size)), jnp.reshape(by_u, (size, 1))],
        [jnp.reshape(condition.weight_z, (1, size)), jnp.reshape(condition.weight_u, (1, 1))],
    ])  # fmt: skip
    right = jnp.append(jnp.ravel(residual), condition.residual(point, jnp.zeros(rows)))
    solution = solve(system, jnp.stack([-right, jnp.asarray(np.eye(size + 1)[-1])], axis=1))
    step, tangent = (Point(jnp.reshape(column[:-1], (rows, UNKNOWNS)), column[-1]) for column in solution.T)
    turned = jnp.reshape(tangent.z, (n, -1))
    tangent_pose = jnp.zeros_like(wanted)
    if problem.springs is not None:
        tangent_pose = problem.displacement(jnp.sum(load_by * turned[:, None], axis=2) + load_by_u * tangent.u)
    inside = z[:, :, SLACK] < problem.length[:, None]
    good = here.inside.upright & ~here.at.backwards & jnp.all(inside | ~touches, axis=1)
    return ChainNewtonStep(
        step,
        tangent,
        jnp.max(jnp.abs(right)),
        jnp.reshape(block[:, :, :POSE], (n, k, POSE, rows, UNKNOWNS)),
        wanted,
        tangent_pose,
        jnp.all(good | ~touching),
    )


class ChainSolutionInSpace(NamedTuple):
    """A solved point; `newton` is a linearisation at most one step before that point."""

    point: Point
    newton: ChainNewtonStep
    converged: Bool[Array, "*batch"]


def solve_points(
    problem: SpaceProblem, phase: PhasesOfRows, condition: PathCondition, motion: MotionOfChain, guess: Point
) -> ChainSolutionInSpace:
    """Solve the equations of a point, or of several points along a leading axis in one loop. Failure is a flag."""
    steps = jax.vmap(newton_step, (None, 0, 0, 0, 0)) if jnp.ndim(guess.u) > 0 else newton_step

    def residual(point, args):
        problem, phase, condition, motion = args
        at = steps(problem, phase, condition, motion, point)
        return at.residual, at

    tolerance = problem.rod.newton_tolerance
    solution = optx.root_find(
        residual,
        StructuredNewton(0.0, tolerance, with_residuals=True),
        guess,
        args=jax.lax.stop_gradient((problem, phase, condition, motion)),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    point = solution.value
    finite = jnp.all(jnp.isfinite(point.z), axis=(-2, -1)) & jnp.isfinite(point.u)
    # A light force on a nearly straight whisker is known only to the rounding of positions over its deflection squared.
    size = solution.state.step_size
    converged = (size < tolerance) | ((solution.aux.residual < ROUNDED) & (size < LARGEST_NOISE))
    return ChainSolutionInSpace(point, solution.aux, converged & finite & solution.aux.sound)


def plain(z: RowsOfContacts) -> MotionOfChain:
    """The motion of contacts without tractions."""
    return MotionOfChain(z, jnp.zeros(z.shape[:-2]), jnp.zeros(z.shape[:-2], bool))


def residuals(
    problem: SpaceProblem, z: RowsOfContacts, u: Scalar, phase: PhasesOfRows, unused: RowsOfContacts
) -> tuple[RowsOfContacts, Float[Array, "whiskers 6"], ChainInSpace]:
    """Residuals of all equations without tractions, coordinates of the bases, and what they are made of.

    They can be differentiated by everything that they depend on. `unused` are the values of places that are not used.
    """
    drive, rates = problem.drive(u), problem.rod.for_rates()
    each_z, each = of_whiskers(problem, (z, phase))
    here = of_each(problem, lambda body, z, phase: equations(problem, body, drive, z, phase, rates=rates), each_z, each)
    touches = each != Phase.free
    last, touching = jax.vmap(last_used)(touches), touches[:, :1]
    load, wanted = jnp.where(touching, here.load, 0.0), jnp.zeros_like(here.load)
    if problem.springs is not None:
        wanted = problem.springs.offset + problem.displacement(load)
    wrong = jnp.where(here.inside.upright & ~here.at.backwards, 0.0, jnp.inf)[:, None]
    missing = wanted + jax.lax.stop_gradient(wrong)
    own = here.own.at[:, :, :POSE].add(-jnp.where(last[:, :, None], missing[:, None], 0.0))
    own = jnp.reshape(own, z.shape)
    pose = jnp.where(touching, here.inside.pose, wanted)
    return jnp.where((phase != Phase.free)[:, None], own, z - unused), pose, here._replace(load=load)
