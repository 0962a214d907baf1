"""Scenes that tests share, and stored exact scans."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw

REFERENCE = json.loads((Path(__file__).parent / "data" / "scans.json").read_text())["cases"]


def model(name="FB", stiffness: float | list = 70.0, rest_length=0.2, distance=0.2, a=1.0):
    """A named model and a parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(distance, a), jw.Support.named(name, stiffness, rest_length))


def from_reference(case):
    """The scene of a stored scan."""
    p = case["profile"]
    profile = jw.Parabola(p["distance"], p["a"]) if p["kind"] == "parabola" else jw.Circle(p["distance"], p["radius"])
    springs = [jw.Spring(tuple(s["between"]), s["stiffness"], s["rest_length"]) for s in case["springs"]]
    return jw.Scene(jw.Whisker(), profile, jw.Support(tuple(springs)))


def step_nearest(result, control):
    """Index of the step nearest to a control."""
    return int(np.argmin(np.abs(np.asarray(result.control) - control)))


def all_ok(result):
    """Whether every step of the scan is ok."""
    return bool(jnp.all(result.status == jw.Status.ok))


def event_list(result):
    """The events as plain tuples (kind, whiskers, control)."""
    return [(e.kind.name, e.whiskers, e.control) for e in result.events]


def in_both_modes(function, direction):
    """Compiled function of parameters and weights: value, forward and reverse derivative of the given function.

    Both modes share one linearisation, which is compiled once.
    """

    @jax.jit
    def both(p, weights):
        value, along = jax.linearize(function, p)
        return value, along(direction), jax.linear_transpose(along, p)(weights)[0]

    return both
