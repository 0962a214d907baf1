"""Stiffness against sliding: whether contacts that may slide over the surface are stable.

Hold the contacts of all whiskers where they are on the surface, and move them along it. The forces along the surface
that are needed, per displacement, are the sliding stiffness. A displacement is one of the material point of the whisker
that touches: at a tip, that of the contact point; at a tangential contact, that without what the contact moves along the
shaft. The equilibrium is stable if this matrix is positive definite: it is the second variation of the energy in which
everything but the contacts is at its minimum, and the minimum exists as long as the whole is stable.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.linear_algebra import block_diagonal, solve
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import FORCE
from jaxwhisker._space.newton import Linear, Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem

LIGHT = 1e-4  # EI/L^2: contacts with smaller forces are stable, and their rods nearly rigid along their axes


def passive_columns(derivatives: Float[Array, "whiskers rows steps"], phase: Phases) -> Array:
    """Derivatives with respect to steps in which the contacts do not slide, forces along the surface included."""
    n = derivatives.shape[1]
    # Steps: force, (roll,) slack, along, across, turn; then the two forces along the surface.
    slack, along = derivatives[:, :, n - 4], derivatives[:, :, n - 3]
    rolling = jnp.where((phase == Phase.tangential)[:, None], slack - along, slack)
    return jnp.concatenate(
        [derivatives[:, :, : n - 4], rolling[:, :, None], derivatives[:, :, n - 1 :]], axis=2
    )


def sliding_stiffness(problem: SpaceProblem, z: Contacts, phase: Phases, at: Linear) -> Float[Array, "rows rows"]:
    """Forces along the surface per displacement along it, two rows for each whisker; the identity for free ones.

    `at` are all whiskers, linearised with forces along the surface.
    """
    n, rows = at.pose.shape
    held = (phase == Phase.free) | (z[:, FORCE] < LIGHT)

    def of(derivatives):
        passive = passive_columns(derivatives, phase)
        return block_diagonal(passive), derivatives[:, :, rows - 3 : rows - 1]

    system, active = of(at.pose_by)
    active = _blocks(active)
    if problem.springs is not None:
        load, load_active = of(at.load_by)
        matrix = problem.springs.matrix
        system -= jnp.sum(matrix[:, :, None] * load, axis=1)
        active -= jnp.sum(matrix[:, :, None] * _blocks(load_active), axis=1)
    still = jnp.repeat(held, rows)
    system = jnp.where(still[:, None], jnp.eye(n * rows), jnp.where(still[None, :], 0.0, system))
    active = jnp.where(still[:, None], 0.0, active)
    moved = -solve(system, active)
    forces = jnp.reshape(moved, (n, rows, 2 * n))[:, -2:].reshape(2 * n, 2 * n)
    fixed = jnp.repeat(held, 2)
    return jnp.where(fixed[:, None] | fixed[None, :], jnp.eye(2 * n), forces)


def _blocks(parts: Float[Array, "whiskers rows two"]) -> Float[Array, "all some"]:
    n, rows, two = parts.shape
    return jnp.reshape(jnp.eye(n)[:, None, :, None] * parts[:, :, None, :], (n * rows, n * two))
