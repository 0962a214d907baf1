"""The line of a whisker against an initial value problem that SciPy solves, and where its elements end."""

# pyright: reportArgumentType=false
import itertools
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._dynamics.elements import POINTS
from jaxwhisker._dynamics.line import LOADS, DeadLoads, Equilibrium, ends_of, line_of
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject
from jaxwhisker._equilibrium.line_loads import ScaledLineLoad

EXACT = 1e-9  # of integrated rods
STIFFNESS, LENGTH, ARC, PLACE = 1.3, 1.1, 0.8, 0.35
BASE, REACTION = (0.2, -0.1, 0.3), (0.9, -0.4, -0.8)
LOAD = 0.3, -0.5, 0.2  # force and moment at PLACE
BREAKS = 0.5, 1.0


def body() -> Any:
    return WhiskerAtObject(jnp.asarray(LENGTH), jnp.asarray(STIFFNESS), jw.Parabola(0.2), jw.Shooting())


@jax.jit
def line(phase, reaction):
    numbers = [jnp.asarray(value) for value in BASE]
    contact = [jnp.asarray(value) for value in (0.0, 0.0, ARC, 0.0, 0.0)]
    at = Equilibrium(*numbers, *reaction, *contact, phase=phase)
    loads = DeadLoads(jnp.array([PLACE]), *(jnp.array([value]) for value in LOAD), lines=())
    ends = ends_of(body(), at, loads, jnp.array(BREAKS))
    return ends, line_of(body(), at, ends, loads)


@pytest.fixture(scope="module")
def lines():
    """A free whisker, one in tangential contact, and one whose reaction is not known."""
    phases = jnp.array([Phase.free, Phase.tangential, Phase.free])
    reactions = jnp.tile(jnp.array(REACTION), (3, 1)).at[2, 0].set(jnp.nan)
    return jax.jit(jax.vmap(lambda phase, reaction: line(phase, reaction)))(phases, reactions)


def integrated(arcs, unloaded):
    """x, y, angle and force at these arc lengths, outwards; without any load beyond the place `unloaded`."""
    states, force = [], []
    for s in np.ravel(arcs):
        y, (fx, fy, mz) = np.array([BASE[0], BASE[1], np.pi / 2 + BASE[2]]), REACTION
        load, moment = np.array([-fx, -fy]), -mz
        at, start = 0.0, y[:2].copy()
        for stop in (PLACE, unloaded, np.inf):
            end = min(stop, s)

            def rate(_, y, load=load, moment=moment, start=start):
                apart = y[:2] - start
                bend = moment - apart[0] * load[1] + apart[1] * load[0]
                return [np.cos(y[2]), np.sin(y[2]), bend / STIFFNESS]

            if end > at:
                y = solve_ivp(rate, (at, end), y, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
                apart = y[:2] - start
                moment, start, at = moment - apart[0] * load[1] + apart[1] * load[0], y[:2].copy(), end
            if s <= stop:
                break
            load, moment = (load - LOAD[:2], moment - LOAD[2]) if stop == PLACE else (0 * load, 0.0)
        states.append(y)
        force.append(load)
    return np.array(states).T, np.array(force).T


@pytest.mark.parametrize(("lane", "unloaded"), [(0, np.inf), (1, ARC)])
def test_the_line_follows_the_moment_and_loses_what_it_has_passed(lines, lane, unloaded):
    ends, found = jax.tree.map(lambda leaf: np.asarray(leaf[lane]), lines)
    few = slice(None, None, 9)
    starts = ends.order.at - found.lengths
    arcs = starts[:, None] + found.lengths[:, None] * POINTS[few]
    (_, _, angle), (force_x, force_y) = integrated(arcs, unloaded)
    for got, expected in zip(
        (found.cos, found.sin, found.force_x, found.force_y),
        (np.cos(angle), np.sin(angle), force_x, force_y),
        strict=True,
    ):
        np.testing.assert_allclose(got[:, few].ravel(), expected, atol=EXACT)
    (x, y, angle), _ = integrated(ends.order.at, unloaded)
    np.testing.assert_allclose(found.ends, [x, y, np.cos(angle), np.sin(angle)], atol=EXACT)
    assert np.all(found.stiffness == STIFFNESS)


def test_elements_end_at_loads_breaks_the_contact_and_the_tip(lines):
    ends, found = jax.tree.map(np.asarray, lines)
    split = [(PLACE + LENGTH) / 2, ARC]  # a free whisker is split anywhere
    for k, at in enumerate(split):
        np.testing.assert_allclose(ends.order.at[k], sorted([PLACE, at, LENGTH, *BREAKS]), rtol=1e-14)
        assert ends.order.at[k][ends.contact[k]] == at and found.contact[k] == ends.contact[k]
        assert ends.order.at[k][ends.order.ranks[LOADS][k]] == [PLACE]


def test_a_reaction_that_is_not_known_spoils_its_own_line(lines):
    _, found = lines
    assert np.isnan(found.cos[2]).any() and np.isfinite(found.cos[:2]).all()


def test_a_distributed_load_acts_between_its_ends():
    low, high, across, along = 0.2, 0.6, 0.4, -0.7
    spread = ScaledLineLoad(jw.LineLoad(across, along), jnp.asarray(low), jnp.asarray(high), 1.0, 1.0)
    at = Equilibrium(*map(jnp.asarray, (*BASE, *REACTION, 0.0, 0.0, ARC, 0.0, 0.0)), phase=jnp.asarray(Phase.free))
    loads = DeadLoads(*[jnp.zeros(0)] * 4, lines=(spread,))
    ends = ends_of(body(), at, loads, None)
    found = line_of(body(), at, ends, loads)

    def rate(push_x, push_y, _, values):
        x, y, angle, fx, fy, about = values
        turn = (about - x * fy + y * fx) / STIFFNESS
        return [np.cos(angle), np.sin(angle), turn, -push_x, -push_y, y * push_x - x * push_y]

    (x, y, angle), (fx, fy, mz) = BASE, REACTION
    values, states = np.array([x, y, np.pi / 2 + angle, -fx, -fy, -mz - x * fy + y * fx]), []
    for start, end in itertools.pairwise([0.0, *np.asarray(ends.arcs)]):
        push = (across, along) if low <= start < high else (0.0, 0.0)
        values = solve_ivp(partial(rate, *push), (start, end), values, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        states.append([values[0], values[1], np.cos(values[2]), np.sin(values[2])])
    np.testing.assert_allclose(np.transpose(found.ends), states, atol=EXACT)
    arcs = (ends.arcs - found.lengths)[:, None] + found.lengths[:, None] * POINTS
    passed = np.clip(arcs - low, 0.0, high - low)
    np.testing.assert_allclose(found.force_x, -fx - across * passed, atol=EXACT)
    np.testing.assert_allclose(found.force_y, -fy - along * passed, atol=EXACT)
