"""Results and events, built by hand: selection, printing, batches."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.result import Event, Events, Result, check_one_scan
from jaxwhisker._scan.state import OPTIONAL, State
from several import EVENTS, scanned

ROOM = 4  # for events
SCENE = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfb(70.0))


def state(*shape):
    """States whose fields hold their own indices."""
    values = jnp.arange(float(np.prod(shape))).reshape(shape)
    fields: dict[str, Any] = {name: values for name in State.__dataclass_fields__ if name not in OPTIONAL}
    return State(**{**fields, "phase": jnp.zeros(shape, int)})


def events(count):
    """Events of two whiskers: a touch of each, then a snap-off of both, and padding or a release."""
    last = -1 if count < ROOM else jw.EventKind.release
    kinds = jnp.array([jw.EventKind.touch, jw.EventKind.touch, jw.EventKind.snap_off, last])
    whiskers = jnp.array([[True, False], [False, True], [True, True], [False, False]])
    control = jnp.array([0.7, 0.5, -1.2, jnp.nan])
    return Events(kinds, whiskers, control, 0.8 - control, state(ROOM, 2), state(ROOM, 2), jnp.asarray(count))


def result(count=3, status=(0, 0, 0)):
    """A scan of three steps."""
    steps = state(len(status), 2)
    fields = {name: getattr(steps, name) for name in State.__dataclass_fields__}
    return Result(
        **fields,
        control=jnp.linspace(0.8, -1.6, len(status)),
        spring_length=jnp.zeros((len(status), 2)),
        status=jnp.array(status),
        deferred_events=events(count),
        scene=SCENE,
    )


def test_events_in_order():
    all_of = list(events(3))
    assert [event.kind.name for event in all_of] == ["touch", "touch", "snap_off"]
    assert [event.whiskers for event in all_of] == [(1,), (2,), (1, 2)]
    assert [event.control for event in all_of] == [0.7, 0.5, -1.2]
    assert events(3)[-1].kind == jw.EventKind.snap_off
    assert len(events(0)) == 0 and list(events(0)) == []
    with pytest.raises(IndexError):
        events(3)[3]


def test_an_event_knows_its_whisker_and_state():
    touch, _, snap = events(3)
    assert (touch.whisker, snap.whisker) == (1, None)
    assert touch.state is touch.after
    np.testing.assert_array_equal(snap.before.fx, [4.0, 5.0])  # the third row
    assert str(touch) == "u = +0.700000000  touch of whisker 1"
    assert str(snap) == "u = -1.200000000  snap_off of whisker 1 2"
    nobody = Event(jw.EventKind.snap_through, (), -0.5, touch.before, touch.after)
    assert nobody.whisker is None and str(nobody) == "u = -0.500000000  snap_through"


def test_events_of_a_kind_and_whisker():
    of = events(3).of
    assert [event.control for event in of(jw.EventKind.touch)] == [0.7, 0.5]
    assert [event.control for event in of(jw.EventKind.touch, 2)] == [0.5]
    assert [event.control for event in of(jw.EventKind.snap_off, 2)] == [-1.2]
    assert of(jw.EventKind.release) == []


@pytest.mark.unchecked
@pytest.mark.parametrize("kind", ["touch", 0, None])
def test_a_kind_must_be_an_event_kind(kind):
    with pytest.raises(ValueError, match=r"`kind` must be an EventKind, such as EventKind\.touch, got "):
        events(3).of(kind)


@pytest.mark.unchecked
@pytest.mark.parametrize("whisker", [0, 3, -1, 1.5])
def test_there_must_be_such_a_whisker(whisker):
    with pytest.raises(ValueError, match=f"`whisker` must be a number from 1 to 2, got {whisker}"):
        events(3).of(jw.EventKind.touch, whisker)


def test_more_events_than_room():
    full, over = result(ROOM), result(ROOM + 3)
    assert not full.events.truncated and over.events.truncated
    assert len(over.events) == ROOM
    assert "events" not in str(full)
    assert "\nthe first and last of 7 events\n" in str(over)


def test_a_result_prints_its_steps_and_events():
    lines = str(result(status=(0, jw.Status.lost, jw.Status.lost))).splitlines()
    assert lines[0] == str(SCENE)
    assert lines[1] == "1 of 3 steps ok; 2: lost"
    assert lines[2:] == [str(event) for event in events(3)]
    assert repr(result()) == str(result())


def test_one_scan_is_no_batch_and_no_stranger():
    one = result()
    assert check_one_scan(one) is one
    batch = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), one, one)
    with pytest.raises(ValueError, match=r"`result` must be the result of a single scan, got a batch of shape \(2,\)"):
        check_one_scan(batch)
    selected = check_one_scan(jax.tree.map(lambda leaf: leaf[0], batch))
    np.testing.assert_array_equal(selected.fx, one.fx)
    with pytest.raises(TypeError, match=r"those of a batch of shape \(2,\): select one scan of the result first"):
        len(batch.events)
    with pytest.raises(ValueError, match="`result` must be the Result of a scan, got 'scan'"):
        check_one_scan("scan")


def test_events_name_contact_and_object_if_there_may_be_several():
    events = list(scanned().events)
    assert tuple(str(event).partition("  ")[2] for event in events) == EVENTS
    assert [event.contact for event in events] == [1, 2, 1, 1, 1, None]
    assert [event.object for event in events] == [1, 2, 1, 1, 2, None]
    assert [event.side is event.after for event in events] == [True, True, False, False, False, False]


def changed(state, **fields):
    """A state of an event, whose fields are NumPy arrays, with other fields."""
    return dataclasses.replace(jax.tree.map(jnp.asarray, state), **fields)


def test_events_of_single_contacts_concern_contact_1():
    touch, _, snap = events(3)
    assert (touch.contact, touch.object, touch.place) == (1, 1, "")
    assert (snap.contact, snap.object, snap.place) == (None, None, "")
    several = touch._replace(after=changed(touch.after, contact_object=jnp.array([2, 0])))
    assert several.object == 2
    assert several._replace(whiskers=(2,)).object is None


def test_the_contact_that_ends_may_be_any_one():
    release = scanned().events[3]
    inner = jnp.asarray(release.before.contact_force[:, ::-1])
    other = release._replace(before=changed(release.before, contact_force=inner))
    assert other.contact == 2 and str(other).endswith("release of whisker 1 from object 2 at contact 2")
    alone = changed(release.after, contact_object=None)
    assert str(release._replace(after=alone)).endswith("release of whisker 1 at contact 1")
