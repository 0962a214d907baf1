"""Pictures: a scan with its shapes, labels and code, as bytes."""

import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import several
from jaxwhisker._base import checks
from jaxwhisker._explore.code import code_of
from jaxwhisker._explore.picture import (
    OUTLINE_POINTS,
    SCAN_STEPS,
    _closed,
    packed_error,
    packed_picture,
    picture_of,
    picture_of_motion,
)
from pictured import LENGTH, STIFFNESS, failed_motion, swept, unpacked

SAME = 1e-9  # of the peak: the path depends slightly on the end of its control, the states do not
SINGLE = 1e-6  # relative: lines are sent in float32
PRINTED = 1e-6  # relative: seven digits


def build(length=1.0, stiffness=1.0):
    """FB in any units: all such scenes share their compiled functions."""
    force = stiffness / length**2
    support = jw.Support.fb(70.0 * force / length, 0.2 * length)
    return jw.Scene(jw.Whisker(length, stiffness), jw.Parabola(0.25 * length, 1 / length), support, jw.ClosedForm())


def picture(scene):
    return jax.tree.map(np.asarray, picture_of(jax.tree.map(checks.as_float, scene)))


@pytest.fixture(scope="module")
def reply():
    """Header and arrays of a picture."""
    scene = build()
    return unpacked(packed_picture(picture(scene), scene, code_of(scene)))


@pytest.fixture(scope="module")
def scanned(reply):
    """The scan at the same control."""
    return jw.scan(build(), reply[1]["control"])


@pytest.mark.parametrize("name", ["fx", "fy", "mz", "base_x", "contact_force", "contact_arc", "contact_x", "contact_y"])
def test_the_signals_are_those_of_the_scan(name, reply, scanned):
    sent, expected = reply[1][name], np.asarray(getattr(scanned, name))
    assert sent.dtype == np.float64 and sent.shape == (SCAN_STEPS, 1)
    np.testing.assert_allclose(sent, expected, rtol=0, atol=SAME * np.abs(expected).max())


def test_the_lines_are_the_shapes_of_the_scan(reply, scanned):
    lines = jw.shapes(scanned, points=reply[1]["line_x"].shape[-1])
    np.testing.assert_allclose(reply[1]["line_x"], lines.x, rtol=0, atol=SINGLE)
    np.testing.assert_allclose(reply[1]["line_y"], lines.y, rtol=0, atol=SINGLE)
    assert np.all(reply[1]["phase"] == np.asarray(scanned.phase))


def test_it_spans_the_default_control_and_lists_its_events(reply):
    header, arrays = reply
    default = jw.scan(build())
    assert abs(arrays["control"][0] - default.control[0]) < SAME
    assert abs(arrays["control"][-1] - default.control[-1]) < 0.002  # the last step of the default control
    assert [event["text"] for event in header["events"]] == [str(event) for event in default.events]
    assert len(header["events"]) == 5 and header["events"][-1]["snap"] and header["events"][0]["whiskers"] == [0]
    assert (header["failed"], header["summary"]) == (0, f"{SCAN_STEPS} steps: {SCAN_STEPS} ok")


def test_the_outline_is_that_of_the_object(reply):
    x, y = reply[1]["outline_x"], reply[1]["outline_y"]
    np.testing.assert_allclose(y, 0.25 + x**2, rtol=SINGLE)
    assert x.min() < -2.9 and x.max() > 2.9


def test_dimensionless_scenes_have_dimensionless_labels(reply):
    header, _ = reply
    assert header["labels"] == {
        "x": "x/L", "y": "y/L", "fx": "fx L²/EI", "fy": "fy L²/EI", "mz": "mz L/EI", "u": "u/L"
    }  # fmt: skip
    assert header["dimensionless"] and header["length"] == 1.0 and header["places"] == [["u", "control", ""]]
    assert header["columns"][0] == ["fx", "fx"] and header["columns"][-1] == ["contact_arc", "contact arc"]


def test_other_scenes_are_shown_in_si_units_with_prefixes(reply):
    length, stiffness = 0.05, 2.4e-5  # 50 mm, force 9.6 mN, moment 0.48 mN m
    scene = build(length, stiffness)
    header, arrays = unpacked(packed_picture(picture(scene), scene, code_of(scene)))
    assert header["labels"] == {
        "x": "x (mm)", "y": "y (mm)", "fx": "fx (mN)", "fy": "fy (mN)", "mz": "mz (mN mm)", "u": "u (mm)"
    }  # fmt: skip
    assert (header["length"], header["dimensionless"]) == (50.0, False)
    assert header["places"] == [["u", "control", " mm"]]
    assert header["columns"][2:4] == [["mz", "mz (mN mm)"], ["base_x", "base x (mm)"]]
    sizes = dict.fromkeys(("control", "base_x", "contact_y", "line_x", "outline_y", "drive_x"), 50.0)
    for name, size in {**sizes, "fx": 9.6, "mz": 480.0, "contact_slope": 1.0}.items():
        expected = size * reply[1][name]
        np.testing.assert_allclose(arrays[name], expected, rtol=0, atol=SINGLE * np.abs(expected).max())
    assert header["events"][0]["text"] == "u = +33.301270189 mm  touch of whisker 1"
    np.testing.assert_allclose(header["events"][0]["place"], 50 * reply[0]["events"][0]["place"], rtol=SAME)


def test_failed_steps_are_counted_and_leave_gaps():
    scene = build()
    whole, bad = picture(scene), np.arange(SCAN_STEPS) >= SCAN_STEPS - 30
    gaps = {name: np.where(bad[:, None], np.nan, getattr(whole.result, name)) for name in ("fx", "fy", "mz")}
    result = eqx.tree_at(lambda r: tuple(getattr(r, name) for name in gaps), whole.result, tuple(gaps.values()))
    result = eqx.tree_at(lambda r: r.status, result, np.where(bad, int(jw.Status.lost), 0))
    header, arrays = unpacked(packed_picture(whole._replace(result=result), scene, ""))
    assert (header["failed"], header["summary"]) == (30, f"{SCAN_STEPS} steps: {SCAN_STEPS - 30} ok, 30 lost")
    assert jw.Status(int(arrays["status"][-1])) == jw.Status.lost
    assert np.isnan(arrays["fx"][-30:]).all() and np.isfinite(arrays["fx"][:-30]).all()


def test_a_scene_without_a_scan_is_an_error():
    whole = picture(build())
    result = eqx.tree_at(lambda r: r.control, whole.result, np.full(SCAN_STEPS, np.nan))
    with pytest.raises(ValueError, match=f"The scene has no scan: {SCAN_STEPS} steps"):
        packed_picture(whole._replace(result=result), build(), "")


def test_the_code_prints_the_numbers_of_the_picture(reply):
    header, arrays = reply
    printed: list[Any] = []
    names = {"__name__": "new", "print": lambda *words: printed.append(words[0])}
    exec("217".join(header["code"]), names)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(jnp.all(a == b)), names["scene"], build()))
    assert str(printed[0]) == str(names["result"])
    for name in ("fx", "fy", "mz"):
        text = re.search(rf"{name} = (\S+?)(,|$)", printed[1])
        assert text is not None
        np.testing.assert_allclose(float(text[1]), arrays[name][217, 0], rtol=PRINTED)


@pytest.fixture(scope="module")
def motion():
    return swept()


def moving(motion):
    """Header and arrays of the picture of a motion."""
    return unpacked(packed_picture(jax.tree.map(np.asarray, picture_of_motion(motion)), motion.scene, ""))


def test_a_motion_is_shown_over_time(motion):
    header, arrays = moving(motion)
    assert header["places"] == [["t", "time", ""], ["u", "control", ""]]
    assert (header["labels"]["t"], header["summary"]) == ("t/T", "101 samples: 101 ok")
    np.testing.assert_allclose(arrays["time"], motion.time / 0.5, rtol=SAME)  # T = 0.5
    for name in ("control", "fx", "fy", "mz", "base_x", "contact_force", "contact_x"):
        np.testing.assert_array_equal(arrays[name], getattr(motion, name))
    lines = motion.shapes(arrays["line_x"].shape[-1])
    np.testing.assert_allclose(arrays["line_x"], lines.x, rtol=0, atol=SINGLE)
    np.testing.assert_allclose(arrays["line_y"], lines.y, rtol=0, atol=SINGLE)
    events = list(motion.events)
    assert [event["place"] for event in header["events"]] == [event.time / 0.5 for event in events]
    assert header["events"][0]["text"] == str(events[0]._replace(time=events[0].time / 0.5))


def test_a_motion_in_si_units_has_prefixes(motion):
    header, arrays = moving(swept(70.0, LENGTH, STIFFNESS))
    assert header["places"] == [["t", "time", " ms"], ["u", "control", " mm"]] and header["labels"]["t"] == "t (ms)"
    np.testing.assert_allclose(arrays["time"], 1000 * motion.time, rtol=SAME)
    shown = re.fullmatch(r"t = (\S+) ms, u = (\S+) mm  touch of whisker 1", header["events"][0]["text"])
    assert shown is not None
    first = motion.events[0]
    np.testing.assert_allclose([*map(float, shown.groups())], [1000 * first.time, 50 * first.control], rtol=PRINTED)


def test_a_motion_that_fails_leaves_a_gap_and_keeps_its_times(motion):
    header, arrays = moving(failed_motion(motion, 60))
    assert (header["failed"], header["summary"]) == (41, "101 samples: 60 ok, 41 lost")
    np.testing.assert_allclose(arrays["time"], motion.time / 0.5, rtol=SAME)
    assert np.isnan(arrays["fx"][60:]).all() and np.isnan(arrays["control"][60:]).all()
    with pytest.raises(ValueError, match="The scene has no motion: 101 samples: 1 ok, 100 lost"):
        moving(failed_motion(motion, 1))


def test_the_code_of_a_motion_prints_the_numbers_of_the_picture(motion):
    header, arrays = moving(motion)
    printed: list[str] = []
    exec("result = made\n" + "40".join(header["code"]), {"made": motion, "print": lambda text: printed.append(text)})
    assert printed[0] is motion
    t, u, fx = (float(re.search(rf"{name} = (\S+?),", printed[1])[1]) for name in ("t", "u", "fx"))  # pyright: ignore
    np.testing.assert_allclose(
        [t, u, fx], [motion.time[40], *(arrays[n][40].item() for n in ("control", "fx"))], PRINTED
    )


def test_errors_have_a_message_and_no_arrays():
    assert unpacked(packed_error(ValueError("`a` must be positive."))) == (
        {"error": "`a` must be positive.", "arrays": []},
        {},
    )
    header, _ = unpacked(packed_error(ZeroDivisionError("x " * 1000)))
    assert header["error"].startswith("ZeroDivisionError: x x") and len(header["error"]) < 600


def test_all_contacts_are_sent():
    scene = several.circles()
    header, arrays = unpacked(packed_picture(picture(scene), scene, code_of(scene)))
    assert arrays["contact_force"].shape == arrays["phase"].shape == (SCAN_STEPS, 1, 2)
    assert arrays["fx"].shape == (SCAN_STEPS, 1)
    assert [event["text"].partition("  ")[2] for event in header["events"]] == list(several.EVENTS)


def test_outlines_of_concave_objects_are_closed_behind_them():
    objects = jw.Graph(several.wavy), jw.Parabola(0.2)
    x = np.linspace(-3.0, 3.0, OUTLINE_POINTS)
    wave, parabola = (np.stack([x, y], axis=1) for y in (np.asarray(several.wavy(x)), 0.2 + x**2))
    closed = _closed(np.concatenate([wave, [(np.nan, np.nan)], parabola]), objects)
    assert len(closed) == 2 * OUTLINE_POINTS + 3
    np.testing.assert_allclose(closed[OUTLINE_POINTS : OUTLINE_POINTS + 2, 1], 0.4, atol=1e-3)
    np.testing.assert_array_equal(closed[-OUTLINE_POINTS:], parabola)
