"""Draw the figures of docs/space.md.

python figures/space.py writes docs/space_signals.png, space_instability.png, space_pictures.png, space_row.png,
space_image.png and space_overview.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
OFFSETS = (0.2, 0.05, 0.01, 0.001)  # of the sphere's centre from the plane of the scan, in whisker lengths
CONTROL = -(np.linspace(-1.0, 1.0, 1201) ** 3)  # denser where the whisker swings around
WIRE = {"length": 0.05, "youngs_modulus": 2.1e11, "diameter": 2e-4}


def past_sphere(offset: float) -> jw.SpaceResult:
    """A straight whisker that is moved towards -x below a sphere."""
    return jw.scan(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -offset))), CONTROL)


def draw_signals() -> None:
    """Six signals of the wire and the ball of the page."""
    wire, ball = jw.Whisker.from_material(**WIRE), jw.Sphere(0.04, (0.0, 0.06, 0.01))
    result = jw.scan(jw.SpaceScene(wire, ball, jw.Support.follicle(x=40.0, z=20.0)))
    figure, axes = pyplot.subplots(1, 2, figsize=(8, 2.8), layout="constrained")
    groups = {"force (mN)": ("fx", "fy", "fz"), "moment (mN mm)": ("mx", "my", "mz")}
    for axis, (label, names), scale in zip(axes, groups.items(), (1e3, 1e6), strict=True):
        for name, colour in zip(names, COLOURS, strict=False):
            values = np.asarray(getattr(result, name))[:, 0] * scale
            axis.plot(np.asarray(result.control) * 1e3, values, color=colour, label=name)
        axis.set(xlabel="drive position $u$ (mm)", ylabel=label)
        axis.invert_xaxis()
        axis.legend(frameon=False)
    figure.savefig(DOCS / "space_signals.png", dpi=150)


def draw_row() -> None:
    """A whisker past three objects, and its signals."""
    rod, peg = (
        jw.Cylinder(0.2, (0.0, 0.8, 0.0), (0.0, 0.3, 1.0)),
        jw.Capsule(0.02, (-0.3, 0.65, -0.4), (-0.3, 1.1, 1.1)),
    )
    result = jw.scan(jw.SpaceScene(jw.Whisker(), (rod, peg, jw.Sphere(0.25, (-1.7, 0.9, 0.1)))))
    figure = pyplot.figure(figsize=(9, 3.6), layout="constrained")
    places = figure.add_gridspec(1, 2, width_ratios=(3, 2))
    camera = figure.add_subplot(places[0], projection="3d")
    jw.plot.shapes(result, [0.0, -0.4, -0.5, -0.7, -1.6, -1.85], view=(20, -150), ax=camera)
    camera.tick_params(labelsize="x-small")
    signal = figure.add_subplot(places[1])
    for name, colour in zip(("fx", "fy", "fz"), COLOURS, strict=False):
        signal.plot(np.asarray(result.control), np.asarray(getattr(result, name))[:, 0], color=colour, label=name)
    signal.set(xlabel="drive position $u/L$", ylabel="force / (EI/L²)")
    signal.invert_xaxis()
    signal.legend(frameon=False)
    figure.savefig(DOCS / "space_row.png", dpi=150)


def draw_instability() -> None:
    """Where the contact goes if the sphere is not quite in the plane of the scan, and the force that follows."""
    figure, (below, signal) = pyplot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for offset, colour in zip(OFFSETS, COLOURS, strict=False):
        result = past_sphere(offset)
        touching = np.asarray(result.phase)[:, 0] > 0
        x, z = (np.asarray(getattr(result, name))[touching, 0] for name in ("contact_x", "contact_z"))
        below.plot(x, z + offset, color=colour, label=f"offset {offset:g} L")
        signal.plot(np.asarray(result.control), np.asarray(result.fx)[:, 0], color=colour)
    plane = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.3, 1.0)))
    signal.plot(np.asarray(plane.control), np.asarray(plane.fx)[:, 0], "k:", label="guided in the plane")
    mark(below)
    below.set(xlabel="contact, $x/L$", ylabel="contact, $z/L$ from the centre", aspect="equal")
    below.legend(frameon=False, loc="upper center", fontsize="small", ncols=2)
    below.set_ylim(-0.1, 1.0)
    signal.set(xlabel="drive position $u/L$", ylabel="$f_x L^2/EI$")
    signal.legend(frameon=False)
    for axis in (below, signal):
        axis.invert_xaxis()
    figure.savefig(DOCS / "space_instability.png", dpi=150)


def mark(axis: Axes) -> None:
    """The point below the centre, where a whisker without an offset loses its stability."""
    axis.plot(0.0, 0.0, "k+", markersize=8)


def draw_pictures() -> None:
    """A whisker past an oblique ellipsoid, by a camera and in two projections."""
    ellipsoid = jw.Ellipsoid((1.1, 0.8, 0.6), (0.0, 1.1, 0.0)).rotated((0.3, 0.2, -0.4))
    result = jw.scan(jw.SpaceScene(jw.Whisker(), ellipsoid, motion=jw.LinearDrive(direction=(-2.0, 0.0, -0.7))))
    figure = pyplot.figure(figsize=(13, 4.8), layout="constrained")
    for place, view in enumerate((None, "xy", "xz")):
        axes = figure.add_subplot(1, 3, place + 1, projection="3d" if view is None else None)
        jw.plot.shapes(result, [-0.6, -0.2, 0.2, 0.3, 0.6], view=view, ax=axes)
    figure.savefig(DOCS / "space_pictures.png", dpi=110)


def draw_overview() -> None:
    """The scan with friction of the page, with turns of the drive."""
    scene = jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.5)), friction=0.3)
    turns = [np.linspace(*ends, 121)[:-1] for ends in ((0.85, 0.3), (0.3, 0.5), (0.5, -0.85))]
    jw.plot.overview(jw.scan(scene, np.concatenate(turns))).savefig(DOCS / "space_overview.png", dpi=100)


def draw_image() -> None:
    """Images of the ellipsoid of the page."""
    stone = jw.Ellipsoid((1.0, 0.5, 0.6), (0.0, 0.9, 0.0)).rotated((0.0, 0.5, 0.0))

    def build(offset):
        drive = jw.LinearDrive(direction=(1.0, 0.0, 0.0), origin=(0.0, 0.0, offset))
        return jw.SpaceScene(jw.Whisker(), stone, motion=drive)

    data = jw.tactile_image(build, offset=np.linspace(-0.9, 0.9, 61), control=np.linspace(-1.2, 1.2, 121))
    jw.plot.save(jw.plot.tactile_image(data), DOCS / "space_image.png", dpi=100)


if __name__ == "__main__":
    draw_signals()
    draw_instability()
    draw_pictures()
    draw_row()
    draw_image()
    draw_overview()
