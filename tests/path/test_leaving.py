"""How the path leaves an event: the end of a march, the begin of a snap, slips that friction allows."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from exact_contacts import scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.newton import LIGHT
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._path import leaving
from jaxwhisker._path.leaving import _changed_slips, _first_leans, _is_over
from jaxwhisker._path.march import _start
from jaxwhisker._path.march_state import Task, Trial

ROUNDING = 1e-12
SCENE = scene(jw.Support.fb(70.0))
FRICTION = 0.3
LIMIT = np.arctan(FRICTION)


@pytest.fixture(scope="module")
def problem():
    return Program(problem_of)(SCENE)


@pytest.fixture(scope="module")
def state(problem):
    """A state ahead of the object, whose drive moves towards -x."""
    return Program(_start)(problem, jnp.array([1.0, -1.0]))


def trial(end=None, tangent=None, stance=None, stable=True):
    """What these decisions see of a trial."""
    solution = Solution(end, None, jnp.asarray(True), jnp.asarray(1))  # pyright: ignore[reportArgumentType]
    yes = jnp.asarray(True)
    parts = solution, tangent, None, jnp.asarray(stable), yes, None, None, stance, jnp.ones(1)
    return Trial(*parts)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("goal", "direction", "x", "at_stop", "over"),
    [
        (1, -1.0, -2.0, False, True),  # on the last leg, beyond the object
        (1, -1.0, -0.3, False, False),  # ... still before it
        (0, -1.0, -2.0, False, False),  # on the way to the first stop
        (1, 1.0, -2.0, False, False),  # on the way back, towards the object
        (2, -1.0, -0.3, True, True),  # at the last stop
        (1, -1.0, -0.3, True, False),  # at an earlier stop
    ],
)
def test_the_end_of_a_march(problem, state, goal, direction, x, at_stop, over):
    turned = state.state._replace(side=-jnp.ones(1))
    at = state._replace(goal=jnp.asarray(goal), direction=jnp.asarray(direction), state=turned)
    stance = problem.stance(0.0, jnp.array([[x]]))
    assert bool(_is_over(problem, at, trial(stance=stance), jnp.asarray(1), jnp.asarray(at_stop))) == over


def test_a_snap_begins_at_the_point_that_has_lost_its_stability(state):
    tip = state.state._replace(phase=jnp.array([int(Phase.tip)]))
    at = state._replace(state=tip, point=Point(jnp.array([[2.0, 0.3, -0.1]]), jnp.asarray(0.4)))
    begun = leaving.to_snap(at)
    assert begun.task == Task.kick and begun.unstable_at == jnp.inf
    np.testing.assert_array_equal(begun.pending.z_before, at.point.z)
    assert begun.pending.before is tip and begun.pending.arriving is at.tangent
    np.testing.assert_array_equal(begun.flow.pose, at.pose)
    assert not begun.flow.slipped.any() and begun.flow.iterations == 0


@pytest.fixture(scope="module")
def rough():
    circle = jw.Circle(0.2, 0.5)
    made = jw.Scene(jw.Whisker(), circle, jw.Support.fbfb(70.0), jw.ClosedForm(), friction=FRICTION)
    return Program(problem_of)(made)


@pytest.fixture(scope="module")
def begun(rough):
    """A march of two whiskers that has just begun."""
    return Program(_start)(rough, jnp.array([1.0, -1.0]))


def march_of(begun, slip, force, leans, *, tries=0, rests=(False, False)):
    """The state at two tip contacts on the right."""
    friction = Friction(jnp.array(slip), jnp.zeros(2), jnp.zeros(2))
    z = jnp.stack([jnp.array(force), jnp.array(leans), jnp.array([-0.2, -0.3])], axis=1)
    return begun._replace(
        state=ContactState(jnp.array([int(Phase.tip)] * 2), jnp.ones(2), friction),
        point=Point(z, jnp.asarray(0.0)),
        tries=jnp.asarray(tries),
        rests=jnp.array(rests),
    )


def changed(problem, begun, slip, rates, *, force=(1.0, 1.0), leans=(0.1, -0.1), falls=False, **more):
    """Whether a contact breaks a law along a tangent on which parameters or leans change at these rates."""
    march = march_of(begun, slip, force, leans, **more)
    tangent = Point(jnp.zeros((2, 3)).at[:, 1].set(jnp.array(rates)), jnp.asarray(-1.0))
    yes, slips = _changed_slips(problem, march, march.point, tangent, jnp.asarray(falls))
    return bool(yes), slips.tolist()


def test_contacts_that_turn_back_stick_and_those_that_lean_too_far_slip(rough, begun):
    at_limit = (LIMIT, -LIMIT)
    assert changed(rough, begun, (1, -1), (0.3, -0.3)) == (False, [1, -1])
    assert changed(rough, begun, (1, -1), (-0.3, -0.3)) == (True, [0, -1])
    assert changed(rough, begun, (1, -1), (-0.3, 0.3)) == (True, [0, -1])  # the first one is changed first
    assert changed(rough, begun, (0, 0), (0.3, -0.3)) == (False, [0, 0])
    assert changed(rough, begun, (0, 0), (0.3, -0.3), leans=at_limit) == (True, [1, 0])
    assert changed(rough, begun, (0, 0), (-0.3, -0.3), leans=at_limit) == (True, [0, -1])
    assert changed(rough, begun, (0, 0), (-0.3, 0.3), leans=at_limit) == (False, [0, 0])
    # Contacts that have come to rest here do not begin to slip again.
    assert changed(rough, begun, (0, 0), (0.3, -0.3), leans=at_limit, rests=(True, True)) == (False, [0, 0])


def test_a_contact_that_has_just_begun_slips_the_other_way_before_it_sticks(rough, begun):
    light = (LIGHT / 2, 1.0)
    assert changed(rough, begun, (-1, -1), (0.3, -0.3), force=light) == (True, [1, -1])
    assert changed(rough, begun, (-1, -1), (0.3, -0.3), force=light, tries=1) == (True, [0, -1])
    # One that slips as it should, but on a path that falls, is no solution either.
    assert changed(rough, begun, (-1, -1), (-0.3, -0.3), force=light, falls=True) == (True, [1, -1])
    assert changed(rough, begun, (-1, -1), (-0.3, -0.3), falls=True) == (False, [-1, -1])


def test_the_first_lean_combines_paths_with_both_slips(rough, begun):
    # Along the present path, which slips towards -x, and along that tried before, towards +x: forces and rates of slip.
    force, other_force, rate, other_rate = 0.8, 0.5, 0.2, -0.3
    tangent, other = (
        Point(jnp.zeros((2, 3)).at[:, 0].set(f).at[:, 1].set(r / 0.5), jnp.asarray(-1.0))
        for f, r in ((force, rate), (other_force, other_rate))
    )
    march = march_of(begun, (-1, 1), (0.0, 0.0), (0.0, 0.0))
    known, leans = _first_leans(rough, march._replace(pending=march.pending._replace(arriving=other)), tangent)
    # Of both forces, of which each leans by the limit, in the proportion in which the contact does not slip.
    share = -rate / other_rate
    for k, slip in enumerate((-1, 1)):
        across = slip * np.sin(LIMIT) * (force - share * other_force)
        along = np.cos(LIMIT) * (force + share * other_force)
        assert known[k]
        np.testing.assert_allclose(leans[k], np.arctan2(across, along), rtol=ROUNDING)
    assert np.all(np.abs(leans) < LIMIT)
