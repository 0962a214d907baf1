"""Segments of rods in space: pieces of one rod, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._rod.space_end import space_rod_end
from jaxwhisker._rod.space_segment import segment_end

STEPS = 12
SAME = 1e-10  # of rods in steps of other lengths
DIFFERENCES = 1e-7  # of central differences, and of steps: derivatives by the arc are those of the exact rod
LOAD = jnp.array([0.3, -0.8, 0.5, 0.4, 0.2, -0.3])  # force and moment


def stiffness(s):
    return 1.0 - 0.5 * s


UNIFORM = SpaceSection(1.0, jnp.asarray(0.7), (0.2, -0.4, 0.3))
UNEVEN = SpaceSection(stiffness, jnp.asarray(0.7), (0.2, -0.4, 0.3))


@jax.jit
def ends(load, arc):
    """The end of a segment, and that of its second half, which begins with the end of the first one."""
    whole = segment_end(load, arc, 0.9, UNIFORM, STEPS, STEPS)
    first = segment_end(load, arc / 2, 0.9, UNIFORM, STEPS, STEPS)
    turn, (force, moment) = matrix_of(first[3:]), (load[:3], load[3:])
    beyond = jnp.concatenate([turn.T @ force, turn.T @ (moment + jnp.cross(force, first[:3]))])
    second = segment_end(beyond, arc / 2, 0.9 - arc / 2, UNIFORM, STEPS, STEPS)
    return whole, first[:3] + turn @ second[:3], turn @ matrix_of(second[3:])


def test_two_halves_are_one_segment():
    whole, position, rotation = ends(LOAD, 0.6)
    np.testing.assert_allclose(position, whole[:3], atol=SAME)
    np.testing.assert_allclose(rotation, matrix_of(whole[3:]), atol=SAME)


def test_a_force_alone_bends_it_like_a_rod_from_its_contact():
    none = jnp.zeros(())
    end = space_rod_end(jnp.asarray(2.0), jnp.asarray(0.7), none, none, UNIFORM, STEPS, STEPS)
    # There, the rod begins along x, with d2 along y, under a force along z: -d1.
    load = jnp.array([-2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    own = segment_end(load, jnp.asarray(0.7), jnp.asarray(0.7), UNIFORM, STEPS, STEPS)
    np.testing.assert_allclose([own[2], own[1], -own[0]], end[:3], atol=SAME)


@pytest.mark.parametrize("section", [UNIFORM, UNEVEN], ids=["uniform", "uneven"])
def test_derivatives_are_those_of_differences(section):
    def end(x):
        return segment_end(x[:6], x[6], x[7], section, STEPS, STEPS)

    at, step = jnp.append(LOAD, jnp.array([0.6, 0.8])), 1e-5
    forward, reverse = jax.jit(jax.jacfwd(end))(at), jax.jit(jax.jacrev(end))(at)
    along = jax.jit(jax.vmap(end))(at + step * jnp.concatenate([jnp.eye(8), -jnp.eye(8)]))
    np.testing.assert_allclose(forward, (along[:8] - along[8:]).T / (2 * step), atol=DIFFERENCES)
    np.testing.assert_allclose(reverse, forward, atol=SAME)
