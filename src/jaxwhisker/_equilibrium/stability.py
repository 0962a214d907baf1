"""Stability of an equilibrium: of each whisker on its clamped branch, and of the network that holds the bases.

The clamped branch of a whisker consists of its states with a clamped base, for all positions of the base along x. It is
stable up to its fold, where the base would have to move back. The network is stable while its stiffness exceeds the
slopes of the loads: K - D is positive definite, with D = d load / d pose. With friction, D is the slope for the present
slips and not symmetric; the network is then stable while all eigenvalues have a positive real part, for overdamped
bases whose mobility is their compliance. A disturbance that makes contacts stick is never worse.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import eigenvalues_are_positive, positive_definite, times_block_diagonal
from jaxwhisker._equilibrium.newton import Condensed
from jaxwhisker._equilibrium.point import Mode
from jaxwhisker._equilibrium.problem import PerWhisker, Problem

# Sign of `by_x` on a stable branch for an approach from the right; the branch has the direction grad turn x grad y.
BRANCH_SIGN = -1.0


def load_slopes(problem: Problem, mode: Mode, at: Condensed) -> Float[Array, "whiskers axes axes"]:
    """Slope d load / d pose of a whisker's base; symmetric without friction."""
    by_x = jnp.where(at.by_x == 0, 1.0, at.by_x)[:, None]
    along = at.load_by[:, :, 0] / by_x
    columns = [along]
    columns += [at.load_by[:, :, k] - along * at.pose_by[:, :1, k] for k in range(1, at.load.shape[-1])]
    return jnp.where(problem.solved(mode.phase)[:, None, None], jnp.stack(columns, axis=-1), 0.0)


def network_is_stable(problem: Problem, slope: Float[Array, "whiskers axes axes"]) -> Bool[Array, ""]:
    """Whether the stiffness of the network minus the load slopes is positive definite.

    With the flexibility L L^T, this is a test of 1 - L^T slope L, which is valid for rigid springs too.
    """
    if problem.flexibility is None:
        return jnp.asarray(True)
    root = problem.flexibility.root
    pull = jnp.sum(root[:, :, None] * times_block_diagonal(root.T, slope).T[:, None, :], axis=0)
    symmetric = problem.friction_angle is None or problem.axes == 1
    positive = positive_definite if symmetric else eigenvalues_are_positive
    return positive(jnp.eye(root.shape[0]) - pull)


def on_stable_branch(problem: Problem, mode: Mode, by_x: PerWhisker) -> Bool[Array, " whiskers"]:
    """Whether whiskers are on the stable part of their clamped branch.

    There the base moves along the branch in the same direction as just after first touch; between two folds it moves
    back.
    """
    return problem.bends_from(mode.phase, mode.side) * by_x * BRANCH_SIGN > 0


def is_stable(
    problem: Problem, mode: Mode, at: Condensed, begins: Bool[Array, " whiskers"] | None = None
) -> Bool[Array, ""]:
    """Whether every whisker is on the stable part of its clamped branch and the network is stable.

    Args:
        problem: the problem.
        mode: the mode of the state.
        at: the linearised whiskers.
        begins: whiskers that are linearised as the contacts that they are about to begin, and are not judged.
    """
    unknown = ~problem.solved(mode.phase)
    unknown = unknown if begins is None else unknown | begins
    own = jnp.all(unknown | on_stable_branch(problem, mode, at.by_x))
    if problem.flexibility is None:
        return own
    slopes = load_slopes(problem, mode, at)
    slopes = slopes if begins is None else jnp.where(begins[:, None, None], 0.0, slopes)
    return own & network_is_stable(problem, slopes)
