"""Laws that scans with friction must satisfy, checked by elliptic integrals that share no code with the package.

The contact force has the direction (sin psi, -cos psi), with psi = alpha - lean; the lean follows from the reported
parts of the force. The equations of independent.py hold with psi in place of alpha: k^2 = sin(psi/2)^2 +
mz^2 / (4 f EI). At the contact, the whisker has the angle phi1 = psi + pi/2 - 2 asin(k). Beyond an amplitude of pi, the
curvature changes sign within the whisker: contacts that stick may bend whiskers that way.
"""

from typing import Any, NamedTuple

import numpy as np
from independent import LOADED, Mechanics, contact_point, height_of
from scipy.special import ellipeinc, ellipkinc

import jaxwhisker as jw

SAME_TRAVEL = 1e-9  # in lengths of the first whisker: an event this close to a step is at the step
SNAPS = [int(jw.EventKind.snap_through), int(jw.EventKind.snap_off)]


class Laws(NamedTuple):
    """Residuals of the laws of states, and what the laws of motion need to know about them."""

    missed: dict[str, np.ndarray]  # relative residuals, (scenes, states), zero where a state does not count
    side: np.ndarray  # (scenes, states, whiskers): direction along the object in which the whisker points


def all_laws(scenes: Mechanics, friction: np.ndarray, control: np.ndarray, result: jw.Result) -> dict[str, np.ndarray]:
    """Residual of each law, (scenes, states): states are steps, ways between two steps, or events.

    Args:
        scenes: the mechanics of all scenes.
        friction: coefficients, (scenes,).
        control: (scenes, steps).
        result: their scans, stacked along the first axis.
    """
    states = laws_of_states(scenes, friction, control, result, np.asarray(result.status) == jw.Status.ok)
    return (
        states.missed
        | laws_of_motion(scenes, control, result, states.side)
        | laws_of_events(scenes, friction, control, result)
    )


def laws_of_states(scenes: Mechanics, friction: np.ndarray, control: np.ndarray, state: Any, ok: np.ndarray) -> Laws:
    """Residuals of the laws of each single state.

    Args:
        scenes: the mechanics of all scenes.
        friction: coefficients, (scenes,).
        control: drive positions, (scenes, states).
        state: fields of shape (scenes, states, whiskers).
        ok: which states count, (scenes, states).
    """
    r = {name: np.asarray(getattr(state, name)) for name in jw.State.__dataclass_fields__}
    touching = (r["phase"] != jw.Phase.free) & ok[..., None]
    tip, free = touching & (r["phase"] == jw.Phase.tip), ok[..., None] & ~touching
    # Everything in units of each whisker.
    length = scenes.length[:, None, :]
    unit = scenes.bending_stiffness[:, None, :] / length**2
    profile = in_lengths(scenes, length)
    slope = np.where(touching, r["contact_slope"], 0.3)
    force = np.where(touching, r["contact_force"] / unit, 1.0)
    normal, along, fx, fy = (r[name] / unit for name in ("normal_force", "friction_force", "fx", "fy"))
    moment = r["mz"] / (unit * length)
    arc, base_x, x, y = (r[name] / length for name in ("contact_arc", "base_x", "contact_x", "contact_y"))
    psi = slope - np.where(touching, np.arctan2(-along, normal), 0.0)
    loaded = touching & (force > LOADED)
    off_arc, off_x, off_y, angle = _shape(
        np.where(loaded, force, 1.0),
        np.where(loaded, psi, 0.3),
        np.where(loaded, moment, 1.0),
        np.where(loaded, arc, 1.0),
        np.where(loaded, x - base_x, 0.0),
        np.where(loaded, y, 1.0),
    )
    on_x, on_y = contact_point(scenes.kind, profile, slope)
    balance = r["base_x"] - control[..., None] - scenes.offset[:, None, :]
    balance = balance + np.einsum("nij,nsj->nsi", scenes.flexibility, r["fx"])
    mu, slips = friction[:, None, None], r["slip"]

    def where(mask, value):
        # NaN violates every law.
        return np.max(np.where(mask, np.where(np.isnan(value), np.inf, np.abs(value)), 0.0), axis=-1)

    with np.errstate(invalid="ignore"):
        missed = {
            "contact on the object, x": where(touching, (x - on_x) / (1 + np.abs(on_x))),
            "contact on the object, y": where(touching, (y - on_y) / (1 + np.abs(on_y))),
            "arc of the elastica": where(loaded, off_arc),
            "base under the contact, x": where(loaded, off_x),
            "base under the contact, y": where(loaded, off_y),
            "parts of the force": where(touching, (np.hypot(normal, along) - force) / (1 + force)),
            "reaction balances the force, x": where(touching, (fx + force * np.sin(psi)) / (1 + force)),
            "reaction balances the force, y": where(touching, (fy - force * np.cos(psi)) / (1 + force)),
            "the object only pushes": where(touching, np.minimum(normal, 0.0)),
            "cone of friction": where(touching, np.maximum(np.abs(along) - mu * normal, 0.0) / (1 + force)),
            "force of slip": where(touching & (slips != 0), (along + mu * slips * normal) / (1 + force)),
            "slip is a sign": where(touching, np.abs(slips) > 1),
            "tip contact is at the tip": where(tip, arc - 1),
            "tip contact is from below": where(tip & loaded, np.minimum(np.sin(angle - slope), 0.0)),
            "tangential contact is tangential": where(loaded & ~tip, np.sin(angle - slope)),
            "tangential contact is on the whisker": where(touching & ~tip, np.maximum(arc - 1, 0.0)),
            "balance of bases": where(
                ok[..., None], balance / (length[..., :1] + np.max(np.abs(r["base_x"]), -1, keepdims=True))
            ),
            "free whiskers carry nothing": where(free, np.abs(fx) + np.abs(fy) + np.abs(moment)),
            "free whiskers are clear": where(free, _intrusion(scenes.kind, profile, base_x)),
        }
    return Laws(missed, np.where(np.cos(angle - slope) < 0, -1.0, 1.0))


def in_lengths(scenes: Mechanics, length: np.ndarray) -> dict[str, np.ndarray]:
    """The numbers of the profile in given lengths."""
    curved = ("a",) if scenes.kind == "parabola" else ()
    return {
        name: value[:, None, None] * (length if name in curved else 1 / length)
        for name, value in scenes.profile.items()
    }


def _intrusion(kind: str, p: dict[str, np.ndarray], x: np.ndarray) -> np.ndarray:
    """Depth by which an upright whisker at x is inside the object: the shorter of the ways down and sideways."""
    if kind == "parabola":
        width = np.sqrt(np.maximum(1 - p["distance"], 0.0) / p["a"])
    else:
        a, b = (p["radius"], p["radius"]) if kind == "circle" else (p["a"], p["b"])
        width = a * np.sqrt(1 - np.clip(1 - (1 - p["distance"]) / b, 0.0, 1.0) ** 2)
    return np.maximum(np.minimum(1 - height_of(kind, p, x), width - np.abs(x)), 0.0)


def _shape(force, psi, moment, arc, x, y):
    """Errors of the arc, x and y of the contact relative to the base, and the whisker's angle at the contact."""
    k = np.clip(np.sqrt(np.sin(psi / 2) ** 2 + moment**2 / (4 * force)), 1e-12, 1 - 1e-15)
    root = np.sqrt(force)

    def bent(way):
        """The same for whiskers that are bent to the left (+1) or right (-1) at the contact."""
        sin_t0, cos_t0 = np.sin(way * psi / 2) / k, way * moment / (2 * k * root)
        amplitude = np.mod(np.arctan2(cos_t0, sin_t0 * np.sqrt(1 - k**2)), 2 * np.pi)
        whole = ellipkinc(amplitude, k**2)
        along = 2 * k * cos_t0
        across = 2 * (ellipeinc(amplitude, k**2) - k**2 * sin_t0 * np.sin(amplitude)) - whole
        right = along * np.cos(way * psi) - across * np.sin(way * psi)
        up = along * np.sin(way * psi) + across * np.cos(way * psi)
        angle = psi + np.pi / 2 - way * 2 * np.arcsin(k)
        return whole / root - arc, way * x - right / root, y - up / root, angle

    left, right = bent(1.0), bent(-1.0)
    nearer = np.abs(left[0]) + np.abs(left[1]) <= np.abs(right[0]) + np.abs(right[1])
    return [np.where(nearer, one, other) for one, other in zip(left, right, strict=True)]


def energy(scenes: Mechanics, state: Any) -> np.ndarray:
    """Elastic energy of whiskers and springs, (scenes, states)."""
    fx, fy = np.asarray(state.fx), np.asarray(state.fy)
    density = np.asarray(state.mz) ** 2 / (2 * scenes.bending_stiffness[:, None, :]) - fy
    way = np.asarray(state.contact_x) - np.asarray(state.base_x)
    whiskers = density * np.asarray(state.contact_arc) + fx * way + fy * np.asarray(state.contact_y)
    springs = np.einsum("nsi,nij,nsj->ns", fx, scenes.flexibility, fx) / 2
    return np.sum(whiskers, axis=-1) + springs


def arc_on_object(kind: str, p: dict[str, np.ndarray], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Arc length along the object from its lowest point; the sign is that of x."""
    if kind == "parabola":
        z = 2 * p["a"] * x
        return (z * np.hypot(1.0, z) + np.arcsinh(z)) / (4 * p["a"])
    a, b = (p["radius"], p["radius"]) if kind == "circle" else (p["a"], p["b"])
    angle = np.arctan2(x / a, 1 - (y - p["distance"]) / b)
    return a * ellipeinc(angle, 1 - (b / a) ** 2)


def laws_of_motion(scenes: Mechanics, control: np.ndarray, result: jw.Result, side: np.ndarray) -> dict:
    """Residuals of the laws of friction between consecutive steps, (scenes, steps - 1), in lengths of the whisker."""
    length = scenes.length[:, None, :]
    x, y, arc = (np.asarray(getattr(result, name)) / length for name in ("contact_x", "contact_y", "contact_arc"))
    slip, ok = np.asarray(result.slip), np.asarray(result.status) == jw.Status.ok
    touching = np.asarray(result.phase) != jw.Phase.free
    apart, at_a_step = _event_between(scenes, control, result)
    known = ok[:, :-1] & ok[:, 1:] & ~apart
    both = touching[:, :-1] & touching[:, 1:] & known[..., None]
    there = arc_on_object(scenes.kind, in_lengths(scenes, length), x, y)
    with np.errstate(invalid="ignore"):
        slipped = np.diff(there, axis=1) - side[:, :-1] * np.diff(arc, axis=1)
    now = slip[:, :-1]
    changes = touching[:, :-1] != touching[:, 1:]
    changes |= touching[:, 1:] & (slip[:, 1:] != now)
    missed = {
        "contacts that stick roll": np.where(both & (now == 0), slipped, 0.0),
        "slip has its direction": np.where(both & (now != 0), np.minimum(slipped * now, 0.0), 0.0),
        "changes are events": np.where(changes & (known & ~at_a_step)[..., None], 1.0, 0.0),
    }
    return {law: np.max(np.where(np.isnan(value), np.inf, np.abs(value)), axis=-1) for law, value in missed.items()}


def _travel(control: np.ndarray) -> np.ndarray:
    """Distance that the drive has travelled up to each step."""
    ways = np.cumsum(np.abs(np.diff(control, axis=1)), axis=1)
    return np.concatenate([np.zeros((len(control), 1)), ways], axis=1)


def _filled(result: jw.Result) -> np.ndarray:
    """Which entries of the events are used, (scenes, events)."""
    return np.arange(np.shape(result.events.kind)[1]) < np.asarray(result.events.count)[:, None]


def _event_between(scenes: Mechanics, control: np.ndarray, result: jw.Result) -> tuple[np.ndarray, np.ndarray]:
    """Whether an event separates a step and the next one, and whether one is at either step; (scenes, steps - 1)."""
    travel, near = _travel(control), SAME_TRAVEL * scenes.length[:, :1]
    at, snaps = np.asarray(result.events.travel), np.isin(result.events.kind, SNAPS)
    filled = _filled(result)
    truncated = np.asarray(result.events.count) > filled.shape[1]
    last = np.where(truncated, np.max(np.where(filled, at, -np.inf), axis=1), np.inf)
    beyond = travel[:, 1:] > last[:, None] - near
    at, snaps, filled, near = at[:, None], snaps[:, None], filled[:, None], near[..., None]
    start, stop = travel[:, :-1, None], travel[:, 1:, None]
    inside = (at > start + near) & (at < stop - near)
    snapping = snaps & (at > start - near) & (at < stop + near)
    at_a_step = filled & (np.minimum(np.abs(at - start), np.abs(at - stop)) <= near)
    return np.any(filled & (inside | snapping), axis=-1) | beyond, np.any(at_a_step, axis=-1)


def laws_of_events(
    scenes: Mechanics, friction: np.ndarray, control: np.ndarray, result: jw.Result
) -> dict[str, np.ndarray]:
    """Residuals of the laws of states before and after each event, and of what happens there, (scenes, events).

    The last event of a scan that ends with a status may be a snap that does not settle: events beyond the last step
    with status ok do not count.
    """
    events, ok = result.events, np.asarray(result.status) == jw.Status.ok
    reached = np.max(np.where(ok, _travel(control), -np.inf), axis=1, keepdims=True)
    known = _filled(result) & (np.asarray(events.travel) < reached + SAME_TRAVEL * scenes.length[:, :1])
    missed = {}
    for when in ("before", "after"):
        state = laws_of_states(scenes, friction, np.asarray(events.control), getattr(events, when), known)
        missed |= {f"{law}, {when} an event": value for law, value in state.missed.items()}
    before, after = energy(scenes, events.before), energy(scenes, events.after)
    highest = np.max(np.where(ok, energy(scenes, result), 0.0), axis=1), np.max(np.where(known, before, 0.0), axis=1)
    peak = np.maximum(*highest)[:, None]
    snaps = known & np.isin(events.kind, SNAPS)
    gain = np.maximum((after - before) / np.where(peak > 0, peak, 1.0), 0.0)
    missed["snaps lose energy"] = np.where(snaps, np.where(np.isnan(gain), np.inf, gain), 0.0)
    for name, power in (("fx", 2), ("fy", 2), ("mz", 1)):
        unit = (scenes.bending_stiffness / scenes.length**power)[:, None]
        one, other = (np.asarray(getattr(state, name)) / unit for state in (events.before, events.after))
        jump = np.max(np.abs(one - other) / (1 + np.abs(one)), axis=-1)
        missed[f"{name} is continuous at an event"] = np.where(known & ~snaps, jump, 0.0)
    return missed
