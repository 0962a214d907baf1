"""The equations of a time step: what they do along the step is the change of energy; loads, modes and unknowns."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.motion_state import Ledger, Moving, Rod, angles_of, nodes_of
from jaxwhisker._dynamics.moving import Damping, system_of
from jaxwhisker._dynamics.time_step import (
    ContactMode,
    Imposed,
    StepUnknowns,
    TimeStep,
    _mode,
    every,
    load_at,
    load_of,
    residual,
    spring_rows,
    unknowns_at,
    unknowns_of,
)

N, H = 3, 0.07
EXACT = 1e-10
ROD = jw.Whisker(1.0, 1.0, 0.4, mass_per_length=1.0, tip_mass=0.2, base_mass=0.3, base_inertia=0.1)
SUPPORT = jw.Support((jw.Spring((0, 1), 70.0, 0.2), jw.Spring((1, 2), 40.0, 0.3)))
RNG = np.random.default_rng(0)
Q, BASE, DRIVE = RNG.normal(size=(2, 2, N)), RNG.normal(size=(2, 2, 3)), RNG.normal(size=(2, 3))
VELOCITY, SPIN = RNG.normal(size=(2, 2, N + 6)), RNG.normal(size=2)
NOTHING = Imposed(jnp.zeros(2, bool), jnp.zeros(2, bool))
FREE = ContactMode(jnp.zeros(2, bool), jnp.zeros(2, int), NOTHING)


@eqx.filter_jit
def made(sensor, damping):
    return system_of(sensor, damping, N)


@pytest.fixture(scope="module")
def system():
    """Two whiskers on springs."""
    none = jnp.zeros(())
    sensor = jw.Sensor(ROD, SUPPORT)
    return made(jax.tree.map(checks.as_float, sensor), Damping(none, none, (none + 0.6, none, none)))


def moving(system, q, base, velocity, spin, z):
    angle = angles_of(system, q, base)
    rod = Rod(q, base, angle, nodes_of(system, base, angle), velocity, spin, None)
    ledger = Ledger(*[jnp.zeros(())] * 5)
    return Moving(rod, z, jnp.asarray(DRIVE[0]), jnp.zeros((2, 2 * N + 2)), ledger, jnp.asarray(True))


def energy(system, moving):
    """Kinetic and elastic energy of the rods."""
    rods, rod = system.rods, moving.rod
    kinetic = jnp.sum(rods.mass[:, None] * rod.velocity**2) + jnp.sum(rods.inertia * rod.spin**2)
    return (kinetic + jnp.einsum("wi,wij,wj->", rod.q, rods.stiffness, rod.q)) / 2


@pytest.mark.parametrize(("air", "material"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.02)])
def test_residuals_and_reactions_do_the_work_of_the_change_of_energy(system, air, material):
    @jax.jit
    def both(air, material):
        own = eqx.tree_at(lambda s: (s.mass_damping, s.stiffness_damping), system, (air, material))
        z = jnp.array([0.3, 0.4])
        old = moving(own, jnp.asarray(Q[0]), jnp.asarray(BASE[0]), jnp.asarray(VELOCITY), jnp.asarray(SPIN), z)
        x, drive = StepUnknowns(jnp.asarray(Q[1]), jnp.zeros((2, 0)), jnp.array([0.1, 0.7])), jnp.asarray(DRIVE[1])
        rows, trial = every(TimeStep(own, old, drive, H), FREE, x)
        base = own.bases(x.z, drive)
        at = nodes_of(own, base, trial.angle)
        velocity = 2 * (at - old.rod.at) / H - old.rod.velocity
        spin = 2 * (base[:, 2] - old.rod.base[:, 2]) / H - old.rod.spin
        new = moving(own, x.q, base, velocity, spin, x.z)
        lost = air / H * jnp.sum(own.rods.mass[:, None] * (at - old.rod.at) ** 2)
        bent = x.q - old.rod.q
        lost += material / H * jnp.einsum("wi,wij,wj->", bent, own.rods.stiffness, bent)
        work = jnp.sum(rows.bending * bent) + jnp.sum(rows.reaction * (base - old.rod.base))
        return work, energy(own, new) - energy(own, old) + lost, lost

    work, change, lost = both(air, material)
    assert work == pytest.approx(float(change), rel=EXACT)
    assert abs(change) > 1 and (lost > 0) == (air + material > 0)


def test_springs_are_in_balance_where_their_loads_move_them(system):
    @jax.jit
    def rows(z, load, rate):
        old = moving(
            system, jnp.asarray(Q[0]), jnp.asarray(BASE[0]), jnp.asarray(VELOCITY), jnp.asarray(SPIN), z - H * rate / 2
        )
        return spring_rows(TimeStep(system, old, jnp.asarray(DRIVE[1]), H), z + H * rate / 2, load)

    z, rate = np.array([0.25, 0.6]), np.array([0.4, -0.3])
    strain = z - [0.2, 0.5]
    load = np.array([70 * strain[0] - 40 * (strain[1] - strain[0]), 40 * (strain[1] - strain[0])]) + 0.6 * rate
    np.testing.assert_allclose(rows(jnp.asarray(z), jnp.asarray(load), jnp.asarray(rate)), 0, atol=1e-12)


def test_loads_on_bases_are_opposite_to_reactions_in_the_frame_of_the_drive():
    reaction, angle = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), 0.3
    turned = -np.exp(-1j * angle) * (reaction[:, 0] + 1j * reaction[:, 1])
    every_one = np.stack([turned.real, turned.imag, -reaction[:, 2]], axis=1).ravel()
    load = load_at(jnp.asarray(reaction), jnp.full(2, angle), (0, 2, 4))
    np.testing.assert_allclose(load, every_one[[0, 2, 4]], atol=1e-14)


def test_unknowns_are_found_again_in_one_array(system):
    x = StepUnknowns(jnp.asarray(Q[0]), jnp.zeros((2, 0)), jnp.array([0.3, 0.4]))
    old = moving(system, x.q, jnp.asarray(BASE[0]), jnp.asarray(VELOCITY), jnp.asarray(SPIN), x.z)
    assert eqx.tree_equal(unknowns_of(system, x.flat()), x)
    assert eqx.tree_equal(unknowns_at(old, system), x)
    step = TimeStep(system, old, jnp.asarray(DRIVE[1]), H)

    @jax.jit
    def both():
        rows, _ = every(step, FREE, x)
        return residual(step, FREE, x.flat()), rows.bending, spring_rows(step, x.z, load_of(step, rows.reaction))

    whole, bending, springs = both()
    np.testing.assert_allclose(whole, np.concatenate([bending.ravel(), springs]), atol=EXACT)


def test_contacts_touch_and_slip_by_the_signs_of_gaps_forces_and_slips(system):
    none = jnp.zeros((), bool)
    rough = eqx.tree_at(lambda s: s.friction, system, 0.5, is_leaf=lambda leaf: leaf is None)

    def mode(force, gap, drag=0.0, slipped=0.0, free=False, held=False, system=rough):
        found = _mode(system, jnp.array([0.5, 0.0, force, drag]), gap, slipped, Imposed(none | free, none | held))
        return bool(found.touches), int(found.slip), bool(found.sticks)

    assert mode(1.0, 0.0) == (True, 0, True)
    assert mode(0.0, 0.1)[0] is False and mode(-1.0, 0.0)[0] is False and mode(-1.0, -2.0)[0] is True
    assert mode(1.0, 0.0, drag=-0.4, slipped=0.2) == (True, 1, False)  # slips along +t against friction
    assert mode(1.0, 0.0, drag=0.4, slipped=-0.2) == (True, -1, False)
    assert mode(1.0, 0.0, drag=-0.4, slipped=0.05) == (True, 0, True)
    assert mode(1.0, 0.0, drag=-0.4, slipped=0.2, held=True) == (True, 0, False)
    assert mode(0.0, -1e-3, free=True)[0] is False and mode(0.0, -1e-2, free=True)[0] is True
    assert mode(1.0, 0.0, slipped=9.0, system=system) == (True, 0, True)
