"""The overdamped flow of bases at a fixed drive, with friction: an explicit differential equation with hysteresis.

Each whisker is clamped to a base at (x, 0) and bends to the left. Its force on the base is a hysteresis operator F of
the path of x: the contact slips one way or the other, or sticks where it came to rest. The bases move with velocities

    x_i' = F_i - [K (x - rest)]_i.

This equation is integrated between events, at which contacts begin to stick or to slip, pass between tip and shaft, or
pass a fold and come free. Only conventions are shared with the package. Seen from the contact, a whisker is a pendulum
about the direction of its force: chi = pi/2 - theta, with theta between the whisker and the normal to that direction,
starts at rest, so that sin(chi / 2) = k cd(sqrt(f / EI) s, k) with k = sin(chi / 2) at the contact. The position of the
base is integrated by Gauss's rule. What happens otherwise (landings, new contacts) is an error.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.special import ellipj

TOLERANCE = 1e-8  # of the integration
STILL = 1e-6  # speed of bases that have come to rest, by then
FIRST_STEP = 1e-7
LONG = 1e4  # pseudo-time
PUSH = 1e-5  # of the drive, by which a flow leaves the equilibrium that lost its stability
SLOW = 1e-7  # speed at which contacts may slip back because of rounding
DIFFERENCE = 1e-6  # of the base, for rates
REFINED = 3  # times that a step across a fold is divided by SHARES
SHARES = 20
EVENTS = 60
EVALUATIONS = 4000  # of the velocities, more than which take too long
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(24)


class NotCoveredError(Exception):
    """The flow does what this oracle does not compute."""


class FoldError(Exception):
    """A whisker has passed a fold of its branch."""

    def __init__(self, whisker: "Whisker"):
        super().__init__()
        self.whisker = whisker


class Contact(NamedTuple):
    """A contact."""

    force: float
    slope: float  # angle of the object
    lean: float  # angle from the object's normal to the force
    slack: float  # > 0: arc length of the whisker beyond it; < 0: minus the angle between whisker and object


def arc_of(a: float, slope: float) -> float:
    """Arc length on the parabola from its lowest point."""
    t = np.tan(slope)
    return (t * np.hypot(1, t) + np.arcsinh(t)) / (4 * a)


def slope_at(a: float, length: float) -> float:
    """Slope angle at an arc length from the lowest point, by Newton's method."""
    t = 2 * a * length
    for _ in range(60):
        t -= ((t * np.hypot(1, t) + np.arcsinh(t)) / (4 * a) - length) * 2 * a / np.hypot(1, t)
    return float(np.arctan(t))


class Whisker:
    """One whisker on its clamped branch, with the memory of its contact; free without a contact."""

    def __init__(self, length: float, stiffness: float, a: float, q: float, mu: float):
        self.length, self.stiffness, self.a, self.q, self.limit = length, stiffness, a, q, np.arctan(mu)
        self.contact, self.slip, self.tip, self.origin, self.sign = None, 0, True, 0.0, 0.0

    def touches(self, force: float, slope: float, lean: float, arc: float, slip: int, tip: bool) -> None:
        """Begin with a contact of a known equilibrium."""
        self.slip, self.tip = slip, tip
        slack = self.length - arc
        if tip:
            # The angle at the tip is that with which the base stands upright.
            found = [
                root(lambda s: self.base(Contact(force, slope, lean, s[0]))[1:], [guess], method="lm", tol=1e-14).x[0]
                for guess in (-0.1, -0.5, -1.0, -1.5, -2.0)
            ]
            missed = [np.max(np.abs(self.base(Contact(force, slope, lean, s))[1:])) for s in found]
            slack = found[int(np.argmin(missed))]
        self.contact = Contact(force, slope, lean, slack)
        self.begins()

    def begins(self, slip: int | None = None, tip: bool | None = None) -> None:
        """Begin a branch at the present contact."""
        assert self.contact is not None
        if self.slip != 0 or tip is not None:
            self.origin = self.rolled(self.contact)
        self.slip, self.tip = self.slip if slip is None else slip, self.tip if tip is None else tip
        self.sign = self.orientation(self.contact)

    def rolled(self, c: Contact) -> float:
        """Arc length on the object minus that on the whisker: constant while the contact sticks."""
        return arc_of(self.a, c.slope) + (0.0 if self.tip else c.slack)

    def base(self, c: Contact) -> tuple[float, float, float]:
        """Position of the base, and the cosine of its direction: 0 if it stands upright."""
        t, slack = np.tan(c.slope), 0.0 if self.tip else c.slack
        theta, arc, bend = (-c.slack if self.tip else 0.0) + c.lean, self.length - slack, c.force / self.stiffness

        def angle(s):
            k = np.sin((np.pi / 2 - theta) / 2)
            _, cn, dn, _ = ellipj(np.sqrt(max(bend, 0.0)) * s, k**2)
            return np.pi / 2 - 2 * np.arcsin(k * cn / dn) + c.slope - c.lean

        angles = angle(arc * (POINTS + 1) / 2)
        x = t / (2 * self.a) - arc / 2 * np.sum(WEIGHTS * np.cos(angles))
        y = self.q + t**2 / (4 * self.a) - arc / 2 * np.sum(WEIGHTS * np.sin(angles))
        return x, y, np.cos(angle(arc))

    def unknowns(self, c: Contact) -> np.ndarray:
        """Force; lean if the contact sticks, otherwise slope; slack."""
        return np.array([c.force, c.lean if self.slip == 0 else c.slope, c.slack])

    def of(self, z) -> Contact:
        """The contact with these unknowns."""
        if self.slip != 0:
            return Contact(z[0], z[1], self.slip * self.limit, z[2])
        assert self.contact is not None
        slope = self.contact.slope if self.tip else slope_at(self.a, self.origin - z[2])
        return Contact(z[0], slope, z[1], z[2])

    def orientation(self, c: Contact) -> float:
        """Sign of the Jacobian of the branch, which changes at its folds."""
        z, steps = self.unknowns(c), 1e-6 * np.eye(3)
        columns = [np.subtract(self.base(self.of(z + d)), self.base(self.of(z - d))) for d in steps]
        return float(np.sign(np.linalg.det(columns)))

    def at(self, base_x: float) -> Contact:
        """The contact on the present branch for a position of the base near the last one."""
        assert self.contact is not None

        def residual(z):
            x, y, turn = self.base(self.of(z))
            return x - base_x, y, turn

        start = self.unknowns(self.contact)
        solution = root(residual, start, tol=1e-12).x
        c = self.of(solution)
        near = np.max(np.abs(solution - start)[1:]) < 0.3
        if not (near and np.max(np.abs(residual(solution))) < 1e-9 and self.orientation(c) == self.sign):
            raise FoldError(self)
        return c

    def rate(self, base_x: float) -> float:
        """Rate at which the contact slips when the base moves."""
        slips = [self.rolled(self.at(base_x + step)) for step in (DIFFERENCE, -DIFFERENCE)]
        return (slips[0] - slips[1]) / (2 * DIFFERENCE)


def rest_of(
    whiskers: Sequence[Whisker], bases: np.ndarray, springs: Sequence[tuple[int, int, float, float]], drive: float
) -> np.ndarray:
    """Bases at which the flow comes to rest; the whiskers are then in the state after it.

    Args:
        whiskers: in the state in which stability is lost.
        bases: their positions, (whiskers,).
        springs: (first, second, stiffness, rest length), 0 for the drive.
        drive: its position, which moves on by PUSH towards -x.
    """

    evaluations = 0

    def velocities(x):
        nonlocal evaluations
        evaluations += 1
        if evaluations > EVALUATIONS:
            raise NotCoveredError("it takes too long")
        at, total = np.concatenate([[drive - PUSH], x]), np.zeros(len(x) + 1)
        for first, second, stiffness, rest in springs:
            tension = stiffness * (at[second] - at[first] - rest)
            total[first] += tension
            total[second] -= tension
        for k, one in enumerate(whiskers):
            if one.contact is not None:
                c = one.at(x[k])
                total[k + 1] += c.force * np.sin(c.slope - c.lean)
        return total[1:]

    def margin(k: int, kind: str):
        def value(_, x):
            one, c = whiskers[k], whiskers[k].at(x[k])
            if kind == "limit":
                return one.limit - abs(c.lean)
            if kind == "phase":
                return -c.slack if one.tip else c.slack
            if kind == "force":
                return c.force
            return one.slip * one.rate(x[k]) * velocities(x)[k] + SLOW

        value.terminal, value.direction = True, -1
        return value

    last: list = []  # accepted steps

    def accepted(t, x):
        """Remember an accepted step; this is no event."""
        last.append((t, np.array(x)))
        for k, one in enumerate(whiskers):
            one.contact = None if one.contact is None else one.at(x[k])
        return 1.0

    def follow(x, events):
        """Integrate to the next event or fold; return the bases and which event happens, or the whisker."""
        step = np.inf
        for _ in range(REFINED):
            last.clear()
            try:
                path = solve_ivp(
                    lambda _, x: velocities(x),
                    *((0, LONG), x, "LSODA"),
                    events=events,
                    rtol=TOLERANCE,
                    atol=1e-10,
                    first_step=min(FIRST_STEP, step),
                    max_step=step,
                )
            except ValueError as error:
                raise NotCoveredError("an event is not resolved") from error
            except FoldError as fold:
                times, x, which = [t for t, _ in last], last[-1][1] if last else x, fold.whisker
                if len(times) < 2 or times[-1] == times[-2]:
                    break  # the flow begins at a fold
                step = (times[-1] - times[-2]) / SHARES
                continue
            return path.y[:, -1], [number for number, times in enumerate(path.t_events) if len(times)]
        return x, which

    x = np.array(bases, dtype=float)
    for _ in range(EVENTS):
        for k, one in enumerate(whiskers):
            if one.contact is not None and one.slip != 0 and margin(k, "slip")(0.0, x) < 0:
                one.begins(slip=0)
        kinds = [
            (k, kind)
            for k, one in enumerate(whiskers)
            if one.contact is not None
            for kind in ("phase", "force", "slip" if one.slip != 0 else "limit")
        ]
        x, happened = follow(x, [accepted, *(margin(*kind) for kind in kinds)])
        if isinstance(happened, Whisker):
            k = whiskers.index(happened)
            if x[k] > -reach(happened):
                raise NotCoveredError("the whisker lands on the far side")
            happened.contact = None
        elif not happened:
            if np.max(np.abs(velocities(x))) > STILL:
                raise NotCoveredError("the flow does not end")
            return x
        else:
            k, kind = kinds[happened[0] - 1]
            one = whiskers[k]
            one.contact = one.at(x[k])
            if kind == "force":
                one.contact = None
            elif kind == "phase":
                one.begins(tip=not one.tip)
            else:
                one.begins(slip=0 if kind == "slip" else int(np.sign(one.contact.lean)))
        if any(one.contact is None and abs(x[k]) < reach(one) for k, one in enumerate(whiskers)):
            raise NotCoveredError("a free whisker touches")
    raise NotCoveredError("too many events")


def reach(one: Whisker) -> float:
    """Distance from the middle at which an upright whisker touches the object."""
    return np.sqrt(max(one.length - one.q, 0.0) / one.a)
