"""Canonical forms of scenes: shapes that scenes share, and the scenes that they stand for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._base.program import _split
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._model.canonical import canonical
from scenes import model

EXACT = 1e-14  # one rounding
WHISKER, PARABOLA, FB = jw.Whisker(), jw.Parabola(0.2, 1.5, 0.1), jw.Support.fb(70.0, 0.2)
TRIANGLE = jw.Polygon([(-0.5, 0.6), (0.0, 0.2), (0.5, 0.6)])
HEXAGON = jw.Polygon([(-0.5, 0.6), (-0.3, 0.3), (0.0, 0.2), (0.3, 0.3), (0.5, 0.6), (0.0, 0.9)])
OCTAGON_AND_ONE = jw.Polygon([(np.sin(a), 1.2 - np.cos(a)) for a in 2 * np.pi * (np.arange(9) - 4) / 9])
LEFT = jw.Translation(direction=1)


def shape_of(scene):
    return _split((canonical(jax.tree.map(checks.as_float, scene)),))[0]


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (jw.Scene(WHISKER, PARABOLA, FB), jw.Scene((WHISKER,), jw.Ellipse(0.2, 0.5, 0.3), motion=LEFT), True),
        (model("FBFB"), model("FBFBR"), True),
        (model("FBFB"), model("FBFBFBR"), False),
        (jw.Scene(WHISKER, TRIANGLE), jw.Scene(WHISKER, HEXAGON), True),
        (jw.Scene(WHISKER, TRIANGLE), jw.Scene(WHISKER, OCTAGON_AND_ONE), False),
        (jw.Scene(WHISKER, PARABOLA), jw.Scene(WHISKER, PARABOLA, friction=0.3), False),
        (jw.Scene(WHISKER, PARABOLA), jw.Scene(WHISKER, TRIANGLE), False),
        (
            jw.Scene(WHISKER, jw.Tilted(PARABOLA, 0.1), jw.Support.follicle(x=9.0)),
            jw.Scene(WHISKER, jw.Tilted(jw.Circle(0.2, 0.5), 0.1), jw.Support.follicle(x=9.0, y=9.0)),
            False,  # without a spring along y, the base moves along x only
        ),
        (
            jw.Scene(WHISKER, jw.Tilted(PARABOLA, 0.1), jw.Support.follicle(phi=9.0)),
            jw.Scene(WHISKER, jw.Tilted(jw.Circle(0.2, 0.5), 0.1), jw.Support.follicle(x=9.0, y=9.0)),
            True,
        ),
    ],
)
def test_scenes_that_differ_in_numbers_have_one_shape(first, second, same):
    assert (shape_of(first) == shape_of(second)) == same


def test_masses_and_detection_are_left_out():
    heavy = jw.Whisker(mass_per_length=2.0, tip_mass=0.1, base_mass=2.0, base_inertia=0.3)
    scene = jw.Scene((heavy, WHISKER), PARABOLA, jw.Support.fbfb(70.0), detect="crossing")
    assert canonical(scene).whiskers == (WHISKER, WHISKER)
    assert shape_of(scene) == shape_of(jw.Scene(WHISKER, PARABOLA, jw.Support.fbfb(70.0)))


@pytest.mark.parametrize("profile", [PARABOLA, jw.Circle(0.2, 0.5, -0.1), jw.Ellipse(0.2, 0.5, 0.3, 0.1)], ids=str)
def test_conic_sections_keep_their_points(profile):
    same = profile.canonical()
    for parameter in (-0.9, 0.0, 0.4):
        np.testing.assert_allclose(same.point(parameter), profile.point(parameter), rtol=EXACT, atol=EXACT)
    assert same.valid() and str(same.conic()) == str(same)


def test_problems_have_the_derivatives_of_the_numbers_that_users_give():
    def lengths(radius):
        problem = problem_of(jw.Scene(WHISKER, jw.Circle(0.2, radius), jw.Support.fbfb([radius, 2.0])))
        return jnp.stack([problem.profile.radius, *jnp.ravel(problem.flexibility.matrix)])  # pyright: ignore

    # The flexibility of the first spring is felt by both bases, that of the second one by its own.
    slopes = jax.jit(jax.jacfwd(lengths))(0.5)
    np.testing.assert_allclose(slopes, [1.0, -4.0, -4.0, -4.0, -4.0], rtol=EXACT)


@pytest.mark.parametrize("height", [0.25, 0.4, 0.55, 0.9])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("polygon", [TRIANGLE, HEXAGON], ids=str)
def test_repeated_corners_change_nothing(polygon, side, height):
    plain, filled = polygon.chain(), polygon.canonical().in_unit(1.0)
    assert filled.xy.shape[0] == 8 and filled.count == plain.count
    for of in ("first_touch", "above_widest"):
        np.testing.assert_allclose(getattr(filled, of)(height, side), getattr(plain, of)(height, side), atol=EXACT)
    np.testing.assert_allclose(filled.ends(), plain.ends(), atol=EXACT)
    np.testing.assert_allclose(filled.vertex(), plain.vertex(), atol=EXACT)
    for slope in (-2.9, -0.4, 0.0, side * 0.7, 3.0):
        np.testing.assert_allclose(filled.at_slope(slope), plain.at_slope(slope), atol=EXACT)
        parameter = plain.at_slope(slope)
        np.testing.assert_allclose(filled.point(parameter), plain.point(parameter), atol=EXACT)
    off = filled.faces().off(jnp.asarray(0.1), jnp.asarray(height - 1.0))
    np.testing.assert_allclose(
        np.max(off), np.max(plain.faces().off(jnp.asarray(0.1), jnp.asarray(height - 1.0))), atol=EXACT
    )


def test_a_repeated_corner_is_no_side_of_a_polygon_out_of_order():
    wrong = np.asarray(HEXAGON.vertices)[[0, 2, 1, 3, 4, 5]]
    good = HEXAGON.canonical()
    assert good.valid() and not type(good)(jnp.asarray(wrong)[np.minimum(np.arange(8), 5)], good.count).valid()
