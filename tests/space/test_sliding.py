"""Stiffness against sliding: a light contact resists like a cantilever."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import LIGHT, Traction
from jaxwhisker._space.linear import linearise
from jaxwhisker._space.problem import of_each
from jaxwhisker._space.sliding import sliding_stiffness

TIP = jnp.array([int(Phase.tip)])
FORCES = Traction(None, jnp.asarray(True))  # tractions are forces


def stiffness_of(problem, z, phase):
    """Stiffness against sliding at the control 0."""
    drives = jax.jvp(problem.drive, (jnp.zeros(()),), (jnp.ones(()),))
    at = of_each(problem, lambda body, z, phase: linearise(problem, body, drives, z, phase, FORCES), z, phase)
    return np.asarray(sliding_stiffness(problem, z, phase, at))


def stiffness(force, support, angle=0.5):
    """Stiffness against sliding of an upright whisker whose tip touches a sphere at this angle."""
    out = np.array([np.cos(angle), -np.sin(angle), 0.0])  # t.n = -sin(angle)
    tip = np.array([0.0, 1.0, 0.0])
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, tuple(map(float, tip - out))), support)
    problem = dimensionless(scene)
    ahead = np.array([np.sin(angle), np.cos(angle), 0.0])
    return stiffness_of(problem, jnp.array([[force, 0.0, -angle, *tip, *ahead, 0.0, 0.0]]), TIP)


SOFT = 20.0


@pytest.mark.parametrize(
    ("support", "lateral"),
    [(jw.Support(), 3.0), (jw.Support.follicle(x=SOFT, y=SOFT, z=SOFT), 1 / (1 / 3 + 1 / SOFT))],
)
def test_a_light_tip_is_held_across_like_the_end_of_a_cantilever_on_its_springs(support, lateral):
    found = stiffness(1.5 * LIGHT, support)
    np.testing.assert_allclose(found[1, 1], lateral, rtol=3e-4)  # of the order of the force
    np.testing.assert_allclose(found[0, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(found, found.T, atol=1e-9)


def test_a_light_tip_is_held_along_the_surface_by_bending_and_by_the_springs():
    """The direction along the surface has parts across the whisker and along it, which only springs yield to."""
    angle = 0.5
    across, axial = 1 / 3 + 1 / SOFT, 1 / SOFT
    expected = 1 / (np.sin(angle) ** 2 * across + np.cos(angle) ** 2 * axial)
    # At a given displacement along the surface, the normal one being zero, both parts are given: springs in parallel.
    held = np.sin(angle) ** 2 / across + np.cos(angle) ** 2 / axial
    found = stiffness(1.5 * LIGHT, jw.Support.follicle(x=SOFT, y=SOFT, z=SOFT), angle)[0, 0]
    assert held > expected
    np.testing.assert_allclose(found, held, rtol=1e-3)


def test_contacts_without_force_count_as_held():
    assert np.array_equal(stiffness(0.1 * LIGHT, jw.Support()), np.eye(2))


def test_stability_is_lost_where_the_plane_model_says():
    """A sphere in the plane of the scan: exactly above its centre, in a state of the reference (S1, offset 0)."""
    problem = dimensionless(
        jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), motion=jw.LinearDrive((-1, 0, 0)))
    )
    point = np.array([0.372582132, 0.3720007786, 0.0])
    out = point - [0.0, 1.3, 0.0]
    ahead = np.array([-out[1], out[0], 0.0])
    z = jnp.array([[7.911281828, 0.0, 1 - 0.5620017929, *point, *ahead, 0.0, 0.0]])
    found = stiffness_of(problem, z, jnp.array([int(Phase.tangential)]))
    np.testing.assert_allclose(found[1], 0.0, atol=1e-7 * found[0, 0])  # across; the reference gives ten digits
    assert found[0, 0] > 1
