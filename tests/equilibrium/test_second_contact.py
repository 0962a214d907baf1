"""Shafts before an object that they do not touch: circles at known distances from arcs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import second_contact
from jaxwhisker._equilibrium.clearance import DEPTH
from jaxwhisker._equilibrium.second_contact import CHORD
from shafts import points, shaft

SHALLOW, DEEP = -0.8 * DEPTH, -1.2 * DEPTH  # gaps on both sides of the limit; the cubics are better than 2e-6
BASE, TIP = -0.7, 0.5  # arc lengths from the contact
LANES = 24


def arc(curvature):
    return 0.1, 0.7, 1.8, curvature


def of_another(profile, own):
    """Whether a shaft that touches another object meets this one."""
    lowest = jnp.asarray(profile.lowest(), dtype=float)
    return second_contact.meets(profile, own, jnp.asarray(True), lowest, jnp.asarray(False))


@Program
def meets_circles(own, distance, radius, position):
    return jax.vmap(lambda *numbers: of_another(jw.Circle(*numbers), own))(distance, radius, position)


def circles_meet(curvature, s, side, gap, radius):
    """Whether circles meet the shaft that lie beside a place of it, at these gaps."""
    given = np.broadcast_arrays(s, side, gap, radius)
    s, side, gap, radius = (np.resize(values.astype(float), LANES) for values in given)
    x, y, phi = points(*arc(curvature), s)
    right, up = x + side * (radius + gap) * np.sin(phi), y - side * (radius + gap) * np.cos(phi)
    own = shaft(*arc(curvature), -BASE, TIP)
    return np.asarray(meets_circles(own, jnp.asarray(up - radius), jnp.asarray(radius), jnp.asarray(right)))


@pytest.mark.parametrize("curvature", [0.0, -1.3, 1.3])
def test_a_shaft_meets_a_circle_that_it_dips_into(curvature):
    # In the midst of cells and at points; the smallest circles fit between two points.
    s = np.array([-0.55, -0.3501, -0.01, 0.0, 0.05, 0.3137])
    radius = np.array([0.002, 0.02, 0.2])[:, None]
    for side in (1.0, -1.0):
        for gap in (0.1, SHALLOW):
            assert not circles_meet(curvature, s, side, gap, radius).any()
        assert circles_meet(curvature, s, side, DEEP, radius).all()
        assert circles_meet(curvature, s, side, -0.001, radius[1:]).all()


@Program
def meets_wedges(own, vertices):
    return jax.vmap(lambda one: of_another(jw.Polygon(one), own))(vertices)


@pytest.mark.parametrize("curvature", [0.0, -1.3])
@pytest.mark.parametrize("half_opening", [0.05, 0.4])
def test_a_corner_may_meet_a_shaft_between_two_of_its_points(curvature, half_opening):
    s = np.linspace(-0.55, 0.45, LANES)  # in the midst of cells and close to points
    x, y, phi = points(*arc(curvature), s)
    own = shaft(*arc(curvature), -BASE, TIP)
    for side in (1.0, -1.0):
        axis = side * np.stack([np.sin(phi), -np.cos(phi)])
        across = np.stack([axis[1], -axis[0]]) * np.tan(half_opening)
        # A straight shaft across a wedge is inside it by the dip of the corner times the sine of the half opening.
        for depth in (SHALLOW, DEEP, -0.3 * np.sin(half_opening)):
            corner = np.stack([x, y]) + depth / np.sin(half_opening) * axis
            vertices = np.stack([corner, corner + 0.4 * (axis + across), corner + 0.4 * (axis - across)])
            found = np.asarray(meets_wedges(own, jnp.asarray(np.moveaxis(vertices, 2, 0))))
            assert found.tolist() == [depth != SHALLOW] * LANES, (side, depth)


def test_beyond_its_ends_a_shaft_meets_nothing():
    s = np.array([TIP + 0.03, BASE - 0.03])
    assert not circles_meet(-1.3, s, 1.0, -0.02, 0.02).any()
    # ... but its ends may be inside an object.
    assert circles_meet(-1.3, s, 1.0, -0.032, 0.032).all()


def test_an_object_above_the_tip_is_not_met():
    assert not circles_meet(0.0, TIP + 1.0, 1.0, -0.05, 0.1).any()


@Program
def sides(own, distance, position):
    return jax.vmap(lambda q, x: second_contact.passes(jw.Circle(q, 0.1, x), own))(distance, position)


def test_the_side_on_which_a_shaft_passes_the_lowest_point():
    own = shaft(*arc(-1.3), -BASE, TIP)
    s = np.array([-0.55, -0.35, -0.01, 0.0, 0.2, 0.45])
    x, y, _ = points(*arc(-1.3), s)
    for away, expected in ((-2 * CHORD, 1.0), (2 * CHORD, -1.0), (0.0, 0.0), (0.5 * CHORD, 0.0)):
        assert sides(own, jnp.asarray(y), jnp.asarray(x + away)).tolist() == [expected] * 6
    # Above its tip and below its base nobody is passed.
    ends = np.resize([np.max(points(*arc(-1.3), np.array([TIP]))[1]) + 0.01, y[0] - 0.3], 6)
    assert sides(own, jnp.asarray(ends), jnp.asarray(x - 1.0)).tolist() == [0.0] * 6


@Program
def looks(own, distance, radius, position, parameter):
    def one(*numbers, parameter):
        circle, yes = jw.Circle(*numbers), jnp.asarray(True)
        looks = (second_contact.dips, second_contact.may_meet, second_contact.meets)
        return jnp.stack([look(circle, own, yes, parameter) for look in looks])

    return jax.vmap(lambda *numbers: one(*numbers[:3], parameter=numbers[3]))(distance, radius, position, parameter)


def test_a_closer_look_finds_all_contacts_and_clears_most_shafts():
    # Circles that touch an arc at s = 0, curved more or less than the arc, on either side of it.
    x, y, phi = points(*arc(1.3), np.zeros(LANES))
    radius = np.geomspace(0.05, 3.0, LANES)
    met = []
    for side in (1.0, -1.0):
        right, up = x + side * radius * np.sin(phi), y - side * radius * np.cos(phi)
        slope = np.arctan2(x - right, up - y)  # of the circle at the contact: its parameter
        own = shaft(*arc(1.3), -BASE, TIP)
        dips, may_meet, meets = np.asarray(looks(own, *map(jnp.asarray, (up - radius, radius, right, slope)))).T
        # The smallest circles turn too much within a part of a cell, but lie on one side of their tangents.
        assert not np.any(meets & ~(may_meet & dips))
        assert np.array_equal(may_meet[radius > 0.25], meets[radius > 0.25])
        assert np.all(dips) == np.any(meets)
        met.append(meets)
    # The arc curves away from one of the circles, and around the other one if that is larger than its own.
    assert sorted(map(tuple, met)) == sorted([(False,) * LANES, tuple(radius > 1 / 1.3)])
