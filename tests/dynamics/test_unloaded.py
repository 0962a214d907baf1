"""Whiskers that springs on their shafts bend, against closed forms, with derivatives."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.moving import Damping, system_of
from jaxwhisker._dynamics.unloaded import unloaded

N = 2
EXACT = 1e-10
TIP = 1e-5  # of curvatures: the spring is 1e-6 below the tip
TORSION = 5.0  # stiffness of the spring that turns the base
NONE = Damping(jnp.zeros(()), jnp.zeros(()), (jnp.zeros(()),) * 3)


@pytest.fixture(scope="module")
def lanes():
    """Values and derivatives in both modes of three whiskers, of which the second one is invalid.

    A torsion spring turns their tips, and springs hold their bases along x and about them: their curvature is constant.
    """
    at_tip = jw.Spring((0, 1), 1.0, 0.3, axis="phi", at=0.999999)
    springs = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((0, 1), TORSION, axis="phi"), at_tip
    sensor = jw.Sensor(jw.Whisker(mass_per_length=1.0), jw.Support(springs))
    system = eqx.filter_jit(system_of)(jax.tree.map(checks.as_float, sensor), NONE, N)

    def given(system):
        assert system.rods.held is not None and system.network is not None
        own = system.rods.held.springs
        return own.stiffness, own.rest_length, system.network.offset

    def bent(p):
        stiffness, angle, base = (leaf.at[0, 0].set(value) for leaf, value in zip(given(system), p, strict=True))
        found = unloaded(eqx.tree_at(given, system, (stiffness, angle, base)))
        return jnp.concatenate([found.q[0], found.z, found.found[None].astype(float)])

    at, weights = jnp.array([[3.0, 0.8, 0.2], [jnp.nan, 0.8, 0.2], [0.5, -1.3, 0.1]]), jnp.arange(1.0, N + 4)

    def one(p):
        values, along = jax.linearize(bent, p)
        return values, jax.vmap(along, out_axes=1)(jnp.eye(3)), jax.linear_transpose(along, p)(weights)[0]

    return at, weights, *jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(at))


def test_a_torsion_spring_at_the_tip_bends_a_whisker_to_an_arc(lanes):
    at, _, values, _, _ = lanes
    for k in (0, 2):
        stiffness, angle, base = np.asarray(at[k])
        moment = stiffness * angle / (1 + stiffness + stiffness / TORSION)
        expected = np.append(np.eye(N)[0] * moment, [base, moment / TORSION, 1.0])
        np.testing.assert_allclose(values[k], expected, atol=TIP)


def test_its_derivatives_are_those_of_the_closed_form(lanes):
    at, weights, _, forward, reverse = lanes
    for k in (0, 2):
        stiffness, angle, _ = np.asarray(at[k])
        expected, whole = np.zeros((N + 3, 3)), 1 + stiffness + stiffness / TORSION
        expected[0, :2] = angle / whole**2, stiffness / whole
        expected[N + 1, :2] = expected[0, :2] / TORSION
        expected[N, 2] = 1.0
        np.testing.assert_allclose(forward[k], expected, atol=TIP)
        np.testing.assert_allclose(reverse[k], weights @ forward[k], atol=EXACT)


def test_a_lane_without_equilibrium_fails_alone(lanes):
    _, _, values, forward, _ = lanes
    assert values[:, -1].tolist() == [1.0, 0.0, 1.0]
    assert np.isfinite(values[::2]).all() and np.isfinite(forward[::2]).all()
