"""Stability of an equilibrium: of each whisker on its clamped branch, and of the network that holds the bases.

The clamped branch of a whisker consists of its states with a clamped base, for all positions of the base along x. It is
stable up to its fold, where the base would have to move back. The network is stable while its stiffness exceeds the
slopes of the loads: K - D is positive definite, with D = d load / d pose. With friction, D is the slope for the present
slips and not symmetric; the network is then stable while all eigenvalues have a positive real part, for overdamped
bases whose mobility is their compliance. A disturbance that makes contacts stick is never worse.

Springs between two shafts couple the whiskers with clamped bases, too. D is then a matrix of all bases, and the clamped
whiskers are stable up to their common fold.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import (
    block_diagonal,
    eigenvalues_are_positive,
    positive_definite,
    sign_of_determinant,
    solve,
    times_block_diagonal,
)
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import Condensed, load_rows
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker

# Sign of `by_x` on a stable branch for an approach from the right; the branch has the direction grad turn x grad y.
BRANCH_SIGN = -1.0

RIGID = 1e-9  # rate `by_x` that may be rounding

Slopes = Float[Array, "whiskers axes axes"] | Float[Array, "rows rows"]  # of each base, or of all bases coupled


def is_rigid(state: ContactState, by_x: PerWhisker) -> Bool[Array, " whiskers"]:
    """Whether whiskers are straight rods between their base and a tip that sticks, with hardly any force.

    Such a rod, which does not stretch, holds its base along its own line. It is stable, but rounding alone decides
    about the signs of its huge stiffness and of its rate along the branch.
    """
    return state.sticks & (jnp.abs(by_x) < RIGID)


def load_slopes(problem: Problem, state: ContactState, at: Condensed) -> Slopes:
    """Slopes d load / d pose of the bases; symmetric without friction."""
    loads, coupled = load_rows(problem, at), at.coupled
    if loads is not None and coupled is not None:
        size = at.pose.size
        loads_by_steps = -solve(loads.by_loads, loads.by_steps)

        def by_steps(own: Array, by_loads: Array) -> Array:
            through = jnp.reshape(by_loads, (size, -1))[:, :, None] * loads_by_steps
            return block_diagonal(own) + jnp.sum(through, axis=1)

        pose_by, load_by = by_steps(at.pose_by, coupled.pose_by_loads), by_steps(at.load_by, coupled.load_by_loads)
        return solve(pose_by.T, load_by.T).T
    by_x = jnp.where(at.by_x == 0, 1.0, at.by_x)[:, None]
    along = at.load_by[:, :, 0] / by_x
    columns = [along]
    columns += [at.load_by[:, :, k] - along * at.pose_by[:, :1, k] for k in range(1, at.load.shape[-1])]
    known = problem.solved(state.phase)
    if state.friction is not None:
        known &= ~is_rigid(state, at.by_x)
    return jnp.where(known[:, None, None], jnp.stack(columns, axis=-1), 0.0)


def network_is_stable(problem: Problem, slope: Slopes) -> Bool[Array, ""]:
    """Whether the stiffness of the network minus the load slopes is positive definite.

    With the flexibility L L^T, this is a test of 1 - L^T slope L, which is valid for rigid springs too.
    """
    root = problem.flexibility.root
    pull = jnp.sum(root[:, :, None] * times_block_diagonal(root.T, slope).T[:, None, :], axis=0)
    symmetric = problem.friction_angle is None or problem.axes == 1
    positive = positive_definite if symmetric else eigenvalues_are_positive
    return positive(jnp.eye(root.shape[0]) - pull)


def on_stable_branch(problem: Problem, state: ContactState, by_x: PerWhisker) -> Bool[Array, " whiskers"]:
    """Whether whiskers are on the stable part of their clamped branch.

    There the base moves along the branch in the same direction as just after first touch; between two folds it moves
    back.
    """
    holds = problem.bends_from(state.phase, state.side) * by_x * BRANCH_SIGN > 0
    return holds if state.friction is None else holds | is_rigid(state, by_x)


def clamped_is_stable(problem: Problem, state: ContactState, at: Condensed) -> Bool[Array, ""]:
    """Whether whiskers that springs between their shafts couple are stable while their bases are clamped.

    This is so up to the first point at which the linearised equations of contacts and loads are singular.
    """
    loads = load_rows(problem, at)
    assert loads is not None and at.coupled is not None
    by_loads = jnp.reshape(at.coupled.pose_by_loads, (at.pose.size, -1))
    system = jnp.block([[block_diagonal(at.pose_by), by_loads], [loads.by_steps, loads.by_loads]])
    sides = problem.bends_from(state.phase, state.side)
    return sign_of_determinant(system) * jnp.prod(sides * BRANCH_SIGN) > 0


def is_stable(
    problem: Problem, state: ContactState, at: Condensed, begins: Bool[Array, " whiskers"] | None = None
) -> Bool[Array, ""]:
    """Whether every whisker is on the stable part of its clamped branch and the network is stable.

    Args:
        problem: the problem.
        state: how the whiskers touch the object.
        at: the linearised whiskers.
        begins: whiskers that are linearised as the contacts that they are about to begin, and are not judged.
    """
    unknown = ~problem.solved(state.phase)
    unknown = unknown if begins is None else unknown | begins
    if at.coupled is not None:
        stable = clamped_is_stable(problem, state, at) & network_is_stable(problem, load_slopes(problem, state, at))
        return stable if begins is None else stable | jnp.any(begins)
    own = jnp.all(unknown | on_stable_branch(problem, state, at.by_x))
    slopes = load_slopes(problem, state, at)
    slopes = slopes if begins is None else jnp.where(begins[:, None, None], 0.0, slopes)
    return own & network_is_stable(problem, slopes)
