"""Routes: travel, turning points, and the same of traced positions."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import STOPS, TRACED_STOPS, across, route_of, straight, traced_route

SIZE = 12  # of random controls: one compilation serves them all
ROUNDING = 1e-14  # of sums in another order

traced = jax.jit(traced_route)
# Few different positions: many plateaus and turns.
controls = st.lists(st.integers(-2, 2), min_size=SIZE, max_size=SIZE).map(lambda values: np.array(values, dtype=float))


def turning_points(control):
    """First position, positions at which the drive reverses, and last one, straight from the definition."""
    stops, heading = [control[0]], 0.0
    for here, there in pairwise(control):
        move = np.sign(there - here)
        if move and heading and move != heading:
            stops.append(here)
        heading = move or heading
    return [*stops, control[-1]]


@given(controls)
def test_stops_are_turning_points(control):
    route = route_of(control)
    expected = turning_points(control)
    assert route.stops[: route.last + 1].tolist() == expected
    assert np.all(route.stops[route.last :] == control[-1])
    np.testing.assert_allclose(route.travel, np.append(0.0, np.cumsum(np.abs(np.diff(control)))), rtol=ROUNDING)
    assert route.control is control


@given(controls)
def test_traced_positions_have_the_same_route(control):
    route, status = traced(jnp.asarray(control))
    expected = route_of(control)
    assert status == Status.ok
    assert int(route.last) == expected.last
    assert route.stops[: expected.last + 1].tolist() == expected.stops[: expected.last + 1].tolist()
    assert np.all(np.asarray(route.stops)[expected.last :] == control[-1])
    np.testing.assert_allclose(route.travel, expected.travel, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("turns", "room"), [(0, 2), (1, STOPS), (STOPS - 2, STOPS), (STOPS - 1, 2 * STOPS), (20, 4 * STOPS)]
)
def test_stops_are_padded_so_that_few_programs_serve_all_routes(turns, room):
    zigzag = np.arange(turns + 2) % 2 * 1.0
    route = route_of(zigzag)
    assert route.last == turns + 1 and route.stops.size == room


def test_one_position_is_a_route():
    route = route_of(np.array([0.3]))
    assert route.stops.tolist() == [0.3, 0.3] and route.last == 1 and route.travel.tolist() == [0.0]
    one, status = traced(jnp.array([0.3]))
    assert status == Status.ok
    assert set(one.stops.tolist()) == {0.3} and one.travel.tolist() == [0.0]


def test_a_drive_that_stands_still_does_not_turn():
    plateau = np.array([1.0, 1.0, 0.5, 0.5, 0.5, 0.0, 0.0])
    assert route_of(plateau).stops.tolist() == [1.0, 0.0]
    back = np.array([1.0, 0.5, 0.5, 0.7])
    assert route_of(back).stops[:3].tolist() == [1.0, 0.5, 0.7]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("index", [0, 5, SIZE - 1])
def test_positions_that_are_not_finite_are_invalid(bad, index):
    _, status = traced(jnp.linspace(1.0, -1.0, SIZE).at[index].set(bad))
    assert status == Status.invalid


def test_more_turns_than_there_is_room_for_are_too_long():
    many = jnp.arange(TRACED_STOPS + 5) % 2 * 1.0
    _, status = traced(many)
    assert status == Status.too_long
    # The first, the last, and 2 STOPS - 2 turns between them are just not too many.
    plateau = jnp.where(jnp.arange(many.size) < TRACED_STOPS, many, many[TRACED_STOPS - 1])
    route, status = traced(plateau)
    assert status == Status.ok and int(route.last) == TRACED_STOPS - 1
    assert route.stops.tolist() == turning_points(np.asarray(plateau))


def test_a_straight_route_and_one_across():
    route = straight(jnp.array([0.8, 0.2, -1.0]))
    assert route.stops.tolist() == [0.8, -1.0] and int(route.last) == 1
    np.testing.assert_allclose(route.travel, [0.0, 0.6, 1.8], rtol=ROUNDING)
    stops, last = across()
    assert np.isnan(stops).all() and stops.shape == (2,) and last == 1
