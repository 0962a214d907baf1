"""How the figures of the catalogue are drawn, and the data behind them written."""

import re
from functools import singledispatch
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Canvas

from jaxwhisker import plot
from jaxwhisker.shape import shapes
from jaxwhisker.report import write_columns
from jaxwhisker.reproduce.catalogue import Deflections, Figure, Moment, Signals, States
from jaxwhisker.reproduce.scans import Case, Scans, event
from jaxwhisker.reproduce.tables import TABLES, bend

DPI = 110
POINTS = 60  # per whisker in the data of a state
DETAIL = 0.06  # of the drive, shown on both sides of an event


def draw(figure: Figure, scans: Scans, folder: Path) -> tuple[Path, Path]:
    """Write a figure as PNG and its data as CSV; return both paths."""
    picture, data = folder / f"{figure.file}.png", folder / f"{figure.file}.csv"
    canvas, columns = _draw(figure.shows, scans)
    canvas.suptitle(f"Figure {figure.number}: {figure.title}", fontsize=10, y=0.985, wrap=True)
    canvas.savefig(picture, dpi=DPI)
    write_columns(columns, data, f"figure {figure.number}: {plain(figure.title)}; units L = EI = 1")
    return picture, data


def plain(text: str) -> str:
    """A label without its mathematics."""
    for symbol, word in ((r"$\infty$", "inf"), (r"$\lambda$", "lambda"), ("λ", "lambda"), ("$", "")):
        text = text.replace(symbol, word)
    return re.sub(r"\s*=\s*", "=", text)


@singledispatch
def _draw(shows, scans: Scans) -> tuple[Canvas, dict[str, np.ndarray]]:
    raise TypeError(f"cannot draw {shows!r}")


@_draw.register
def _(shows: Deflections, scans: Scans):
    bent = bend(TABLES[shows.table])
    canvas = Canvas(figsize=(7, 5))
    ax = plot.deflection(bent, ax=canvas.add_axes((0.1, 0.11, 0.86, 0.8)))
    table = TABLES[shows.table]
    loads = list(table.loads)
    for load, colour, deflection in zip(loads, plot.COLOURS, bent.values()):
        _force_arrow(ax, deflection, load.position, table.follower, 0.06 + 0.022 * load.force, colour)
    ax.plot([0, 0], [0, 1], color="0.5", linewidth=1, linestyle="--", zorder=1, label="unloaded")
    ax.set_xlim(right=max(ax.get_xlim()[1], 0.4))
    ax.legend(fontsize=9, loc="best")
    columns = {}
    for name, deflection in bent.items():
        for quantity in ("s", "x", "y", "angle", "curvature"):
            columns[f"{quantity} ({plain(name)})"] = np.asarray(getattr(deflection, quantity))
    return canvas, columns


def _force_arrow(ax, deflection, position: float, follower: bool, size: float, colour: str) -> None:
    s, x, y, angle = (np.asarray(getattr(deflection, name)) for name in ("s", "x", "y", "angle"))
    at = np.array([np.interp(position, s, x), np.interp(position, s, y)])
    # At rest the force points towards -x, 90 degrees ahead of the whisker; a follower force keeps to the whisker.
    direction = np.interp(position, s, angle) + np.pi / 2 if follower else np.pi
    tip = at + size * np.array([np.cos(direction), np.sin(direction)])
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=tuple(tip), xytext=tuple(at), arrowprops=arrow, zorder=5)
    ax.update_datalim([tuple(at), tuple(tip)])
    ax.autoscale_view()


def _midway(result, moments: tuple[Moment, Moment]) -> float:
    controls = []
    for kind, whisker in moments:
        found = event(result, kind, whisker)
        if found is None:
            raise RuntimeError(f"the scan of {result.scene} has no {kind} of whisker {whisker}")
        controls.append(found.control)
    return sum(controls) / 2


@_draw.register
def _(shows: States, scans: Scans):
    result = scans(shows.case)
    ats = [_midway(result, moments) for moments in shows.between]
    canvas = Canvas(figsize=(9, 7))
    axes = canvas.subplots(2, 2, sharex=True, sharey=True)
    canvas.subplots_adjust(left=0.08, right=0.98, bottom=0.08, top=0.89, wspace=0.06, hspace=0.16)
    for ax, at, letter in zip(axes.flat, ats, "abcd"):
        plot.state(result, at, whole=not shows.case.semicircle, ax=ax)
        ax.set_title(f"{letter}) $u/L$ = {at:.3f}; {_in_words(result, at)}", fontsize=9)
        ax.label_outer()
    plot.frame_states(list(axes.flat), [result] * 4, ats)
    axes[0, 0].legend(fontsize=8, loc="lower left")
    lines = shapes(result, at=ats, points=POINTS)
    columns = {}
    for k, at in enumerate(ats):
        for whisker in range(np.asarray(lines.x).shape[1]):
            for axis in ("x", "y"):
                columns[f"{axis}_{whisker + 1} (u={at:.6f})"] = np.asarray(getattr(lines, axis))[k, whisker]
    return canvas, columns


def _in_words(result, at: float) -> str:
    words = plot.phases(result, at)
    return words.removeprefix("1: ") + " contact" if "," not in words else "whisker " + words


@_draw.register
def _(shows: Signals, scans: Scans):
    results = {name: scans(case) for name, case in shows.cases.items()}
    everything = list(results.values())
    low, high = plot.contact_range(everything)
    if shows.around is not None:
        at = [e.control for e in (event(r, *shows.around) for r in everything) if e is not None]
        low, high = min(at) - DETAIL, max(at) + DETAIL
    lone = next(iter(results.values()))
    rows, indices = len(shows.quantities), shows.indices
    columns = 1 if shows.overlay else len(indices)
    panels = rows * columns
    canvas = Canvas(figsize=(7 if columns == 1 else min(5 * columns, 12), 5 if rows == 1 else 6.5))
    axes = canvas.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
    canvas.subplots_adjust(
        left=0.1 if columns == 1 else 0.07, right=0.98, bottom=0.08, top=0.9, wspace=0.06, hspace=0.08
    )
    for row, quantity in enumerate(shows.quantities):
        for column in range(columns):
            ax = axes[row, column]
            if shows.overlay:
                plot.signal(lone, quantity, ax=ax)
            else:
                plot.compare(results, quantity, index=indices[column], ax=ax, colours=_colours(shows.cases))
                if row == 0 and panels > 1 and columns > 1:
                    ax.set_title(
                        f"{'spring' if quantity == 'spring_length' else 'whisker'} {indices[column]}", fontsize=9
                    )
            ax.set_xlim(low, high)
            ax.label_outer()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(handles) > 1:
        canvas.legend(handles, labels, fontsize=9, loc="upper center", ncols=len(handles), bbox_to_anchor=(0.5, 0.96), frameon=False)
    if shows.around is not None:
        _fit_height(axes[0, 0], low, high)
    return canvas, _signal_columns(shows, results, low, high)


def _colours(cases: dict[str, Case]) -> tuple[str, ...]:
    # The clamped whisker is black wherever it stands beside others.
    return tuple(
        plot.COLOURS[-1] if np.isinf(case.stiffness) and len(cases) > 1 else plot.COLOURS[k]
        for k, case in enumerate(cases.values())
    )


def _fit_height(ax, low: float, high: float) -> None:
    shown = []
    for line in ax.get_lines():
        x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        shown.append(y[(x >= low) & (x <= high)])
    values = np.concatenate(shown)
    room = 0.06 * (np.nanmax(values) - np.nanmin(values))
    ax.set_ylim(np.nanmin(values) - room, np.nanmax(values) + room)


def _signal_columns(shows: Signals, results, low: float, high: float) -> dict[str, np.ndarray]:
    control = np.asarray(next(iter(results.values())).control)
    inside = (control >= low) & (control <= high)
    columns = {"control": control[inside]}
    for name, result in results.items():
        for index in shows.indices:
            for quantity in shows.quantities:
                short = "spring" if quantity == "spring_length" else quantity
                values = np.asarray(getattr(result, quantity))[inside, index - 1]
                columns[f"{short}_{index}" + f" ({plain(name)})" * (len(results) > 1)] = values
    return columns


def table_picture(title: str, rows: list[list[str]], path: Path) -> None:
    """Write a table as PNG."""
    canvas = Canvas(figsize=(7.5, 0.8 + 0.27 * len(rows)))
    ax = canvas.add_axes((0.02, 0.02, 0.96, 0.88 - 0.2 / len(rows)))
    ax.set_axis_off()
    drawn = ax.table(cellText=rows[1:], colLabels=rows[0], loc="center", cellLoc="right", bbox=(0, 0, 1, 1))
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(9)
    for (row, _), cell in drawn.get_celld().items():
        cell.set_linewidth(0.4)
        if row == 0:
            cell.set_facecolor("#E6E6E6")
    canvas.suptitle(title, fontsize=10)
    canvas.savefig(path, dpi=DPI)
