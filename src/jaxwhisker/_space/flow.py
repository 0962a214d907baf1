"""What follows from a loss of stability: contacts slide over the surface at fixed drive until they come to rest.

The sliding is overdamped: a force along the surface, proportional to the speed of the material point that touches, holds
each contact back. Only the order in which places are passed depends on the factor, not the equilibria, and the energy
falls all the way. Time steps are implicit (backward Euler) and grow until the contacts are at rest. A whisker whose
contact force vanishes on the way comes free; it stays free if its unloaded shape clears the object.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import block_diagonal, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import scale_of
from jaxwhisker._space.contact import FORCE, POINT, SLACK, UNKNOWNS, frame_of
from jaxwhisker._space.newton import Phases, linearise
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each

FIRST_TIME = 1e-3  # dimensionless: a contact with the stiffness 1 moves by a thousandth of its way
LONGEST_TIME = 1e8
SHORTEST_TIME = 1e-12
STRIDE = 0.08  # lengths that a contact may move in a step
TOLERANCE = 1e-9
NEWTON_STEPS = 10
STEPS = 400
REST = 1e-9  # motion in a step of the longest time


class Flow(NamedTuple):
    """Sliding contacts at a time."""

    z: Contacts
    drag: Float[Array, "whiskers 2"]  # force along the surface: towards the tip, and across
    phase: Phases
    time: Scalar  # length of the next time step
    steps: Int[Array, ""]
    rests: Bool[Array, ""]
    failed: Bool[Array, ""]

    @property
    def moves(self) -> Bool[Array, ""]:
        """Whether the flow goes on."""
        return ~self.rests & ~self.failed


def phase_of(z: Contacts, phase: Phases) -> Phases:
    """Phases of touching whiskers by the signs of their slacks."""
    touching = jnp.where(z[:, SLACK] > 0, int(Phase.tangential), int(Phase.tip))
    return jnp.where(phase == Phase.free, phase, touching)


def flow_from(problem: SpaceProblem, u: Scalar, z: Contacts, phase: Phases, flows: Bool[Array, ""]) -> Flow:
    """Let contacts slide until they are at rest; elements of a batch that do not flow stay as they are."""
    start = Flow(
        z,
        jnp.zeros((phase.size, 2)),
        phase_of(z, phase),
        jnp.asarray(FIRST_TIME),
        jnp.asarray(0),
        ~flows,
        jnp.asarray(False),
    )
    return jax.lax.while_loop(lambda now: now.moves, lambda now: _advance(problem, u, now), start)


def _advance(problem: SpaceProblem, u: Scalar, now: Flow) -> Flow:
    z, drag, solved = _implicit_step(problem, u, now)
    moved = jnp.max(jnp.abs(z[:, POINT] - now.z[:, POINT]))
    moved = jnp.where(jnp.isfinite(moved), moved, jnp.inf)
    good = solved & (moved < STRIDE)
    released = (z[:, FORCE] < 0) & (now.phase != Phase.free)
    phase = jnp.where(released, int(Phase.free), phase_of(z, now.phase))
    free = jnp.all(phase == Phase.free)
    rests = good & ((moved < REST) & (now.time >= LONGEST_TIME / 4) | free)
    time = jnp.where(good, jnp.minimum(now.time * jnp.where(moved < STRIDE / 3, 3.0, 1.0), LONGEST_TIME), now.time / 4)
    steps = now.steps + 1
    return Flow(
        jnp.where(good, z, now.z),
        jnp.where(good & ~released[:, None], drag, jnp.where(released[:, None], 0.0, now.drag)),
        jnp.where(good, phase, now.phase),
        time,
        steps,
        rests,
        ((time < SHORTEST_TIME) | (steps >= STEPS)) & ~rests,
    )


def _implicit_step(problem: SpaceProblem, u: Scalar, now: Flow) -> tuple[Contacts, Float[Array, "whiskers 2"], Bool[Array, ""]]:
    """Contacts and forces along the surface after a time step, and whether they are solved for."""

    def iterate(carry):
        z, drag, _, count = carry
        dz, dg = _newton_step(problem, u, now, z, drag)
        size = jnp.maximum(jnp.max(jnp.abs(dz) / scale_of(z)), jnp.max(jnp.abs(dg) / (1 + jnp.abs(drag))))
        # A step through the kink between the phases may overshoot.
        share = jnp.minimum(1.0, 0.3 / jnp.maximum(size, 1e-30))
        return z + share * dz, drag + share * dg, size, count + 1

    def goes_on(carry):
        _, _, size, count = carry
        return (size > TOLERANCE) & (count < NEWTON_STEPS)

    start = now.z, now.drag, jnp.asarray(jnp.inf), jnp.asarray(0)
    z, drag, size, _ = jax.lax.while_loop(goes_on, iterate, start)
    return z, drag, size <= TOLERANCE


def _newton_step(problem: SpaceProblem, u: Scalar, before: Flow, z: Contacts, drag: Float[Array, "whiskers 2"]):
    n, rows = before.phase.size, problem.rows
    phase = phase_of(z, before.phase)
    drives = jax.jvp(problem.drive, (u,), (jnp.ones_like(u),))
    touching = (before.phase != Phase.free)[:, None]
    block = touching[:, :, None]

    def one(body, z, phase, drag, z_before, force):
        # Without any force, its direction is unknown.
        at = linearise(problem, body, drives, z, phase, drag)
        held, held_by = _drag_equations(problem, z + at.correction, phase, drag, z_before, before.time, rows)
        return at, held, held_by

    at, held, held_by = of_each(problem, one, z, phase, drag, before.z, z[:, FORCE])
    residual, pose_by = at.pose, at.pose_by
    # The last two columns are the forces along the surface.
    system = jnp.concatenate([jnp.where(block, pose_by, np.eye(rows, rows + 2)), jnp.where(block, held_by, np.eye(2, rows + 2, rows))], axis=1)
    matrix = block_diagonal(system)
    residual = jnp.where(touching, jnp.concatenate([residual, held], axis=1), 0.0)
    if problem.springs is not None:
        load, load_by = jnp.where(touching, at.load, 0.0), jnp.where(block, at.load_by, 0.0)
        moved = problem.springs.offset + problem.displacement(load)
        residual = residual.at[:, :rows].add(-jnp.where(touching, moved, 0.0))
        yields = jnp.reshape(problem.springs.matrix, (n, rows, n, rows))
        yields = jnp.sum(yields[..., None] * load_by[None, None], axis=3)
        yields = jnp.where(touching[:, :, None, None], yields, 0.0)
        whole = jnp.zeros((n, rows + 2, n, rows + 2)).at[:, :rows].set(yields)
        matrix -= jnp.reshape(whole, matrix.shape)
    steps = jnp.reshape(solve(matrix, -jnp.ravel(residual)[:, None])[:, 0], (n, 1, rows + 2))
    directions = jnp.where(block, at.directions, 0.0)
    dz = jnp.sum(directions * steps[:, :, :rows], axis=-1) + jnp.where(touching, at.correction, 0.0)
    return dz, jnp.where(touching, steps[:, 0, rows:], 0.0)


def _drag_equations(problem: SpaceProblem, z, phase, drag, z_before, time, rows):
    """Residuals of time * force = -displacement along the surface, and their derivatives by the steps."""
    ahead, across, _ = frame_of(problem.surface, z).T
    chord = z[POINT] - z_before[POINT]
    along, beside = jnp.sum(chord * ahead), jnp.sum(chord * across)
    slid = along + jnp.maximum(z[SLACK], 0.0) - jnp.maximum(z_before[SLACK], 0.0)
    tangential = (phase == Phase.tangential).astype(float)
    zero, one = jnp.zeros(()), jnp.ones(())
    heads = [zero] * (rows - 4)
    first = jnp.stack([*heads, tangential, one, zero, beside, time, zero])
    second = jnp.stack([*heads, zero, zero, one, -along, zero, time])
    return jnp.stack([time * drag[0] + slid, time * drag[1] + beside]), jnp.stack([first, second])
