"""Pictures of scans in space: states, geometry and window, as the page draws them."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxwhisker as jw
import pegs
from jaxwhisker._explore.code import code_of
from jaxwhisker._explore.picture import SCAN_STEPS, packed_picture
from jaxwhisker._explore.space_picture import VIEWS, picture_in_space
from jaxwhisker.plot.view import VIEWS as AXES
from jaxwhisker.plot.view import direction_of
from pictured import LENGTH, past_ball, unpacked

MM = 1e3  # the page shows the scene of the wire in mm
SAME = 1e-9  # of the peak: both scans solve for the same states, from paths that differ slightly
SINGLE = 1e-6  # relative: geometry is sent in float32
REACTIONS = ("fx", "fy", "fz", "mx", "my", "mz")


def sent(scene):
    """Header and arrays of the picture of a scene."""
    picture = jax.tree.map(np.asarray, picture_in_space(scene))
    return unpacked(packed_picture(picture, scene, code_of(scene)))


@pytest.fixture(scope="module")
def scene():
    return past_ball(3).scene


@pytest.fixture(scope="module")
def reply(scene):
    return sent(scene)


@pytest.fixture(scope="module")
def scanned(reply, scene):
    """The scan at the same control."""
    return jw.scan(scene, reply[1]["control"] / MM)


def test_the_signals_are_those_of_the_scan(reply, scanned):
    header, arrays = reply
    assert header["signals"] == list(REACTIONS) and [name for name, _ in header["columns"]][:6] == list(REACTIONS)
    for name, size in zip(REACTIONS, [1e3] * 3 + [1e6] * 3, strict=True):  # mN, mN mm
        expected = size * np.asarray(getattr(scanned, name))
        assert arrays[name].shape == (SCAN_STEPS, 1)
        np.testing.assert_allclose(arrays[name], expected, rtol=0, atol=SAME * size * np.abs(scanned.moment).max())
    assert header["labels"]["fz"] == "fz (mN)" and header["labels"]["my"] == "my (mN mm)"
    assert header["labels"]["z"] == "z (mm)" and header["places"] == [["u", "control", " mm"]]
    assert (header["failed"], header["length"]) == (0, MM * LENGTH)
    assert [event["text"].split(" mm  ")[1] for event in header["events"]] == [
        f"{event.kind} of whisker 1" for event in scanned.events
    ]


def test_lines_and_directors_are_those_of_the_scan(reply, scanned):
    _, arrays = reply
    lines = jw.shapes(scanned, points=arrays["line"].shape[2])
    for k, name in enumerate("xyz"):
        expected = MM * np.asarray(getattr(lines, name))
        np.testing.assert_allclose(arrays["line"][..., k], expected, rtol=0, atol=SINGLE * MM * LENGTH)
    np.testing.assert_allclose(arrays["directors"], scanned.base_rotation, rtol=0, atol=SINGLE)


def test_forces_point_to_the_contacts_against_the_reaction(reply, scanned):
    _, arrays = reply
    touching = np.asarray(scanned.phase)[:, 0] > 0
    assert 0 < touching.sum() < SCAN_STEPS
    np.testing.assert_array_equal(np.isfinite(arrays["contacts"]).all(axis=(1, 2)), touching)
    contact = MM * np.stack([getattr(scanned, f"contact_{axis}")[touching, 0] for axis in "xyz"], axis=1)
    tail, head = arrays["forces"][touching, 0].swapaxes(0, 1)
    np.testing.assert_allclose(head, contact, rtol=0, atol=SINGLE * MM * LENGTH)
    push, force = head - tail, np.asarray(scanned.force)[touching, 0]
    length = np.linalg.norm(push, axis=1)
    along = -force / np.linalg.norm(force, axis=1)[:, None]
    np.testing.assert_allclose(push / length[:, None], along, rtol=0, atol=1e-4)  # a difference of float32
    np.testing.assert_allclose(length.max(), 0.35 * MM * LENGTH, rtol=1e-4)  # the longest arrow of all figures


def test_springs_run_from_the_drive_to_the_base(reply, scanned):
    header, arrays = reply
    assert header["rigid"] == [False, False]
    drive = MM * np.stack([scanned.control, 0 * scanned.control, 0 * scanned.control], axis=1)
    np.testing.assert_allclose(arrays["drive"][:, 0], drive, rtol=0, atol=SINGLE * MM * LENGTH)
    for k, axis in enumerate((0, 2)):
        line = arrays[f"spring_{k}"]
        np.testing.assert_array_equal(line[:, -1], arrays["line"][:, 0, 0])
        assert np.all(np.argmax(np.ptp(line, axis=1), axis=1) == axis)


def test_the_object_is_a_ball_in_a_window_that_holds_everything(reply):
    header, arrays = reply
    out = arrays["corners"] - MM * np.array([0.0, 0.06, 0.01])
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 40.0, rtol=SINGLE)
    middles = out[arrays["faces"]].mean(axis=1)
    assert np.all(np.sum(middles * arrays["normals"], axis=1) > 0.99 * 40.0)  # outward
    assert np.all((arrays["shades"] > 0) & (arrays["shades"] < 1))
    ends = arrays["faces"][arrays["beside"][:, 0]]
    assert np.all([edge in face for edge, face in zip(arrays["edges"][:, 0], ends, strict=True)])
    low, high = header["window"]
    for name in ("corners", "line", "drive", "contacts", "forces"):
        points = arrays[name].reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        assert np.all((points >= low) & (points <= high))
    tenths = np.array(header["window"]) / (0.1 * MM * LENGTH)
    np.testing.assert_allclose(tenths, np.round(tenths), atol=SINGLE)  # small changes do not move it


def test_views_look_along_the_axes_of_the_projections():
    assert set(VIEWS) == {"camera", *AXES}
    for name, (across, up) in AXES.items():
        towards = direction_of(*VIEWS[name])
        np.testing.assert_allclose(towards, np.cross(np.eye(3)[across], np.eye(3)[up]), atol=1e-15)


def test_failed_steps_leave_gaps():
    """A symmetric scene may go either way at the vertex, where its scan ends."""
    symmetric = jw.SpaceScene(jw.Whisker(), jw.Cylinder(0.9, (0.0, 1.2, 0.0)), jw.Support.follicle(x=80.0, z=70.0))
    header, arrays = sent(symmetric)
    failed = np.equal(arrays["status"], int(jw.Status.undetermined))
    assert 0 < failed.sum() < SCAN_STEPS
    assert header["summary"] == f"{SCAN_STEPS} steps: {SCAN_STEPS - failed.sum()} ok, {failed.sum()} undetermined"
    assert header["events"][-1]["text"].endswith("bifurcation of whisker 1")
    for name in ("fz", "line", "directors", "forces", "spring_1"):
        good: Any = np.isfinite(arrays[name]).all(axis=tuple(range(1, arrays[name].ndim)))
        assert not good[failed].any()
        assert name == "forces" or good[~failed].all()
    assert np.isfinite(arrays["drive"]).all() and np.isfinite(header["window"]).all()
    assert header["labels"]["mx"] == "mx L/EI" and arrays["sharp"].any()  # the cylinder is cut off


def test_a_scene_without_a_scan_is_an_error(scene):
    picture = picture_in_space(scene)
    result = eqx.tree_at(lambda r: r.control, picture.result, np.full(SCAN_STEPS, np.nan))
    with pytest.raises(ValueError, match=f"The scene has no scan: {SCAN_STEPS} steps"):
        packed_picture(picture._replace(result=result), scene, "")


def test_a_contact_with_friction_has_pictures():
    rough = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.5)), friction=0.3)
    header, arrays = sent(rough)
    touching = arrays["phase"][:, 0] > 0
    assert header["failed"] == 0 and header["title"].endswith("friction 0.3")
    np.testing.assert_array_equal(arrays["slip"][touching, 0], 1)  # straight on, nothing sticks
    tail, head = arrays["forces"][touching, 0].swapaxes(0, 1)
    push = (head - tail) / np.linalg.norm(head - tail, axis=1)[:, None]
    normal = np.array([0.0, 1.3, -0.5]) - head  # of the object, inward; the radius is 1
    np.testing.assert_allclose(np.sum(push * -normal, axis=1), 1 / np.hypot(1.0, 0.3), rtol=1e-4)


def test_all_contacts_are_sent():
    _, arrays = sent(pegs.scene())
    both = np.sum(arrays["phase"].reshape(SCAN_STEPS, 2) != 0, axis=1) == 2
    assert both.sum() > 10 and arrays["contacts"].shape[1:] == (2, 3) and arrays["forces"].shape[1:] == (2, 2, 3)
    assert np.isfinite(arrays["forces"][both]).all()
    # Each contact goes on in its own way, of which some are drawn in the place of another.
    assert arrays["ways"].shape == arrays["contacts"].shape
    np.testing.assert_allclose(np.sort(arrays["ways"][both], axis=1), np.sort(arrays["contacts"][both], axis=1))
