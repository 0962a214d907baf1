"""Contacts in space that are put in and taken out."""

import jax.numpy as jnp
import numpy as np

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._space.contact import UNKNOWNS
from jaxwhisker._space_chain.march_state import NewContactInSpace, inserted, removed

Z = jnp.arange(2.0 * UNKNOWNS).reshape(2, UNKNOWNS).at[1].set(0.0)
PHASE = jnp.array([int(Phase.tangential), int(Phase.free)])


def test_a_contact_that_begins_at_the_tip_comes_first_and_leaves_no_trace():
    new = NewContactInSpace(jnp.asarray(0), jnp.full(UNKNOWNS, 7.0), jnp.asarray(int(Phase.tip)))
    z, phase = inserted(Z, PHASE, new, 2)
    np.testing.assert_array_equal(z, [np.full(UNKNOWNS, 7.0), Z[0]])
    assert phase.tolist() == [Phase.tip, Phase.tangential]
    z, phase = removed(z, phase, jnp.array([True, False]), 2)
    np.testing.assert_array_equal(z, Z)
    assert phase.tolist() == PHASE.tolist()
