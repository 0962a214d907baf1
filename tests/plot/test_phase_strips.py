"""Strips of phases: where they begin and end, events, and gaps."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
from matplotlib.colors import to_hex

import jaxwhisker as jw
import several
from jaxwhisker import plot
from jaxwhisker.plot import phase_strips
from pictured import LENGTH, failed, of_steps


def extents(ax, whisker):
    """Left and right ends of the bars of a whisker in contact."""
    bars = [bar.get_paths()[0].get_extents() for bar in ax.collections if to_hex(bar.get_edgecolor()[0]) != "#777777"]
    return [(bar.x0, bar.x1) for bar in bars if abs((bar.y0 + bar.y1) / 2 - whisker - 1) < 0.4]


def test_phases_change_at_the_events(result):
    ax = plot.phases(of_steps(result, slice(0, None, 9)))  # independently of the steps
    for k in range(2):
        own = {round(e.control, 9) for e in result.events if e.whisker == k + 1 and e.kind != jw.EventKind.vertex}
        ends = {round(end, 9) for extent in extents(ax, k) for end in extent}
        # Whisker 2 passes through tip contact between two of these steps.
        assert ends == own if k == 0 else ends < own
    markers = [line for line in ax.get_lines() if line.get_marker() == "X"]
    assert [float(m.get_xdata()[0]) for m in markers] == [e.control for e in result.events.of(jw.EventKind.snap_off)]
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    assert words == ["free", "tip", "tangential", "touch", "vertex", "snap-off"]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["whisker 1", "whisker 2"]


def test_failed_steps_leave_gaps(result):
    bars = {tuple(np.round(extent, 9)) for extent in extents(plot.phases(failed(result, slice(60, 90))), 0)}
    control = np.asarray(result.control)
    # Nothing is known between the last step before and the first one after.
    assert not any(left < control[60] and right > control[89] for left, right in bars)
    assert {right for _, right in bars} > {round(float(control[90]), 9)}


def test_strips_in_si_units_are_in_millimetres(result, result_in_si):
    ax, in_mm = plot.phases(result), plot.phases(result_in_si)
    assert in_mm.get_xlabel() == "$u$ (mm)"
    np.testing.assert_allclose(extents(in_mm, 0), 1000 * LENGTH * np.array(extents(ax, 0)), rtol=1e-6)
    at, other = ([float(line.get_xdata()[0]) for line in axes.get_lines()] for axes in (ax, in_mm))
    np.testing.assert_allclose(other, 1000 * LENGTH * np.array(at), rtol=1e-6)


def test_phases_differ_without_colour():
    looks = [phase_strips._bar(phase, plot.COLOURS[0]) for phase in jw.Phase]
    assert len({(look["facecolor"] == "white", look.get("hatch")) for look in looks}) == 3


def test_every_contact_has_a_row():
    result = several.scanned()
    ax = plot.phases(result)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["whisker 1, contact 1", "whisker 1, contact 2"]
    touches = [event.control for event in result.events]
    np.testing.assert_allclose(extents(ax, 1), [(touches[3], touches[1])], rtol=1e-12)
    rows = {marker: [] for marker in ("o", "s", "X")}
    for line in ax.get_lines():
        rows[line.get_marker()].append(float(line.get_ydata()[0]))
    assert rows == {"o": [1.0, 2.0], "s": [1.0], "X": [1.0]}
