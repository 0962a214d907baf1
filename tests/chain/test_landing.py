"""Landings: where rods flow from, how contacts are revised, and when the march gives up."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.landing import (
    BEYOND,
    CLOSEST,
    DEEP,
    FIRST,
    LIGHT,
    OF_SLIPS,
    SLIPS,
    STRAYS,
    after_flow,
    flow_again,
    revised_landing,
    state_differs,
    strays,
    to_snap,
    towards_loss,
)
from jaxwhisker._chain.march_state import SNAP, MarchOfChain
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import EventKind, Status
from several_cases import CASES
from several_engine import march_at, of_event, problem, trial_at, with_contacts

PLACE = 0.02  # lengths: two links of the coarse rods
ROUNDING = 1e-9  # of contacts of rods at rest, between a batch and one rod
PUSHES = 0.1  # of forces of coarse rods, relative
SNAPS = [event for event in CASES["wavy"]["events"] if "after" in event]

revised, flowed = jax.jit(revised_landing), jax.jit(after_flow)
flowed_lanes = jax.jit(jax.vmap(after_flow, (None, 0)))


def test_rods_flow_from_where_stability_is_lost():
    march = march_at(with_contacts(2))
    flowing = to_snap(march)
    assert int(flowing.task) == Task.flow and int(flowing.flow.attempt) == FIRST
    np.testing.assert_array_equal(flowing.flow.start, march.point.z)
    assert float(flowing.flow.u) == float(march.point.u)
    np.testing.assert_array_equal(flowing.pending.z_before, march.point.z)


def test_a_contact_that_slips_over_an_end_flows_from_beyond_it():
    march = march_at(with_contacts(2))
    flowing = to_snap(march.replace(slips=jnp.asarray(True)))
    np.testing.assert_allclose(flowing.flow.start, march.point.z + SLIPS * march.tangent.z)
    assert int(flowing.flow.attempt) == OF_SLIPS and not bool(flowing.slips)


def test_rods_flow_elsewhere_behind_the_loss_again_and_again():
    march = to_snap(march_at(with_contacts(2)))
    for attempt in range(1, len(BEYOND)):
        march = flow_again(march.replace(task=jnp.asarray(int(Task.arrive))))
        assert int(march.task) == Task.flow and int(march.flow.attempt) == attempt
        assert float(march.point.u) == float(march.flow.u)
    assert int(flow_again(march).status) == Status.unsettled
    assert int(flow_again(march).task) == Task.done


def test_contacts_are_followed_to_the_loss_in_shorter_steps_if_one_does_not_do():
    march = landed()
    loss = float(march.flow.u)
    march = march.replace(point=march.point._replace(u=loss - 0.02), flow=march.flow._replace(landed=loss - 0.02))
    trial = trial_at(march, march.point.z)
    onwards, _, worth = towards_loss(march, trial)
    assert float(onwards.point.u) == loss and not bool(worth)
    _, shorter, worth = towards_loss(onwards, trial)
    assert bool(worth) and float(shorter.point.u) == pytest.approx(loss - 0.01)
    assert float(shorter.flow.landed) == pytest.approx(loss - 0.02)
    close = onwards.replace(flow=onwards.flow._replace(landed=loss - 0.5 * CLOSEST))
    assert not bool(towards_loss(close, trial)[2])


def test_states_differ_by_contacts_and_pieces():
    state = with_contacts(2).state
    assert not bool(state_differs(state, state))
    assert not bool(state_differs(state, state._replace(side=-state.side)))
    assert not bool(state_differs(state, state._replace(phase=state.phase.at[0].set(3 - state.phase[0]))))
    assert bool(state_differs(state, state._replace(phase=state.phase.at[1].set(0))))
    assert bool(state_differs(state, state._replace(piece=state.piece.at[0].set(1))))


def landed(count: int = 2) -> MarchOfChain:
    """A march that arrives after a snap, with contacts that are right."""
    return to_snap(march_at(with_contacts(count))).replace(task=jnp.asarray(int(Task.arrive)))


def test_a_landing_in_the_right_contacts_is_not_revised():
    march = landed()
    _, wrong = revised(problem(), march, trial_at(march, march.point.z))
    assert not bool(wrong)


def test_an_equilibrium_with_other_forces_than_those_on_rods_at_rest_is_not_where_they_land():
    march = landed()
    z = march.point.z
    rests = march.replace(flow=march.flow._replace(push=jnp.sum(z[:, FORCE])[None]))
    shared = z.at[:, FORCE].set(z[::-1, FORCE])
    beyond = z.at[0, FORCE].add(STRAYS * jnp.sum(z[:, FORCE]) + 1.01 * LIGHT)
    for there, other in ((z, False), (shared, False), (beyond, True)):
        assert bool(strays(problem(), rests, trial_at(march, there))) == other


def test_a_contact_that_pulls_is_taken_out():
    march = landed()
    z = march.point.z.at[1, FORCE].multiply(-1.0)
    new, wrong = revised(problem(), march, trial_at(march, z))
    assert bool(wrong) and int(new.flow.tries) == 1
    assert new.state.phase.tolist() == [int(march.state.phase[0]), int(Phase.free)]
    np.testing.assert_array_equal(new.point.z[0], z[0])


def test_a_contact_beyond_the_tip_becomes_one_at_the_tip():
    march = landed()
    z = march.point.z.at[0, SLACK].multiply(-1.0)
    new, wrong = revised(problem(), march, trial_at(march, z))
    assert bool(wrong) and new.state.phase.tolist() == [int(Phase.tip), int(Phase.tangential)]
    assert float(new.point.z[0, SLACK]) == 0.0


@pytest.mark.parametrize("count", [1, 2])
def test_a_missing_contact_is_put_in_if_there_is_room(count):
    march = landed(count)
    trial = trial_at(march, march.point.z, phase=Phase.tip, slack=-0.3)
    gap = jnp.ones_like(march.stance.gap).at[0, 1].set(-2 * DEEP)
    new, wrong = revised(problem(), march, trial._replace(stance=march.stance._replace(gap=gap)))
    assert bool(wrong)
    if count == 1:
        assert new.state.phase.tolist() == [int(Phase.tip), int(Phase.tangential)]
        np.testing.assert_array_equal(new.point.z[1], march.point.z[0])
    else:
        assert int(new.status) == Status.too_many_contacts


@pytest.mark.parametrize("event", [SNAPS[0], SNAPS[-1]], ids=lambda event: event["kind"])
def test_rods_come_to_rest_in_the_contacts_after_a_snap(event):
    march = to_snap(march_at(of_event(event)))
    new, written, _ = flowed(problem(), march)
    contacts = event["after"]["contacts"]
    assert not bool(written)
    assert int(new.pending.kind) == (EventKind.snap_through if contacts else EventKind.snap_off)
    assert new.pending.whiskers.tolist() == [True, False]
    assert int(new.target.number) == SNAP and int(jnp.sum(new.state.touches)) == len(contacts)
    np.testing.assert_allclose(new.point.u, event["control"] - BEYOND[0])
    for row, (_, _, _, force, _, x, _) in zip(new.point.z, contacts[::-1], strict=False):
        assert abs(float(row[0]) - force) < PUSHES * force and abs(float(row[1]) - x) < PLACE


@pytest.mark.parametrize(
    ("other", "then"), [(Task.advance, Task.flow), (Task.done, Task.arrive), (Task.flow, Task.arrive)]
)
def test_lanes_of_a_batch_flow_together(other, then):
    # The flow of one lane costs as much as that of all.
    flowing = to_snap(march_at(of_event(SNAPS[0])))
    lanes = flowing, flowing.replace(task=jnp.asarray(int(other)))
    new, _, _ = flowed_lanes(problem(), jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes))
    assert int(new.task[0]) == then
    if then == Task.arrive:
        alone, _, _ = flowed(problem(), flowing)
        np.testing.assert_allclose(new.point.z[0], alone.point.z, atol=ROUNDING)
