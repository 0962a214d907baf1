"""First touches of unloaded whiskers: straight, leaning, curved."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import touch
from jaxwhisker._rod.rod import Section

SEARCHED = 1e-10  # promised of a first touch that is searched
ROUNDING = 1e-14
POLYLINE = 1e-8  # position of a polyline of 200,000 points
FINE = 1e-7  # position of the polylines of a smooth object of 200,000 points and a whisker of 20,000
TABLE = 1e-9  # position of a circular arc in the outline's table

PARABOLA = jw.Parabola(0.2)
straight = partial(touch.outline, section=None)


def arc(length, curvature):
    """The outline of a whisker of constant curvature."""
    s = np.linspace(0.0, length, touch.POINTS)
    turn = curvature * s
    return touch.Outline(
        *map(jnp.asarray, ((np.cos(turn) - 1) / curvature, np.sin(turn) / curvature, -np.sin(turn), np.cos(turn)))
    )


@Program
def first_touch(profile, length, own, y, angle, side):
    return touch.first_touch(profile, length, own, y, angle, side)


@pytest.mark.parametrize("length", [0.15, 0.7, 1.3])
@pytest.mark.parametrize("profile", [PARABOLA, jw.Circle(0.2, 0.3, 0.1)], ids=str)
def test_an_upright_straight_whisker(profile, length):
    length = jnp.asarray(length)
    for side in (1.0, -1.0):
        expected = touch.first_touch_upright(profile, length, side)
        found = first_touch(profile, length, straight(length), jnp.asarray(0.0), jnp.asarray(0.0), jnp.asarray(side))
        assert found.reaches == expected.reaches == (length > 0.2)
        assert found.side == expected.side == side
        if length > 0.2:
            np.testing.assert_allclose(found.x, expected.x, atol=SEARCHED)
            np.testing.assert_allclose(found.parameter, expected.parameter, atol=SEARCHED)
            np.testing.assert_allclose(found.slack, expected.slack, atol=SEARCHED)


def test_upright_touches_of_tip_and_shaft():
    tip = touch.first_touch_upright(PARABOLA, jnp.asarray(1.0), 1.0)
    np.testing.assert_allclose(tip.x, np.sqrt(0.8), rtol=ROUNDING)
    # The slack is minus the angle between the upright whisker and the object.
    np.testing.assert_allclose(tip.slack, np.arctan(2 * np.sqrt(0.8)) - np.pi / 2, rtol=ROUNDING)
    # A circle is widest at its centre, 0.5 above the bases: the shaft meets it there, and 0.8 stand above.
    shaft = touch.first_touch_upright(jw.Circle(0.2, 0.3, 0.1), jnp.asarray(1.3), -1.0)
    np.testing.assert_allclose([shaft.x, shaft.slack], [0.1 - 0.3, 0.8], atol=ROUNDING)
    assert not touch.first_touch_upright(PARABOLA, jnp.asarray(0.2), 1.0).reaches


def leaning(angle, side, y=0.0):
    length = jnp.asarray(1.0)
    return first_touch(PARABOLA, length, straight(length), jnp.asarray(y), jnp.asarray(angle), jnp.asarray(side))


def test_a_whisker_that_leans_towards_the_object_touches_with_its_tip():
    for side in (1.0, -1.0):
        found = leaning(side * 0.4, side, y=0.1)
        height = 0.1 + np.cos(0.4)
        x = np.sqrt(height - 0.2)
        np.testing.assert_allclose(found.x, side * (x + np.sin(0.4)), atol=SEARCHED)
        # Whisker and object enclose the angle between their directions.
        np.testing.assert_allclose(found.slack, -(np.pi / 2 + 0.4 - np.arctan(2 * x)), atol=SEARCHED)
        assert found.side == side


def test_a_whisker_that_leans_far_back_touches_along_its_shaft():
    # Where the parabola is as steep as the whisker: 2 x = cot(1).
    x = 1 / np.tan(1.0) / 2
    y = 0.2 + x**2
    for side in (1.0, -1.0):
        found = leaning(-side, side)
        np.testing.assert_allclose(found.x, side * (x - y * np.tan(1.0)), atol=SEARCHED)
        np.testing.assert_allclose(found.slack, 1 - y / np.cos(1.0), atol=SEARCHED)
        np.testing.assert_allclose(found.parameter, side * np.arctan(2 * x), atol=SEARCHED)


def test_a_curved_whisker_touches_without_entering_the_object():
    own, length, y, angle = arc(1.0, -1.2), jnp.asarray(1.0), 0.05, -0.3
    found = first_touch(PARABOLA, length, own, jnp.asarray(y), jnp.asarray(angle), jnp.asarray(1.0))
    assert found.reaches and found.slack > 0
    s = np.linspace(0.0, 1.0, 20001)
    turn = angle - 1.2 * s
    shift = [(np.cos(turn) - np.cos(angle)) / -1.2, (np.sin(turn) - np.sin(angle)) / -1.2]
    clearance = 0.2 + (found.x + shift[0]) ** 2 - (y + shift[1])
    assert np.min(clearance) > -TABLE
    nearest = np.argmin(clearance)
    assert clearance[nearest] < TABLE
    assert abs(s[nearest] - (1 - found.slack)) < 1e-3  # the clearance is flat there: its root


CLOSED = {
    "circle": jw.Circle(0.3, 0.25, 0.05),
    "upright ellipse": jw.Ellipse(0.31, 0.07, 0.3),
    "flat ellipse": jw.Ellipse(0.55, 0.3, 0.04),
    "tilted ellipse": jw.Tilted(jw.Ellipse(0.3, 0.1, 0.3), 0.3, about=(0.0, 0.6)),
    "tilted box": jw.Tilted(jw.Box(0.3, 0.3, 0.4), 0.4, about=(0.0, 0.5)),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_curved_whisker_may_touch_above_the_widest_place_of_an_object(name):
    profile, own, length = CLOSED[name], arc(1.0, 1.0), jnp.asarray(1.0)
    left_end, right_end = profile.span()
    outline = jax.vmap(profile.point)(jnp.linspace(left_end, right_end, 200_001))
    outline_x, outline_y = np.asarray(outline.x), np.asarray(outline.y)
    s = np.linspace(0.0, 1.0, 20_001)
    for side in (1.0, -1.0):
        zero = jnp.asarray(0.0)
        found = first_touch(profile, length, own, zero, zero, jnp.asarray(side))
        x, y = (np.cos(s) - 1), np.sin(s)
        # Where each point of the whisker meets the outer side of the object in an approach along x.
        climbs = side * np.asarray(outline.sin) > 0
        order = np.argsort(outline_y[climbs])
        at = np.interp(y, outline_y[climbs][order], side * outline_x[climbs][order], left=-np.inf, right=-np.inf)
        first = np.argmax(at - side * x)
        assert found.reaches
        np.testing.assert_allclose(side * found.x, (at - side * x)[first], atol=s[1] if profile.has_edges else FINE)
        if side > 0:  # with the tip, or with the shaft at this distance from it
            assert y[first] > outline_y[np.argmax(outline_x)]
            assert abs(max(float(found.slack), 0.0) - (1 - s[first])) < 1e-3


def test_only_a_strongly_curved_whisker_touches_in_two_places():
    narrow, y = jw.Parabola(0.2, 20.0), jnp.asarray(0.19)
    in_two_places = Program(touch.in_two_places)
    # It leans back from a base close to the vertex, and its tip bends towards the object again.
    for side in (1.0, -1.0):
        angle = jnp.asarray(-side * 0.7)
        assert in_two_places(narrow, arc(1.0, side * 1.4), y, angle)
        assert not in_two_places(narrow, straight(jnp.asarray(1.0)), y, angle)
        assert not in_two_places(narrow, arc(1.0, side * 0.1), y, angle)
        assert not in_two_places(PARABOLA, arc(1.0, side * 1.4), y, jnp.asarray(0.0))


def test_outlines():
    one = jnp.asarray(1.0)
    section = Section(1.0, 0.9, one, one, one)
    own = Program(touch.outline)(jnp.asarray(0.8), section)
    for value, expected in zip(own, arc(0.8, 0.9), strict=True):
        np.testing.assert_allclose(value, expected, atol=TABLE)
    np.testing.assert_allclose(straight(jnp.asarray(0.8)).y, np.linspace(0, 0.8, touch.POINTS), atol=ROUNDING)


def test_both_sides_at_once():
    args = PARABOLA, jnp.asarray(1.0), arc(1.0, 0.8), jnp.asarray(0.0), jnp.asarray(0.1)
    right, left = Program(touch.first_touches)(*args)
    for found, side in ((right, 1.0), (left, -1.0)):
        alone = first_touch(*args, jnp.asarray(side))
        np.testing.assert_allclose(jnp.stack(jax.tree.leaves(found)), jnp.stack(jax.tree.leaves(alone)), atol=SEARCHED)


def hook(s):
    """Curvature of a whisker whose tip bends far over."""
    return 0.765 - 4.324 * s


@pytest.mark.parametrize("distance", [0.407, 0.444, 0.494, 0.519, 0.556])
def test_a_hooked_whisker(distance):
    # From the left, its tip touches the object higher than where it is widest.
    profile = jw.Circle(distance, 0.278, 0.93)
    section = jw.Whisker(1.0, 1.0, intrinsic_curvature=hook).section(1.0, 1.0)
    own, zero = touch.outline(jnp.asarray(1.0), section), jnp.asarray(0.0)
    right, left = (first_touch(profile, jnp.asarray(1.0), own, zero, zero, jnp.asarray(s)) for s in (1.0, -1.0))
    s = np.linspace(0.0, 1.0, 200_001)
    turn = np.pi / 2 + 0.765 * s - 4.324 * s**2 / 2
    x, y = (np.append(0.0, np.cumsum((f[1:] + f[:-1]) / 2 * s[1])) for f in (np.cos(turn), np.sin(turn)))
    half_width = np.sqrt(np.maximum(0.278**2 - (y - distance - 0.278) ** 2, 0.0))
    level = half_width > 0
    np.testing.assert_allclose(right.x, np.max((0.93 + half_width - x)[level]), atol=POLYLINE)
    np.testing.assert_allclose(left.x, np.min((0.93 - half_width - x)[level]), atol=POLYLINE)
    assert left.slack < 0 < right.slack


def test_a_hooked_whisker_is_not_overlooked():
    result = jw.scan(
        jw.Scene(jw.Whisker(intrinsic_curvature=hook), jw.Circle(0.494, 0.278, 0.93)), jnp.linspace(1.3, 0.4, 10)
    )
    assert [e.kind.name for e in result.events] == ["touch", "vertex"]
    assert np.all(np.asarray(result.status) == jw.Status.ok) and float(np.min(result.mz[2:])) > 0.1
