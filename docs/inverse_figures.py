"""Figures of inverse.md, from the example's data: `python docs/inverse_figures.py`."""

import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from matplotlib import pyplot

import jaxwhisker as jw

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "examples"))

from make_measured import CONTROL, NOISE, STIFFNESS

DATA = HERE.parent / "examples" / "measured.csv"


def build(c1, c2, c3, q):
    """What the example's data come from."""
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fbfbr((c1, c2, c3)))


def draw_information() -> None:
    """Where along the scan the signals know about each parameter."""
    told = jw.information(build, dict(zip(("c1", "c2", "c3", "q"), (*STIFFNESS, 0.3), strict=True)), sigma=NOISE)
    _, ax = pyplot.subplots(figsize=(5, 2.8), layout="constrained")
    jw.plot.information(told, ax=ax).set_xlabel("$u/L$")
    ax.figure.savefig(HERE / "information.png", dpi=130)


def draw_contour() -> None:
    """Points one by one, and the contour of all signals at once."""
    sensor = jw.Sensor(jw.Whisker(), jw.Support.fbfbr(STIFFNESS))
    points = jw.reconstruct(DATA, sensor, sigma=NOISE)
    fit = jw.fit_contour(DATA, sensor, sigma=NOISE)
    print(fit)
    _, axs = pyplot.subplots(1, 2, figsize=(7.2, 3.4), sharex=True, sharey=True, layout="constrained")
    jw.plot.contour(points, profile=jw.Parabola(0.3), ax=axs[0])
    jw.plot.contour(fit, profile=jw.Parabola(0.3), ax=axs[1])
    axs[0].set(xlabel="$x/L$", ylabel="$y/L$", title="points, one by one")
    axs[1].set(xlabel="$x/L$", ylabel="", title="any convex contour, all at once")
    for ax in axs:
        ax.title.set_fontsize(9)
        ax.legend(frameon=False, fontsize=8)
    axs[0].figure.savefig(HERE / "contour.png", dpi=130)


if __name__ == "__main__":
    print(f"{CONTROL.size} steps")
    draw_information()
    draw_contour()
