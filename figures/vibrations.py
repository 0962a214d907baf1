"""Draw the figure of docs/vibrations.md: python figures/vibrations.py

Writes docs/vibrations_map.png: the first frequency over stiffness and drive position.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw

DOCS = Path(__file__).parents[1] / "docs"
CONTROL = np.linspace(0.95, -1.65, 131)
STIFFNESS = np.geomspace(20.0, 500.0, 33)
TICKS = 20, 50, 100, 200, 500


def build(stiffness):
    """A whisker on a spring along x."""
    return jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2), jw.Support.fb(stiffness))


def main() -> None:
    """Draw the figure."""

    def frequencies(result):
        return {"omega": jw.modes(result, 2, points=2).omega}

    data = jw.study(build, stiffness=STIFFNESS, control=CONTROL, outputs="events", channels=frequencies)
    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    for axis, name, word in zip(axes, ("omega_1", "omega_2"), ("first", "second"), strict=True):
        mesh = axis.pcolormesh(CONTROL, STIFFNESS, data[name], shading="nearest", vmin=0.0, rasterized=True)
        figure.colorbar(mesh, ax=axis, label=f"{word} $\\omega$")
        for kind, style in ((jw.EventKind.snap_through, "-"), (jw.EventKind.snap_off, "--")):
            where = data.event_control.where(data.event_kind == kind).min("event")
            axis.plot(where, STIFFNESS, style, color="white", label=kind.name.replace("_", "-"))
        axis.set(yscale="log", xlabel="drive position $u / L$")
        axis.invert_xaxis()
    axes[0].set_yticks(TICKS, map(str, TICKS), minor=False)
    axes[0].minorticks_off()
    axes[0].set_ylabel("stiffness $c L^3 / EI$")
    axes[0].legend(facecolor="0.4", labelcolor="white", fontsize=8, loc="upper left")
    figure.savefig(DOCS / "vibrations_map.png", dpi=110)


if __name__ == "__main__":
    main()
