"""Scans against exact ones by elliptic integrals (exact.py), for a fixed list of scenes that were drawn at random."""

import math

import exact
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import all_ok, event_list

SIGNAL = 1e-6  # relative to a signal's peak over the scan; near a fold both solutions lose digits
EVENT = 1e-8
EVERY = 40  # of the default control's steps: the exact solver is slow

ENDS = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}
# model, profile, stiffnesses, rest lengths: soft and stiff, steep and flat, near and far, rigid links, strained loops.
SCENES = [
    ("FB", ("parabola", 0.05, 1.0), [40.0], [0.2]),
    ("FB", ("parabola", 0.85, 8.0), [12.0], [0.1]),
    ("FB", ("parabola", 0.3, 0.1), [5.0], [0.3]),
    ("FB", ("circle", 0.3, 0.1), [30.0], [0.2]),
    ("FB", ("circle", 0.15, 0.35), [500.0], [0.0]),
    ("FB", ("ellipse", 0.25, 0.2, 0.9), [20.0], [0.2]),
    ("FB", ("ellipse", 0.4, 2.0, 0.25), [60.0], [0.2]),
    ("FBFB", ("parabola", 0.2, 1.0), [9.0, 400.0], [0.2, 0.15]),
    ("FBFB", ("parabola", 0.1, 2.0), [300.0, 25.0], [0.1, 0.3]),
    ("FBFB", ("parabola", 0.4, 0.5), [80.0, math.inf], [0.2, 0.2]),
    ("FBFBR", ("parabola", 0.2, 1.0), [30.0, 200.0, 15.0], [0.2, 0.2, 0.4]),
    ("FBFBR", ("parabola", 0.6, 3.0), [1e4, 10.0, 50.0], [0.2, 0.2, 0.7]),
    ("FBFBFBR", ("parabola", 0.3, 1.0), [70.0, 20.0, 500.0, 35.0, 8.0], [0.2, 0.2, 0.2, 0.4, 0.6]),
    ("FBFBFBR", ("parabola", 0.15, 0.7), [15.0, 15.0, 15.0, 15.0, 15.0], [0.3, 0.1, 0.2, 0.4, 0.6]),
]
PROFILES = {
    "parabola": (jw.Parabola, exact.parabola),
    "circle": (jw.Circle, exact.circle),
    "ellipse": (jw.Ellipse, exact.ellipse),
}


@pytest.mark.parametrize(("model", "profile", "stiffness", "rest_length"), SCENES)
def test_signals_and_events(model, profile, stiffness, rest_length):
    kind, *sizes = profile
    ours, theirs = PROFILES[kind]
    springs = tuple(jw.Spring(*s) for s in zip(ENDS[model], stiffness, rest_length, strict=True))
    result = jw.scan(jw.Scene(jw.Whisker(), ours(*sizes), jw.Support(springs)))
    assert all_ok(result)
    control = np.asarray(result.control)[::EVERY]
    keys = ("between", "stiffness", "rest_length")
    stored = [dict(zip(keys, values, strict=True)) for values in zip(ENDS[model], stiffness, rest_length, strict=True)]
    reference = exact.exact_scan(theirs(*sizes), stored, control)
    for name in ("fx", "fy", "mz", "base_x"):
        values, exactly = np.asarray(getattr(result, name))[::EVERY], np.asarray(getattr(reference.states, name))
        peak = np.maximum(np.max(np.abs(exactly), axis=0), 1e-3)
        assert np.max(np.abs(values - exactly) / peak) < SIGNAL, name
    phases = np.array([jw.Phase(int(p)).name for p in np.asarray(result.phase)[::EVERY].ravel()])
    assert np.array_equal(phases, np.asarray(reference.states.phase).ravel())
    events = [e for e in event_list(result) if e[2] >= control[-1]]
    exactly = [e for e in reference.events if e.control >= control[-1]]
    assert [e[:2] for e in events] == [(e.kind, tuple(e.whiskers)) for e in exactly]
    np.testing.assert_allclose([e[2] for e in events], [e.control for e in exactly], rtol=0, atol=EVENT)
