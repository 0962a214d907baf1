"""Margins of stored exact states, their rates, and the contacts that begin."""

# pyright: reportArgumentType=false
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.march_state import AT_STOP, HIGH, LOW, PHASE, RELEASE, TOUCH, inserted
from jaxwhisker._chain.margins import (
    TOUCHING,
    begins_at,
    first_violated,
    is_full,
    margin_rates,
    margins_of,
    new_contact,
    piece_ends,
    z_before,
)
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march_state import Task
from several_engine import STOP, candidates, march_at, problem, trial_at, with_contacts

ROUNDING = 1e-12
STEP = 1e-3  # along the path; margins of contacts are linear in their numbers
TIP = ChainState(jnp.array([int(Phase.tip), int(Phase.free)]), jnp.ones(2), jnp.zeros(2, int))


def at_tip(slack: float):
    """A march whose only contact is at the tip, with this slack."""
    march = march_at(with_contacts(1))
    return march.replace(state=TIP, point=march.point._replace(z=march.point.z.at[0, SLACK].set(slack)))


def margins(march):
    return margins_of(problem(), march, march.point.z, march.point.u, march.stance, jnp.asarray(STOP))


def test_margins_of_contacts_on_the_shaft():
    march = march_at(with_contacts(2))
    own, z = margins(march), march.point.z
    np.testing.assert_allclose(own[TOUCH], march.stance.gap + TOUCHING, atol=ROUNDING)
    np.testing.assert_array_equal(own[RELEASE], z[:, FORCE])
    np.testing.assert_array_equal(own[PHASE], [z[0, SLACK], np.inf])  # only the outermost one can come to the tip
    assert np.all(np.isinf(own[LOW])) and np.all(np.isinf(own[HIGH]))  # the graph has no ends
    np.testing.assert_allclose(own[AT_STOP], [float(march.point.u) - STOP], atol=ROUNDING)


def test_places_that_are_not_used_have_no_margins():
    own = margins(march_at(with_contacts(1)))
    for kind in (RELEASE, PHASE, LOW, HIGH):
        assert np.isinf(own[kind][1])


@pytest.mark.parametrize(("slack", "margin"), [(-0.4, 0.4), (-3.0, np.pi - 3.0), (0.1, -0.1)])
def test_a_tip_contact_ends_at_either_tangent(slack, margin):
    np.testing.assert_allclose(margins(at_tip(slack))[PHASE], [margin, np.inf], atol=ROUNDING)


@pytest.mark.parametrize("march", [lambda: march_at(with_contacts(2)), lambda: at_tip(-0.4), lambda: at_tip(-3.0)])
def test_rates_of_forces_and_slacks(march):
    march = march()
    z, tangent = march.point.z, march.tangent
    moved = march.replace(point=Point(z + STEP * tangent.z, march.point.u + STEP * tangent.u))
    rates, here, there = margin_rates(problem(), march, tangent), margins(march), margins(moved)
    for kind in (RELEASE, PHASE):
        change = np.where(np.isfinite(here[kind]), np.asarray(there[kind]) - here[kind], 0.0)
        np.testing.assert_allclose(rates[kind], change / STEP, atol=1e-9)
    assert np.any(np.asarray(rates[RELEASE]) != 0) and float(rates[PHASE][0]) != 0


def test_pieces_of_smooth_objects_have_no_ends():
    low, high = piece_ends(problem(), march_at(with_contacts(2)))
    np.testing.assert_array_equal(low, [-np.inf, -np.inf])
    np.testing.assert_array_equal(high, [np.inf, np.inf])


@pytest.mark.parametrize(("shift", "row"), [(-0.01, 0), (0.01, 1)])
def test_contacts_begin_between_those_beside_them(shift, row):
    march = march_at(with_contacts(1))
    own = candidates(Phase.tangential, float(march.point.z[0, SLACK]) + shift)
    new = new_contact(problem(), march, march.point.z, own, jnp.asarray(1))
    assert int(new.row) == row and float(new.numbers[1]) == 0.3 and float(new.side) == -1.0


def test_a_contact_at_the_tip_comes_first():
    march = march_at(with_contacts(1))
    new = new_contact(problem(), march, march.point.z, candidates(Phase.tip, -0.3), jnp.asarray(1))
    assert int(new.row) == 0 and int(new.phase) == Phase.tip


@pytest.mark.parametrize("count", [1, 2])
def test_whiskers_are_full_with_two_contacts(count):
    for row in (0, 1):
        assert bool(is_full(problem(), march_at(with_contacts(count)), jnp.asarray(row))) == (count == 2)


def test_a_contact_that_begins_is_not_there_on_arrival():
    march = march_at(with_contacts(1))
    new = new_contact(problem(), march, march.point.z, candidates(Phase.tip, -0.3), jnp.asarray(1))
    z, state = inserted(march.point.z, march.state, new, 2)
    target = march.target._replace(number=jnp.asarray(TOUCH), first=new)
    begins = march.replace(task=jnp.asarray(int(Task.event)), target=target)
    assert bool(begins_at(begins))
    trial = trial_at(begins, z, state)
    trial = trial._replace(stance=trial.stance._replace(parameter=z[:, PARAMETER]))
    before, parameter = z_before(problem(), begins, trial)
    np.testing.assert_array_equal(before, march.point.z)
    np.testing.assert_array_equal(parameter, march.point.z[:, PARAMETER])
    other = begins.replace(target=target._replace(number=jnp.asarray(RELEASE)))
    assert not bool(begins_at(other))
    np.testing.assert_array_equal(z_before(problem(), other, trial_at(other, z, state))[0], z)


def test_the_first_event_within_a_step():
    march = march_at(with_contacts(2))
    march = march.replace(task=jnp.asarray(int(Task.advance)))
    z = march.point.z
    some, _ = first_violated(problem(), march, trial_at(march, z), jnp.asarray(STEP))
    assert not bool(some)
    # The force of the inner contact vanishes after a quarter of the step, the slack after half of it.
    end = z.at[1, FORCE].multiply(-3.0).at[0, SLACK].multiply(-1.0)
    some, target = first_violated(problem(), march, trial_at(march, end), jnp.asarray(STEP))
    assert bool(some) and int(target.number) == RELEASE
    assert target.whiskers.tolist() == [False, True]
    np.testing.assert_allclose(target.distance, STEP / 4, rtol=1e-9)
    ignored = [jnp.zeros_like(margin, bool) for margin in margins(march)]
    ignored[RELEASE] = jnp.array([False, True])
    some, target = first_violated(problem(), march, trial_at(march, end), jnp.asarray(STEP), ignored)
    assert bool(some) and int(target.number) == PHASE and target.whiskers.tolist() == [True, False]


def test_a_touch_knows_where_it_begins():
    march = march_at(with_contacts(1))
    march = march.replace(task=jnp.asarray(int(Task.advance)))
    trial = trial_at(march, march.point.z, phase=Phase.tip, slack=-0.3)
    touched = march.stance._replace(gap=march.stance.gap.at[0, 1].set(-1e-3))
    some, target = first_violated(problem(), march, trial._replace(stance=touched), jnp.asarray(STEP))
    assert bool(some) and int(target.number) == TOUCH
    assert int(target.first.row) == 0 and int(target.first.phase) == Phase.tip
    assert target.whiskers.tolist() == [True, False]
