"""Discrete rod with inequality constraints: rigid links and hinges, equilibria by sequential quadratic programming.

Rigid links of length h = 1/n, with half a link at either end, are joined by hinges of stiffness 1/h; the first half
link is clamped. No point of a link may enter a circle; with `at_nodes`, no hinge and not the tip. Every quadratic
program has the Hessian of the Lagrangian and is solved by non-negative least squares. Where it has no minimum, or the
step is long, the angles are damped: the rod then moves, overdamped, to its next equilibrium, which decides where jumps
lead. Matrices are dense.
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, solve_triangular
from scipy.optimize import nnls

from peers.scene import Circles

NEAR = 0.03  # gaps below this are constraints
LARGEST = 0.2  # change of an angle in one iteration
STILL = 1e-9  # change of an angle at rest
STIFFENED = 10.0  # stiffness of loaded constraints in the Hessian, per link, which does not change the solution
DAMPING = 0.01  # of each angle, where damping begins and ends
MOST = 500  # iterations of an equilibrium


class Rod:
    """A chain of n links at its last equilibrium."""

    def __init__(self, scene: Circles, links: int, at_nodes: bool = False):
        self.circles, self.at_nodes, self.links = scene.circles, at_nodes, links
        self.lengths = np.append(np.full(links - 1, 1 / links), 0.5 / links)  # beyond the clamped half link
        bending = 2 * np.eye(links) - np.eye(links, k=1) - np.eye(links, k=-1)
        bending[-1, -1] = 1.0
        self.bending = links * bending
        self.angles = np.full(links, np.pi / 2)
        self.forces = np.zeros((len(scene.circles), links))  # of each circle on each link
        self.iterations = 0

    def settle(self, u: float) -> np.ndarray:
        """Move the base to (u, 0); return the reactions fx, fy, mz at rest, or NaN if the rod does not come to rest."""
        damping = 0.0
        for _ in range(MOST):
            self.iterations += 1
            change, forces, pushed = self._step(u, damping)
            size = np.max(np.abs(change))
            if not size <= LARGEST:
                damping = max(4 * damping, DAMPING)
                continue
            self.angles, self.forces = self.angles + change, forces
            if size < STILL and not damping:
                return pushed
            damping = damping / 4 if damping > DAMPING else 0.0
        return np.full(3, np.nan)

    def _step(self, u, damping):
        """Change of the angles, NaN if there is no minimum; forces on all links; and the reactions fx, fy, mz."""
        links = np.arange(self.links)
        along = np.stack([np.cos(self.angles), np.sin(self.angles)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        base = np.array([u, 0.5 / self.links])
        starts = np.concatenate([[base], base + np.cumsum(self.lengths[:, None] * along, axis=0)[:-1]])
        bent = self.angles - np.pi / 2
        gradient, hessian = self.bending @ bent, self.bending + damping * np.eye(self.links)
        keys, gaps, slopes, pushes = [], [], [], []
        for number, (x, y, radius) in enumerate(self.circles):
            centre = np.array([x, y])
            share = np.sum((centre - starts) * along, axis=1)
            place = self.lengths if self.at_nodes else np.clip(share, 0.0, self.lengths)
            points = starts + place[:, None] * along
            apart = np.linalg.norm(points - centre, axis=1)
            for k in np.flatnonzero(apart < radius + NEAR):
                normal = (points[k] - centre) / apart[k]
                arms = np.where(links < k, self.lengths, 0.0)  # how far the point moves across each link, per angle
                arms[k] = place[k]
                slope, gap = arms * (across @ normal), apart[k] - radius
                keys.append((number, k)), gaps.append(gap), slopes.append(slope)
                pushes.append((*normal, (points[k, 0] - u) * normal[1] - points[k, 1] * normal[0]))
                if force := self.forces[number, k]:
                    gradient += STIFFENED * self.links * gap * slope
                    hessian += STIFFENED * self.links * np.outer(slope, slope)
                    hessian[links, links] += force * arms * (along @ normal)
                    if place[k] == share[k]:  # the gap between a line and a point
                        slide = force * np.sign(across[k] @ normal) * arms * (across @ along[k])
                        hessian[k] += slide
                        hessian[:, k] += slide
                        hessian[k, k] += force * apart[k]
                    else:
                        slide = arms * (across @ np.array([-normal[1], normal[0]]))
                        hessian -= force / apart[k] * np.outer(slide, slide)
        forces, reactions = np.zeros_like(self.forces), np.zeros(3)
        try:
            lower = np.tril(cho_factor(hessian, lower=True)[0])
        except LinAlgError:
            return np.full(self.links, np.nan), forces, reactions
        free = solve_triangular(lower, gradient, lower=True)
        if keys:
            # The least |y| with G y >= h, where y = L^T change + free.
            bounds = solve_triangular(lower, np.array(slopes).T, lower=True)  # G^T
            level = bounds.T @ free - gaps
            problem = np.vstack([bounds, level])
            target = np.append(np.zeros(self.links), 1.0)
            multipliers, _ = nnls(problem, target)
            residual = problem @ multipliers - target
            multipliers = -multipliers / residual[-1]
            free = free - bounds @ multipliers
            for (number, k), force in zip(keys, multipliers, strict=True):
                # Loaded constraints have a part of their force in the Hessian.
                forces[number, k] = force
            reactions = -multipliers @ np.array(pushes)
        return -solve_triangular(lower.T, free, lower=False), forces, reactions


def scan(scene: Circles, control: np.ndarray, links: int, at_nodes: bool = False) -> np.ndarray:
    """Support reactions fx, fy, mz at every drive position, (steps, 3)."""
    rod = Rod(scene, links, at_nodes)
    return np.array([rod.settle(float(u)) for u in control])
