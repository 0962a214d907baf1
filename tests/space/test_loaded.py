"""The equations of a whisker under given loads in space, and its stiffness against rotations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.quadrature import gauss, legendre_integrals
from jaxwhisker._base.quaternions import inverse_rotation, product, small_rotation, third_axis, times, turned
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._space import loaded

EQUILIBRIUM = 1e-9  # virtual work: error of the rod's integration
EXACT = 1e-9  # likewise


@pytest.mark.parametrize("free_beyond", [False, True])
def test_the_unloaded_whisker_solves_the_equations(free_beyond):
    whisker = jw.Whisker(2.0, 3.0, 0.4)
    rods = loaded.loaded_in_space(whisker, (jw.SpaceForce(0.1, 0.2, 0.3, 1.5 if free_beyond else None),))
    assert rods.walks_beyond == free_beyond

    def missed(top):
        return rods.at_base(top, jnp.zeros(1)).missed

    np.testing.assert_allclose(missed(rods.unbent), 0.0, atol=1e-14)
    # Rotations of the top are rotations of the base, and the determinant is positive.
    slope = jax.jacfwd(missed)(rods.unbent)
    np.testing.assert_allclose(slope @ slope.T, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(jnp.linalg.det(slope), 1.0, atol=1e-12)


def test_stretches_between_loads():
    whisker = jw.Whisker(2.0)
    loads = jw.SpaceForce(1.0, 0.0, 0.0, 0.5), jw.SpaceForce(0.0, 0.0, 1.0, 1.5), jw.LineLoad(0.5, stop=1.25)
    rods = loaded.loaded_in_space(whisker, loads)
    np.testing.assert_allclose(rods.loads.position, [0.75, 0.25])
    found = loaded.walked(rods.unbent, rods, 0.5, np.array([0.0, 0.5, 1.0]), 4)
    np.testing.assert_allclose(found.s, [1.0, 0.875, 0.75, 0.75, 0.5, 0.25, 0.25, 0.125, 0.0])
    np.testing.assert_allclose(found.loads.force[2], [0, 0, 0, 2, 2, 2, 2, 2, 2])
    by_line = 0.5 * 0.5 * 8 * np.maximum(0.625 - found.s, 0.0)
    np.testing.assert_allclose(found.loads.force[0] - by_line, [0, 0, 0, 0, 0, 0, 2, 2, 2], atol=1e-13)
    np.testing.assert_allclose(found.given[0], [[0.0, 2.0], [0.0, 0.0], [2.0, 0.0]], atol=1e-13)
    # The size of all: forces of 4 each, and 1.25 times 0.5, in EI/L^2 = 1/4.
    np.testing.assert_allclose(rods.sizes[0], 4 + 4 + 1.25 * 0.5 * 4, rtol=1e-3)


def test_a_load_at_the_tip_is_at_the_first_place():
    follower = jw.SpaceForce(0.3, 0.2, 0.1, follower=True)
    rods = loaded.loaded_in_space(jw.Whisker(), (follower, jw.SpaceMoment(0.0, 0.0, 0.4, position=0.6)))
    found = loaded.walked(rods.unbent, rods, 1.0, np.array([0.0, 1.0]), 4)
    np.testing.assert_allclose(found.given[0], [[0.3, 0.0], [0.2, 0.0], [0.1, 0.0]], atol=1e-13)
    np.testing.assert_allclose(found.given[1], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.4]], atol=1e-13)


BOTH = jw.SpaceForce(0.8, -0.5, 1.1, 0.4, follower=True), jw.SpaceMoment(0.3, 0.7, -0.2, 0.4, follower=True)
LOADS = {
    "dead": (jw.SpaceForce(0.8, -0.5, 1.1), jw.SpaceMoment(0.3, 0.7, -0.2, 0.4)),
    "followers": (*BOTH, jw.SpaceForce(-0.4, 0.9, 0.3, follower=True)),
    "distributed": (jw.LineLoad(0.8, -0.5, z=1.1), jw.SpaceMoment(0.3, 0.7, -0.2, follower=True)),
}


@pytest.mark.parametrize("kind", LOADS)
def test_the_stiffness_is_the_change_of_virtual_work(kind):
    """Along one field of rotations w, of the work by another one v: of elastic moments, and of loads."""
    stiffness, own = 1.3 * np.array([1.0, 1.0, 0.6]), np.array([0.4, -0.7, 0.9])
    rods = loaded.loaded_in_space(jw.Whisker(), LOADS[kind])
    section = SpaceSection(1.3, 0.6, (0.4, -0.7, 0.9))
    rods = loaded.LoadedInSpace(rods.loads, rods.lines, section, rods.straight, rods.walks_beyond)
    nodes, weights = gauss(20)
    top = rods.unbent + jnp.array([0.3, -0.2, 0.5, 0.1])
    found = jax.jit(lambda top: loaded.walked(top, rods, 1.0, nodes, 4))(top)
    weights = jnp.ravel(found.lengths[:, None] * weights)
    elastic, form = jax.jit(lambda found: loaded.stiffness(rods, found, weights))(found)
    rows, columns = np.random.default_rng(0).normal(size=(2, loaded.MODES, 3)) / np.arange(1, loaded.MODES + 1)[:, None]

    follows = rods.loads.follower.tolist()

    def field(coefficients, at):
        return coefficients.T @ jnp.stack(legendre_integrals(at, loaded.MODES))

    def work(size):
        """Virtual work on `columns` after a rotation by a size times `rows`; forces grow on a rod that is displaced."""

        def rotation(at):
            return small_rotation(tuple(size * field(rows, at)))

        def density(s, state, load):
            by, slope = jax.jvp(lambda at: jnp.stack(rotation(at)), (s,), (1.0,))
            virtual, rate = jax.jvp(lambda at: field(columns, at), (s,), (1.0,))
            spin = times(2.0, product(tuple(slope), inverse_rotation(tuple(by)))[1:])
            after = product(tuple(by), state[1])
            k = own + jnp.stack(turned(inverse_rotation(state[1]), load.moment_at(state[0]))) / stiffness
            k = k + jnp.stack(turned(inverse_rotation(after), spin))
            moment = jnp.stack(turned(after, tuple(stiffness * (k - own))))
            displaced = jnp.cross(virtual, jnp.stack(third_axis(after)))
            return moment @ rate - jnp.stack(load.force) @ displaced, displaced

        along, displaced = jax.vmap(density)(found.s, found.states, found.loads)
        total = weights @ along
        for k, place in enumerate(rods.loads.position):
            force, moment = (jnp.stack([part[k] for part in given]) for given in found.given)
            by = rotation(place)
            if follows[k]:
                more = jnp.stack(turned(by, tuple(force))) - force
                total -= more @ (jnp.where(found.s < place, weights, 0.0) @ displaced)
                moment = jnp.stack(turned(by, tuple(moment)))
            total -= moment @ field(columns, place)
        return total

    value, slope = jax.jit(lambda: jax.jvp(work, (0.0,), (1.0,)))()
    assert abs(value) < EQUILIBRIUM
    np.testing.assert_allclose(np.ravel(rows) @ form @ np.ravel(columns), slope, rtol=EXACT)
    np.testing.assert_allclose(elastic, elastic.T, atol=EXACT)
    assert np.max(np.abs(form - form.T)) > 0.01  # moments and followers have no potential


def test_dead_forces_have_a_potential():
    loads = jw.SpaceForce(0.8, -0.5, 1.1), jw.LineLoad(0.8, -0.5, z=1.1), jw.PointForce(0.4, 0.6)
    rods = loaded.loaded_in_space(jw.Whisker(1.0, 1.0, 0.3), loads)
    nodes, weights = gauss(20)
    found = jax.jit(lambda: loaded.walked(rods.unbent, rods, 1.0, nodes, 4))()
    stiffness = jax.jit(lambda found, weights: loaded.stiffness(rods, found, weights))
    _, form = stiffness(found, jnp.ravel(found.lengths[:, None] * weights))
    np.testing.assert_allclose(form, form.T, atol=EXACT)
