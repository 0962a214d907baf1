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

    def contact(self, alpha):
        """Point of the circle at slope angle alpha."""
        return self.radius * np.sin(alpha), self.distance + self.radius * (1 - np.cos(alpha))
