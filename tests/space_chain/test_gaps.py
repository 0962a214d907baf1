"""Gaps between shafts in space and objects."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.surfaces import as_one_surface
from jaxwhisker._space.contact import AHEAD, POINT, SLACK
from jaxwhisker._space_chain.gaps import gaps_of
from jaxwhisker._space_chain.shaft import WholeShaftInSpace

POINTS = 13
EXACT = 1e-12


def straight(starts: bool = False) -> WholeShaftInSpace:
    """A straight shaft along y, from (0, 1, 0) to the origin."""
    beyond = jnp.linspace(0.0, 1.0, POINTS)[None]
    position = jnp.stack([0 * beyond, 1 - beyond, 0 * beyond], axis=-1)
    up, x = (jnp.broadcast_to(jnp.asarray(axis), position.shape) for axis in ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
    return WholeShaftInSpace(beyond, position, up, 0 * up, x, jnp.asarray([starts]), jnp.asarray([False]))


@jax.jit
def gaps(surface, shaft):
    # Beyond a contact at the tip, a shaft has a further segment without length.
    both = jax.tree.map(
        lambda leaf: jnp.concatenate([jnp.broadcast_to(leaf[:, :1], leaf.shape), leaf]),
        shaft._replace(starts=shaft.beyond, ends=shaft.beyond),
    )
    return gaps_of(surface, both._replace(starts=jnp.append(False, shaft.starts), ends=jnp.append(False, shaft.ends)))


def test_the_nearest_points_of_a_straight_shaft():
    objects = as_one_surface((jw.Sphere(0.2, (0.3, 0.4321, 0.4)), jw.Sphere(0.1, (0.0, 1.2, 0.05))))
    found = gaps(objects.in_unit(1.0), straight())
    on_shaft, behind_tip, past_tip, at_tip = found.candidates.distance
    # The distance of a quadric is one to first order: exact where it vanishes.
    np.testing.assert_allclose(on_shaft, (0.5**2 - 0.2**2) / (2 * 0.5), atol=EXACT)
    contact = found.candidates.contact[0]
    np.testing.assert_allclose(contact[SLACK], 1 - 0.4321, atol=EXACT)
    np.testing.assert_allclose(contact[AHEAD], [0.0, 1.0, 0.0], atol=EXACT)
    np.testing.assert_allclose(contact[POINT][1], 0.4321, atol=EXACT)
    assert np.isinf(behind_tip) and np.isinf(past_tip)
    # The sphere above the tip.
    away = np.hypot(0.2, 0.05)
    np.testing.assert_allclose(at_tip, (away**2 - 0.1**2) / (2 * away), atol=EXACT)
    assert found.candidates.phase.tolist() == [Phase.tangential, Phase.tip, Phase.tangential, Phase.tip]
    assert found.base > 0


def test_a_contact_is_no_candidate():
    touching = jw.Sphere(0.3, (0.3, 1.0, 0.0)).in_unit(1.0)
    own = gaps(touching, straight(starts=True)).candidates.distance
    other = gaps(touching, straight()).candidates.distance
    assert np.isinf(own[0])
    assert np.isinf(other[0]) or abs(float(other[0])) < EXACT


def test_a_tip_that_touches_is_no_candidate():
    above = jw.Sphere(0.2, (0.0, 1.2, 0.0)).in_unit(1.0)
    assert np.isinf(gaps(above, straight(starts=True)).candidates.distance[1])
    np.testing.assert_allclose(gaps(above, straight()).candidates.distance[1], 0.0, atol=EXACT)


def test_a_thin_object_between_two_points_of_a_shaft_is_as_near_as_it_is():
    thin = jw.Cylinder(0.002, (0.01, 6.5 / (POINTS - 1), 0.0)).in_unit(1.0)
    # At the points, its distance is 0.04.
    np.testing.assert_allclose(gaps(thin, straight()).distance, (0.01**2 - 0.002**2) / (2 * 0.01), atol=EXACT)


def test_the_lowest_of_two_valleys_before_a_small_ring():
    radius, tube, centre, axis = 0.02, 0.005, np.array([0.0106, 0.4443, 0.0034]), np.array([1.0, 0.118, 0.069])
    found = gaps(jw.Torus(radius, tube, tuple(centre), tuple(axis)).in_unit(1.0), straight())
    y = np.linspace(0.3, 0.5, 200001)
    off = np.stack([0 * y, y, 0 * y], axis=1) - centre
    rise = off @ axis / np.linalg.norm(axis)
    gap = np.hypot(np.sqrt(np.sum(off**2, axis=1) - rise**2) - radius, rise) - tube
    valleys = np.flatnonzero((gap[1:-1] < gap[:-2]) & (gap[1:-1] < gap[2:])) + 1
    assert len(valleys) == 2 and abs(y[valleys[0]] - y[valleys[1]]) < 1 / (POINTS - 1)
    np.testing.assert_allclose(found.candidates.distance[0], gap.min(), atol=1e-9)
    np.testing.assert_allclose(1 - found.candidates.contact[0][SLACK], y[np.argmin(gap)], atol=2e-6)
