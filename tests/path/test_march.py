"""The march: nodes, events and ends of a path, in one program for FB."""

import equinox as eqx
import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import Q, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import Point, at_control, scale_of
from jaxwhisker._path.march import march
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Status
from jaxwhisker._plane.continuation import ContinuationInPlane

EVENT = 1e-9  # positions of events: folds are located to the square of 1e-9, the others solved for
EXACT = 1e-9  # nodes are solved for
ALIGNED = 1e-8  # of cosines; directions are those of the last linearisation, one Newton step before the node
CAPACITY = 192
STOPS = 24  # of a path, padded
STIFF, SOFT = 70.0, 10.0


@Program
def marching(problem, stops, last):
    mechanics = ContinuationInPlane(problem)
    return march(mechanics, mechanics.limits(stops[0]), stops, last, capacity=CAPACITY)


def followed(problem, *stops):
    """The path to these stops: its filled nodes and its status."""
    padded = np.pad(np.asarray(stops, dtype=float), (0, STOPS - len(stops)), mode="edge")
    path = marching(problem, jnp.asarray(padded), jnp.asarray(len(stops) - 1))
    nodes = jax.tree.map(lambda leaf: np.asarray(leaf)[: int(path.count)], path.nodes)
    return nodes, Status(int(path.status))


def events(nodes):
    """Kinds and controls of the events at or behind the first stop."""
    public = (nodes.kind >= 0) & (np.cumsum(nodes.travel >= 0) > 0)
    return [EventKind(k).name for k in nodes.kind[public]], nodes.point.u[public]


@pytest.fixture(scope="module")
def problem():
    return dimensionless(scene(jw.Support.fb(STIFF)))


@pytest.fixture(scope="module")
def straight(problem):
    return followed(problem, 0.8, -2.0)


def exactly(stiffness):
    springs = [{"between": (0, 1), "stiffness": stiffness, "rest_length": 0.2}]
    return exact.exact_scan(Q, springs, np.linspace(0.8, -1.6, 5)).events


@pytest.mark.parametrize("stiffness", [STIFF, SOFT])
def test_events_are_the_exact_ones(stiffness):
    nodes, status = followed(dimensionless(scene(jw.Support.fb(stiffness))), 0.8, -2.0)
    assert status == Status.ok
    kinds, controls = events(nodes)
    expected = exactly(stiffness)
    assert kinds == [event.kind for event in expected]
    np.testing.assert_allclose(controls, [event.control for event in expected], atol=EVENT * 10)


def test_nodes_lie_on_the_way_of_the_drive(straight):
    nodes, _ = straight
    assert np.all(np.diff(nodes.travel) >= 0)
    on_the_way = nodes.travel >= 0
    np.testing.assert_allclose(nodes.travel[on_the_way], 0.8 - nodes.point.u[on_the_way], atol=EXACT)
    assert nodes.kind[0] == NO_EVENT and nodes.travel[0] <= 0
    assert (nodes.kind == STOP).sum() == 1  # it ends where the object is left behind, before the last stop
    assert nodes.point.u[-1] > -2.0
    # Between events phases stay; a snap begins where the node before it ends.
    snap = nodes.kind[1:] >= EventKind.snap_through
    np.testing.assert_array_equal(nodes.state.phase[:-1][~snap], nodes.before.phase[1:][~snap])
    plain = nodes.kind == NO_EVENT
    np.testing.assert_array_equal(nodes.state.phase[plain], nodes.before.phase[plain])
    assert not nodes.whiskers[plain].any() and nodes.whiskers[nodes.kind >= 0].all()


def test_nodes_are_equilibria_with_tangents_of_unit_length(problem, straight):
    nodes, _ = straight

    @Program
    @jax.vmap
    def judged(z, u, phase, side):
        state = ContactState(phase, side)
        newton = newton_step(problem, state, at_control(u, z), Point(z, u))
        return newton.residual, newton.tangent

    residual, tangent = judged(*map(jnp.asarray, (*nodes.point, nodes.state.phase, nodes.state.side)))
    assert np.max(residual) < EXACT
    size = jax.vmap(scale_of)(jnp.asarray(nodes.point.z))

    def dot(one, other):
        return np.sum(np.asarray(one.z) * other.z / size**2, axis=(1, 2)) + np.asarray(one.u) * other.u

    np.testing.assert_allclose(dot(nodes.leaving, nodes.leaving), 1.0, rtol=1e-9)
    aligned = dot(nodes.leaving, tangent) / np.sqrt(dot(tangent, tangent))
    # At the fold the control does not change along the path; elsewhere it moves on.
    fold = np.flatnonzero(nodes.kind == EventKind.snap_off) - 1
    assert np.max(np.abs(nodes.arriving.u[fold])) < 1e-6
    assert np.all(np.delete(nodes.leaving.u, fold) < 0)
    np.testing.assert_allclose(np.abs(np.delete(aligned, fold)), 1.0, atol=ALIGNED)


@pytest.mark.parametrize("stops", [(0.8, 0.1, -2.0), (0.3, -0.7, -1.0, -2.0), (1.9, -2.0)], ids=str)
def test_events_do_not_depend_on_the_stops(problem, straight, stops):
    nodes, status = followed(problem, *stops)
    assert status == Status.ok
    kinds, controls = events(nodes)
    whole_kinds, whole = events(straight[0])
    ahead = whole < stops[0]
    assert kinds == [kind for kind, is_ahead in zip(whole_kinds, ahead, strict=True) if is_ahead]
    np.testing.assert_allclose(controls, whole[ahead], atol=EVENT * 10)
    at_stops = nodes.point.u[nodes.kind == STOP]
    assert at_stops.tolist() == [u for u in stops if u > -1.3]
    np.testing.assert_allclose(nodes.travel[nodes.kind == STOP][0], 0.0, atol=EXACT)


def test_the_way_back_retraces_the_way_out(problem):
    nodes, status = followed(problem, 0.8, -0.7, 0.8)
    kinds, controls = events(nodes)
    assert status == Status.ok
    assert kinds == ["touch", "tip_to_tangential", "vertex", "vertex", "tangential_to_tip", "release"]
    np.testing.assert_allclose(controls[:3], controls[:2:-1], atol=EVENT * 10)
    assert np.all(np.diff(nodes.travel) >= 0)
    np.testing.assert_allclose(nodes.travel[-1], 3.0, atol=EXACT)
    turn = np.flatnonzero(nodes.kind == STOP)[1]
    assert nodes.arriving.u[turn] < 0 < nodes.leaving.u[turn]


def test_a_march_ends_where_the_last_stop_is(problem):
    nodes, status = followed(problem, 0.8, -0.4)
    assert status == Status.ok
    assert nodes.point.u[-1] == pytest.approx(-0.4, abs=EXACT) and nodes.kind[-1] == STOP
    assert nodes.state.phase[-1] == Phase.tangential


def test_an_invalid_problem_has_no_nodes(problem):
    nodes, status = followed(eqx.tree_at(lambda p: p.valid, problem, jnp.asarray(False)), 0.8, -2.0)
    assert status == Status.invalid and nodes.kind.size == 0


def test_too_many_turns_are_too_long(problem):
    there_and_back = [0.8, *[-0.4, 0.8] * 11]
    nodes, status = followed(problem, *there_and_back)
    assert status == Status.too_long
    assert nodes.kind.size == CAPACITY
