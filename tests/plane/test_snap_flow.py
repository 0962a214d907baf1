"""The snap flow: its first step, its limits, and where it comes to rest."""

from functools import cache

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import Q, branch, contacts, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import Apart
from jaxwhisker._equilibrium.point import Point, at_control, scale_of
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._equilibrium.stance import Stance
from jaxwhisker._equilibrium.touch import TouchAlongX
from jaxwhisker._plane import snap_flow
from jaxwhisker._plane.snap_flow import FIRST_CHANGE, ITERATIONS, SHORTEST

ROUNDING = 1e-14
REST = 1e-8  # position of the bases where a flow is followed to its end
NEAR = 1e-10  # ... to which these flows are followed; a march stops them earlier, and solves
AHEAD = 1e-4  # along the clamped branch: a direction
SOFT = 10.0  # below the critical stiffness: snaps through the vertex, slips, lands on the far side


@pytest.fixture(scope="module")
def begun():
    """A flow about to begin, of three whiskers."""
    pose = jnp.array([[0.5], [0.7], [0.9]])
    state = ContactState(jnp.array([1, 2, 0]), jnp.ones(3))
    return snap_flow.start(state, pose, jnp.zeros((3, 3))), pose


def test_the_kick_changes_contacts_by_one_step(begun):
    flow, pose = begun
    z = jnp.array([[1.5, 0.8, -0.3], [2.5, 0.1, 0.4], [0.0, 0.0, 0.0]])
    tangent = Point(jnp.array([[3.0, 0.2, 0.5], [-2.0, 0.4, 0.1], [0.0, 0.0, 0.0]]), jnp.asarray(0.0))
    tangent_pose = jnp.array([[0.3], [-0.4], [0.2]])
    kicked = snap_flow.kick(flow, Point(z, jnp.asarray(0.0)), tangent, tangent_pose)
    size = np.sqrt(np.sum(((kicked.guess - z) / scale_of(z)) ** 2))
    np.testing.assert_allclose(size, FIRST_CHANGE, rtol=1e-12)
    # The bases go the same way along the tangent.
    share = np.sum((kicked.guess - z) * tangent.z) / np.sum(tangent.z**2)
    np.testing.assert_allclose(kicked.pose - pose, share * tangent_pose, rtol=1e-12)
    # A tangent that hardly changes the contacts does not throw the bases far away.
    still = tangent._replace(z=1e-9 * tangent.z)
    kicked = snap_flow.kick(flow, Point(z, jnp.asarray(0.0)), still, tangent_pose)
    assert np.max(np.abs(kicked.pose - pose)) <= FIRST_CHANGE / 1e-3


def test_shorter_steps_are_exhausted_at_the_shortest(begun):
    flow, steps = begun[0], []
    while not flow.exhausted:
        flow = snap_flow.shortened(flow)
        steps.append(float(flow.step))
    assert steps[-1] < SHORTEST <= steps[-2]
    np.testing.assert_allclose(steps, FIRST_CHANGE / 4.0 ** np.arange(1, len(steps) + 1), rtol=ROUNDING)
    late = begun[0]._replace(iterations=jnp.asarray(ITERATIONS))
    assert snap_flow.shortened(late).exhausted
    assert not snap_flow.shortened(late._replace(iterations=jnp.asarray(ITERATIONS - 1))).exhausted


def test_contacts_at_first_touch():
    right, left = (
        TouchAlongX(
            jnp.full(2, parameter), jnp.full(2, x), jnp.array([slack, -slack]), jnp.full(2, side), jnp.ones(2, bool)
        )
        for parameter, x, slack, side in ((1.1, 0.9, 0.1, 1.0), (-1.2, -0.9, 0.2, -1.0))
    )
    z, phase, side = snap_flow.touching(Stance(jnp.zeros(2), right, left), jnp.array([1.0, -1.0]))
    assert z.tolist() == [[0.0, 1.1, 0.1], [0.0, -1.2, -0.2]]
    assert phase.tolist() == [Phase.tangential, Phase.tip]
    assert side.tolist() == [1.0, -1.0]


@Program
def iterate(problem, flow, state, point, tangent, tangent_pose, first):
    """One step of a flow as the march takes it: propose, solve, accept."""
    kicked = snap_flow.kick(flow, point, tangent, tangent_pose)
    proposed = snap_flow.propose(problem, flow, state, point)
    flow = jax.tree.map(lambda a, b: jnp.where(first, a, b), kicked, proposed)
    apart = Apart(jnp.asarray(True), problem.across(flow.pose))
    solution = solve_point(problem, state, at_control(point.u, flow.guess), Point(flow.guess, point.u), apart)
    pose = jnp.where(problem.solved(state.phase)[:, None], solution.newton.pose, flow.pose)
    stance = problem.stance(point.u, pose)
    flow, state, z = snap_flow.advance(problem, flow, state, point.z, solution, stance, None)
    return flow, state, Point(z, point.u), solution.converged, snap_flow.at_rest(problem, flow, state, point.u)


def follow(problem, p, u):
    """The flow's last state, contact state and contacts, from a contact that has just lost its stability."""
    at, ahead = contacts(p), contacts(p + AHEAD)
    state = ContactState(jnp.asarray(at.phase), jnp.ones(1))
    point, pose = Point(jnp.asarray(at.z), jnp.asarray(u)), jnp.asarray(at.base_x)[:, None]
    onwards = Point(jnp.asarray(ahead.z - at.z), jnp.asarray(0.0)), jnp.asarray(ahead.base_x - at.base_x)[:, None]
    size = np.sqrt(np.sum((onwards[0].z / scale_of(point.z)) ** 2))
    tangent, tangent_pose = jax.tree.map(lambda leaf: leaf / size, onwards)
    flow = snap_flow.start(state, pose, point.z)._replace(near=jnp.asarray(NEAR))
    first, rested = True, False
    while not rested:
        before = flow, state, point
        flow, state, point, converged, rested = iterate(problem, *before, tangent, tangent_pose, jnp.asarray(first))
        if not converged:
            (flow, state, point), rested = before, False
            flow = snap_flow.shortened(flow)
        first = first and not converged
        assert not flow.exhausted
    return flow, state, point


@cache
def exact_snaps():
    """Snaps of the softest spring, by the oracle."""
    springs = [{"between": (0, 1), "stiffness": SOFT, "rest_length": 0.2}]
    events = exact.exact_scan(Q, springs, np.linspace(0.8, -1.2, 5)).events
    return [event for event in events if event.kind.startswith("snap")]


def parameter_of(state):
    """Parameter on the clamped branch of an exact state."""
    return branch().parameter(float(state.base_x[0]))


@pytest.mark.parametrize("number", [0, 1], ids=["through the vertex", "to the far side"])
def test_a_flow_comes_to_rest_at_the_exact_equilibrium(number):
    snap = exact_snaps()[number]
    problem = dimensionless(scene(jw.Support.fb(SOFT)))
    flow, state, point = follow(problem, parameter_of(snap.before), snap.control)
    after = snap.after
    np.testing.assert_allclose(flow.pose[:, 0], after.base_x, atol=REST)
    np.testing.assert_allclose(point.z[:, 0], after.contact_force, rtol=1e-6)
    np.testing.assert_allclose(point.z[:, 1], after.contact_slope, rtol=1e-6)
    slips = number == 1
    assert flow.slipped.tolist() == [slips]
    assert state.side.tolist() == [-1.0 if slips else 1.0]
    assert (state.phase != Phase.free).all()


def test_a_stiff_base_comes_free():
    stiffness = 1e4
    problem, fold = dimensionless(scene(jw.Support.fb(stiffness))), branch().fold - 1e-9
    at = contacts(fold)
    u = float(at.base_x[0] - 0.2 - at.force_x[0] / stiffness)
    flow, state, point = follow(problem, fold, u)
    assert flow.slipped.all() and (state.phase == Phase.free).all()
    assert state.side.tolist() == [-1.0]  # beyond the object
    np.testing.assert_allclose(flow.pose[:, 0], u + 0.2, atol=REST)
    assert np.all(point.z == 0)
