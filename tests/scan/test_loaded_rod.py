"""The equations of one loaded whisker: arcs, small deflections, bases on springs, Euler's load, sizes of loads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.along import LinearTaper
from jaxwhisker._path.deflection import LEAST_LOAD, checks_of, misfit
from jaxwhisker._scan.loaded_rod import bent, loaded_rod

EXACT = 1e-11
SMALL = 1e-5  # angle by which a force bends a whisker: deflections are linear to its square
UPRIGHT = np.pi / 2
LENGTH, STIFFNESS = 2.0, 3.0
CLAMP = jw.Support.clamped()


def rods(*loads, support=CLAMP, whisker=None):
    return loaded_rod(whisker or jw.Whisker(LENGTH, STIFFNESS), loads, support)


@jax.jit
def of_force(force, direction):
    """A clamped whisker under a dead force in the middle: misfit and checks without, and misfits with unknowns."""
    some = rods(jw.PointForce(force, position=LENGTH / 2, direction=direction))
    straight = jnp.array([UPRIGHT])
    return misfit(straight, some), checks_of(some, straight, jnp.ones(1))


def test_a_column_is_stable_up_to_the_load_of_euler():
    # Half of the whisker is the column.
    euler = np.pi**2 / 4 * STIFFNESS / (LENGTH / 2) ** 2
    for factor, direction, stable in ((0.99, -UPRIGHT, True), (1.01, -UPRIGHT, False), (3.0, UPRIGHT, True)):
        residual, checks = of_force(factor * euler, direction)
        np.testing.assert_allclose(residual, 0.0, atol=EXACT)
        assert checks.residual < EXACT and checks.by_steps < EXACT and checks.stable == stable
    # A force across is not in balance with a straight whisker: the base would turn by F L^2 / (2 EI).
    residual, checks = of_force(1e-3, np.pi)
    turn = 1e-3 * (LENGTH / 2) ** 2 / (2 * STIFFNESS)
    np.testing.assert_allclose(residual, [-turn], rtol=1e-3)
    assert checks.residual == pytest.approx(turn, rel=1e-3)


def test_a_moment_bends_an_arc_with_a_straight_end():
    moment, place = 1.2, 0.75
    curvature = moment / STIFFNESS
    angle = curvature * place * LENGTH

    @jax.jit
    def shape(top):
        some = rods(jw.PointMoment(moment, position=place * LENGTH))
        return misfit(top, some), bent(some, top, 5)

    missed, found = shape(jnp.array([UPRIGHT + angle]))
    np.testing.assert_allclose(missed, 0.0, atol=EXACT)
    s = np.asarray(found.s)
    assert s[0] == 0.0 and s[-1] == 1.0 and np.all(np.diff(s) >= 0) and np.any(s == place)
    x, y, cos, sin = found.states
    turned = np.minimum(s, place) * LENGTH * curvature
    np.testing.assert_allclose(np.arctan2(sin, cos), UPRIGHT + turned, atol=EXACT)
    beyond = np.maximum(s - place, 0.0)
    radius = 1 / (curvature * LENGTH)
    np.testing.assert_allclose(x, radius * (np.cos(turned) - 1) - beyond * np.sin(angle), atol=EXACT)
    np.testing.assert_allclose(y, radius * np.sin(turned) + beyond * np.cos(angle), atol=EXACT)
    unit = STIFFNESS / LENGTH
    np.testing.assert_allclose(found.load, [0.0, 0.0, moment / unit], atol=EXACT)
    np.testing.assert_allclose(np.asarray(found.moment)[s < place], moment / unit, atol=EXACT)
    np.testing.assert_allclose(np.asarray(found.moment)[s > place], 0.0, atol=EXACT)
    np.testing.assert_array_equal(found.pose, [0.0, 0.0, 0.0])


def test_a_base_on_springs_moves_with_the_load_on_it():
    force, spring, torsion, rest = SMALL, 40.0, 5.0, 0.3

    @jax.jit
    def shape(top):
        springs = jw.Spring((0, 1), spring, rest), jw.Spring((0, 1), torsion, 0.1, axis="phi")
        some = rods(jw.PointForce(force), support=jw.Support(springs, jw.Mount(0.0, 0.4, 0.0)))
        return misfit(top, some), bent(some, top, 3)

    turned = 0.1 + force * LENGTH * np.cos(0.1) / torsion
    missed, found = shape(jnp.array([UPRIGHT + turned + force * LENGTH**2 * np.cos(0.1) / (2 * STIFFNESS)]))
    np.testing.assert_allclose(missed, 0.0, atol=SMALL**2 * 100)
    np.testing.assert_allclose(
        found.pose, [(rest - force / spring) / LENGTH, 0.4 / LENGTH, turned], atol=SMALL**2 * 100
    )
    unit = STIFFNESS / LENGTH**2
    np.testing.assert_allclose(found.load[:2], [-force / unit, 0.0], atol=EXACT)


def test_the_unknowns_of_a_curved_whisker_without_loads_and_the_size_of_loads():
    @jax.jit
    def sizes():
        whisker = jw.Whisker(LENGTH, STIFFNESS, LinearTaper(0.1, 0.4, LENGTH))
        curved = rods(jw.PointForce(-0.3, position=1.5), jw.PointMoment(0.2, position=0.5), whisker=whisker)
        whole = rods(jw.LineLoad(0.3, -0.4, start=0.5))
        return (curved.unbent, curved.load, curved.top), (whole.unbent, whole.load, whole.top)

    (unbent, load, top), (straight, spread, end) = sizes()
    assert top == 0.75 and unbent[0] == pytest.approx(UPRIGHT + 0.1 * 1.5 + 0.3 / LENGTH * 1.5**2 / 2, abs=EXACT)
    assert load == pytest.approx(0.3 * LENGTH**2 / STIFFNESS + 0.2 * LENGTH / STIFFNESS + LEAST_LOAD)
    assert end == 1.0 and straight[0] == pytest.approx(UPRIGHT)
    # The sum of the sizes along x and y, times the length of the loaded part.
    assert spread == pytest.approx((0.3 + 0.4) * 1.5 * LENGTH**2 / STIFFNESS + LEAST_LOAD)
