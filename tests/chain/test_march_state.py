"""Contacts that are put in and taken out."""

import jax.numpy as jnp
import numpy as np

from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.march_state import NewContact, inserted, removed
from jaxwhisker._equilibrium.contact import Phase

CONTACTS = 3  # of each of two whiskers
Z = jnp.arange(18.0).reshape(6, 3).at[2].set(0.0).at[4:].set(0.0)
STATE = ChainState(
    jnp.array([1, 2, 0, 2, 0, 0]), jnp.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), jnp.array([0, 1, 0, 1, 0, 0])
)


def new(row: int) -> NewContact:
    """A contact that begins at this row."""
    return NewContact(jnp.asarray(row), jnp.array([0.0, 7.0, 0.5]), jnp.asarray(2), jnp.asarray(-1.0), jnp.asarray(1))


def test_a_new_contact_moves_those_behind_it_towards_the_base():
    z, state = inserted(Z, STATE, new(1), CONTACTS)
    np.testing.assert_array_equal(z[:3], [Z[0], [0.0, 7.0, 0.5], Z[1]])
    np.testing.assert_array_equal(z[3:], Z[3:])  # of the other whisker
    assert state.phase.tolist() == [1, 2, 2, 2, 0, 0]
    assert state.side.tolist() == [1.0, -1.0, -1.0, 1.0, 1.0, 1.0]
    assert state.piece.tolist() == [0, 1, 1, 1, 0, 0]


def test_a_contact_that_ends_leaves_no_gap():
    z, state = removed(Z, STATE, jnp.arange(6) == 0, CONTACTS)
    np.testing.assert_array_equal(z, jnp.stack([Z[1], Z[2], Z[2], Z[3], Z[4], Z[5]]))
    assert state.phase.tolist() == [2, 0, 0, 2, 0, 0]
    assert state.touches.tolist() == [True, False, False, True, False, False]
    assert state.side.tolist() == [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]


def test_a_contact_that_begins_and_ends_changes_nothing():
    for row in range(6):
        if int(STATE.phase[row // CONTACTS * CONTACTS + CONTACTS - 1]) == Phase.free:
            z, state = inserted(Z, STATE, new(row), CONTACTS)
            z, state = removed(z, state, jnp.arange(6) == row, CONTACTS)
            np.testing.assert_array_equal(z, Z)
            for own, before in zip(state, STATE, strict=True):
                np.testing.assert_array_equal(own, before)


def test_nothing_is_removed_without_a_row():
    z, state = removed(Z, STATE, jnp.zeros(6, bool), CONTACTS)
    np.testing.assert_array_equal(z, Z)
    np.testing.assert_array_equal(state.phase, STATE.phase)
