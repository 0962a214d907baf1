"""Shafts of whiskers in space with several contacts."""

import jax
import jax.numpy as jnp
import numpy as np

import pegs
from jaxwhisker._space.contact import POINT
from jaxwhisker._space.problem import of_each
from jaxwhisker._space_chain.shaft import cell_of, point_at
from jaxwhisker._space_chain.stance import bases_of, chains_of, shafts_of, steps_of
from pegs_engine import PHASE, contacts, problem

EXACT = 1e-8
BETWEEN = 1e-8  # of quintics between points


@jax.jit
def seen(problem, z, phase, beyond):
    """The shaft, the points with these arc lengths beyond them, and the middle of a cell of the second segment."""
    pose = jnp.zeros((1, 6))
    shaft = jax.tree.map(lambda leaf: leaf[0], shafts_of(problem, pegs.CONTROL, pose, z, phase))
    own = chains_of(problem, pegs.CONTROL, z, phase), phase[None], bases_of(problem, pegs.CONTROL, pose)
    steps = steps_of(problem)

    def points(body, *own):
        chain, phase, base = own
        return jax.vmap(lambda b: point_at(body, steps, chain, phase, base, b))(beyond)

    cell = cell_of(shaft, jnp.asarray(1), jnp.asarray(6))
    return shaft, of_each(problem, points, *own)[0], cell.beyond + cell.length / 2, cell.point(jnp.asarray(0.5))


def test_the_shaft_runs_from_the_tip_through_all_contacts_to_the_base():
    z = contacts()
    shaft, points, middle, between = seen(problem(), z, PHASE, jnp.array([0.0, 0.05, 0.4, 1.0]))
    np.testing.assert_allclose(shaft.position[1:, 0], z[:, POINT], atol=EXACT)
    np.testing.assert_allclose(shaft.position[:2, -1], z[:, POINT], atol=EXACT)
    np.testing.assert_allclose(shaft.position[2, -1], [pegs.CONTROL, 0.0, 0.0], atol=EXACT)
    np.testing.assert_allclose(shaft.beyond[:, 0], [0.0, *(1 - np.array(pegs.CONTACTS["contact_arc"]))], atol=EXACT)
    assert shaft.starts.tolist() == [False, True, True]
    assert shaft.ends.tolist() == [True, True, False]
    # Beyond the outermost contact, the whisker is straight.
    tip = z[0, POINT] + float(shaft.beyond[1, 0]) * shaft.tangent[1, 0]
    np.testing.assert_allclose(shaft.position[0, 0], tip, atol=EXACT)
    np.testing.assert_allclose(points[0], tip, atol=EXACT)
    np.testing.assert_allclose(points[3], shaft.position[2, -1], atol=EXACT)
    own = seen(problem(), z, PHASE, jnp.full(4, middle))[1][0]
    np.testing.assert_allclose(between, own, atol=BETWEEN)


def test_a_free_whisker_is_straight():
    shaft, points, *_ = seen(problem(), jnp.zeros((2, 11)), jnp.zeros(2, int), jnp.array([0.0, 0.05, 0.4, 1.0]))
    np.testing.assert_allclose(points, [[pegs.CONTROL, y, 0.0] for y in (1.0, 0.95, 0.6, 0.0)], atol=EXACT)
    assert not jnp.any(shaft.starts) and not jnp.any(shaft.ends)
