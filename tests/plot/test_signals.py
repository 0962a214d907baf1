"""Figures of quantities over the control."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.axes import Axes

import jaxwhisker as jw
import several
from jaxwhisker import plot
from jaxwhisker.plot import signals
from pictured import LENGTH, STIFFNESS, failed

MILLI = 1000
SCANS = 1e-7  # relative difference of scans in different units
FORCE, MOMENT = STIFFNESS / LENGTH**2, STIFFNESS / LENGTH


def curves(ax):
    return [line for line in ax.get_lines() if not line.get_label().startswith("_")]


def test_signals_are_those_of_the_scan(result):
    rows = plot.reactions(result)
    assert isinstance(rows, np.ndarray) and len(rows) == 3 and isinstance(rows[0], Axes)
    for ax, name in zip(rows, ("fx", "fy", "mz"), strict=True):
        for k, line in enumerate(curves(ax)):
            np.testing.assert_array_equal(line.get_xdata(), result.control)
            np.testing.assert_array_equal(line.get_ydata(), getattr(result, name)[:, k])
            assert line.get_color() == plot.COLOURS[k]
        marked = [float(np.asarray(line.get_xdata())[0]) for line in ax.get_lines() if line not in curves(ax)]
        assert marked == [event.control for event in result.events]
    assert [ax.get_ylabel() for ax in rows] == [r"$f_x\,L^2/EI$", r"$f_y\,L^2/EI$", r"$m_z\,L/EI$"]
    assert [ax.get_xlabel() for ax in rows] == ["", "", "$u/L$"]
    kinds = ["touch", "tip-to-tangential", "vertex", "tangential-to-tip", "snap-off"]
    assert [text.get_text() for text in rows[0].get_legend().get_texts()] == ["whisker 1", "whisker 2", *kinds]
    assert rows[1].get_legend() is None


def test_events_have_the_marker_of_their_kind(result):
    ax = plot.reactions(result)[0]
    shown = {text.get_text(): entry.get_marker() for entry, text in entries(ax)}
    lines = [line for line in ax.get_lines() if line not in curves(ax)]
    for line, event in zip(lines, result.events, strict=True):
        assert line.get_marker() == shown[event.kind.name.replace("_", "-")]
        assert line.get_markeredgecolor() == plot.COLOURS[event.whiskers[0] - 1]
        (marked,) = np.asarray(line.get_ydata())[line.get_markevery()]
        assert 0.9 < marked < 1  # within the Axes, where they do not hide the curves


def entries(ax):
    return zip(ax.get_legend().legend_handles, ax.get_legend().get_texts(), strict=True)


def test_signals_in_si_units_have_prefixes(result, result_in_si):
    rows, in_si = plot.reactions(result), plot.reactions(result_in_si)
    assert [ax.get_ylabel() for ax in in_si] == ["$f_x$ (mN)", "$f_y$ (mN)", "$m_z$ (mN mm)"]
    assert in_si[-1].get_xlabel() == "$u$ (mm)"
    for ax, other, size in zip(rows, in_si, (FORCE, FORCE, MILLI * MOMENT), strict=True):
        for line, same in zip(ax.get_lines(), other.get_lines(), strict=True):
            x, y = np.asarray(line.get_xydata()).T
            # Lines of events have heights in shares of the axes.
            expected = MILLI * size * y if line in curves(ax) else y
            np.testing.assert_allclose(np.asarray(same.get_xdata()), MILLI * LENGTH * x, atol=SCANS * MILLI * LENGTH)
            np.testing.assert_allclose(np.asarray(same.get_ydata()), expected, atol=SCANS * MILLI * size * 100)


def test_units_dimensionless_makes_signals_of_all_scenes_equal(result, result_in_si):
    for ax, other in zip(plot.reactions(result), plot.reactions(result_in_si, units="dimensionless"), strict=True):
        assert (ax.get_xlabel(), ax.get_ylabel()) == (other.get_xlabel(), other.get_ylabel())
        for line, same in zip(ax.get_lines(), other.get_lines(), strict=True):
            np.testing.assert_allclose(same.get_xydata(), line.get_xydata(), atol=1e-5)


def test_compared_scans_share_units(result, result_in_si):
    ax = plot.compare({"a": result, "b": result_in_si}, "mz", index=2)
    assert ax.get_ylabel() == r"$m_z\,L/EI$"
    first, second = (np.asarray(line.get_xydata()) for line in curves(ax))
    np.testing.assert_allclose(second, first, atol=1e-5)
    ax = plot.compare({"b": result_in_si}, "spring_length", index=3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$u$ (mm)", r"$\ell$ (mm)")
    np.testing.assert_allclose(curves(ax)[0].get_ydata(), MILLI * result_in_si.spring_length[:, 2])


def test_the_range_of_contact_has_the_units_of_the_axis(result, result_in_si):
    low, high = plot.contact_range([result])
    touch, last = result.events[0].control, result.events[-1].control
    assert low < last < touch < high < low + 1.1 * (touch - last)
    np.testing.assert_allclose(plot.contact_range([result_in_si]), (MILLI * LENGTH * low, MILLI * LENGTH * high))
    page = plot.overview(result_in_si)
    assert all(ax.get_xlim() == page.axes[1].get_xlim() for ax in page.axes[2:])
    np.testing.assert_allclose(page.axes[1].get_xlim(), (MILLI * LENGTH * low, MILLI * LENGTH * high))
    assert page.axes[-1].get_ylabel() == r"$\Delta\ell$ (mm)" and page.axes[0].get_xlabel() == "$x$ (mm)"
    assert plot.overview(result_in_si, units="dimensionless").axes[-1].get_xlabel() == "$u/L$"


def test_springs_have_the_colours_of_their_whiskers(result, turned):
    ax = plot.spring_lengths(result)
    assert [line.get_color() for line in curves(ax)] == [plot.COLOURS[k] for k in (0, 1, 1)]
    assert [line.get_linestyle() for line in curves(ax)] == ["-", "-", "--"]
    assert ax.get_ylabel() == r"$\ell/L$"
    ax = plot.spring_lengths(turned)
    assert [line.get_label() for line in curves(ax)] == ["spring 1", "spring 2, $y$", r"spring 3, $\varphi$"]
    assert ax.get_ylabel() == r"$\ell/L$, $\varphi$ (rad)" and ax.get_xlabel() == "angle of the drive (rad)"


def test_extensions_are_lengths_beyond_rest_lengths(result, turned):
    lengths, extensions = curves(plot.spring_lengths(result)), curves(plot.spring_extensions(result))
    for length, extension, spring in zip(lengths, extensions, result.scene.support.springs, strict=True):
        expected = np.asarray(length.get_ydata()) - float(spring.rest_length)
        np.testing.assert_array_equal(extension.get_ydata(), expected)
        assert extension.get_color() == length.get_color() and extension.get_linestyle() == length.get_linestyle()
    assert plot.spring_extensions(turned).get_ylabel() == r"$\Delta\ell/L$, $\Delta\varphi$ (rad)"


def test_an_axial_spring_is_not_extended_at_the_absolute_value_of_its_rest_length(result):
    spring = jw.Spring((0, 1), 70.0, -0.2, axis="axial", at=0.1)
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support((spring, jw.Spring((0, 1), 70.0))))
    lengths = jnp.tile(jnp.array([0.25, 0.0]), (result.control.size, 1))
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    axial = jw.Result(**fields | {"scene": scene, "spring_length": lengths})
    ax = plot.spring_extensions(axial)
    np.testing.assert_allclose(curves(ax)[0].get_ydata(), 0.05)
    assert curves(ax)[0].get_label() == "spring 1"


@pytest.mark.parametrize("size", [1e-7, 0.0])
def test_stiff_springs_are_not_drawn_as_flat_lines(result, size):
    scale = size / np.ptp(result.spring_length[:, 0])
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    rest = np.array([spring.rest_length for spring in result.scene.support.springs])
    stiff = jw.Result(**fields | {"spring_length": rest + scale * (result.spring_length - rest)})
    low, high = plot.spring_extensions(stiff).get_ylim()
    assert (high - low < 5 * size) if size else (high - low > signals.LEAST_EXTENSION)


def test_curves_have_legends(result, result_in_si):
    def texts(ax):
        return [text.get_text() for text in ax.get_legend().get_texts()]

    assert texts(plot.compare({"a": result, "b": result_in_si}, "mz")) == ["a", "b"]
    assert texts(plot.compare({"one": result}, "mz")) == ["one"]
    assert texts(plot.signal(result, "mz")) == ["whisker 1", "whisker 2"]


def test_failed_steps_leave_gaps(result):
    lost = failed(result, slice(60, 90))
    ax = plot.reactions(lost)[0]
    assert np.isnan(np.asarray(curves(ax)[0].get_ydata())).sum() == 30
    assert plot.shapes(lost, float(result.control[70])).get_title() == ""
    nothing = failed(result, slice(None))
    for draw in (plot.shapes, plot.spring_lengths, plot.spring_extensions, plot.phases, plot.overview):
        draw(nothing)
    plot.reactions(nothing)


def test_losses_of_lateral_stability_are_marked_in_the_colours_of_whiskers(result):
    rows = plot.reactions(result)
    before = [len(ax.get_lines()) for ax in rows]
    limits = [ax.get_xlim() for ax in rows]
    places = [-0.3, np.nan]
    assert plot.lateral_losses(result, np.array(places), axs=rows) is not rows
    for ax, count, limit in zip(rows, before, limits, strict=True):
        (line,) = ax.get_lines()[count:]
        assert line.get_color() == plot.COLOURS[0] and list(line.get_xdata()) == [-0.3, -0.3]
        (shade,) = ax.patches
        # The drive moves towards -x: what comes after the loss is on the left.
        np.testing.assert_allclose(shade.get_extents().x1, ax.transData.transform((-0.3, 0))[0])
        assert ax.get_xlim() == limit
        assert [text.get_text() for text in ax.texts] == ["needs lateral guidance"]
    # Whiskers that stay in the plane have no marks.
    (free,) = plot.lateral_losses(result, np.array([np.nan, np.nan]), axs=[plot.signal(result, "fx")])
    assert not free.patches and not free.texts


def test_long_titles_of_overviews_are_broken_into_lines(result, monkeypatch):
    assert "\n" not in plot.overview(result).get_suptitle()
    monkeypatch.setattr("jaxwhisker.plot.signals.LETTERS", 2)
    title = plot.overview(result).get_suptitle()
    assert title.split() == str(result.scene).split() and max(map(len, title.split("\n"))) <= 22


def test_every_contact_has_a_curve():
    result = several.scanned()
    first, second = curves(plot.signal(result, "contact_force"))
    assert [line.get_label() for line in (first, second)] == ["whisker 1, contact 1", "whisker 1, contact 2"]
    assert (first.get_linestyle(), second.get_linestyle()) == ("-", "--")
    np.testing.assert_array_equal(second.get_ydata(), result.contact_force[:, 0, 1])
    _, inner = curves(plot.signal(result, "contact_x"))
    np.testing.assert_array_equal(np.isfinite(inner.get_ydata()), np.asarray(result.phase)[:, 0, 1] > 0)
    assert len(curves(plot.signal(result, "mz"))) == 1


def test_all_contacts_are_compared():
    result = several.scanned()
    lines = plot.compare({"a": result, "b": several.with_one_contact(result)}, "contact_arc").get_lines()
    assert [line.get_linestyle() for line in lines] == ["-", "--", "-"]
    assert lines[0].get_color() == lines[1].get_color() != lines[2].get_color()
    low, high = plot.contact_range([result])
    assert low < -1.38 and 0.15 < high < 0.3
