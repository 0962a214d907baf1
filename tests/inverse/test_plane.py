"""Sensors and signals in the plane: directions of slip, reactions that are missing or negated, poses of bases."""

import numpy as np
import pytest

import jaxwhisker as jw
from contacts import CONTROL, sensor, signals
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._model.scene import Sensor

FRICTION = 1e-8  # of the length, and rad: signals of the scan itself
ABOVE = jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=0.1)


@pytest.mark.parametrize("supports", ["FB", "FBFBR"])
def test_points_with_friction(supports):
    support = jw.Support.fb(70.0) if supports == "FB" else jw.Support.fbfbr(70.0)
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), support, friction=0.3)
    result = jw.scan(scene, np.linspace(0.75, -1.0, 80))
    points, touching = reconstruct(result, scene), np.asarray(result.phase) > 0
    np.testing.assert_array_equal(points.phase, result.phase)
    for name, truth in (("x", "contact_x"), ("y", "contact_y"), ("slope", "contact_slope"), ("arc", "contact_arc")):
        off = np.abs(np.asarray(getattr(points, name)) - np.asarray(getattr(result, truth)))[touching]
        assert np.max(off) < FRICTION, name
    # Without friction, the angle of friction is taken for slope.
    ignored = reconstruct(result, Sensor(jw.Whisker(), support))
    off = np.abs(np.asarray(ignored.slope) - np.asarray(result.contact_slope))[touching]
    assert np.nanmax(off) == pytest.approx(np.arctan(0.3), rel=0.05)


def test_points_of_contacts_that_stick_need_their_slip():
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0), friction=0.3)
    result = jw.scan(scene, np.r_[np.linspace(0.75, -0.3, 40), np.linspace(-0.28, 0.5, 40)])
    touching, sticks = np.asarray(result.phase) > 0, np.asarray(result.slip) == 0
    lean = -np.arctan2(np.asarray(result.friction_force), np.where(touching, np.asarray(result.normal_force), 1.0))
    points = reconstruct(result, scene, slip=lean / np.arctan(0.3))
    off = np.abs(np.asarray(points.slope) - np.asarray(result.contact_slope))
    assert np.any(sticks & touching) and np.max(off[touching]) < FRICTION
    assumed = reconstruct(result, scene)
    off = np.abs(np.asarray(assumed.slope) - np.asarray(result.contact_slope))
    assert np.nanmax(off[touching & ~sticks]) < FRICTION < np.nanmax(off[touching & sticks])


@pytest.mark.parametrize(("friction", "slip", "named"), [(None, np.ones(3), "without"), (0.3, np.ones(4), r"\(4,\)")])
def test_wrong_slips_are_named(friction, slip, named):
    data = {"control": np.arange(3.0), "fx": np.ones(3), "fy": np.ones(3), "mz": np.ones(3)}
    with pytest.raises(ValueError, match=f"`slip`.*{named}"):
        reconstruct(data, Sensor(jw.Whisker(), friction=friction), slip=slip)


def test_missing_reactions_are_named():
    measured = signals("FBFBR")[1]
    with pytest.raises(ValueError, match=r"`measured` must hold fx, fy and mz .* of fx_1, fy_1, fx_2, fy_2;"):
        reconstruct({n: measured[n] for n in ("control", "mz")}, sensor("FBFBR"))
    first = {"control": CONTROL} | {f"{n}_1": measured[n][:, 0] for n in ("fx", "fy", "mz")}
    with pytest.raises(ValueError, match="no value of fx_2, fy_2, mz_2;"):  # which moves the first base
        reconstruct(first, sensor("FBFBR"))
    clamped = Sensor(jw.Whisker(), jw.Support(mount=(jw.Mount(), jw.Mount())))
    points = reconstruct(first, clamped)
    assert np.all(np.asarray(points.status)[:, 1] == PointStatus.missing)
    with pytest.raises(ValueError, match="no value of mz_1;"):
        reconstruct({n: first[n] for n in ("control", "fx_1", "fy_1")}, clamped)
    with pytest.raises(ValueError, match="got no values;"):
        reconstruct({"control": CONTROL, "fx": np.full(CONTROL.size, np.nan)}, clamped)


def test_negated_moments_are_named():
    measured = signals("FB")[1]
    with pytest.raises(ValueError, match="check the sign of mz; the tables of the thesis negate mz"):
        reconstruct(measured | {"mz": -measured["mz"]}, sensor("FB"))


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("springs", "words"),
    [
        ((ABOVE,), "`base` must be given, because no signal shows"),
        ((ABOVE, jw.Spring((1, 2), 70.0, 0.2)), "`sensor` must be one whose springs do not connect whiskers"),
    ],
)
def test_poses_that_no_signal_shows_must_be_given(springs, words):
    support = jw.Support(springs)
    zeros = np.zeros((3, support.whiskers))
    measured = {"control": np.zeros(3), "fx": zeros, "fy": zeros, "mz": zeros}
    with pytest.raises(ValueError, match=words):
        jw.reconstruct(measured, jw.Sensor(jw.Whisker(), support))
