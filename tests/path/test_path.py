"""Selection among cases, and the margins that tell how far away events are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import EventKind, Status, first_case, select
from jaxwhisker._plane.events import AT_STOP, PHASE, RELEASE, TOUCH, VERTEX, PathDirection, Seen, margin_rates, margins

DIFFERENCE = 1e-9  # margins are linear in point and pose: central differences are exact to rounding

FREE, TIP, TANGENTIAL = (int(phase) for phase in Phase)
# A free, a tip and a tangential contact; the free whisker first on the right of the object, then on its left.
MODES = [
    ContactState(jnp.array([FREE, TIP, TANGENTIAL]), jnp.array(side)) for side in ([1.0, 1.0, 1.0], [-1.0, 1.0, -1.0])
]
POINT = Point(jnp.array([[0.0, 0.0, 0.0], [1.5, 0.8, -0.3], [2.5, 0.1, 0.4]]), jnp.asarray(0.3))
POSE = jnp.array([[1.1], [0.7], [0.2]])


@pytest.mark.parametrize("conditions", [(True, True), (False, True), (True, False), (False, False)])
def test_the_first_true_case_wins(conditions):
    first, second = (jnp.asarray(condition) for condition in conditions)
    tree = first_case((first, {"a": 1.0}), (second, {"a": 2.0}), otherwise={"a": 3.0})
    assert tree["a"] == (1.0 if conditions[0] else 2.0 if conditions[1] else 3.0)


def test_leaves_that_both_trees_share_are_not_selected():
    shared = jnp.arange(3.0)
    tree = select(jnp.asarray(True), (shared, jnp.asarray(1.0)), (shared, jnp.asarray(2.0)))
    assert tree[0] is shared and tree[1] == 1.0


def test_numbers_of_status_and_kinds_are_those_that_files_hold():
    # Stored results hold these numbers.
    names = ["ok", "invalid", "lost", "unsettled", "not_convex", "too_long", "inexact", "unstable"]
    names += ["undetermined", "second_contact", "crossing", "at_spring", "too_many_contacts"]
    assert [status.name for status in Status] == names and list(Status) == list(range(13))
    kinds = ["touch", "tip_to_tangential", "vertex", "tangential_to_tip", "release", "snap_through", "snap_off"]
    kinds += ["stick", "slip", "edge", "bifurcation"]
    assert [kind.name for kind in EventKind] == kinds and list(EventKind) == list(range(11))


@pytest.fixture(scope="module")
def problem():
    return dimensionless(scene(jw.Support.fbfbfbr(70.0)))


@pytest.fixture(scope="module")
def at(problem):
    """Margins of a contact state at a point and pose."""

    @Program
    def at(state, point, pose):
        ahead = state.side * jnp.sin(point.z[:, 1])
        return margins(
            Seen(problem, state, state.free, point.z, problem.stance(point.u, pose), ahead, jnp.asarray(0.05), None)
        )

    return at


def test_margins_are_distances_from_events(at):
    touch = np.sqrt(0.8)  # of an upright whisker of length 1 before y = x^2 + 0.2
    right, left = (at(state, POINT, POSE) for state in MODES)
    np.testing.assert_allclose(right[TOUCH], [1.1 - touch, np.inf, np.inf], rtol=1e-14)
    # Beyond its first touch from the left a whisker has a negative margin.
    np.testing.assert_allclose(left[TOUCH], [-1.1 - touch, np.inf, np.inf], rtol=1e-14)
    assert right[RELEASE].tolist() == [np.inf, 1.5, 2.5]
    assert right[PHASE].tolist() == [np.inf, 0.3, 0.4]
    np.testing.assert_allclose(right[VERTEX], [np.inf, np.sin(0.8), np.sin(0.1)])
    np.testing.assert_allclose(left[VERTEX], [np.inf, np.sin(0.8), -np.sin(0.1)])
    assert right[AT_STOP].tolist() == [0.05]


def test_whiskers_out_of_reach_never_touch(problem):
    state, stance = MODES[0], problem.stance(0.3, POSE)
    stance = stance._replace(right=stance.right._replace(reaches=jnp.zeros(3, bool)))
    seen = Seen(problem, state, state.free, POINT.z, stance, jnp.ones(3), jnp.asarray(1.0), None)
    assert np.all(margins(seen)[TOUCH] == np.inf)


@pytest.mark.parametrize("state", MODES, ids=["right", "left"])
def test_rates_are_derivatives_of_the_margins(problem, at, state):
    rng = np.random.default_rng(2)
    direction = Point(jnp.asarray(rng.normal(size=(3, 3))), jnp.asarray(-1.0))
    pose_rate, step = jnp.asarray(rng.normal(size=(3, 1))), 1e-3

    def moved(by):
        return at(state, Point(POINT.z + by * direction.z, POINT.u + by * direction.u), POSE + by * pose_rate)

    rates = margin_rates(PathDirection(problem, state, state.free, POINT.z, direction.z, pose_rate))
    ahead, behind = moved(step), moved(-step)
    for number in (TOUCH, RELEASE, PHASE):
        later, earlier, here = (np.asarray(margins[number]) for margins in (ahead, behind, at(state, POINT, POSE)))
        finite = np.isfinite(here)
        assert finite.any()
        difference = np.where(finite, (np.where(finite, later, 0) - np.where(finite, earlier, 0)) / (2 * step), 0.0)
        np.testing.assert_allclose(rates[number], difference, atol=DIFFERENCE, err_msg=str(number))
    # Vertex and stop are passed only once: between two steps, nothing is interpolated.
    assert np.all(rates[VERTEX] == 0) and np.all(rates[AT_STOP] == 0)
    assert jax.tree.map(jnp.shape, rates) == jax.tree.map(jnp.shape, ahead)
