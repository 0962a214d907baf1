"""Second variation of straight rods under thrust, torque and shear, by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.quadrature import gauss
from jaxwhisker._rod.second_variation import BentRod, second_variation

EXACT = 1e-12
STIFFNESS, RATIO = 1.3, 0.7
NODES, WEIGHTS = gauss(20)
# Rotations that vanish at the base, of a rod of length 1.
FIELDS = jnp.stack([jnp.sin(np.pi / 2 * NODES), jnp.asarray(NODES)])
SLOPES = jnp.stack([np.pi / 2 * jnp.cos(np.pi / 2 * NODES), jnp.ones(NODES.size)])
GRAM = np.array([[1 / 2, 4 / np.pi**2], [4 / np.pi**2, 1 / 3]])  # integrals of products of the fields
RISE = np.array([[np.pi**2 / 8, 1.0], [1.0, 1.0]])  # and of those of their slopes


def along(*vector):
    return jnp.broadcast_to(jnp.array(vector), (NODES.size, 3))


@jax.jit
def form(tangent, force, moment):
    rod = BentRod(jnp.full(NODES.size, STIFFNESS), RATIO, tangent, force, moment)
    every = second_variation(rod, FIELDS, SLOPES, jnp.asarray(WEIGHTS))
    return every, second_variation(rod, FIELDS, SLOPES, jnp.asarray(WEIGHTS), axes=2)


UP, NOTHING = along(0.0, 1.0, 0.0), along(0.0, 0.0, 0.0)


def blocks(values, axes=3):
    """By function, axis, function and axis."""
    return np.reshape(values, (2, axes, 2, axes))


def test_a_thrust_lowers_what_bends_and_leaves_what_twists():
    thrust = 2.0
    values = blocks(form(UP, along(0.0, -thrust, 0.0), NOTHING)[0])
    for axis in range(3):
        twists = axis == 1
        expected = STIFFNESS * RISE * RATIO if twists else STIFFNESS * RISE - thrust * GRAM
        np.testing.assert_allclose(values[:, axis, :, axis], expected, atol=EXACT)
        others = np.delete(values[:, axis], axis, axis=-1)
        np.testing.assert_allclose(others, 0.0, atol=EXACT)


@pytest.mark.parametrize(("share", "stable"), [(0.999, True), (1.001, False)])
def test_a_column_buckles_at_the_load_of_euler(share, stable):
    euler = np.pi**2 / 4 * STIFFNESS
    every, _ = form(UP, along(0.0, -share * euler, 0.0), NOTHING)
    assert (np.linalg.eigvalsh(every)[0] > 0) == stable


def test_a_torque_couples_bending_about_both_axes():
    torque = 0.6
    values = blocks(form(UP, NOTHING, along(0.0, torque, 0.0))[0])
    # m.(w x w') with m along y: m (w_z w'_x - w_x w'_z), made symmetric.
    mixed = np.einsum("p,ip,jp->ij", WEIGHTS, FIELDS, SLOPES)  # field times slope
    coupled = torque * (mixed - mixed.T) / 2
    np.testing.assert_allclose(values[:, 0, :, 2], coupled, atol=EXACT)
    np.testing.assert_allclose(values[:, 2, :, 0], coupled.T, atol=EXACT)
    assert np.max(np.abs(coupled)) > 0.01


def test_a_shear_force_couples_bending_and_twist():
    shear = 0.8
    values = blocks(form(UP, along(shear, 0.0, 0.0), NOTHING)[0])
    # -(F.w)(t.w), made symmetric.
    np.testing.assert_allclose(values[:, 0, :, 1], -shear * GRAM / 2, atol=EXACT)


def test_rotations_about_the_first_axes_only():
    every, two = form(along(0.6, 0.8, 0.0), along(0.3, -0.5, 0.2), along(0.1, 0.4, -0.7))
    np.testing.assert_allclose(blocks(two, 2), blocks(every)[:, :2, :, :2], atol=EXACT)
    np.testing.assert_allclose(every, every.T, atol=EXACT)
