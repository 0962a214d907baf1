"""The elastic energy stored in whiskers and springs.

Along the loaded part of a whisker, t being its unit tangent and F = (-fx, -fy) the force of the object on it,
EI kappa' = F x t, so that EI kappa^2 / 2 + F . t is the same everywhere: at the base t = t0 and EI kappa = -mz. What is
left of the integral of EI kappa^2 / 2 is that of F . t = F . dr/ds, which is a difference:

    U = (mz^2 / (2 EI) + F . t0) s1 - F . (r1 - r0),    r0 the base, r1 the contact point, s1 the contact arc.

Of curved whiskers, and where EI changes, EI (kappa - kappa0)^2 / 2 = M^2 / (2 EI) is integrated along the shape.

Springs hold 1/2 F . C F, C the flexibility matrix of the support and F the loads on the bases in the drive's frame.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._model.motion import Translation
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.state import State, base_of, outwards


def stored_energy(scene: Scene, state: State) -> Float[Array, "*steps"]:
    """Elastic energy of whiskers and springs (force times length), zero where all whiskers are free.

    While the drive moves without a snap, energy is only exchanged with what moves: dE = sum(fx) du; an object that
    moves does the work of the contact forces, dE = -sum(fx) dx - sum(fy) dy. A snap loses what E drops by. (Along x:
    of another motion the work is that of forces and moments on the drive.)

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
    load = _loads(scene, state, flexibility)
    # Elementwise: jax 0.10.2 gets large batches of small matrix products wrong.
    strain = jnp.sum(flexibility.matrix * load[..., None, :], axis=-1)
    return energy + jnp.sum(load * strain, axis=-1) / 2


def _loads(scene: Scene, state: State, flexibility: Flexibility) -> Float[Array, "*steps rows"]:
    """Loads on the bases in the frame of the drive, as its flexibility takes them."""
    turned, n = jnp.asarray(0.0), scene.support.whiskers
    if not isinstance(scene.motion, Translation):
        # The base is turned like the drive, but for its mount and its torsion springs.
        turned = state.base_angle - jnp.stack([jnp.asarray(m.angle, dtype=float) for m in scene.support.mounts])
        if flexibility.offset.size > n:
            yields, rest = jnp.reshape(flexibility.matrix, (n, 3, n, 3))[:, 2, :, 2], flexibility.offset[2::3]
            turned += jnp.sum(yields * state.mz[..., None, :], axis=-1) - rest
    cos, sin = jnp.cos(turned), jnp.sin(turned)
    across = -state.fx * cos - state.fy * sin
    if flexibility.offset.size == n:
        return across
    load = jnp.stack([across, state.fx * sin - state.fy * cos, -state.mz], axis=-1)
    return jnp.reshape(load, (*load.shape[:-2], 3 * n))


INTERVALS = 64  # of Simpson's rule along a whisker that is not uniform; its error falls with their fourth power


def _bent(whisker: Whisker, state: State) -> Float[Array, "*steps"]:
    """The energy of one bent whisker."""
    if whisker.uniform:
        along = state.fx * jnp.sin(state.base_angle) - state.fy * jnp.cos(state.base_angle)
        density = state.mz**2 / (2 * whisker.base_stiffness) + along
        way_x, way_y = state.contact_x - state.base_x, state.contact_y - state.base_y
        return density * state.contact_arc + state.fx * way_x + state.fy * way_y

    def integral(state: State):
        x, y, _, _ = outwards(
            whisker, base_of(state), state.fx, state.fy, state.mz, state.contact_arc, count=INTERVALS + 1
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
