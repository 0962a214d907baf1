"""Results depend on the path, not on the grid: coarse and fine, out and back, from the middle, beside the object."""

import exact
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxwhisker as jw
from scenes import all_ok, event_list, model, step_nearest

GRID = 1e-9  # states shared by two grids
EVENT = 1e-8  # events of two grids
RETRACE = 1e-9  # of states out and back without a snap
FLAT = np.linspace(3.3, -4.0, 400)  # across a wide object


def test_coarse_and_fine_agree():
    for name in ("FB", "FBFBR"):
        results = [jw.scan(model(name), np.arange(1500, -3500, -k) / 2000.0) for k in (20, 4, 1)]
        fine = results[-1]
        for coarse, k in zip(results[:-1], (20, 4), strict=True):
            assert all_ok(coarse)
            for field in ("fx", "fy", "mz", "base_x"):
                np.testing.assert_allclose(getattr(coarse, field), getattr(fine, field)[::k], atol=GRID * 10)
            np.testing.assert_allclose([e[2] for e in event_list(coarse)], [e[2] for e in event_list(fine)], atol=EVENT)
            assert [e[:2] for e in event_list(coarse)] == [e[:2] for e in event_list(fine)]


def test_out_and_back_without_a_snap_retraces_itself():
    out = np.linspace(0.8, -1.2, 201)
    result = jw.scan(model("FBFBR"), np.concatenate([out, out[-2::-1]]))
    assert all_ok(result)
    assert not any(e.kind in (jw.EventKind.snap_off, jw.EventKind.snap_through) for e in result.events)
    for field in ("fx", "fy", "mz", "base_x"):
        values = np.asarray(getattr(result, field))
        np.testing.assert_allclose(values[201:], values[:200][::-1], atol=RETRACE * 10)
    kinds = [e[0] for e in event_list(result)]
    assert kinds.count("touch") == kinds.count("release") == 2
    assert kinds.count("vertex") % 2 == 0


@pytest.mark.parametrize("beyond", [1e-8, 1e-10, 1e-11, 1e-13])
def test_a_whisker_that_grazes_the_object_passes_it(beyond):
    result = jw.scan(model("FB", distance=1 - beyond), np.linspace(-0.1995, -0.2005, 171))
    assert all_ok(result)
    events = event_list(result)
    if beyond < 5e-11:  # too little to decide where it touches
        assert not events and np.max(result.contact_force) == 0
    else:
        assert [e[0] for e in events] == ["touch", "vertex", "snap_off"]
        np.testing.assert_allclose(events[0][2], -0.2 + np.sqrt(beyond), atol=EVENT)
    assert result.fx[-1, 0] == 0


def test_back_after_a_snap_through_stays_on_the_far_branch():
    # FB q = 0.1, c = 30 snaps through the vertex at u = -0.8505; on the way back it stays beyond it for a while.
    out = np.linspace(0.8, -0.9, 171)
    result = jw.scan(model("FB", 30.0, distance=0.1), np.concatenate([out, out[::-1]]))
    assert all_ok(result)
    snaps = result.events.of(jw.EventKind.snap_through)
    assert len(snaps) == 2
    assert snaps[1].control > snaps[0].control + 0.1
    between = step_nearest(result, -0.8)
    back = 341 - between
    assert result.base_x[between, 0] > 0 > result.base_x[back, 0]
    assert result.fx[between, 0] < 0 < result.fx[back, 0]


def test_back_after_a_snap_off_touches_from_the_other_side():
    out = np.linspace(1.5, -1.5, 301)
    result = jw.scan(model("FB"), np.concatenate([out, out[::-1]]))
    assert all_ok(result)
    kinds = [e[0] for e in event_list(result)]
    assert kinds.count("snap_off") == 2
    again = result.events.of(jw.EventKind.touch)[1]
    assert abs(again.after.base_x[0] + np.sqrt(0.8)) < EVENT
    at = step_nearest(result, -1.2)
    assert result.phase[at, 0] != jw.Phase.free
    assert result.phase[601 - at, 0] == jw.Phase.free
    assert result.mz[601 - step_nearest(result, 0.0), 0] < 0


def test_starting_in_the_middle_of_contact():
    whole = jw.scan(model("FBFB"), np.linspace(0.8, -1.6, 241))
    part = jw.scan(model("FBFB"), np.linspace(-0.4, -1.6, 121))
    for field in ("fx", "fy", "mz", "base_x", "phase"):
        np.testing.assert_allclose(getattr(part, field), getattr(whole, field)[120:], atol=GRID * 10)
    assert event_list(part)[0][2] < -0.4
    assert [e[:2] for e in event_list(part)] == [e[:2] for e in event_list(whole) if e[2] < -0.4]


def test_one_step_and_standing_still():
    one = jw.scan(model("FB"), np.array([-0.5]))
    still = jw.scan(model("FB"), np.array([0.7, -0.5, -0.5, -0.5]))
    assert all_ok(one) and all_ok(still)
    np.testing.assert_allclose(still.fy[1:, 0], np.repeat(one.fy[0, 0], 3), atol=GRID)


def test_an_object_out_of_reach_is_no_contact():
    with pytest.warns(UserWarning, match=r"The scan touches nothing: .*parabola q = 1\.5"):
        result = jw.scan(model("FBFBR", distance=1.5))
    assert all_ok(result)
    assert len(result.events) == 0
    for field in ("fx", "fy", "mz", "contact_force"):
        assert np.all(np.asarray(getattr(result, field)) == 0)
    np.testing.assert_allclose(result.base_x[:, 0] - result.control, 0.2, atol=1e-12)


def test_the_default_control_contains_all_events():
    for name in ("clamped", "FB", "FBFBFBR"):
        result = jw.scan(model(name))
        assert np.all(np.asarray(result.phase[0]) == jw.Phase.free)
        assert np.all(np.asarray(result.phase[-1]) == jw.Phase.free)
        assert result.control[0] > event_list(result)[0][2] > event_list(result)[-1][2] > result.control[-1]
        np.testing.assert_allclose(np.diff(result.control), -0.001, atol=1e-12)


def test_the_far_side():
    # With c = 10 the whisker slips at u = -1.0246, lands on the far side, bent the other way, and leaves smoothly.
    result = jw.scan(model("FB", 10.0))
    landing = result.events.of(jw.EventKind.snap_through)[1]
    assert landing.whiskers == (1,)
    assert landing.whisker == 1
    assert result.events[2].whisker is None  # the snap through the vertex, at which no whisker slips
    assert landing.state is landing.after
    assert landing.before.mz[0] > 0 > landing.after.mz[0]
    assert abs(landing.after.base_x[0] + 0.8400653) < 1e-6
    assert abs(event_list(result)[-1][2] + 1.094427191) < EVENT
    assert event_list(result)[-1][0] == "release"


def test_sixteen_whiskers_in_a_row():
    springs = tuple(jw.Spring((k, k + 1), 200.0, 0.15) for k in range(16))
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.4), jw.Support(springs)), np.linspace(0.8, -3.8, 300))
    assert all_ok(result)
    assert result.fx.shape == (300, 16)
    # Every whisker touches the object; some spring back after a snap and touch it again.
    assert {w for kind, whiskers, _ in event_list(result) if kind == "touch" for w in whiskers} == set(range(1, 17))
    drive = 200.0 * (np.asarray(result.spring_length)[:, 0] - 0.15)
    np.testing.assert_allclose(-drive, np.asarray(result.fx).sum(axis=1), atol=1e-9 * 200)


def test_just_below_the_critical_stiffness_it_snaps_and_just_above_it_does_not():
    # The steepest slope of the clamped whisker's force at q = 0.3 is 11.4506; the pair of folds below it is tiny.
    for stiffness, snaps in ((11.40, 1), (11.45, 1), (11.451, 0), (11.5, 0)):
        result = jw.scan(model("FB", stiffness, distance=0.3))
        assert all_ok(result)
        assert len(result.events.of(jw.EventKind.snap_through)) == snaps, stiffness


def test_a_snap_at_a_corner_and_a_flow_across_one():
    # Soft FBFB at q = 0.4: stability is lost at a change of phase, and the flow ends close to another change.
    result = jw.scan(model("FBFB", 11.65, distance=0.4))
    assert all_ok(result)
    expected = [
        ("snap_through", (1,), -1.014952975),
        ("release", (1,), -1.021197722),
        ("vertex", (2,), -1.067701473),
        ("tangential_to_tip", (2,), -1.163606539),
        ("snap_through", (2,), -1.163606539),
        ("release", (2,), -1.174596669),
    ]
    assert [e[:2] for e in event_list(result)[-6:]] == [e[:2] for e in expected]
    np.testing.assert_allclose([e[2] for e in event_list(result)[-6:]], [e[2] for e in expected], atol=EVENT)


def test_beneath_the_edge_of_a_flat_object_a_whisker_slides_on():
    # The branch turns back where the edge slips beneath the tip, and is stable again immediately, bent as before.
    a, b, distance = 3.1907, 0.036, 0.7042
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Ellipse(distance, a, b), jw.Support.clamped()), FLAT)
    branch = exact.ClampedBranch(exact.ellipse(distance, a, b))
    slope, x = branch.states(branch.fold).contact_slope, branch.fold_x

    def beyond(p):
        return branch.states(p).base_x - x

    further = branch.states(float(brentq(beyond, branch.fold + 0.1, 1.0)))  # pyright: ignore[reportArgumentType]
    assert all_ok(result)
    kinds = [e[0] for e in event_list(result)]
    assert kinds == ["touch", "tangential_to_tip", "snap_through", "vertex", "snap_off"]
    snap = result.events[2]
    assert abs(snap.control - x) < EVENT
    assert (
        abs(snap.before.contact_slope[0] - slope) < 1e-4
    )  # at a fold, the error of the state is the root of that of the position
    assert abs(snap.after.contact_slope[0] - further.contact_slope) < 1e-6
    assert snap.after.mz[0] > 0


def test_a_stretch_between_two_changes_of_phase_is_not_missed():
    # Tip contact becomes tangential and tip again within one long step of the march.
    whisker, profile = jw.Whisker(), jw.Parabola(0.5189945179467305, 0.21826609)
    result = jw.scan(jw.Scene(whisker, profile, jw.Support.clamped(), jw.ClosedForm()), np.linspace(2, -2, 400))
    assert all_ok(result)
    assert [e[0] for e in event_list(result)] == [
        "touch",
        "tip_to_tangential",
        "tangential_to_tip",
        "vertex",
        "snap_off",
    ]


def test_a_soft_spring_is_stretched_over_thousands_of_lengths():
    stiff, soft, rest = 70.0, 1e-3, 0.2
    known = jw.scan(model("FB", stiff), np.linspace(0.8, 0.0, 10)).events.of(jw.EventKind.tip_to_tangential)[0]
    stretch = known.control + rest - known.before.base_x[0]
    result = jw.scan(model("FB", soft), np.linspace(0.8, -8000.0, 500))
    assert all_ok(result)
    change = result.events.of(jw.EventKind.tip_to_tangential)[0]
    assert abs(change.control - (known.before.base_x[0] - rest + stretch * stiff / soft)) < 1e-8 * stiff / soft
    assert event_list(result)[-1][0] == "snap_off"
