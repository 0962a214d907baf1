"""Draws docs/known.png from what benchmarks/known.py has stored: errors of the contour, and standard errors."""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from jaxwhisker.plot import COLOURS

HERE = Path(__file__).parent
RESULTS = HERE.parent / "benchmarks" / "results"
MM = 1 / 25.4
WIDTH, HEIGHT = 180 * MM, 150 * MM
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
MARKERS = ("o", "s", "^", "D")
LABELS = {"EI": "$EI$, 1 %", "L": "$L$, 1 %", "angle": "angle of the mount, 1°"}


def rows_of(name: str) -> list[dict]:
    return json.loads((RESULTS / f"{name}.json").read_text())["rows"]


def label(parameter: str) -> str:
    """A parameter and by how much it is wrong."""
    symbol = {"c": "c", "l": r"\lambda"}.get(parameter[0], parameter)
    return LABELS.get(parameter, f"${symbol}_{parameter[1:]}$, 1 %")


def draw_errors(ax, scene: str, parameters: str, whisker: int) -> None:
    """Where the contour ends up for a wrong parameter, along the contour."""
    own = [row for row in rows_of("known_errors") if row["scene"] == scene and row["parameter"][0] in parameters]
    for k, row in enumerate(own):
        x, away = (np.array(values) for values in row["curves"][whisker])
        style = {"color": COLOURS[k], "linestyle": DASHES[k % len(DASHES)], "linewidth": 1.3}
        ax.plot(x, 1e3 * away, label=label(row["parameter"]), **style)
    ax.axhline(0, color="0.6", linewidth=0.6, zorder=0)
    ax.set(xlabel="$x/L$ of the contour", ylabel=r"displacement, outwards ($10^{-3}\,L$)")
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.4 * (high - low), high)  # room for the legend
    ax.legend(fontsize=7, frameon=False, loc="lower left", ncols=2)


def draw_stiffness(ax) -> None:
    """Standard error of the worst known stiffness over the stiffness."""
    rows = rows_of("known_buys")
    for k, scene in enumerate(dict.fromkeys(row["scene"] for row in rows)):
        own = [row for row in rows if row["scene"] == scene]
        c = [row["stiffness"] for row in own]
        for key, dash in (("worst stiffness", "-"), ("worst stiffness, any shape", ":")):
            style = {"color": COLOURS[k], "marker": MARKERS[k], "markersize": 4, "linestyle": dash, "linewidth": 1.2}
            ax.loglog(c, [100 * row[key] for row in own], label=scene if dash == "-" else None, **style)
    ticks = sorted({row["stiffness"] for row in rows})
    ax.set_xticks(ticks, [f"{c:g}" for c in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set(xlabel=r"stiffness $c$ of all springs ($EI/L^3$)", ylabel="standard error of the worst stiffness (%)")
    ax.legend(fontsize=7, frameon=False)


def draw_object(ax, stiffness: float = 70.0) -> None:
    """Standard errors of the object by scene."""
    rows = [row for row in rows_of("known_buys") if row["stiffness"] == stiffness]
    shown = {"a": (100, "$a$ (%)"), "q": (100, "$q$ (%)"), "contour": (1e3, "contour of any shape ($10^{-3}\\,L$)")}
    for k, (key, (unit, words)) in enumerate(shown.items()):
        style = {"color": COLOURS[k], "marker": MARKERS[k], "markersize": 5, "linestyle": ":", "linewidth": 0.8}
        ax.plot(range(len(rows)), [unit * row[key] for row in rows], label=words, **style)
    ax.set_xticks(range(len(rows)), [row["scene"].replace(" ", "\n") for row in rows])
    ax.set(ylim=(0, None), ylabel="standard error (units in the legend)")
    ax.legend(fontsize=7, frameon=False)


def main() -> None:
    canvas = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    axs = canvas.subplots(2, 2)
    draw_errors(axs[0, 0], "FB", "clELa", 0)
    draw_errors(axs[0, 1], "three whiskers", "c", 2)
    draw_stiffness(axs[1, 0])
    draw_object(axs[1, 1])
    titles = (
        "contour error: FB, a parameter is wrong",
        "... and three whiskers, whisker 3",
        "stiffness, parabola (dotted: any shape)",
        "the object, stiffness sought, too, c = 70",
    )
    for ax, title, letter in zip(axs.flat, titles, "abcd", strict=True):
        ax.set_title(f"({letter}) {title}", fontsize=8.5, loc="left")
        ax.tick_params(labelsize=7.5)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.grid(alpha=0.3, linewidth=0.5)
    canvas.savefig(HERE / "known.png", dpi=150)


if __name__ == "__main__":
    main()
