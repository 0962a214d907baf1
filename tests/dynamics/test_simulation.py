"""Events of a trace that is made by hand, and their interface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.simulation import EVENTS, MotionEnergy, TimedEvents, Trace, events_of, rest_angles
from jaxwhisker._path.path import EventKind

H, STEPS = 0.1, 8
TIME = H * jnp.arange(STEPS + 1)
EXACT = 1e-12


def control(t):
    return 1.0 - 2.0 * t


def trace(**fields):
    """Two whiskers, of which the second one never touches."""
    none = np.zeros((STEPS + 1, 2))
    touches = none > 0
    touches[3:7, 0] = True
    given = {"touches": touches, "force": none, "gap": none + 1, "at_tip": none + 1, "slope": none + 1}
    each = {"work": none[:, 0], "contact": none[:, 0], "impact": none[:, 0]}
    for name, values in fields.items():
        given[name] = given[name] + 0.0
        given[name][: len(values), 0] = values
    return Trace(**{name: jnp.asarray(values) for name, values in (given | each).items()})


MOVED = trace(
    gap=[0.25, 0.15, 0.05],  # decreases by 0.1 per step: it closes half a step after the last value
    force=[0.0, 0.0, 0.0, 0.0, 4.0, 3.0, 1.0],  # means over steps, at whose middle they are reached
    at_tip=[1.0, 1.0, 1.0, 0.6, -0.2, -0.1, 0.3, 0.2, 0.2],
    slope=[0.3, 0.3, 0.3, 0.3, 0.1, -0.1, -0.1, -0.1, -0.1],
)
ALL = jnp.ones(STEPS + 1, bool)
EXPECTED = [
    (EventKind.touch, 0.25),
    (EventKind.tip_to_tangential, 0.375),
    (EventKind.vertex, 0.45),
    (EventKind.tangential_to_tip, 0.525),
    (EventKind.release, 0.6),
]


@jax.jit
def found(trace, ok):
    return events_of(trace, ok, TIME, control)


def test_events_are_in_order_and_between_steps():
    events = found(MOVED, ALL)
    assert len(events) == events.count == len(EXPECTED)
    for event, (kind, time) in zip(events, EXPECTED, strict=True):
        assert (event.kind, event.whisker) == (kind, 1)
        assert event.time == pytest.approx(time, abs=EXACT)
        assert event.control == pytest.approx(control(time), abs=EXACT)
    assert np.all(events.kind[5:] == -1) and np.all(events.whisker[5:] == 0)
    assert np.isnan(events.time[5:]).all() and np.isnan(events.control[5:]).all()


def test_steps_that_failed_have_no_events():
    assert [event.kind for event in found(MOVED, ALL.at[5:].set(False))] == [kind for kind, _ in EXPECTED[:2]]
    assert len(found(MOVED, ~ALL)) == 0


def test_nothing_is_extrapolated_beyond_a_step():
    """A gap that grows before the touch, and a force that grows before the release."""
    events = found(trace(gap=[0.05, 0.1, 0.2], force=[0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0]), ALL)
    assert [event.kind for event in events] == [EventKind.touch, EventKind.release]
    np.testing.assert_allclose([event.time for event in events], [0.3, 0.6], atol=EXACT)


def test_the_time_of_a_touch_has_the_derivative_of_the_interpolation():
    def time(gap):
        return events_of(MOVED._replace(gap=MOVED.gap.at[1:3, 0].set(gap)), ALL, TIME, control).time[0]

    before, last = 0.15, 0.05
    expected = [-H * last / (before - last) ** 2, H * before / (before - last) ** 2]
    rates = jax.jit(lambda gap: (jax.jacfwd(time)(gap), jax.jacrev(time)(gap)))(jnp.array([before, last]))
    np.testing.assert_allclose(rates, [expected] * 2, atol=EXACT)


def test_there_may_be_more_events_than_room():
    steps = 2 * EVENTS
    values = jnp.ones((steps + 1, 1))
    touches = (jnp.arange(steps + 1) % 2 == 1)[:, None]
    often = Trace(touches, values, values, values, values, *[values[:, 0]] * 3)
    events = jax.jit(lambda: events_of(often, jnp.ones(steps + 1, bool), H * jnp.arange(steps + 1.0), control))()
    assert events.count == steps and len(events) == EVENTS
    assert [event.kind for event in events][:3] == [EventKind.touch, EventKind.release, EventKind.touch]


def test_events_are_selected_by_kind_and_whisker():
    kinds = jnp.array([EventKind.touch, EventKind.touch, EventKind.release, -1])
    events = TimedEvents(kinds, jnp.array([1, 2, 1, 0]), jnp.arange(4.0), -jnp.arange(4.0), jnp.asarray(3))
    assert [event.whisker for event in events.of(EventKind.touch)] == [1, 2]
    assert [event.time for event in events.of(EventKind.touch, 2)] == [1.0]
    assert events[-1].kind == EventKind.release
    assert str(events[1]) == "t = 1, u = -1.000000  touch of whisker 2"
    with pytest.raises(IndexError):
        events[3]
    with pytest.raises(TypeError, match=r"a batch of shape \(2,\)"):
        len(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), events))


@pytest.mark.unchecked
def test_a_kind_must_be_an_event_kind():
    with pytest.raises(ValueError, match="`kind` must be an EventKind"):
        found(MOVED, ALL).of(0)  # pyright: ignore[reportArgumentType]


def test_the_total_energy_and_the_angles_of_the_unloaded_whisker():
    energy = MotionEnergy(*(jnp.full(1, 10.0**k) for k in range(8)))
    assert energy.total == 111.0
    whisker = jw.Whisker(0.6, intrinsic_curvature=-0.5)
    np.testing.assert_allclose(rest_angles(whisker, 3), -0.5 * 0.6 * basis(3).points, atol=EXACT)
