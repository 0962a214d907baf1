"""Chains of segments in space: loads on segments, and where they end."""

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from jaxwhisker._space.contact import FORCE, POINT, SLACK
from jaxwhisker._space.problem import of_each
from jaxwhisker._space_chain.contacts import at_rest, base_of_chain, last_used
from pegs_engine import PHASE, contacts, problem

EXACT = 1e-8


@jax.jit
def chain(problem, z, phase):
    drive = problem.drive(pegs.CONTROL)
    return of_each(
        problem,
        lambda body: base_of_chain(
            body, problem.surface, problem.rod, z, phase, at_rest(problem.surface, drive.position)
        ),
    )


def test_segments_meet_and_end_at_the_base_with_its_reaction():
    at = jax.tree.map(lambda leaf: leaf[0], chain(problem(), contacts(), PHASE))
    np.testing.assert_allclose(at.meets[0], 0.0, atol=EXACT)
    np.testing.assert_allclose(at.base.position, [pegs.CONTROL, 0.0, 0.0], atol=EXACT)
    np.testing.assert_allclose(at.base.tangent, [0.0, 1.0, 0.0], atol=EXACT)
    reaction = [*-at.base.force[:2], -at.base.moment[2]]
    np.testing.assert_allclose(reaction, list(pegs.REACTION.values()), atol=1e2 * EXACT)
    assert not at.backwards


def test_the_load_on_a_segment_is_that_of_all_contacts_beyond():
    z = contacts()
    at = jax.tree.map(lambda leaf: leaf[0], chain(problem(), z, PHASE)).chain
    pushes = z[:, FORCE, None] * at.frame[:, :, 2]
    np.testing.assert_allclose(at.force, np.cumsum(pushes, axis=0), atol=1e-14)
    arm = z[0, POINT] - z[1, POINT]
    np.testing.assert_allclose(at.moment, [np.zeros(3), np.cross(arm, pushes[0])], atol=1e-14)
    np.testing.assert_allclose(at.arc, [z[1, SLACK] - z[0, SLACK], 1 - z[1, SLACK]], atol=1e-14)


def test_contacts_in_the_wrong_order_run_backwards():
    swapped = jax.tree.map(lambda leaf: leaf[0], chain(problem(), contacts()[::-1], PHASE))
    assert swapped.backwards


def test_the_last_contact_is_that_before_unused_places():
    assert last_used(jnp.array([True, True, False])).tolist() == [False, True, False]
    assert last_used(jnp.array([False, False])).tolist() == [False, False]
