"""Panels: integrals and derivatives along them against polynomials, shares of the control, places in a panel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import quad

from jaxwhisker._scan.panels import (
    POINTS,
    Panel,
    PanelEnds,
    coefficients,
    integral_to,
    panels_of,
    place_in,
    points_of,
    rates_of,
    share,
    slopes_at_points,
)

EXACT = 1e-12  # of polynomials with coefficients of order 1
SLOPES = np.array([[1.0, 1.0], [0.2, 2.5], [3.0, 3.0], [0.0, 2.0]])
AT = (np.polynomial.legendre.leggauss(POINTS)[0] + 1) / 2


def panels(slopes=SLOPES):
    """Panels in turn, from 0.9 to -1.1 and back."""
    count = len(slopes)
    control = np.where(np.arange(count + 1) % 2 == 0, 0.9, -1.1)
    travel = 2.0 * np.arange(count + 1) + 5.0
    return Panel(
        jnp.asarray(control[:-1]),
        jnp.asarray(control[1:]),
        jnp.stack([travel[:-1], travel[1:]], axis=1),
        jnp.asarray(slopes),
        jnp.full(count, 1e-12),
    )


def test_polynomials_at_the_points_are_integrated_and_differentiated_exactly():
    rng = np.random.default_rng(0)
    curves = [Polynomial(rng.normal(size=POINTS)) for _ in range(4)]
    values = jnp.asarray([curve(AT) for curve in curves])
    vectors = jnp.stack([values, 2 * values], axis=-1)

    @jax.jit
    def found(vectors, t):
        total = coefficients(vectors)
        return slopes_at_points(vectors), total[:, 0], jax.vmap(lambda t: jax.vmap(integral_to, (None, 0))(t, total))(t)

    t = np.array([0.0, 0.3, 1.0])
    slopes, whole, to = found(vectors, t)
    for k, curve in enumerate(curves):
        np.testing.assert_allclose(slopes[k, :, 1], 2 * curve.deriv()(AT), atol=100 * EXACT)
        integral = curve.integ()
        np.testing.assert_allclose(whole[k, 0], integral(1.0), atol=EXACT)
        np.testing.assert_allclose(to[:, k, 1], 2 * integral(t), atol=EXACT)


def test_the_control_grows_from_end_to_end_with_the_given_slopes():
    t = jnp.linspace(0.0, 1.0, 101)
    value, rate = jax.vmap(share, in_axes=(None, 0))(t, jnp.asarray(SLOPES)[:, None])
    np.testing.assert_allclose(value[:, [0, -1]], [[0.0, 1.0]] * 4, atol=EXACT)
    np.testing.assert_allclose(rate[:, [0, -1]], SLOPES, atol=EXACT)
    assert np.all(np.diff(value) > 0) and np.all(rate > -EXACT)


def test_points_and_rates_integrate_over_the_control():
    some = panels()
    control, travel = points_of(some)
    rates = rates_of(some)
    for k in range(len(SLOPES)):
        start, stop = float(some.start[k]), float(some.stop[k])
        work = coefficients(jnp.exp(control) * rates)[k, 0]
        assert work == pytest.approx(quad(np.exp, start, stop)[0], rel=1e-12)
        # Travel passes with the control.
        way = np.abs(control[k] - start)
        np.testing.assert_allclose(travel[k], some.travel[k, 0] + way, atol=EXACT)
        assert np.all(travel[k] < some.travel[k, 1])


def test_a_panel_in_which_the_drive_stands_still_is_not_used():
    travel = jnp.array([0.0, 1.0, 1.0 + 5e-12, 2.0, 2.0])
    none = jnp.zeros(5, int)
    slopes = jnp.arange(10.0).reshape(5, 2)
    ends = PanelEnds(
        jnp.array([0.5, -0.5, -0.5, 0.5, 0.5]), travel, slopes, none, none, none, none[0], jnp.asarray(1e-12)
    )
    some = panels_of(ends)
    assert some.used.tolist() == [True, False, True, False]
    np.testing.assert_array_equal(some.start, ends.control[:-1])
    np.testing.assert_array_equal(some.stop, ends.control[1:])
    np.testing.assert_array_equal(some.travel, [[0.0, 1.0], travel[1:3], travel[2:4], [2.0, 2.0]])
    np.testing.assert_array_equal(some.slopes, slopes[:4])


@jax.jit
def placed(start, stop, slopes, control):
    panel = Panel(start, stop, jnp.array([0.0, 1.0]), slopes, jnp.asarray(1e-12))
    return place_in(panel, control)


def test_a_place_is_the_inverse_of_the_share_with_its_derivatives():
    slopes, t = jnp.array([0.2, 2.5]), 0.37
    s, rate = share(jnp.asarray(t), slopes)
    # share = 3 t^2 - 2 t^3 + a (t - 2 t^2 + t^3) + b (t^3 - t^2)
    curvature = Polynomial([0.0, 0.2, 3.0 - 0.4 - 2.5, -2.0 + 0.2 + 2.5]).deriv(2)(t)
    at = (0.9, -1.1, slopes, 0.9 - 2.0 * s)
    assert placed(*at) == pytest.approx(t, abs=EXACT)
    reverse = jax.grad(placed, argnums=(0, 1, 3))
    (by_start, by_stop, by_control), (*_, second) = jax.jit(
        lambda *at: jax.jvp(lambda control: reverse(*at[:3], control), at[3:], (jnp.ones(()),))
    )(*at)
    expected = np.array([1 - s, s, -1.0]) / (2.0 * rate)
    np.testing.assert_allclose([by_start, by_stop, by_control], expected, atol=EXACT)
    assert second == pytest.approx(-curvature / (4.0 * float(rate) ** 3), rel=1e-9)


def test_a_control_outside_a_panel_is_placed_at_its_end():
    for control, t in ((1.5, 0.0), (0.9, 0.0), (-1.1, 1.0), (-3.0, 1.0)):
        assert placed(0.9, -1.1, jnp.array([1.0, 1.0]), control) == pytest.approx(t, abs=EXACT)
