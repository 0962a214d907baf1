"""A clamped rod in space by scipy's collocation method `solve_bvp`: nothing is shared with the package.

Unknowns along the rod are position, quaternion (scalar part first), and force and moment of everything beyond.
"""

import numpy as np
from scipy.integrate import solve_bvp

TOLERANCE = 1e-11  # relative to the derivatives
CLAMP = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])  # d1 = x, d2 = -z, d3 = y


def matrix(q):
    """Rotation matrices [d1 d2 d3] of quaternions, along the last axis."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def solved(stiffness, ratio, curvature, density, at_tip, steps=10):
    """Values [r, q, F, m] at the base and the tip of a rod of length 1, while loads grow.

    Args:
        stiffness: EI as a function of arc length.
        ratio: torsional stiffness divided by EI.
        curvature: intrinsic curvatures and twist, a vector.
        density: dead force per length as a function of arc length, shape (3, points).
        at_tip: force and moment at the tip of a rod with this rotation matrix there.
        steps: in which the loads grow.
    """
    s = np.linspace(0.0, 1.0, 41)
    guess = np.zeros((13, s.size))
    guess[1], guess[3:7] = s, CLAMP[:, None]
    for share in np.linspace(0.0, 1.0, steps + 1):

        def rates(s, values, share=share):
            q, force, moment = values[3:7], values[7:10], values[10:]
            axes = matrix(q)
            local = np.einsum("abp,ap->bp", axes, moment)
            x, y, z = local / (stiffness(s) * np.array([1.0, 1.0, ratio])[:, None]) + np.asarray(curvature)[:, None]
            w, i, j, k = q / 2
            spin = [-i * x - j * y - k * z, w * x + j * z - k * y, w * y + k * x - i * z, w * z + i * y - j * x]
            return np.concatenate([axes[:, 2], spin, -share * density(s), np.cross(force.T, axes[:, 2].T).T])

        def ends(base, tip, share=share):
            force, moment = at_tip(matrix(tip[3:7]))
            return np.concatenate([base[:3], base[3:7] - CLAMP, tip[7:10] - share * force, tip[10:] - share * moment])

        tolerance = TOLERANCE if share == 1 else 1e-4
        found = solve_bvp(rates, ends, s, guess, tol=tolerance, max_nodes=200_000)
        assert found.success
        s, guess = found.x, found.y
    return guess[:, 0], guess[:, -1]
