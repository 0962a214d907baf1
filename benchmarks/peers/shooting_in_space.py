"""scipy in space: fsolve around solve_ivp (DOP853), from the contact to the base, continued from step to step.

The unknowns are a rotation vector, which turns the last frame of the contact over the sphere, the force, the slack, and
for a curved whisker the roll. A straight round rod needs its tangent only, a curved one has a quaternion. Every solve
starts from the linear extrapolation of the last two solutions.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from peers.scene import InSpace

UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns d1, d2, d3
ROLL, FORCE, SLACK = 3, 4, 5


def scan(scene: InSpace, control: np.ndarray, tolerance: float) -> np.ndarray:
    """Support reactions fx, fy, fz, mx, my, mz at every drive position, (steps, 6); NaN where fsolve fails."""
    curved, bow = scene.curvature != 0, np.array([0.0, -scene.curvature, 0.0])
    clamp = UPRIGHT @ Rotation.from_rotvec([0.0, 0.0, scene.roll]).as_matrix()
    stiffness, centre = np.array([1.0, 1.0, scene.torsion_ratio]), np.array([0.0, scene.height, 0.0])
    upright = Rotation.from_matrix(clamp).as_quat(scalar_first=True)
    free = np.arange(6) if curved else np.array([0, 1, 2, FORCE, SLACK])

    def contact(frame, z):
        frame = frame @ Rotation.from_rotvec(z[:3]).as_matrix()
        return frame, centre + scene.radius * frame[:, 2], z[FORCE] * frame[:, 2]

    def missed(unknowns, base, frame):
        z = np.zeros(6)
        z[free] = unknowns
        (ahead, across, out), p, force = (part.T for part in contact(frame, z))
        chi, arc = max(-z[SLACK], 0.0), 1 - max(z[SLACK], 0.0)
        tangent = np.cos(chi) * ahead - np.sin(chi) * out
        if not curved:
            end = _end(lambda _, y: -arc * np.append(y[3:], _turned(_turned(p - y[:3], force), y[3:])),
                       np.append(p, tangent), tolerance)  # fmt: skip
            return np.append(end[:3] - base, end[[3, 5]])

        def bend(_, state):
            w, v = state[3], state[4:]
            moment = _turned(p - state[:3], force)
            # Into the body frame, and the tangent out of it.
            own = moment + 2 * _turned(v, _turned(v, moment) - w * moment)
            k = bow + own / stiffness
            x, y, z = v
            along = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)
            return -arc * np.array([*along, -(v @ k) / 2, *((w * k + _turned(v, k)) / 2)])

        first = np.cos(z[ROLL]) * np.cross(across, tangent) + np.sin(z[ROLL]) * across
        start = np.stack([first, np.cross(tangent, first), tangent], axis=1)
        end = _end(bend, np.append(p, Rotation.from_matrix(start).as_quat(scalar_first=True)), tolerance)
        w, v = end[3], end[4:]
        # Vector part of the quaternion from the clamp to the base.
        return np.append(end[:3] - base, upright[0] * v - w * upright[1:] - _turned(upright[1:], v))

    frame, z = _touch(scene, centre, clamp)
    change, reactions = np.zeros(6), []
    for u in control:
        base = np.array([-u, 0.0, scene.offset])
        guess = z + change
        solution = fsolve(missed, guess[free], (base, frame), xtol=tolerance, epsfcn=tolerance, full_output=True)
        if solution[2] != 1:
            reactions.append(np.full(6, np.nan))
            continue
        last, z = z, np.zeros(6)
        z[free] = solution[0]
        frame, p, force = contact(frame, z)
        change = z - last * [0, 0, 0, 1, 1, 1]
        z[:3] = 0.0
        reactions.append(np.append(-force, -np.cross(p - base, force)))
    return np.array(reactions)


def _turned(a, b):
    # numpy's cross takes ten times as long.
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _end(slope, start, tolerance):
    return solve_ivp(slope, (0.0, 1.0), start, "DOP853", rtol=tolerance, atol=tolerance).y[:, -1]


def _touch(scene, centre, clamp):
    """Frame of the contact and unknowns where the unloaded whisker touches the sphere first."""
    turn = scene.curvature
    # The tip in the frame of the clamp, whose k2 is minus the curvature.
    tip = clamp @ ([-(1 - np.cos(turn)) / turn, 0.0, np.sin(turn) / turn] if turn else [0.0, 0.0, 1.0])
    directors = clamp @ Rotation.from_rotvec([0.0, -turn, 0.0]).as_matrix()
    tangent, y, z = directors[:, 2], tip[1] - centre[1], tip[2] + scene.offset
    out = np.array([np.sqrt(scene.radius**2 - y**2 - z**2), y, z]) / scene.radius
    chi = np.arcsin(-tangent @ out)
    ahead = (tangent + np.sin(chi) * out) / np.cos(chi)
    across = np.cross(out, ahead)
    roll = np.arctan2(directors[:, 0] @ across, directors[:, 0] @ np.cross(across, tangent))
    start = np.zeros(6)
    start[[ROLL, FORCE, SLACK]] = roll, 0.01, -chi
    return np.stack([ahead, across, out], axis=1), start
