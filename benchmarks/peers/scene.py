"""Scenes that every method computes: FB, one whisker (L = EI = 1) on one spring beneath a parabola or a circle."""

import math
from dataclasses import dataclass

import numpy as np

CONTACT_SLOPE = math.atan(2 * math.sqrt(0.8))  # where an upright whisker first touches the parabola


@dataclass(frozen=True)
class Scene:
    """Beneath the parabola y = x^2 + distance."""

    stiffness: float = 70.0
    rest_length: float = 0.2
    distance: float = 0.2

    def contact(self, alpha):
        """Point of the object at slope angle alpha."""
        return np.tan(alpha) / 2, self.distance + np.tan(alpha) ** 2 / 4


@dataclass(frozen=True)
class Circle(Scene):
    """Beneath a circle, for simulators without a parabola."""

    radius: float = 1.0

    @property
    def circles(self):
        """Centre x, y and radius."""
        return ((0.0, self.distance + self.radius, self.radius),)

    def contact(self, alpha):
        """Point of the circle at slope angle alpha."""
        return self.radius * np.sin(alpha), self.distance + self.radius * (1 - np.cos(alpha))


@dataclass(frozen=True)
class InSpace:
    """A clamped whisker (L = EI = 1) that passes a sphere; its base is at (-u, 0, offset)."""

    offset: float = 0.2
    curvature: float = 0.0
    roll: float = 0.0
    torsion_ratio: float = 2 / 3
    radius: float = 1.0
    height: float = 1.3  # of the centre of the sphere above the base


@dataclass(frozen=True)
class Circles:
    """Two circles that a clamped whisker (L = EI = 1) passes from right to left; its base is at (u, 0)."""

    circles: tuple[tuple[float, float, float], ...] = ((0.0, 0.7, 0.2), (-0.55, 0.37, 0.12))  # x, y, radius
