"""Solved ends of steps at stored exact states: along the path, at events, and right after them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.march_state import RELEASE, TOUCH, MarchOfChain, NewContact, TrialOfChain, removed
from jaxwhisker._chain.newton import solve_points
from jaxwhisker._chain.trial import solved_trial
from jaxwhisker._equilibrium.contact import FORCE, Phase
from jaxwhisker._equilibrium.point import Point, along, at_control
from jaxwhisker._path.march_state import Target, Task
from several_cases import CASES
from several_engine import Known, march_at, of_event, problem, with_contacts

STEP = 0.01  # length of a step
PLACE = 1e-8  # of controls of stored events, which have ten decimals
SOLVED = 1e-9  # of solved states, relative to their largest number
AWAY = 1e-3  # of guesses

EVENTS = CASES["wavy"]["events"]


@jax.jit
def tried(problem, march: MarchOfChain) -> TrialOfChain:
    """The end of a step whose stop is far ahead."""
    return solved_trial(problem, march, jnp.array([-3.0]), jnp.asarray(0))


def one_hot(row: int):
    """The row of a contact among two."""
    return jnp.arange(2) == row


def with_task(march: MarchOfChain, task: Task, number: int = TOUCH, row: int = 0, **changes) -> MarchOfChain:
    """A march with a task, of which the target is an event of a row."""
    rows = one_hot(row)
    target = march.target._replace(number=jnp.asarray(number), whiskers=rows, distance=jnp.asarray(0.0))
    return march.replace(task=jnp.asarray(int(task)), target=target, **changes)


def released(known: Known, row: int) -> Known:
    """The state without a contact."""
    z, state = removed(known.z, known.state, one_hot(row), 2)
    return known._replace(z=z, state=state)


@pytest.mark.parametrize("count", [1, 2])
def test_a_step_along_the_path(count):
    march = march_at(with_contacts(count))
    march = with_task(march, Task.advance, step=jnp.asarray(STEP))
    trial = tried(problem(), march)
    assert bool(trial.converged) and bool(trial.stable) and bool(trial.stance.opens)
    assert float(trial.point.u) < float(march.point.u)
    exact = jax.jit(solve_points)(problem(), march.state, at_control(trial.point.u, trial.point.z), trial.point)
    np.testing.assert_allclose(trial.point.z, exact.point.z, atol=SOLVED * np.max(np.abs(exact.point.z)))
    # It ends where the tangent leads, to second order.
    guess = along(march.point, march.tangent, march.step, march.bend)
    off = np.max(np.abs(np.asarray(trial.point.z - guess.z)))
    assert 0 < off < 100 * STEP**2
    np.testing.assert_array_equal(trial.guess.z, guess.z)


def test_a_step_back_is_not_stable():
    march = march_at(with_contacts(2))
    back = jax.tree.map(lambda leaf: -leaf, march.tangent)
    trial = tried(problem(), with_task(march, Task.advance, step=jnp.asarray(STEP), tangent=back))
    assert bool(trial.converged) and not bool(trial.stable)


def test_the_point_of_a_release():
    event = next(event for event in EVENTS if event["kind"] == "release")
    u, z, state = of_event(event)
    row = int(np.argmin(z[:, FORCE]))
    march = with_task(march_at(Known(u, z, state)), Task.event, RELEASE, row)
    trial = tried(problem(), march.replace(point=Point(z + AWAY, u + AWAY)))
    assert bool(trial.converged)
    assert abs(float(trial.point.u) - event["control"]) < PLACE
    assert abs(float(trial.point.z[row, FORCE])) < PLACE


def test_the_point_of_a_touch():
    event = [event for event in EVENTS if event["kind"] == "touch"][-2]
    rows = event["before"]["contacts"]
    own, (new,) = ([c for c in rows if (c[3] > 0) == pushes] for pushes in (True, False))
    u, z, state = of_event(event, own)
    slack = 1 - new[4]
    first = NewContact(
        jnp.asarray(1), jnp.array([0.0, new[5] + AWAY, slack]), jnp.asarray(int(Phase.tangential)), *_upward()
    )
    march = march_at(Known(u, z, state))
    march = with_task(march, Task.event, TOUCH)
    assert isinstance(march.target, Target)
    march = march.replace(target=march.target._replace(first=first), point=Point(march.point.z, u + AWAY))
    trial = tried(problem(), march)
    assert bool(trial.converged) and bool(trial.stable)
    assert trial.state.phase.tolist() == [int(state.phase[0]), int(Phase.tangential)]
    assert abs(float(trial.point.u) - event["control"]) < PLACE
    np.testing.assert_allclose(trial.point.z[1], [0.0, new[5], slack], atol=10 * PLACE)


def _upward():
    return jnp.asarray(1.0), jnp.asarray(0)  # along the object's tangent, on its only piece


@pytest.mark.parametrize(("direction", "opens"), [(-1.0, True), (1.0, False)])
def test_a_released_contact_opens_as_the_drive_moves_on(direction, opens):
    event = next(event for event in EVENTS if event["kind"] == "release")
    before = of_event(event)
    row = int(np.argmin(before.z[:, FORCE]))
    after = released(before, row)
    arrived = march_at(before)
    march = march_at(after)
    pending = arrived.node(arrived.point, arrived.tangent)
    march = with_task(march, Task.arrive, RELEASE, row, pending=pending, direction=jnp.asarray(direction))
    trial = tried(problem(), march)
    assert bool(trial.converged)
    np.testing.assert_allclose(trial.point.z, after.z, atol=10 * PLACE)
    assert bool(trial.stable) == opens
    assert not bool(tried(problem(), march.replace(slips=jnp.asarray(True))).stable)
