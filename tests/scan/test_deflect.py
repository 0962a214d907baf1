"""Deflection under given loads: the thesis's tables, balance, moments, several loads."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_bvp

import jaxwhisker as jw

PRINTED = 5.1e-5  # the tables have four decimals
EXACT = 1e-9

TIP_FOLLOWER = {  # A.1
    1: (0.8795, 0.4758, 0.9755),
    3: (0.5139, 2.9557, 2.4313),
    5: (-2.5163, 4.3207, 2.9396),
    7: (-5.9366, 3.7091, 2.7236),
    10: (-9.8894, 1.4833, 1.7224),
}
FOLLOWER_ALONG = {0.3: (0.9990, 0.0450, 0.2999), 0.5: (0.9922, 0.1246, 0.4992), 0.7: (0.9703, 0.2421, 0.6958)}  # A.2
TIP_DEAD = {1: 0.943567, 3: 2.2367, 5: 3.0619, 7: 3.6895, 10: 4.4500}  # A.3, which prints 0.9437 for F = 1
DEAD_ALONG = {0.3: 0.2998, 0.5: 0.4979, 0.7: 0.6893}  # A.4


@pytest.mark.parametrize("force", TIP_FOLLOWER)
def test_table_a1(force):
    d = jw.deflect(jw.Whisker(), jw.PointForce(force, position=1.0, follower=True))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], TIP_FOLLOWER[force], atol=PRINTED)


@pytest.mark.parametrize("position", FOLLOWER_ALONG)
def test_table_a2(position):
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0, position=position, follower=True))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], FOLLOWER_ALONG[position], atol=PRINTED)


@pytest.mark.parametrize("force", TIP_DEAD)
def test_table_a3(force):
    d = jw.deflect(jw.Whisker(), jw.PointForce(force))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], [force, 0.0, TIP_DEAD[force]], atol=PRINTED)


@pytest.mark.parametrize("position", DEAD_ALONG)
def test_table_a4(position):
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0, position=position))
    np.testing.assert_allclose([d.fx, d.fy, -d.mz], [1.0, 0.0, DEAD_ALONG[position]], atol=PRINTED)


def test_the_misprint_of_table_a3():
    d = jw.deflect(jw.Whisker(), jw.PointForce(1.0))
    assert abs(-d.mz - 0.943567) < 5.1e-7


def test_a_tip_moment_bends_an_arc():
    d = jw.deflect(jw.Whisker(), jw.PointMoment(0.8))
    np.testing.assert_allclose(d.curvature[:-1], 0.8, atol=EXACT)
    np.testing.assert_allclose(d.x, (np.cos(0.8 * d.s) - 1) / 0.8, atol=EXACT)
    np.testing.assert_allclose(d.y, np.sin(0.8 * d.s) / 0.8, atol=EXACT)
    np.testing.assert_allclose(d.angle, np.pi / 2 + 0.8 * d.s, atol=EXACT)
    assert abs(d.mz + 0.8) < EXACT
    assert abs(d.fx) < EXACT


def test_several_loads_balance():
    whisker = jw.Whisker(length=2.0, bending_stiffness=3.0)
    d = jw.deflect(whisker, jw.PointForce(1.0, 1.5, direction=2.5), jw.PointMoment(0.3, 1.0), jw.PointForce(2.0, 0.7))
    reordered = jw.deflect(
        whisker, jw.PointForce(2.0, 0.7), jw.PointForce(1.0, 1.5, direction=2.5), jw.PointMoment(0.3, 1.0)
    )
    at = {s: (np.interp(s, d.s, d.x), np.interp(s, d.s, d.y)) for s in (0.7, 1.5)}
    forces = {0.7: (-2.0, 0.0), 1.5: (np.cos(2.5), np.sin(2.5))}
    moment = 0.3 + sum(at[s][0] * forces[s][1] - at[s][1] * forces[s][0] for s in at)
    assert abs(d.fx + sum(f[0] for f in forces.values())) < EXACT
    assert abs(d.fy + sum(f[1] for f in forces.values())) < EXACT
    assert abs(d.mz + moment) < EXACT
    assert abs(d.mz - reordered.mz) < EXACT


def test_a_follower_turns_with_the_whisker_and_a_dead_load_does_not():
    follower = jw.deflect(jw.Whisker(), jw.PointForce(2.0, follower=True))
    tip = float(follower.angle[-1])
    np.testing.assert_allclose([-follower.fx, -follower.fy], 2 * np.array([-np.sin(tip), np.cos(tip)]), atol=EXACT)
    dead = jw.deflect(jw.Whisker(), jw.PointForce(2.0))
    np.testing.assert_allclose([dead.fx, dead.fy], [2.0, 0.0], atol=EXACT)


EULER = np.pi**2 / 4  # smallest axial load that buckles a cantilever
MINUTES = np.radians(0.05)


@pytest.mark.parametrize(
    ("axial", "lateral", "tip"),
    [
        # Angle of the tip to the upright in degrees, towards -x, where the lateral load pushes.
        (1.5, 0.01, 98.72),
        (1.1, 0.001, 49.64),
        (2.8 * np.cos(MINUTES) / EULER, 2.8 * np.sin(MINUTES), 57.05),
        (1.1, 1e-6, 49.53),  # the bend of the branch is as narrow as 1e-4 of the load
    ],
)
def test_branches_begin_at_rest(axial, lateral, tip):
    for side in (1, -1):
        push = jw.PointForce(side * lateral)
        d = jw.deflect(jw.Whisker(), jw.PointForce(axial * EULER, direction=-np.pi / 2), push)
        assert d.status == jw.Status.ok
        np.testing.assert_allclose(np.degrees(d.angle[-1] - np.pi / 2), side * tip, atol=TENTHS)
        assert side * d.x[-1] < 0


TENTHS = 0.006  # degrees; the angles are rounded


def test_columns_buckle_to_either_side():
    status = [
        int(jw.deflect(jw.Whisker(), jw.PointForce(share * EULER, direction=-np.pi / 2)).status)
        for share in (0.99, 1.01, 20.0)  # the last one is beyond the second buckling load
    ]
    assert status == [jw.Status.ok, jw.Status.unstable, jw.Status.unstable]


def test_pure_tension_is_stable():
    assert jw.deflect(jw.Whisker(), jw.PointForce(50.0, direction=np.pi / 2)).status == jw.Status.ok


def heavy(load, lateral):
    """Tip of an upright whisker under its weight and a small lateral load, by a collocation method."""

    def rates(s, values):
        phi, moment, *_ = values
        # Of everything beyond s: the weight times (1 - s) downwards, and the lateral load towards -x.
        return np.stack([moment, (1 - s) * load * np.cos(phi) - lateral * np.sin(phi), np.cos(phi), np.sin(phi)])

    def ends(base, tip):
        return np.array([base[0] - np.pi / 2, base[2], base[3], tip[1]])

    s = np.linspace(0, 1, 41)
    guess = np.stack([np.pi / 2 + 2.2 * np.sin(np.pi * s / 2), 2 * (1 - s), -s, s * (1 - s)])
    found = solve_bvp(rates, ends, s, guess, tol=1e-11, max_nodes=100_000)
    assert found.success
    return found.y[:, -1], found.y[1, 0]


DISTRIBUTED = 1e-8  # of the collocation method and of deflections
SIDEWAYS = 0.3


@pytest.mark.parametrize("load", [6.0, 10.0])  # less and more than the 7.837 at which an upright column buckles
def test_uniform_dead_weight(load):
    (phi, _, x, y), moment = heavy(load, SIDEWAYS)
    push = jw.PointForce(SIDEWAYS)
    for d in (
        jw.deflect(jw.Whisker(), jw.LineLoad(y=-load), push),
        jw.deflect(jw.Whisker(mass_per_length=2.0), push, gravity=(0.0, -load / 2)),
        jw.deflect(jw.Whisker(), jw.LineLoad(y=lambda s: -load + 0 * s), push),
    ):
        assert d.status == jw.Status.ok
        np.testing.assert_allclose([d.angle[-1], d.x[-1], d.y[-1], -d.mz], [phi, x, y, moment], atol=DISTRIBUTED)
        np.testing.assert_allclose([d.fx, d.fy], [SIDEWAYS, load], atol=EXACT)


def test_heavy_columns_buckle_at_greenhills_load():
    status = jax.vmap(lambda w: jw.deflect(jw.Whisker(), jw.LineLoad(y=-w), points=2).status)(np.array([7.83, 7.84]))
    assert status.tolist() == [jw.Status.ok, jw.Status.unstable]


def test_weights_include_the_tip_but_not_the_base():
    whisker = jw.Whisker(2.0, 3.0, mass_per_length=0.4, tip_mass=0.3, base_mass=5.0)
    d = jw.deflect(whisker, gravity=(-0.7, -0.1))
    np.testing.assert_allclose([d.fx, d.fy], [1.1 * 0.7, 1.1 * 0.1], atol=EXACT)
    along = np.trapezoid(0.4 * np.stack([d.x, d.y]), d.s)  # 0.7 and 0.1 times the moment of the distributed mass
    x, y = along + 0.3 * np.array([d.x[-1], d.y[-1]])
    assert abs(d.mz - (x * 0.1 - y * 0.7)) < TRAPEZOIDS


TRAPEZOIDS = 1e-4  # the moment from 101 points of the shape


class Growing(eqx.Module):
    rate: jax.Array

    def __call__(self, s):
        return self.rate * s


def test_derivatives_by_distributed_loads():
    def tip(numbers):
        x, rate, start, stop, length = numbers
        d = jw.deflect(jw.Whisker(length), jw.LineLoad(x, Growing(rate), start, stop), points=3)
        return jnp.stack([d.mz, d.x[-1], d.fy])

    @jax.jit
    def all_of(numbers, weights):
        value, along = jax.linearize(tip, numbers)
        columns = jax.vmap(along, out_axes=-1)(jnp.eye(numbers.size))
        return value, columns, jax.linear_transpose(along, numbers)(weights)[0]

    at, weights = jnp.array([-1.0, 0.7, 0.2, 0.9, 1.2]), jnp.array([1.0, -2.0, 0.5])
    _, forward, reverse = all_of(at, weights)
    np.testing.assert_allclose(reverse, weights @ np.asarray(forward), rtol=MODES)
    for k in range(at.size):
        step = 1e-5 * jnp.eye(at.size)[k]
        difference = (all_of(at + step, weights)[0] - all_of(at - step, weights)[0]) / 2e-5
        assert np.max(np.abs(difference)) > 0.1
        np.testing.assert_allclose(forward[:, k], difference, atol=DIFFERENCES * np.max(np.abs(forward)))


def test_deflections_in_si_units():
    one = jw.deflect(jw.Whisker(), jw.PointForce(5.0))
    length, stiffness = 0.02, 3e-7
    si = jw.deflect(jw.Whisker(length, stiffness), jw.PointForce(5.0 * stiffness / length**2))
    assert abs(si.mz / (stiffness / length) - one.mz) < 1e-12
    np.testing.assert_allclose(si.x / length, one.x, atol=1e-12)


def test_a_load_too_large_for_the_steps_has_a_status():
    d = jw.deflect(jw.Whisker(), jw.PointForce(1e4))
    assert d.status == jw.Status.inexact
    assert np.isnan(d.mz) and np.all(np.isnan(d.x))


def test_shapes_have_points_on_each_stretch():
    whisker = jw.Whisker(2.0)
    d = jw.deflect(whisker, jw.PointForce(0.3, 1.5), jw.PointForce(0.2, 0.5), points=11)
    assert d.s.shape == (11 + 11 + 1,)
    np.testing.assert_allclose(np.asarray(d.s)[[0, 10, 11, 21, 22]], [0.0, 0.5, 0.5, 1.5, 2.0], atol=EXACT)
    np.testing.assert_allclose([d.x[0], d.y[0]], [d.base_x, d.base_y], atol=EXACT)
    # Beyond the outermost load the whisker is straight.
    step = np.array([d.x[22] - d.x[21], d.y[22] - d.y[21]])
    np.testing.assert_allclose(step, 0.5 * np.array([np.cos(d.angle[21]), np.sin(d.angle[21])]), atol=EXACT)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.deflect("whisker", jw.PointForce(1.0)), "`whisker` must be a Whisker, got 'whisker'"),  # pyright: ignore
        (
            lambda: jw.deflect(jw.Whisker()),
            r"`loads` must be one or more of PointForce, PointMoment, LineLoad, SpaceForce and SpaceMoment, got \(\)",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), 3.0),  # pyright: ignore
            "`loads` must be one or more of PointForce, PointMoment, LineLoad, SpaceForce and SpaceMoment, got",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), jw.PointForce(1.0, 1.5)),
            "`position` must be at most the length 1.0, got 1.5",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), jw.LineLoad(1.0, stop=2.0)),
            "`stop` must be at most the length 1.0, got 2.0",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), jw.LineLoad(1.0, start=1.0)),
            "`start` must be less than the length 1.0, got 1.0",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), gravity=(0.0, -1.0)),
            "`mass_per_length` must be given for a whisker with a weight, got None",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), jw.PointForce(1.0), points=1),
            "`points` must be an int of at least 2, got 1",
        ),
        (
            lambda: jw.deflect(jw.Whisker(), jw.PointForce(1.0), support=jw.Support.fbfb(70.0)),
            "`support` must be a Support of one whisker, got",
        ),
    ],
)
def test_wrong_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_vmap_is_a_loop():
    forces = np.array([1.0, 5.0, 10.0])
    batch = jax.vmap(lambda f: jw.deflect(jw.Whisker(), jw.PointForce(f)).mz)(forces)
    loop = [jw.deflect(jw.Whisker(), jw.PointForce(f)).mz for f in forces]
    np.testing.assert_allclose(batch, loop, rtol=1e-13)


LOADS = jnp.array([3.0, 0.8, 2.5, 0.6, 1.1, 0.9])  # force, position, direction; moment; length, bending stiffness
MODES = 1e-10  # forward against reverse
DIFFERENCES = 1e-7  # central differences of a smooth function with step 1e-5


def bent(p, follower):
    force, position, direction, moment, length, bending_stiffness = p
    loads = (jw.PointForce(force, position, follower, direction), jw.PointMoment(moment))
    d = jw.deflect(jw.Whisker(length, bending_stiffness), *loads, points=5)
    return jnp.concatenate([jnp.stack([d.fx, d.fy, d.mz]), d.s, d.x, d.y, d.angle, d.curvature])


@pytest.mark.parametrize("follower", [False, True])
def test_derivatives_by_loads_and_whisker(follower):
    @jax.jit
    def all_of(p, weights):
        value, along = jax.linearize(lambda p: bent(p, follower), p)
        columns = jax.vmap(along, out_axes=-1)(jnp.eye(p.size))
        return value, columns, jax.linear_transpose(along, p)(weights)[0]

    weights = np.random.default_rng(4).normal(size=bent(LOADS, follower).shape)
    _, forward, reverse = all_of(LOADS, weights)
    np.testing.assert_allclose(reverse, weights @ np.asarray(forward), rtol=MODES)
    for k in range(LOADS.size):
        step = 1e-5 * jnp.eye(LOADS.size)[k]
        difference = (all_of(LOADS + step, weights)[0] - all_of(LOADS - step, weights)[0]) / 2e-5
        assert np.max(np.abs(difference)) > 0.1
        np.testing.assert_allclose(forward[:, k], difference, atol=DIFFERENCES * np.max(np.abs(forward)))


def test_derivatives_of_small_deflections_agree_with_beam_theory():
    # Cantilever: tip deflection F L^3 / 3 EI, base moment F L; the force towards -x.
    def tip(force, length, bending_stiffness):
        d = jw.deflect(jw.Whisker(length, bending_stiffness), jw.PointForce(force))
        return d.x[-1], d.mz

    by_force = jax.jit(jax.jacrev(tip))(0.0, 1.3, 0.7)
    np.testing.assert_allclose(by_force, (-(1.3**3) / (3 * 0.7), -1.3), rtol=EXACT)


def test_second_derivatives():
    def moment(force, length):
        return jw.deflect(jw.Whisker(length), jw.PointForce(force)).mz

    hessian = jax.jit(jax.hessian(moment, argnums=(0, 1)))(3.0, 1.1)
    slopes = jax.jit(jax.grad(moment, argnums=(0, 1)))
    for k, (df, dl) in enumerate([(1e-5, 0.0), (0.0, 1e-5)]):
        ahead, behind = slopes(3.0 + df, 1.1 + dl), slopes(3.0 - df, 1.1 - dl)
        np.testing.assert_allclose(hessian[k], [(a - b) / 2e-5 for a, b in zip(ahead, behind, strict=True)], atol=1e-7)


def test_failed_batch_elements_have_no_derivative():
    def mean(forces, positions, stiffness):
        def one(force, position):
            return jw.deflect(jw.Whisker(1.0, stiffness), jw.PointForce(force, position)).mz

        return jnp.nanmean(jax.vmap(one)(forces, positions))

    gradient = jax.jit(jax.grad(mean, argnums=(0, 1, 2)))
    # A NaN, a load beyond the tip, one that is too large, another NaN; then two valid ones.
    forces = jnp.array([jnp.nan, 1.0, 1e7, 1.0, 1.0, 2.0])
    positions = jnp.array([0.5, 1.5, 0.7, jnp.nan, 0.5, 0.8])
    by_force, by_position, by_stiffness = gradient(forces, positions, 1.0)
    assert np.all(by_force[:4] == 0) and np.all(by_position[:4] == 0)
    assert np.all(by_force[4:] != 0) and np.all(by_position[4:] != 0)
    # A batch of valid loads only has the same mean.
    _, _, alone = gradient(jnp.tile(forces[4:], 3), jnp.tile(positions[4:], 3), 1.0)
    np.testing.assert_allclose(by_stiffness, alone, rtol=MODES)


@pytest.mark.parametrize("load", [50.0, 80.0, 150.0])
def test_a_strong_force_bends_the_whisker_in_one_direction(load):
    """Near such a solution are others, whose curvature changes sign."""
    bent = jw.deflect(jw.Whisker(), jw.PointForce(load, direction=np.pi - 0.3))
    assert bent.status == jw.Status.ok
    assert np.all(bent.curvature > -1e-9)
    assert np.pi / 2 < bent.angle[-1] < np.pi - 0.3
