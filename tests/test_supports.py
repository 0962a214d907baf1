"""Supports that yield in x, y and angle, and mounted whiskers: forward shooting, energy, limits, derivatives."""

from functools import cache

import equinox as eqx
import numpy as np
import pytest

import forward
import jaxwhisker as jw
from scenes import all_ok

EXACT = 1e-7  # of signals relative to their size: the rods' steps
SAME = 1e-7  # of signals relative to their size: a stiffness of 1e9 is a clamp
CONTROL = np.linspace(1.2, -1.9, 125)
SIGNALS = ("base_x", "base_y", "base_angle", "fx", "fy", "mz")
PARABOLA = jw.Parabola(0.2)


class Spiral(eqx.Module):
    """An Euler spiral: curvature linear in arc length."""

    start: float
    growth: float

    def __call__(self, s):
        return self.start + self.growth * s


def cone(ratio):
    return lambda s: (1 - (1 - ratio) * s) ** 4


def spring(ends, stiffness, rest_length=0.0, axis="x"):
    return jw.Spring(ends, stiffness, rest_length, axis)


TORSION = (spring((0, 1), 70.0, 0.2), spring((1, 2), 70.0, 0.2), spring((0, 1), 30.0, 0.0, "phi"))
SCENES = {
    "follicle": jw.Scene(jw.Whisker(), PARABOLA, jw.Support.follicle(x=70.0, y=500.0, phi=20.0)),
    "torsion": jw.Scene(jw.Whisker(), PARABOLA, jw.Support.follicle(phi=5.0)),
    "coupled by torsion": jw.Scene(
        jw.Whisker(), PARABOLA, jw.Support((*TORSION, spring((1, 2), 30.0, 0.1, "phi"), spring((0, 2), 90.0, 0.4)))
    ),
    "conical spiral on torsion": jw.Scene(
        jw.Whisker(1.0, cone(0.4), Spiral(0.3, 0.5)), PARABOLA, jw.Support.follicle(phi=15.0)
    ),
    "mounted": jw.Scene(jw.Whisker(), PARABOLA, jw.Support.follicle(x=90.0, phi=40.0, mount=jw.Mount(0.1, -0.05, 0.2))),
    "everything": jw.Scene(
        (jw.Whisker(1.0, cone(0.5), -0.2), jw.Whisker(0.95, 0.8, Spiral(0.1, 0.2))),
        PARABOLA,
        jw.Support(
            (*TORSION, spring((1, 2), 40.0, 0.05, "phi"), spring((0, 2), 300.0, 0.02, "y"), spring((0, 2), 60.0, 0.3)),
            (jw.Mount(0.0, 0.02, -0.1), jw.Mount(0.05, 0.0, 0.15)),
        ),
    ),
}


@cache
def scanned(name):
    return jw.scan(SCENES[name], CONTROL)


@pytest.mark.parametrize("name", SCENES)
def test_against_forward_shooting(name):
    result, phases = scanned(name), set()
    assert all_ok(result)
    touching = np.flatnonzero(np.any(np.asarray(result.phase) != jw.Phase.free, axis=1))
    missed = forward.misses(result, touching[1 :: max(1, touching.size // 8)], phases=phases)
    assert max(missed.values()) < EXACT, missed
    assert {jw.Phase.tip, jw.Phase.tangential} <= phases
