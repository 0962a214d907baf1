"""The dimensionless problem: programs that scenes share, units, coordinates of the bases."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import contacts, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._equilibrium.problem import AlongX, InPlane
from jaxwhisker._equilibrium.stability import load_slopes
from jaxwhisker._equilibrium.stance import Stance
from jaxwhisker._equilibrium.touch import TouchAlongX

ROUNDING = 1e-13  # the same numbers by other operations
TOUCHED = 1e-9  # first touches in the plane are searched, and exact to 1e-10 of a length
CLOSED_FORM = 1e-10  # the same equilibrium by other coordinates

FOLLICLE = scene(jw.Support.follicle(x=70.0, mount=jw.Mount(0.1, -0.05, 0.2)))


@pytest.fixture(scope="module")
def in_plane():
    return dimensionless(FOLLICLE)


def test_unloaded_bases_rest_on_their_mounts_and_rest_lengths(in_plane):
    at = in_plane.in_scene(0.7, in_plane.rest(0.7))
    # The default rest length of a follicle is zero.
    np.testing.assert_allclose(np.ravel(at), [0.7 + 0.1, -0.05, 0.2], atol=ROUNDING)
    rest_length = 0.3
    softly = eqx.tree_at(lambda s: s.support.springs[0].rest_length, FOLLICLE, rest_length)
    problem = dimensionless(softly)
    # The spring acts along the drive's x axis, the coordinates along the axes of the mount.
    np.testing.assert_allclose(problem.rest(0.7)[0], rest_length * np.array([np.cos(0.2), -np.sin(0.2), 0]), atol=1e-13)
    at = problem.in_scene(0.7, problem.rest(0.7))
    np.testing.assert_allclose(np.ravel(at), [0.7 + 0.1 + rest_length, -0.05, 0.2], atol=ROUNDING)


def test_a_shift_moves_bases_along_the_scenes_x_axis():
    motion = jw.Rotation((0.3, -0.5), 0.4)
    problem = dimensionless(scene(jw.Support.follicle(phi=5.0, mount=jw.Mount(0.1, -0.05, 0.2)), motion=motion))
    u, pose, distance = 0.6, jnp.array([[0.02, -0.03, 0.1]]), jnp.array([0.25])
    before = problem.in_scene(u, pose)
    after = problem.in_scene(u, pose + problem.shift(u, distance))
    np.testing.assert_allclose(np.ravel(after) - np.ravel(before), [0.25, 0.0, 0.0], atol=ROUNDING)
    # The unloaded base turns about the pivot with the drive.
    unloaded = problem.in_scene(u, problem.rest(u))
    arm = np.array([0.1, 0.4 - 0.05])
    turned = np.array([[np.cos(u), -np.sin(u)], [np.sin(u), np.cos(u)]]) @ arm + [0.3, -0.5]
    np.testing.assert_allclose(np.ravel(unloaded), [*turned, 0.2 + u], atol=ROUNDING)
    # Frames and their derivatives by the control; those of the turning drive are its arm, turned by a right angle.
    frame, rate = problem.frames(u)
    np.testing.assert_allclose(
        np.ravel(rate), [-turned[1] - 0.5, turned[0] - 0.3, -frame.sin[0], frame.cos[0]], atol=ROUNDING
    )


def test_a_base_in_the_plane_that_yields_along_x_only_has_the_equations_of_a_base_along_x():
    alone, plane = (
        dimensionless(scene(jw.Support.follicle(x=70.0, mount=mount)))
        for mount in (None, jw.Mount())
    )  # fmt: skip
    assert isinstance(alone, AlongX) and isinstance(plane, InPlane)
    for name in ("x", "parameter", "slack", "reaches"):
        for touch in ("touch_right", "touch_left"):
            values = [getattr(getattr(problem, touch), name) for problem in (alone, plane)]
            np.testing.assert_allclose(*values, atol=TOUCHED)
    at = contacts(0.6)
    u = at.base_x[0] - at.force_x[0] / 70.0
    state = ContactState(jnp.asarray(at.phase), jnp.ones(1))
    z = jnp.asarray(at.z)

    @Program
    def step(problem):
        newton = newton_step(problem, state, at_control(u, z), Point(z, jnp.asarray(u)))
        return newton, load_slopes(problem, state, newton.condensed), problem.in_scene(jnp.asarray(u), newton.pose).x

    (one, slope, x), (other, slopes, in_scene_x) = step(alone), step(plane)
    assert one.residual < CLOSED_FORM and other.residual < CLOSED_FORM
    np.testing.assert_allclose(other.tangent.z, one.tangent.z, rtol=CLOSED_FORM)
    np.testing.assert_allclose(other.load[:, :1], one.load, atol=CLOSED_FORM)
    np.testing.assert_allclose(slopes[:, :1, :1], slope, rtol=CLOSED_FORM)
    np.testing.assert_allclose([x, in_scene_x], at.base_x[0], atol=CLOSED_FORM)


def test_only_free_whiskers_out_of_reach_change_their_side(in_plane):
    none = jnp.zeros(3)
    away = TouchAlongX(none, none, none, none, none > 0)
    stance = Stance(jnp.array([-1.0, -1.0, 1.0]), away, away)
    side = in_plane.updated_side(jnp.array([True, False, True]), jnp.ones(3), stance)
    assert side.tolist() == [-1.0, 1.0, 1.0]
    near = away._replace(reaches=jnp.ones(3, bool))
    assert in_plane.updated_side(jnp.ones(3, bool), jnp.ones(3), stance._replace(right=near)).tolist() == [1.0] * 3


def test_displacements_are_flexibility_times_load():
    stiff = dimensionless(scene(jw.Support.fbfb([50.0, 20.0], 0.2)))
    # Spring 1 carries both loads, spring 2 that of base 2.
    moved = stiff.displacement(jnp.array([[3.0], [-1.0]]))
    np.testing.assert_allclose(moved[:, 0], [2 / 50, 2 / 50 - 1 / 20], atol=ROUNDING)
    clamped = dimensionless(scene(jw.Support.clamped()))
    assert clamped.displacement(jnp.array([[3.0]])).tolist() == [[0.0]]
    assert clamped.rest(0.4).tolist() == [[0.4]]
