"""Scans against exact ones by elliptic integrals, stored with nine decimals, and their landmarks."""

import numpy as np
import pytest

import jaxwhisker as jw
from scenes import REFERENCE, all_ok, event_list, from_reference

SIGNAL = 1e-6  # relative to a signal's peak, at every stored control
EVENT = 1e-7  # in u: a hundred times the reference's rounding
PRINTED = 5.1e-8  # landmarks are printed with seven decimals
PEAK = 5.1e-6  # peaks are printed with five decimals, read on a grid of 0.001

by_name = pytest.mark.parametrize("case", REFERENCE, ids=[c["name"] for c in REFERENCE])


@by_name
def test_signals_phases_and_events(case):
    result = jw.scan(from_reference(case), np.array(case["control"]))
    assert all_ok(result)
    for i, whisker in enumerate(case["whiskers"]):
        phases = [jw.Phase(int(p)).name for p in result.phase[:, i]]
        assert phases == whisker["phase"]
        for name in ("base_x", "fx", "fy", "mz", "contact_arc"):
            exact = np.array([np.nan if v is None else v for v in whisker[name]])
            known = np.isfinite(exact)
            peak = np.max(np.abs(exact[known]))
            error = np.abs(np.asarray(getattr(result, name))[:, i] - exact)[known]
            assert np.max(error) < SIGNAL * peak, name


@by_name
def test_all_events_of_the_default_scan(case):
    result = jw.scan(from_reference(case))
    assert all_ok(result)
    kinds = [e["kind"].replace("->", "_to_").replace("-", "_") for e in case["events"]]
    assert [kind for kind, _, _ in event_list(result)] == kinds
    assert [list(whiskers) for _, whiskers, _ in event_list(result)] == [e["whisker"] for e in case["events"]]
    controls = np.array([e["control"] for e in case["events"]])
    np.testing.assert_allclose([u for _, _, u in event_list(result)], controls, rtol=0, atol=EVENT)
    for event, exact in zip(result.events, case["events"], strict=True):
        # The reference stores `after` 1e-7 later, and `before` slightly before a fold, where base_x changes fast.
        for state, stored in ((event.before, exact.get("before", [])), (event.after, exact.get("after", []))):
            for i, values in enumerate(stored):
                assert abs(state.base_x[i] - values["base_x"]) < 1e-3
        for name in ("base_x", "fx", "fy", "mz", "contact_arc", "contact_force"):
            if name in exact:
                value = getattr(event.before, name)[event.whiskers[0] - 1]
                assert abs(value - exact[name]) < EVENT * max(1, abs(exact[name]))


@by_name
def test_peaks_of_the_default_scan(case):
    # The default grid differs from the reference's: near a peak, both differ from it by less than the bound.
    result = jw.scan(from_reference(case))
    for i, peaks in enumerate(case["peaks"]):
        last = np.asarray(result.control) > -2  # guards against an empty scan
        assert last.sum() > 1000
        assert abs(np.min(result.fx[:, i]) - peaks["fx_min"]) < 2e-2
        assert abs(np.max(result.fy[:, i]) - peaks["fy_max"]) < 5e-2 * peaks["fy_max"]
        assert abs(np.max(result.mz[:, i]) - peaks["mz_max"]) < 5e-2


def test_landmarks_are_the_same_for_every_network():
    clamped = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.clamped())
    fbfbr = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0, 0.2))
    for scene in (clamped, fbfbr):
        events = jw.scan(scene).events
        for i in range(scene.support.whiskers):
            touch = events.of(jw.EventKind.touch, i + 1)[0].after
            enters = events.of(jw.EventKind.tip_to_tangential, i + 1)[0].after
            vertex = events.of(jw.EventKind.vertex, i + 1)[0].after
            leaves = events.of(jw.EventKind.tangential_to_tip, i + 1)[0].after
            landmarks = [
                (touch.base_x[i], np.sqrt(0.8)),
                (enters.base_x[i], 0.5108666),
                (enters.contact_force[i], 1.0711052),
                (enters.mz[i], 1.0411010),
                (vertex.base_x[i], -0.3338507),
                (vertex.contact_force[i], 17.9442503),
                (vertex.mz[i], 5.9907012),
                (vertex.contact_arc[i], 0.4376879),
                (leaves.base_x[i], -0.9951728),
                (leaves.contact_force[i], 4.5544649),
                (leaves.mz[i], 2.9020201),
            ]
            for value, exact in landmarks:
                assert abs(value - exact) < PRINTED
    clamped_result = jw.scan(clamped, np.arange(0.9, -1.23, -0.0001))  # fine enough for the peaks
    snap = clamped_result.events.of(jw.EventKind.snap_off)[0]
    assert abs(snap.before.base_x[0] + 1.2224698) < PRINTED
    assert abs(np.degrees(snap.before.contact_slope[0]) + 47.23) < 0.005
    assert abs(np.min(clamped_result.fx) + 7.40235) < PEAK
    assert abs(np.max(clamped_result.fy) - 20.89341) < PEAK
    assert abs(np.max(clamped_result.mz) - 6.46427) < PEAK
