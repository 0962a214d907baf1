"""The march in the plane: how many nodes it has room for, and how it leaves an event."""

# pyright: reportArgumentType=false

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march import STOPS, TRACED_STOPS
from jaxwhisker._plane.continuation import ContinuationInPlane
from jaxwhisker._plane.events import Lead
from jaxwhisker._plane.march_state import TrialInPlane


@pytest.fixture(scope="module")
def problem():
    return dimensionless(scene(jw.Support.fb(70.0)))


def test_padding_makes_no_room_for_nodes(problem):
    mechanics = ContinuationInPlane(problem)
    whole, one = mechanics.capacity(TRACED_STOPS), mechanics.capacity(2)
    assert [int(mechanics.room(whole, jnp.asarray(last))) // one for last in (1, STOPS - 1, STOPS)] == [1, 4, 8]
    assert int(mechanics.room(one, jnp.asarray(STOPS))) == one


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("lead", [1.0, -1.0])
def test_the_path_leaves_an_event_where_its_lead_grows_and_turns_with_the_drive(problem, lead, direction):
    march = begun_march(problem, jnp.array([1.0, -1.0]))
    z = jnp.zeros_like(march.point.z).at[0, 0].set(1.0)
    march = march.replace(lead=Lead(lead * z, jnp.zeros_like(march.pose), jnp.asarray(0.0)))

    trial = TrialInPlane(None, None, Point(z, jnp.asarray(0.2)), jnp.zeros_like(march.pose), *[None] * 7)
    # The drive moves towards smaller u.
    sign = ContinuationInPlane(problem).leaves(march, trial, jnp.asarray(direction))
    np.testing.assert_array_equal(sign, -direction * lead)
