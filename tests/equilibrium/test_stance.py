"""Stances: on which side whiskers stand, before which object, and what they are like while they are free."""

import jax.numpy as jnp

from jaxwhisker._equilibrium.stance import Stance, of_object
from jaxwhisker._equilibrium.touch import TouchAlongX


def at(x, reaches=True):
    """First touches of three whiskers with their bases at x; or of each object, with a leading axis."""
    x = jnp.asarray(x) + jnp.zeros(3)
    return TouchAlongX(0 * x, x, 0 * x, 0 * x, jnp.full(x.shape, reaches))


X = jnp.array([1.0, 0.125, -1.0])


def test_where_whiskers_stand():
    stance = Stance(X, at(0.75), at(-0.5))
    assert stance.clear.tolist() == [True, False, True]
    # Half-way between both touches, at 0.125, the right-hand side counts as the nearer one.
    assert stance.side.tolist() == [1.0, 1.0, -1.0]
    assert stance.first(jnp.array([1.0, -1.0, 1.0])).x.tolist() == [0.75, -0.5, 0.75]
    assert Stance(X, at(0.75, False), at(-0.5, False)).clear.all()


def test_before_several_objects_each_whisker_has_a_stance_before_each():
    # The second object lies to the left of the first one.
    stance = Stance(X, at([[0.75], [-1.5]]), at([[-0.5], [-2.5]]))
    assert stance.clear.tolist() == [[True, False, True], [True, True, True]]
    assert stance.side.tolist() == [[1.0, 1.0, -1.0], [1.0, 1.0, 1.0]]
    own = stance.of(jnp.array([0, 1, 1]))
    assert own.right.x.tolist() == [0.75, -1.5, -1.5] and own.left.x.tolist() == [-0.5, -2.5, -2.5]
    assert own.x is stance.x
    assert stance.of(None) is stance


def test_values_of_one_object_for_each_whisker():
    assert of_object(jnp.array([[1, 2, 3], [4, 5, 6]]), jnp.array([1, 0, 1])).tolist() == [4, 2, 6]


def test_free_whiskers_that_no_spring_bends_have_zero_contacts():
    bent = jnp.arange(9.0).reshape(3, 3)
    assert Stance(X, at(0.75), at(-0.5)).contact_if_free == 0.0
    assert Stance(X, at(0.75), at(-0.5), bent).contact_if_free is bent
