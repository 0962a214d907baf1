"""Points of the path and the conditions that select them: each against the plain sum that it stands for."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import point
from jaxwhisker._equilibrium.point import Point

ROUNDING = 1e-14  # the same few products in another order, of numbers up to 10

# Two whiskers, each with force, parameter, slack, and three loads of a spring to another shaft.
Z = np.array([[3.0, 0.4, -0.2, 0.5, -2.0, 0.1], [-0.5, -0.7, 0.3, 0.0, 0.0, -4.0]])
CHANGE = np.array([[0.2, -0.1, 0.3, 0.7, 0.1, -0.2], [-0.4, 0.6, 0.1, -0.5, 0.2, 0.3]])
U, RATE = 0.8, -0.6
SINES = np.array([0.3, -0.9])
HERE, THERE = Point(jnp.asarray(Z), jnp.asarray(U)), Point(jnp.asarray(Z + CHANGE), jnp.asarray(U + RATE))
FIRST, SECOND, BOTH = (jnp.array(which) for which in ([True, False], [False, True], [True, True]))

residual = Program(lambda condition, at: condition.residual(at, jnp.asarray(SINES)))


def test_the_condition_of_a_control():
    condition = point.at_control(jnp.asarray(0.3), HERE.z)
    np.testing.assert_allclose(residual(condition, THERE), U + RATE - 0.3, atol=ROUNDING)


@pytest.mark.parametrize(("which", "expected"), [(FIRST, 0.2), (SECOND, -0.4), (BOTH, -0.2)])
def test_the_condition_of_a_force_concerns_the_sum_of_forces(which, expected):
    np.testing.assert_allclose(residual(point.at_force(which, HERE.z), THERE), expected, atol=ROUNDING)


def test_an_arc_length_is_measured_along_the_tangent():
    tangent, length = point.unit(Point(jnp.asarray(CHANGE), jnp.asarray(RATE)), HERE.z)
    scale = 1 + np.abs(Z)
    scale[:, 1:3] = 1.0  # of parameter and slack
    size = np.sqrt(np.sum((CHANGE / scale) ** 2) + RATE**2)
    np.testing.assert_allclose(length, size, rtol=ROUNDING)
    np.testing.assert_allclose(tangent.z, CHANGE / size, rtol=ROUNDING)
    np.testing.assert_allclose(tangent.u, RATE / size, rtol=ROUNDING)
    np.testing.assert_allclose(point.dot(tangent, tangent, point.scale_of(HERE.z)), 1.0, rtol=ROUNDING)
    condition = point.at_arc_length(HERE, tangent, jnp.asarray(0.25))
    # The point of CHANGE is at its own length; a step across the tangent stays in the plane.
    np.testing.assert_allclose(residual(condition, THERE), size - 0.25, atol=ROUNDING)
    across = Point(THERE.z.at[0, 0].add(RATE * scale[0, 0] ** 2), THERE.u - CHANGE[0, 0])
    np.testing.assert_allclose(residual(condition, across), size - 0.25, atol=ROUNDING)


def test_contacts_without_shaft_loads_are_scaled_by_their_force_alone():
    three = jnp.asarray(Z[:, :3])
    np.testing.assert_allclose(point.scale_of(three), [[4.0, 1.0, 1.0], [1.5, 1.0, 1.0]])
    np.testing.assert_allclose(point.scale_of(HERE.z)[:, :3], point.scale_of(three))
    # Batches, too.
    np.testing.assert_allclose(point.scale_of(three[None])[0], point.scale_of(three))


def test_points_along_lines_and_parabolas():
    direction, bend = Point(jnp.asarray(CHANGE), jnp.asarray(RATE)), Point(jnp.asarray(Z), jnp.asarray(2.0))
    for own, half in ((None, 0.0), (bend, 0.3**2 / 2)):
        found = point.along(HERE, direction, jnp.asarray(0.3), own)
        np.testing.assert_allclose(found.z, Z + 0.3 * CHANGE + half * Z, atol=ROUNDING)
        np.testing.assert_allclose(found.u, U + 0.3 * RATE + half * 2.0, atol=ROUNDING)
