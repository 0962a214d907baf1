"""The elastic energy stored in whiskers and springs.

Along the loaded part of a whisker, t being its unit tangent and F = (-fx, -fy) the force of the object on it,
EI kappa' = F x t, so that EI kappa^2 / 2 + F . t is the same everywhere: at the base, where t = (0, 1), it is
mz^2 / (2 EI) - fy. What is left of the integral of EI kappa^2 / 2 is that of F . t = F . dr/ds, which is a difference:

    U = (mz^2 / (2 EI) - fy) s1 + fx (xi - x0) + fy eta,    (xi, eta) the contact point, s1 the contact arc.

Of curved whiskers, and where EI changes, EI (kappa - kappa0)^2 / 2 = M^2 / (2 EI) is integrated along the shape.

Springs hold 1/2 F_x . C F_x, C the flexibility matrix of the support and F_x = -fx the forces on the bases.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker.result import State
from jaxwhisker.scene import Scene
from jaxwhisker.shape import outwards
from jaxwhisker.whisker import Whisker


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
    fields = {name: jnp.asarray(getattr(state, name)) for name in State.__dataclass_fields__}
    state, whiskers = State(**fields), scene.whiskers
    bent = [_bent(whisker, jax.tree.map(lambda leaf, k=k: leaf[..., k], state)) for k, whisker in enumerate(whiskers)]
    energy = sum(bent[1:], bent[0])
    flexibility = scene.support.flexibility()
    if flexibility is None:
        return energy
    # Elementwise: jax 0.10.2 gets large batches of small matrix products wrong.
    strain = jnp.sum(flexibility.matrix * state.fx[..., None, :], axis=-1)
    return energy + jnp.sum(state.fx * strain, axis=-1) / 2


INTERVALS = 64  # of Simpson's rule along a whisker that is not uniform; its error falls with their fourth power


def _bent(whisker: Whisker, state: State) -> Float[Array, "*steps"]:
    """The energy of one bent whisker."""
    if whisker.uniform:
        density = state.mz**2 / (2 * whisker.base_stiffness) - state.fy
        along = state.fx * (state.contact_x - state.base_x) + state.fy * state.contact_y
        return density * state.contact_arc + along

    def integral(state: State):
        x, y, _, _ = outwards(
            whisker, state.base_x, state.fx, state.fy, state.mz, state.contact_arc, count=INTERVALS + 1
        )
        moment = (x - state.contact_x) * state.fy - (y - state.contact_y) * state.fx
        s = state.contact_arc * np.linspace(0.0, 1.0, INTERVALS + 1)
        stiffness = jax.vmap(whisker.stiffness_at)(s)
        density = jnp.where(stiffness > 0, moment**2 / (2 * jnp.where(stiffness > 0, stiffness, 1.0)), 0.0)
        weights = np.ones(INTERVALS + 1)
        weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
        return jnp.sum(density * weights) * state.contact_arc / (3 * INTERVALS)

    for _ in range(state.base_x.ndim):
        integral = jax.vmap(integral)
    return integral(state)
