"""Numbers of contacts in events, and the status of every step."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.trace import CREATED_AT_REST, DEEPEST, NO_ROOM, Trace, numbers_of, status_of

STEP = 1e-3


def trace(**changes):
    """Three times of one whisker with two places."""
    places, none = jnp.zeros((3, 2)), jnp.zeros(3)
    outside = jnp.full((3, 1), jnp.inf)
    fields = Trace(places > 0, places, places, places, places, none, none, none, places, outside, outside)
    return fields._replace(**{name: jnp.asarray(value) for name, value in changes.items()})


def test_contacts_are_numbered_from_the_tip():
    touches = jnp.array([[True, True, False], [True, True, True], [False, False, False]])
    arc = jnp.array([[0.5, 0.9, 0.7], [0.5, 0.9, 0.7], [0.5, 0.9, 0.7]])
    numbers = numbers_of(trace(touches=touches, arc=arc), 3)
    assert numbers.tolist() == [[2, 1, 2], [3, 1, 2], [1, 1, 1]]
    # Each whisker has its own numbers.
    two = trace(touches=jnp.tile(touches, 2), arc=jnp.concatenate([arc, 1 - arc], axis=1))
    assert numbers_of(two, 3)[1].tolist() == [3, 1, 2, 1, 3, 2]


def test_what_fails_first_is_the_status():
    solved, step = jnp.ones(3, bool), jnp.asarray(STEP)
    inside, deep = [[np.inf], [np.inf], [-2 * NO_ROOM]], [[0.0], [-2 * DEEPEST], [0.0]]

    def found(trace, solved=solved):
        return [jw.Status(int(status)).name for status in status_of(solved, trace, jnp.zeros(()), step)]

    assert found(trace()) == found(None) == ["ok"] * 3
    assert found(trace(inside=inside)) == ["ok", "ok", "too_many_contacts"]
    assert found(trace(inside=inside, distance=deep)) == ["ok", "inexact", "inexact"]
    assert found(trace(inside=inside), solved.at[0].set(False)) == ["lost"] * 3
    assert found(trace(contact=[0.0, 0.0, 2 * CREATED_AT_REST])) == ["ok", "ok", "inexact"]
    alone = trace(inside=inside)._replace(inside=None, distance=None, gap=jnp.array(deep))
    assert found(alone) == ["ok", "second_contact", "second_contact"]
