"""Walks past places: their order, points between loads, what walks collect, and a walk in the plane and in space."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.quaternions import cross, plus
from jaxwhisker._base.rotation import quaternion_of
from jaxwhisker._rod import rod, space
from jaxwhisker._rod.walk import in_order, pressed, stretches, walk

ROUNDING = 1e-14
SAME = 1e-12  # one rod, integrated in two ways


def test_places_of_several_kinds_are_passed_in_their_order():
    first, second = jnp.array([0.2, 0.7, 0.7]), jnp.array([0.7, 0.9])
    for outwards, at in ((False, [0.9, 0.7, 0.7, 0.7, 0.2]), (True, [0.2, 0.7, 0.7, 0.7, 0.9])):
        order = in_order(first, second, outwards=outwards)
        np.testing.assert_array_equal(order.at, at)
        # Of places that coincide, those of the first kind come first.
        assert order.ranks[0].tolist() == ([0, 1, 2] if outwards else [4, 1, 2])
        assert order.ranks[1].tolist() == ([3, 4] if outwards else [3, 0])
        numbers, rows, none = order.spread(1, (jnp.array([5, 6]), jnp.array([[1.0, 2.0], [3.0, 4.0]]), None))
        assert numbers.tolist() == ([0, 0, 0, 5, 6] if outwards else [6, 0, 0, 5, 0]) and numbers.dtype == int
        np.testing.assert_array_equal(rows[order.ranks[1]], [[1.0, 2.0], [3.0, 4.0]])
        assert np.count_nonzero(rows) == 4 and none is None


def test_the_order_of_places_has_no_derivatives_and_their_positions_do():
    at, change = jnp.array([0.3, 0.6]), jnp.array([1.0, 2.0])
    _, moved = jax.jvp(lambda at: in_order(at, jnp.array([0.5])).at, (at,), (change,))
    np.testing.assert_array_equal(moved, [2.0, 0.0, 1.0])


def test_points_between_loads():
    position, share = jnp.array([0.75, 0.25]), np.array([0.0, 0.5, 1.0])
    at, loads, points, lengths = stretches(position, share, beyond=True)
    np.testing.assert_allclose(lengths, [0.25, 0.5, 0.25], atol=ROUNDING)
    np.testing.assert_allclose(
        at, [1.0, 1.0, 0.875, 0.75, 0.75, 0.75, 0.5, 0.25, 0.25, 0.25, 0.125, 0.0], atol=ROUNDING
    )
    assert loads.tolist() == [4, 8] and points.tolist() == [1, 2, 3, 5, 6, 7, 9, 10, 11]
    # Without the base among the points, the walk still ends there.
    at, loads, points, _ = stretches(position, share[1:2], beyond=False)
    np.testing.assert_allclose(at, [0.75, 0.5, 0.25, 0.125, 0.0], atol=ROUNDING)
    assert loads.tolist() == [0, 2] and points.tolist() == [1, 3]
    at, loads, points, _ = stretches(position, share[:0], beyond=True)
    np.testing.assert_allclose(at, [1.0, 0.75, 0.25, 0.0], atol=ROUNDING)
    assert loads.tolist() == [1, 2] and points.size == 0


def test_the_ends_of_stretches_are_exact():
    position = jnp.array([0.7, 0.7, 0.1])
    at, loads, points, _ = stretches(position, np.linspace(0.0, 1.0, 7), beyond=True)
    np.testing.assert_array_equal(at[points].reshape(4, 7)[:, -1], [*position, 0.0])
    np.testing.assert_array_equal(at[loads], position)
    assert np.all(np.diff(at) <= 0)


@pytest.mark.parametrize("begins_at_a_place", [False, True])
def test_what_a_walk_collects(begins_at_a_place):
    """A state that falls with the load, which grows at each place by what acts there and by the state."""

    def onwards(state, load, s, stop):
        return state - load * (s - stop), load, s + stop

    def past(load, state, place):
        return load + place + state

    stops, places = jnp.array([4.0, 3.0, 1.0]), jnp.array([0.5, -1.0, 2.0])
    found = walk(onwards, past, 2.0, 1.0, stops, places, s=None if begins_at_a_place else jnp.asarray(4.5))
    state, load, s, passed = 2.0, 1.0, 4.0 if begins_at_a_place else 4.5, []
    for k, (stop, place) in enumerate(zip(stops.tolist(), places.tolist(), strict=True)):
        if k or not begins_at_a_place:
            state, way = state - load * (s - stop), s + stop
            passed.append((state, load, way))
        load, s = load + place + state, stop
    np.testing.assert_allclose(jnp.stack([found.passed, found.loads, found.ways], axis=1), passed, atol=ROUNDING)
    np.testing.assert_allclose([found.end, found.load], [state, load], atol=ROUNDING)


FORCES = np.array([[0.7, -0.4], [-0.5, 0.9]])
STOPS, ANGLE, STEPS = np.array([0.9, 0.4, 0.0]), 2.0, 16


def in_plane(forces):
    def past(load, state, force):
        return jax.tree.map(jnp.add, load, pressed(state[:2], force[0], force[1]))

    def onwards(state, load, s, stop):
        return rod.integrate(state, s - stop, load, steps=STEPS), load, None

    start = 0.3, 0.8, np.cos(ANGLE), np.sin(ANGLE)
    return walk(onwards, past, start, rod.Load(0.0, 0.0, 0.0), jnp.asarray(STOPS), forces)


def in_space(forces):
    section, zero = space.SpaceSection(1.0), jnp.zeros(())

    def past(load, state, force):
        own = force[0], force[1], zero
        return space.SpaceLoad(plus(load.force, own), plus(load.moment, cross(state[0], own)))

    def onwards(state, load, s, stop):
        return space.integrate(state, s - stop, load, section, steps=STEPS, from_base=s), load, None

    tangent, up = np.array([np.cos(ANGLE), np.sin(ANGLE), 0.0]), np.array([0.0, 0.0, 1.0])
    rotation = quaternion_of(jnp.asarray(np.stack([up, np.cross(tangent, up), tangent], axis=1)))
    start = (0.3, 0.8, 0.0), tuple(rotation)
    nothing = space.SpaceLoad((zero, zero, zero), (zero, zero, zero))
    return walk(onwards, past, start, nothing, jnp.asarray(STOPS), forces)


def test_rods_in_the_plane_and_in_space_walk_alike():
    forces = jnp.asarray(np.concatenate([FORCES, np.zeros((1, 2))]))
    plane, other = jax.jit(in_plane)(forces), jax.jit(in_space)(forces)
    np.testing.assert_allclose(jnp.stack(plane.passed[:2]), jnp.stack(other.passed[0][:2]), atol=SAME)
    np.testing.assert_allclose(plane.load.moment, other.load.moment[2], atol=SAME)
    # Statics: the load at the base is that of all forces.
    np.testing.assert_allclose([plane.load.force_x, plane.load.force_y], FORCES.sum(axis=0), atol=ROUNDING)
    x, y = np.append(0.3, plane.passed[0][0]), np.append(0.8, plane.passed[1][0])
    np.testing.assert_allclose(plane.load.moment, np.sum(x * FORCES[:, 1] - y * FORCES[:, 0]), atol=SAME)
    assert abs(x[1] - 0.3 + 0.5 * np.cos(ANGLE)) > 1e-3  # the rod bends
