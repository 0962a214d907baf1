"""The end of a rod in space and its derivatives, against the rod in a plane and finite differences."""

# pyright: reportArgumentType=false

from functools import cache, partial

import equinox as eqx
import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest

from functions import Linear, Step
from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._rod.elastica import Shooting
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._rod.space_end import contact_rotation, space_rod_end

ROUNDING = 1e-13
PLANE = 1e-12  # of rods with many steps
SLOPE = 1e-8  # of central differences with a step of 1e-4 and one extrapolation, and of the arc's slope with 16 steps
CURVATURE = 1e-7  # likewise of differences of slopes
STEPS = 16
AT = jnp.array([2.3, 0.85, 0.4, 0.7])  # force, arc, chi, gamma


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: jax.Array

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


def uniform(p):
    """A section with three parameters."""
    return SpaceSection(p[0], p[1], (None, p[2], 0.3))


def cone(p):
    """Likewise, with functions."""
    return SpaceSection(Cone(p[0] / 4), p[1], (None, Linear(p[2], 0.2), 0.3))


def jumping(p):
    """Likewise, with a break that is a parameter."""
    at = p[0] / 3
    return SpaceSection(1.0, p[1], (None, Step(at, p[2], -0.1), 0.3), breaks=jnp.stack([at]))


OF_SECTION = jnp.array([1.1, 0.7, -0.6])
ALL = jnp.concatenate([AT, OF_SECTION])
SECTIONS = [uniform, cone, jumping]


def end(build, p, steps=STEPS, rate_steps=STEPS):
    return space_rod_end(*p[:4], build(p[4:]), steps, rate_steps)


def differences(function, at):
    """Central differences, once extrapolated."""

    def quotient(step):
        sides = at + step * jnp.eye(at.size), at - step * jnp.eye(at.size)
        above, below = (jax.vmap(function)(side) for side in sides)
        return np.array(above - below) / (2 * step)

    return np.moveaxis((4 * quotient(5e-5) - quotient(1e-4)) / 3, 0, -1)


def test_the_frame_of_the_contact():
    chi, gamma = 0.4, 0.7
    tangent = np.array([np.cos(chi), 0.0, -np.sin(chi)])
    b = np.array([0.0, 1.0, 0.0])
    first = np.cos(gamma) * np.cross(b, tangent) + np.sin(gamma) * b
    got = matrix_of(contact_rotation(chi, gamma))
    np.testing.assert_allclose(got, np.stack([first, np.cross(tangent, first), tangent], axis=1), atol=ROUNDING)


def test_the_end_of_a_rod_in_a_plane():
    """The plane's y axis points along -z, into the object."""
    force, arc, chi = 2.3, 0.85, 0.4
    x, y, cos, sin = Shooting(steps=64).end(*map(jnp.asarray, (force, arc, chi)))
    got = space_rod_end(force, arc, chi, 0.7, SpaceSection(1.0), 64, 64)
    np.testing.assert_allclose(got[:3], [x, 0.0, -y], atol=PLANE)
    np.testing.assert_allclose(matrix_of(tuple(got[3:]))[:, 2], [cos, 0.0, -sin], atol=PLANE)


@cache
def forward_slopes(build):
    return jax.jit(jax.jacfwd(partial(end, build)))


@pytest.mark.parametrize("build", SECTIONS)
def test_derivatives_in_both_modes(build):
    forward = forward_slopes(build)(ALL)
    reverse = jax.jit(jax.jacrev(partial(end, build)))(ALL)
    np.testing.assert_allclose(forward, reverse, atol=ROUNDING)
    np.testing.assert_allclose(forward, differences(jax.jit(partial(end, build)), ALL), atol=SLOPE)


FORWARD, REVERSE = jax.jacfwd, jax.jacrev


@pytest.mark.parametrize(
    ("build", "orders"),
    [(uniform, [(FORWARD, FORWARD), (REVERSE, FORWARD)]), (cone, [(FORWARD, FORWARD), (FORWARD, REVERSE)])],
)
def test_second_derivatives_in_both_modes(build, orders):
    weights = jnp.array([0.3, -0.8, 0.5, 1.0, 0.2, -0.4, 0.7])

    def weighted(p):
        return weights @ end(build, p)

    slope = jax.jit(jax.jacfwd(weighted))
    expected = differences(slope, ALL)
    for outer, inner in orders:
        np.testing.assert_allclose(jax.jit(outer(inner(weighted)))(ALL), expected, atol=CURVATURE)


def test_derivatives_may_take_more_steps():
    coarse = partial(end, uniform, steps=2, rate_steps=STEPS)
    np.testing.assert_array_equal(coarse(ALL), end(uniform, ALL, 2, 2))
    np.testing.assert_allclose(jax.jacfwd(coarse)(ALL), jax.jacfwd(partial(end, uniform))(ALL), atol=ROUNDING)


@pytest.mark.parametrize(("build", "changes"), [(uniform, 3), (cone, 4)])
def test_any_number_of_parameters_cost_few_changes_of_the_state(build, changes):
    """The loops over stages carry changes due to force, angle, roll and, if the rod is not uniform, arc length."""

    def of_many(p):
        return space_rod_end(*(AT + jnp.reshape(p, (5, 4)).sum(0)), build(OF_SECTION), STEPS, STEPS)

    jaxpr = jax.make_jaxpr(jax.jacfwd(of_many))(jnp.zeros(20))
    carried = {shape[0] for shape in shapes_in_loops(jaxpr.jaxpr, inside=False) if shape}
    assert changes in carried
    assert 20 not in carried


def shapes_in_loops(jaxpr, inside):
    for equation in jaxpr.eqns:
        within = inside or equation.primitive.name == "scan"
        if within:
            yield from (out.aval.shape for out in equation.outvars if equation.primitive.name != "scan")
        for inner in jax.extend.core.jaxprs_in_params(equation.params):
            yield from shapes_in_loops(inner, within)


def test_batched_ends_are_those_of_single_ones():
    many = AT * jnp.linspace(0.8, 1.1, 3)[:, None]
    some = jnp.concatenate([many, jnp.tile(OF_SECTION, (3, 1))], axis=1)
    batch = jax.jit(jax.vmap(jax.jacfwd(partial(end, cone))))(some)
    loop = [forward_slopes(cone)(p) for p in some]
    np.testing.assert_allclose(batch, np.stack(loop), atol=ROUNDING)
