"""Stiffness against sliding: whether contacts that may slide over the surface are stable.

Hold the contacts of all whiskers where they are on the surface, and move them along it. The forces along the surface
that are needed, per displacement, are the sliding stiffness. A displacement is one of the material point of the whisker
that touches: at a tip, that of the contact point; at a tangential contact, that without what the contact moves along
the shaft. The equilibrium is stable if this matrix is positive definite: it is the second variation of the energy in
which everything but the contacts is at its minimum, and the minimum exists as long as the whole is stable.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.linear_algebra import block_diagonal, solve
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import FORCE, LIGHT
from jaxwhisker._space.linear import Linear
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem


def passive_columns(derivatives: Float[Array, "whiskers rows steps"], phase: Phases) -> Array:
    """Derivatives with respect to steps in which the contacts do not slide, forces along the surface included."""
    n = derivatives.shape[1]
    # Steps: force, (roll,) slack, along, across, turn; then the two forces along the surface.
    slack, along = derivatives[:, :, n - 4], derivatives[:, :, n - 3]
    rolling = jnp.where((phase == Phase.tangential)[:, None], slack - along, slack)
    return jnp.concatenate([derivatives[:, :, : n - 4], rolling[:, :, None], derivatives[:, :, n - 1 :]], axis=2)


def sliding_stiffness(problem: SpaceProblem, z: Contacts, phase: Phases, at: Linear) -> Float[Array, "rows rows"]:
    """Forces along the surface per displacement along it, two rows for each whisker; the identity for free ones.

    `at` are all whiskers, linearised with tractions. Contacts with hardly any force are stable, and their rods are
    nearly rigid along their axes: for these, it is the identity, too.
    """
    n, rows = at.pose.shape
    held = (phase == Phase.free) | (z[:, FORCE] < LIGHT)
    still, fixed = jnp.repeat(held, rows), jnp.repeat(held, 2)

    def of(derivatives):
        return block_diagonal(passive_columns(derivatives, phase)), block_diagonal(
            derivatives[:, :, rows - 3 : rows - 1]
        )

    system, active = of(at.pose_by)
    if problem.springs is not None:
        load, load_active = of(at.load_by)
        system -= jnp.sum(problem.springs.matrix[:, :, None] * load, axis=1)
        active -= jnp.sum(problem.springs.matrix[:, :, None] * load_active, axis=1)
    system = jnp.where(still[:, None], jnp.eye(n * rows), jnp.where(still[None, :], 0.0, system))
    moved = -solve(system, jnp.where(still[:, None], 0.0, active))
    forces = jnp.reshape(moved, (n, rows, 2 * n))[:, -2:].reshape(2 * n, 2 * n)
    return jnp.where(fixed[:, None] | fixed[None, :], jnp.eye(2 * n), forces)
