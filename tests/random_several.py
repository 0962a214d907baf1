"""Random ordinary scenes with several contacts of each whisker, also in plain numbers for several_laws.py."""

# pyright: reportArgumentType=false, reportRedeclaration=false

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import numpy as np

import jaxwhisker as jw
import several_laws as laws
from several_cases import Wave

STEPS = 60
SNAPS = jw.EventKind.snap_off, jw.EventKind.snap_through
AT_ONCE = 1e-9  # lengths between an event and the snap that it causes
APART = 0.03  # lengths between two objects
ROLLED = 1e-3  # lengths: error of distances along the object
TOP = 1.3  # lengths above the bases: height of objects with corners, out of reach
BLUNT = 0.05  # least sine of the angle by which the outline turns at a corner
KINDS = {  # objects, whiskers, support and largest number of contacts
    "two circles, straight, FB": ("circles", 2, "straight", "FB", 2),
    "two circles, straight, FBFB": ("circles", 2, "straight", "FBFB", 2),
    "three circles, straight, clamped": ("circles", 3, "straight", "clamped", 3),
    "two ellipses, curved, FB": ("ellipses", 2, "curved", "FB", 2),
    "two ellipses, cone, FBFB": ("ellipses", 2, "cone", "FBFB", 2),
    "wave, straight, clamped": ("wave", 1, "straight", "clamped", 2),
    "wave, curved, FB": ("wave", 1, "curved", "FB", 3),
    "wave, cone, FB": ("wave", 1, "cone", "FB", 2),
    "box, straight, FB": ("boxes", 1, "straight", "FB", 2),
    "two boxes, curved, clamped": ("boxes", 2, "curved", "clamped", 3),
    "polygon, straight, clamped": ("polygon", 1, "straight", "clamped", 2),
    "polygon, curved, FBFB": ("polygon", 1, "curved", "FBFB", 3),
    "roof, straight, clamped": ("roof", 1, "straight", "clamped", 3),
    "roof, curved, FB": ("roof", 1, "curved", "FB", 3),
}


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


class Drawn(NamedTuple):
    """A scene, in plain numbers too, and the control of a scan across it."""

    scene: jw.Scene
    plain: laws.Plain
    control: np.ndarray


def drawn(
    kind: str,
    rng: np.random.Generator,
    steps: int = STEPS,
    *,
    friction: tuple[float, float] | None = None,
    turns: bool = True,
) -> Drawn:
    """A random scene; with friction between these coefficients, the drive turns back for a while, if it `turns`."""
    objects, count, whisker, support, contacts = KINDS[kind]
    rod, plain_rod = _rod(whisker, rng)
    profile, plain_objects = MAKERS[objects](objects, count, rng)
    bases, rest = len(support) // 2 if support != "clamped" else 0, 0.2
    stiffness = float(10 ** rng.uniform(1.3, 2.5))
    springs = tuple(laws.PlainSpring(k, k + 1, stiffness, rest) for k in range(bases))
    held = {
        "clamped": jw.Support.clamped,
        "FB": lambda: jw.Support.fb(stiffness, rest),
        "FBFB": lambda: jw.Support.fbfb(stiffness, rest),
    }[support]()
    control = np.linspace(1.7, -2.4 - rest * bases, steps)
    mu = float(rng.uniform(*friction)) if friction else None
    if friction and turns:
        turn = int(steps * rng.uniform(0.35, 0.65))
        back = control[turn - steps // 6 : turn][::-1]
        control = np.concatenate([control[: turn + 1], back, control[turn - steps // 6 + 1 :]])
    scene = jw.Scene(rod, profile, held, contacts=contacts, friction=mu)
    plain = laws.Plain((plain_rod,) * max(1, bases), plain_objects, springs, friction=mu or 0.0)
    return Drawn(scene, plain, control)


def _rod(whisker: str, rng: np.random.Generator) -> tuple[jw.Whisker, laws.Rod]:
    if whisker == "straight":
        return jw.Whisker(), laws.Rod()
    if whisker == "curved":
        kappa = float(rng.uniform(-1.2, 1.2))
        return jw.Whisker(intrinsic_curvature=kappa), laws.Rod(curvature=lambda s: kappa + 0 * s)
    taper = float(rng.uniform(0.3, 0.7))
    return jw.Whisker(bending_stiffness=Cone(taper)), laws.Rod(stiffness=lambda s: (1 - taper * s) ** 4)


def _wave(_objects: str, _count: int, rng: np.random.Generator):
    uniform = rng.uniform
    amplitude = float(uniform(0.02, 0.12) * rng.choice([-1, 1]))
    numbers = float(uniform(0.3, 0.5)), amplitude, float(uniform(0.2, 0.6)), float(uniform(0.3, 1.0))
    return jw.Graph(Wave(*numbers)), (laws.wave(*numbers),)


def _ovals(objects: str, count: int, rng: np.random.Generator):
    while True:
        x = np.sort(rng.uniform(-1.1, 0.0, count))[::-1]
        distance, a = rng.uniform(0.2, 0.7, count), rng.uniform(0.08, 0.3, count)
        b = a if objects == "circles" else rng.uniform(0.08, 0.3, count)
        middle, size = np.stack([x, distance + b], axis=1), np.maximum(a, b)
        pairs = [(i, j) for i in range(count) for j in range(i)]
        if all(np.linalg.norm(middle[i] - middle[j]) > size[i] + size[j] + APART for i, j in pairs):
            break
    each = [tuple(map(float, values)) for values in zip(distance, a, b, x, strict=True)]
    if objects == "circles":
        profile = tuple(jw.Circle(q, r, position=at) for q, r, _, at in each)
        return profile, tuple(laws.circle(q, r, at) for q, r, _, at in each)
    profile = tuple(jw.Ellipse(q, a, b, position=at) for q, a, b, at in each)
    return profile, tuple(laws.ellipse(*values) for values in each)


def _boxes(_objects: str, count: int, rng: np.random.Generator):
    width = rng.uniform(0.1, 0.5, count)
    gap = rng.uniform(0.1, 0.4, count)
    x = -np.cumsum(gap + width) + width / 2
    each = [tuple(map(float, own)) for own in zip(rng.uniform(0.2, 0.7, count), width, x, strict=True)]
    profile = tuple(jw.Box(q, wide, TOP - q, position=at) for q, wide, at in each)
    return profile, tuple(laws.box(q, wide, TOP - q, at) for q, wide, at in each)


def _polygon(_objects: str, _count: int, rng: np.random.Generator):
    while True:
        a, b, q, x = (float(rng.uniform(*span)) for span in ((0.15, 0.5), (0.05, 0.4), (0.2, 0.5), (-0.6, 0.0)))
        turn = np.sort(rng.uniform(-np.pi, 0.0, int(rng.integers(1, 7))))
        low = np.stack([x + a * np.cos(turn), q + b + b * np.sin(turn)], axis=1)
        corners = np.concatenate([[(x - 1.2 * a, TOP)], low, [(x + 1.2 * a, TOP)]])
        side = np.roll(corners, -1, axis=0) - corners
        behind = np.roll(side, 1, axis=0)
        turns = behind[:, 0] * side[:, 1] - behind[:, 1] * side[:, 0]
        if np.all(turns > BLUNT * np.linalg.norm(side, axis=1) * np.linalg.norm(behind, axis=1)):
            return jw.Polygon(corners), (laws.Outline(corners),)


def _roof(_objects: str, _count: int, rng: np.random.Generator):
    low, x = rng.uniform(0.25, 0.65, 2), float(rng.uniform(-0.6, 0.0))
    left, right = x - rng.uniform(0.15, 0.7), x + rng.uniform(0.15, 0.7)
    peak = float(max(low) + rng.uniform(0.03, 0.3))
    lean = rng.uniform(0.05, 0.4, 2)
    below = (left, low[0]), (x, peak), (right, low[1])
    corners = np.array([(left - lean[0], TOP), *below, (right + lean[1], TOP), (x, TOP + 0.3)])
    return jw.Polygon(corners), (laws.Outline(corners),)


MAKERS = {"circles": _ovals, "ellipses": _ovals, "wave": _wave, "boxes": _boxes, "polygon": _polygon, "roof": _roof}


def checked(drawn: Drawn, result: jw.Result, every: int = 5) -> list[tuple[str, float, int, float]]:
    """The laws of some steps and of the states after events: law, control, step (-1 for an event), value.

    Of `stability` and `spread`, the value is how far it is below zero.
    """
    ok = np.flatnonzero(np.asarray(result.status) == jw.Status.ok)
    states = [(float(result.control[k]), int(k), laws.state_of(result, k)) for k in ok[::every]]
    events = list(result.events)
    states += [(event.control, -1, laws.state_of(event.after)) for event in events]
    # A snap at an event: the state right after the event is not stable.
    lost = [a.control for a, b in pairwise(events) if b.kind in SNAPS and abs(a.control - b.control) < AT_ONCE]
    if events and len(ok) < len(result.status):
        lost.append(events[-1].control)  # the scan may end there
    found = []
    for control, step, state in states:
        values = laws.violations(drawn.plain, control, state)
        if any(held.contacts for held in state) and values["order"] == 0:
            values["spread"] = max(0.0, *(-spread for spread in laws.spreads(drawn.plain, state)), 0.0)
            if (step >= 0 or control not in lost) and not drawn.plain.friction:
                values["stability"] = max(0.0, -laws.stability(drawn.plain, state))
        found += [(law, control, step, value) for law, value in values.items()]
    return found + list(_slides(drawn.plain, result, ok) if drawn.plain.friction else _counts(result, ok))


def _counts(result: jw.Result, ok: np.ndarray):
    """Contacts that begin or end between neighbouring steps although there is no event."""
    phase = np.asarray(result.phase)
    # A tip in an inner corner gets there along one side and leaves along another one, and is two contacts only there.
    count = np.sum(phase != laws.FREE, axis=-1) - np.sum(phase[..., 1:] == laws.TIP, axis=-1)
    events, control = list(result.events), np.asarray(result.control)
    for k in ok:
        if k + 1 >= len(control) or result.status[k + 1] != jw.Status.ok:
            continue
        between = [e for e in events if control[k + 1] <= e.control < control[k]]
        if any(e.kind in SNAPS for e in between):
            continue
        for w in range(count.shape[1]):
            own = [e.kind for e in between if w + 1 in e.whiskers]
            change = own.count(jw.EventKind.touch) - own.count(jw.EventKind.release)
            yield "events", float(control[k]), int(k), float(abs(count[k + 1, w] - count[k, w] - change))


def _slides(plain: laws.Plain, result: jw.Result, ok: np.ndarray):
    """How far contacts have moved against their slip between neighbouring steps without an event, or while they stick.

    The distance along the object is that along the mean of the slopes.
    """
    names = "phase", "slip", "contact_x", "contact_y", "contact_arc", "contact_slope"
    phase, slip, x, y, arc, slope = (np.asarray(getattr(result, name)) for name in names)
    control, events = np.asarray(result.control), [event.control for event in result.events]
    for k in ok:
        if k + 1 not in ok:
            continue
        low, high = sorted(control[[k, k + 1]])
        if any(low - AT_ONCE <= u <= high + AT_ONCE for u in events):
            continue
        side, mean = _sides(plain, result, k), (slope[k] + slope[k + 1]) / 2
        moved = (x[k + 1] - x[k]) * np.cos(mean) + (y[k + 1] - y[k]) * np.sin(mean) - side * (arc[k + 1] - arc[k])
        touches = phase[k] != laws.FREE
        back = np.where(slip[k] == 0, np.abs(moved), -slip[k] * moved) - ROLLED
        yield "slides", float(control[k]), int(k), float(np.max(np.where(touches, np.maximum(back, 0.0), 0.0)))


def _sides(plain: laws.Plain, result: jw.Result, step: int) -> np.ndarray:
    """Whether whiskers run along the object's tangent at their contacts, or against it: 1 or -1; 0 without contact."""
    sides = np.zeros(result.phase.shape[1:])
    for w, (rod, held) in enumerate(zip(plain.rods, laws.state_of(result, step), strict=True)):
        _, there = laws.line_of(rod, held, np.zeros(0))
        for k, (contact, (_, _, angle, _)) in enumerate(zip(held.contacts[::-1], there[-2::-1], strict=True)):
            sides[w, k] = np.sign(np.cos(angle - contact.slope))
    return sides
