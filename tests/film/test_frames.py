"""Frames of a film: the steps of a scan, and the snaps between them."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
import several
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker.film.flow import flows
from jaxwhisker.film.frames import DEEPEST, SNAP_FRAMES, Silhouette, _mixed, between, frames, silhouettes_of_scan
from pictured import FILM_STEPS, ends_moved, row, snaps

CHORDS = 1e-4  # relative: a polyline of 64 points is shorter than the bent whisker
SOLVED = 1e-9  # accuracy of Newton's method for poses and contacts
SETTLED = 0.02  # lengths: the flow ends this close to where the march's Newton method takes over
ROUNDING = 1e-12  # relative


def starts(marks):
    return [(first, event) for first, event, _ in marks if event.kind >= jw.EventKind.snap_through]


def lengths(lines):
    return np.sum(np.hypot(np.diff(lines.x), np.diff(lines.y)), axis=-1)


def test_frames_run_evenly_from_the_first_step_to_the_last_and_snaps_add_frames(soft, film_of_soft):
    shown, marks = film_of_soft
    assert len(snaps(soft)) == 2
    assert shown.step.size == FILM_STEPS + 2 * SNAP_FRAMES
    assert np.all(np.diff(shown.step) >= 0)
    steps = shown.step[~shown.snap]
    assert steps[0] == 0 and steps[-1] == soft.control.size - 1
    assert np.ptp(np.diff(steps)) <= 1
    for name in ("fx", "mz", "base_x", "phase"):
        assert np.array_equal(getattr(shown.state, name)[~shown.snap], np.asarray(getattr(soft, name))[steps])
    assert np.array_equal(shown.control[~shown.snap], np.asarray(soft.control)[steps])
    assert [event.kind for _, event, _ in marks] == [event.kind for event in soft.events]


def test_an_event_happens_between_the_last_frame_before_and_the_first_one_after_it(film_of_soft):
    shown, marks = film_of_soft
    for first, event, _ in marks:
        assert shown.control[first - 1] >= event.control >= shown.control[first]


def test_a_snap_begins_at_the_state_before_it_and_ends_at_the_one_after_it(soft, film_of_soft):
    shown, marks = film_of_soft
    for first, event in starts(marks):
        assert np.all(shown.snap[first : first + SNAP_FRAMES])
        assert not shown.snap[first - 1] and not shown.snap[first + SNAP_FRAMES]
        assert np.all(shown.control[first : first + SNAP_FRAMES] == event.control)
        for k, state in ((first, event.before), (first + SNAP_FRAMES - 1, event.after)):
            for name in jw.State.__dataclass_fields__:
                if getattr(state, name) is not None:
                    assert np.array_equal(getattr(shown.state, name)[k], getattr(state, name))
            line = shapes_of(soft.scene, jax.tree.map(jnp.asarray, state), event.control, points=64)
            np.testing.assert_allclose(shown.lines.x[k], line.x, atol=SOLVED)
            np.testing.assert_allclose(shown.lines.y[k], line.y, atol=SOLVED)


def test_whiskers_keep_their_length_and_stay_out_of_the_object(soft, film_of_soft):
    shown, _ = film_of_soft
    np.testing.assert_allclose(lengths(shown.lines), 1.0, rtol=CHORDS)
    [parabola] = silhouettes_of_scan(soft)
    for k in np.flatnonzero(shown.snap):
        assert parabola.depth(shown.lines.x[k, 0], shown.lines.y[k, 0]) < DEEPEST


def test_frames_of_a_snap_are_about_evenly_far_apart(film_of_soft):
    shown, marks = film_of_soft
    for first, _ in starts(marks):
        moved = ends_moved(row(shown.lines, slice(first, first + SNAP_FRAMES)))
        assert moved.min() > 0.25 * moved.mean()
        assert moved.max() < 3 * moved.mean()  # a swinging tip moves along an arc, which is longer than the chord


def test_a_clamped_whisker_swings_to_the_far_side_while_its_base_stands_still():
    # A cone, five times thinner at its tip. Its flow on the far side starts from the touch there.
    cone = jw.Whisker(1.0, lambda s: (1 - 0.8 * s) ** 4)
    result = jw.scan(jw.Scene(cone, jw.Parabola(0.2)), np.linspace(-0.6, -0.8, 11))
    (number,) = snaps(result)
    (flow,) = flows(result, [number])
    event = result.events[number]
    np.testing.assert_allclose(flow.base_x, event.control, atol=SETTLED)
    assert np.all(flow.phase != jw.Phase.free)
    # From its right to its left. The moment is no criterion: it changes sign before the release.
    assert event.before.contact_x > event.control > flow.contact_x[-1]
    shown, marks = frames(result, 2)
    first = starts(marks)[0][0]
    snap = row(shown.state, slice(first, first + SNAP_FRAMES))
    # Bent to one side, then without a defined contact, then bent to the other side.
    touching = snap.phase[:, 0] != jw.Phase.free
    assert touching[0] and touching[-1] and not touching[SNAP_FRAMES // 2]
    assert np.all(snap.contact_force[~touching] == 0) and np.all(snap.mz[~touching] == 0)


def test_a_line_turns_from_one_to_another_and_keeps_its_length():
    s = np.linspace(0.0, 2.0, 64)
    upright = Shapes(jnp.zeros((1, 64)), jnp.asarray(s)[None])
    bent = Shapes(1.0 + (1 - jnp.cos(s))[None], jnp.sin(s)[None])  # a circle of radius one, two long
    far = Silhouette(np.array([-1.0, 1.0]), np.array([9.0, 9.0]))
    half = between(upright, bent, np.array([2.0]), 0.5, [far])
    # Half of the curvature: a circle of radius two that starts half-way between the bases.
    np.testing.assert_allclose(half.x[0], 0.5 + 2 * (1 - np.cos(s / 2)), atol=2e-3)
    np.testing.assert_allclose(half.y[0], 2 * np.sin(s / 2), atol=2e-3)
    np.testing.assert_allclose(lengths(half), 2.0, rtol=ROUNDING)


def test_a_line_that_would_enter_the_object_is_curled_around_it(stiff):
    event = stiff.events[snaps(stiff)[0]]
    ends = [
        shapes_of(stiff.scene, jax.tree.map(jnp.asarray, state), event.control, points=64)
        for state in (event.before, event.after)
    ]
    nowhere = Silhouette(np.array([-9.0, 9.0]), np.array([9.0, 9.0]))
    [parabola] = silhouettes_of_scan(stiff)
    before, after = jax.tree.map(np.asarray, ends)
    both = [between(before, after, np.ones(1), 0.4, [outline]) for outline in (nowhere, parabola)]
    straight, curled = jax.tree.map(np.asarray, both)
    assert parabola.depth(straight.x[0], straight.y[0]) > 10 * DEEPEST
    assert parabola.depth(curled.x[0], curled.y[0]) < DEEPEST
    np.testing.assert_allclose(lengths(curled), 1.0, rtol=ROUNDING)


def test_a_snap_from_several_contacts_turns_the_whisker_past_all_objects():
    result = several.scanned()
    shown, marks = frames(result, 20)
    ((first, event),) = starts(marks)
    assert shown.snap.sum() == SNAP_FRAMES and shown.state.phase.shape == (20 + SNAP_FRAMES, 1, 2)
    np.testing.assert_array_equal(shown.state.contact_force[first], event.before.contact_force)
    assert not np.asarray(shown.state.phase)[first + 1 : first + SNAP_FRAMES].any()
    np.testing.assert_allclose(lengths(shown.lines), 1.0, rtol=2 * CHORDS)
    for silhouette in silhouettes_of_scan(result):
        depths = [silhouette.depth(*line) for line in zip(shown.lines.x[:, 0], shown.lines.y[:, 0], strict=True)]
        assert max(depths) < DEEPEST


def test_contacts_between_two_states_stay_on_their_object():
    event = several.scanned().events[3]
    still = np.zeros(1, bool)
    halfway = _mixed(event.before, event.after, 0.5, still)
    # The outermost contact is on another object afterwards, and there is no second one.
    assert not np.asarray(halfway.phase).any() and not np.asarray(halfway.contact_force).any()
    assert float(halfway.fx[0]) == 0.0
    same = _mixed(event.before, event.before, 0.5, still)
    np.testing.assert_array_equal(same.contact_x, event.before.contact_x)
    assert float(same.fx[0]) == event.before.fx[0]


def test_depth_inside_a_concave_object():
    scene = jw.Scene(jw.Whisker(), (jw.Graph(several.wavy), jw.Parabola(0.2)), contacts=2)
    result: Any = SimpleNamespace(scene=scene)
    wave, parabola = silhouettes_of_scan(result)
    assert not wave.convex and parabola.convex
    hollow, hill = np.array([0.0]), np.array([-np.pi / 6])  # of heights 0.4 and 0.2
    assert wave.depth(hollow, np.array([0.35])) == 0.0 and wave.depth(hill, np.array([0.15])) == 0.0
    np.testing.assert_allclose(wave.depth(hill, np.array([0.23])), 0.03, atol=1e-3)
