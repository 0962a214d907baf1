"""Shafts against whiskers that SciPy integrates in the scene, from the contact to both ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import shaft
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._model.along import LinearTaper
from jaxwhisker._rod.rod import Section

POINTS = 2e-6  # promised of a uniform whisker, between its points; they are better
CURVED = 1e-5  # promised of a curved and conical one
ROUNDING = 1e-13

LENGTH, STIFFNESS, RHO = 1.2, 1.6, 0.25
PARABOLA = jw.Parabola(0.2, 1.3, -0.1)
TIP, TANGENTIAL = int(Phase.tip), int(Phase.tangential)
# Force, slope angle, slack, phase, side of a contact.
CONTACTS = [(3.0, 0.5, 0.3, TANGENTIAL, 1.0), (2.0, -0.4, 0.2, TANGENTIAL, -1.0), (1.5, 0.3, -0.4, TIP, 1.0)]


def stiffness_of(s):
    return STIFFNESS * (1 - 0.5 * s / LENGTH)


def curvature_of(s):
    return 0.3 + 0.5 * s


@Program
def shafts(z, phase, side, section, slip):
    """The shafts of many whiskers; with friction if there are slips."""
    one = jnp.asarray(1.0)
    body = WhiskerAtObject(
        one * LENGTH, one * STIFFNESS, PARABOLA, jw.ClosedForm() if section is None else jw.Shooting(), section
    )
    friction = None
    if slip is not None:
        body = body._replace(friction_angle=one * RHO)
        friction = Friction(slip, jnp.zeros_like(side), jnp.zeros_like(side))
    return jax.vmap(lambda *own: shaft.shaft(body, *own))(z, phase, side, friction)


def computed(section=None, slip=None):
    """The shafts of all contacts."""
    z, phase, side = np.split(np.array(CONTACTS), [3, 4], axis=1)
    slips = None if slip is None else jnp.asarray(slip)
    return shafts(jnp.asarray(z), jnp.asarray(phase[:, 0].astype(int)), jnp.asarray(side[:, 0]), section, slips)


def integrated(contact, ends, lean=0.0, curved=False):
    """States x, y, phi of the whisker at arc lengths from the contact, by equilibrium in the scene."""
    force, slope, slack, phase, side = contact
    x, y = -0.1 + np.tan(slope) / 2.6, 0.2 + np.tan(slope) ** 2 / 5.2
    fx, fy = force * np.sin(slope - lean), -force * np.cos(slope - lean)
    # Tangential, or at an angle to the object from which its tip points into it.
    phi = slope if side > 0 else slope + np.pi
    phi += -side * slack if phase == TIP else 0.0
    arc = LENGTH - (slack if phase == TANGENTIAL else 0.0)

    def rate(s, state):
        # The part of the whisker beyond a point is loaded by the contact alone, if the contact lies there.
        moment = (x - state[0]) * fy - (y - state[1]) * fx if s <= 0 else 0.0
        stiffness, curvature = (stiffness_of(arc + s), curvature_of(arc + s)) if curved else (STIFFNESS, 0.0)
        return [np.cos(state[2]), np.sin(state[2]), curvature + moment / stiffness]

    ends = np.asarray(ends)
    if ends[-1] == 0:
        return np.tile([x, y, phi], (ends.size, 1)).T
    solved = solve_ivp(rate, (0.0, ends[-1]), [x, y, phi], t_eval=ends, rtol=1e-11, atol=1e-12)
    return solved.y


def check(own, contact, tolerance, *, lean=0.0, curved=False):
    """Compare a shaft with the integrated whisker."""
    _, _, slack, phase, _ = contact
    beyond = slack if phase == TANGENTIAL else 0.0
    for line, length in ((own.to_base, -(LENGTH - beyond)), (own.to_tip, beyond)):
        ends = np.append(0.0, np.cumsum(line.cell))
        np.testing.assert_allclose(ends[-1], length, atol=ROUNDING)
        x, y, phi = integrated(contact, ends, lean, curved)
        for found, expected in ((line.x, x), (line.y, y), (line.cos, np.cos(phi)), (line.sin, np.sin(phi))):
            np.testing.assert_allclose(found, expected, atol=tolerance)
    for name in ("x", "y", "cos", "sin"):
        np.testing.assert_allclose(getattr(own.base, name), getattr(own.to_base, name)[-1], atol=tolerance)


def each(tree):
    return [jax.tree.map(lambda leaf, k=k: np.asarray(leaf[k]), tree) for k in range(len(CONTACTS))]


def test_uniform_whiskers():
    for own, contact in zip(each(computed()), CONTACTS, strict=True):
        check(own, contact, POINTS)
        assert own.parameter == contact[1]


def test_whiskers_that_are_curved_and_conical():
    one = jnp.asarray(1.0)
    section = Section(LinearTaper(STIFFNESS, 0.5 * STIFFNESS, LENGTH), LinearTaper(0.3, 0.9, LENGTH), one, one)
    for own, contact in zip(each(computed(section)), CONTACTS, strict=True):
        check(own, contact, CURVED, curved=True)


@pytest.mark.parametrize("slip", [1, -1])
def test_with_friction_the_force_leans_against_the_slip(slip):
    for own, contact in zip(each(computed(slip=[slip] * 3)), CONTACTS, strict=True):
        check(own, contact, POINTS, lean=slip * RHO)


def test_a_shaft_moves_as_a_rigid_body():
    whole = jax.tree.map(lambda leaf: leaf[0], computed())
    x, y, angle = 0.4, -0.3, 0.7
    moved = Program(shaft.moved)(whole, *map(jnp.asarray, (x, y, angle)))
    np.testing.assert_allclose([moved.to_base.x[-1], moved.to_base.y[-1]], [x, y], atol=POINTS)
    np.testing.assert_allclose(
        [moved.to_base.cos[-1], moved.to_base.sin[-1]], [-np.sin(angle), np.cos(angle)], atol=POINTS
    )
    turn = np.pi / 2 + angle - np.arctan2(whole.base.sin, whole.base.cos)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for before, after in ((whole.to_base, moved.to_base), (whole.to_tip, moved.to_tip)):
        right, up = turned @ np.array([before.x - whole.base.x, before.y - whole.base.y])
        np.testing.assert_allclose([after.x, after.y], [x + right, y + up], atol=ROUNDING)
        np.testing.assert_allclose([after.cos, after.sin], turned @ [before.cos, before.sin], atol=ROUNDING)
        np.testing.assert_array_equal(after.cell, before.cell)
    # Where it already is, nothing moves.
    pose = whole.base.x, whole.base.y, jnp.arctan2(-whole.base.cos, whole.base.sin)
    same = Program(shaft.moved)(whole, *pose)
    np.testing.assert_allclose(same.to_base.x, whole.to_base.x, atol=ROUNDING)
