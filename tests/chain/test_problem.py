"""The dimensionless problem: units, bases and loads."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._scan.chain import problem_now

ROUNDING = 1e-14


def problem(length=1.0, stiffness=1.0):
    """The problem of two whiskers on springs."""
    unit = stiffness / length**3
    support = jw.Support.fbfb([70.0 * unit, 40.0 * unit], [0.2 * length, 0.3 * length])
    objects = jw.Circle(0.5 * length, 0.2 * length), jw.Circle(0.3 * length, 0.1 * length, position=-0.6 * length)
    scene = jw.Scene(jw.Whisker(length, stiffness), objects, support, contacts=2)
    return problem_now(jax.tree.map(checks.as_float, scene))


def test_the_problem_does_not_depend_on_units():
    one, other = problem(), problem(0.04, 3e-6)
    for name in ("length", "bending_stiffness", "profile", "flexibility", "mount"):
        for a, b in zip(jax.tree.leaves(getattr(one, name)), jax.tree.leaves(getattr(other, name)), strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-12, atol=ROUNDING)
    np.testing.assert_allclose(np.array(other.unit), [0.04, 3e-6 / 0.04**2, 3e-6 / 0.04, 0.04], rtol=1e-12)


def test_unloaded_bases_are_at_the_rest_lengths():
    at = problem().in_scene(jnp.asarray(0.4), problem().rest)
    np.testing.assert_allclose(at.x, [0.6, 0.9], atol=ROUNDING)
    np.testing.assert_allclose([at.y, at.angle], 0.0, atol=ROUNDING)


def test_loads_stretch_the_springs_on_their_way_to_the_drive():
    moved = problem().displacement(jnp.array([[1.0, 5.0, 6.0], [2.0, 7.0, 8.0]]))
    np.testing.assert_allclose(moved[:, 0], [3 / 70, 3 / 70 + 2 / 40], rtol=1e-12)
    np.testing.assert_allclose(moved[:, 1:], 0.0, atol=ROUNDING)


def test_there_is_room_for_all_contacts():
    assert problem().rows == 4
    numbers = problem().numbers()
    assert numbers.flexibility.root is None and numbers.contacts == 2
