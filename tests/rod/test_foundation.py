"""Rods on a foundation: against theory of beams, scipy and rods without one. Derivatives against differences."""

import forward
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from functions import Step
from jaxwhisker._rod import rod
from jaxwhisker._rod.foundation import integrate_on
from jaxwhisker._rod.rod import Load, Section

SMALL = 1e-6  # deflection of a beam: the equation is linear to its square
ROD = 1e-9  # of rods that scipy integrates to 1e-12
SAME = 1e-11  # two methods, both with more steps than they need
DIFFERENCE, DIFFERENCES = 1e-5, 1e-8  # step and error of central differences
FIRST = 1.0  # arc length at which all rods begin


def test_a_slightly_bent_rod_obeys_the_equation_of_a_beam():
    # y'''' = -4 b^4 y has the solution exp(-b s) cos(b s) for 4 b^4 = stiffness; x is the displacement.
    b, length = 2.0, 1.0

    def derivative(n, s):
        rate = complex(-b, b)
        return SMALL * (rate**n * np.exp(rate * s)).real

    # The walk begins at s = length and goes to s = 0; the displacement is that of x, the rod points along +y.
    x, lean, curvature, shear = (jnp.asarray(derivative(n, length)) for n in range(4))
    start = x, jnp.asarray(length), lean, jnp.sqrt(1 - lean**2)
    # phi' = -x'', and the moment of the force about a point of the rod falls by force_x ds.
    force_x = -shear
    load = Load(force_x, jnp.zeros(()), -curvature - length * force_x)

    def density(x, y, s):
        del y, s
        return -4 * b**4 * x, jnp.zeros_like(x)

    walk = jax.jit(lambda arc: integrate_on(start, load, arc, None, density, steps=16, from_base=arc))
    end, below = walk(length)
    np.testing.assert_allclose(end[0], derivative(0, 0.0), atol=1e-3 * SMALL**2 + 1e-15)
    np.testing.assert_allclose(end[2], derivative(1, 0.0), atol=1e-14)
    np.testing.assert_allclose(jnp.asarray(below.force_x), -derivative(3, 0.0), atol=1e-13)


def springy(stiffness):
    """A force per length that depends on position and arc length along both axes."""
    return lambda x, y, s: (-stiffness * (x - 0.1) * (1 + s), 0.5 * stiffness * y * s)


@jax.jit
def walked(values, load, arc, stiffness, from_base=FIRST):
    """State (x, y, cos, sin) and load (forces, moment about the origin) at the end of a uniform rod with EI = 2."""
    end, below = integrate_on(
        tuple(values), Load(*load), arc, 2.0, springy(stiffness), steps=16, from_base=jnp.asarray(from_base)
    )
    return jnp.stack(end), jnp.stack([*map(jnp.asarray, (below.force_x, below.force_y, below.moment))])


START = jnp.array([0.2, -0.1, np.cos(0.5), np.sin(0.5)])
LOAD = jnp.array([1.5, -3.0, 0.6])


def test_a_strongly_bent_rod_against_scipy():
    density = springy(20.0)

    def rate(t, values):
        x, y, angle, fx, fy, about = values
        px, py = density(x, y, FIRST - t)
        curvature = (about - x * fy + y * fx) / 2.0
        return [-np.cos(angle), -np.sin(angle), -curvature, px, py, x * py - y * px]

    exact = solve_ivp(rate, (0.0, 0.8), [0.2, -0.1, 0.5, *LOAD], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    end, below = walked(START, LOAD, 0.8, 20.0)
    x, y, angle, *loads = exact
    np.testing.assert_allclose(end, [x, y, np.cos(angle), np.sin(angle)], atol=ROD)
    np.testing.assert_allclose(below, loads, atol=ROD)
    assert abs(angle - 0.5) > 0.2


def test_a_walk_back_ends_where_it_began():
    end, below = walked(START, LOAD, 0.8, 20.0)
    start, load = walked(end, below, -0.8, 20.0, FIRST - 0.8)
    np.testing.assert_allclose(start, START, atol=SAME)
    np.testing.assert_allclose(load, LOAD, atol=SAME)


def test_without_stiffness_the_rod_has_no_foundation():
    end, below = walked(START, LOAD, 0.8, 0.0)
    plain = rod.integrate(tuple(START), jnp.asarray(0.8), Load(*LOAD), 2.0, steps=64)
    np.testing.assert_allclose(end, np.array(plain), atol=SAME)
    np.testing.assert_array_equal(below, LOAD)
    still, load = walked(START, LOAD, 0.0, 20.0)
    np.testing.assert_array_equal(still, START)
    np.testing.assert_array_equal(load, LOAD)


def test_derivatives_in_reverse_mode_agree_with_differences():
    weights, direction = jnp.arange(1.0, 8.0), jnp.array([1.0, -0.5, 2.0])

    def total(by):
        return weights @ jnp.concatenate(walked(START, LOAD.at[1].add(by[0]), 0.8 + by[1], 20.0 + by[2]))

    step = DIFFERENCE * direction
    difference = (total(step) - total(-step)) / (2 * DIFFERENCE)
    assert jax.jit(jax.grad(total))(jnp.zeros(3)) @ direction == pytest.approx(float(difference), abs=DIFFERENCES)


def test_a_foundation_ends_its_steps_at_breaks():
    # A constant push is a foundation, and scipy can integrate it with the rod.
    first, zero = jnp.asarray(1.0), jnp.zeros(())
    load = rod.Load(zero, zero - 0.8, zero)
    section = Section(Step(0.37, 1.0, 0.2), Step(0.37, 0.1, 0.6), 1.0, 1.0, breaks=jnp.array([0.37]))
    start = (zero, zero, zero + 1.0, zero)

    @jax.jit
    def end(first):
        return integrate_on(
            start, load, first, section, lambda x, y, s: (0.3 + 0 * s, 0 * s), steps=8, from_base=first
        )[0]

    def rate(t, r):
        x, y, angle, force_x, about = r
        bend = about + 0.8 * x + y * force_x
        curvature = np.where(1 - t < 0.37, 0.1, 0.6) + bend / np.where(1 - t < 0.37, 1.0, 0.2)
        return np.array([-np.cos(angle), -np.sin(angle), -curvature, 0.3, -0.3 * y])

    x, y, angle, *_ = forward.integrated(rate, (0.0,) * 5, 1.0, (0.63,))
    np.testing.assert_allclose(end(first), [x, y, np.cos(angle), np.sin(angle)], atol=ROD)
