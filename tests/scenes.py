"""Scenes that tests share, and stored exact scans.

Most of the time of a test run is spent on programs, one set for each problem shape. Tests therefore use few shapes and
vary numbers, and call `jw.scan` and its derivatives without a jit of their own: such calls share programs, between
workers too. The shapes are

- one, two or three uniform whiskers on springs along x (`model`: FB, FBFBR, FBFBFBR), below a parabola or a circle;
- one whisker on springs along x, y and phi (`follicle`), on a moving drive or below a tilted object;
- one conical, curved whisker on one spring (`cone`);
- and the few others that are the subject of a test.

Functions of a scene are modules with fields. A lambda is a new shape in every test, and is not stored.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._model.along import LinearTaper, RoundSection

MODES = 1e-10  # forward against reverse mode, relative to the sum of sizes: the same sums in another order
DIFFERENCE = 1e-5  # relative step of central differences

REFERENCE = json.loads((Path(__file__).parent / "data" / "scans.json").read_text())["cases"]


def model(name="FB", stiffness: float | list = 70.0, rest_length=0.2, distance=0.2, a=1.0):
    """A named model and a parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(distance, a), jw.Support.named(name, stiffness, rest_length))


def follicle(x=np.inf, y=np.inf, phi=np.inf, mount=(0.0, 0.0, 0.0)):
    """One base with springs along all axes."""
    return jw.Support.follicle(x=x, y=y, phi=phi, mount=jw.Mount(*mount))


def cone(ratio, *, length=1.0, stiffness=1.0, curvature: tuple[float, float] | None = None):
    """A whisker whose tip is `ratio` times as thick as its base, with this bending stiffness at its base.

    `curvature` is the intrinsic curvature at the base and at the tip, between which it changes linearly.
    """
    section = RoundSection(stiffness * 64 / np.pi, LinearTaper(1.0, ratio, length))
    return jw.Whisker(length, section, None if curvature is None else LinearTaper(*curvature, length))


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
    """Function of parameters and weights: value, forward and reverse derivative of the given function."""

    def both(p, weights):
        value, along = jax.linearize(function, p)
        return value, along(direction), jax.linear_transpose(along, p)(weights)[0]

    return both


def check_derivatives(function, p, *, seed, differences, visible, jit=False):
    """Check derivatives of weighted values by all parameters, in both modes and against central differences.

    Args:
        function: returns an array of values.
        p: the parameters, of which none is zero.
        seed: of the random weights and of the direction in forward mode.
        differences: tolerance of central differences, relative to the largest change when a parameter doubles.
        visible: least change of the weighted relative values when any parameter doubles.
        jit: whether to compile one program for everything.
    """
    rng = np.random.default_rng(seed)
    direction = p * jnp.asarray(rng.uniform(0.5, 1.0, p.size))
    weights = jnp.asarray(rng.normal(size=jax.eval_shape(function, p).shape))
    both = in_both_modes(function, direction)
    both = jax.jit(both) if jit else both

    def values(at):
        return both(at, weights)[0] if jit else function(at)

    value = values(p)
    assert np.all(np.isfinite(value))
    weights = weights / jnp.maximum(jnp.abs(value), 0.1)
    _, pushed, pulled = both(p, weights)
    assert np.all(np.abs(pulled * p) > visible)
    assert abs(weights @ pushed - pulled @ direction) < MODES * np.sum(np.abs(pulled * direction))
    for k, size in enumerate(p):
        step = DIFFERENCE * size
        ahead, behind = (values(p.at[k].add(sign * step)) for sign in (1, -1))
        difference = weights @ (ahead - behind) / (2 * step)
        assert abs(difference - pulled[k]) < differences * np.max(np.abs(pulled * p)) / np.abs(size), k
