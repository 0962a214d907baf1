"""Draw the figures of docs/objects.md: python figures/objects.py

Writes docs/objects_edges.png and docs/objects_several.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot
from matplotlib.ticker import MultipleLocator

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
OBJECTS = {
    "Box(0.3, width=0.8, height=0.5)": jw.Box(0.3, width=0.8, height=0.5),
    "Polygon of 5 corners": jw.Polygon([(-0.45, 0.7), (-0.3, 0.35), (0.1, 0.2), (0.4, 0.35), (0.45, 0.75)]),
    "Cut(Parabola(0.2), -0.4, 0.3)": jw.Cut(jw.Parabola(0.2), left=-0.4, right=0.3),
}
SHOWN = {jw.EventKind.edge: ("|", "contact passes the end of an edge"), jw.EventKind.snap_off: ("X", "snap-off")}


SEVERAL = jw.Circle(0.3, 0.25), jw.Box(0.4, 0.5, 0.3, position=-1.05), jw.Parabola(0.2, 4.0, position=-2.8)
STATES = -0.1, -0.6, -1.04, -1.09, -1.5, -2.6, -3.3  # drive positions


def draw() -> None:
    """Draw all figures."""
    edges()
    several()


def several() -> None:
    """Three objects, one after the other: states of a whisker, and the moment at its base, which two whiskers share."""
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(9, 6.2), height_ratios=(1.2, 1), layout="constrained")
    result = jw.scan(jw.Scene(jw.Whisker(), SEVERAL, jw.Support.fb(70.0)))
    jw.plot.shapes(result, STATES, ax=above)
    above.set_xlim(-4.0, 0.6)
    if above.get_legend() is not None:
        above.get_legend().remove()
    control, mz = np.asarray(result.control), np.asarray(result.mz)[:, 0]
    for number in range(len(SEVERAL) + 1):
        on = np.asarray(result.contact_object)[:, 0] == number
        label = f"contact_object = {number}" + " (free)" * (number == 0)
        color = "0.6" if number == 0 else COLOURS[number - 1]
        below.plot(control, np.where(on, mz, np.nan), color=color, linewidth=1.5, label=label)
    for kind, marker in ((jw.EventKind.snap_off, "X"), (jw.EventKind.snap_through, "P")):
        events = result.events.of(kind)
        x, y = [e.control for e in events], [e.before.mz[0] for e in events]
        below.plot(x, y, color="black", marker=marker, linestyle="none", label=kind.name.replace("_", "-"))
    below.set_xlim(above.get_xlim())
    below.set(xlabel="drive position $u / L$", ylabel="$m_z L / EI$")
    below.legend(fontsize=8)
    figure.savefig(DOCS / "objects_several.png", dpi=110)


def edges() -> None:
    """Each object with some states of a whisker on a spring, and the moment at its base below."""
    figure, axs = pyplot.subplots(2, 3, figsize=(11, 6.4), height_ratios=(1.3, 1), layout="constrained")
    for (name, profile), above, below in zip(OBJECTS.items(), *axs, strict=True):
        result = jw.scan(jw.Scene(jw.Whisker(), profile, jw.Support.fb(70.0, 0.2)))
        touching = np.flatnonzero(np.asarray(result.contact_force)[:, 0] > 0)
        at = np.asarray(result.control)[touching[np.linspace(5, touching.size - 2, 6).astype(int)]]
        jw.plot.shapes(result, at, ax=above)
        above.set_title(name, fontsize=10)
        if above.get_legend() is not None:
            above.get_legend().remove()
        control, mz = np.asarray(result.control), np.asarray(result.mz)[:, 0]
        below.plot(control, mz, color=COLOURS[0], linewidth=1.3)
        for kind, (marker, label) in SHOWN.items():
            events = result.events.of(kind)
            x, y = [e.control for e in events], [e.before.mz[0] for e in events]
            below.plot(x, y, color="black", marker=marker, markersize=8, linestyle="none", label=label)
        below.axhline(0, color="0.6", linewidth=0.6, zorder=0)
        below.invert_xaxis()
        below.xaxis.set_major_locator(MultipleLocator(0.5))
        below.set_xlabel("drive position $u / L$")
    axs[1, 0].set_ylabel("$m_z L / EI$")
    axs[1, 0].legend(fontsize=8, loc="lower center")
    figure.savefig(DOCS / "objects_edges.png", dpi=110)


if __name__ == "__main__":
    draw()
