"""A rod in space by scipy's DOP853, with rotation matrices: nothing is shared with the package."""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

TOLERANCE = 1e-13  # of the integration; its results are accurate to about 1e-12


def hat(v):
    """Matrix of the vector product with v."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def end(force, arc, start, stiffness, ratio, curvature, breaks=()):
    """Position and rotation matrix at the base of a rod from the origin.

    Args:
        force: vector of the dead force at the start.
        arc: arc length of the start from the base.
        start: rotation matrix [d1 d2 d3] there.
        stiffness: EI as a function of arc length.
        ratio: torsional stiffness divided by EI.
        curvature: intrinsic curvatures and twist as a function of arc length, a vector.
        breaks: arc lengths at which the functions jump.
    """

    def slope(s, state):
        r, rotation = state[:3], state[3:].reshape(3, 3)
        local = rotation.T @ np.cross(-r, force)
        k = curvature(s) + local / (stiffness(s) * np.array([1.0, 1.0, ratio]))
        return np.concatenate([rotation[:, 2], (rotation @ hat(k)).ravel()])

    state = np.concatenate([np.zeros(3), np.asarray(start).ravel()])
    stops = [arc, *sorted((s for s in breaks if 0 < s < arc), reverse=True), 0.0]
    for above, below in itertools.pairwise(stops):
        # The functions have the values of this piece at its ends, too.
        inner = below + 1e-12, above - 1e-12
        run = solve_ivp(
            lambda s, y, inner=inner: slope(np.clip(s, *inner), y),
            (above, below),
            state,
            method="DOP853",
            rtol=TOLERANCE,
            atol=TOLERANCE,
        )
        state = run.y[:, -1]
    return state[:3], state[3:].reshape(3, 3)
