"""The elastic energy stored in whiskers and springs.

Along the loaded part of a whisker, t being its unit tangent and F = (-fx, -fy) the force of the object on it,
EI kappa' = F x t, so that EI kappa^2 / 2 + F . t is the same everywhere: at the base, where t = (0, 1), it is
mz^2 / (2 EI) - fy. What is left of the integral of EI kappa^2 / 2 is that of F . t = F . dr/ds, which is a difference:

    U = (mz^2 / (2 EI) - fy) s1 + fx (xi - x0) + fy eta,    (xi, eta) the contact point, s1 the contact arc.

Springs hold 1/2 F_x . C F_x, C the flexibility matrix of the support and F_x = -fx the forces on the bases.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker.result import State
from jaxwhisker.scene import Scene


def stored_energy(scene: Scene, state: State) -> Float[Array, "*steps"]:
    """Elastic energy of whiskers and springs (force times length), zero where all whiskers are free.

    While the drive moves without a snap, energy is only exchanged with what moves: dE = sum(fx) du; an object that
    moves does the work of the contact forces, dE = -sum(fx) dx - sum(fy) dy. A snap loses what E drops by.

    Springs that strain each other at rest (a loop whose rest lengths do not add up) hold a constant besides, left out.

    Args:
        scene: what was scanned.
        state: the Result of its scan, or the states `before` or `after` its events; NaN gives NaN.

    Raises:
        ValueError: if an argument is not of that kind.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"`scene` must be a Scene, but is {scene!r}.")
    if not isinstance(state, State):
        raise ValueError(f"`state` must be a Result or a State, but is {state!r}.")
    stiffness = jnp.stack([jnp.asarray(w.bending_stiffness, dtype=float) for w in scene.whiskers])
    density = state.mz**2 / (2 * stiffness) - state.fy
    bent = density * state.contact_arc + state.fx * (state.contact_x - state.base_x) + state.fy * state.contact_y
    energy = jnp.sum(bent, axis=-1)
    flexibility = scene.support.flexibility()
    if flexibility is None:
        return energy
    # Elementwise: jax 0.10.2 gets large batches of small matrix products wrong.
    strain = jnp.sum(flexibility.matrix * state.fx[..., None, :], axis=-1)
    return energy + jnp.sum(state.fx * strain, axis=-1) / 2
