"""Draw the figure of docs/inverse.md on the pose of a sensor.

python figures/pose.py writes docs/pose.png: standard errors of the pose from several sweeps past a known ball.
"""

from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
WIRE = jw.Whisker.from_material(length=0.05, youngs_modulus=2.1e11, diameter=2e-4)
BALL = jw.Sphere(0.02, (0.0, 0.055, 0.008))  # m
NOISE = {"f1": 1e-4, "f2": 1e-4, "f3": 1e-4, "m1": 5e-6, "m2": 5e-6, "m3": 5e-6}  # N and N m
STEPS = 200  # readings of each sweep
UNIT = {"x": 1e3, "y": 1e3, "z": 1e3, "angle": 180 / np.pi, "elevation": 180 / np.pi, "roll": 180 / np.pi}
ALONG_X = {"direction": (-1.0, 0.0, 0.0)}
SWEEPS = {
    "x": (jw.LinearDrive(**ALONG_X), (-0.03, 0.02)),
    "x 6 mm lower": (jw.LinearDrive(**ALONG_X, origin=(0.0, -0.006, 0.0)), (-0.03, 0.02)),
    "y": (jw.LinearDrive((0.0, 1.0, 0.0), (-0.01, -0.02, 0.0)), (0.0, 0.02)),
    "z": (jw.LinearDrive((0.0, 0.0, 1.0), (0.008, 0.0, 0.0)), (-0.03, 0.02)),
    "whisk": (jw.WhiskDrive(pivot=(0.0, -0.02, 0.0)), (-0.5, 0.4)),
}
EDGE = 5.0  # of the figure's scale, beyond which it marks what is not observable
ROWS = (("x",), ("y",), ("z",), ("whisk",), ("x", "x 6 mm lower"), ("x", "z"), ("x", "whisk"))


def build_of(motion):
    """Scenes with a drive, for every pose of the sensor on it."""

    def build(x, y, z, angle, elevation, roll):
        mount = jw.Mount(x=x, y=y, angle=angle, z=z, elevation=elevation, roll=roll)
        return jw.Scene(WIRE, BALL, jw.Support(mount=mount), motion=motion)

    return build


def own(result: jw.SpaceResult) -> dict[str, Any]:
    """Six components in the frame of the sensor, which turns with it."""
    parts = [*result.own_force[:, 0].T, *result.own_moment[:, 0].T]
    return dict(zip(NOISE, parts, strict=True))


def informations() -> dict[str, jw.Information]:
    """The information in each sweep."""
    at = dict.fromkeys(UNIT, 0.0)
    return {
        name: jw.information(
            build_of(drive), at, sigma=NOISE, control=np.linspace(ends[0], ends[1], STEPS), channels=own
        )
        for name, (drive, ends) in SWEEPS.items()
    }


def draw_pose() -> None:
    """Standard errors of the pose by sweep; those that are not observable at the right."""
    each = informations()
    figure, panels = pyplot.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axis, names, unit in zip(panels, (("x", "y", "z"), ("angle", "elevation", "roll")), ("mm", "°"), strict=True):
        axis.axvspan(EDGE, 8 * EDGE, color="0.93", linewidth=0)
        for place, (name, colour) in enumerate(zip(names, COLOURS, strict=False)):
            errors = [sum_of(each, row).standard_error[name] * UNIT[name] for row in ROWS]
            at = np.arange(len(ROWS)) + 0.22 * (place - 1)
            seen = np.isfinite(errors)
            axis.plot(np.where(seen, errors, np.nan), at, "o", color=colour, label=name)
            axis.plot(np.where(seen, np.nan, 8**0.5 * EDGE), at, "x", color=colour)
        axis.set(xscale="log", xlim=(0.02, 8 * EDGE), xlabel=f"standard error ({unit})")
        axis.set_xticks([0.1, 1.0], ["0.1", "1"])
        axis.text(8**0.5 * EDGE, -0.75, "not observable", ha="center", fontsize="small")
        for line in np.arange(len(ROWS) - 1) + 0.5:
            axis.axhline(line, color="0.85", linewidth=0.6, zorder=0)
        axis.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3)
    panels[0].set_yticks(np.arange(len(ROWS)), [" + ".join(row) for row in ROWS])
    panels[0].set_ylabel("sweeps")
    panels[0].set_ylim(len(ROWS) - 0.5, -1.1)
    figure.savefig(DOCS / "pose.png", dpi=150)


def sum_of(each: dict[str, jw.Information], row: tuple[str, ...]) -> jw.Information:
    """The information in several sweeps together."""
    first, *others = (each[name] for name in row)
    for other in others:
        first = first + other
    return first


if __name__ == "__main__":
    draw_pose()
