"""The dimensionless problem in space: units, and what is absent."""

# pyright: reportOptionalMemberAccess=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless

SPHERE = jw.Sphere(30.0, (0.0, 40.0, 5.0))
DRIVE = jw.LinearDrive((-1.0, 0.0, 0.0))


def test_lengths_are_in_the_length_and_forces_in_the_stiffness_of_the_whisker():
    whisker = jw.Whisker(length=20.0, bending_stiffness=8.0)
    support = jw.Support.follicle(x=0.5, y=3.0, z=0.1, mount=jw.Mount(x=10.0))
    problem = dimensionless(jw.SpaceScene(whisker, SPHERE, support, motion=DRIVE))
    force = 8.0 / 20.0**2
    np.testing.assert_allclose(problem.length, [1.0])
    np.testing.assert_allclose(problem.bending_stiffness, [1.0])
    np.testing.assert_allclose(problem.mount.position, [[0.5, 0.0, 0.0]])
    np.testing.assert_allclose(problem.surface.interior_point(), [0.0, 2.0, 0.25])
    np.testing.assert_allclose(problem.drive(jnp.asarray(0.5)).position, [-0.5, 0.0, 0.0])
    flexibility = np.diag(problem.springs.matrix)[:3] * force / 20.0
    np.testing.assert_allclose(flexibility, np.array([1 / 0.5, 1 / 3.0, 1 / 0.1]) * (force / 20.0) ** 2, rtol=1e-12)


@pytest.mark.parametrize(
    ("whisker", "support", "rows"),
    [
        (jw.Whisker(), jw.Support(), 5),
        (jw.Whisker(), jw.Support.follicle(x=10.0, y=10.0, z=10.0), 5),
        (jw.Whisker(), jw.Support.follicle(phi=3.0), 6),
        (jw.Whisker(intrinsic_curvature=0.5), jw.Support(), 6),
        (jw.Whisker(twist=0.5), jw.Support(), 6),
    ],
)
def test_only_whiskers_that_can_twist_have_a_roll(whisker, support, rows):
    problem = dimensionless(jw.SpaceScene(whisker, SPHERE, support, motion=DRIVE))
    assert problem.rows == rows
    assert (problem.springs is None) == (not support.springs)


def test_parameters_outside_their_domain_make_a_problem_invalid():
    def valid(radius):
        return dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, (0.0, 1.0, 0.0)), motion=DRIVE)).valid

    assert np.array_equal(jax.vmap(valid)(jnp.array([1.0, -1.0, jnp.nan])), [True, False, False])


def test_the_outline_of_a_curved_whisker_is_an_arc():
    problem = dimensionless(jw.SpaceScene(jw.Whisker(intrinsic_curvature=0.8), SPHERE, motion=DRIVE))
    s = np.linspace(0.0, 1.0, problem.outline.position.shape[1])
    position = problem.outline.position[0]
    np.testing.assert_allclose(position[:, 2], np.sin(0.8 * s) / 0.8, atol=1e-9)
    np.testing.assert_allclose(np.abs(position[:, 0]), (1 - np.cos(0.8 * s)) / 0.8, atol=1e-9)
