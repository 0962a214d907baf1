"""Slips: where the path leaves an event, and in a step of a snap, against the motion of contacts on a circle."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begun_march, dimensionless
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.newton import LIGHT
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._plane import snap_flow
from jaxwhisker._plane.slips import changed_slips, disagreement, goes_astray, partly, repeated
from jaxwhisker._plane.snap_flow import ITERATIONS

ROUNDING = 1e-12
RADIUS, FRICTION = 0.5, 0.3
LIMIT = np.arctan(FRICTION)
TIP, TANGENTIAL = int(Phase.tip), int(Phase.tangential)
# A tip contact that slips back, a tangential one that slips towards -x, and a tip contact that sticks.
Z = np.array([[2.0, 0.4, -0.3], [1.5, -0.2, 0.3], [1.0, 0.1, -0.2]])
SLIPS = Friction(jnp.array([1, -1, 0]), jnp.zeros(3), jnp.zeros(3))
STATE = ContactState(jnp.array([TIP, TANGENTIAL, TIP]), jnp.array([1.0, 1.0, -1.0]), SLIPS)


@pytest.fixture(scope="module")
def problem():
    circle = jw.Circle(0.2, RADIUS)
    return dimensionless(jw.Scene(jw.Whisker(), circle, jw.Support.fbfbfbr(70.0), jw.ClosedForm(), friction=FRICTION))


@pytest.fixture(scope="module")
def flow():
    begun = snap_flow.start(STATE, jnp.zeros((3, 1)), jnp.asarray(Z))
    return begun._replace(basis=jnp.ones((3, 3, 1)))  # the branches are known


@Program
def judged(problem, flow, state, previous, z):
    return disagreement(problem, flow, state, previous, z)


def found(problem, flow, change, *, previous=Z, slip=(1, -1, 0), phase=STATE.phase, **more: Any):
    """How a step with these changes is judged."""
    state = STATE._replace(phase=phase, friction=SLIPS._replace(slip=jnp.array(slip)))
    z = jnp.asarray(previous + np.array(change))
    result = judged(problem, flow._replace(**more), state, jnp.asarray(previous), z)
    return bool(result.wrong), result.slip.tolist(), float(result.share)


STILL = np.zeros(3)


def test_contacts_that_slip_the_way_they_should_are_no_disagreement(problem, flow):
    change = [[0.1, 0.02, -0.01], [0.1, -0.03, 0.01], [0.1, 0.05, 0.02]]
    assert found(problem, flow, change) == (False, [1, -1, 0], 1.0)


def test_a_contact_that_slips_back_sticks(problem, flow):
    back = [0.0, -0.01, 0.0]
    assert found(problem, flow, [back, STILL, STILL]) == (True, [0, -1, 0], 1.0)
    # A tangential contact rolls: it slips by the difference of both arc lengths, with side = +1 by their sum.
    rolls = [0.0, 0.01, -0.01 * RADIUS]
    assert found(problem, flow, [STILL, rolls, STILL])[0] is False
    assert found(problem, flow, [STILL, np.add(rolls, [0, 0, 1e-9]), STILL])[:2] == (True, [1, 0, 0])
    assert found(problem, flow, [STILL, np.add(rolls, [0, 0, -1e-9]), STILL])[0] is False
    # Only the first of several is changed.
    assert found(problem, flow, [back, [0, 0, 0.1], STILL])[:2] == (True, [0, -1, 0])


def test_a_contact_that_has_just_begun_may_slip_the_other_way(problem, flow):
    light = Z.copy()
    light[:, 0] = 1e-9
    # On the right, it has begun to slip towards -x.
    change = [STILL, [0.0, 0.01, 0.0], STILL]
    assert found(problem, flow, change, previous=light, slip=(1, -1, 0))[:2] == (True, [1, 1, 0])
    assert found(problem, flow, change)[:2] == (True, [1, 0, 0])


def test_a_contact_that_leans_too_far_slips_from_there_on(problem, flow):
    def leaning(lean, by):
        previous = Z.copy()
        previous[2, 1] = lean
        return found(problem, flow, [STILL, STILL, [0.0, by, 0.0]], previous=previous)

    for sign in (1.0, -1.0):
        wrong, slip, share = leaning(sign * (LIMIT - 0.02), sign * 0.05)
        assert not wrong and slip == [1, -1, 0]
        np.testing.assert_allclose(share, 0.02 / 0.05, atol=1e-9)
        assert leaning(sign * LIMIT, sign * 0.05) == (True, [1, -1, int(sign)], 1.0)
        assert leaning(sign * LIMIT, -sign * 0.05) == (False, [1, -1, 0], 1.0)


@pytest.mark.parametrize("why", ["sliding", "landing", "unknown", "free"])
def test_some_contacts_are_not_judged(problem, flow, why):
    change, only = [[0.0, -0.01, 0.0], STILL, STILL], jnp.array([True, False, False])
    more: dict[str, Any] = {
        "sliding": {"sliding": only},
        "landing": {"landing": only},
        "unknown": {"basis": flow.basis.at[0].set(0.0)},
        "free": {"phase": STATE.phase.at[0].set(int(Phase.free))},
    }[why]
    assert found(problem, flow, change, **more) == (False, [1, -1, 0], 1.0)


@pytest.mark.parametrize(("miss", "astray"), [(0.4, False), (0.6, True)])
def test_a_step_goes_astray_that_ends_far_from_its_guess(miss, astray):
    for step in ([0.3, 0.0, 0.0], [0.0, 0.1, 0.0]):  # in the scale of the force, both are of one size
        guess = Z + np.array([step, STILL, STILL])
        z = guess + np.array([STILL, [0.0, 0.0, 0.1 * miss], STILL])
        assert bool(goes_astray(STATE, *map(jnp.asarray, (Z, guess, z)))) == astray
    # The lean of a contact that sticks counts by its force, here half.
    light = Z.copy()
    light[2, 0] = 0.5
    guess = light + np.array([[0.3, 0.0, 0.0], STILL, STILL])
    z = guess + np.array([STILL, STILL, [0.0, 2 * 0.1 * miss, 0.0]])
    assert bool(goes_astray(STATE, *map(jnp.asarray, (light, guess, z)))) == astray
    assert not goes_astray(STATE, jnp.asarray(Z), jnp.asarray(Z), jnp.asarray(Z + 1.0))


def test_steps_that_are_repeated_are_shorter(flow):
    begun = flow._replace(share=jnp.asarray(0.5), iterations=jnp.asarray(7))
    again = repeated(begun, jnp.array([False, True, False]))
    assert np.all(again.basis[1] == 0) and np.all(again.basis[::2] == 1)
    assert again.step == begun.step / 4 and again.time_step == begun.time_step / 4 and again.share == 1.0
    cut = partly(begun, jnp.asarray(0.4))
    assert cut.share == 0.2 and cut.step == begun.step and again.iterations == cut.iterations == 8
    # A step is cut, but never to nothing.
    shares = [float(partly(begun, jnp.asarray(share)).share) for share in (1.0, 0.0, -1.0)]  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(shares, [0.4995, 0.0005, 0.0005], rtol=ROUNDING)
    for iterations, exhausted in ((ITERATIONS - 1, False), (ITERATIONS, True)):
        last = flow._replace(iterations=jnp.asarray(iterations))
        assert bool(partly(last, jnp.asarray(0.5)).exhausted) == exhausted
        assert bool(repeated(last, jnp.zeros(3, bool)).exhausted) == exhausted


@pytest.fixture(scope="module")
def rough():
    circle = jw.Circle(0.2, RADIUS)
    made = jw.Scene(jw.Whisker(), circle, jw.Support.fbfb(70.0), jw.ClosedForm(), friction=FRICTION)
    return dimensionless(made)


@pytest.fixture(scope="module")
def begun(rough):
    """A march of two whiskers that has just begun."""
    return begun_march(rough, jnp.array([1.0, -1.0]))


def march_of(begun, slip, force, leans, *, tries=0, rests=(False, False)):
    """The state at two tip contacts on the right."""
    friction = Friction(jnp.array(slip), jnp.zeros(2), jnp.zeros(2))
    z = jnp.stack([jnp.array(force), jnp.array(leans), jnp.array([-0.2, -0.3])], axis=1)
    return begun.replace(
        state=ContactState(jnp.array([int(Phase.tip)] * 2), jnp.ones(2), friction),
        point=Point(z, jnp.asarray(0.0)),
        slips_tried=jnp.asarray(tries),
        rests=jnp.array(rests),
    )


def changed(problem, begun, slip, rates, *, force=(1.0, 1.0), leans=(0.1, -0.1), falls=False, **more):
    """Whether a contact breaks a law along a tangent on which parameters or leans change at these rates."""
    march = march_of(begun, slip, force, leans, **more)
    tangent = Point(jnp.zeros((2, 3)).at[:, 1].set(jnp.array(rates)), jnp.asarray(-1.0))
    yes, slips = changed_slips(problem, march, march.point, tangent, jnp.asarray(falls))
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
