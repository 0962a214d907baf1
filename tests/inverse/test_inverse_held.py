"""States of whiskers with springs on their shafts: bases under a reaction in closed form, rods against scipy."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._inverse.inverse_held import HeldObservation, _Phase, _state, _turned, base_under
from jaxwhisker._scan.loaded_rod import LoadedRod, loaded_rod

EXACT = 1e-12
ROD = 1e-9  # of rods that scipy integrates to 1e-12
DRIVE = np.array([0.2, -0.1, 0.3])
BASE, BELOW = (40.0, 0.25), (15.0, 0.21)  # stiffness and rest length of springs at the base and below it
AXIAL = jw.Spring((0, 1), 20.0, 0.2, axis="axial", at=0.4, anchor=(-0.15, 0.3))


def equations(*springs) -> LoadedRod:
    return loaded_rod(jw.Whisker(), (jw.PointForce(0.0),), jw.Support((jw.Spring((0, 1), *BASE), *springs)))[0]


def observed(known, reaction, pose=None, lean=None):
    return HeldObservation(jnp.asarray(reaction), jnp.ones(3), jnp.asarray(DRIVE), known, pose, lean)


def turned(vector, angle):
    x, y, rest = vector
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, rest])


def test_vectors_turn_counter_clockwise():
    np.testing.assert_allclose(_turned(jnp.array([1.0, 0.0, 5.0]), np.pi / 2), [0.0, 1.0, 5.0], atol=EXACT)
    np.testing.assert_allclose(_turned(jnp.array([0.3, 0.4, 5.0]), 0.7), turned([0.3, 0.4, 5.0], 0.7), atol=EXACT)


def test_the_base_lies_where_its_springs_carry_the_reaction():
    @jax.jit
    def bases(stiffness, force):
        def base(force):
            reaction = _turned(jnp.stack([force, -0.3, 0.2]), DRIVE[2])
            known = equations(AXIAL, jw.Spring((0, 1), stiffness, BELOW[1], at=-0.1))
            return base_under(observed(known, reaction))

        return jax.jvp(base, (force,), (jnp.ones(()),))

    # Springs at the base and below it act along x of the drive; the base turns in no other way.
    for stiffness, force in ((BELOW[0], -1.7), (1e-9, 0.4)):
        total = BASE[0] + stiffness
        x = (BASE[0] * BASE[1] + stiffness * BELOW[1] - force) / total
        found, slope = bases(stiffness, force)
        np.testing.assert_allclose(found, DRIVE + turned([x, 0.0, 0.0], DRIVE[2]), atol=EXACT)
        np.testing.assert_allclose(slope, turned([-1 / total, 0.0, 0.0], DRIVE[2]), atol=EXACT)


def by_scipy(pose, reaction, arc):
    """State, load and internal moment of the rod at an arc length beyond the axial spring, in the drive's frame."""

    def rate(s, values):
        x, y, phi, fx, fy, about = values
        return [np.cos(phi), np.sin(phi), about - x * fy + y * fx, 0.0, 0.0, 0.0]

    x, y, angle = pose
    fx, fy, mz = reaction
    values = np.array([x, y, np.pi / 2 + angle, -fx, -fy, -mz - x * fy + y * fx])
    values = solve_ivp(rate, (0.0, 0.4), values, rtol=1e-12, atol=1e-13).y[:, -1]
    away = values[:2] - [-0.15, 0.3]
    push = -20.0 * (np.hypot(*away) - 0.2) * away / np.hypot(*away)
    values[3:] -= *push, values[0] * push[1] - values[1] * push[0]
    values = solve_ivp(rate, (0.4, arc), values, rtol=1e-12, atol=1e-13).y[:, -1]
    x, y, phi, fx, fy, about = values
    return x, y, phi, fx, fy, about - x * fy + y * fx


def test_a_state_is_that_of_the_rod_past_its_springs():
    lean = 0.15

    @jax.jit
    def states(loads):
        known = equations(AXIAL)
        tip = _state(jnp.append(loads, 0.6), _Phase(jnp.asarray(True), jnp.zeros(())), observed(known, jnp.zeros(3)))
        tangent = _Phase(jnp.asarray(False), jnp.asarray(np.pi))
        return tip, _state(jnp.append(loads, 0.2), tangent, observed(known, jnp.zeros(3), lean=jnp.asarray(lean)))

    loads = np.array([1.1, -0.4, 0.5])  # on the springs between drive and base
    pose, reaction = np.array([BASE[1] + loads[0] / BASE[0], 0.0, 0.0]), -loads
    for state, arc, beyond, leaning in zip(states(loads), (1.0, 0.8), (0.6, np.pi), (0.0, lean), strict=True):
        x, y, phi, fx, fy, moment = by_scipy(pose, reaction, arc)
        slope = np.arctan2(fx, -fy) + leaning
        np.testing.assert_allclose(state.reaction, turned(reaction, DRIVE[2]), atol=EXACT)
        contact, base = (DRIVE + turned(at, DRIVE[2]) for at in ((x, y, slope), pose))
        np.testing.assert_allclose(state.values, [*contact, arc, *base, np.hypot(fx, fy)], atol=ROD)
        off = phi - slope - beyond
        angle = np.arctan2(np.sin(off), np.cos(off))
        np.testing.assert_allclose(state.conditions, [moment, angle], atol=ROD)
