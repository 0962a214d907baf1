"""Laws for one whisker with springs on its shaft, checked by a rod integrated outwards from the base with NumPy.

The checks share no code with the package. They use the fields of a Result only: pose of the base, reaction, contact.
"""

from typing import NamedTuple

import numpy as np

import jaxwhisker as jw

STEPS = 128  # of the classical Runge-Kutta method on each piece of the rod
UNLOADED = 1e-9  # force below which a contact has just begun: its direction is not checked


class Held(NamedTuple):
    """Numbers of many scenes with one uniform whisker, L = EI = 1; leading axis: scenes."""

    at: np.ndarray  # (scenes, springs), arc lengths from the base; negative below it
    axis: tuple[str, ...]  # per spring: "axial", "x", "y" or "phi"
    anchor_x: np.ndarray
    anchor_y: np.ndarray
    stiffness: np.ndarray
    rest_length: np.ndarray
    base_stiffness: np.ndarray  # (scenes,), of a spring along x at the base; 0 without one
    base_rest: np.ndarray
    distance: np.ndarray  # of a parabola
    a: np.ndarray


def _rates(state, load, stiffness=1.0):
    x, y, phi = state
    fx, fy, about = load
    return np.stack([np.cos(phi), np.sin(phi), (about - x * fy + y * fx) / stiffness])


def along(state, load, arc):
    """State of the rod, x, y and angle to the x axis, an arc length further from the base, under this load."""
    h = arc / STEPS
    for _ in range(STEPS):
        k1 = _rates(state, load)
        k2 = _rates(state + h / 2 * k1, load)
        k3 = _rates(state + h / 2 * k2, load)
        k4 = _rates(state + h * k3, load)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


def walk(held: Held, control: np.ndarray, result: jw.Result):
    """States (x, y, phi) at the contact or the tip, loads there, lengths of springs, forces fx at or below the base."""
    r = {
        name: np.asarray(getattr(result, name))[..., 0] for name in ("base_x", "base_y", "base_angle", "fx", "fy", "mz")
    }
    state = np.stack([r["base_x"], r["base_y"], np.pi / 2 + r["base_angle"]])
    load = np.stack([-r["fx"], -r["fy"], -r["mz"] - r["base_x"] * r["fy"] + r["base_y"] * r["fx"]])
    free = np.asarray(result.phase)[..., 0] == jw.Phase.free
    stop = np.where(free, 1.0, np.asarray(result.contact_arc)[..., 0])
    lengths, s = np.zeros((*control.shape, held.at.shape[1])), np.zeros_like(stop)
    kinds = np.array(held.axis)
    order, below_base = np.argsort(held.at, axis=1), np.zeros_like(s)
    for rank in range(held.at.shape[1]):
        k = order[:, rank]
        at, ax, ay, c, rest = (
            np.take_along_axis(values, k[:, None], 1)
            for values in (held.at, held.anchor_x, held.anchor_y, held.stiffness, held.rest_length)
        )
        kind = kinds[k][:, None]
        height, below = np.maximum(at, 0.0) + 0 * s, np.minimum(at, 0.0)
        state = along(state, load, height - s)
        s = height
        x, y, phi = state
        x, y = x + below * np.cos(phi), y + below * np.sin(phi)
        right, up = x - control - ax, y - ay
        away = np.hypot(right, up)
        length = np.select([kind == "axial", kind == "x", kind == "y"], [away, right, up], phi - np.pi / 2)
        tension = c * (length - rest)
        fx = -tension * np.select([kind == "axial", kind == "x"], [right / np.maximum(away, 1e-300), 1.0], 0.0)
        fy = -tension * np.select([kind == "axial", kind == "y"], [up / np.maximum(away, 1e-300), 1.0], 0.0)
        turn = -tension * (kind == "phi")
        # Above the spring, its force is no longer part of the load; the reaction contains those at the base and below.
        above = at > 0
        load = load - np.where(above, np.stack([fx, fy, x * fy - y * fx + turn]), 0.0)
        below_base = below_base + np.where(above, 0.0, fx)
        np.put_along_axis(lengths, np.broadcast_to(k[:, None, None], (*control.shape, 1)), length[..., None], 2)
    return along(state, load, stop - s), load, lengths, below_base


def violations(held: Held, control: np.ndarray, result: jw.Result) -> dict[str, np.ndarray]:
    """Residual of each law at each step, (scenes, steps); zero where the status is not ok."""
    r = {
        name: np.asarray(getattr(result, name))[..., 0]
        for name in jw.State.__dataclass_fields__
        if name != "slip" and getattr(result, name) is not None
    }
    ok = np.asarray(result.status) == jw.Status.ok
    free, tip = r["phase"] == jw.Phase.free, r["phase"] == jw.Phase.tip
    (x, y, phi), (fx, fy, about), lengths, below = walk(held, control, result)
    force, slope = r["contact_force"], r["contact_slope"]
    q, a = held.distance[:, None], held.a[:, None]
    scale = 1 + np.abs(force) + np.abs(r["fx"]) + np.abs(r["fy"]) + np.abs(r["mz"])
    moment = about - x * fy + y * fx
    drawn = held.base_stiffness[:, None] * (r["base_x"] - control - held.base_rest[:, None])
    given = np.asarray(result.spring_length)[..., : held.at.shape[1]]
    missed = {
        "no moment at the end": moment / scale,
        "force at the end, x": (fx - np.where(free, 0.0, force * np.sin(slope))) / scale,
        "force at the end, y": (fy + np.where(free, 0.0, force * np.cos(slope))) / scale,
        "contact point, x": np.where(free, 0.0, x - r["contact_x"]),
        "contact point, y": np.where(free, 0.0, y - r["contact_y"]),
        "contact on the object": np.where(free, 0.0, r["contact_y"] - q - a * r["contact_x"] ** 2),
        "slope of the object": np.where(free, 0.0, np.tan(slope) - 2 * a * r["contact_x"]) * np.cos(slope) ** 2,
        "the object only pushes": np.minimum(force, 0.0),
        "tip contact is at the tip": np.where(tip, r["contact_arc"] - 1, 0.0),
        "tangential contact is tangential": np.where(~free & ~tip & (force > UNLOADED), np.sin(phi - slope), 0.0),
        "contact from below": np.where(tip & (force > UNLOADED), np.minimum(np.sin(phi - slope), 0.0), 0.0),
        "contact above the springs": np.where(free, 0.0, np.minimum(r["contact_arc"] - held.at.max(1)[:, None], 0.0)),
        "springs at and below the base": (r["fx"] + drawn - below) / scale,
        "base upright at height 0": np.abs(r["base_y"]) + np.abs(r["base_angle"]),
        "spring lengths": np.max(np.abs(given - lengths), axis=-1),
        "free whiskers are clear": np.where(free, np.minimum(q + a * x**2 - y, 0.0), 0.0),
    }
    return {name: np.where(ok, np.where(np.isnan(value), np.inf, np.abs(value)), 0.0) for name, value in missed.items()}
