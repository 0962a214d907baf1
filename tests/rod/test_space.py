"""Rods in space: helices, rods in a plane, scipy's DOP853, and what stays constant along a rod."""

# pyright: reportArgumentType=false, reportCallIssue=false

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rod_in_space
from scipy.spatial.transform import Rotation

from functions import Linear, Step
from jaxwhisker._base.quaternions import product, small_rotation, third_axis, turned
from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._rod import rod, space
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.space import SpaceLoad, SpaceSection

ROUNDING = 1e-13  # of integrations over many steps
EXACT = 1e-11  # scipy's error, and that of the numbers of steps below
PLANE = 1e-12  # of rods in a plane, with many steps
MANY = 64  # steps with errors near rounding
FORCE, MOMENT = np.array([1.3, -0.4, 1.9]), np.array([-0.3, 0.6, 0.2])
TURN = np.array([0.5, -0.1, 0.7, 0.5])  # a unit quaternion
ORIGIN = (0.0, 0.0, 0.0)


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: float
    base: float = 1.0

    def __call__(self, s):
        return self.base * (1 - self.taper * s) ** 4


class Wave(eqx.Module):
    """A smooth function of arc length."""

    mean: float
    size: float

    def __call__(self, s):
        return self.mean + self.size * jnp.sin(3 * s)


def stacked(state):
    r, q = state
    return np.concatenate([np.ravel(r), np.ravel(matrix_of(q))])


@eqx.filter_jit
def end(section, arc=0.9, force=FORCE, turn=TURN, steps=MANY, moment=None):
    load = SpaceLoad(tuple(force), space.NONE if moment is None else tuple(moment))
    return space.integrate((ORIGIN, tuple(turn)), arc, load, section, steps=steps, from_base=arc)


JUMP = Step(jnp.array(0.37), jnp.array(1.6), jnp.array(0.5))
SECTIONS = {
    "straight": SpaceSection(1.2),
    "curved": SpaceSection(1.2, 1.0, (None, -0.8, None)),
    "straight with torsion": SpaceSection(1.2, 0.7),
    "curved and twisted": SpaceSection(1.2, 0.7, (0.5, -0.8, 1.1)),
    "cone": SpaceSection(Cone(0.7), None, (None, 0.6, None)),
    "cone with torsion": SpaceSection(Cone(0.7), 0.6, (None, 0.6, 0.4)),
    "functions": SpaceSection(Wave(1.4, 0.3), 0.7, (Linear(0.4, -0.7), Wave(-0.5, 0.4), Wave(0.3, 0.6))),
    "breaks": SpaceSection(JUMP, 0.7, (Linear(0.4, 0.2), JUMP, None), breaks=jnp.array([0.37])),
}


@pytest.mark.parametrize("name", SECTIONS)
def test_rods_agree_with_scipy(name):
    section, breaks = SECTIONS[name], () if SECTIONS[name].breaks is None else (0.37,)

    def value(part, s):
        return 0.0 if part is None else float(part(s)) if callable(part) else part

    expected = rod_in_space.end(
        FORCE,
        0.9,
        matrix_of(tuple(TURN)),
        partial(value, section.bending_stiffness),
        section.torsion_ratio or 1.0,
        lambda s: np.array([value(part, s) for part in section.curvature]),
        breaks,
    )
    got = stacked(end(section))
    np.testing.assert_allclose(got, np.concatenate([expected[0], np.ravel(expected[1])]), atol=EXACT)


@pytest.mark.parametrize(("name", "steps"), [("straight", 3), ("curved and twisted", 4), ("cone with torsion", 16)])
def test_order_of_convergence(name, steps):
    exact, errors = stacked(end(SECTIONS[name])), []
    for count in (steps, 2 * steps):
        errors.append(np.max(np.abs(stacked(end(SECTIONS[name], steps=count)) - exact)))
    assert 5.5 < np.log2(errors[0] / errors[1]) < 7.5
    assert errors[1] > 10 * ROUNDING


@pytest.mark.parametrize("roll", [0.0, np.pi])
@pytest.mark.parametrize("stiffness", [1.0, Cone(0.6)])
def test_rods_in_a_plane(roll, stiffness):
    """At roll 0, d2 is the axis of the plane's rotation; half a turn reverses the curvature."""
    angle, bow = 0.4, Linear(0.5, 0.6)
    sign = 1.0 if roll == 0 else -1.0
    flat = Section(stiffness, bow, 1.0, 1.0)
    start, load = (0.0, 0.0, np.cos(angle), np.sin(angle)), rod.Load(0.3, -2.0, None)
    x, y, cos, sin = rod.integrate(start, 0.8, load, flat, steps=MANY, from_base=0.8)

    # The plane's x and y axes are those in space, and its rotations are about z: t = (cos, sin, 0), d2 = z.
    tangent, axis = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    first = np.cross(axis, tangent)
    turn = quaternion(np.stack([sign * first, sign * axis, tangent], axis=1))
    section = SpaceSection(stiffness, 0.7, (None, Linear(sign * 0.5, sign * 0.6), None))
    load = SpaceLoad((0.3, -2.0, None))
    r, q = space.integrate((ORIGIN, tuple(turn)), 0.8, load, section, steps=MANY, from_base=0.8)
    np.testing.assert_allclose(r, [x, y, 0.0], atol=PLANE)
    np.testing.assert_allclose(third_axis(q), [cos, sin, 0.0], atol=PLANE)


def quaternion(rotation):
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def test_an_unloaded_rod_is_a_helix():
    k, twist, at = 0.9, 1.4, np.linspace(0.0, 1.0, 33)
    section, load = SpaceSection(1.0, 0.7, (None, k, twist)), SpaceLoad((None, None, 0.0))
    r, q = space.points((ORIGIN, tuple(TURN)), 1.5, load, section, at=jnp.asarray(at), from_base=1.5)
    axis = np.array(turned(tuple(TURN), (0.0, k, twist))) / np.hypot(k, twist)
    radius, pitch = k / (k**2 + twist**2), 2 * np.pi * twist / (k**2 + twist**2)
    turns = -1.5 * at * np.hypot(k, twist) / (2 * np.pi)
    r, towards_axis = np.stack(r, axis=1), np.moveaxis(np.array(matrix_of(q)), 0, 2)[:, 0].T
    np.testing.assert_allclose(r @ axis, turns * pitch, atol=ROUNDING)
    centres = r + radius * towards_axis
    centres -= np.outer(centres @ axis, axis)
    np.testing.assert_allclose(centres, np.tile(centres[0], (33, 1)), atol=ROUNDING)


def test_the_hamiltonian_is_constant_along_a_uniform_rod():
    section = SECTIONS["curved and twisted"]
    load, at = SpaceLoad(tuple(FORCE)), jnp.linspace(0.0, 1.0, MANY + 1)
    states = space.points((ORIGIN, tuple(TURN)), 0.9, load, section, at=at, from_base=0.9)
    k = np.stack(jax.vmap(lambda *state: space.curvature(state, load, section, 0.0))(*states))
    own = np.array([0.5, -0.8, 1.1])[:, None]
    moment = 1.2 * np.array([1.0, 1.0, 0.7])[:, None] * (k - own)
    energy = np.sum(moment * (k - own) / 2 + moment * own, axis=0) + FORCE @ np.stack(third_axis(states[1]))
    np.testing.assert_allclose(energy, FORCE @ np.array(third_axis(tuple(TURN))), atol=EXACT)


@pytest.mark.parametrize("name", ["curved and twisted", "cone with torsion"])
def test_a_rotation_of_the_frame_rotates_the_rod(name):
    by = (0.1, 0.7, 0.1, -0.7)
    plain = end(SECTIONS[name], moment=MOMENT, steps=8)
    start, load = product(by, tuple(TURN)), [np.array(turned(by, tuple(v))) for v in (FORCE, MOMENT)]
    rotated = end(SECTIONS[name], force=load[0], moment=load[1], turn=np.array(start), steps=8)
    expected = turned(by, plain[0]), product(by, plain[1])
    np.testing.assert_allclose(stacked(rotated), stacked(expected), atol=ROUNDING)


@pytest.mark.parametrize("name", ["curved and twisted", "breaks"])
def test_there_and_back(name):
    section, load = SECTIONS[name], SpaceLoad(tuple(FORCE), tuple(MOMENT))
    base = end(section, moment=MOMENT, steps=12)
    back = space.integrate(base, -0.9, load, section, steps=12, from_base=0.0)
    np.testing.assert_allclose(stacked(back), stacked((ORIGIN, tuple(TURN))), atol=ROUNDING)


def test_points_are_states_along_the_rod():
    section, load, at = SECTIONS["breaks"], SpaceLoad(tuple(FORCE)), np.linspace(0.0, 1.0, 41)
    states = space.points((ORIGIN, tuple(TURN)), 0.9, load, section, at=jnp.asarray(at), from_base=0.9)
    for k in (0, 13, 29, 40):
        part = space.integrate((ORIGIN, tuple(TURN)), 0.9 * at[k], load, section, steps=MANY, from_base=0.9)
        np.testing.assert_allclose(stacked(jax.tree.map(lambda leaf, k=k: leaf[k], states)), stacked(part), atol=EXACT)


def test_a_pointed_tip_carries_no_moment():
    section, load = SpaceSection(Cone(1.0), 0.7, (None, 0.6, None)), SpaceLoad((None, None, 0.0))
    start = ORIGIN, tuple(TURN)
    got = space.integrate(start, 1.0, load, section, steps=16, from_base=1.0)
    free = space.integrate(start, 1.0, load, SpaceSection(1.0, None, (None, 0.6, None)), steps=16, from_base=1.0)
    np.testing.assert_allclose(stacked(got), stacked(free), atol=ROUNDING)
    loaded = space.curvature(((0.1, 0.2, 0.3), tuple(TURN)), SpaceLoad(tuple(FORCE)), section, 1.0)
    np.testing.assert_array_equal(np.array(loaded), [0.0, 0.6, 0.0])


def test_units_of_length_and_stiffness():
    section = SpaceSection(Cone(0.01, 5e4), 0.7, (None, Linear(0.004, 2e-5), 0.003), 70.0, 5e4)
    dimensionless = SpaceSection(Cone(0.7), 0.7, (None, Linear(0.28, 0.098), 0.21))
    np.testing.assert_allclose(stacked(end(section)), stacked(end(dimensionless)), atol=ROUNDING)


@pytest.mark.parametrize("name", ["curved and twisted", "cone with torsion", "breaks"])
def test_changes_are_derivatives(name):
    section, r, w, force = (
        SECTIONS[name],
        np.array([0.2, -0.3, 0.5]),
        np.array([-0.4, 0.1, 0.6]),
        np.array([0.7, 0.2, -0.5]),
    )

    def moved(share):
        turn = product(small_rotation(tuple(share * w)), tuple(TURN))
        load = SpaceLoad(tuple(FORCE + share * force), tuple(MOMENT))
        start = tuple(share * r), turn
        r1, q = space.integrate(start, 0.9, load, section, steps=6, from_base=0.9)
        return jnp.stack(r1), matrix_of(q)

    (_, turned), (expected, slope) = jax.jit(lambda: jax.jvp(moved, (0.0,), (1.0,)))()
    two = jax.tree.map(lambda x: jnp.array([x, 0.0]), ((tuple(r), tuple(w)), SpaceLoad(tuple(force))))
    start, load = (ORIGIN, tuple(TURN)), SpaceLoad(tuple(FORCE), tuple(MOMENT))
    end, (by_r, by_w) = space.with_changes(start, two, 0.9, load, section, steps=6, from_base=0.9)
    np.testing.assert_allclose(matrix_of(end[1]), turned, atol=ROUNDING)
    np.testing.assert_allclose(np.stack(by_r, axis=1), [expected, np.zeros(3)], atol=ROUNDING)
    spin = np.array(slope @ turned.T)
    np.testing.assert_allclose(np.stack(by_w, axis=1)[0], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=ROUNDING)


def test_a_torsional_stiffness_like_that_of_bending_costs_nothing():
    def operations(ratio):
        section = SpaceSection(1.0, ratio, (None, 0.5, None))
        jaxpr = jax.make_jaxpr(
            lambda f: space.integrate(
                (ORIGIN, tuple(TURN)), 1.0, SpaceLoad((None, None, f)), section, steps=8, from_base=1.0
            )
        )(1.0)
        return len(str(jaxpr).splitlines())

    assert operations(None) == operations(1) == operations(1.0) < operations(jnp.asarray(1.0)) - 20


def test_compiled_and_batched_rods_are_the_same():
    section = SECTIONS["cone with torsion"]
    arcs = jnp.array([0.5, 0.7, 0.9])
    loop = [stacked(end.__wrapped__(section, arc=arc, steps=8)) for arc in arcs]
    batch = jax.vmap(lambda arc: end(section, arc=arc, steps=8))(arcs)
    for k, alone in enumerate(loop):
        np.testing.assert_allclose(stacked(jax.tree.map(lambda leaf, k=k: leaf[k], batch)), alone, atol=ROUNDING)
