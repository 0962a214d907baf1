"""Laws of whiskers with several contacts each, checked by numpy and scipy only: nothing is shared with the package.

Every rod is integrated from its base with the reaction of the support, and each contact force is taken off where it
acts. `violations` returns one number per law, zero up to the accuracy of the state. `stability` is the smallest
eigenvalue of the second variation of the energy of discrete rods.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, null_space

ROD = 1e-11  # relative tolerance of the integration
POINTS = 2000  # of a shaft, at which its depth in the objects is measured
FREE, TIP, TANGENTIAL = range(3)  # phases
SLIGHT = 1e-6  # EI/L^2: contacts that push less are about to begin or to end, and do not hold the whisker
SHARP = 1e6  # curvature of a corner: of an arc that is small enough for its radius to change nothing
FLAT = 1e-6  # difference of curvatures below which a shaft lies on a side
NODES = 160  # of a discrete rod
UPRIGHT = np.pi / 2  # angle of an unloaded whisker at its base


class Shape(NamedTuple):
    """What a function F(x, y), positive outside the object, is like at some points."""

    off: np.ndarray  # distance from the object to first order; negative inside
    normal: np.ndarray  # (..., 2), outward
    curvature: np.ndarray  # of the level line, positive if the object is convex


def shape_of(f, fx, fy, fxx, fxy, fyy) -> Shape:
    """The shape from a function and its derivatives."""
    size = np.maximum(np.hypot(fx, fy), 1e-12)  # zero at the centre of an ellipse
    bend = (fxx * fy**2 - 2 * fxy * fx * fy + fyy * fx**2) / size**3
    return Shape(f / size, np.stack([fx / size, fy / size], axis=-1), bend)


class Oval(NamedTuple):
    """An ellipse with this centre and these half axes, of which the inside is solid, or all that is outside."""

    x: float
    y: float
    a: float
    b: float
    hollow: bool = False

    def __call__(self, x, y) -> Shape:
        sign = -1.0 if self.hollow else 1.0
        u, v, one = (x - self.x) / self.a**2, (y - self.y) / self.b**2, np.ones_like(x)
        f = (x - self.x) * u + (y - self.y) * v - 1
        parts = f, 2 * u, 2 * v, 2 * one / self.a**2, 0 * one, 2 * one / self.b**2
        return shape_of(*(sign * part for part in parts))


class Curve(NamedTuple):
    """All that is above y = g(x), with the derivatives of g."""

    g: Callable
    slope: Callable
    bend: Callable

    def __call__(self, x, y) -> Shape:
        one = np.ones_like(x)
        return shape_of(self.g(x) - y, self.slope(x), -one, self.bend(x), 0 * one, 0 * one)


def _cross(a, b) -> float:
    return a[0] * b[1] - a[1] * b[0]


class Outline(NamedTuple):
    """A polygon by its corners, counter-clockwise; inner corners are those at which it turns to the right."""

    corners: np.ndarray

    @property
    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        """The vectors along all sides, and their outward normals."""
        along = np.roll(self.corners, -1, axis=0) - self.corners
        size = np.linalg.norm(along, axis=1)[:, None]
        return along, np.stack([along[:, 1], -along[:, 0]], axis=1) / size

    def __call__(self, x, y) -> Shape:
        at, (along, normals) = np.stack([x, y], axis=-1)[..., None, :], self.sides
        share = np.clip(np.sum((at - self.corners) * along, axis=-1) / np.sum(along**2, axis=1), 0.0, 1.0)
        away = np.linalg.norm(at - self.corners - share[..., None] * along, axis=-1)
        # The inside, of which every outward ray crosses an odd number of sides.
        (low, high), height = np.sort([self.corners[:, 1], (self.corners + along)[:, 1]], axis=0), at[..., 1]
        flat = along[:, 1] == 0
        meets = self.corners[:, 0] + (height - self.corners[:, 1]) * along[:, 0] / np.where(flat, 1.0, along[:, 1])
        crossed = ~flat & (low <= height) & (height < high) & (meets > at[..., 0])
        inside = np.sum(crossed, axis=-1) % 2 == 1
        number, off = np.argmin(away, axis=-1), np.min(away, axis=-1)
        return Shape(np.where(inside, -off, off), normals[number], np.zeros_like(off))

    def touched(self, x: float, y: float, normal: np.ndarray, *, tip: bool = False) -> tuple[float, bool]:
        """How far a contact is from the next place that can push along its normal, and whether that is a corner.

        A side pushes along its own normal, a corner along all those between the normals of its sides. An inner corner
        does so if a tip is in it.
        """
        at, (along, normals) = np.array([x, y]), self.sides
        found = []
        for k, corner in enumerate(self.corners):
            share = np.clip((at - corner) @ along[k] / (along[k] @ along[k]), 0.0, 1.0)
            aside = np.linalg.norm(normal - normals[k])
            found.append((max(np.linalg.norm(at - corner - share * along[k]), aside), False))
            ways = along[[k - 1, k]] / np.linalg.norm(along[[k - 1, k]], axis=1)[:, None]
            turn = np.sign(_cross(*ways))
            if turn > 0 or tip:
                tangent = np.array([-normal[1], normal[0]])  # on the left of the side before, right of the side after
                beyond = max(0.0, -turn * _cross(ways[0], tangent), -turn * _cross(tangent, ways[1]))
                beyond = beyond if tangent @ (ways[0] + ways[1]) > 0 else np.inf
                found.append((max(np.linalg.norm(at - corner), beyond), True))
        return min(found)


def circle(distance: float, radius: float, position: float = 0.0) -> Oval:
    """A circle by its lowest point."""
    return Oval(position, distance + radius, radius, radius)


def ellipse(distance: float, a: float, b: float, position: float = 0.0) -> Oval:
    """An ellipse by its lowest point."""
    return Oval(position, distance + b, a, b)


def pipe(radius: float, position: float, height: float) -> Oval:
    """The inside of a circle by its centre."""
    return Oval(position, height, radius, radius, hollow=True)


def box(distance: float, width: float, height: float, position: float = 0.0) -> Outline:
    """A box by the centre of its bottom."""
    left, right, top = position - width / 2, position + width / 2, distance + height
    return Outline(np.array([(left, top), (left, distance), (right, distance), (right, top)]))


def wave(distance: float, amplitude: float, wavelength: float, a: float, position: float = 0.0) -> Curve:
    """A parabola with waves: distance + amplitude (1 - cos(k (x - position))) + a (x - position)^2."""
    k = 2 * np.pi / wavelength
    return Curve(
        lambda x: distance + amplitude * (1 - np.cos(k * (x - position))) + a * (x - position) ** 2,
        lambda x: amplitude * k * np.sin(k * (x - position)) + 2 * a * (x - position),
        lambda x: amplitude * k**2 * np.cos(k * (x - position)) + 2 * a,
    )


class Rod(NamedTuple):
    """A whisker by itself."""

    length: float = 1.0
    stiffness: Callable = np.ones_like  # EI(s)
    curvature: Callable = np.zeros_like  # kappa0(s)


class PlainSpring(NamedTuple):
    """A spring along x from one base to another, numbered from 1, or from the drive, which is 0."""

    first: int
    second: int
    stiffness: float
    rest_length: float


class Plain(NamedTuple):
    """A scene in plain numbers. Without springs, all bases are clamped to the drive."""

    rods: tuple[Rod, ...]
    objects: tuple[Callable, ...]
    springs: tuple[PlainSpring, ...] = ()
    along_y: float = np.inf  # stiffness of the springs of every base to y = 0
    turning: float = np.inf  # and to the upright
    friction: float = 0.0  # coefficient


class Contact(NamedTuple):
    """One contact."""

    phase: int
    force: float
    arc: float
    x: float
    y: float
    slope: float
    number: int  # of the object, from 0
    normal_part: float | None = None  # of the force, with friction
    drag: float = 0.0  # its part along the object
    slip: int = 0

    @property
    def normal(self) -> np.ndarray:
        return np.array([np.sin(self.slope), -np.cos(self.slope)])

    @property
    def along(self) -> np.ndarray:
        return np.array([np.cos(self.slope), np.sin(self.slope)])

    @property
    def push(self) -> float:
        """The part of the force along the normal."""
        return self.force if self.normal_part is None else self.normal_part

    @property
    def pushes(self) -> np.ndarray:
        """The force on the whisker."""
        return self.push * self.normal + self.drag * self.along


class Held(NamedTuple):
    """A whisker in a state: its base, the reaction of the support, and its contacts from the base to the tip."""

    x: float
    y: float
    angle: float
    fx: float
    fy: float
    mz: float
    contacts: tuple[Contact, ...]
    places: tuple[int, ...]  # of all contacts in the result, from the tip to the base: their phases


def state_of(state, step: int | None = None) -> tuple[Held, ...]:
    """The whiskers at one step of a result, or in the state of an event."""

    def field(name):
        values = np.asarray(getattr(state, name))
        return values if step is None else values[step]

    names = "base_x", "base_y", "base_angle", "fx", "fy", "mz"
    bases = np.stack([field(name) for name in names], axis=1).tolist()
    kinds = "phase", "contact_force", "contact_arc", "contact_x", "contact_y", "contact_slope"
    each = [field(name) for name in kinds]
    one = state.contact_object is None
    numbers = np.zeros_like(each[0]) if one else field("contact_object") - 1
    none = np.zeros_like(each[1])
    parts = each[1], none, none.astype(int)
    if state.slip is not None:
        parts = field("normal_force"), field("friction_force"), field("slip")

    def ends(w, k):
        return [values[w, k].item() for values in (numbers, *parts)]

    found = []
    for w, base in enumerate(bases):
        places = tuple(each[0][w].tolist())
        rows = [
            Contact(phase, *(float(values[w, k]) for values in each[1:]), *ends(w, k))  # pyright: ignore
            for k, phase in enumerate(places)
            if phase != FREE
        ]
        found.append(Held(*base, tuple(rows[::-1]), places))  # pyright: ignore
    return tuple(found)


class Line(NamedTuple):
    """A loaded rod: positions, angles and moments at some arc lengths; fields (points,)."""

    arc: np.ndarray
    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    moment: np.ndarray


def line_of(rod: Rod, held: Held, arcs: np.ndarray) -> tuple[Line, np.ndarray]:
    """The rod at these arc lengths, and at its contacts and its tip: x, y, angle, moment (contacts + 1, 4)."""
    y, at, parts = np.array([held.x, held.y, UPRIGHT + held.angle, -held.mz]), 0.0, [np.zeros((4, 0))]
    inner, there = np.array([-held.fx, -held.fy]), []
    for end, force in [*((c.arc, c.pushes) for c in held.contacts), (rod.length, np.zeros(2))]:

        def slope(s, y, inner=inner):
            cos, sin = np.cos(y[2]), np.sin(y[2])
            bend = rod.curvature(s) + y[3] / rod.stiffness(s)
            return [cos, sin, bend, -cos * inner[1] + sin * inner[0]]

        within = arcs[(arcs >= at) & ((arcs < end) | (end == rod.length))]
        if end > at:
            found = solve_ivp(slope, (at, end), y, method="DOP853", rtol=ROD, atol=ROD, dense_output=True)
            parts.append(found.sol(within) if within.size else np.zeros((4, 0)))
            y = found.y[:, -1]
        there.append(y)
        at, inner = max(at, end), inner - force
    return Line(arcs, *np.concatenate(parts, axis=1)), np.array(there)


def violations(plain: Plain, control: float, state: tuple[Held, ...]) -> dict[str, float]:
    """How far a state is from each law, the largest value of all whiskers."""
    found = {"springs": _springs(plain, control, state)}
    for rod, held in zip(plain.rods, state, strict=True):
        for law, value in _of_whisker(plain, rod, held).items():
            found[law] = max(found.get(law, 0.0), value if np.isfinite(value) else np.inf)
    return found


def _springs(plain: Plain, control: float, state: tuple[Held, ...]) -> float:
    """How far the bases are from where their loads move them."""
    off = [max(abs(held.y + held.fy / plain.along_y), abs(held.angle + held.mz / plain.turning)) for held in state]
    x = np.array([control, *(held.x for held in state)])
    if not plain.springs:
        return max(*off, np.max(np.abs(x[1:] - control)))
    pull, stiffness = -np.array([0.0, *(held.fx for held in state)]), np.zeros(x.size)
    for spring in plain.springs:
        force = spring.stiffness * (x[spring.second] - x[spring.first] - spring.rest_length)
        pull[spring.second] -= force
        pull[spring.first] += force
        stiffness[[spring.first, spring.second]] += spring.stiffness
    return max(*off, np.max(np.abs(pull[1:] / stiffness[1:])))


def _of_whisker(plain: Plain, rod: Rod, held: Held) -> dict[str, float]:
    count, arcs = len(held.contacts), np.linspace(0.0, rod.length, POINTS)
    places, ends = np.array(held.places), [0.0, *(c.arc for c in held.contacts), rod.length]
    found = {
        # A tip in an inner corner is two contacts.
        "places": float(
            np.any((places[1:] != FREE) & (places[:-1] == FREE) | (places[1:] == TIP) & (places[:-1] != TIP))
        ),
        "order": max(0.0, *(a - b for a, b in pairwise(ends))),
    }
    if found["order"] > 0:
        return found
    line, there = line_of(rod, held, arcs)
    forces = sum((c.pushes for c in held.contacts), np.zeros(2))
    size = 1 + sum(abs(c.force) for c in held.contacts)
    found |= {
        "balance": float(np.max(np.abs(forces + np.array([held.fx, held.fy])))) / size,
        "end": abs(there[-1, 3]) / size,
        "depth": max(depth(one, line) for one in plain.objects),
    }
    for contact, (x, y, angle, _) in zip(held.contacts, there[:count], strict=True):
        one = plain.objects[contact.number]
        into = -float(contact.normal @ [np.cos(angle), np.sin(angle)])
        tip = contact.phase == TIP
        own = {
            "position": max(abs(x - contact.x), abs(y - contact.y)),
            "surface": abs(float(one(np.array(contact.x), np.array(contact.y)).off)),
            "normal": _turned(one, contact),
            "push": max(-contact.push, 0.0),
            "cone": max(abs(contact.drag) - plain.friction * contact.push, 0.0) / size,
            "slip": abs(contact.drag + contact.slip * plain.friction * contact.push) / size if contact.slip else 0.0,
            "parallel": max(-into, 0.0) if tip else abs(into),
            "tip": abs(contact.arc - rod.length) if tip else 0.0,
        }
        found |= {law: max(found.get(law, 0.0), value) for law, value in own.items()}
    return found


def _turned(one: Callable, contact: Contact) -> float:
    """How far the normal of a contact is from those of its place."""
    if isinstance(one, Outline):
        return float(one.touched(contact.x, contact.y, contact.normal, tip=contact.phase == TIP)[0])
    return float(np.max(np.abs(one(np.array(contact.x), np.array(contact.y)).normal - contact.normal)))


def _curvature(one: Callable, contact: Contact) -> float:
    """Curvature of an object at a contact."""
    if isinstance(one, Outline):
        return SHARP if one.touched(contact.x, contact.y, contact.normal)[1] else 0.0
    return float(one(np.array(contact.x), np.array(contact.y)).curvature)


def depth(one: Callable, line: Line) -> float:
    """How deep a rod is in an object; between points, where three neighbours have a parabola's peak."""
    inside = -one(line.x, line.y).off
    if isinstance(one, Outline):
        return max(float(np.max(inside)), 0.0)  # distances from corners are no parabolas
    a, b, c = inside[:-2], inside[1:-1], inside[2:]
    peak, bend = (b >= a) & (b >= c), a - 2 * b + c
    higher = np.where(peak & (bend < 0), b - (c - a) ** 2 / (8 * np.where(bend < 0, bend, -1.0)), b)
    return max(float(np.max(inside)), float(np.max(higher)), 0.0)


def spreads(plain: Plain, state: tuple[Held, ...]) -> list[float]:
    """The curvatures at which rod and object part at tangential contacts; negative where the rod passes through."""
    return [
        _spread(plain, rod, contact, at)
        for rod, held in zip(plain.rods, state, strict=True)
        for contact, at in zip(held.contacts, line_of(rod, held, np.zeros(0))[1], strict=False)
        if contact.phase == TANGENTIAL
    ]


def _spread(plain: Plain, rod: Rod, contact: Contact, at: np.ndarray) -> float:
    _, _, angle, moment = at
    left = np.array([-np.sin(angle), np.cos(angle)])
    bend = rod.curvature(contact.arc) + moment / rod.stiffness(contact.arc)
    return _curvature(plain.objects[contact.number], contact) + float(contact.normal @ left * bend)


def stability(plain: Plain, state: tuple[Held, ...], nodes: int = NODES) -> float:
    """Smallest eigenvalue of the second variation, relative to the elastic energy; positive if the state is stable.

    Unknowns are the turns of all rods at nodes, linear between them, and the displacements of the bases. The energy
    minus force times distance at each contact varies where the distances keep their values to first order.
    """
    rods = [_variation(plain, *each, nodes) for each in zip(plain.rods, state, strict=True)]
    sizes = [len(q) for q, _, _ in rods]
    starts = np.cumsum([0, *sizes])
    q, mass = np.zeros((starts[-1], starts[-1])), np.zeros((starts[-1], starts[-1]))
    holds = np.zeros((0, starts[-1]))
    for (own_q, own_mass, own_holds), start, size in zip(rods, starts, sizes, strict=False):
        at = slice(start, start + size)
        q[at, at], mass[at, at] = own_q, own_mass
        holds = np.vstack([holds, np.zeros((len(own_holds), starts[-1]))])
        holds[len(holds) - len(own_holds) :, at] = own_holds
    keep, bases = np.ones(starts[-1], bool), starts[:-1]  # each begins with x, y and the turn of the base
    for spring in plain.springs:
        way = np.zeros(starts[-1])
        way[bases[spring.second - 1]] += 1
        if spring.first:
            way[bases[spring.first - 1]] -= 1
        for matrix in (q, mass):
            matrix += spring.stiffness * np.outer(way, way)
    keep[bases] = bool(plain.springs)
    for shift, stiffness in ((1, plain.along_y), (2, plain.turning)):
        keep[bases + shift] = np.isfinite(stiffness)
        if np.isfinite(stiffness):
            for matrix in (q, mass):
                matrix[bases + shift, bases + shift] += stiffness
    q, mass, holds = q[np.ix_(keep, keep)], mass[np.ix_(keep, keep)], holds[:, keep]
    free = null_space(holds) if len(holds) else np.eye(len(q))
    return float(eigh(free.T @ q @ free, free.T @ mass @ free, eigvals_only=True, subset_by_index=[0, 0])[0])


def _variation(plain: Plain, rod: Rod, held: Held, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Second variation of a rod's energy, the elastic part of it, and first variations of the distances."""
    touching = [c for c in held.contacts if c.force > SLIGHT]
    ends = np.unique([0.0, *(c.arc for c in touching), rod.length])
    counts = [max(2, int(np.ceil(nodes * (b - a) / rod.length))) for a, b in pairwise(ends)]
    parts = [np.linspace(*span, count + 1)[:-1] for span, count in zip(pairwise(ends), counts, strict=True)]
    s = np.append(np.concatenate(parts), rod.length)
    h, middle = np.diff(s), (s[1:] + s[:-1]) / 2
    line, there = line_of(rod, held, middle)
    size = s.size + 2  # x and y of the base, then the turns at the nodes, of which the first is that of the base
    mean, rate = np.zeros((h.size, size)), np.zeros((h.size, size))
    rows = np.arange(h.size)
    mean[rows, rows + 2] = mean[rows, rows + 3] = 0.5
    rate[rows, rows + 2], rate[rows, rows + 3] = -1 / h, 1 / h
    elastic = rate.T @ ((rod.stiffness(middle) * h)[:, None] * rate)
    q, holds = elastic.copy(), []
    tangent = np.stack([np.cos(line.angle), np.sin(line.angle)])
    left = np.stack([-tangent[1], tangent[0]])
    for contact, at in zip(held.contacts, there, strict=False):
        if contact.force <= SLIGHT:
            continue
        before = middle < contact.arc
        weight = np.where(before, h, 0.0)
        moved = (left * weight) @ mean  # (2, size)
        moved[[0, 1], [0, 1]] += 1
        normal = contact.normal
        along = np.array([-normal[1], normal[0]])
        curvature = _curvature(plain.objects[contact.number], contact)
        second = -mean.T @ ((weight * (normal @ tangent))[:, None] * mean)
        second += curvature * np.outer(along @ moved, along @ moved)
        if contact.phase == TANGENTIAL:
            cos, sin = np.cos(at[2]), np.sin(at[2])
            turn = np.zeros(size)
            turn[2 + int(np.argmin(np.abs(s - contact.arc)))] = 1
            slope = normal @ [-sin, cos] * turn + curvature * (along @ [cos, sin]) * (along @ moved)
            spread = _spread(plain, rod, contact, at)
            if isinstance(plain.objects[contact.number], Outline) and spread < FLAT:
                holds.append(slope)  # a straight shaft lies on a side: it cannot turn without being lifted
            else:
                second -= np.outer(slope, slope) / spread
        q -= contact.force * second
        holds.append(normal @ moved)
    return q, elastic, np.array(holds).reshape(-1, size)
