"""Conic sections: one curve for parabolas, circles, ellipses and hyperbolas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._model.conic import Conic, conic

EXACT = 1e-12  # sums of a few numbers of size 1
NEAR_TOP = 1e-9  # far above the widest point of a closed curve, heights are differences of nearly equal numbers
SIZE, HEIGHT, PLACE = 0.4, 0.2, -0.1
SHAPES = {"parabola": 0.0, "circle": 1.0, "flat ellipse": 40.0, "steep ellipse": 0.03, "hyperbola": -0.7}


def curve(shape):
    return conic(HEIGHT, SIZE, shape, PLACE)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_points_satisfy_the_equation_and_slopes_are_those_of_the_curve(shape):
    for parameter in (-1.3, -0.4, 1e-6, 0.8, *([2.0, -3.0] if shape > 0 else [])):
        at = curve(shape).point(jnp.asarray(parameter))
        if shape < 0 and abs(np.tan(parameter)) > 1 / np.sqrt(-shape):
            continue  # steeper than the asymptotes
        x, y = at.x - PLACE, at.y - HEIGHT
        assert abs(x**2 - 2 * SIZE * y + shape * y**2) < EXACT * (1 + y)
        rate_x, rate_y = jax.jacfwd(lambda p: jnp.stack(curve(shape).point(p)[:2]))(jnp.asarray(parameter))
        speed = np.hypot(rate_x, rate_y)
        np.testing.assert_allclose([at.cos, at.sin], [rate_x / speed, rate_y / speed], atol=EXACT)
        np.testing.assert_allclose(curve(shape).speed(parameter), speed, rtol=NEAR_TOP)


def derivatives(formula):
    """Programs for derivatives of points of all shapes by everything but the shape itself, and by a factor of it."""

    def point(numbers, shape):
        distance, radius, factor, position, parameter = numbers
        return jnp.stack(formula(conic(distance, radius, shape * factor, position), parameter))

    first, second = (
        (jax.jacfwd(point), jax.jacrev(point)),
        (jax.jacfwd(jax.jacrev(point)), jax.jacrev(jax.jacfwd(point))),
    )
    return [jax.jit(derivative) for derivative in (*first, *second)]


OURS, PLAIN = derivatives(Conic.point), derivatives(Conic._point)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_derivatives_of_points_are_those_of_the_formulas(shape):
    for parameter in (-1.3, 0.0, 0.4, 1.7):
        numbers = jnp.asarray([HEIGHT, SIZE, 1.0, PLACE, parameter])
        at = curve(shape)
        assert all(a == b or np.isnan(a) for a, b in zip(at.point(parameter), at._point(parameter), strict=True))
        for ours, plain in zip(OURS, PLAIN, strict=True):
            np.testing.assert_allclose(ours(numbers, shape), plain(numbers, shape), rtol=NEAR_TOP, atol=NEAR_TOP)


def test_classes_are_conics_with_their_own_numbers():
    parabola, circle, ellipse = jw.Parabola(0.3, 2.0, 0.4), jw.Circle(0.2, 0.7, -0.1), jw.Ellipse(0.2, 0.5, 0.9, 1.0)
    for parameter in (-1.2, 0.3, 1.5):
        x, y, cos, sin = parabola.point(parameter)
        np.testing.assert_allclose([y - 0.3, sin / cos], [2.0 * (x - 0.4) ** 2, 4.0 * (x - 0.4)], rtol=EXACT)
        x, y, cos, sin = circle.point(parameter)
        np.testing.assert_allclose([x + 0.1, 0.9 - y], [0.7 * sin, 0.7 * cos], atol=EXACT)
        x, y, _, _ = ellipse.point(parameter)
        np.testing.assert_allclose(((x - 1.0) / 0.5) ** 2 + ((y - 1.1) / 0.9) ** 2, 1.0, rtol=EXACT)


def test_first_touches_and_places_beside_are_where_the_curve_has_this_height():
    for shape in SHAPES.values():
        widest = SIZE / shape if shape > 0 else np.inf
        for side in (1.0, -1.0):
            for rise in (0.1 * min(widest, 1.0), 0.5 * min(widest, 1.0), 1.2 * widest):
                if not np.isfinite(rise):
                    continue
                touch, above = (f(HEIGHT + rise, side) for f in (curve(shape).first_touch, curve(shape).above_widest))
                assert abs(touch.y - HEIGHT - min(rise, widest)) < EXACT
                assert abs(above.y - HEIGHT - min(rise, 2 * widest)) < EXACT
                for found in (touch, above):
                    at = curve(shape).point(found.parameter)
                    np.testing.assert_allclose([found.x, found.y], [at.x, at.y], atol=EXACT)
                    assert side * (found.x - PLACE) > -EXACT


def test_out_of_reach_a_first_touch_is_finite():
    for shape in SHAPES.values():
        assert np.isfinite(jax.tree.leaves(curve(shape).first_touch(HEIGHT - 0.1, 1.0))).all()


def test_slopes_and_lowest_points_are_found_without_iteration():
    for shape in SHAPES.values():
        for slope in (-1.0, 0.0, 0.5):
            at = curve(shape).point(curve(shape).at_slope(slope))
            np.testing.assert_allclose(jnp.arctan2(at.sin, at.cos), slope, atol=EXACT)
        lowest = curve(shape).point(curve(shape).lowest())
        np.testing.assert_array_equal([lowest.x, lowest.y], [PLACE, HEIGHT])


def test_a_parabola_goes_on_beyond_a_vertical_tangent():
    # Newton's method may step there, and comes back from finite values.
    x, y, _, _ = curve(0.0).point(jnp.asarray(1.7))
    np.testing.assert_allclose([x - PLACE, y - HEIGHT], [SIZE * np.tan(1.7), SIZE * np.tan(1.7) ** 2 / 2], rtol=1e-10)


def test_the_derivative_of_the_width_by_the_shape():
    rise = 0.15  # at which x = sqrt(y (2 R - k y))
    for shape in SHAPES.values():
        x, by_shape = jax.jvp(lambda k: conic(HEIGHT, SIZE, k, 0.0).first_touch(HEIGHT + rise, 1.0).x, (shape,), (1.0,))
        if rise < SIZE / max(shape, 1e-9):
            np.testing.assert_allclose(by_shape, -(rise**2) / (2 * x), rtol=EXACT)


def test_scenes_with_any_conic_share_their_programs():
    profiles = jw.Parabola(0.2), jw.Circle(0.2, 0.5), jw.Ellipse(0.2, 0.5, 0.3)
    problems = [problem_of(jw.Scene(jw.Whisker(), profile, jw.Support.fb(70.0))) for profile in profiles]
    structures = [(jax.tree.structure(problem), [x.shape for x in jax.tree.leaves(problem)]) for problem in problems]
    assert structures[0] == structures[1] == structures[2]
    assert [type(problem.profile) for problem in problems] == [Conic] * 3


def test_whether_a_curve_is_closed_is_a_number():
    for shape in SHAPES.values():
        assert bool(curve(shape).closed) == (shape > 0)
        np.testing.assert_allclose(curve(shape).span()[1], np.pi if shape > 0 else curve(shape).ends()[1])
