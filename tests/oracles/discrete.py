"""The energy of whiskers made of stiff links, minimised with scipy: no rod theory, no contact forces, no equilibria.

A whisker is a chain of equal links whose joints must stay outside of the object; its base sits on springs. A state is
stable if a minimisation that starts there stays there.
"""

import numpy as np
from scipy.optimize import minimize, nnls

TOUCHING = 1e-7  # distance from the object below which a joint may have a contact force
BALANCED = 1e-4  # forces, in EI/L^2, beside contact forces of order 10


class Chains:
    """Whiskers of length and stiffness 1 on springs (between, stiffness, rest_length, axis), below a parabola."""

    def __init__(self, springs, whiskers: int, distance: float, links: int = 32):
        self.springs, self.whiskers, self.distance, self.links = springs, whiskers, distance, links
        self.axes = sorted({axis for *_, axis in springs})

    def _split(self, unknown):
        unknown = unknown.reshape(self.whiskers, 3 + self.links)
        return unknown[:, :3], unknown[:, 3:]

    def energy(self, unknown):
        """Energy, and its gradient with respect to displacements of bases and directions of links."""
        bases, angles = self._split(unknown)
        by_base, by_angle = np.zeros_like(bases), np.zeros_like(angles)
        step, total = 1 / self.links, 0.0
        # Half a link lies between the clamped root and the middle of the first link.
        turns = np.diff(angles, axis=1, prepend=np.pi / 2 + bases[:, 2:])
        stiffness = np.append(2.0, np.ones(self.links - 1)) / step
        total += np.sum(stiffness * turns**2) / 2
        moment = stiffness * turns
        by_angle += moment - np.append(moment[:, 1:], np.zeros((self.whiskers, 1)), axis=1)
        by_base[:, 2] -= moment[:, 0]
        for (first, second), c, rest, axis in self.springs:
            k = ("x", "y", "phi").index(axis)
            stretch = bases[second - 1, k] - (bases[first - 1, k] if first else 0.0) - rest
            total += c * stretch**2 / 2
            by_base[second - 1, k] += c * stretch
            if first:
                by_base[first - 1, k] -= c * stretch
        return total, np.concatenate([by_base, by_angle], axis=1).ravel()

    def joints(self, unknown, u):
        """Positions of all joints, (2, whiskers, links), and their derivatives with respect to the unknowns."""
        bases, angles = self._split(unknown)
        step = 1 / self.links
        x = u + bases[:, :1] + step * np.cumsum(np.cos(angles), axis=1)
        y = bases[:, 1:2] + step * np.cumsum(np.sin(angles), axis=1)
        slopes = np.zeros((2, self.whiskers, self.links, self.whiskers, 3 + self.links))
        reach = np.tril(np.ones((self.links, self.links))) * step
        for k in range(self.whiskers):
            slopes[0, k, :, k, 0], slopes[1, k, :, k, 1] = 1.0, 1.0
            slopes[0, k, :, k, 3:], slopes[1, k, :, k, 3:] = -reach * np.sin(angles[k]), reach * np.cos(angles[k])
        return np.stack([x, y]), slopes.reshape(2, self.whiskers, self.links, -1)

    def at_rest(self, u: float, start) -> np.ndarray:
        """Unknowns of the minimum at which a descent from `start` ends, with the drive at u."""
        rigid = [k for k, axis in enumerate(("x", "y", "phi")) if axis not in self.axes]
        fixed = [w * (3 + self.links) + k for w in range(self.whiskers) for k in rigid]
        free = np.setdiff1d(np.arange(start.size), fixed)

        def whole(some):
            unknown = np.zeros(start.size)
            unknown[free] = some
            return unknown

        def energy(some):
            value, gradient = self.energy(whole(some))
            return value, gradient[free]

        def outside(some):
            (x, y), _ = self.joints(whole(some), u)
            return (self.distance + x**2 - y).ravel()

        def outside_slopes(some):
            unknown = whole(some)
            (x, _), (by_x, by_y) = self.joints(unknown, u)
            return (2 * x[..., None] * by_x - by_y).reshape(x.size, -1)[:, free]

        minimum = minimize(
            energy,
            start[free],
            jac=True,
            method="SLSQP",
            constraints={"type": "ineq", "fun": outside, "jac": outside_slopes},
            options={"maxiter": 500, "ftol": 1e-12},
        )
        # The line search may fail on rounding at the minimum. The conditions of a minimum are checked instead of its
        # success: contact forces of touching joints, none of which pulls, balance the gradient of the energy.
        touching, unbalanced = outside(minimum.x) < TOUCHING, np.linalg.norm(energy(minimum.x)[1])
        if touching.any():
            _, unbalanced = nnls(outside_slopes(minimum.x)[touching].T, energy(minimum.x)[1])
        assert unbalanced < BALANCED, minimum.message
        return whole(minimum.x)

    def start(self, base, x, y):
        """Unknowns of whiskers with given base displacements, (whiskers, 3), and points of their shapes."""
        rows = []
        for own, px, py in zip(base, x, y, strict=True):
            arc = np.append(0.0, np.cumsum(np.hypot(np.diff(px), np.diff(py))))
            ends = np.linspace(0.0, arc[-1], self.links + 1)
            qx, qy = np.interp(ends, arc, px), np.interp(ends, arc, py)
            rows.append(np.concatenate([own, np.arctan2(np.diff(qy), np.diff(qx))]))
        return np.concatenate(rows)
