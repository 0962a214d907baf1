"""Pictures: what they show, their labels and manners, wrong input."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot, rcParams
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker.plot import drawing, strips
from pictured import ANGLES, CONTROL, MIDDLE, coupled, failed, of_steps, steepness, summarised, turning

ROUNDING = 1e-12  # of lengths in L


@pytest.fixture(scope="module")
def result():
    return jw.scan(coupled(), CONTROL)


@pytest.fixture(scope="module")
def turned():
    return jw.scan(turning(), ANGLES)


@pytest.fixture(autouse=True)
def _manners(monkeypatch):
    """No picture opens a window or changes matplotlib's settings for those to come."""

    def never(*_, **__):
        raise AssertionError("a picture opened a window")

    monkeypatch.setattr(pyplot, "show", never)
    before = dict(rcParams)
    yield
    assert dict(rcParams) == before
    pyplot.close("all")


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
    assert [text.get_text() for text in rows[0].get_legend().get_texts()] == ["whisker 1", "whisker 2"]


def test_springs_have_the_colours_of_their_whiskers(result, turned):
    ax = plot.spring_lengths(result)
    assert [line.get_color() for line in curves(ax)] == [plot.COLOURS[k] for k in (0, 1, 1)]
    assert [line.get_linestyle() for line in curves(ax)] == ["-", "-", "--"]
    assert ax.get_ylabel() == r"$\ell/L$"
    ax = plot.spring_lengths(turned)
    assert [line.get_label() for line in curves(ax)] == ["spring 1", "spring 2, $y$", r"spring 3, $\varphi$"]
    assert ax.get_ylabel() == r"$\ell/L$, $\varphi$ (rad)" and ax.get_xlabel() == "angle of the drive (rad)"


def test_shapes_are_at_the_nearest_steps(result):
    ax = plot.shapes(result, [0.4003, MIDDLE])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x/L$", "$y/L$") and ax.get_aspect() == 1
    lines = jw.shapes(result, at=[0.4003, MIDDLE])
    whiskers = [line for line in ax.get_lines() if np.size(line.get_xdata()) == drawing.POINTS]
    assert len(whiskers) == 4
    for line, (at, k) in zip(whiskers, [(1, 0), (1, 1), (0, 0), (0, 1)], strict=True):
        np.testing.assert_allclose(line.get_xydata().T, [lines.x[at, k], lines.y[at, k]], atol=ROUNDING)
        assert line.get_color() == plot.COLOURS[k]
    assert whiskers[0].get_alpha() > whiskers[2].get_alpha()
    assert ax.get_legend().get_title().get_text() == "$u/L$: 0.40, \N{MINUS SIGN}0.50"
    assert plot.in_words(result, MIDDLE) == "1: tangential, 2: tangential" and plot.in_words(result, 9.0).endswith(
        "free"
    )


def test_shapes_are_spread_over_the_contact(result):
    (touch, *_, last) = [event.control for event in result.events]
    told = plot.shapes(result).get_legend().get_title().get_text()
    at = [float(u) for u in told.removeprefix("$u/L$: ").replace("\N{MINUS SIGN}", "-").split(",")]
    assert len(at) == 5 and last < min(at) and max(at) < touch
    np.testing.assert_allclose(np.diff(at), (last - touch) / 5, atol=0.02)


def test_a_scene_is_drawn_before_the_touch(result, turned):
    touch = result.events[0].control
    assert drawing.start_of(result.scene) == pytest.approx(touch + drawing.AHEAD, abs=ROUNDING)
    drive = drawing.drive_pose(result.scene, touch)
    assert (drive.x, drive.y, drive.angle) == (touch, 0.0, 0.0)
    start, step = drawing.start_of(turned.scene), np.pi / (drawing.LOOKED_AT - 1)
    assert start < turned.events[0].control < start + 1.01 * step
    ax = plot.scene(turned.scene)
    (whisker,) = [line for line in ax.get_lines() if line.get_label() == "whisker 1"]
    x, y = np.asarray(whisker.get_xydata()).T
    assert np.hypot(x, y - 1.0).min() > 0.4  # clear of the circle
    # The base stands on its mount, 0.1 in front of the drive.
    assert np.hypot(x[0], y[0] + 0.5) == pytest.approx(0.4)
    assert np.arctan2(x[0] - x[-1], y[-1] - y[0]) == pytest.approx(start + 0.2)


def test_units_do_not_matter(result):
    length, stiffness = 0.04, 2e-3
    whisker = jw.Whisker(length, stiffness)
    support = jw.Support.fbfbr(70.0 * stiffness / length**3, 0.2 * length)
    scene = jw.Scene(whisker, jw.Parabola(0.2 * length, 1 / length), support, rod=jw.ClosedForm())
    large = jw.scan(scene, CONTROL * length)
    for ax, other in zip(plot.reactions(result), plot.reactions(large), strict=True):
        assert (ax.get_xlabel(), ax.get_ylabel()) == (other.get_xlabel(), other.get_ylabel())
        for line, same in zip(ax.get_lines(), other.get_lines(), strict=True):
            np.testing.assert_allclose(same.get_xydata(), line.get_xydata(), atol=1e-7)
    ax, other = plot.shapes(result, MIDDLE), plot.shapes(large, MIDDLE * length)
    for line, same in zip(ax.get_lines(), other.get_lines(), strict=True):
        np.testing.assert_allclose(same.get_xydata(), line.get_xydata(), atol=1e-7)
    np.testing.assert_allclose(other.get_xlim(), ax.get_xlim(), atol=1e-7)


def test_failed_steps_leave_gaps(result):
    lost = failed(result, slice(60, 90))
    ax = plot.reactions(lost)[0]
    assert np.isnan(np.asarray(curves(ax)[0].get_ydata())).sum() == 30
    bars = {tuple(np.round(extent, 9)) for extent in extents(plot.phases(lost), 0)}
    control = np.asarray(result.control)
    # Nothing is known between the last step before and the first one after.
    assert not any(left < control[60] and right > control[89] for left, right in bars)
    assert {right for _, right in bars} > {round(float(control[90]), 9)}
    assert plot.shapes(lost, float(control[70])).get_title() == ""
    nothing = failed(result, slice(None))
    for draw in (plot.shapes, plot.spring_lengths, plot.phases, plot.overview):
        draw(nothing)
    plot.reactions(nothing)


def extents(ax, whisker):
    """Left and right ends of the bars of a whisker, but for those of free ones."""
    bars = [bar.get_paths()[0].get_extents() for bar in ax.collections if to_hex(bar.get_edgecolor()[0]) != "#777777"]
    return [(bar.x0, bar.x1) for bar in bars if abs((bar.y0 + bar.y1) / 2 - whisker - 1) < 0.4]


def test_phases_change_at_the_events(result):
    ax = plot.phases(of_steps(result, slice(0, None, 9)))  # whatever the steps
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


def test_phases_are_told_apart_in_grey():
    looks = [strips._bar(phase, plot.COLOURS[0]) for phase in jw.Phase]
    assert len({(look["facecolor"] == "white", look.get("hatch")) for look in looks}) == 3


def test_pictures_go_where_they_are_asked_to(result, turned):
    figure, (left, right) = pyplot.subplots(1, 2)
    numbers = pyplot.get_fignums()
    assert plot.scene(result.scene, ax=left) is left and plot.shapes(result, MIDDLE, ax=right) is right
    assert plot.phases(result, ax=left) is left and plot.spring_lengths(result, ax=right) is right
    rows = Figure().subplots(3, 1)
    np.testing.assert_array_equal(plot.reactions(result, axs=rows), rows)
    assert pyplot.get_fignums() == numbers and figure.axes == [left, right]
    page = plot.overview(turned)
    assert len(page.axes) == 5 and page.axes[0].get_xlabel() == "$x/L$"
    assert pyplot.get_fignums() == numbers


def test_maps_share_a_scale():
    axs = plot.study(summarised(), critical=steepness(summarised()))
    assert [ax.get_legend().get_title().get_text() for ax in axs] == ["whisker 1", "whisker 2"]
    first, second = (ax.collections[0] for ax in axs)
    assert first.get_clim() == second.get_clim()
    assert axs[0].get_xlabel() == "stiffness [EI/L^3]" and axs[0].get_legend() is not None


def test_saved_text_is_text(result, tmp_path):
    ax = plot.reactions(result)[0]
    plot.save(ax, tmp_path / "reactions.svg")
    plot.save(ax.figure, str(tmp_path / "reactions.pdf"))
    plot.save(plot.phases(result), tmp_path / "phases.svg")
    drawn = (tmp_path / "reactions.svg").read_text()
    assert "<text" in drawn and "whisker 2" in drawn
    assert "tangential" in (tmp_path / "phases.svg").read_text()
    assert b"/Type3" not in (tmp_path / "reactions.pdf").read_bytes()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda r: plot.scene(r), "`scene` must be a Scene"),
        (lambda r: plot.profile(r), "`object` must be a profile"),
        (lambda r: plot.profile(r.scene.profile, length=0.0), "`length` must be .*positive.*0"),
        (lambda r: plot.profile(r.scene.profile, length=jnp.nan), "`length` must be .*nan"),
        (lambda r: plot.shapes(r.scene), "`result` must be the Result of a scan"),
        (lambda r: plot.shapes(r, "middle"), "`at` must be .*'middle'"),
        (lambda r: plot.shapes(r, jnp.nan), "`at` must be .*nan"),
        (lambda r: plot.shapes(r, []), "`at` must be .*non-empty"),
        (lambda r: plot.shapes(r, [[0.1]]), "`at` must be .*one-dimensional"),
        (lambda r: plot.reactions(r, axs=Figure().subplots(2, 1)), "`axs` must be 3 Axes, but are 2"),
        (lambda r: plot.signal(r, "fz"), "`quantity` must be one of .*'fz'"),
        (lambda r: plot.compare({"a": r}, "fx", index=3), "`index` must lie between 1 and 2, but is 3"),
        (lambda r: plot.spring_lengths(clamped(r)), "`result` must be of whiskers on springs"),
        (lambda r: plot.study(summarised(), "fx"), "`name` must be one of max_mz, but is 'fx'"),
        (lambda r: plot.study(summarised().isel(stiffness=0, distance=0)), "`data` must hold max_mz over one or two"),
        (lambda r: plot.study(summarised(), axs=Figure().subplots(1, 3)), "`axs` must be 2 Axes, but are 3"),
        *[
            (lambda r, draw=draw: draw(batch(r)), r"`result` must be of one scan, but is a batch of shape \(2,\)")
            for draw in (plot.shapes, plot.reactions, plot.spring_lengths, plot.phases, plot.overview)
        ],
    ],
)
def test_what_cannot_be_drawn_is_told_by_name(draw, words, result):
    with pytest.raises(ValueError, match=words):
        draw(result)
    assert not pyplot.get_fignums()


def batch(result):
    return jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), result)


def clamped(result):
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    springs = jnp.zeros((result.control.size, 0))
    support = jw.Support(mount=(jw.Mount(), jw.Mount(0.2)))
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), support)
    return jw.Result(**fields | {"scene": scene, "spring_length": springs})
