"""Whiskers that base springs couple in a row, each with a spring on its shaft and a torsion spring.

Equilibrium is checked from the fields of a Result alone, with the rod integrated outwards by NumPy.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from independent_shaft import along

import jaxwhisker as jw
from scenes import all_ok

WHISKERS = 3
EQUILIBRIUM = 1e-8  # relative to the largest force
CONTROL = np.linspace(1.3, -0.9, 23)
DIFFERENCE = 1e-5
BY_DIFFERENCES = 1e-6  # of the largest derivative
ROD = jw.Shooting(steps=16)
TURN = 8.0
HEIGHTS = np.array([0.1, 0.15, 0.2, 0.12])


def springs(count: int = WHISKERS, heights: Any = HEIGHTS):
    row = (jw.Spring((k, k + 1), 80.0 - 10 * k, 0.2) for k in range(count))
    turns = (jw.Spring((0, k + 1), TURN + k, 0.02 * k, axis="phi") for k in range(count))
    # Not where the whiskers are at rest: they are bent before they touch.
    shafts = (
        jw.Spring((0, k + 1), 30.0, 0.21 * (k + 1), at=heights[k], axis="axial", anchor=(0.0, 0.09 + 0.01 * k))
        for k in range(count)
    )
    return (*row, *turns, *shafts)


def scene(count: int = WHISKERS, heights: Any = HEIGHTS):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.35), jw.Support(springs(count, heights)), ROD)


@cache
def scanned():
    return jw.scan(scene(), CONTROL)


def states(result):
    fields = ("base_x", "base_y", "base_angle", "fx", "fy", "mz", "contact_force", "contact_slope", "contact_arc")
    return SimpleNamespace(**{name: np.asarray(getattr(result, name)) for name in fields})


def test_bases_and_whiskers_are_in_equilibrium():
    result = scanned()
    assert all_ok(result)
    at, phase = states(result), np.asarray(result.phase)
    assert phase.any(axis=0).all() and any(p.any() and not p.all() for p in phase)  # some touch while others are free
    assert np.abs(at.mz[0]).max() > 0.01  # bent before any contact
    size = np.max(np.abs(np.stack([at.fx, at.fy, at.mz])))
    u = CONTROL[:, None]
    row = 80.0 - 10 * np.arange(WHISKERS)
    x = np.concatenate([u, at.base_x], axis=1)
    tension = row * (np.diff(x, axis=1) - 0.2)
    np.testing.assert_allclose(result.spring_length[:, :WHISKERS], np.diff(x, axis=1), atol=EQUILIBRIUM)
    # Each base is pulled back by the spring before it and forwards by the one behind it.
    pulled = -tension + np.concatenate([tension[:, 1:], np.zeros_like(u)], axis=1)
    np.testing.assert_allclose(at.fx, pulled, atol=EQUILIBRIUM * size)
    turned = -(TURN + np.arange(WHISKERS)) * (at.base_angle - 0.02 * np.arange(WHISKERS))
    np.testing.assert_allclose(at.mz, turned, atol=EQUILIBRIUM * size)
    np.testing.assert_allclose(at.base_y, 0.0, atol=EQUILIBRIUM)
    for k in range(WHISKERS):
        state = np.stack([at.base_x[:, k], at.base_y[:, k], np.pi / 2 + at.base_angle[:, k]])
        fx, fy = at.fx[:, k], at.fy[:, k]
        load = np.stack([-fx, -fy, -at.mz[:, k] - state[0] * fy + state[1] * fx])
        x, y, _ = state = along(state, load, HEIGHTS[k])
        right, up = x - CONTROL, y - 0.09 - 0.01 * k
        length = np.hypot(right, up)
        np.testing.assert_allclose(result.spring_length[:, 2 * WHISKERS + k], length, atol=EQUILIBRIUM)
        pull = -30.0 * (length - 0.21 * (k + 1)) / length
        load -= np.stack([pull * right, pull * up, x * pull * up - y * pull * right])
        end = np.where(phase[:, k] == jw.Phase.free, 1.0, at.contact_arc[:, k])
        x, y, _ = along(state, load, end - HEIGHTS[k])
        force, slope = at.contact_force[:, k], at.contact_slope[:, k]
        np.testing.assert_allclose(load[0], force * np.sin(slope), atol=EQUILIBRIUM * size)
        np.testing.assert_allclose(load[1], -force * np.cos(slope), atol=EQUILIBRIUM * size)
        np.testing.assert_allclose(load[2] - x * load[1] + y * load[0], 0.0, atol=EQUILIBRIUM * size)


def test_the_place_of_one_spring_moves_the_signals_of_its_neighbours():
    steps = CONTROL[::4]

    def signals(height):
        result = jw.scan(scene(heights=jnp.asarray(HEIGHTS).at[1].set(height)), steps)
        return jnp.concatenate([result.mz, result.base_x], axis=1)

    at = jnp.asarray(HEIGHTS[1])
    _, slope = jax.jvp(signals, (at,), (jnp.ones(()),))
    difference = (signals(at + DIFFERENCE) - signals(at - DIFFERENCE)) / (2 * DIFFERENCE)
    np.testing.assert_allclose(slope, difference, atol=BY_DIFFERENCES * np.max(np.abs(slope)))
    assert np.all(np.max(np.abs(slope), axis=0) > 1e-3)


def test_an_invalid_place_leaves_the_other_lane_alone():
    heights = np.stack([HEIGHTS, np.where(np.arange(4) == 1, 1.5, HEIGHTS)])
    result = jax.vmap(lambda heights: jw.scan(scene(heights=heights), CONTROL))(heights)
    assert np.all(result.status[1] == jw.Status.invalid) and np.all(np.isnan(result.mz[1]))
    np.testing.assert_allclose(result.mz[0], scanned().mz, atol=1e-9 * np.max(np.abs(scanned().mz)))
