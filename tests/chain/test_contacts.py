"""One whisker and its contacts: loads, lengths and equations of its segments."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._chain.contacts import chain_of, equations, fractions, last_contact
from jaxwhisker._equilibrium.contact import of_each
from several_engine import STORED, problem, with_contacts

ROUNDING = 1e-12


def one(function, known):
    """A function of the only whisker of a problem at a state."""

    def each(problem, u, z, state):
        found = of_each(problem.bodies(u), function, z[None], jax.tree.map(lambda leaf: leaf[None], state))
        return jax.tree.map(lambda leaf: leaf[0], found)

    return jax.jit(each)(problem(), *known)


def test_loads_add_up_towards_the_base():
    known = with_contacts(2)
    chain = one(chain_of, known)
    force = np.asarray(known.z)[:, 0]
    pushes = force * np.asarray(chain.contact.sin), -force * np.asarray(chain.contact.cos)
    np.testing.assert_allclose(chain.load.force_x, np.cumsum(pushes[0]), atol=ROUNDING)
    np.testing.assert_allclose(chain.load.force_y, np.cumsum(pushes[1]), atol=ROUNDING)
    levers = np.asarray(chain.contact.x) * pushes[1] - np.asarray(chain.contact.y) * pushes[0]
    np.testing.assert_allclose(chain.load.moment, np.cumsum(levers), atol=ROUNDING)


def test_segments_reach_from_contact_to_contact_and_to_the_base():
    known = with_contacts(2)
    chain = one(chain_of, known)
    outer, inner = np.asarray(known.z)[:, 2]
    np.testing.assert_allclose(chain.arc, [inner - outer, 1 - inner], atol=ROUNDING)
    assert float(jnp.sum(chain.arc)) < 1.0  # nothing is integrated beyond the outermost contact


def test_an_empty_place_changes_nothing():
    known = with_contacts(1)
    chain = one(chain_of, known)
    assert float(chain.arc[1]) == 0.0  # it lies at the base
    changed = one(equations, known._replace(z=known.z.at[1].set(jnp.array([3.0, 0.2, 0.4]))))
    np.testing.assert_array_equal(changed.load, one(equations, known).load)
    np.testing.assert_array_equal(changed.own[1], [3.0, 0.2, 0.4])  # its equations are that its numbers vanish


def test_the_last_segment_ends_at_the_base():
    known = with_contacts(2)
    at = one(equations, known)
    np.testing.assert_allclose([at.base.x, at.base.y], np.array([float(known.u), 0.0]), atol=10 * STORED)
    np.testing.assert_allclose(at.own[1], 0.0, atol=10 * STORED)  # the pose in the frame of the drive
    assert not bool(at.backwards)
    turned = known._replace(state=known.state._replace(side=known.state.side * jnp.array([1.0, -1.0])))
    assert bool(one(equations, turned).backwards)


def test_the_last_contact_is_the_one_nearest_to_the_base():
    assert last_contact(jnp.array([True, True, False])).tolist() == [False, True, False]
    assert last_contact(jnp.array([False, False])).tolist() == [False, False]


def test_steps_are_short_at_both_ends_of_a_segment():
    at = fractions(12)
    assert at[0] == 0 and at[-1] == 1
    np.testing.assert_allclose(at + at[::-1], 1.0, atol=ROUNDING)
    assert np.diff(at)[0] < 0.2 * np.max(np.diff(at))
