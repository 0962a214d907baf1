"""Pictures look as they did, and mistakes in them are noticed."""

import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.testing.compare import compare_images
from matplotlib.ticker import NullFormatter

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker._inverse.information import EventInformation
from jaxwhisker._inverse.measured import Measured
from jaxwhisker.plot import axes, drawing, inverse, signals, strips
from pictured import ANGLES, CONTROL, MIDDLE, coupled, failed, of_steps, steepness, summarised, there_and_back, turning

BASELINE = Path(__file__).parent / "baseline"
WRITE = os.environ.get("JAXWHISKER_BASELINE") == "write"  # after a change on purpose; look at what was written
TOLERANCE = 1.0  # rms of grey levels up to 255: matplotlib 3.9 to 3.11 agree exactly, the slightest mistake is off by 3
SIZE, DPI = (3.35, 2.4), 80  # inches: a column of a journal
SEVERAL = (0.4, -0.2, -0.8)


@pytest.fixture(scope="module")
def result():
    return jw.scan(coupled(), CONTROL)


@pytest.fixture(scope="module")
def turned():
    return jw.scan(turning(), ANGLES)


def told():
    """What signals might tell of a stiffness and a distance."""
    control = np.linspace(0.7, -1.4, 64)
    rates = np.stack([np.exp(-((control + 0.5) ** 2)), np.exp(-8 * (control + 1.0) ** 2)], axis=1)[:, None, :]
    event = EventInformation(jw.EventKind.vertex, (1,), -0.5, np.zeros(2), np.inf)
    return jw.Information(("c", "q"), {"c": 70.0, "q": 0.2}, control, ("mz",), rates, (event,), np.array([True, True]))


def fitted(result):
    """A fit that misses what was measured a little."""
    values = np.stack([np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")], axis=-1)
    measured = Measured(np.asarray(result.control), values + 0.3 * np.sin(40 * values), np.ones(values.shape))
    known = {"status": jw.FitStatus.ok, "measured": measured, "signals": values, "scene": result.scene}
    return jw.Fit(**dict.fromkeys(jw.Fit.__dataclass_fields__) | known)  # pyright: ignore[reportArgumentType]


def found():
    """Points of a parabola, the last one lost in noise."""
    x = jnp.linspace(-0.8, 0.8, 33)[:, None]
    one, covariance = jnp.ones_like(x), jnp.zeros((*x.shape, 4, 4)).at[..., [0, 1], [0, 1]].set(4e-4)
    point = {"x": x, "y": 0.2 + x**2, "slope": jnp.arctan(2 * x), "phase": jnp.ones(x.shape, int)}
    state = {"status": jnp.zeros(x.shape, int), "significance": 100 * one.at[-1].set(0.01), "covariance": covariance}
    fields = dict.fromkeys(jw.Reconstruction.__dataclass_fields__, one) | point | state | {"control": x[:, 0]}
    return jw.Reconstruction(**fields)


def drawn(name, result, turned):
    """One of the pictures, small, without text: what is compared does not depend on fonts."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    rows = {"reactions": 3, "fit": 3}.get(name, 1)
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.03, top=0.97)
    axs = figure.subplots(rows, 1, squeeze=False)[:, 0]
    ax = axs[0]
    {
        "scene": lambda: plot.scene(result.scene, ax=ax),
        "scene_turning": lambda: plot.scene(turned.scene, ax=ax),
        "shapes": lambda: plot.shapes(result, MIDDLE, ax=ax),
        "shapes_several": lambda: plot.shapes(result, SEVERAL, ax=ax),
        "shapes_turning": lambda: plot.shapes(turned, ax=ax),
        "reactions": lambda: plot.reactions(result, axs=axs),
        "spring_lengths": lambda: plot.spring_lengths(result, ax=ax),
        "phases": lambda: plot.phases(result, ax=ax),
        "phases_and_back": lambda: plot.phases(failed(there_and_back(result), slice(60, 90)), ax=ax),
        "compare": lambda: plot.compare({"a": result, "b": of_steps(result, slice(0, 150))}, "mz", index=2, ax=ax),
        "study_line": lambda: plot.study(
            summarised().isel(distance=1), critical=steepness(summarised()).isel(distance=1, drop=True), axs=[ax]
        ),
        "study_map": lambda: plot.study(summarised().isel(whisker=[0]), critical=steepness(summarised()), axs=[ax]),
        "information": lambda: plot.information(told(), ax=ax),
        "fit": lambda: plot.fit(fitted(result), axs=axs),
        "contour": lambda: plot.contour(found(), profile=jw.Parabola(0.2), ax=ax),
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


PICTURES = """
scene scene_turning shapes shapes_several shapes_turning reactions spring_lengths phases phases_and_back compare
study_line study_map information fit contour deflection
""".split()  # noqa: SIM905


def difference(figure, name, folder):
    """What differs from the picture that is stored; None if nothing does."""
    actual = folder / f"{name}.png"
    figure.savefig(actual)
    return compare_images(str(BASELINE / f"{name}.png"), str(actual), TOLERANCE)


@pytest.mark.unchecked  # a fit made up has no fields but those that are drawn
@pytest.mark.parametrize("name", PICTURES)
def test_picture_looks_as_it_did(name, result, turned, tmp_path):
    figure = drawn(name, result, turned)
    if WRITE:
        BASELINE.mkdir(exist_ok=True)
        figure.savefig(BASELINE / f"{name}.png")
    words = difference(figure, name, tmp_path)
    assert words is None, words


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
    monkeypatch.setattr(signals, "mark_events", lambda *_: None)
    monkeypatch.setattr(inverse, "mark_events", lambda *_: None)


def tip_is_tangential(monkeypatch):
    bar = strips._bar
    monkeypatch.setattr(strips, "_bar", lambda kind, colour: bar(jw.Phase.tangential if kind else kind, colour))


def no_markers(monkeypatch):
    monkeypatch.setattr(strips, "_MARKERS", {})


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
def test_a_wrong_picture_is_noticed(mistake, name, result, turned, tmp_path, monkeypatch):
    mistake(monkeypatch)
    assert difference(drawn(name, result, turned), name, tmp_path) is not None
