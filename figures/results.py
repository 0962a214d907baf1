"""Draw the figures of stored benchmark results: python figures/results.py

Writes docs/work_precision.png, space_precision.png, several_precision.png, motion_precision.png, numbers.png,
supports.png, whiskers.png and known.png.
"""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullLocator

from jaxwhisker.plot import COLOURS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.append(str(ROOT / "benchmarks"))

from common import read

MM = 1 / 25.4

# Run time and accuracy

METHODS = {  # colours of Okabe and Ito
    "jaxwhisker, integrated": ("#0072B2", "o"),
    "jaxwhisker, closed form": ("#D55E00", "D"),
    "diffrax and optimistix": ("#009E73", "s"),
    "scipy: fsolve, solve_ivp (thesis)": ("#000000", "^"),
    "scipy: solve_bvp": ("#999999", "v"),
    "MuJoCo: hinge chain": ("#CC79A7", "P"),
    "PyElastica": ("#E69F00", "X"),
}
WITHOUT_PARABOLA = ("MuJoCo: hinge chain", "PyElastica")  # these simulate a circle
IN_FAMILIES = ("jaxwhisker, integrated", "diffrax and optimistix")  # one line per solver


def draw_methods(ax, batch: int | None) -> None:
    """Draw error against time of every method at one batch size, or at its largest one."""
    rows = read("work_precision")["rows"]
    for method, (colour, marker) in METHODS.items():
        shape = "circle" if method in WITHOUT_PARABOLA else "parabola"
        own = [row for row in rows if row["method"] == method and row["object"] == shape]
        sizes = {row["batch"] for row in own}
        size = batch if batch in sizes else max(sizes)
        families: dict[str, list] = {}
        for row in own:
            if row["batch"] == size:
                words = row["setting"].split(", ")
                solver = words[0] if method in IN_FAMILIES else method
                families.setdefault(solver + (", adaptive" if "adaptive" in words else ""), []).append(row)
        for number, family in enumerate(families.values()):
            family.sort(key=lambda row: row["us per equilibrium"])
            x, y = [row["us per equilibrium"] for row in family], [row["error"] for row in family]
            label = None if number else method
            ax.loglog(x, y, color=colour, marker=marker, ms=4, lw=1, ls="-" if number == 0 else ":", label=label)
    ax.set_xlabel("time per equilibrium (µs)")
    ax.set_ylabel("error, relative to the peak")
    ax.grid(alpha=0.3, lw=0.5)


def draw_work_precision() -> None:
    """Error against time, one panel per batch size."""
    batches = sorted({row["batch"] for row in read("work_precision")["rows"]})
    down = -(-len(batches) // 2)
    size = (9, 1 + 3.4 * down)
    fig, axs = plt.subplots(down, 2, figsize=size, sharex=True, sharey=True, squeeze=False, layout="constrained")
    for ax, batch in zip(axs.flat, batches, strict=False):
        draw_methods(ax, batch)
        ax.set_title("one scan" if batch == 1 else f"batch of {batch}", fontsize=10)
        ax.label_outer()
    handles, labels = axs[0, 0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    fig.savefig(DOCS / "work_precision.png", dpi=130)


SPATIAL = {
    "jaxwhisker": METHODS["jaxwhisker, integrated"],
    "jaxwhisker, closed form": METHODS["jaxwhisker, closed form"],
    "scipy: fsolve, solve_ivp": METHODS["scipy: fsolve, solve_ivp (thesis)"],
    "MuJoCo: chain of balls": METHODS["MuJoCo: hinge chain"],
    "PyElastica": METHODS["PyElastica"],
}


def draw_space_precision() -> None:
    """Error against time of scans in space: a panel for each whisker, and a line for each batch size."""
    rows = read("space_precision")["rows"]
    for row in rows:
        row["method"] += ", closed form" if row["setting"] == "elliptic functions" else ""
    whiskers = list(dict.fromkeys(row["whisker"] for row in rows))
    fig, axs = plt.subplots(1, len(whiskers), figsize=(9, 4.2), sharex=True, sharey=True, layout="constrained")
    for ax, whisker in zip(axs, whiskers, strict=True):
        for method, (colour, marker) in SPATIAL.items():
            own = [row for row in rows if row["whisker"] == whisker and row["method"] == method]
            batches = sorted({row["batch"] for row in own})
            for batch, style in zip(batches, ("-", "--", ":"), strict=False):
                line = [row for row in own if row["batch"] == batch]
                line.sort(key=lambda row: row["us per equilibrium"])
                x, y = [row["us per equilibrium"] for row in line], [row["error"] for row in line]
                size = f", batch of {batch}" if batch > 1 else ", one scan"
                label = method + size * (len(batches) > 1)
                ax.loglog(x, y, color=colour, marker=marker, ms=4, lw=1, ls=style, label=label)
        ax.set_title(f"{whisker} whisker past a sphere", fontsize=10)
        ax.set_xlabel("time per equilibrium (µs)")
        ax.grid(alpha=0.3, lw=0.5)
    axs[0].set_ylabel("error, relative to the peak")
    fig.legend(*axs[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    fig.savefig(DOCS / "space_precision.png", dpi=130)


MOVING = {
    "jaxwhisker": METHODS["jaxwhisker, integrated"],
    "MuJoCo": METHODS["MuJoCo: hinge chain"],
    "PyElastica": METHODS["PyElastica"],
    "diffrax, Kvaerno5": METHODS["diffrax and optimistix"],
    "diffrax, Dopri8": ("#56B4E9", "D"),
}


def draw_motion() -> None:
    """Error against time of simulators of motion, one panel per case."""
    rows = read("motion")["rows"]
    cases = list(dict.fromkeys(row["case"] for row in rows))
    fig, axs = plt.subplots(1, len(cases), figsize=(11, 3.8), layout="constrained")
    for ax, case in zip(axs, cases, strict=True):
        for method, (colour, marker) in MOVING.items():
            own = [row for row in rows if row["case"] == case and row["method"] == method]
            own.sort(key=lambda row: row["time, s"])
            x, y = [row["time, s"] for row in own], [row["error"] for row in own]
            ax.loglog(x, y, color=colour, marker=marker, ms=4, lw=1, label=method)
        ax.set_title(case, fontsize=10)
        ax.set_xlabel("run time (s)")
        ax.grid(alpha=0.3, lw=0.5)
    axs[0].set_ylabel("largest error of the tip (L)")
    axs[1].set_ylabel("rms error of mz, relative to the peak")
    fig.legend(*axs[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    fig.savefig(DOCS / "motion_precision.png", dpi=130)


TOUCHING_TWICE = {
    "jaxwhisker": METHODS["jaxwhisker, integrated"],
    "jaxwhisker, motion": ("#56B4E9", "D"),
    "discrete rod": METHODS["scipy: fsolve, solve_ivp (thesis)"],
    "discrete rod, contact at hinges": METHODS["scipy: solve_bvp"],
    "MuJoCo": METHODS["MuJoCo: hinge chain"],
    "Exudyn": METHODS["diffrax and optimistix"],
    "PyElastica": METHODS["PyElastica"],
}


def draw_several_precision() -> None:
    """Error against time past two circles: mz and fx, a line for each number of positions and lanes."""
    rows = read("several_precision")["rows"]
    fig, axs = plt.subplots(1, 2, figsize=(10, 4.6), sharex=True, sharey=True, layout="constrained")
    for ax, signal in zip(axs, ("mz", "fx"), strict=True):
        for method, (colour, marker) in TOUCHING_TWICE.items():
            own = [row for row in rows if row["method"] == method]
            lines = list(dict.fromkeys((row["batch"], row["positions"]) for row in own))
            for (batch, positions), style in zip(lines, ("-", "--", ":"), strict=False):
                line = [row for row in own if (row["batch"], row["positions"]) == (batch, positions)]
                x, y = [row["ms per equilibrium"] for row in line], [row[signal] for row in line]
                size = f", {positions} positions" + f", batch of {batch}" * (batch > 1)
                label = method + size * (len(lines) > 1)
                ax.loglog(x, y, color=colour, marker=marker, ms=4, lw=1, ls=style, label=label)
        ax.set_title(f"largest error of {signal}", fontsize=10)
        ax.set_xlabel("time per equilibrium (ms)")
        ax.grid(alpha=0.3, lw=0.5)
    axs[0].set_ylabel("error, relative to the peak")
    fig.legend(*axs[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    fig.savefig(DOCS / "several_precision.png", dpi=130)


def draw_numbers() -> None:
    """The README's figure: error against time, extreme cases, cost of each part of a scene."""
    fig, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4.5), layout="constrained")
    draw_methods(left, None)
    most = max(row["batch"] for row in read("work_precision")["rows"])
    left.set_title(f"error against time (jaxwhisker and diffrax: batch of {most})", fontsize=9)
    fig.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=7.5, frameon=False)

    rows = read("extremes")["rows"]
    groups = list(dict.fromkeys(row["case"] for row in rows))
    for kind, colour, marker in (("integrated", "#0072B2", "o"), ("closed form", "#D55E00", "D")):
        own = [row for row in rows if row["rods"] == kind]
        y = [groups.index(row["case"]) for row in own]
        middle.semilogx([max(row["error"], 1e-16) for row in own], y, marker, color=colour, ms=3.5, label=kind)
    middle.set_yticks(range(len(groups)), groups, fontsize=7)
    middle.invert_yaxis()
    middle.set_xlim(1e-16, 1e-5)
    middle.set_xlabel("largest residual of any equation")
    middle.set_title("extreme cases", fontsize=9)
    middle.grid(alpha=0.3, lw=0.5)
    middle.legend(fontsize=7, frameon=False)

    rungs = [row for row in read("ladder")["rows"] if row["us per step"] is not None]
    right.barh([row["scene"] for row in rungs], [row["us per step"] for row in rungs], color="#0072B2")
    right.invert_yaxis()
    right.tick_params(axis="y", labelsize=7)
    right.set_xlabel("µs per step, batch of 32")
    right.set_title("cost of each part of a scene", fontsize=9)
    fig.savefig(DOCS / "numbers.png", dpi=110)


# Supports and whiskers


def draw_supports() -> None:
    """Signals for springs of different stiffness along each axis."""
    rows = [row for row in read("settings")["rows"] if row["rest"] == 0]
    fig, axs = plt.subplots(2, 4, figsize=(13, 5.6), layout="constrained", sharey="row")
    shades = ["#56B4E9", "#0072B2", "#009E73", "#000000"]
    panels = ("springs across (thesis)", "springs along", "torsion springs", "rotation, torsion")
    for column, setting in enumerate(panels):
        own = [row for row in rows if row["setting"] == setting]
        for colour, row in zip(shades, own, strict=True):
            u, _, fy, mz = (np.array(values) for values in row["curve"])
            label = "rigid" if row["stiffness"] == "inf" else f"c = {row['stiffness']:g}"
            for ax, values in zip(axs[:, column], (mz, fy), strict=True):
                ax.plot(u, np.where(values == 0, np.nan, values), color=colour, lw=1.2, label=label)
        axs[0, column].set_title(setting, fontsize=9)
        axs[0, column].legend(fontsize=7, frameon=False)
        axs[1, column].set_xlabel("angle of the drive (rad)" if "rotation" in setting else r"$u/L$")
        if "rotation" not in setting:
            axs[0, column].invert_xaxis()
            axs[1, column].invert_xaxis()
    axs[0, 0].set_ylabel(r"$m_z\,L/EI$")
    axs[1, 0].set_ylabel(r"$f_y\,L^2/EI$")
    fig.savefig(DOCS / "supports.png", dpi=110)


def draw_whiskers() -> None:
    """Signals of clamped whiskers with taper and curvature."""
    rows = [row for row in read("settings")["rows"] if row["rest"] == 0 and row["stiffness"] == "inf"]
    shown = {
        "springs across (thesis)": ("uniform", "#000000"),
        "a cone 2:1, across": ("cone 2:1", "#D55E00"),
        "curved forwards by 0.5, across": ("curved forwards", "#0072B2"),
        "curved backwards by 0.5, across": ("curved backwards", "#009E73"),
    }
    fig, axs = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    for setting, (name, colour) in shown.items():
        row = next(row for row in rows if row["setting"] == setting)
        u, fx, fy, mz = (np.array(values) for values in row["curve"])
        for ax, values, label in zip(axs, (fx, fy, mz), (r"$f_x$", r"$f_y$", r"$m_z$"), strict=True):
            ax.plot(u, np.where(mz == 0, np.nan, values), color=colour, lw=1.2, label=name)
            ax.set_xlabel(r"$u/L$")
            ax.set_title(label, fontsize=9)
    for ax in axs:
        ax.invert_xaxis()
    axs[0].legend(fontsize=7, frameon=False)
    fig.savefig(DOCS / "whiskers.png", dpi=110)


# What has to be known

DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
MARKERS = ("o", "s", "^", "D")
PARAMETERS = {"EI": "$EI$, 1 %", "L": "$L$, 1 %", "angle": "angle of the mount, 1°"}


def parameter_label(parameter: str) -> str:
    """Symbol of a parameter and the size of its error."""
    symbol = {"c": "c", "l": r"\lambda"}.get(parameter[0], parameter)
    return PARAMETERS.get(parameter, f"${symbol}_{parameter[1:]}$, 1 %")


def draw_errors(ax, scene: str, initials: str) -> None:
    """Displacement of the contour for every wrong parameter with one of these initials."""
    rows = [row for row in read("known_errors")["rows"] if row["scene"] == scene and row["parameter"][0] in initials]
    for k, row in enumerate(rows):
        x, away = (np.array(values) for values in row["curve"])
        style = {"color": COLOURS[k], "linestyle": DASHES[k % len(DASHES)], "linewidth": 1.3}
        ax.plot(x, 1e3 * away, label=parameter_label(row["parameter"]), **style)
    ax.axhline(0, color="0.6", linewidth=0.6, zorder=0)
    ax.set(xlabel="$x/L$ of the contour", ylabel=r"displacement, outwards ($10^{-3}\,L$)")
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.4 * (high - low), high)  # room for the legend
    ax.legend(fontsize=7, frameon=False, loc="lower left", ncols=2)


def draw_stiffness_error(ax) -> None:
    """Standard error of the least certain stiffness over the stiffness."""
    rows = read("known_networks")["rows"]
    for k, scene in enumerate(dict.fromkeys(row["scene"] for row in rows)):
        own = [row for row in rows if row["scene"] == scene]
        c = [row["stiffness"] for row in own]
        for key, dash in (("worst stiffness", "-"), ("worst stiffness, any shape", ":")):
            style = {"color": COLOURS[k], "marker": MARKERS[k], "markersize": 4, "linestyle": dash, "linewidth": 1.2}
            ax.loglog(c, [100 * row[key] for row in own], label=scene if dash == "-" else None, **style)
    ticks = sorted({row["stiffness"] for row in rows})
    ax.set_xticks(ticks, [f"{c:g}" for c in ticks])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set(xlabel=r"stiffness $c$ of all springs ($EI/L^3$)", ylabel="largest standard error of a stiffness (%)")
    ax.legend(fontsize=7, frameon=False)


def draw_object_error(ax, stiffness: float = 70.0) -> None:
    """Standard errors of the object for each scene."""
    rows = [row for row in read("known_networks")["rows"] if row["stiffness"] == stiffness]
    shown = {"a": (100, "$a$ (%)"), "q": (100, "$q$ (%)"), "contour": (1e3, "contour of any shape ($10^{-3}\\,L$)")}
    for k, (key, (unit, words)) in enumerate(shown.items()):
        style = {"color": COLOURS[k], "marker": MARKERS[k], "markersize": 5, "linestyle": ":", "linewidth": 0.8}
        ax.plot(range(len(rows)), [unit * row[key] for row in rows], label=words, **style)
    ax.set_xticks(range(len(rows)), [row["scene"].replace(" ", "\n") for row in rows])
    ax.set(ylim=(0, None), ylabel="standard error (units in the legend)")
    ax.legend(fontsize=7, frameon=False)


def draw_known() -> None:
    """Contour errors caused by wrong parameters, and standard errors."""
    fig, axs = plt.subplots(2, 2, figsize=(180 * MM, 150 * MM), layout="constrained")
    draw_errors(axs[0, 0], "FB", "clELa")
    draw_errors(axs[0, 1], "three whiskers", "c")
    draw_stiffness_error(axs[1, 0])
    draw_object_error(axs[1, 1])
    titles = (
        "FB with one wrong parameter",
        "three whiskers, whisker 3",
        "stiffness, parabola (dotted: any shape)",
        "object, stiffness unknown, c = 70",
    )
    for ax, title, letter in zip(axs.flat, titles, "abcd", strict=True):
        ax.set_title(f"({letter}) {title}", fontsize=8.5, loc="left")
        ax.tick_params(labelsize=7.5)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.grid(alpha=0.3, linewidth=0.5)
    fig.savefig(DOCS / "known.png", dpi=150)


def main() -> None:
    """Draw all figures."""
    of_speed = draw_work_precision, draw_space_precision, draw_several_precision, draw_motion, draw_numbers
    for draw in (*of_speed, draw_supports, draw_whiskers, draw_known):
        draw()


if __name__ == "__main__":
    main()
