"""Clearance: nearest points and gaps in closed form, and shafts that cross as their polylines do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import clearance
from jaxwhisker._equilibrium.clearance import DEPTH, NEAREST_ERROR
from jaxwhisker._equilibrium.shaft import Shaft
from shafts import line, points, shaft

GAP = 1e-8  # of the cubic between two points, for a distance that is nearly a parabola
ROUNDING = 1e-12

CENTRE, RADIUS = np.array([0.1, 0.9]), 0.5
CIRCLE = jw.Circle(CENTRE[1] - RADIUS, RADIUS, CENTRE[0])
PARABOLA = jw.Parabola(0.2, 1.3, -0.1)

nearest = Program(clearance.nearest)


def test_the_nearest_points_of_a_circle_lie_towards_its_centre():
    random = np.random.default_rng(3)
    towards, distance = random.uniform(-1.5, 1.5, 12), random.uniform(0.3, 2.0, 12)
    x, y = CENTRE[:, None] + distance * np.array([np.sin(towards), -np.cos(towards)])
    wanted = np.arange(12) != 5
    feet = nearest(CIRCLE, jnp.asarray(0.4), jnp.asarray(x), jnp.asarray(y), jnp.asarray(wanted))
    # The parameter of a circle is its slope angle.
    np.testing.assert_allclose(feet[wanted], towards[wanted], atol=2 * NEAREST_ERROR / RADIUS)
    assert feet[5] == 0.4


def test_the_nearest_points_of_a_parabola_are_roots_of_a_cubic():
    random = np.random.default_rng(4)
    x, y = random.uniform(-1.5, 1.5, 12), random.uniform(-1.0, 0.2, 12)  # below, where each has one nearest point
    every = jnp.ones(12, bool)
    feet = nearest(PARABOLA, jnp.asarray(0.2), jnp.asarray(x), jnp.asarray(y), every)
    for px, py, foot in zip(x + 0.1, y - 0.2, feet, strict=True):
        roots = np.roots([2 * 1.3**2, 0.0, 1 - 2 * 1.3 * py, -px])
        (root,) = roots[np.abs(roots.imag) < 1e-9].real
        np.testing.assert_allclose(np.tan(foot) / 2.6, root, atol=NEAREST_ERROR)


@Program
def dips(profile, own):
    return clearance.dips(profile, own.parameter, (own.to_base, own.to_tip)), clearance.meets_again(profile, own)


def on_circle(angle, curvature, to_base, to_tip):
    """A shaft that touches the circle tangentially."""
    x, y = CENTRE + RADIUS * np.array([np.sin(angle), -np.cos(angle)])
    return shaft(x, y, angle, curvature, to_base, to_tip, angle)


def test_a_shaft_that_is_less_curved_than_the_object_meets_it_once():
    for curvature in (0.0, -1.0, 1.9):
        gaps, again = dips(CIRCLE, on_circle(0.6, curvature, 0.8, 0.4))
        assert not again and np.all(np.concatenate(gaps) == np.inf)


@pytest.mark.parametrize("part", [0, 1])
def test_a_shaft_that_is_more_curved_than_the_object_dips_into_it(part):
    curvature, lengths = 2.005, [(0.5, 0.02), (0.02, 0.5)][part]
    own = on_circle(0.6, curvature, *lengths)
    gaps, again = dips(CIRCLE, own)
    # On the arc of the shaft, the distance from the object's centre falls steadily.
    t = np.array([own.to_base, own.to_tip][part].x), np.array([own.to_base, own.to_tip][part].y)
    depth = np.hypot(t[0] - CENTRE[0], t[1] - CENTRE[1]) - RADIUS
    expected = np.where(depth[1:] < -DEPTH, depth[1:], np.inf)
    assert again and 3 < np.sum(expected < 0) < expected.size
    np.testing.assert_allclose(gaps[part], expected, atol=GAP)
    assert np.all(np.asarray(gaps[1 - part]) == np.inf)


@pytest.mark.parametrize(("depth", "meets"), [(0.7 * DEPTH, False), (1.3 * DEPTH, True)])
def test_a_dip_between_two_points_is_not_overlooked(depth, meets):
    # A straight line, whose only points inside are around its middle, passes the centre at this depth.
    half = np.sqrt(RADIUS**2 - (RADIUS - depth) ** 2)
    x = CENTRE[0] + np.array([-4.5, -1.5, 1.4, 4.5]) * half
    own = line(x, np.full(4, CENTRE[1] - RADIUS + depth), np.zeros(4), np.diff(x))
    gaps, _ = dips(CIRCLE, Shaft(own, own, np.float64(0.0), None))  # pyright: ignore[reportArgumentType]
    inside = np.asarray(gaps[0]) < np.inf
    assert inside.tolist() == [False, meets, False]
    if meets:
        np.testing.assert_allclose(gaps[0][1], -depth, atol=GAP)


LANES = 40  # in which shafts are compared: one program for all


@Program
def in_either_order(one, others):
    return jax.vmap(lambda other: (clearance.cross(one, other), clearance.cross(other, one)))(others)


def cross(one, others):
    """Whether a shaft crosses each of the others, which does not depend on the order."""
    lanes = jax.tree.map(lambda *leaves: np.resize(np.stack(leaves), (LANES, *leaves[0].shape)), *others)
    found, swapped = in_either_order(one, lanes)
    np.testing.assert_array_equal(found, swapped)
    return found[: len(others)].tolist()


def polyline(own, curvature):
    """Many points of a shaft of constant curvature, from base to tip."""
    phi = np.arctan2(own.to_base.sin[0], own.to_base.cos[0])
    base, tip = np.sum(own.to_base.cell), np.sum(own.to_tip.cell)
    at = own.to_base.x[0], own.to_base.y[0], phi, curvature
    return np.stack(points(*at, np.linspace(base, tip, 400))[:2], axis=1)


def polylines_cross(a, b):
    """Whether two polylines cross: whether each of two chords separates the ends of the other."""

    def sides(at, along, ends):
        return along[:, None, 0] * (ends - at[:, None])[..., 1] - along[:, None, 1] * (ends - at[:, None])[..., 0]

    first = sides(a[:-1], np.diff(a, axis=0), b[None])
    second = sides(b[:-1], np.diff(b, axis=0), a[None])
    return np.any((first[:, 1:] * first[:, :-1] < 0) & (second[:, 1:] * second[:, :-1] < 0).T)


def test_shafts_cross_as_their_polylines_do():
    random = np.random.default_rng(5)
    one = shaft(0.0, 0.5, 1.7, -1.1, 0.6, 0.4)
    numbers = random.uniform([-0.6, 0.0, 0.8, -1.5, 0.4, 0.0], [0.6, 0.8, 2.4, 1.5, 0.8, 0.5], (LANES, 6))
    others = [shaft(*row) for row in numbers]
    own = polyline(one, -1.1)
    expected = [polylines_cross(own, polyline(other, row[3])) for other, row in zip(others, numbers, strict=True)]
    assert LANES / 4 < np.sum(expected) < 3 * LANES / 4
    assert cross(one, others) == expected


def test_shafts_cross_only_where_both_are():
    upright = shaft(0.0, 0.5, np.pi / 2, 0.0, 0.5, 0.4)
    near = 1e-6
    # The left ends of level shafts, 0.5 long, and their heights.
    places = [(near - 0.5, 0.3), (-near - 0.5, 0.3), (-near, 0.3), (near, 0.3)]
    places += [(-0.2, 0.9 - near), (-0.2, 0.9 + near), (-0.2, near), (-0.2, -near)]
    others = [shaft(x + 0.25, y, 0.0, 0.0, 0.25, 0.25) for x, y in places]
    assert cross(upright, others) == [True, False] * 4


def test_a_shaft_with_its_contact_at_the_tip_ends_there():
    tip = shaft(0.0, 0.9, np.pi / 2, 0.0, 0.9, 0.0)
    others = [shaft(0.0, y, 0.0, 0.0, 0.25, 0.25) for y in (0.9 - 1e-6, 0.9 + 1e-6, 1e-6, -1e-6)]
    assert cross(tip, others) == [True, False, True, False]
