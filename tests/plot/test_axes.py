"""Labels, units that results share, argument checks, and saved files."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker.plot.axes import unit_systems
from pictured import MIDDLE, coupled, summarised, turning


def test_labels_have_symbol_and_unit(result_in_si):
    scene = result_in_si.scene
    assert plot.axis_label("fx") == r"$f_x\,L^2/EI$" and plot.axis_label("mz", scene) == "$m_z$ (mN mm)"
    assert plot.axis_label("contact_slope") == plot.axis_label("contact_slope", scene) == r"$\alpha$ (rad)"
    assert plot.axis_label("base_x", scene, units="dimensionless") == "$x_0/L$"
    assert plot.CONTROL_AXIS == plot.control_axis(coupled()) == "$u/L$"
    assert plot.control_axis(scene) == "$u$ (mm)"
    assert plot.control_axis(coupled(), units="SI") == "$u$ (m)"
    assert plot.control_axis(turning()) == "angle of the drive (rad)"
    assert {plot.axis_label(name)[0] for name in plot.QUANTITIES} == {"$"}


def test_results_on_the_same_axes_share_their_units(result, result_in_si):
    small = jw.Result(**{**vars(result_in_si), "scene": coupled(2e-4, 1e-9)})
    in_mm = unit_systems([result_in_si, small], "auto")
    assert [system.label("base_x") for system in in_mm] == ["$x_0$ (mm)"] * 2
    assert unit_systems([small], "auto")[0].label("base_x") == "$x_0$ (µm)"
    # Each by its own L and EI, as soon as one of them is dimensionless.
    both = unit_systems([result, result_in_si], "auto")
    assert [system.label("base_x") for system in both] == ["$x_0/L$"] * 2
    assert [system.unit("base_x").size for system in both] == [1.0, 0.05]


def test_text_in_files_stays_text(result, tmp_path):
    ax = plot.reactions(result)[0]
    plot.save(ax, tmp_path / "reactions.svg")
    plot.save(ax.figure, str(tmp_path / "reactions.pdf"))
    plot.save(plot.phases(result), tmp_path / "phases.svg")
    drawn = (tmp_path / "reactions.svg").read_text()
    assert "<text" in drawn and "whisker 2" in drawn
    assert "tangential" in (tmp_path / "phases.svg").read_text()
    assert b"/Type3" not in (tmp_path / "reactions.pdf").read_bytes()


def test_figures_go_into_the_axes_given(result, turned):
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


def batch(result):
    return jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), result)


def clamped(result):
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    springs = jnp.zeros((result.control.size, 0))
    support = jw.Support(mount=(jw.Mount(), jw.Mount(0.2)))
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), support)
    return jw.Result(**fields | {"scene": scene, "spring_length": springs})


OF_A_SCAN = {
    "shapes": plot.shapes,
    "reactions": plot.reactions,
    "spring_lengths": plot.spring_lengths,
    "spring_extensions": plot.spring_extensions,
    "phases": plot.phases,
    "strain": lambda result: plot.strain(result, 0.01),
    "overview": plot.overview,
    "signal": lambda result: plot.signal(result, "fx"),
    "in_words": lambda result: plot.in_words(result, 0.0),
    "compare": lambda result: plot.compare({"a": result}, "fx"),
    "contact_range": lambda result: plot.contact_range([result]),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", OF_A_SCAN)
@pytest.mark.parametrize("wrong", [None, 3, "result", {}, jw.Parabola(0.2)], ids=lambda value: type(value).__name__)
def test_only_results_of_one_scan_are_drawn(name, wrong, result):
    with pytest.raises(ValueError, match="`result` must be the Result of a scan"):
        OF_A_SCAN[name](wrong)
    with pytest.raises(ValueError, match=r"`result` must be the result of a single scan, got a batch of shape \(2,\)"):
        OF_A_SCAN[name](batch(result))
    assert not pyplot.get_fignums()


OTHERS = {
    "scene": (plot.scene, "`setup` must be a Scene or an Array, got"),
    "profile": (plot.profile, "`shape` must be a profile such as .*, got"),
    "same_window": (plot.same_window, "`axs` must be Axes, got"),
    "save": (lambda value: plot.save(value, "nowhere.png"), "`drawn` must be a matplotlib Figure or Axes, got"),
    "control_axis": (plot.control_axis, "`scene` must be a Scene, got"),
    "axis_label": (plot.axis_label, "`quantity` must be one of base_x|fx.*, got"),
    "compare": (lambda value: plot.compare(value, "fx"), "`results` must "),
    "contact_range": (plot.contact_range, "`results` must hold at least one Result, got"),
    "deflection": (plot.deflection, "`results` must be a non-empty mapping .*, got"),
    "study": (plot.study, "`data` must be a Dataset of jw.summary, got"),
    "fit": (plot.fit, "`result` must be the Fit of jw.identify, got"),
    "information": (plot.information, "`result` must be the Information of jw.information, got"),
    "contour": (plot.contour, "`result` must be the result of jw.reconstruct, jw.fit_profile or jw.fit_contour, got"),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("wrong", [None, 3, {}], ids=str)
def test_wrong_objects_are_rejected_by_name(name, wrong):
    draw, words = OTHERS[name]
    with pytest.raises(ValueError, match=words):
        draw(wrong)
    assert not pyplot.get_fignums()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda r: plot.profile(r.scene.profile, length=0.0), "`length` must be .*positive.*0"),
        (lambda r: plot.profile(r.scene.profile, length=jnp.nan), "`length` must be .*nan"),
        (lambda r: plot.shapes(r, "middle"), "`at` must be .*'middle'"),
        (lambda r: plot.shapes(r, jnp.nan), "`at` must be .*nan"),
        (lambda r: plot.shapes(r, []), "`at` must be .*non-empty"),
        (lambda r: plot.shapes(r, [[0.1]]), "`at` must be .*one-dimensional"),
        (lambda r: plot.shapes(r, ax=3), "`ax` must be matplotlib Axes, got 3"),
        (lambda r: plot.shapes(r, units="mm"), "`units` must be one of auto, SI, dimensionless, got 'mm'"),
        (lambda r: plot.reactions(r, axs=Figure().subplots(2, 1)), "`axs` must be 3 Axes, got 2"),
        (lambda r: plot.reactions(r, axs=3), "`axs` must be 3 Axes, got 3"),
        (lambda r: plot.signal(r, "fz"), "`quantity` must be one of .*, got 'fz'"),
        (lambda r: plot.compare({"a": r}, "fx", index=3), "`index` must lie between 1 and 2, got 3"),
        (lambda r: plot.compare({"a": r}, "fx", index="1"), "`index` must lie between 1 and 2, got '1'"),
        (lambda r: plot.spring_extensions(clamped(r)), "`result` must have whiskers on springs, got"),
        (lambda r: plot.spring_lengths(clamped(r)), "`result` must have whiskers on springs, got"),
        (lambda r: plot.deflection({"a": r}), "`results` must be a non-empty mapping"),
        (lambda r: plot.study(summarised(), "fx"), "`name` must be one of max_mz, got 'fx'"),
        (lambda r: plot.study(summarised(), critical=1.0), "`critical` must be a DataArray, got 1.0"),
        (lambda r: plot.study(summarised().isel(stiffness=0, distance=0)), "`data` must have max_mz over one or two"),
        (lambda r: plot.study(summarised(), axs=Figure().subplots(1, 3)), "`axs` must be 2 Axes, got 3"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(draw, words, result):
    with pytest.raises(ValueError, match=words):
        draw(result)
    assert not pyplot.get_fignums()
