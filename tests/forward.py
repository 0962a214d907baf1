"""One whisker in contact, shot from its base outwards with scipy: shares nothing with the package but its conventions.

Unknown are the force, the slope angle where it acts and, in tangential contact, the arc length to it. They give the
base's position (x0 = u + rest + f sin(alpha) / c) and the moment everywhere, m(s) = (xi - x) F_y - (eta - y) F_x; the
rod, integrated from the base on, has to meet the object there, and in tangential contact to be parallel to it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

INTEGRATION = 1e-12  # relative and absolute tolerance of a rod


class State(NamedTuple):
    """Signals and where the contact is."""

    base_x: float
    fx: float
    fy: float
    mz: float
    contact_slope: float
    contact_arc: float


def equilibrium(
    *,
    u: float,
    guess: tuple[float, ...],
    bending_stiffness: Callable[..., Any],
    length: float,
    profile: Callable[..., tuple],
    stiffness: float = np.inf,
    rest_length: float = 0.0,
    intrinsic_curvature: Callable[..., Any] = lambda s: 0.0,
) -> State:
    """The equilibrium near a guess: (force, slope) in tip contact, (force, slope, arc) in tangential contact."""

    def at(unknown):
        force, slope = unknown[:2]
        arc = unknown[2] if len(unknown) == 3 else length
        force_x, force_y = force * np.sin(slope), -force * np.cos(slope)
        base_x = u + rest_length + force_x / stiffness
        return arc, force_x, force_y, base_x, *profile(slope)

    def missed(unknown):
        arc, force_x, force_y, base_x, contact_x, contact_y = at(unknown)

        def bent(s, state):
            x, y, angle = state
            moment = (contact_x - x) * force_y - (contact_y - y) * force_x
            return np.cos(angle), np.sin(angle), intrinsic_curvature(s) + moment / bending_stiffness(s)

        start = base_x, 0.0, np.pi / 2
        end = solve_ivp(bent, (0.0, arc), start, method="DOP853", rtol=INTEGRATION, atol=INTEGRATION).y[:, -1]
        off = [end[0] - contact_x, end[1] - contact_y, end[2] - unknown[1]]
        return off[: len(unknown)]

    found = root(missed, guess, tol=1e-13)
    if np.max(np.abs(found.fun)) > 1e-11:
        raise RuntimeError(f"no equilibrium near {guess}: {found.message}")
    arc, force_x, force_y, base_x, contact_x, contact_y = at(found.x)
    moment = (contact_x - base_x) * force_y - contact_y * force_x
    return State(base_x, -force_x, -force_y, -moment, float(found.x[1]), float(arc))
