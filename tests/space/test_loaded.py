"""The equations of a whisker under forces in space, and their second variation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.quadrature import gauss, legendre_integrals
from jaxwhisker._base.quaternions import inverse_rotation, product, small_rotation, third_axis, times, turned
from jaxwhisker._model.loads import SpaceForce
from jaxwhisker._rod.space import SpaceSection
from jaxwhisker._space import loaded

EQUILIBRIUM = 1e-9  # first variation: error of the rod's integration
EXACT = 1e-9  # likewise


@pytest.mark.parametrize("free_beyond", [False, True])
def test_the_unloaded_whisker_solves_the_equations(free_beyond):
    whisker = jw.Whisker(2.0, 3.0, 0.4)
    rods = loaded.loaded_in_space(whisker, (SpaceForce(0.1, 0.2, 0.3, 1.5 if free_beyond else None),))
    assert rods.walks_beyond == free_beyond

    def missed(top):
        return rods.at_base(top, jnp.zeros(1)).missed

    np.testing.assert_allclose(missed(rods.unbent), 0.0, atol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(missed)(rods.unbent), np.eye(3), atol=1e-12)


def test_stretches_between_forces():
    whisker = jw.Whisker(2.0)
    rods = loaded.loaded_in_space(whisker, (SpaceForce(1.0, 0.0, 0.0, 0.5), SpaceForce(0.0, 0.0, 1.0, 1.5)))
    np.testing.assert_allclose(rods.position, [0.75, 0.25])
    found = loaded.walked(jnp.zeros(3), rods, 0.5, np.array([0.0, 0.5, 1.0]), 4)
    np.testing.assert_allclose(found.s, [1.0, 0.875, 0.75, 0.75, 0.5, 0.25, 0.25, 0.125, 0.0])
    np.testing.assert_allclose(found.loads.force[2], [0, 0, 0, 2, 2, 2, 2, 2, 2])
    np.testing.assert_allclose(found.loads.force[0], [0, 0, 0, 0, 0, 0, 2, 2, 2])


def test_the_second_variation_is_that_of_the_energy():
    """Along one field of rotations: elastic energy minus the work of the force on the tip."""
    stiffness, own = 1.3 * np.array([1.0, 1.0, 0.6]), np.array([0.4, -0.7, 0.9])
    rods = loaded.loaded_in_space(jw.Whisker(), (SpaceForce(0.8, -0.5, 1.1),))
    section = SpaceSection(1.3, 0.6, (0.4, -0.7, 0.9))
    rods = loaded.LoadedInSpace(rods.force, rods.position, section, rods.straight, rods.walks_beyond)
    nodes, weights = gauss(20)
    found = loaded.walked(jnp.array([0.3, -0.2, 0.5]), rods, 1.0, nodes, 4)
    form = loaded.variation(rods, found, jnp.asarray(weights))
    coefficients = np.random.default_rng(0).normal(size=(loaded.MODES, 3))

    def energy(size):
        def density(s, state, load):
            def rotated(at):
                fields = jnp.stack(legendre_integrals(at, loaded.MODES))
                return jnp.stack(small_rotation(tuple(size * coefficients.T @ fields)))

            by, slope = jax.jvp(rotated, (s,), (1.0,))
            spin = times(2.0, product(tuple(slope), inverse_rotation(tuple(by)))[1:])
            after = product(tuple(by), state[1])
            k = own + jnp.stack(turned(inverse_rotation(state[1]), load.moment_at(state[0]))) / stiffness
            k = k + jnp.stack(turned(inverse_rotation(after), spin))
            return jnp.sum(stiffness * (k - own) ** 2 / 2) - jnp.stack(load.force) @ jnp.stack(third_axis(after))

        return weights @ jax.vmap(density)(found.s, found.states, found.loads)

    first, second = jax.jvp(jax.jacfwd(energy), (0.0,), (1.0,))
    assert abs(first) < EQUILIBRIUM
    flat = np.ravel(coefficients)
    np.testing.assert_allclose(flat @ form @ flat, second, rtol=EXACT)
