"""Derivatives of every law of contact, and of kinds of events, by the rules that all transformations of scans share.

A rule attaches the derivatives of an equilibrium or an event to its values. Here, both modes of it are compared with
differences between whole scans, which need no further program. Scans below a caller's jit are in test_derivatives.py.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import EventKind as Kind

STEP = 1e-5  # of central differences, for parameters of order one
DIFFERENCES = 2e-6  # central differences lose half of the digits; relative to 1 + the largest derivative of a channel
HISTORY = 2e-5  # ... and in space with friction, contacts follow polynomials, which are accurate to 1e-10
MODES = 1e-10  # forward and reverse mode: the same sums in a different order; relative to the largest
EVENTS = 8  # the first ones of a scan
NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
TIP, TANGENTIAL = jw.Phase.tip, jw.Phase.tangential


class Law(NamedTuple):
    """A kind of scenes, by the first three of its numbers, and what its scan must pass through."""

    scene: Callable[[Any], Any]
    at: tuple[float, float, float]
    control: Any
    phases: set[jw.Phase]
    events: set[Kind] | None = None  # None if derivatives of events are left to other tests


def past_a_polygon(p):
    faces = jnp.array([(-0.5, 0.75), (-0.32, 0.42), (0.24, 0.36), (0.52, 0.75)])
    polygon = jw.Polygon(faces + p[:2] * jnp.array([0.1, 1.0]))
    return jw.Scene(jw.Whisker(), polygon, jw.Support.fb(70.0 * p[2], 0.2))


def on_its_shaft(p):
    springs = jw.Spring((0, 1), 70.0 * p[1]), jw.Spring((0, 1), 30.0, at=0.2 * p[2])
    return jw.Scene(jw.Whisker(), jw.Parabola(p[0]), jw.Support(springs))


def past_a_ball(p, friction=None):
    return jw.Scene(jw.Whisker(bending_stiffness=p[2]), jw.Sphere(0.6, (p[0], 0.9 + p[1], 0.2)), friction=friction)


LAWS = {
    "corners and faces": Law(
        past_a_polygon, (0.0, 0.35, 1.0), np.linspace(0.6, -1.0, 13), {TIP, TANGENTIAL}, {Kind.touch, Kind.edge}
    ),
    "friction, with a turn": Law(
        lambda p: jw.Scene(jw.Whisker(), jw.Parabola(p[0]), jw.Support.fb(70.0 * p[1], 0.2), friction=p[2]),
        *((0.25, 1.0, 0.3), np.array([0.9, 0.3, 0.0, -0.2, 0.0, 0.2]), {TIP, TANGENTIAL}),
        {Kind.touch, Kind.tip_to_tangential, Kind.slip},
    ),
    "springs on the shaft": Law(on_its_shaft, (0.3, 1.0, 1.0), np.linspace(0.6, -0.5, 9), {TIP, TANGENTIAL}),
    "bases free along all axes": Law(
        lambda p: jw.Scene(jw.Whisker(), jw.Parabola(p[0]), jw.Support.follicle(100.0 * p[1], 100.0, 5.0 * p[2])),
        *((0.3, 1.0, 1.0), np.linspace(0.65, -1.15, 13), {TIP, TANGENTIAL}),
    ),
    "in space": Law(
        *(past_a_ball, (0.1, 0.2, 1.0), np.linspace(0.75, -1.15, 13), {TIP, TANGENTIAL}),
        {Kind.touch, Kind.tip_to_tangential},
    ),
    "in space, with friction": Law(
        lambda p: past_a_ball(p, 0.3), (0.1, 0.2, 1.0), np.append(np.linspace(0.75, -0.3, 8), 0.1), {TIP, TANGENTIAL}
    ),
}


def observed(law: Law, p: Any) -> tuple[list[Any], Any]:
    """Reactions of all steps and positions of events of a scan, and the scan."""
    result = jw.scan(law.scene(p), law.control)
    reactions = jnp.stack([getattr(result, name)[:, 0] for name in NAMES if hasattr(result, name)], axis=-1)
    return [reactions] if law.events is None else [reactions, result.events.control[:EVENTS]], result


@cache
def derived(name: str) -> tuple[Any, list, list]:
    """The scan of a kind, the slopes of its reactions and events in forward mode, and their differences."""
    law, p = LAWS[name], jnp.array(LAWS[name].at)
    slopes = jax.jacfwd(lambda p: observed(law, p)[0])(p)
    steps = STEP * np.eye(3)
    pairs = [zip(observed(law, p + step)[0], observed(law, p - step)[0], strict=True) for step in steps]
    columns = [[(np.asarray(a) - np.asarray(b)) / (2 * STEP) for a, b in pair] for pair in pairs]
    return observed(law, p)[1], slopes, [np.stack(each, axis=-1) for each in zip(*columns, strict=True)]


@pytest.mark.parametrize("name", LAWS)
def test_slopes_are_those_of_differences(name):
    _, slopes, differences = derived(name)
    assert np.all(np.max(np.abs(slopes[0]), axis=(0, 1)) > 1e-3)  # every number matters
    for found, expected in zip(slopes, differences, strict=True):
        known = np.isfinite(expected)
        assert np.any(known)  # there may be fewer events than places for them
        found, expected = np.where(known, found, 0.0), np.where(known, expected, 0.0)
        size = 1 + np.max(np.abs(expected), axis=0)
        np.testing.assert_allclose(
            found / size, expected / size, atol=HISTORY if "space, with" in name else DIFFERENCES
        )


@pytest.mark.parametrize("name", LAWS)
def test_scans_pass_through_the_law(name):
    law, (result, _, _) = LAWS[name], derived(name)
    assert np.all(result.status == jw.Status.ok)
    assert law.phases <= set(np.unique(result.phase).tolist())
    if law.events is not None:
        assert law.events <= set(np.asarray(result.events.kind)[: int(result.events.count)].tolist())


@pytest.mark.parametrize("name", LAWS)
def test_both_modes_agree(name):
    law, (_, slopes, _), random = LAWS[name], derived(name), np.random.default_rng(1)
    weights = [np.where(np.isfinite(slope[..., 0]), random.normal(size=slope.shape[:-1]), 0.0) for slope in slopes]

    def weighted(p):
        values = observed(law, p)[0]
        return sum(jnp.sum(jnp.where(w == 0, 0.0, w * value)) for w, value in zip(weights, values, strict=True))

    each = zip(weights, slopes, strict=True)
    expected = sum(np.nansum(w[..., None] * slope, axis=tuple(range(w.ndim))) for w, slope in each)
    np.testing.assert_allclose(jax.grad(weighted)(jnp.array(law.at)), expected, atol=MODES * np.max(np.abs(expected)))
