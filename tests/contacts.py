"""Exact signals of one and two whiskers before a parabola and a circle, for tests of reconstruction."""

from functools import cache

import exact
import numpy as np

import jaxwhisker as jw

NOISE = 0.01  # of a channel's peak
CONTROL = np.linspace(0.9503, -1.6, 256)

CASES = {
    "clamped": (jw.Support(), exact.parabola(0.2)),
    "FB": (jw.Support.fb(70.0), exact.parabola(0.2)),
    "FBFBR": (jw.Support.fbfbr(70.0), exact.parabola(0.2)),
    "circle": (jw.Support.fbfbr(70.0), exact.circle(0.3, 0.6)),
}


@cache
def signals(name):
    """Exact states and their signals."""
    support, profile = sensor(name).support, CASES[name][1]
    keys = ("between", "stiffness", "rest_length")
    springs = [
        dict(zip(keys, (s.between, 1 / float(s.softness), float(s.rest_length)), strict=True)) for s in support.springs
    ]
    states = exact.exact_scan(profile, springs, CONTROL).states
    return states, {"control": CONTROL, "fx": states.fx, "fy": states.fy, "mz": states.mz}


def sensor(name):
    """The sensor of a case."""
    return jw.Sensor(jw.Whisker(), CASES[name][0])


def noisy(name, seed):
    """Signals with noise, and the standard deviations of the noise."""
    _, exactly = signals(name)
    random = np.random.default_rng(seed)
    sigma = {c: NOISE * np.max(np.abs(exactly[c])) for c in ("fx", "fy", "mz")}
    shape = exactly["fx"].shape
    return exactly | {c: exactly[c] + s * random.standard_normal(shape) for c, s in sigma.items()}, sigma
