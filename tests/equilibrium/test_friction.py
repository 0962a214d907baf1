"""The laws of friction: rolling contacts against closed forms of arc lengths, slips and leans."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import friction
from jaxwhisker._equilibrium.friction import Friction

ROLLED = 1e-12  # the parameter is integrated with an error of 1e-13 in each step
SLOPE = 1e-11  # of derivatives, by the numbers of the object through a quadrature that is exact enough for short ways

STARTS, DISTANCES = np.array([-1.2, -0.3, 0.0, 0.5, 1.1]), np.array([2.0, -0.7, 0.4, -1.5, 0.0])


@Program
def rolled(profile, start, distance):
    return jax.vmap(lambda *own: friction.rolled(profile, *own))(start, distance)


def length_of(a, alpha):
    """Arc length of y = a x^2 from its vertex to the slope angle alpha."""
    slope = np.tan(alpha)
    return (slope * np.hypot(1, slope) + np.arcsinh(slope)) / (4 * a)


def test_on_a_circle_a_contact_rolls_by_an_angle():
    np.testing.assert_allclose(
        rolled(jw.Circle(0.2, 0.7, 0.1), jnp.asarray(STARTS), jnp.asarray(DISTANCES)),
        STARTS + DISTANCES / 0.7,
        atol=ROLLED,
    )


def test_on_a_parabola_a_contact_rolls_by_an_arc_length_and_back_again():
    profile = jw.Parabola(0.2, 1.7, -0.4)
    start, distance = jnp.asarray(STARTS), jnp.asarray(DISTANCES)
    stop = rolled(profile, start, distance)
    np.testing.assert_allclose(length_of(1.7, np.asarray(stop)), length_of(1.7, STARTS) + DISTANCES, rtol=1e-11)
    np.testing.assert_allclose(rolled(profile, stop, -distance), start, atol=ROLLED)
    assert stop[-1] == start[-1]  # no distance, exactly
    least = rolled(profile, start, jnp.full_like(start, 1e-17))  # less than rounding
    np.testing.assert_allclose(least, start, atol=1e-15)


def test_derivatives_of_rolling_agree_with_closed_forms_in_both_modes():
    a, start, distance = 1.7, -0.3, 0.1

    @Program
    def slopes(a, start, distance):
        def stop(a, start, distance):
            return friction.rolled(jw.Parabola(0.2, a, 0.1), start, distance)

        return [mode(stop, argnums=(0, 1, 2))(a, start, distance) for mode in (jax.jacfwd, jax.jacrev)]

    stop = rolled(jw.Parabola(0.2, a), jnp.asarray([start]), jnp.asarray([distance]))[0]
    before, after = (1 / (2 * a * np.cos(angle) ** 3) for angle in (start, stop))  # arc length per parameter
    # Arc lengths between two slopes are proportional to 1 / a.
    expected = distance / a / after, before / after, 1 / after
    for found in slopes(jnp.asarray(a), jnp.asarray(start), jnp.asarray(distance)):
        np.testing.assert_allclose(found, expected, rtol=SLOPE)


def test_a_contact_that_rolls_off_a_sharp_end_fails_alone():
    def bowl(x):
        return 1.2 - jnp.sqrt(1 - x**2)

    # The parameter is the abscissa, and its arc length the arcsine, up to the vertical wall at 1.
    start, distance = np.array([0.1, 0.1, 0.1, -0.5]), np.array([0.5, 2.0, np.nan, 0.0])
    stop = rolled(jw.Graph(bowl), jnp.asarray(start), jnp.asarray(distance))
    np.testing.assert_allclose(stop[0], np.sin(np.arcsin(0.1) + 0.5), atol=ROLLED)
    assert np.isnan(stop[1]) and np.isnan(stop[2]) and stop[3] == -0.5


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_contact_that_sticks_rolls_and_others_are_where_they_are(side):
    radius, known, beyond = 0.7, jnp.array([0.4, 0.4, 0.4]), jnp.array([0.35, 0.35, 0.2])
    began = Friction(jnp.array([0, 1, 0]), jnp.full(3, -0.3), jnp.full(3, 0.2))

    @Program
    def parameter(side, friction_):
        def one(*own):
            return friction.contact_parameter(jw.Circle(0.2, radius), *own)

        return jax.vmap(one, in_axes=(0, 0, None, 0))(known, beyond, side, friction_)

    # The whisker rolls towards its base by 0.15, which is down the object on the side from which it came.
    expected = [-0.3 - side * 0.15 / radius, 0.4, -0.3]
    np.testing.assert_allclose(parameter(jnp.asarray(side), began), expected, atol=ROLLED)


def test_forces_lean_against_the_slip_by_the_friction_angle():
    of = Friction(jnp.array([0, 1, -1]), jnp.zeros(3), jnp.zeros(3))
    known = jnp.array([0.1, 7.0, 8.0])
    np.testing.assert_array_equal(friction.lean(known, of, 0.3), [0.1, 0.3, -0.3])
    assert friction.lean(known, None, 0.3) is None and friction.lean(known, of, None) is None


def test_contacts_begin_to_slip_towards_the_vertex():
    side, which = jnp.array([1.0, -1.0, 1.0]), jnp.array([True, True, False])
    of = friction.slipping_from(side)
    assert of.slip.tolist() == [-1, 1, -1] and of.parameter.tolist() == of.beyond.tolist() == [0.0] * 3
    stuck = Friction(jnp.zeros(3, int), jnp.array([0.1, 0.2, 0.3]), jnp.array([0.4, 0.5, 0.6]))
    after = friction.newly_slipping(stuck, which, side)
    assert after is not None and after.slip.tolist() == [-1, 1, 0]
    assert after.parameter is stuck.parameter and after.beyond is stuck.beyond
    assert friction.newly_slipping(None, which, side) is None
