"""Exact equilibria as the package's unknowns, from the closed forms of exact.py."""

from functools import cache
from typing import NamedTuple

import exact
import numpy as np

import jaxwhisker as jw

DISTANCE = 0.2
Q = exact.parabola(DISTANCE)
PHASE = {exact.FREE: jw.Phase.free, exact.TIP: jw.Phase.tip, exact.TANGENTIAL: jw.Phase.tangential}


class Contacts(NamedTuple):
    """Exact states of clamped whiskers below y = x^2 + 0.2, with L = EI = 1; every field has shape (whiskers, ...)."""

    z: np.ndarray  # (whiskers, 3): force, slope angle, slack
    phase: np.ndarray
    base_x: np.ndarray
    force_x: np.ndarray  # of the object on the whisker
    mz: np.ndarray  # support reaction


@cache
def branch() -> exact.ClampedBranch:
    """The clamped branch of these whiskers."""
    return exact.clamped_branch(Q)


def contacts(*p: float, side=1.0, tip=None) -> Contacts:
    """Contacts at these parameters of the clamped branch: 0 at first touch, 1 at the vertex."""
    at = branch().states(np.array(p), side, tip)
    phase = np.array([int(PHASE[name]) for name in at.phase])
    # The first integral of the elastica: k^2 = sin(alpha/2)^2 + mz^2 / (4 f), and k = sin((pi/2 - theta1)/2).
    k = np.sqrt(np.sin(at.contact_slope / 2) ** 2 + at.mz**2 / (4 * at.contact_force))
    angle = np.pi / 2 - 2 * np.arcsin(k)
    slack = np.where(phase == jw.Phase.tip, -angle, 1 - at.contact_arc)
    return Contacts(np.stack([at.contact_force, at.contact_slope, slack], axis=-1), phase, at.base_x, -at.fx, at.mz)


def scene(support: jw.Support, **fields) -> jw.Scene:
    """A scene of such whiskers, by the closed form of the rod: it compiles fastest."""
    return jw.Scene(jw.Whisker(), jw.Parabola(DISTANCE), support, jw.ClosedForm(), **fields)


def fbfb_at(p1: float, p2: float, stiffness: tuple[float, float] = (70.0, 40.0)) -> jw.Scene:
    """FBFB with the rest lengths that make these two contacts an equilibrium at control 0."""
    at = contacts(p1, p2)
    c1, c2 = stiffness
    first = at.base_x[0] - (at.force_x[0] + at.force_x[1]) / c1
    second = at.base_x[1] - at.base_x[0] - at.force_x[1] / c2
    return scene(jw.Support.fbfb(list(stiffness), [float(first), float(second)]))


def fb_control(p: float, stiffness=70.0, rest_length=0.2) -> float:
    """The control at which FB has this contact."""
    at = contacts(p)
    return float(at.base_x[0] - rest_length - at.force_x[0] / stiffness)
