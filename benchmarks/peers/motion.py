"""Motions that every simulator computes: a clamped whisker, L = EI = rho A = 1, let go or dragged past a circle."""

import math
from dataclasses import dataclass, field

import numpy as np

from peers.scene import Circle, Circles

SUBSTEPS = 4  # Runge-Kutta steps between two arc lengths


@dataclass(frozen=True)
class RingDown:
    """Let go at rest from an equilibrium under a force at its tip, without damping."""

    reaction: tuple[float, float, float]  # fx, fy, mz of the support before
    duration: float = 1.0
    samples: int = 200

    def shape(self, arcs: np.ndarray) -> np.ndarray:
        """Initial x, y and angle at ascending arc lengths from 0, (points, 3), with the base at the origin."""
        fx, fy, mz = self.reaction

        def rate(state):
            x, y, angle = state
            return np.array([np.cos(angle), np.sin(angle), x * fy - y * fx - mz])

        points = [np.array([0.0, 0.0, np.pi / 2])]
        for h in np.diff(arcs) / SUBSTEPS:
            state = points[-1]
            for _ in range(SUBSTEPS):
                a = rate(state)
                b = rate(state + h / 2 * a)
                c = rate(state + h / 2 * b)
                state = state + h / 6 * (a + 2 * b + 2 * c + rate(state + h * c))
            points.append(state)
        return np.array(points)


@dataclass(frozen=True)
class Sweep:
    """Dragged past circles at constant speed, from clear of it to after the release; at rest relative to the base."""

    stiffness_damping: float = 0.0  # time constant of the material
    mass_damping: float = 0.0  # drag of still air, per mass
    start: float = 1.0  # base position
    stop: float = -1.8
    speed: float = 0.2
    samples: int = 350
    scene: Circle | Circles = field(default_factory=Circle)

    @property
    def duration(self) -> float:
        """Time of the sweep."""
        return (self.start - self.stop) / self.speed


def substeps(motion: RingDown | Sweep, largest: float) -> int:
    """Number of time steps between two samples if a step has a largest size."""
    return math.ceil(motion.duration / motion.samples / largest)
