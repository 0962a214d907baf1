"""Exact quasi-static scans of uniform straight whiskers by elliptic integrals: the reference of the tests.

Only conventions are shared with the package: bases at (base_x, 0), clamped along +y, the object above them,
its vertex at (0, distance), scanned towards -x; reactions of the support on the whisker; units L = EI = 1.

One clamped whisker. theta = phi - alpha is a pendulum, theta'' = f cos(theta), with theta' = 0 at the contact. From
sin((pi/2 - theta)/2) = k sin(t), where t = t0 at the base and pi/2 at the contact, sin(alpha/2) = k sin(t0) and

    sqrt(f) s1 = K(k) - F(t0, k),    sqrt(f) T = 2 k cos(t0),    sqrt(f) N = 2 [E(k) - E(t0, k)] - [K(k) - F(t0, k)],

where T and N are the coordinates of the contact point relative to the base, along and across the object's tangent. With
the complementary amplitude tan(psi) = cot(t0) / sqrt(1 - k^2), the differences are, without cancellation,
K(k) - F(t0, k) = F(psi, k) and E(k) - E(t0, k) = E(psi, k) - k^2 sin(t0) sin(psi). Tangential contact: k = sqrt(1/2),
and f follows from y = eta. Tip contact: s1 = 1, and y = eta is one equation for k. The curve parameter is
p = (1 - 2 t0 / pi)^2: 0 at first touch (everything is regular in p, and f proportional to it), 1 at the vertex, 4 where
the base is unbent. A free whisker has p < 0, where -p is the clearance.

A network. Equilibria are the roots of x0(p) - u - rest - C F_x(p) in (p, u), with the flexibility matrix C. They are
followed by pseudo-arclength steps. Between two phase borders the equations are analytic. Therefore every whisker stays
on its piece of the curve until an event switches it, and every event is a bracketed root on the path. Stability is lost
where det(-dx0/dp + C dF_x/dp) vanishes: at the clamped fold where C = 0, at det(K - dF_x/dx0) = 0 elsewhere. The
overdamped flow of the bases at fixed u then leads to the next equilibrium; a whisker that passes its clamped fold slips
and is then free or bent the other way (mirrored). The steps use Chebyshev series of x0 and F_x, accurate to 1e-12;
results are evaluated with the closed forms, and an equilibrium whose residual exceeds RESIDUAL is an error.
"""

# ruff: noqa: B023, E731
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false, reportOperatorIssue=false
# pyright: reportFunctionMemberAccess=false, reportUnhashable=false

import math
from collections import namedtuple
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.linalg import null_space
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipkinc

TANGENTIAL_MODULUS = math.sqrt(0.5)
RESIDUAL = 1e-10  # allowed in x0 = u + rest + C F_x at every reported state; 1e-12 is usual
STEP = 0.01  # largest step along the path of equilibria, in p and u
OVERLAP = 2 * STEP  # how far a piece of the curve continues past its borders
KICK = 1e-5  # displacement off a lost equilibrium that starts the flow
FREE, TIP, TANGENTIAL = "free", "tip", "tangential"
CLAMP = {"between": (0, 1), "stiffness": math.inf, "rest_length": 0.0}
Profile = Callable[..., tuple]  # slope angle -> contact point (xi, eta); strictly convex, symmetric in x


def parabola(distance: float, a: float = 1.0) -> Profile:
    """Return the profile y = a x^2 + distance."""
    return lambda slope: (np.tan(slope) / (2 * a), distance + np.tan(slope) ** 2 / (4 * a))


def circle(distance: float, radius: float) -> Profile:
    """Return the circle above its lowest point (0, distance)."""
    return ellipse(distance, radius, radius)


def ellipse(distance: float, a: float, b: float) -> Profile:
    """Return the ellipse with half axes a along x and b along y, above its lowest point (0, distance)."""

    def contact(slope):
        norm = np.hypot(a * np.sin(slope), b * np.cos(slope))
        return a**2 * np.sin(slope) / norm, distance + b * (1 - b * np.cos(slope) / norm)

    return contact


# Equilibrium; fields have the shape (..., whiskers). The phase is "tip", "tangential" or "free"; slope and arc of free
# whiskers are NaN.
State = namedtuple("State", "base_x fx fy mz contact_force contact_slope contact_arc phase")

# kind: touch, tip_to_tangential, vertex, tangential_to_tip, release, snap_off or snap_through; whiskers: 1-based, for
# snaps those that slipped, of which far_side landed bent the other way (none free: snap_through). before, after: states
# of all whiskers, both at control; after is None except for snaps.
Event = namedtuple("Event", "kind whiskers control before after far_side", defaults=(None, ()))

# control: (steps,); states: State of (steps, whiskers); events: list of Event, down to the last control.
Scan = namedtuple("Scan", "control states events")


def _shape(p, k):
    """Return the slope, and sqrt(f) times s1, x and y of the contact point relative to the base."""
    turn = np.pi / 2 * np.sqrt(p)  # pi/2 - t0
    slope = 2 * np.arcsin(np.clip(k * np.cos(turn), -1, 1))
    psi = np.arctan2(np.sin(turn), np.sqrt(1 - k**2) * np.cos(turn)) % (2 * np.pi)
    first = ellipkinc(psi, k**2)
    along = 2 * k * np.sin(turn)
    across = 2 * (ellipeinc(psi, k**2) - k**2 * np.cos(turn) * np.sin(psi)) - first
    x = along * np.cos(slope) - across * np.sin(slope)
    return slope, first, x, along * np.sin(slope) + across * np.cos(slope)


def _tip_modulus(profile, p):
    """Return k of the tip contact, by bisection down to rounding: y drops below eta as k grows."""
    low, high = np.zeros_like(p), np.abs(np.cos(np.pi / 2 * np.sqrt(p)))
    high = np.minimum(0.75, TANGENTIAL_MODULUS / np.maximum(high, TANGENTIAL_MODULUS))  # |alpha| <= pi/2
    for _ in range(56):
        k = (low + high) / 2
        slope, length, _, y = _shape(p, k)
        is_low = y / length > profile(slope)[1]
        low, high = np.where(is_low, k, low), np.where(is_low, high, k)
    return (low + high) / 2


class _Piece:
    """Chebyshev series of x0 and F_x over p in [low, high], one phase; continued by OVERLAP, linear below p = 0."""

    def __init__(self, branch, low, high, phase):
        self.low, self.high, start, stop = low, high, max(low - OVERLAP, 0.0), high + OVERLAP
        self.middle, self.half, self.phase = (start + stop) / 2, (stop - start) / 2, phase
        sample = lambda at: np.transpose(branch.states(self.middle + self.half * at, tip=phase == TIP)[:2])
        for count in (32, 64, 128, 256, 512, 1024):
            series = chebyshev.chebinterpolate(sample, count - 1).T * [[1], [-1]]  # x0, F_x
            size = np.abs(series) / np.abs(series).max(axis=1, keepdims=True)
            if np.all(size[:, -count // 8 :] < 1e-13):
                break
        slopes = chebyshev.chebder(series, axis=1) / self.half
        self.series = np.concatenate([series, np.pad(slopes, ((0, 0), (0, 1)))])
        self.orders = np.arange(count)

    def __call__(self, p):
        """Return x0, F_x, dx0/dp, dF_x/dp at one p."""
        inside = min(max(at := (p - self.middle) / self.half, -1.0), 1.0)
        x, force, dx, dforce = self.series @ np.cos(self.orders * math.acos(inside))
        beyond = (at - inside) * self.half
        return x + beyond * dx, force + beyond * dforce, dx, dforce


class _Free(namedtuple("_Free", "touch_x")):
    """The curve of a free whisker, p < 0, in the form of a piece."""

    low, high, phase = -math.inf, 0.0, FREE

    def __call__(self, p):
        return self.touch_x - p, 0.0, -1.0, 0.0


class ClampedBranch:
    """Stable equilibria of a clamped whisker from first touch (p = 0, base_x = touch_x) to the fold (fold, fold_x).

    borders: p of touch, changes of phase and vertex; pieces: the curve from each border on, and, as pieces[-1], free.
    """

    def __init__(self, profile: Profile):
        self.profile = profile
        grid = np.linspace(0, 4.5, 4501)
        base_x, excess = self.states(grid).base_x, lambda p: self.states(p, tip=False).contact_arc - 1
        self.touch_x = base_x[0]
        if not self.touch_x > 1e-6:
            raise ValueError("`profile` must be within reach of the whisker.")
        turn = np.flatnonzero(np.diff(base_x) > 0)[0]
        changes = np.flatnonzero(np.diff(excess(grid[: turn + 1]) > 0))
        changes = [brentq(excess, grid[i], grid[i + 1], xtol=1e-15) for i in changes]
        stop = grid[turn] + 5 * STEP
        self.borders = np.array(sorted({0.0, *changes, min(1.0, stop)} - {stop}))
        spans = zip(self.borders, [*self.borders[1:], stop], strict=True)
        self.pieces = [_Piece(self, a, b, TIP if excess((a + b) / 2) > 0 else TANGENTIAL) for a, b in spans]
        self.pieces.append(_Free(self.touch_x))
        self.fold = float(brentq(lambda p: self.piece(p)(p)[2], grid[turn - 1], grid[turn + 1], xtol=1e-15))
        self.fold_x = self.states(self.fold).base_x.item()
        self._table_p = np.linspace(0, 1, 2001)[::-1] ** 2 * self.fold
        self._table_x = self.states(self._table_p).base_x

    def states(self, p: ArrayLike, side: ArrayLike = 1.0, tip=None) -> State:
        """Return the exact states at p, mirrored in x where side = -1; tip=True or False prescribes the phase."""
        p, side = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(side, dtype=float))
        free, clearance, p = p < 0, -p, np.maximum(p, 1e-300)  # at 0 the ratios below would be 0/0
        slope, length, x, y = _shape(p, TANGENTIAL_MODULUS)
        root = y / self.profile(slope)[1]
        arc = length / np.maximum(root, length / 2)  # at most 2: out of reach even if infinite or negative
        tip = arc > 1 if tip is None else np.full(p.shape, tip)
        k = np.full(p.shape, TANGENTIAL_MODULUS)
        if tip.any():
            k[tip] = _tip_modulus(self.profile, p[tip])
            slope, length, x, y = _shape(p, k)
            root, arc = np.where(tip, length, root), np.where(tip, 1.0, arc)
        force = np.where(free, 0.0, root**2)
        base_x = self.profile(slope)[0] - x / root
        base_x = side * (np.where(free, self.touch_x + clearance, base_x) if free.any() else base_x)
        fx, fy = -side * force * np.sin(slope), force * np.cos(slope)
        mz = side * 2 * k * np.sin(np.pi / 2 * np.sqrt(p)) * np.sqrt(force)
        slope, arc = np.where(free, np.nan, side * slope), np.where(free, np.nan, arc)
        return State(base_x, fx, fy, mz, force, slope, arc, np.where(free, FREE, np.where(tip, TIP, TANGENTIAL)))

    def piece(self, p: float):
        """Return the piece at p: p -> x0, F_x, dx0/dp, dF_x/dp."""
        return self.pieces[np.searchsorted(self.borders, p, "right") - 1]

    def parameter(self, base_x: float) -> float:
        """Return p of the stable state at base_x, which is raised to fold_x."""
        if base_x > self.touch_x:
            return self.touch_x - base_x
        p = np.interp(base_x, self._table_x, self._table_p)
        for _ in range(8):
            x, _, dx, _ = self.piece(p)(p)
            change = (x - max(base_x, self.fold_x)) / min(dx, -1e-12)
            p = min(max(p - change, 0.0), self.fold)
            if abs(change) < 1e-12:
                break
        return p


clamped_branch = lru_cache(ClampedBranch)  # of a profile


class _Network:
    """Springs between the drive (node 0) and the bases: base_x = u + rest + tie @ z.

    tie: (whiskers, modes), orthonormal motions that rigid springs allow; stiffness: K of the modes; flexibility: C of
    the bases; rest: at no load, with the prestress of contradicting rest lengths; is_rigid: tied to the drive.
    """

    def __init__(self, springs):
        ends = np.array([spring["between"] for spring in springs])
        stiffness, length = (np.array([spring[key] for spring in springs]) for key in ("stiffness", "rest_length"))
        nodes = np.arange(1, ends.max() + 1)
        stretch = (ends[:, 1:] == nodes).astype(float) - (ends[:, :1] == nodes)
        rigid, soft = np.isinf(stiffness), np.isfinite(stiffness)
        offset = np.linalg.pinv(stretch[rigid]) @ length[rigid]
        if np.any(np.abs(stretch[rigid] @ offset - length[rigid]) > 1e-12):
            raise ValueError("`springs` must have rest lengths that add up around rigid loops.")
        self.tie = null_space(stretch[rigid]) if rigid.any() else np.eye(nodes.size)
        pull = self.tie.T @ (stretch[soft].T * stiffness[soft])
        self.stiffness = pull @ stretch[soft] @ self.tie
        self.rest = offset + self.tie @ np.linalg.solve(self.stiffness, pull @ (length - stretch @ offset)[soft])
        self.flexibility = self.tie @ np.linalg.solve(self.stiffness, self.tie.T)
        self.is_rigid = np.abs(self.tie).sum(axis=1) < 1e-9


class _Path:
    """Stable equilibria y = (p, u) as u decreases; side and piece (-1: free) are constant between events."""

    def __init__(self, branch, network, first_control):
        self.branch, self.network, self.count = branch, network, len(network.rest)
        self.side, self.piece = np.ones(self.count), np.full(self.count, -1)
        u = max(first_control, branch.touch_x - network.rest.min()) + STEP
        self.y = np.append(branch.touch_x - u - network.rest, u)
        self.step, self.events = STEP, []

    def _pieces(self):
        return [self.branch.pieces[i] for i in self.piece]

    def _curve(self, p):
        """Return base_x, F_x and their derivatives by p, each (whiskers,), mirrored where side = -1."""
        return self.side * np.array([piece(value) for piece, value in zip(self._pieces(), p, strict=True)]).T

    def _balance(self, y):
        """Return base_x - u - rest - C F_x and its derivatives by p."""
        x, force, dx, dforce = self._curve(y[:-1])
        rest, flexibility = self.network.rest, self.network.flexibility
        return x - y[-1] - rest - flexibility @ force, np.diag(dx) - flexibility * dforce

    def _margin(self, y):
        """Return det(-dx0/dp + C dF_x/dp) of the curves before mirroring: positive while stable, smooth at the fold."""
        return np.linalg.det(-self.side[:, None] * self._balance(y)[1])

    def _hessian(self, y):
        """Return K - dF_x/dx0 of the flexible groups, and dF_x/dx0 of the whiskers."""
        _, _, dx, dforce = self._curve(y[:-1])
        return self.network.stiffness - self.network.tie.T @ ((dforce / dx)[:, None] * self.network.tie), dforce / dx

    def _is_stable(self, y):
        is_lost = np.any(y[:-1] > self.branch.fold) or self._margin(y) <= 0
        return not is_lost and np.all(np.linalg.eigvalsh(self._hessian(y)[0]) > 0)

    def _newton(self, y, row, value):
        """Return the equilibrium with row @ y = value next to y, or NaN."""
        for _ in range(12):
            residual, by_p = self._balance(y)
            matrix = np.vstack([np.column_stack([by_p, -np.ones(self.count)]), row])
            change = np.linalg.solve(matrix, np.append(residual, row @ y - value))
            y = y - change
            if np.abs(change).max() < 1e-11:  # quadratic: y itself is better
                return y
        return np.full_like(y, np.nan)

    def advance(self, control):
        """Go on to the next event, at most by a step; return (control, p, side) for every control passed on the way."""
        tangent = np.append(np.linalg.solve(self._balance(self.y)[1], -np.ones(self.count)), -1.0)
        tangent /= np.linalg.norm(tangent)
        point = lambda tau: self._newton(self.y + tau * tangent, tangent, tangent @ self.y + tau)

        def root(value, tau):
            if abs(value(self.y)) < 1e-12 and value(point(0)) * value(point(tau)) > 0:
                return 0.0  # on the root, except for rounding
            return brentq(lambda tau: value(point(tau)), 0, tau, xtol=1e-15)

        while not np.abs((end := point(self.step)) - self.y).max() < 1.5 * self.step:
            self.step /= 2
            if self.step < 1e-10:
                raise RuntimeError(f"no equilibrium near control {self.y[-1]}")
        tau, whisker, border = self.step, None, None
        for i, piece in enumerate(self._pieces()):
            for limit, sign in ((piece.low, -1), (piece.high, 1)):
                if sign * (end[i] - limit) > 0 and (at := root(lambda y: y[i] - limit, self.step)) < tau:
                    tau, whisker, border = at, i, limit
        is_lost = self._margin(point(tau)) <= 0
        end = point(tau := root(self._margin, tau) if is_lost else tau)
        if not is_lost and whisker is None and not self._is_stable(end):
            raise RuntimeError(f"several whiskers lose their equilibrium together at control {end[-1]}")
        taus = [root(lambda y: y[-1] - value, tau) for value in control if value >= end[-1]]
        passed = [(value, point(at)[:-1], self.side.copy()) for value, at in zip(control, taus, strict=False)]
        self.y, self.step = end, min(1.5 * self.step, STEP)
        if is_lost or (whisker is not None and self._switch(whisker, border)):
            self._snap()
        return passed

    def _switch(self, i, border):
        """Enter the neighbouring piece at the border; return whether the equilibrium is unstable there."""
        old = self._pieces()[i]
        self.y[i] = border
        self.piece[i] += 1 if border == old.high else -1
        old, new = old.phase, self._pieces()[i].phase
        kind = {FREE: "touch", new: "vertex"}.get(old, "release" if new == FREE else f"{old}_to_{new}")
        self.events.append(Event(kind, (i + 1,), float(self.y[-1]), self._state()))
        return self._margin(self.y) <= 0

    def _state(self):
        return self.branch.states(np.where(self.piece < 0, np.minimum(self.y[:-1], -1e-300), self.y[:-1]), self.side)

    def _snap(self):
        """Follow the overdamped flow of the bases from the lost equilibrium to the next one, at the same control."""
        network, before, side = self.network, self._state(), self.side.copy()
        start = np.linalg.solve(network.stiffness, network.tie.T @ -before.fx)
        slipped = network.is_rigid & (self.y[:-1] > self.branch.fold - 1e-9)
        kick = np.zeros_like(start)
        if not slipped.any():
            hessian, slope = self._hessian(self.y)
            mode = np.linalg.eigh(hessian)[1][:, 0]
            kick = (
                -KICK * np.sign(mode @ network.tie.T @ slope) * mode
            )  # the direction in which the force pulls as u decreases
        self.side[slipped] *= -1
        self._relax(start, start + kick, has_left=slipped.any())
        moved = self.side != side
        landed = moved & (self.piece >= 0)
        whiskers, far_side = (tuple(int(i) + 1 for i in np.flatnonzero(mask)) for mask in (moved, landed))
        kind = "snap_off" if np.any(moved & ~landed) else "snap_through"
        self.events.append(Event(kind, whiskers, float(self.y[-1]), before, self._state(), far_side))

    def _relax(self, start, z, has_left):
        """Integrate the flow from z, whiskers slipping at their folds, until it rests away from start."""
        network, branch = self.network, self.branch
        base_x = lambda z: self.side * (self.y[-1] + network.rest + network.tie @ z)
        slip = lambda _, z: base_x(z).min() - branch.fold_x
        slip.terminal, slip.direction = True, -1

        def pull(z):
            p = [branch.parameter(x) for x in base_x(z)]
            _, force, dx, dforce = np.array([branch.piece(value)(value) for value in p]).T
            return self.side * force, dforce / np.minimum(dx, -1e-12)

        flow = lambda _, z: network.tie.T @ pull(z)[0] - network.stiffness @ z
        slope = lambda _, z: network.tie.T * pull(z)[1] @ network.tie - network.stiffness
        for span in 4.0 ** np.arange(15):
            is_slipping = ~network.is_rigid & (base_x(z) < branch.fold_x + 1e-11)
            self.side[is_slipping] *= -1
            has_left |= is_slipping.any() or np.linalg.norm(z - start) > 1.1 * KICK
            if has_left and not is_slipping.any() and self._settle(base_x(z)):
                return
            if z.size:
                z = solve_ivp(flow, (0, span), z, "Radau", events=slip, jac=slope, rtol=1e-7, atol=1e-9).y[:, -1]
        raise RuntimeError(f"the flow at control {self.y[-1]} does not come to rest")

    def _settle(self, base_x):
        """Enter the stable equilibrium within 1e-6 of base_x (mirrored) at the same u; return whether there is one."""
        y = np.append([self.branch.parameter(x) for x in base_x], self.y[-1])
        for _ in range(5):
            self.piece = np.searchsorted(self.branch.borders, y[:-1], "right") - 1
            y = self._newton(y, np.append(np.zeros(self.count), 1.0), y[-1])
            is_inside = all(piece.low <= p <= piece.high for p, piece in zip(y[:-1], self._pieces(), strict=True))
            distance = np.abs(self.side * self._curve(y[:-1])[0] - base_x).max()
            if is_inside and distance < 1e-6 and self._is_stable(y):
                self.y = y
                return True
        return False


def exact_scan(profile: Profile, springs: Sequence[dict], control: ArrayLike) -> Scan:
    """Scan with strictly decreasing control, coming from the right, where all whiskers are free.

    springs: {"between": (i, j), "stiffness": c, "rest_length": x_j - x_i} each, node 0 the drive, c = math.inf rigid;
    none: one clamped whisker. Raises RuntimeError if several whiskers lose their equilibrium together.
    """
    control = np.asarray(control, dtype=float)
    if control.ndim != 1 or not np.all(np.diff(control) < 0):
        raise ValueError("`control` must be strictly decreasing.")
    branch, network = clamped_branch(profile), _Network(springs or [CLAMP])
    path, passed = _Path(branch, network, control[0]), []
    while len(passed) < len(control):
        passed += path.advance(control[len(passed) :])
    states = branch.states(np.array([p for _, p, _ in passed]), np.array([side for *_, side in passed]))
    residual = np.abs(states.base_x - control[:, None] - network.rest + states.fx @ network.flexibility).max()
    if not residual <= RESIDUAL:
        raise RuntimeError(f"equilibria miss the closed forms by {residual}")
    return Scan(control, states, [event for event in path.events if event.control >= control[-1]])
