"""The summary of scans, compared with finer steps, exact peaks and scans made by hand."""

import numpy as np
import pytest
import xarray as xr

import jaxwhisker as jw
import several
from jaxwhisker._scan.dataset import VARIABLES
from jaxwhisker._scan.state import OPTIONAL
from jaxwhisker._study import summary as module
from jaxwhisker._study.summary import summarise, summary, summary_without
from scenes import model

PEAK = 1e-7  # relative: a polynomial through steps of 0.001 next to the steepest peak
NARROW = 2e-8  # relative: ... through seven steps of a peak whose half width is twenty; a parabola misses by 3e-6
ROUNDING = 1e-12
COARSE = 0.1  # three uneven steps of a peak's width; across the turn a polynomial would be off by 0.2
PLACE = 1e-5  # of a peak: the size of the finer steps
PRINTED = 5e-6  # half a unit of the last digit of the exact peaks
SUMMARY = summary_without(OPTIONAL)  # of scenes in the plane
WIDTH = 1e-5  # straight lines between steps of 0.001
STIFFNESS = (20.0, 70.0)  # the softer one snaps through before the second whisker's vertex and lands on the far side
CONTROL = np.arange(0.9, -1.8, -0.001)
SNAPS = (jw.EventKind.snap_through, jw.EventKind.snap_off)


def arrays_of(result):
    """One scan by the names that its variables have in a study."""
    events = {"kind": "kind", "control": "control", "whisker": "whiskers", "count": "count"}
    arrays = {name: np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz", "base_x", "status")}
    arrays |= {f"event_{name}": np.asarray(getattr(result.events, field)) for name, field in events.items()}
    for side in ("before", "after"):
        states = getattr(result.events, side)
        arrays[f"event_energy_{side}"] = np.asarray(jw.stored_energy(result.scene, states))
        arrays |= {f"{side}_{name}": np.asarray(getattr(states, name)) for name in ("fx", "fy", "mz")}
    return arrays


@pytest.fixture(scope="module")
def scans():
    return [jw.scan(model("FBFB", c), CONTROL) for c in STIFFNESS]


@pytest.fixture(scope="module")
def arrays(scans):
    lanes = [arrays_of(result) for result in scans]
    return {name: np.stack([lane[name] for lane in lanes]) for name in lanes[0]}


@pytest.fixture(scope="module")
def data(arrays):
    dims = {name: ("stiffness", *VARIABLES[name].axes) for name in arrays}
    units = {"length": "L", "control": "L", "force": "EI/L^2", "moment": "EI/L", "energy": "EI/L", "number": "1"}
    variables = {k: (dims[k], v, {"units": units[VARIABLES[k].kind]}) for k, v in arrays.items()}
    coords = {"stiffness": list(STIFFNESS), "control": ("control", CONTROL, {"units": "L"}), "whisker": [1, 2]}
    return xr.Dataset(variables, coords, {"title": "two scans"})


def test_peaks_are_the_exact_ones(arrays):
    found = summarise(arrays, CONTROL)
    for name, peak in (("min_fx", -7.40235), ("max_fy", 20.89341), ("max_mz", 6.46427)):
        np.testing.assert_allclose(found[name][1], peak, rtol=PEAK, atol=PRINTED)
        steps = getattr(np.asarray(arrays[name[4:]][1]), name[:3])(axis=0)
        assert np.all(np.abs(found[name][1]) >= np.abs(steps))
    assert found["max_fy"][0, 1] < 17.0  # a snap cuts it off


def test_a_peak_a_few_steps_wide_is_read_to_rounding_of_the_printed_digits():
    control = np.linspace(1.0, -1.0, 2001)
    control[1::2] += 2e-4  # arbitrary spacing
    at, width = 0.30047, 0.02
    mz = 1 / (1 + ((control - at) / width) ** 2)
    none = {"event_kind": -np.ones(1, int), "event_control": np.full(1, np.nan), "event_count": np.array(0)}
    found = summarise({"mz": mz[:, None], "event_whisker": np.zeros((1, 1), bool)} | none, control)
    assert abs(found["max_mz"][0] - 1) < NARROW < 1 - mz.max()
    assert abs(found["control_of_max_mz"][0] - at) < NARROW * width


def test_a_peak_that_the_drive_passes_at_once_is_read_over_the_base():
    control = np.linspace(1.0, -1.0, 2001)
    base_x, at = np.cbrt(control), 0.03  # near a critical stiffness
    arrays = {"mz": (1 - (base_x - at) ** 2)[:, None], "event_whisker": np.zeros((1, 1), bool)}
    arrays |= {"event_kind": -np.ones(1, int), "event_control": np.full(1, np.nan), "event_count": np.array(0)}
    found = summarise(arrays | {"base_x": base_x[:, None]}, control)
    np.testing.assert_allclose(found["max_mz"], 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(found["control_of_max_mz"], at**3, atol=ROUNDING)
    assert abs(summarise(arrays, control)["max_mz"][0] - 1) > 1e-5


def test_no_peak_is_read_across_a_turn_of_the_drive():
    control = np.concatenate([np.arange(1.0, 0.0, -0.1), np.arange(0.0647, 1.0, 0.1)])
    mz = 1 / (1 + ((np.arange(control.size) - 8.8) / 3) ** 2)  # smooth over time, largest before the drive turns
    none = {"event_kind": -np.ones(1, int), "event_control": np.full(1, np.nan), "event_count": np.array(0)}
    found = summarise({"mz": mz[:, None], "event_whisker": np.zeros((1, 1), bool)} | none, control)
    assert 0.0 <= found["max_mz"][0] - mz.max() < COARSE


def test_peaks_lie_where_finer_steps_have_them(arrays, scans):
    found = summarise(arrays, CONTROL)
    for name, sign in (("min_fx", -1), ("max_mz", 1)):
        for whisker in (0, 1):
            at = found[f"control_of_{name}"][1, whisker]
            fine = jw.scan(scans[1].scene, at + np.linspace(0.002, -0.002, 401))
            best = np.argmax(sign * np.asarray(getattr(fine, name[4:]))[:, whisker])
            assert abs(fine.control[best] - at) < PLACE


def test_a_peak_that_a_snap_cuts_off_is_the_state_there(arrays, scans):
    at = scans[0].events.of(jw.EventKind.snap_through)[0]
    found = summarise(arrays, CONTROL)
    assert found["max_fy"][0, 1] == at.before.fy[1]
    assert found["control_of_max_fy"][0, 1] == at.control
    # Without the states the nearest step is used: no polynomial reaches across the event.
    without = summarise({k: v for k, v in arrays.items() if not k.startswith(("before", "after"))}, CONTROL)
    assert without["max_fy"][0, 1] == arrays["fy"][0, :, 1].max() < at.before.fy[1]
    np.testing.assert_array_equal(without["max_fy"][1], found["max_fy"][1])


def test_a_peak_of_zero_is_nowhere(arrays):
    found = summarise(arrays, CONTROL)
    assert np.all(found["min_fy"] == 0) and np.all(np.isnan(found["control_of_min_fy"]))


def test_contact_and_snaps_are_those_of_the_events(arrays, scans):
    found = summarise(arrays, CONTROL)
    for k, result in enumerate(scans):
        snaps = [e for e in result.events if e.kind in SNAPS]
        lost = sum(
            float(jw.stored_energy(result.scene, e.before) - jw.stored_energy(result.scene, e.after)) for e in snaps
        )
        assert found["snaps"][k] == len(snaps) >= 2
        assert lost > 1.0
        np.testing.assert_allclose(found["snap_work"][k], lost)
        for whisker in (1, 2):
            ends = [e for e in result.events if e.kind >= jw.EventKind.release and whisker in e.whiskers]
            assert found["first_touch"][k, whisker - 1] == result.events.of(jw.EventKind.touch, whisker)[0].control
            assert found["last_contact"][k, whisker - 1] == ends[-1].control
    assert found["last_contact"][0, 1] == scans[0].events.of(jw.EventKind.release, 2)[0].control  # not the snap before
    np.testing.assert_array_equal(found["contact_width"], found["first_touch"] - found["last_contact"])
    assert np.all(found["steps_failed"] == 0)


def test_half_width_is_that_of_the_signal(arrays):
    found = summarise(arrays, CONTROL)
    for whisker in (0, 1):
        moment, half = arrays["mz"][1, :, whisker], found["max_mz"][1, whisker] / 2
        top = int(np.argmax(moment))
        rise = np.interp(half, moment[:top], CONTROL[:top])
        fall = np.interp(-half, -moment[top:], CONTROL[top:])
        assert abs(found["half_width_mz"][1, whisker] - (rise - fall)) < WIDTH


def test_what_the_control_does_not_show_is_unknown(arrays):
    steps = slice(700, 1600)  # from within contact to within contact
    part = {k: v[:, steps] if k in ("fx", "fy", "mz", "base_x", "status") else v for k, v in arrays.items()}
    found = summarise(part, CONTROL[steps])
    for name in ("first_touch", "last_contact", "contact_width"):
        assert np.all(np.isnan(found[name][1]))
    whole = summarise(arrays, CONTROL)
    np.testing.assert_array_equal(found["max_mz"][1], whole["max_mz"][1])


def test_a_failed_scan_has_no_peaks_and_one_not_computed_no_counts(arrays):
    broken = {k: v.copy() for k, v in arrays.items()}
    broken["status"][0, 1500:1503] = jw.Status.lost
    for name in ("fx", "fy", "mz"):
        broken[name][0, 1500:1503] = np.nan
    found = summarise(broken, CONTROL)
    assert list(found["steps_failed"]) == [3, 0]
    numbers = [name for name in SUMMARY if SUMMARY[name].dtype == "float64"]
    assert set(numbers) < set(found)
    assert all(np.all(np.isnan(found[name][0])) for name in numbers)
    intact = summarise(arrays, CONTROL)
    assert all(np.array_equal(found[name][1], intact[name][1], equal_nan=True) for name in found)

    broken["status"][0], broken["event_kind"][0], broken["event_count"][0] = -1, -1, -1
    found = summarise(broken, CONTROL)
    assert list(found["steps_failed"]) == [-1, 0] and found["snaps"][0] == -1


def test_what_is_missing_is_left_out(arrays):
    only = lambda *prefixes: {k: v for k, v in arrays.items() if k.startswith(prefixes)}  # noqa: E731
    assert set(summarise(only("status"), CONTROL)) == {"steps_failed"}
    assert set(summarise(only("event_"), CONTROL)) == {"snaps", "snap_work"}
    reactions = summarise(only("fx", "mz"), CONTROL)
    assert set(reactions) == {k for k in SUMMARY if k.endswith(("fx", "mz"))}
    assert reactions["max_mz"][1, 0] == arrays["mz"][1, :, 0].max()  # smooth or not: nothing tells


def by_hand(touching, events):
    """A scan of two whiskers whose force is 1 where they touch; events as (kind, whiskers, control)."""
    fy = np.array(touching, dtype=float).T
    named = np.array([[w in whiskers for w in (1, 2)] for _, whiskers, _ in events], bool).reshape(-1, 2)
    return {
        "fy": fy,
        "status": np.zeros(len(fy), np.int8),
        "event_kind": np.array([jw.EventKind[kind] for kind, _, _ in events], np.int8),
        "event_control": np.array([control for *_, control in events], float),
        "event_whisker": named,
        "event_count": np.int32(len(events)),
    }


DOWN = -np.arange(8.0)
CASES = {
    "in another's snap": (
        [[0, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 0, 0]],
        [("touch", (1,), -0.5), ("snap_off", (1,), -3.5), ("release", (2,), -5.2)],
        [[-0.5, -3.5], [-3.5, -5.2]],
    ),
    "out of contact in another's snap": (
        [[0, 1, 1, 1, 1, 1, 0, 0], [0, 0, 1, 1, 0, 0, 0, 0]],
        [("touch", (1,), -0.5), ("touch", (2,), -1.5), ("snap_through", (1,), -3.5), ("snap_off", (1,), -5.5)],
        [[-0.5, -5.5], [-1.5, -3.5]],
    ),
    "landed, then released": (
        [[0, 1, 1, 1, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 0]],
        [("touch", (1,), -0.5), ("snap_through", (1,), -2.5), ("release", (1,), -4.5)],
        [[-0.5, -4.5], [np.nan, np.nan]],
    ),
    "twice": (
        [[0, 1, 0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 0]],
        [("touch", (1,), -0.5), ("snap_off", (1,), -1.5), ("touch", (1,), -3.5), ("release", (1,), -4.5)],
        [[-0.5, -4.5], [np.nan, np.nan]],
    ),
    "between two steps": (
        [[0, 0, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 0]],
        [("touch", (1,), -1.2), ("snap_off", (1,), -1.7), ("touch", (2,), -3.2), ("release", (2,), -3.7)],
        [[-1.2, -1.7], [-3.2, -3.7]],
    ),
    "in the step of another's snap": (
        [[0, 0, 0, 1, 1, 0, 0, 0], [0, 1, 1, 0, 0, 0, 0, 0]],
        [("touch", (2,), -0.5), ("snap_off", (2,), -2.2), ("touch", (1,), -2.6), ("snap_off", (1,), -4.5)],
        [[-2.6, -4.5], [-0.5, -2.2]],
    ),
    "to the end": (
        [[0, 0, 1, 1, 1, 1, 1, 1], [1, 1, 0, 0, 0, 0, 0, 0]],
        [("touch", (1,), -1.5), ("release", (2,), -1.6)],
        [[-1.5, np.nan], [np.nan, -1.6]],
    ),
    "none": ([[0] * 8, [0] * 8], [], [[np.nan, np.nan], [np.nan, np.nan]]),
}


@pytest.mark.parametrize("name", CASES)
def test_contact_begins_and_ends(name):
    touching, events, expected = CASES[name]
    found = summarise(by_hand(touching, events), DOWN)
    np.testing.assert_array_equal(np.stack([found["first_touch"], found["last_contact"]], axis=1), expected)


def test_a_peak_is_refined_where_it_is_smooth_only():
    control = np.array([3.0, 2.0, 1.0, 0.5, -1.0])  # steps of any size
    bump = np.stack([5 - (control - 0.9) ** 2, np.zeros(5)])
    smooth = summarise(by_hand(bump, [("vertex", (1,), 0.9)]), control)
    np.testing.assert_allclose([smooth["max_fy"][0], smooth["control_of_max_fy"][0]], [5.0, 0.9])
    corner = summarise(by_hand(bump, [("tip_to_tangential", (2,), 0.9)]), control)
    np.testing.assert_array_equal([corner["max_fy"][0], corner["control_of_max_fy"][0]], [bump[0, 2], 1.0])


def mirrored(arrays):
    """The scans of the mirrored scene: the drive moves towards +x; fx and mz change their sign."""
    negated = {name for name in arrays if name.endswith(("fx", "mz", "base_x")) or name == "event_control"}
    return {name: -values if name in negated else values for name, values in arrays.items()}


def test_a_rising_control_gives_the_mirrored_summary(arrays):
    falling, rising = summarise(arrays, CONTROL), summarise(mirrored(arrays), -CONTROL)
    assert np.all(falling["contact_width"] > 0)
    for name in ("contact_width", "half_width_mz", "snap_work", "snaps", "steps_failed", "max_fy"):
        np.testing.assert_allclose(rising[name], falling[name], rtol=ROUNDING, err_msg=name)
    for name in ("first_touch", "last_contact", "control_of_max_fy"):
        np.testing.assert_allclose(rising[name], -falling[name], rtol=ROUNDING, err_msg=name)
    for name in ("fx", "mz"):
        for one, other in (("max", "min"), ("min", "max")):
            for prefix in ("", "control_of_"):
                found, expected = rising[f"{prefix}{one}_{name}"], -falling[f"{prefix}{other}_{name}"]
                np.testing.assert_allclose(found, expected, rtol=ROUNDING, err_msg=f"{prefix}{one}_{name}")


def test_a_peak_of_rounding_errors_is_zero_and_nowhere():
    touching = np.array([[0, 1e-15, -1.0, -6.0, -2.0, 0, 0, 0], [0] * 8])
    found = summarise(by_hand(touching, [("touch", (1,), 0.9), ("release", (1,), 4.5)]), np.arange(8.0))
    assert found["max_fy"][0] == 0 and np.isnan(found["control_of_max_fy"][0])
    assert found["min_fy"][0] <= -6.0 and np.isfinite(found["control_of_min_fy"][0])


def dataset_of(arrays, control):
    variables = {name: (VARIABLES[name].axes, values) for name, values in arrays.items()}
    return xr.Dataset(variables, {"control": control, "whisker": [1, 2]})


def test_widths_of_a_turning_control_are_nan_and_say_why():
    control = np.array([3.0, 2.0, 1.0, 2.0, 3.0])
    arrays = by_hand([[0, 1.0, 2.0, 1.0, 0], [0] * 5], [("touch", (1,), 2.5), ("release", (1,), 2.5)])
    found = summarise(arrays | {"mz": arrays["fy"]}, control)
    assert np.isnan(found["contact_width"]).all() and np.isnan(found["half_width_mz"]).all()
    assert found["first_touch"][0] == found["last_contact"][0] == 2.5 and found["max_mz"][0] == 2.0
    assert "changes direction" in summary(dataset_of(arrays, control)).contact_width.attrs["comment"]
    assert "comment" not in summary(dataset_of(arrays, np.arange(5.0))).contact_width.attrs


def test_more_events_than_room_is_no_sum(arrays):
    full = arrays | {"event_count": np.array([arrays["event_kind"].shape[1] + 1, arrays["event_count"][1]])}
    assert np.isnan(summarise(full, CONTROL)["snap_work"][0])


def test_summary_of_a_dataset(data, arrays):
    found = summary(data)
    expected = summarise(arrays, CONTROL)
    assert set(found.data_vars) == set(expected) == set(SUMMARY)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name].values, values)
        assert found[name].dims == ("stiffness", *SUMMARY[name].axes)
        assert found[name].attrs["long_name"]
    units = {"max_fy": "EI/L^2", "min_mz": "EI/L", "control_of_max_fy": "L", "snaps": "1"}
    assert {name: found[name].attrs["units"] for name in units} == units
    assert list(found.stiffness) == list(STIFFNESS) and list(found.whisker) == [1, 2]
    assert found.attrs["title"] == "two scans"


def test_summary_does_not_depend_on_blocks_or_the_order_of_dimensions(data, tmp_path, monkeypatch):
    expected = summary(data)
    grid = xr.concat([data, data.isel(stiffness=[1, 0]).assign_coords(stiffness=list(STIFFNESS))], "distance")
    grid = grid.assign_coords(distance=[0.1, 0.2])
    grid.chunk(stiffness=1, distance=2).to_zarr(tmp_path / "grid.zarr", consolidated=False)
    stored = xr.open_zarr(tmp_path / "grid.zarr", chunks=None, consolidated=False)
    read = []
    monkeypatch.setattr(module, "summarise", lambda a, *rest: read.append(a["mz"].shape[:-2]) or summarise(a, *rest))
    xr.testing.assert_equal(summary(stored).isel(distance=0, drop=True), expected)
    assert read == [(2, 1), (2, 1)]  # whole chunks
    read.clear()
    monkeypatch.setattr(module, "BLOCK_BYTES", 1.0)
    xr.testing.assert_equal(summary(grid.transpose()).isel(distance=0, drop=True), expected)
    assert len(read) == 4


@pytest.mark.unchecked
def test_other_data_are_refused(data):
    for wrong in (data.fx, {}, xr.Dataset(), data.drop_vars("control"), summary(data)):
        with pytest.raises(ValueError, match="`data` must be the Dataset of a study"):
            summary(wrong)  # pyright: ignore[reportArgumentType]


def test_whiskers_with_several_contacts_are_summarised():
    result = several.scanned()
    found = summary(result.to_xarray())
    touch, *_, snap = (event.control for event in result.events)
    assert (float(found.first_touch[0]), float(found.last_contact[0])) == (touch, snap)
    assert int(found.snaps) == 1 and float(found.snap_work) == pytest.approx(2.30103, abs=1e-5)
    assert float(found.max_mz[0]) == pytest.approx(float(np.max(result.mz)), rel=1e-3)
    assert "contact" not in found.dims


def test_a_study_of_several_contacts_keeps_all_of_them():
    data = jw.study(several.circles, distance=[0.25], outputs=("contact", "reactions"), control=several.CONTROL)
    assert data.contact_force.dims == ("distance", "control", "whisker", "contact")
    result = several.scanned()
    np.testing.assert_allclose(data.contact_force[0], result.contact_force, atol=1e-9)
    np.testing.assert_array_equal(data.phase[0], result.phase)
    whole = jw.study(several.circles, distance=[0.25], outputs="all", summary=True, control=several.CONTROL)
    assert float(whole.last_contact[0, 0]) == pytest.approx(result.events[-1].control, abs=1e-9)
    assert whole.before_contact_arc.dims == ("distance", "event", "whisker", "contact")


def test_fields_of_several_contacts_do_not_change_the_axes_of_a_summary():
    reactions = {name: np.arange(6.0).reshape(2, 3, 1) for name in ("fx", "fy", "mz")}
    found = summarise(reactions | {"phase": np.zeros((2, 3, 1, 2), int)}, np.array([0.3, 0.2, 0.1]))
    np.testing.assert_array_equal(found["max_fx"], [[2.0], [5.0]])
