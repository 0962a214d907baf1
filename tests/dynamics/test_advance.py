"""One time step: that of a linear vibration against NumPy, and the parts of its solution."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.advance import _eliminated, _where, advance, solved_each
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.motion_state import Ledger, Moving, Rod, angles_of, nodes_of
from jaxwhisker._dynamics.moving import Damping, system_of

N, H, SIZE = 3, 0.05, 1e-5
LINEAR = 1e-8  # of a step relative to its size: the equations are odd in the bends, whose squares are 1e-10
EXACT = 1e-11
AIR, MATERIAL = 0.3, 0.01


@pytest.fixture(scope="module")
def stepped():
    """Steps of an upright clamped whisker from small bends, and its mass and stiffness; the last bend is NaN."""
    sensor = jax.tree.map(checks.as_float, jw.Sensor(jw.Whisker(mass_per_length=1.0, tip_mass=0.2)))
    none, rng = jnp.zeros(()), np.random.default_rng(0)
    q, rate = SIZE * rng.normal(size=(2, 2, N)) * [1.0, 0.1, 0.01]
    q[1, 0] = np.nan

    @eqx.filter_jit
    def of(sensor, q, rate):
        system = system_of(sensor, Damping(none + AIR, none + MATERIAL, (none, none, none)), N)
        base = jnp.zeros((1, 3))

        def shape(q):
            return nodes_of(system, base, angles_of(system, q, base))

        def one(q, rate):
            at, velocity = jax.jvp(shape, (q[None],), (rate[None],))
            rod = Rod(q[None], base, angles_of(system, q[None], base), at, velocity, jnp.zeros(1), None)
            ledger = Ledger(*[none] * 5)
            old = Moving(rod, jnp.zeros(0), jnp.zeros(3), jnp.zeros((2, N)), ledger, jnp.asarray(True))
            return advance(system, old, jnp.zeros(3), jnp.zeros(3), jnp.asarray(H))

        rods, angles = system.rods, basis(N).angles
        return jax.vmap(one)(q, rate), angles.T @ rods.second[0] @ angles, rods.stiffness[0]

    return q[0], rate[0], *jax.tree.map(np.asarray, of(sensor, jnp.asarray(q), jnp.asarray(rate)))


def test_a_small_vibration_takes_a_step_of_the_midpoint_rule(stepped):
    q, rate, (new, _), mass, stiffness = stepped
    damping = AIR * mass + MATERIAL * stiffness
    left = 2 * mass / H**2 + damping / H + stiffness / 2
    right = (2 * mass / H**2 + damping / H - stiffness / 2) @ q + 2 * mass @ rate / H
    expected = np.linalg.solve(left, right)
    np.testing.assert_allclose(new.rod.q[0, 0], expected, atol=LINEAR * SIZE)
    assert np.max(np.abs(expected - q)) > 0.05 * SIZE
    np.testing.assert_allclose(new.change[0, 0], new.rod.q[0, 0] - q, atol=1e-20)


def test_energy_and_its_ledger_change_alike(stepped):
    q, rate, (new, forces), mass, stiffness = stepped
    after = new.rod.q[0, 0]
    speed = 2 * (after - q) / H - rate
    before, later = ((v @ mass @ v + q @ stiffness @ q) / 2 for q, v in ((q, rate), (after, speed)))
    moved = (after - q) / H
    lost = H * moved @ (AIR * mass + MATERIAL * stiffness) @ moved
    np.testing.assert_allclose(new.ledger.damping[0], lost, rtol=1e-6)
    np.testing.assert_allclose(later - before, -lost, rtol=1e-6)
    assert new.ledger.work[0] == 0
    # The force of the clamp is the change of momentum along x, and what the air takes.
    _, weights, _, angles, reach, _ = basis(N)
    masses = np.concatenate([[0.0], weights, [0.2]])
    momentum = -masses @ reach @ angles @ np.stack([speed - rate, AIR * (after - q)], axis=1)
    np.testing.assert_allclose(forces.reaction[0, 0, 0], np.sum(momentum) / H, rtol=1e-6)


def test_a_state_that_is_not_known_is_not_solved(stepped):
    _, _, (new, _), _, _ = stepped
    assert new.solved.tolist() == [True, False]
    assert np.isfinite(new.rod.q[0]).all() and np.isnan(new.rod.q[1]).any()


def test_blocks_are_eliminated():
    rng = np.random.default_rng(1)
    half, right = rng.normal(size=(4, 4)), rng.normal(size=(4, 3))
    block = half @ half.T + np.eye(4)
    found = jax.jit(_eliminated)(jnp.asarray(np.concatenate([block, right], axis=1)))
    np.testing.assert_allclose(found, np.linalg.solve(block, right), atol=EXACT)
    systems, rows = np.stack([half, block]), rng.normal(size=(2, 4))
    solved = jax.jit(solved_each)(jnp.asarray(systems), jnp.asarray(rows))
    np.testing.assert_allclose(solved, np.linalg.solve(systems, rows[..., None])[..., 0], atol=EXACT)
    assert solved_each(jnp.zeros((2, 0, 0)), jnp.zeros((2, 0))).shape == (2, 0)


def test_points_are_computed_anew_only_where_they_are_needed():
    points, are_found = (jnp.arange(3.0), -jnp.arange(3.0)), jnp.array([False, True, False])
    poses = (jnp.full(3, 10.0),)

    def found(poses, points):
        return jax.tree.map(lambda each: each + poses[0], points), jnp.ones(3, bool)

    @jax.jit
    def of(needed):
        return _where(needed, found, poses, points, are_found)

    (first, second), done = of(jnp.array([True, False, False]))
    assert first.tolist() == [10, 1, 2] and second.tolist() == [10, -1, -2] and done.tolist() == [True, True, False]
    (first, _), done = of(jnp.zeros(3, bool))
    assert first.tolist() == [0, 1, 2] and done.tolist() == [False, True, False]
