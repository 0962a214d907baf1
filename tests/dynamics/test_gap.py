"""Closest points of whisker and object against geometry, and the derivatives that a gap carries."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.gap import CLOSEST, Posed, closest, followed, gap_at, others_distance
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.outline import number_of, outline
from jaxwhisker._model.objects import as_one

N = 4
POINTS = basis(N).points
EXACT = 1e-9  # of closest points: Newton's method ends below 1e-7, and its error is the square
SAMPLED = 1e-3  # of the distance of another object: squared distance of the samples
CENTRE, RADIUS = np.array([0.1, 0.5]), 0.2
CIRCLE = jw.Circle(0.3, RADIUS, 0.1)


def straight(profile, x, y=0.0, lean=0.0, length=1.0):
    return Posed(basis(N), profile, jnp.asarray(length), jnp.array([x, y]), jnp.pi / 2 + lean + jnp.zeros(POINTS.size))


@jax.jit
def nearest(posed):
    return gap_at(posed, *closest(posed))


@pytest.mark.parametrize(
    ("profile", "x", "distance", "point"),
    [
        (jw.Box(0.3, 0.8, 0.5), 0.41, 0.01, None),  # beside a flank
        (jw.Cut(jw.Parabola(0.2), -0.3, 0.5), 0.51, 0.01, (0.5, 0.45)),  # beside an edge
        (jw.Polygon([(-0.1, 0.5), (0.0, 0.2), (0.1, 0.5)]), 0.11, 0.01, (0.1, 0.5)),
        (jw.Polygon([(-0.1, 2.0), (0.0, 1.1), (0.1, 2.0)]), 0.0, 0.1, (0.0, 1.1)),  # above the tip
        (jw.Polygon([(-0.1, 2.0), (0.0, 1.1), (0.1, 2.0)]), 0.05, np.hypot(0.05, 0.1), (0.0, 1.1)),
    ],
)
def test_closest_points(profile, x, distance, point):
    gap = nearest(straight(profile, x))
    assert gap.distance == pytest.approx(distance, abs=1e-6)
    if point is not None:
        assert (gap.object.x, gap.object.y) == pytest.approx(point, abs=1e-6)


# Base, lean and length of straight whiskers: upright beside the circle, leaning, and two that end below its centre.
POSES = np.array([[0.5, 0.0, 0.0, 1.0], [0.6, 0.1, 0.4, 1.2], [0.5, 0.0, 0.1, 0.4], [0.2, -0.1, -0.9, 0.3]])
LEANING = np.append(POSES, [[0.5, np.nan, 0.0, 1.0]], axis=0)


@pytest.fixture(scope="module")
def leaning():
    """The gaps of leaning whiskers, and what Newton's method finds from points near the closest ones."""

    def one(x, y, lean, length):
        posed = straight(CIRCLE, x, y, lean, length)
        points = closest(posed)
        near = points[0] - 0.01, points[1] + 0.02
        return gap_at(posed, *points), points, followed(posed, *near)

    return jax.jit(jax.vmap(one))(*jnp.asarray(LEANING).T)


def test_leaning_whiskers_are_closest_to_a_circle_where_the_line_to_its_centre_is_normal(leaning):
    gap, (arc, _), _ = leaning
    for k, (x, y, lean, length) in enumerate(POSES):
        way = np.array([-np.sin(lean), np.cos(lean)])
        foot = np.clip((CENTRE - [x, y]) @ way, 0.0, length)
        apart = [x, y] + foot * way - CENTRE
        assert gap.distance[k] == pytest.approx(np.hypot(*apart) - RADIUS, abs=EXACT)
        assert arc[k] == pytest.approx(foot / length, abs=EXACT)
        np.testing.assert_allclose(gap.normal[k], apart / np.hypot(*apart), atol=EXACT)
        assert (gap.at_tip[k] > 0) == (foot == length)
        assert abs(gap.foot[k]) < EXACT and abs(gap.end[k]) < EXACT
    assert {bool(at_tip > 0) for at_tip in gap.at_tip[: len(POSES)]} == {True, False}
    assert np.isnan(gap.distance[-1])


def test_closest_points_are_followed(leaning):
    _, (arc, parameter), ((arc_again, parameter_again), found) = leaning
    assert found.tolist() == [True] * len(POSES) + [False]
    np.testing.assert_allclose(arc_again[:-1], arc[:-1], atol=CLOSEST)
    np.testing.assert_allclose(parameter_again[:-1], parameter[:-1], atol=CLOSEST)


def test_a_gap_has_the_derivatives_that_it_carries():
    posed = straight(CIRCLE, 0.45, 0.05, length=0.9)._replace(angle=jnp.asarray(1.3 + 0.8 * POINTS - POINTS**2))
    arc, parameter = jnp.asarray(0.6), jnp.asarray(1.1)  # not the closest points

    def of(base, angle, arc, parameter):
        gap = gap_at(posed._replace(base=base, angle=angle), arc, parameter)
        return jnp.stack([gap.distance, gap.foot])

    at = posed.base, posed.angle, arc, parameter
    every = range(4)
    gap, forward, reverse = jax.jit(lambda at: (gap_at(posed, *at[2:]), *(m(of, every)(*at) for m in MODES)))(at)
    by_base, by_angle, by_arc, by_parameter = forward
    np.testing.assert_allclose(by_base, [gap.normal, gap.tangent], atol=EXACT)
    np.testing.assert_allclose(by_angle, [gap.across, gap.along], atol=EXACT)
    phi = 1.3 + 0.8 * 0.6 - 0.6**2
    way = 0.9 * np.array([np.cos(phi), np.sin(phi)])
    np.testing.assert_allclose(by_arc, [way @ gap.normal, way @ gap.tangent], atol=1e-6)  # the angle is interpolated
    # On a circle the frame turns with the parameter, which is also the angle to its lowest point.
    np.testing.assert_allclose(by_parameter, [gap.foot, -gap.distance - RADIUS], atol=EXACT)
    for one, other in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(one, other, atol=EXACT)


MODES = jax.jacfwd, jax.jacrev


def test_the_tip_counts_where_a_shaft_is_bent_more_than_the_object():
    """At the top of a circle, the inside of an arc is farther from it than its ends if its radius is smaller."""
    here, (arc, parameter) = straight(CIRCLE, 0.0, 0.0), (jnp.asarray(0.5), jnp.asarray(np.pi / 2))

    @jax.jit
    def bent(radius):
        """Arcs whose middle is parallel to the right flank of the circle, 0.1 beside it."""
        posed = here._replace(angle=np.pi / 2 + (jnp.asarray(POINTS) - 0.5) / radius)
        chord = 2 * radius * jnp.sin(0.25 / radius)
        turn = np.pi / 2 - 0.25 / radius
        base = jnp.array([CENTRE[0] + RADIUS + 0.1, CENTRE[1]]) - chord * jnp.stack([jnp.cos(turn), jnp.sin(turn)])
        gap = gap_at(posed._replace(base=base), arc, parameter)
        return gap.distance, gap.at_tip, gap.end

    wide, narrow, away = (bent(radius) for radius in (0.32, 0.28, -0.28))
    for distance, *_ in (wide, narrow, away):
        assert distance == pytest.approx(0.1, abs=1e-4)
    assert wide[1] < 0 and abs(wide[2]) < 1e-4 and away[1] < 0
    assert narrow[1] > 0 and narrow[2] == 0.5


def test_the_nearest_of_several_objects_counts_and_the_others_are_beside_it():
    profile = outline(as_one((jw.Circle(0.3, 0.2), jw.Circle(0.4, 0.3, 2.2))).in_unit(1.0))

    @jax.jit
    def of(posed):
        arc, parameter = closest(posed)
        return gap_at(posed, arc, parameter).distance, number_of(profile, parameter), others_distance(posed, parameter)

    for x, number in ((0.6, 0), (1.5, 1)):
        distances = sorted([x - 0.2, 2.2 - 0.3 - x])
        distance, which, other = of(straight(profile, x))
        assert which == number
        assert distance == pytest.approx(distances[0], abs=EXACT)
        assert other == pytest.approx(distances[1], abs=SAMPLED)
