"""The march of whiskers with several contacts against exact scans: events in order, and the states around them."""

import numpy as np
import pytest

import jaxwhisker as jw
from several_cases import CASES, contacts_of, scanned, scene_of

CONTROL = 1e-8  # stored with ten decimals
NEXT_TO_A_FOLD = 1e-4  # of states: at a fold they change with the square root of the control
AT_WALL = 1e-5  # lengths
AFTER = 1e-8  # of states in which whiskers come to rest, relative to the largest value

by_name = pytest.mark.parametrize("name", CASES)


def kind_of(event: dict) -> str:
    """The kind as the package names it: a snap in which any whisker comes free is a snap off."""
    if "after" not in event:
        return event["kind"]
    before, after = ({contact[0] for contact in event[when]["contacts"]} for when in ("before", "after"))
    return "snap_off" if before - after else "snap_through"


@by_name
def test_events_are_exact_and_in_order(name):
    case, events = CASES[name], list(scanned(name).events)
    assert [event.kind.name for event in events] == [kind_of(event) for event in case["events"]]
    error = np.array([event.control for event in events]) - [event["control"] for event in case["events"]]
    assert np.max(np.abs(error)) < CONTROL


@by_name
def test_whiskers_of_events(name):
    case = CASES[name]
    for event, exact in zip(scanned(name).events, case["events"], strict=True):
        if event.kind not in (jw.EventKind.snap_off, jw.EventKind.snap_through):
            assert event.whiskers == (exact["whisker"],)
        elif event.kind == jw.EventKind.snap_off:
            before, after = ({contact[0] for contact in exact[when]["contacts"]} for when in ("before", "after"))
            assert set(event.whiskers) == before - after


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if any("after" in e for e in case["events"])])
def test_states_after_jumps_are_exact(name):
    case = CASES[name]
    for event, exact in zip(scanned(name).events, case["events"], strict=True):
        if "after" not in exact:
            continue
        compare(event.before, exact["before"], NEXT_TO_A_FOLD, len(case["whiskers"]))
        compare(event.after, exact["after"], AFTER, len(case["whiskers"]))


def compare(state, exact: dict, tolerance: float, whiskers: int) -> None:
    """Compare a state with a stored one."""
    for signal in ("base_x", "fx", "fy", "mz"):
        error = np.asarray(getattr(state, signal)) - exact[signal]
        assert np.max(np.abs(error)) < tolerance * (1 + np.max(np.abs(exact[signal]))), signal
    for whisker in range(whiskers):
        stored = [contact for contact in exact["contacts"] if contact[0] == whisker + 1]
        found = contacts_of(state, whisker)
        assert len(found) == len(stored)
        for own, contact in zip(found, stored, strict=True):
            assert contact[2] in (None, own[0])
            assert np.max(np.abs(np.array(own[1:]) - contact[3:])) < tolerance * (1 + contact[3])


@by_name
def test_a_contact_begins_and_ends_without_force(name):
    for event in scanned(name).events:
        if event.kind in (jw.EventKind.touch, jw.EventKind.release):
            state = event.after if event.kind == jw.EventKind.touch else event.before
            forces = [own[1] for own in contacts_of(state, event.whiskers[0] - 1)]
            assert min(np.abs(forces)) < CONTROL


def test_all_steps_before_a_base_gets_into_a_wall_are_equilibria():
    case = CASES["pipe"]
    wall = float(np.sqrt(case["objects"][0]["radius"] ** 2 - case["objects"][0]["height"] ** 2))
    control = np.linspace(0.0, wall + 0.02, 12)
    control = np.sort(np.append(control, [wall - AT_WALL, wall + AT_WALL]))
    status = np.asarray(jw.scan(scene_of(case), control).status)
    np.testing.assert_array_equal(status == jw.Status.ok, control < wall)
    assert np.all(status[control > wall] == jw.Status.lost)
