"""Where should a spring sit on the shaft? Draw a figure of docs/shaft_springs.md and print its table.

python figures/shaft_design.py writes docs/shaft_design.png.
"""

from functools import partial
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
CONTROL = np.linspace(0.8, -1.1, 96)  # from before the first touch to just before the snap-off
HEIGHTS = np.linspace(0.0, 0.4, 9)
OBJECT = {"distance": 0.4, "a": 1.0}
SIGMA = 0.02  # of fx, fy and mz at every step
LABELS = {"distance": "distance $q/L$", "a": "steepness $aL$"}


def alone(height, distance, a) -> jw.Scene:
    """A whisker that slides along x, held by an axial spring at this height above its base."""
    spring = jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=height)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance, a), jw.Support((spring,)))


def beside(height, distance, a) -> jw.Scene:
    """The same with a spring at the base."""
    springs = jw.Spring((0, 1), 70.0, 0.2), jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=height)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance, a), jw.Support(springs))


SUPPORTS = {"the only spring": alone, "beside a base spring": beside}


def main() -> None:
    """Draw the figure and print the table."""
    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3.0), layout="constrained")
    columns = []
    for (name, build), colour in zip(SUPPORTS.items(), COLOURS, strict=False):
        found = jw.design(build, at=OBJECT, sigma=SIGMA, control=CONTROL, height=HEIGHTS)
        for axis, parameter in zip(axes, LABELS, strict=True):
            error = 1e4 * found.standard_error.sel(parameter=parameter).values
            axis.plot(HEIGHTS, error, "o-", markersize=3, color=colour, label=name)
            columns.append(error)
        at_object = partial(build, **OBJECT)
        scans = jw.study(lambda height, build=at_object: build(height), control=CONTROL, height=HEIGHTS)
        assert np.all(scans.status == jw.Status.ok)
        columns += [
            np.abs(scans[channel].values).max(axis=scans[channel].get_axis_num("control")).ravel()
            for channel in ("fy", "mz")
        ]
    for axis, label in zip(axes, LABELS.values(), strict=True):
        axis.set(xlabel="height of the spring, $h/L$", ylabel="standard error ($10^{-4}$)", title=label)
        axis.set_ylim(bottom=0)
    axes[0].legend(frameon=False, loc="lower left")
    jw.plot.save(figure, DOCS / "shaft_design.png")
    for height, *row in zip(HEIGHTS, *columns, strict=True):
        print(f"| {height:.2f} | " + " | ".join(f"{value:.2f}" for value in row) + " |")


if __name__ == "__main__":
    main()
