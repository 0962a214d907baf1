"""Whiskers in contact, by shooting from their bases outwards with scipy. Only conventions are shared with the package.

The unknowns of a touching whisker are the contact force, the slope angle at the contact and, in tangential contact, the
arc length of the contact. They determine the load on its base, the displacements of the springs, the pose of the base
and the moment everywhere, m(s) = (xi - x) F_y - (eta - y) F_x. The rod, integrated from its base, must meet the object
at the contact, and must be parallel to it in tangential contact.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.integrate import solve_ivp
from scipy.optimize import root

INTEGRATION = 1e-12  # relative and absolute tolerance of a rod
DEGREE = 12  # of polynomials for bending stiffness and curvature: those of a cone are of degree 4 and 1
POLYNOMIAL = 1e-13  # their error


class Rod(NamedTuple):
    """A whisker and its mount."""

    length: float
    bending_stiffness: Callable[..., Any]
    intrinsic_curvature: Callable[..., Any]
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    breaks: tuple[float, ...] = ()  # arc lengths at which a function jumps


class State(NamedTuple):
    """Signals and contacts; arrays of shape (whiskers,)."""

    base_x: np.ndarray
    base_y: np.ndarray
    base_angle: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    mz: np.ndarray
    contact_slope: np.ndarray
    contact_arc: np.ndarray


def parabola(distance: float, a: float = 1.0):
    """Points of a parabola by slope angle."""
    return lambda slope: (np.tan(slope) / (2 * a), distance + np.tan(slope) ** 2 / (4 * a))


def yielding(springs, whiskers: int) -> tuple[np.ndarray, np.ndarray]:
    """Flexibility (axis, base, base) and rest displacement (axis, base) of springs of finite stiffness.

    Each is (between, stiffness, rest_length, axis).
    """
    flexibility, rest = np.zeros((3, whiskers, whiskers)), np.zeros((3, whiskers))
    for k, axis in enumerate(("x", "y", "phi")):
        own = [spring for spring in springs if spring[3] == axis]
        moved = sorted({end for (ends, *_) in own for end in ends} - {0})
        stiffness, force = np.zeros((whiskers + 1, whiskers + 1)), np.zeros(whiskers + 1)
        for (first, second), c, length, _ in own:
            across = np.zeros(whiskers + 1)
            across[first], across[second] = -1.0, 1.0
            stiffness += c * np.outer(across, across)
            force += c * length * across
        if moved:
            index = np.array(moved)
            inverse = np.linalg.inv(stiffness[np.ix_(index, index)])
            flexibility[k][np.ix_(index - 1, index - 1)] = inverse
            rest[k, index - 1] = inverse @ force[index]
    return flexibility, rest


def integrated(rate: Callable[..., Any], start: tuple, arc: float, breaks: tuple[float, ...] = ()) -> np.ndarray:
    """The state at an arc length: each stretch between two breaks is integrated with the functions of its inside."""
    ends = np.array([0.0, *(at for at in breaks if at < arc), arc])
    for first, last in itertools.pairwise(ends):
        inside = np.nextafter(first, last), np.nextafter(last, first)
        own = solve_ivp(
            lambda s, r, inside=inside: rate(np.clip(s, *inside), r),
            (first, last),
            start,
            method="DOP853",
            rtol=INTEGRATION,
            atol=INTEGRATION,
        )
        start = own.y[:, -1]
    return np.asarray(start)


def equilibrium(
    *,
    drive: tuple[float, float, float],
    rods: list[Rod],
    springs: tuple,
    profile: Callable[..., tuple],
    guess: list[tuple[float, ...]],
) -> State:
    """The equilibrium near a guess: per whisker () if free, (force, slope) in tip contact, (force, slope, arc) else."""
    n = len(rods)
    flexibility, rest = yielding(springs, n)
    drive_x, drive_y, turned = drive
    cos, sin = np.cos(turned), np.sin(turned)
    mounts = np.array([rod.mount for rod in rods])
    splits = np.cumsum([len(own) for own in guess])[:-1]

    def at(unknown):
        own = [np.append(part, 0.0)[:3] for part in np.split(unknown, splits)]
        own = [np.zeros(3) if not len(g) else o for g, o in zip(guess, own, strict=True)]
        force, slope = (np.array([o[k] for o in own]) for k in (0, 1))
        arc = np.array([o[2] if len(g) == 3 else rod.length for o, g, rod in zip(own, guess, rods, strict=True)])
        force_x, force_y = force * np.sin(slope), -force * np.cos(slope)
        contact_x, contact_y = (np.array(values) for values in zip(*map(profile, slope), strict=True))
        # Forces along the drive's axes move the bases; moments depend on the positions of the bases.
        along_x = rest[0] + flexibility[0] @ (force_x * cos + force_y * sin) + mounts[:, 0]
        along_y = rest[1] + flexibility[1] @ (force_y * cos - force_x * sin) + mounts[:, 1]
        base_x, base_y = drive_x + along_x * cos - along_y * sin, drive_y + along_x * sin + along_y * cos
        moment = (contact_x - base_x) * force_y - (contact_y - base_y) * force_x
        base_angle = turned + mounts[:, 2] + rest[2] + flexibility[2] @ moment
        return State(base_x, base_y, base_angle, -force_x, -force_y, -moment, slope, arc), contact_x, contact_y

    def missed(unknown):
        state, contact_x, contact_y = at(unknown)
        off = []
        for k, rod in enumerate(rods):

            def bent(s, r, k=k, rod=rod):
                x, y, angle = r
                moment = -(contact_x[k] - x) * state.fy[k] + (contact_y[k] - y) * state.fx[k]
                return np.cos(angle), np.sin(angle), rod.intrinsic_curvature(s) + moment / rod.bending_stiffness(s)

            start = state.base_x[k], state.base_y[k], np.pi / 2 + state.base_angle[k]
            if len(guess[k]):
                end = integrated(bent, start, state.contact_arc[k], rod.breaks)
                parallel = np.sin(end[2] - state.contact_slope[k])
                off += [end[0] - contact_x[k], end[1] - contact_y[k], parallel][: len(guess[k])]
        return np.array(off)

    solution = root(missed, np.concatenate(guess), tol=1e-13)
    if np.max(np.abs(solution.fun)) > 1e-11:
        raise RuntimeError(f"no equilibrium near {guess}: {solution.message}")
    return at(solution.x)[0]


def along(value, length) -> Callable[..., Any]:
    """A quantity along a whisker as a polynomial: thousands of calls through JAX would take most of the time."""
    exact = np.vectorize(lambda s: float(value(s)))
    polynomial = Chebyshev.interpolate(exact, DEGREE, domain=[0.0, float(length)])
    between = np.linspace(0.0, float(length), 2 * DEGREE)
    np.testing.assert_allclose(polynomial(between), exact(between), rtol=POLYNOMIAL, atol=POLYNOMIAL)
    return polynomial.trim(POLYNOMIAL)


def misses(
    result, steps, *, drive=lambda u: (u, 0.0, 0.0), profile=None, phases: set | None = None
) -> dict[str, float]:
    """Largest difference between scan steps and forward shooting, per signal, relative to its maximum.

    The phases of these steps are added to `phases`.
    """
    scene = result.scene
    mounts = [(float(m.x), float(m.y), float(m.angle)) for m in scene.support.mounts]
    rods = [
        Rod(float(w.length), along(w.stiffness_at, w.length), along(w.curvature_at, w.length), mount)
        for w, mount in zip(scene.whiskers, mounts, strict=True)
    ]
    springs = tuple(
        (s.between, 1 / float(s.softness), float(s.rest_length), s.axis)
        for s in scene.support.springs
        if s.softness > 0
    )
    profile = profile or parabola(float(scene.profile.distance), float(scene.profile.a))
    worst = dict.fromkeys(State._fields, 0.0)
    for k in steps:
        near = np.stack([result.contact_force[k], result.contact_slope[k], result.contact_arc[k]], axis=-1)
        sizes = np.array([0, 2, 3])[np.asarray(result.phase)[k]]
        guess = [tuple(1.01 * own[:size]) for own, size in zip(near, sizes, strict=True)]
        exact = equilibrium(
            drive=drive(float(result.control[k])), rods=rods, springs=springs, profile=profile, guess=guess
        )
        touching = sizes > 0
        for name in worst:
            values = np.asarray(getattr(result, name))
            size = np.max(np.abs(values), initial=1.0 if name.startswith("base") else 1e-300)
            missed = np.abs(values[k] - getattr(exact, name))
            # Free whiskers have no contact.
            missed = missed[touching] if name.startswith("contact") else missed
            worst[name] = max(worst[name], float(np.max(missed, initial=0.0)) / size)
        if phases is not None:
            phases |= set(np.asarray(result.phase)[k].tolist())
    return worst
