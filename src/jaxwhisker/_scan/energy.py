"""The elastic energy stored in whiskers and springs.

Along the loaded part of a uniform straight whisker, with unit tangent t and the force F = (-fx, -fy) of the object on
it, EI kappa' = F x t. Therefore EI kappa^2 / 2 + F . t is constant; at the base, t = t0 and EI kappa = -mz. Since
t = dr/ds, the integral of F . t is F . (r1 - r0), and the energy of the whisker is

    U = (mz^2 / (2 EI) + F . t0) s1 - F . (r1 - r0),    r0 the base, r1 the contact point, s1 the contact arc.

For other whiskers, and for those that may have several contacts, EI (kappa - kappa0)^2 / 2 = M^2 / (2 EI) is integrated
along the shape.

Springs store 1/2 F . C F, with the flexibility matrix C of the support and the loads F on the bases in the drive's
frame. If springs hold the shafts, the energies of all springs follow from their lengths, and those of whiskers and
foundations are integrated between the springs.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.motion import Translation
from jaxwhisker._model.network import Flexibility
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.spring import POINTS, WEIGHTS
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.contacts import has_several, of_whisker, past_contacts
from jaxwhisker._scan.springs import at_arcs, bases_of, held, holds, shaft_energy, spring_length, suspension
from jaxwhisker._scan.state import State, base_of, state_of

INTERVALS = 4  # of Gaussian quadrature along a whisker that is not uniform; breaks are further ends


@in_double
def stored_energy(scene: Scene, state: State, control: Control | None = None) -> Float[Array, "*steps"]:
    """Elastic energy of whiskers and springs; zero where all whiskers are free.

    Between snaps, no energy E is lost: it is exchanged with the drive and with a moving object. A drive that moves
    along x does the work dE = sum(fx) du; on other motions, forces and moments of the drive do work. A moving object
    does the work of the contact forces, dE = -sum(fx) dx - sum(fy) dy. At a snap, the drop in E is lost. With friction,
    contacts that slip turn some of the work into heat.

    Whiskers with a weight also have its potential energy, which is zero at the origin.

    Springs that strain each other at rest store a constant energy. That of a loop of base springs whose rest lengths do
    not add up is not included; that of springs on shafts is.

    Args:
        scene: the scanned scene.
        state: the Result of its scan, or the states `before` or `after` its events; NaN gives NaN.
        control: drive positions of these states, shape (steps,). Default: those of the Result. They are needed for
            springs on shafts and gravity only.

    Returns:
        Energy, force times length, shape (steps,): one value per step or event.

    Raises:
        ValueError: if an argument has the wrong type, or if springs hold the shafts or whiskers have a weight and
            `control` is missing.
    """
    checks.instance("scene", scene, Scene, "a Scene")
    checks.instance("state", state, State, "a Result or a State")
    control = getattr(state, "control", None) if control is None else control
    if holds(scene) is None:
        control = None
    elif control is None:
        checks.fail("control", "given for states of a scene with springs on shafts or gravity", "None")
    return _energy_now(jax.tree.map(checks.as_float, scene), state_of(state), control)


def _energy(scene: Scene, state: State, control: Control | None) -> Float[Array, "*steps"]:
    if control is not None:
        held = partial(_held_energy, scene)
        return (jax.vmap(held) if state.base_x.ndim > 1 else held)(state, jnp.asarray(control, dtype=float))
    energy = jnp.zeros(())
    for k, whisker in enumerate(scene.whiskers):
        energy += _whisker_energy(whisker, of_whisker(state, k))
    flexibility = scene.support.flexibility()
    load = _loads(scene, state, flexibility)
    # Elementwise, because jax 0.10.2 computes large batches of small matrix products incorrectly.
    strain = jnp.sum(flexibility.matrix * load[..., None, :], axis=-1)
    return energy + jnp.sum(load * strain, axis=-1) / 2


def _held_energy(scene: Scene, state: State, control: Scalar) -> Float[Array, ""]:
    """Energy of one state of a scene with springs on shafts."""
    by = holds(scene)
    assert by is not None
    energy = jnp.zeros(())
    every, _ = held(by, scene.whiskers, control, state.shaft_loads)
    for k, (whisker, own) in enumerate(zip(scene.whiskers, every, strict=True)):
        at = jax.tree.map(lambda leaf, k=k: leaf[k], state)
        arc = jnp.where(at.phase == Phase.free, whisker.length, at.contact_arc)
        energy += shaft_energy(whisker, base_of(at), (at.fx, at.fy, at.mz), arc, own)
    lengths = spring_length(suspension(scene), bases_of(scene, state), control)
    return energy + sum(spring.energy(lengths[k]) for k, spring in enumerate(scene.support.springs))


def _loads(scene: Scene, state: State, flexibility: Flexibility) -> Float[Array, "*steps rows"]:
    """Loads on the bases in the drive's frame, in the order of the flexibility's rows."""
    turned, n = jnp.asarray(0.0), scene.support.whiskers
    if not isinstance(scene.motion, Translation):
        # The angle of the drive is that of the base minus those of its mount and of its torsion springs.
        turned = state.base_angle - jnp.array([mount.angle for mount in scene.support.mounts], dtype=float)
        if flexibility.offset.size > n:
            yields, rest = jnp.reshape(flexibility.matrix, (n, 3, n, 3))[:, 2, :, 2], flexibility.offset[2::3]
            turned += jnp.sum(yields * state.mz[..., None, :], axis=-1) - rest
    cos, sin = jnp.cos(turned), jnp.sin(turned)
    across = -state.fx * cos - state.fy * sin
    if flexibility.offset.size == n:
        return across
    load = jnp.stack([across, state.fx * sin - state.fy * cos, -state.mz], axis=-1)
    return jnp.reshape(load, (*load.shape[:-2], 3 * n))


def _whisker_energy(whisker: Whisker, state: State) -> Float[Array, "*steps"]:
    """Energy of one whisker."""
    if has_several(state):
        energy = partial(_energy_past_contacts, whisker)
        for _ in range(state.base_x.ndim):
            energy = jax.vmap(energy)
        return energy(state)
    if whisker.uniform:
        along = state.fx * jnp.sin(state.base_angle) - state.fy * jnp.cos(state.base_angle)
        density = state.mz**2 / (2 * whisker.base_stiffness) + along
        way_x, way_y = state.contact_x - state.base_x, state.contact_y - state.base_y
        return density * state.contact_arc + state.fx * way_x + state.fy * way_y

    def integral(state: State):
        arc = state.contact_arc
        ends = arc * jnp.linspace(0.0, 1.0, INTERVALS + 1)
        if whisker.breaks is not None:
            ends = jnp.sort(jnp.append(ends, jnp.clip(whisker.breaks, 0.0, arc)))
        s = jnp.ravel(ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS)
        reaction = state.fx, state.fy, state.mz
        x, y = at_arcs(whisker, base_of(state), reaction, s)
        moment = (x - state.contact_x) * state.fy - (y - state.contact_y) * state.fx
        density = _density(whisker, moment, s)
        return jnp.sum(jnp.ravel(jnp.diff(ends)[:, None] * WEIGHTS) * density)

    for _ in range(state.base_x.ndim):
        integral = jax.vmap(integral)
    return integral(state)


def _energy_past_contacts(whisker: Whisker, state: State) -> Float[Array, ""]:
    """Energy of one whisker that may have several contacts, in one state."""
    stretches = jnp.append(0.0, state.contact_arc[::-1])  # places that are not used are at the base
    ends = stretches[:-1, None] + jnp.diff(stretches)[:, None] * jnp.linspace(0.0, 1.0, INTERVALS + 1)
    ends = jnp.append(jnp.ravel(ends[:, :-1]), state.contact_arc[0])
    if whisker.breaks is not None:
        ends = jnp.sort(jnp.append(ends, jnp.clip(whisker.breaks, 0.0, state.contact_arc[0])))
    s = jnp.ravel(ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS)
    _, moment = past_contacts(whisker, state, s)
    return jnp.sum(jnp.ravel(jnp.diff(ends)[:, None] * WEIGHTS) * _density(whisker, moment, s))


def _density(whisker: Whisker, moment: Float[Array, " points"], s: Float[Array, " points"]) -> Float[Array, " points"]:
    """Energy per arc length; a pointed tip has no stiffness and carries no moment."""
    stiffness = jax.vmap(whisker.stiffness_at)(s)
    return jnp.where(stiffness > 0, moment**2 / (2 * jnp.where(stiffness > 0, stiffness, 1.0)), 0.0)


_energy_now = Program(_energy)
