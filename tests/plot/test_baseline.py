"""Figures look as stored in `baseline`, and mistakes in them are detected."""

import os
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.testing.compare import compare_images
from matplotlib.ticker import NullFormatter

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker.plot import axes, drawing, inverse, phase_strips, signals
from pictured import (
    MIDDLE,
    failed,
    of_steps,
    some_fit,
    some_information,
    some_points,
    steepness,
    summarised,
    there_and_back,
)

BASELINE = Path(__file__).parent / "baseline"
WRITE = os.environ.get("JAXWHISKER_BASELINE") == "write"  # after an intended change; look at the new files
TOLERANCE = 1.0  # rms of grey levels up to 255: matplotlib 3.9 to 3.11 agree exactly, the smallest mistake is 3
SIZE, DPI = (3.35, 2.4), 80  # inches: a column of a journal
SEVERAL = (0.4, -0.2, -0.8)


def drawn(name, result, turned):
    """Draw a small figure without text, because fonts differ between machines."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    rows, columns = {"reactions": (3, 1), "fit": (3, 2)}.get(name, (1, 1))
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.03, top=0.97)
    axs = figure.subplots(rows, columns, squeeze=False).ravel()
    ax = axs[0]
    {
        "scene": lambda: plot.scene(result.scene, ax=ax),
        "scene_turning": lambda: plot.scene(turned.scene, ax=ax),
        "shapes": lambda: plot.shapes(result, MIDDLE, ax=ax),
        "shapes_several": lambda: plot.shapes(result, SEVERAL, ax=ax),
        "shapes_turning": lambda: plot.shapes(turned, ax=ax),
        "reactions": lambda: plot.reactions(result, axs=axs),
        "spring_lengths": lambda: plot.spring_lengths(result, ax=ax),
        "spring_extensions": lambda: plot.spring_extensions(result, ax=ax),
        "phases": lambda: plot.phases(result, ax=ax),
        "phases_and_back": lambda: plot.phases(failed(there_and_back(result), slice(60, 90)), ax=ax),
        "compare": lambda: plot.compare({"a": result, "b": of_steps(result, slice(0, 150))}, "mz", index=2, ax=ax),
        "study_line": lambda: plot.study(
            summarised().isel(distance=1), critical=steepness(summarised()).isel(distance=1, drop=True), axs=[ax]
        ),
        "study_map": lambda: plot.study(summarised().isel(whisker=[0]), critical=steepness(summarised()), axs=[ax]),
        "information": lambda: plot.information(some_information(), ax=ax),
        "fit": lambda: plot.fit(some_fit(result), axs=axs),
        "contour": lambda: plot.contour(some_points(), profile=jw.Parabola(0.2), ax=ax),
        "deflection": lambda: plot.deflection({"a": jw.deflect(jw.Whisker(), jw.PointForce(3.0))}, ax=ax),
    }[name]()
    for ax in figure.axes:
        ax.set(title="", xlabel="", ylabel="")
        if legend := ax.get_legend():
            legend.remove()
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(NullFormatter())
            axis.set_minor_formatter(NullFormatter())
    return figure


FIGURES = """
scene scene_turning shapes shapes_several shapes_turning reactions spring_lengths spring_extensions phases
phases_and_back compare study_line study_map information fit contour deflection
""".split()  # noqa: SIM905


def difference(figure, name, folder):
    """Differences from the stored figure in words; None if there are none."""
    actual = folder / f"{name}.png"
    figure.savefig(actual)
    return compare_images(str(BASELINE / f"{name}.png"), str(actual), TOLERANCE)


@pytest.mark.unchecked  # the made-up fit only has the fields that are drawn
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_looks_as_stored(name, result, turned, tmp_path):
    figure = drawn(name, result, turned)
    if WRITE:
        BASELINE.mkdir(exist_ok=True)
        figure.savefig(BASELINE / f"{name}.png")
    message = difference(figure, name, tmp_path)
    assert message is None, message


def other_colours(monkeypatch):
    monkeypatch.setattr(axes, "COLOURS", axes.COLOURS[1:])


def no_springs(monkeypatch):
    monkeypatch.setattr(drawing, "spring_lines", lambda *_: ())


def slack_springs(monkeypatch):
    monkeypatch.setattr(drawing, "AMPLITUDE", 0.0)


def forces_on_the_object(monkeypatch):
    arrow = drawing.force_arrow

    def reversed(*state):
        drawn = arrow(*state)
        return None if drawn is None else drawing.Arrow(drawn.head, drawn.tail)

    monkeypatch.setattr(drawing, "force_arrow", reversed)


def forces_as_long_as_each_other(monkeypatch):
    monkeypatch.setattr(drawing, "_LEAST_ARROW", drawing._LONGEST_ARROW)


def upright_drive(monkeypatch):
    pose = drawing.drive_pose
    monkeypatch.setattr(drawing, "drive_pose", lambda *state: pose(*state)._replace(angle=0.0))


def no_events(monkeypatch):
    monkeypatch.setattr(signals, "mark_events", lambda *_: [])
    monkeypatch.setattr(inverse, "mark_events", lambda *_: [])


def tip_is_tangential(monkeypatch):
    bar = phase_strips._bar
    monkeypatch.setattr(phase_strips, "_bar", lambda kind, colour: bar(jw.Phase.tangential if kind else kind, colour))


def no_markers(monkeypatch):
    monkeypatch.setattr(phase_strips, "_IN_STRIPS", tuple(jw.EventKind))


MISTAKES = [
    (other_colours, "scene"),
    (other_colours, "shapes"),
    (other_colours, "reactions"),
    (other_colours, "phases"),
    (other_colours, "contour"),
    (other_colours, "information"),
    (no_springs, "scene"),
    (no_springs, "shapes_several"),
    (no_springs, "scene_turning"),
    (slack_springs, "shapes"),
    (forces_on_the_object, "shapes"),
    (forces_on_the_object, "shapes_turning"),
    (forces_as_long_as_each_other, "shapes_several"),
    (upright_drive, "shapes_turning"),
    (no_events, "reactions"),
    (no_events, "information"),
    (tip_is_tangential, "phases"),
    (no_markers, "phases"),
]


@pytest.mark.unchecked
@pytest.mark.parametrize(("mistake", "name"), MISTAKES, ids=lambda value: getattr(value, "__name__", value))
def test_a_wrong_figure_is_detected(mistake, name, result, turned, tmp_path, monkeypatch):
    mistake(monkeypatch)
    assert difference(drawn(name, result, turned), name, tmp_path) is not None
