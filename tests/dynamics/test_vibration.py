"""The flexibility of all whiskers on their network, against the inverse of the whole stiffness."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag

import jaxwhisker as jw
from jaxwhisker._dynamics.forms import Forms, condensed
from jaxwhisker._dynamics.vibration import _assembled, _by_whisker, mass_unit

EXACT = 1e-10
INNER = 4  # coordinates of each of two whiskers besides those of its base


def drawn() -> Any:
    """Random forms of two whiskers without contact, the frames of their bases, and the stiffness of the network."""
    rng = np.random.default_rng(0)

    def positive(*shape):
        half = rng.normal(size=(*shape, shape[-1]))
        return half @ np.swapaxes(half, -1, -2) + np.eye(shape[-1])

    axes = np.linalg.qr(rng.normal(size=(2, 3, 3)))[0]
    mass, stiffness, below, network = positive(2, INNER + 3), positive(2, INNER + 3), positive(2, 3), positive(6)
    given = (jnp.asarray(each) for each in (mass, stiffness, below, np.zeros((2, 1, INNER + 3))))
    fields: Any = None
    return Forms(*given, defined=jnp.ones(2, bool), fields=fields), axes, mass, stiffness, below, network


def whole(blocks, axes) -> Any:
    """The form of the inner coordinates of all whiskers, and then of all bases in their frames."""
    turned = [block_diag(np.eye(INNER), own) for own in axes]
    both: Any = block_diag(*(turn.T @ block @ turn for turn, block in zip(turned, blocks, strict=True)))
    size = INNER + 3
    order = [*range(INNER), *range(size, size + INNER), *range(INNER, size), *range(size + INNER, 2 * size)]
    return both[np.ix_(order, order)]


@pytest.mark.unchecked  # the problem is not a Problem
def test_the_flexibility_is_the_inverse_of_the_stiffness_of_whiskers_and_network():
    forms, axes, mass, stiffness, below, network = drawn()
    # Springs that the network contains, but that do not exist.
    held = SimpleNamespace(held=jnp.tile(0.3 * jnp.eye(3), (2, 1, 1)))

    @jax.jit
    def assembled(forms, axes, matrix):
        problem: Any = SimpleNamespace(flexibility=SimpleNamespace(matrix=matrix), attached=held)
        return _assembled(problem, forms, jax.vmap(condensed)(forms), axes)

    found_mass, found = assembled(forms, jnp.asarray(axes), jnp.asarray(np.linalg.inv(network)))
    np.testing.assert_allclose(found_mass, whole(mass, axes), atol=EXACT)
    stiff = stiffness.copy()
    stiff[:, INNER:, INNER:] += below
    expected = whole(stiff, axes)
    expected[-6:, -6:] += network - 0.3 * np.eye(6)
    np.testing.assert_allclose(found, np.linalg.inv(expected), atol=EXACT)
    # A network without any flexibility is a clamp.
    clamped = assembled(forms, jnp.asarray(axes), jnp.zeros((6, 6)))[1]
    alone = [np.linalg.inv(own[:INNER, :INNER]) for own in stiffness]
    expected = np.asarray(block_diag(*alone, np.zeros((6, 6))))
    np.testing.assert_allclose(clamped, expected, atol=EXACT)


def test_a_mode_has_the_inner_coordinates_of_each_whisker_and_the_pose_of_its_base():
    axes = drawn()[1]
    mode = np.arange(2.0 * INNER + 6)
    own, base = jax.jit(_by_whisker)(jnp.asarray(mode), jnp.asarray(axes))
    np.testing.assert_array_equal(base, [[8, 9, 10], [11, 12, 13]])
    for k in range(2):
        np.testing.assert_allclose(own[k], [*mode[INNER * k : INNER * (k + 1)], *axes[k] @ base[k]], atol=EXACT)


def test_masses_are_measured_in_that_of_the_first_base():
    assert mass_unit((jw.Whisker(mass_per_length=3.0), jw.Whisker(mass_per_length=9.0))) == 3.0
