"""Laws of a whisker in contact in space, checked by numpy and scipy only: nothing is shared with the package.

The rod is integrated forward, from the base with the reaction of the support to its tip. `violations` returns one
number per law, zero up to the accuracy of the state. `stability` is the smallest eigenvalue of the second variation of
a discrete rod.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, null_space
from scipy.spatial.transform import Rotation

TOLERANCE = 1e-12  # of the integration
POINTS = 400  # of a shaft, half of them beyond the contact, at which its distance from the object is measured
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns d1, d2, d3


class Surface(NamedTuple):
    """The quadric d.M d / 2 + w.d = depth, d = x - inside; negative inside."""

    inside: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray
    depth: float

    def off(self, x):
        """Distance to first order, of points (..., 3)."""
        d = x - self.inside
        gradient = d @ self.matrix + self.slope
        gradient[np.all(gradient == 0, axis=-1)] = 1e-9  # at the centre
        return (np.sum(d * (d @ self.matrix / 2 + self.slope), axis=-1) - self.depth) / np.linalg.norm(
            gradient, axis=-1
        )

    def normal_and_curvature(self, x):
        gradient = (x - self.inside) @ self.matrix + self.slope
        return gradient / np.linalg.norm(gradient), self.matrix / np.linalg.norm(gradient)


class RoundedCore(NamedTuple):
    """The sum of G(|u| - h) = size^2 / 2, u the coordinates along the rows of `axes`; negative inside.

    G'' is 0 below -w, 1 above w, and between them the cubic with slopes 0 at its ends.
    """

    inside: np.ndarray
    axes: np.ndarray
    half: np.ndarray
    width: np.ndarray
    size: float

    def _beyond(self, x):
        """G with two derivatives by |u|, and the signs of u."""
        u = (x - self.inside) @ self.axes.T
        v = np.abs(u) - self.half
        w = np.broadcast_to(self.width, v.shape)
        g, rate, bend = np.where(v > 0, v**2 / 2 + w**2 / 10, 0.0), np.maximum(v, 0.0), (v >= 0).astype(float)
        strip = np.abs(v) < w
        t, w = v[strip] / w[strip], w[strip]
        bend[strip] = 1 / 2 + 3 / 4 * t - t**3 / 4
        rate[strip] = w * (3 / 16 + t / 2 + 3 / 8 * t**2 - t**4 / 16)
        g[strip] = w**2 * (1 / 20 + 3 / 16 * t + t**2 / 4 + t**3 / 8 - t**5 / 80)
        return g, rate, bend, np.sign(u)

    def off(self, x):
        """Distance to first order, of points (..., 3); deep inside, that from the nearest face of the core."""
        g, rate, _, _ = self._beyond(x)
        total, slope = np.sum(g, axis=-1), np.linalg.norm(rate, axis=-1)
        deep = np.max(np.abs((x - self.inside) @ self.axes.T) - self.half, axis=-1) - self.size
        shallow = total > self.size**2 / 8
        return np.where(shallow, (total - self.size**2 / 2) / np.where(shallow, slope, 1.0), deep)

    def normal_and_curvature(self, x):
        _, rate, bend, sign = self._beyond(x)
        size = np.linalg.norm(rate)
        return (rate * sign / size) @ self.axes, self.axes.T @ np.diag(bend / size) @ self.axes


class Apart(NamedTuple):
    """Several objects that are apart from each other; a point on one of them is outside all others."""

    each: tuple[Surface | RoundedCore, ...]

    def off(self, x):
        """Distance from the nearest object to first order, of points (..., 3)."""
        return np.min([one.off(x) for one in self.each], axis=0)

    def normal_and_curvature(self, x):
        nearest = np.argmin([one.off(x) for one in self.each])
        return self.each[nearest].normal_and_curvature(x)


class Plain(NamedTuple):
    """A scene with one whisker in plain numbers."""

    surface: Surface | RoundedCore | Apart
    placement: Callable  # control -> position of the mount without springs, rotation of the drive, of the mount's frame
    length: float = 1.0
    stiffness: Callable = lambda s: 1.0  # B(s)
    torsion_ratio: float = 2 / 3
    lateral_ratio: float = 1.0  # stiffness about d1 divided by B
    curvature: Callable = lambda s: np.zeros(3)  # about d1, d2 and d3
    springs: np.ndarray = np.full(3, np.inf)  # along the axes of the drive
    tilting: np.ndarray = np.full(3, np.inf)  # about them


class State(NamedTuple):
    """A state of a whisker: the fields of a result, without the axis of whiskers."""

    control: float
    phase: int  # 0 free, 1 tip, 2 tangential
    force: np.ndarray
    moment: np.ndarray
    base: np.ndarray
    rotation: np.ndarray
    contact_force: float
    contact_arc: float
    contact: np.ndarray


def state_of(state, control: float, whisker: int = 0) -> State:
    """One step of a result, or the state of an event."""
    names = ("contact_force", "contact_arc")
    at = np.array([float(getattr(state, f"{name}")[whisker]) for name in ("base_x", "base_y", "base_z")])
    contact = np.array([float(getattr(state, f"contact_{name}")[whisker]) for name in "xyz"])
    force, moment = (np.array([float(getattr(state, f"{f}{a}")[whisker]) for a in "xyz"]) for f in "fm")
    rotation = np.asarray(state.base_rotation[whisker])
    f, arc = (float(getattr(state, name)[whisker]) for name in names)
    return State(float(control), int(state.phase[whisker]), force, moment, at, rotation, f, arc, contact)


class Shaft(NamedTuple):
    """A loaded whisker: its centreline up to the contact, the whole of it, and its elastic energy."""

    arc: np.ndarray
    points: np.ndarray
    at_contact: np.ndarray  # position
    directors: np.ndarray  # at the contact
    energy: float  # with that of the springs


def _hat(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _cross(a, b):
    # numpy.cross takes as long as all the rest.
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def _rods(plain: Plain, states: list[State], start: np.ndarray, stop: np.ndarray, y, loaded: bool, at):
    """Rods of several states between two arc lengths each, at these shares of the way: (states, 13, shares)."""
    force, moment, base = (np.array([getattr(s, name) for s in states]) for name in ("force", "moment", "base"))
    span = stop - start

    def slope(t, y):
        y = y.reshape(-1, 13)
        r, d, s = y[:, :3], y[:, 3:12].reshape(-1, 3, 3), start + t * span
        stiffness = np.multiply.outer(
            np.broadcast_to(plain.stiffness(s), s.shape), [plain.lateral_ratio, 1.0, plain.torsion_ratio]
        )
        m = _cross(r - base, force) - moment if loaded else np.zeros_like(r)
        bend = np.einsum("nij,ni->nj", d, m) / stiffness
        k = plain.curvature(s) + bend
        turned = _cross(d, k[:, None])  # rows of d times the matrix of k
        rates = [d[:, :, 2], turned.reshape(-1, 9), np.sum(stiffness * bend**2, axis=1, keepdims=True) / 2]
        return (span[:, None] * np.concatenate(rates, axis=1)).ravel()

    found = solve_ivp(slope, (0.0, 1.0), y.ravel(), method="DOP853", rtol=TOLERANCE, atol=TOLERANCE, t_eval=at).y
    return found.reshape(len(states), 13, -1)


def shafts(plain: Plain, states: list[State]) -> list[Shaft]:
    """The whiskers of some states, from their bases and the reactions there."""
    start = np.array([np.concatenate([s.base, s.rotation.ravel(), [0.0]]) for s in states])
    contact, share = np.array([s.contact_arc if s.phase else 0.0 for s in states]), np.linspace(0.0, 1.0, POINTS // 2)
    below = _rods(plain, states, 0 * contact, contact, start, True, share)
    beyond = _rods(plain, states, contact, 0 * contact + plain.length, below[:, :, -1], False, share)
    found = []
    for k, state in enumerate(states):
        at, points = below[k, :, -1], np.concatenate([below[k, :3].T, beyond[k, :3].T[1:]])
        arc = np.concatenate([contact[k] * share, contact[k] + (plain.length - contact[k]) * share[1:]])
        displacement, turn = _yield_of(plain, state)
        springs = sum(np.sum(k[np.isfinite(k)] * v[np.isfinite(k)] ** 2) / 2 for k, v in
                      ((plain.springs, displacement), (plain.tilting, turn)))  # fmt: skip
        found.append(Shaft(arc, points, at[:3], at[3:12].reshape(3, 3), at[12] + springs))
    return found


def shaft(plain: Plain, state: State) -> Shaft:
    """The whisker of one state."""
    return shafts(plain, [state])[0]


def _yield_of(plain: Plain, state: State):
    """Displacement and rotation vector of the base in the frame of the drive."""
    position, drive, mount = plain.placement(state.control)
    return drive.T @ (state.base - position), Rotation.from_matrix(
        drive.T @ state.rotation @ (drive.T @ mount).T
    ).as_rotvec()


def _left_jacobian(turn):
    angle = np.linalg.norm(turn)
    if angle < 1e-6:
        return np.eye(3) + _hat(turn) / 2
    a, b = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) + a * _hat(turn) + b * _hat(turn) @ _hat(turn)


def violations(plain: Plain, state: State, whole: Shaft | None = None) -> dict[str, float]:
    """How far a state is from each law; `whole` is its shaft if that is known."""
    displacement, turn = _yield_of(plain, state)
    _, drive, _ = plain.placement(state.control)
    whole = shaft(plain, state) if whole is None else whole
    load, moment = drive.T @ -state.force, drive.T @ -state.moment
    found = {
        "springs": np.max(np.abs(displacement - load / plain.springs)),
        "tilting": np.max(np.abs(turn - _left_jacobian(turn).T @ moment / plain.tilting)),
        "depth": -np.min(plain.surface.off(whole.points)),
    }
    if not state.phase:
        return found | {"free": np.max(np.abs([*state.force, *state.moment]))}
    normal, _ = plain.surface.normal_and_curvature(state.contact)
    tangent = whole.directors[:, 2]
    size = 1 + np.linalg.norm(state.force)
    found |= {
        "contact": np.max(np.abs(whole.at_contact - state.contact)),
        "moment": np.max(np.abs(-state.moment + np.cross(whole.at_contact - state.base, state.force))) / size,
        "surface": abs(plain.surface.off(state.contact)),
        "normal": np.max(np.abs(state.force + state.contact_force * normal)) / size,
        "push": max(-state.contact_force, 0.0),
        "wrench": abs(state.force @ state.moment) / size**2,
    }
    if state.phase == 1:
        return found | {"arc": abs(state.contact_arc - plain.length), "tip": max(tangent @ normal, 0.0)}
    beyond = max(state.contact_arc - plain.length, 0.0)
    return found | {
        "arc": beyond,
        "tangential": abs(tangent @ normal),
        "spread": max(-spread(plain, state, whole), 0.0),
    }


def spread(plain: Plain, state: State, whole: Shaft) -> float:
    """How fast shaft and surface part on both sides of a tangential contact: g_ss, a curvature."""
    normal, curvature = plain.surface.normal_and_curvature(state.contact)
    first, second, tangent = whole.directors.T
    bent = plain.curvature(state.contact_arc)
    return float(normal @ (bent[1] * first - bent[0] * second) + tangent @ curvature @ tangent)


def stability(plain: Plain, state: State, elements: int = 60) -> float:
    """Smallest eigenvalue of the second variation, relative to the elastic energy; positive if the state is stable."""
    arc = np.linspace(0.0, state.contact_arc, elements + 1)
    start = np.concatenate([state.base, state.rotation.ravel(), [0.0]])
    h = state.contact_arc / elements
    middle = arc[:-1] + h / 2
    shares = np.append(middle / state.contact_arc, 1.0)
    (y,) = _rods(plain, [state], np.zeros(1), np.array([state.contact_arc]), start, True, shares)
    force = -state.force
    n = 3 * (elements + 1) + 3
    q, mass, slide = np.zeros((n, n)), np.zeros((n, n)), np.zeros((3, n))
    slide[:, -3:] = np.eye(3)
    for k, s in enumerate(middle):
        r, d = y[:3, k], y[3:12, k].reshape(3, 3)
        t = d[:, 2]
        m = -state.moment + np.cross(r - state.base, state.force)
        at = slice(3 * k, 3 * k + 6)
        mean = np.hstack([np.eye(3), np.eye(3)]) / 2
        rate = np.hstack([-np.eye(3), np.eye(3)]) / h
        stiffness = d @ np.diag(plain.stiffness(s) * np.array([plain.lateral_ratio, 1.0, plain.torsion_ratio])) @ d.T
        elastic = h * rate.T @ stiffness @ rate
        # m.(phi x phi') = phi.(phi' x m) = -phi.(m x phi')
        twist = h * mean.T @ _hat(m) @ rate
        lever = h * mean.T @ ((force @ t) * np.eye(3) - (np.outer(force, t) + np.outer(t, force)) / 2) @ mean
        q[at, at] += elastic + (twist + twist.T) / 2 + lever
        mass[at, at] += elastic
        slide[:, at] += -h * _hat(t) @ mean
    normal, curvature = plain.surface.normal_and_curvature(state.contact)
    d = y[3:12, -1].reshape(3, 3)
    t, f = d[:, 2], state.contact_force
    q -= f * slide.T @ curvature @ slide
    if state.phase == 2:
        bent = plain.curvature(state.contact_arc)
        spread = normal @ (bent[1] * d[:, 0] - bent[0] * d[:, 1]) + t @ curvature @ t
        turned = t @ curvature @ slide
        turned[-6:-3] += np.cross(t, normal)  # n.(phi x t) = phi.(t x n)
        q += f * np.outer(turned, turned) / spread
    _, drive, _ = plain.placement(state.control)
    keep = np.ones(n, bool)
    for of, stiffness in ((slice(n - 3, n), plain.springs), (slice(0, 3), plain.tilting)):
        if not np.any(np.isfinite(stiffness)):
            keep[of] = False
            continue
        assert np.all(np.isfinite(stiffness)), "springs along all axes or none"
        matrix = drive @ np.diag(stiffness) @ drive.T
        mass[of, of] += matrix
        if of.start:
            q[of, of] += matrix
        else:
            q[of, of] += _second_of_turn(plain, state)
    free = null_space((normal @ slide)[None, keep])
    q, mass = (free.T @ part[np.ix_(keep, keep)] @ free for part in (q, mass))
    return float(eigh(q, mass, eigvals_only=True, subset_by_index=[0, 0])[0])


def _second_of_turn(plain: Plain, state: State):
    """Second derivatives of the energy of the tilting springs by a rotation vector that turns the base in space."""
    _, drive, _ = plain.placement(state.control)
    turn = Rotation.from_rotvec(_yield_of(plain, state)[1])

    def energy(phi):
        at = (Rotation.from_rotvec(drive.T @ phi) * turn).as_rotvec()
        return np.sum(plain.tilting * at**2) / 2

    h, unit = 1e-4, np.eye(3)
    return np.array([[
        (energy(h * (a + b)) - energy(h * (a - b)) - energy(h * (b - a)) + energy(-h * (a + b))) / (4 * h * h)
        for a in unit] for b in unit])  # fmt: skip


def power(plain: Plain, state: State) -> float:
    """Power of the drive per rate of the control: the increase of the stored energy."""
    h = 1e-5
    (before, turned, _), (after, further, _) = (plain.placement(state.control + step) for step in (-h, h))
    at = plain.placement(state.control)[0]
    turn = Rotation.from_matrix(further @ turned.T).as_rotvec() / (2 * h)
    # The reaction is transmitted by the springs to the drive, at the displaced base.
    rate = (after - before) / (2 * h) + np.cross(turn, state.base - at)
    return float(state.force @ rate + state.moment @ turn)
