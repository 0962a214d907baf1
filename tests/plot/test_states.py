"""Figures of states, scenes and deflections."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
import pytest

import jaxwhisker as jw
import several
from jaxwhisker import plot
from jaxwhisker.plot import drawing
from pictured import LENGTH, MIDDLE, STIFFNESS

ROUNDING = 1e-12  # of lengths in L
SCANS = 1e-7  # relative difference of scans in different units


def whiskers_of(ax):
    return [line for line in ax.get_lines() if np.size(line.get_xdata()) == drawing.LINE_POINTS]


def test_shapes_are_at_the_nearest_steps(result):
    ax = plot.shapes(result, [0.4003, MIDDLE])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x/L$", "$y/L$") and ax.get_aspect() == 1
    lines = jw.shapes(result, at=[0.4003, MIDDLE])
    whiskers = whiskers_of(ax)
    assert len(whiskers) == 4
    for line, (at, k) in zip(whiskers, [(1, 0), (1, 1), (0, 0), (0, 1)], strict=True):
        np.testing.assert_allclose(line.get_xydata().T, [lines.x[at, k], lines.y[at, k]], atol=ROUNDING)
        assert line.get_color() == plot.COLOURS[k]
    assert whiskers[0].get_alpha() > whiskers[2].get_alpha()
    assert ax.get_legend().get_title().get_text() == "$u/L$: 0.40, \N{MINUS SIGN}0.50"
    assert plot.in_words(result, MIDDLE) == "1: tangential, 2: tangential"
    assert plot.in_words(result, 0.72) == "1: free, 2: free"


def test_positions_outside_the_scan_are_rejected(result, result_in_si):
    words = "`at` must be within the drive positions of the scan, from -1.62 to 0.72, got "
    for draw in (plot.shapes, plot.in_words):
        with pytest.raises(ValueError, match=words + "9"):
            draw(result, 9.0)
    with pytest.raises(ValueError, match=words + "-1.7"):
        plot.shapes(result, [0.0, -1.7])
    with pytest.raises(ValueError, match=r"from -0\.081 to 0\.036, got -0\.5"):
        plot.shapes(result_in_si, MIDDLE)
    ends = plot.shapes(result, [0.72 + ROUNDING, -1.62 - ROUNDING])
    assert ends.get_legend().get_title().get_text() == "$u/L$: 0.72, \N{MINUS SIGN}1.62"


def test_shapes_are_spread_over_the_contact(result):
    (touch, *_, last) = [event.control for event in result.events]
    listed = plot.shapes(result).get_legend().get_title().get_text()
    at = [float(u) for u in listed.removeprefix("$u/L$: ").replace("\N{MINUS SIGN}", "-").split(",")]
    assert len(at) == 5 and last < min(at) and max(at) < touch
    np.testing.assert_allclose(np.diff(at), (last - touch) / 5, atol=0.02)


def test_a_scene_is_drawn_before_the_touch(turned):
    start = drawing.start_of(turned.scene)
    ax = plot.scene(turned.scene)
    (whisker,) = [line for line in ax.get_lines() if line.get_label() == "whisker 1"]
    x, y = np.asarray(whisker.get_xydata()).T
    assert np.hypot(x, y - 1.0).min() > 0.4  # clear of the circle
    # The base stands on its mount, 0.1 in front of the drive.
    assert np.hypot(x[0], y[0] + 0.5) == pytest.approx(0.4)
    assert np.arctan2(x[0] - x[-1], y[-1] - y[0]) == pytest.approx(start + 0.2)


def test_every_object_is_in_the_window(result):
    other = jw.Circle(0.3, 0.2, -3.0)
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    scene = jw.Scene(result.scene.whiskers, (result.scene.profile, other), result.scene.support)
    several = jw.Result(**fields | {"scene": scene})
    for ax in (plot.shapes(several, MIDDLE), plot.scene(scene), plot.overview(several).axes[0]):
        left, right = ax.get_xlim()
        assert left <= -3.0 - 0.2 - 0.2 and right >= 0.5
        assert ax.get_aspect() == 1


def test_the_same_state_in_si_units_has_millimetres(result, result_in_si):
    ax, in_mm = plot.shapes(result, MIDDLE), plot.shapes(result_in_si, MIDDLE * LENGTH)
    per_length = 1000 * LENGTH
    assert (in_mm.get_xlabel(), in_mm.get_ylabel()) == ("$x$ (mm)", "$y$ (mm)")
    assert in_mm.get_legend().get_title().get_text() == "$u$ (mm): \N{MINUS SIGN}25.0"
    for line, scaled in zip(ax.get_lines(), in_mm.get_lines(), strict=True):
        if line.get_transform() == ax.transData:
            expected = per_length * np.asarray(line.get_xydata())
            np.testing.assert_allclose(scaled.get_xydata(), expected, atol=SCANS * per_length)
    for get in ("get_xlim", "get_ylim"):
        limits = np.array(getattr(ax, get)())
        np.testing.assert_allclose(getattr(in_mm, get)(), per_length * limits, atol=SCANS * per_length)
    arrows = [[annotation.xy for annotation in axes.texts] for axes in (ax, in_mm)]
    np.testing.assert_allclose(arrows[1], per_length * np.array(arrows[0]), atol=SCANS * per_length)


def test_units_dimensionless_hides_the_size_of_a_scene(result, result_in_si):
    ax, same = (
        plot.shapes(one, at, units="dimensionless") for one, at in ((result, MIDDLE), (result_in_si, MIDDLE * LENGTH))
    )
    assert (same.get_xlabel(), same.get_ylabel()) == ("$x/L$", "$y/L$")
    for line, other in zip(ax.get_lines(), same.get_lines(), strict=True):
        np.testing.assert_allclose(other.get_xydata(), line.get_xydata(), atol=SCANS)
    np.testing.assert_allclose(same.get_xlim(), ax.get_xlim(), atol=SCANS)


def test_a_scene_in_si_units_has_a_window_of_the_same_shape(result, result_in_si):
    ax, in_mm = plot.scene(result.scene), plot.scene(result_in_si.scene)
    np.testing.assert_allclose(in_mm.get_xlim(), 1000 * LENGTH * np.array(ax.get_xlim()), rtol=SCANS)
    assert in_mm.get_xlabel() == "$x$ (mm)"


@pytest.mark.parametrize("rest_length", [0.02, 0.05, 0.1])
def test_a_short_spring_lies_between_drive_and_base(rest_length):
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, rest_length), rod=jw.ClosedForm())
    ax = plot.scene(scene)
    (drive,) = [line for line in ax.get_lines() if line.get_label() == "drive"]
    (spring,) = [line for line in ax.get_lines() if np.size(line.get_xdata()) > 10 and line.get_zorder() == 2]
    x = np.asarray(spring.get_xdata())
    assert x.min() == pytest.approx(float(drive.get_xdata()[0]))
    assert np.ptp(x) == pytest.approx(rest_length)


def test_deflections_have_the_units_of_the_whisker():
    force = 3.0 * STIFFNESS / LENGTH**2
    bent = jw.deflect(jw.Whisker(LENGTH, STIFFNESS), jw.PointForce(force, position=LENGTH))
    labels, tips = [], []
    for options in ({}, {"units": "dimensionless"}, {"length": 2 * LENGTH}):
        ax = plot.deflection({"a": bent}, **options)
        labels.append((ax.get_xlabel(), ax.get_ylabel()))
        tips.append(ax.get_lines()[0].get_xydata()[-1])
    assert labels == [("$x$ (mm)", "$y$ (mm)"), ("$x/L$", "$y/L$"), ("$x/L$", "$y/L$")]
    np.testing.assert_allclose(tips[0], [1000 * bent.x[-1], 1000 * bent.y[-1]])
    np.testing.assert_allclose(tips[1:], [tips[0] / 50.0, tips[0] / 100.0])
    plain = plot.deflection({"a": jw.deflect(jw.Whisker(), jw.PointForce(3.0))})
    assert plain.get_xlabel() == "$x/L$"
    np.testing.assert_allclose(plain.get_lines()[0].get_xydata()[-1], tips[1], rtol=SCANS)


def test_all_contacts_are_shown():
    scanned, step = several.scanned(), several.BOTH[1]
    at = float(scanned.control[step])
    assert plot.in_words(scanned, at) == "1: tangential and tangential"
    assert plot.in_words(scanned, 0.3) == "1: free"
    heads = [text.xy for text in plot.shapes(scanned, at).texts]
    np.testing.assert_allclose(heads, np.stack([scanned.contact_x[step, 0], scanned.contact_y[step, 0]], axis=1))


def test_a_concave_object_is_filled_up_to_its_highest_places():
    ax = plot.profile(jw.Graph(several.wavy))
    (filled,), outline = ax.patches, ax.get_lines()[0].get_xydata()
    corners, above = filled.get_xy(), np.array([0.0, 1e-6])
    below_top = outline[1:-1][outline[1:-1, 1] < 0.399]
    assert filled.get_path().contains_points(below_top + above).all()
    assert not filled.get_path().contains_points(outline - above).any()
    assert corners[:, 1].max() == pytest.approx(0.4, abs=1e-3)
    convex = plot.profile(jw.Parabola(0.2))
    assert len(convex.patches[0].get_xy()) == 1 + len(convex.get_lines()[0].get_xydata())  # the first point again
