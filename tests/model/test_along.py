"""Functions along a whisker against numpy, closed forms and quadrature."""

# pyright: reportArgumentType=false, reportOptionalOperand=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.integrate import quad

import jaxwhisker as jw
from jaxwhisker._model.along import LinearTaper, ParabolicShape, RoundMass, RoundSection, as_breaks

EXACT = 1e-13  # of numbers of order 1

ROWS, VALUES = np.array([0.0, 0.3, 0.3, 0.5, 1.0]), np.array([1.0, 2.5, 0.5, 0.7, -0.3])  # with a jump at 0.3


@jax.jit
def read(rows, values, s):
    return jax.vmap(jw.Table(rows, values))(s)


def test_a_table_is_linear_between_rows_and_continues_beyond_them():
    between = np.array([0.0, 0.1, 0.29, 0.31, 0.42, 0.5, 0.77, 1.0])
    np.testing.assert_allclose(read(ROWS, VALUES, between), np.interp(between, ROWS, VALUES), atol=EXACT)
    beyond = read(ROWS, VALUES, np.array([-0.2, 1.5]))
    np.testing.assert_allclose(beyond, [1.0 - 0.2 * 5.0, -0.3 - 0.5 * 2.0], atol=EXACT)


def test_a_jump_in_a_table_has_the_value_from_below():
    np.testing.assert_allclose(read(ROWS, VALUES, np.array([0.3, 0.3 + 1e-14])), [2.5, 0.5], atol=EXACT)


def test_a_table_has_the_derivatives_of_its_lines():
    at = np.array([0.1, 0.3, 0.4])
    for mode in (jax.jacfwd, jax.jacrev):
        by_rows, by_values, by_s = jax.jit(mode(read, argnums=(0, 1, 2)))(ROWS, VALUES, at)
        # Between rows 0 and 1 at 1/3 and at the end, and between rows 2 and 3 in the middle.
        weights = [[2 / 3, 1 / 3, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0.5, 0.5, 0]]
        slopes = np.array([5.0, 5.0, 1.0])
        np.testing.assert_allclose(by_values, weights, atol=EXACT)
        np.testing.assert_allclose(by_rows, -slopes[:, None] * weights, atol=EXACT)
        np.testing.assert_allclose(by_s, np.diag(slopes), atol=EXACT)


def test_a_polynomial_begins_at_the_base_and_ends_with_the_sum_of_its_coefficients():
    coefficients, s = np.array([0.4, -1.5, 0.0, 2.0]), np.linspace(0.0, 2.5, 7)
    found = jax.vmap(jw.Polynomial(coefficients, 2.5))(s)
    np.testing.assert_allclose(found, np.polynomial.Polynomial(coefficients)(s / 2.5), atol=EXACT)
    np.testing.assert_allclose([found[0], found[-1]], [0.4, 0.9], atol=EXACT)
    reverse = jax.jacrev(lambda c, length, s: jw.Polynomial(c, length)(s), argnums=(0, 1, 2))
    slopes = jax.jit(reverse)(coefficients, 2.5, 1.5)
    rate = (-1.5 + 6.0 * 0.6**2) / 2.5
    for slope, expected in zip(slopes, (0.6 ** np.arange(4), -0.6 * rate, rate), strict=True):
        np.testing.assert_allclose(slope, expected, atol=EXACT)


def test_round_sections_are_integrals_over_a_circle():
    diameter, s, r = LinearTaper(0.8, 0.2, 3.0), 1.0, 0.3
    area = quad(lambda y: 2 * np.sqrt(r**2 - y**2), -r, r)[0]
    inertia = quad(lambda y: 2 * y**2 * np.sqrt(r**2 - y**2), -r, r)[0]
    assert diameter(s) == pytest.approx(2 * r) and (diameter(0.0), diameter(3.0)) == pytest.approx((0.8, 0.2))
    linear = LinearTaper(7.0, 10.0, 3.0)
    for value in (8.0, linear):
        assert RoundSection(value, diameter)(s) == pytest.approx(8.0 * inertia, rel=1e-7)
        assert RoundMass(value, diameter)(s) == pytest.approx(8.0 * area, rel=1e-7)
    assert RoundSection(2.0, 0.6)(s) == pytest.approx(2 * inertia, rel=1e-7)


def test_breaks_are_one_array_or_none():
    assert as_breaks(None) is None and as_breaks(()) is None and as_breaks([]) is None
    np.testing.assert_array_equal(as_breaks((0.2, 1)), [0.2, 1.0])
    np.testing.assert_array_equal(jax.jit(lambda at: as_breaks((at, 2 * at, 3)))(0.5), [0.5, 1.0, 3.0])
    assert jax.grad(lambda at: as_breaks([at, 2 * at]) @ jnp.array([1.0, 10.0]))(0.5) == 21.0


@pytest.mark.parametrize("coefficient", [24.0, -24.0])
def test_the_curvature_of_a_parabola_along_its_arc(coefficient):
    x = np.array([-0.01, 0.0, 1e-9, 1e-3, 0.02, 0.0625])  # the last one where the slope is 3
    nodes, weights = np.polynomial.legendre.leggauss(80)
    arc = np.hypot(1.0, coefficient * np.outer(x, 1 + nodes)) @ weights * x / 2
    expected = 2 * coefficient / np.hypot(1.0, 2 * coefficient * x) ** 3
    found = jax.jit(jax.vmap(ParabolicShape(coefficient)))(jnp.array(arc))
    np.testing.assert_allclose(found, expected, rtol=EXACT)
    assert ParabolicShape(0.0)(0.5) == 0.0


def test_derivatives_of_a_parabola():
    def curvature(coefficient, s):
        return ParabolicShape(coefficient)(s)

    for at in (0.0, 0.7):
        check_grads(curvature, (0.4, at), order=2, modes=("fwd", "rev"))
    # kappa = 2 A (1 - 6 A^2 s^2 + ...)
    np.testing.assert_allclose(jax.grad(jax.grad(curvature, 1), 1)(0.4, 0.0), -24 * 0.4**3, rtol=EXACT)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Table([0.0], [1.0]), r"`values` must be two or more numbers, one per row \(1\), got 1"),
        (lambda: jw.Table([0.0, 1.0], [1.0, 2.0, 3.0]), r"`values` must be two or more numbers, one per row \(2\)"),
        (lambda: jw.Table([0.0, 2.0, 1.0], [1.0, 2.0, 3.0]), "`s` must be in ascending order"),
        (lambda: jw.Polynomial([1.0], 0.0), "`length` must be a positive"),
        (lambda: jw.Polynomial(1.0, 1.0), "`coefficients` must be"),
        (lambda: as_breaks("0.2"), "`breaks` must be"),
    ],
)
def test_wrong_values_name_the_argument(make, message):
    with pytest.raises(ValueError, match=message):
        make()
