"""Shafts of constant curvature, made by hand: their geometry is known in closed form."""

import numpy as np

from jaxwhisker._equilibrium.shaft import Shaft, ShaftLine


def points(x, y, phi, curvature, s):
    """Points of an arc at arc lengths from a point with this direction, and directions there."""
    chord, turn = s * np.sinc(curvature * s / 2 / np.pi), phi + curvature * s / 2
    return x + chord * np.cos(turn), y + chord * np.sin(turn), phi + curvature * s


def line(x, y, phi, cell) -> ShaftLine:
    """A line of points with these directions."""
    return ShaftLine(*map(np.asarray, (x, y, np.cos(phi), np.sin(phi), cell)))  # pyright: ignore[reportArgumentType]


def shaft(x, y, phi, curvature, to_base, to_tip, parameter=0.0) -> Shaft:
    """The shaft with a contact at a point, where it has this direction, and these arc lengths to its ends."""
    along = np.linspace(0.0, -to_base, 17), np.linspace(0.0, to_tip, 9)
    below, beyond = (line(*points(x, y, phi, curvature, s), np.diff(s)) for s in along)
    return Shaft(below, beyond, np.float64(parameter), None)  # pyright: ignore[reportArgumentType]
