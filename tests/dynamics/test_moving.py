"""Dimensionless systems of moving whiskers against closed forms, in any unit."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.moving import Damping, drive_pose, free_coordinates, motion_units, system_of

N = 4
EXACT = 1e-12
LENGTH, STIFFNESS, DENSITY = 0.05, 2.4e-5, 3e-4  # m, N m^2, kg/m: those of a large whisker
FORCE, MOMENT = STIFFNESS / LENGTH**2, STIFFNESS / LENGTH
TIME = LENGTH**2 * np.sqrt(DENSITY / STIFFNESS)
TURN = 0.4  # of the second mount
DAMPING = np.array([0.3, 0.7, 0.2])  # of bases, dimensionless


def sensor(length=1.0, stiffness=1.0, density=1.0):
    """Two whiskers on springs along x and y and about the bases; the second one is shorter, stiffer and heavier."""
    force, moment = stiffness / length**2, stiffness / length
    first = jw.Whisker(length, stiffness, mass_per_length=density, tip_mass=0.2 * density * length)
    second = jw.Whisker(
        0.8 * length,
        3.0 * stiffness,
        0.5 / length,
        mass_per_length=2 * density,
        base_mass=0.4 * density * length,
        base_inertia=0.1 * density * length**3,
    )
    springs = [
        jw.Spring((0, 1), 70.0 * force / length, 0.2 * length),
        jw.Spring((1, 2), 40.0 * force / length, 0.3 * length),
        jw.Spring((0, 2), 50.0 * force / length, -0.1 * length, axis="y"),
        jw.Spring((0, 2), 5.0 * moment, 0.05, axis="phi"),
    ]
    mounts = jw.Mount(), jw.Mount(0.1 * length, 0.02 * length, TURN)
    return jw.Sensor((first, second), jw.Support(tuple(springs), mount=mounts))


@eqx.filter_jit
def made(scene, damping):
    return system_of(scene, damping, N)


def damping(mass=1.0, stiffness=1.0, force=1.0, moment=1.0, speed=1.0, spin=1.0):
    base = tuple(jnp.asarray(d) for d in DAMPING * [force / speed, force / speed, moment / spin])
    return Damping(jnp.asarray(0.6 * mass), jnp.asarray(0.02 * stiffness), base)


def system():
    return made(jax.tree.map(checks.as_float, sensor()), damping())


def test_masses_and_stiffness_of_uniform_whiskers():
    rods, points = system().rods, basis(N).points
    np.testing.assert_allclose(rods.length, [1.0, 0.8], rtol=EXACT)
    for k, (own, stiffness, base, along, tip) in enumerate([(1.0, 1.0, 0.0, 1.0, 0.2), (0.8, 3.0, 0.4, 1.6, 0.0)]):
        # Legendre polynomials have the squared norm 1 / (2 k + 1).
        expected = np.diag(stiffness / own / (2 * np.arange(N) + 1))
        np.testing.assert_allclose(rods.stiffness[k], expected, atol=EXACT)
        np.testing.assert_allclose([rods.mass[k, 0], rods.mass[k, -1]], [base, tip], atol=EXACT)
        np.testing.assert_allclose(rods.mass[k, 1:-1].sum(), along, rtol=EXACT)
        # A straight whisker that turns about its base: integrals of the mass times s and s^2.
        np.testing.assert_allclose(rods.first[k].sum(), along / 2 + tip, rtol=EXACT)
        np.testing.assert_allclose(rods.second[k].sum(), along / 3 + tip, rtol=EXACT)
    np.testing.assert_allclose(rods.inertia, [0.0, 0.1], atol=EXACT)
    np.testing.assert_allclose(rods.rest, [0 * points, 0.5 * 0.8 * points], atol=EXACT)
    assert rods.held is None


def test_springs_leave_coordinates_free_and_hold_the_bases_at_their_rest_lengths():
    own = system()
    assert own.free == free_coordinates(sensor().support) == (0, 3, 4, 5)  # x of base 1; x, y and angle of base 2
    assert own.is_free.tolist() == [[True, False, False], [True, True, True]]
    np.testing.assert_allclose(own.at_rest, [0.2, 0.5, -0.1, 0.05], atol=EXACT)
    strain = jnp.array([0.01, 0.03, -0.02, 0.1])
    # Springs in series along x; each of the others alone.
    expected = [70 * 0.01 - 40 * 0.02, 40 * 0.02, -50 * 0.02, 5 * 0.1]
    np.testing.assert_allclose(own.elastic(strain), expected, rtol=1e-10)
    np.testing.assert_allclose(own.strain(own.at_rest + strain), strain, atol=EXACT)
    assert own.network is not None
    np.testing.assert_allclose(own.network.compliance @ jnp.array(expected), strain, atol=EXACT)


def test_bases_are_damped_in_the_frames_of_their_mounts():
    own = system()
    assert own.network is not None
    turn = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
    expected = np.diag([DAMPING[0], 0.0, 0.0, DAMPING[2]])
    expected[1:3, 1:3] = turn @ np.diag(DAMPING[:2]) @ turn.T
    np.testing.assert_allclose(own.network.damping, expected, atol=EXACT)


def test_bases_turn_with_the_drive():
    own, drive, z = system(), np.array([0.7, -0.2, 0.3]), np.array([0.25, 0.4, 0.1, -0.2])
    d = np.array([[z[0], 0.0, 0.0], z[1:]])
    np.testing.assert_allclose(own.displacement(jnp.asarray(z)), d, atol=EXACT)
    at = d + np.array([[0.0, 0.0, 0.0], [0.1, 0.02, TURN]])
    turned = drive[0] + 1j * drive[1] + np.exp(0.3j) * (at[:, 0] + 1j * at[:, 1])
    expected = np.stack([turned.real, turned.imag, 0.3 + at[:, 2]], axis=1)
    np.testing.assert_allclose(
        jax.jit(lambda *at: own.bases(*at))(jnp.asarray(z), jnp.asarray(drive)), expected, atol=EXACT
    )


def test_the_same_sensor_in_other_units_is_the_same_system():
    scene = jax.tree.map(checks.as_float, sensor(LENGTH, STIFFNESS, DENSITY))
    unit = motion_units(scene)
    np.testing.assert_allclose([float(own) for own in unit], [LENGTH, FORCE, MOMENT, TIME])
    assert unit.energy == unit.moment
    si = damping(1 / TIME, TIME, FORCE, MOMENT, LENGTH / TIME, 1 / TIME)
    for one, other in zip(jax.tree.leaves(made(scene, si)), jax.tree.leaves(system()), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=EXACT)
    pose = drive_pose(jw.Motion(lambda u: (u, 2 * u, 3 * u), start=0.0, stop=1.0), 0.1, unit)
    np.testing.assert_allclose(pose, [0.1 / LENGTH, 0.2 / LENGTH, 0.3], rtol=EXACT)


def test_a_batch_with_a_failing_lane():
    stiffness = jnp.array([1.0, jnp.nan, 2.0])
    whisker = jax.vmap(lambda c: system_of(jw.Sensor(jw.Whisker(1.0, c, mass_per_length=1.0)), NONE, 2).rods.stiffness)
    own = jax.jit(whisker)(stiffness)
    assert np.isnan(own[1]).any() and np.isfinite(own[0]).all() and np.isfinite(own[2]).all()


NONE = Damping(jnp.zeros(()), jnp.zeros(()), (jnp.zeros(()),) * 3)
