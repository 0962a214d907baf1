"""Rods in space under distributed loads: in the plane, against scipy, back and forth, and derivatives."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from functions import Step
from jaxwhisker._rod import space
from jaxwhisker._rod.space import SpaceLoad, SpaceSection
from jaxwhisker._rod.space_line import integrate_under

ROD = 1e-9  # of rods that scipy integrates to 1e-12
SAME = 1e-11  # two methods, both with more steps than they need
DIFFERENCE, DIFFERENCES = 1e-5, 1e-8  # step and error of central differences
FIRST, ARC = 1.0, 0.8  # arc length at which all rods begin, and that to their end
START = jnp.array([0.2, -0.1, 0.3, 0.6, -0.4, 0.5, np.sqrt(1 - 0.36 - 0.16 - 0.25)])
LOAD = jnp.array([1.5, -3.0, 2.0, 0.6, -0.5, 0.4])


def push(size):
    """A force per length that depends on the arc length along all axes."""
    return lambda s: size * jnp.stack([1 + s, -(s**2), 0.5 + 0 * s])


def walked(values, load, section, density, arc=ARC, from_base=FIRST, steps=16):
    start = tuple(values[:3]), tuple(values[3:])
    given = SpaceLoad(tuple(load[:3]), tuple(load[3:]))
    (r, q), below = integrate_under(
        start, given, jnp.asarray(arc), section, density, steps=steps, from_base=jnp.asarray(from_base)
    )
    return jnp.stack([*r, *q]), jnp.stack([*below.force, *below.moment])


def by_scipy(section, density, breaks=()):
    """The same with rotation matrices."""

    def axes(q):
        w, x, y, z = q
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip

    def rate(t, values, inner):
        s = np.clip(FIRST - t, *inner)
        r, rotation, force, about = values[:3], values[3:12].reshape(3, 3), values[12:15], values[15:]
        moment = rotation.T @ (about + np.cross(force, r))
        stiffness = np.asarray(section.bending_stiffness(s)) * np.array([1.0, 1.0, 0.7])
        x, y, z = moment / stiffness + np.array([0.3, -0.5, 0.9])
        hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        p = np.asarray(density(s))
        return -np.concatenate([rotation[:, 2], (rotation @ hat).ravel(), -p, -np.cross(r, p)])

    values = np.concatenate([START[:3], axes(START[3:]).ravel(), LOAD])
    stops = [0.0, *breaks, ARC]
    for a, b in itertools.pairwise(stops):
        inner = FIRST - b + 1e-12, FIRST - a - 1e-12
        values = solve_ivp(rate, (a, b), values, args=(inner,), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return values, axes


class Wave:
    """A bending stiffness."""

    def __call__(self, s):
        return 2.0 + jnp.sin(3 * s)


@pytest.mark.parametrize(("stiffness", "breaks"), [(Wave(), ()), (Step(0.63, 1.0, 0.4), (FIRST - 0.63,))])
def test_a_bent_rod_against_scipy(stiffness, breaks):
    at = jnp.array([0.63]) if breaks else None
    section = SpaceSection(stiffness, 0.7, (0.3, -0.5, 0.9), breaks=at)
    exact, axes = by_scipy(section, push(4.0), breaks)
    end, below = jax.jit(lambda start: walked(start, LOAD, section, push(4.0)))(START)
    np.testing.assert_allclose(end[:3], exact[:3], atol=ROD)
    np.testing.assert_allclose(axes(end[3:]), exact[3:12].reshape(3, 3), atol=ROD)
    np.testing.assert_allclose(below, exact[12:], atol=ROD)


UNIFORM = SpaceSection(2.0, 0.7, (0.3, -0.5, 0.9))


def test_a_walk_back_ends_where_it_began():
    end, below = walked(START, LOAD, UNIFORM, push(20.0))
    start, load = walked(end, below, UNIFORM, push(20.0), -ARC, FIRST - ARC)
    np.testing.assert_allclose(start, START, atol=SAME)
    np.testing.assert_allclose(load, LOAD, atol=SAME)
    assert np.max(np.abs(below - LOAD)) > 5


def test_without_a_density_the_rod_is_that_of_the_other_method():
    end, below = walked(START, LOAD, UNIFORM, push(0.0))
    start, load = (tuple(START[:3]), tuple(START[3:])), SpaceLoad(tuple(LOAD[:3]), tuple(LOAD[3:]))
    r, q = space.integrate(start, jnp.asarray(ARC), load, UNIFORM, steps=64, from_base=jnp.asarray(FIRST))
    np.testing.assert_allclose(end, jnp.stack([*r, *q]), atol=SAME)
    np.testing.assert_array_equal(below, LOAD)


def test_derivatives_in_both_modes_agree_with_differences():
    weights, direction = jnp.arange(1.0, 14.0), jnp.array([1.0, -0.5, 2.0])

    def total(by):
        found = walked(START, LOAD.at[1].add(by[0]), UNIFORM, push(4.0 + by[2]), ARC + by[1])
        return weights @ jnp.concatenate(found)

    step = DIFFERENCE * direction
    difference = (total(step) - total(-step)) / (2 * DIFFERENCE)
    assert jax.jit(jax.grad(total))(jnp.zeros(3)) @ direction == pytest.approx(float(difference), abs=DIFFERENCES)
    assert jax.jvp(total, (jnp.zeros(3),), (direction,))[1] == pytest.approx(float(difference), abs=DIFFERENCES)
