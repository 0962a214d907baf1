"""The geometry of a state: springs, forces, frames."""

# pyright: reportOptionalMemberAccess=false

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
import several
from jaxwhisker.plot import drawing
from pictured import CONTROL, MIDDLE

ROUNDING = 1e-12  # of lengths in L


def test_springs_are_as_long_as_they_are(result):
    steps = range(0, result.control.size, 29)
    drawn = [drawing.drawing_at(result, step) for step in steps]
    for step, one in zip(steps, drawn, strict=True):
        ends = [line.x[-1] - line.x[0] for line in one.springs]
        np.testing.assert_allclose(ends, result.spring_length[step], atol=ROUNDING)
        assert [float(line.y.min()) < -0.05 for line in one.springs] == [False, False, True]  # feedback hangs below
    assert len({str([line.x.shape for line in (*one.springs, *one.whiskers)]) for one in drawn}) == 1


def test_springs_turn_with_the_drive(turned):
    for step in (0, 50, 115):
        one = drawing.drawing_at(turned, step)
        x, y, angle = one.drive
        back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        across, along, coil = [back @ np.stack([line.x - x, line.y - y]) for line in one.springs]
        length, height, wound = np.asarray(turned.spring_length[step])
        base = back @ np.array([one.bases.x[0] - x, one.bases.y[0] - y])
        np.testing.assert_allclose(base, [length, 0.1 + height], atol=1e-9)
        for line in (across, along):
            np.testing.assert_allclose(line[:, -1], base, atol=ROUNDING)
        # From a wall that keeps its place on the drive.
        np.testing.assert_allclose((across[0, 0], along[1, 0]), (-drawing.STAND, 0.1 - drawing.STAND), atol=ROUNDING)
        inner, outer = (np.arctan2(*(coil[:, k] - base)[::-1]) for k in (1, -1))
        turns = 2 * np.pi * drawing._TURNS * 95 / 96  # of the spiral from its second point on
        assert np.sin(inner - outer - wound * 95 / 96 + turns) == pytest.approx(0.0, abs=1e-9)


def test_rigid_springs_are_straight_and_thick():
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfb((70.0, jnp.inf)))
    soft, rigid = drawing.drawing(scene, 1.0, drawing.rest_state(scene, 1.0)).springs
    assert np.ptp(soft.y) == pytest.approx(2 * drawing.AMPLITUDE) and np.ptp(rigid.y) == 0
    assert rigid.width > soft.width
    beside = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support(mount=(jw.Mount(0.0), jw.Mount(0.3, 0.1))))
    ends = [(line.x[-1], line.y[-1]) for line in drawing.drawing(beside, 1.0, drawing.rest_state(beside, 1.0)).springs]
    np.testing.assert_allclose(ends, [(1.0, 0.0), (1.3, 0.1)], atol=ROUNDING)


def test_forces_point_the_way_the_object_pushes(result):
    step = int(np.argmin(np.abs(CONTROL - MIDDLE)))
    for k, arrow in enumerate(drawing.drawing_at(result, step).arrows):
        way = np.subtract(arrow.head, arrow.tail)
        pushed = -np.array([result.fx[step, k], result.fy[step, k]])
        np.testing.assert_allclose(way / np.hypot(*way), pushed / np.hypot(*pushed), atol=1e-9)
        np.testing.assert_allclose(arrow.head, [result.contact_x[step, k], result.contact_y[step, k]])
    assert drawing.drawing_at(result, 0).arrows == (None, None)
    after = drawing.drawing(result.scene, result.events[-1].control, result.events[-1].after)
    assert after.arrows == (None, None)


def test_a_scene_starts_just_before_the_touch(result, turned):
    touch = result.events[0].control
    assert drawing.start_of(result.scene) == pytest.approx(touch + drawing.BEFORE_TOUCH, abs=ROUNDING)
    drive = drawing.drive_pose(result.scene, touch)
    assert (drive.x, drive.y, drive.angle) == (touch, 0.0, 0.0)
    start, step = drawing.start_of(turned.scene), np.pi / (drawing.CONTROLS - 1)
    assert start < turned.events[0].control < start + 1.01 * step


def test_a_scaled_drawing_keeps_angles_and_line_widths(turned):
    one = drawing.drawing_at(turned, 60)
    twice = one.scaled(2.0)
    assert twice.drive == (2 * one.drive.x, 2 * one.drive.y, one.drive.angle)
    for line, other in zip((*one.springs, one.arm, one.bases), (*twice.springs, twice.arm, twice.bases), strict=True):
        np.testing.assert_array_equal(other.x, 2 * line.x)
        assert other.width == line.width
    assert twice.arrows[0].head == tuple(2 * value for value in one.arrows[0].head)
    np.testing.assert_array_equal(twice.extent()[1], 2 * one.extent()[1])


def test_every_contact_has_an_arrow():
    scanned, step = several.scanned(), int(several.BOTH[1])
    both, one = (drawing.drawing_at(scanned, k).arrows for k in (step, 20))
    for contact, arrow in enumerate(both):
        np.testing.assert_allclose(
            arrow.head, [scanned.contact_x[step, 0, contact], scanned.contact_y[step, 0, contact]]
        )
    force = np.asarray(scanned.contact_force[step, 0])
    lengths = [np.hypot(*np.subtract(arrow.head, arrow.tail)) for arrow in both]
    largest = float(np.max(scanned.contact_force))
    np.testing.assert_allclose(lengths, drawing.arrow_length(force, largest))
    assert len(both) == len(one) == 2 and one[1] is None


def test_a_scan_with_several_contacts_starts_before_the_first_touch():
    start = drawing.start_of(several.circles())
    assert 0.2 + 0.9 * drawing.BEFORE_TOUCH < start < 0.2 + 2.1 * drawing.BEFORE_TOUCH
    state = drawing.rest_state(several.circles(), start)
    assert state.phase.shape == (1, 2) and state.fx.shape == (1,) and float(state.base_x[0]) == start
