"""Quadratic forms of a vibrating whisker against rigid motions, a cantilever and the exact gap to a circle."""

# pyright: reportArgumentType=false
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.elements import NODES
from jaxwhisker._dynamics.forms import Forms, Masses, condensed, forms_of, quadratic_of, reaction
from jaxwhisker._dynamics.line import Centreline, Equilibrium
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject

EXACT = 1e-10
LENGTHS = np.array([0.6, 0.4])  # of the elements of an upright whisker; the first one ends at its contact
RADIUS, FORCE, WEIGHT = 0.3, 2.5, 0.7

MASSES = Masses(jnp.ones((2, NODES)), jnp.asarray(0.2), jnp.asarray(0.3), jnp.asarray(0.1))


@jax.jit
def forms(phase, height, push):
    """Forms of an upright whisker, which may touch a circle at this height, and in which a force pushes down."""
    none = jnp.zeros((2, NODES))
    ends = jnp.zeros(2), jnp.cumsum(jnp.asarray(LENGTHS)), jnp.zeros(2), jnp.ones(2)
    line = Centreline(jnp.asarray(LENGTHS), none, none + 1, none, none - push, none + 1, ends, None, jnp.asarray(0))
    body: Any = WhiskerAtObject(jnp.ones(()), jnp.ones(()), jw.Circle(height - RADIUS, RADIUS), jw.Shooting())
    zero = jnp.zeros(())
    contact = {"contact_force": zero + FORCE, "contact_slope": zero + jnp.pi / 2, "contact_arc": height}
    at = Equilibrium(*[zero] * 6, **contact, contact_x=zero + RADIUS, contact_y=height, phase=phase)
    own = forms_of(body, at, line, MASSES)
    return own, condensed(own)


@pytest.fixture(scope="module")
def of():
    """Forms by phase; without contact, the whisker carries a weight."""
    cases = {Phase.free: (1.0, WEIGHT), Phase.tip: (1.0, 0.0), Phase.tangential: (0.6, 0.0)}
    return {phase: forms(jnp.asarray(int(phase)), jnp.asarray(h), jnp.asarray(w)) for phase, (h, w) in cases.items()}


def rigid(form, motion):
    motion = np.asarray(motion)
    return motion @ np.asarray(form)[-3:, -3:] @ motion


def test_rigid_motions_have_the_mass_and_the_inertia_of_the_whisker(of):
    own, _ = of[Phase.free]
    mass, inertia = 1.0 + 0.2 + 0.3, 1 / 3 + 0.2 + 0.1
    np.testing.assert_allclose(rigid(own.mass, [0.3, 0.4, 0.0]), mass * 0.25, rtol=EXACT)
    np.testing.assert_allclose(rigid(own.mass, [0.0, 0.0, 1.0]), inertia, rtol=EXACT)
    # The base turns counter-clockwise: what is above it moves towards -x.
    np.testing.assert_allclose(own.mass[-3, -1], -(1 / 2 + 0.2), rtol=EXACT)


def test_a_weight_makes_a_turned_whisker_fall(of):
    own, _ = of[Phase.free]
    assert rigid(own.stiffness, [0.3, 0.4, 0.0]) == pytest.approx(0.0, abs=EXACT)
    assert rigid(own.stiffness, [0.0, 0.0, 1.0]) == pytest.approx(-WEIGHT)
    assert np.all(own.constraints == 0) and own.defined


def test_a_held_whisker_has_the_frequencies_of_a_cantilever(of):
    heavy = forms(jnp.asarray(0), jnp.asarray(1.0), jnp.asarray(0.0))
    along = heavy[0].mass - 0.2 * np.asarray(heavy[0].fields.ends[-1, :2]).T @ heavy[0].fields.ends[-1, :2]
    flexibility = np.asarray(heavy[1].flexibility)
    inner = flexibility.shape[0]
    mu = np.sort(np.linalg.eigvals(flexibility @ along[:inner, :inner]).real)[::-1]
    np.testing.assert_allclose(mu[:2] ** -0.5, [1.8751040687**2, 4.6940911330**2], rtol=1e-8)


def test_a_shaft_that_turns_and_slides_along_a_circle_has_the_second_variation_of_its_distance(of):
    own, _ = of[Phase.tangential]
    turn, slide, step = 0.7, -0.4, 1e-4

    def gap(by):
        """Distance of the line from the circle; the point at the contact slides, and the line turns about it."""
        return RADIUS * np.cos(by * turn) + by * slide * np.sin(by * turn) - RADIUS

    second = (gap(step) - 2 * gap(0.0) + gap(-step)) / step**2
    motion = [0.6 * turn, slide, turn]
    assert rigid(own.stiffness, motion) == pytest.approx(-FORCE * second, rel=1e-6)
    np.testing.assert_allclose(own.constraints[:, -3:] @ np.array(motion), 0, atol=EXACT)
    np.testing.assert_allclose(own.constraints[:, -3:] @ np.eye(3)[0], 1, atol=EXACT)


def test_a_tip_that_slides_along_a_circle_has_the_second_variation_of_its_distance(of):
    own, _ = of[Phase.tip]
    assert rigid(own.stiffness, [0.7, -0.4, 0.7]) == pytest.approx(-FORCE * 0.4**2 / RADIUS)
    np.testing.assert_allclose(own.constraints[:, -3:], [[1.0, 0.0, -1.0]], atol=EXACT)


def drawn():
    """Random forms with one constraint and one that is unused."""
    rng = np.random.default_rng(0)
    root, rows = rng.normal(size=(2, 8, 8)), np.zeros((2, 8))
    rows[0] = rng.normal(size=8)
    mass, stiffness = (half @ half.T + np.eye(8) for half in root)
    given = (jnp.asarray(each) for each in (mass, stiffness, np.zeros((3, 3)), rows))
    fields: Any = None
    return Forms(*given, defined=jnp.asarray(True), fields=fields), mass, stiffness, rows[0], rng


def test_a_condensed_whisker_follows_its_base_in_equilibrium_and_keeps_its_contact():
    own, _, stiffness, row, rng = drawn()
    found = jax.jit(condensed)(own._replace(fields=None))
    base, push = rng.normal(size=(2, 8))
    base = base[:3]
    saddle = np.block([[stiffness[:5, :5], row[:5, None]], [row[None, :5], np.zeros((1, 1))]])
    inner = np.linalg.solve(saddle, -np.append(stiffness[:5, 5:] @ base, row[5:] @ base))[:5]
    np.testing.assert_allclose(found.follows @ base, inner, atol=EXACT)
    whole = np.append(inner, base)
    np.testing.assert_allclose(base @ found.held @ base, whole @ stiffness @ whole, rtol=EXACT)
    moved = np.linalg.solve(saddle, np.append(push[:5], 0.0))[:5]
    np.testing.assert_allclose(found.flexibility @ push[:5], moved, atol=EXACT)
    np.testing.assert_allclose(row[:5] @ found.flexibility, 0, atol=EXACT)


def test_the_reaction_balances_inertia_stiffness_and_contact():
    own, mass, stiffness, row, rng = drawn()
    rate, contact, base = 0.01, 0.8, rng.normal(size=3)
    whole = stiffness - rate * mass
    inner = np.linalg.solve(whole[:5, :5], contact * row[:5] - whole[:5, 5:] @ base)
    mode = np.append(inner, base)
    expected = whole[5:] @ mode - contact * row[5:]
    found = jax.jit(reaction)(own._replace(fields=None), jnp.asarray(mode), rate)
    np.testing.assert_allclose(found, expected, atol=EXACT)
    form = quadratic_of(jnp.asarray(row[None, None]), jnp.full((1, 1, 1), 3.0))
    np.testing.assert_allclose(form, 3 * np.outer(row, row), atol=EXACT)
