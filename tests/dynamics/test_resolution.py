"""The warning about unresolved stiffness, against errors of frequencies that are computed with NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh

import jaxwhisker as jw
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.resolution import RESOLVED, _error, warn_of_shapes

ROUNDING = 1e-9
CELLS = 150  # of the whisker, for frequencies
MIDDLES = (np.arange(CELLS) + 0.5) / CELLS


class Jump(eqx.Module):
    """A stiffness of 1 up to a place, and another one beyond it."""

    place: jax.Array
    beyond: jax.Array

    def __call__(self, s):
        return jnp.where(s < self.place, 1.0, self.beyond)


class Line(eqx.Module):
    """A stiffness of 1 at the base that changes linearly."""

    slope: jax.Array

    def __call__(self, s):
        return 1.0 + self.slope * s


def jump(place=0.53, beyond=0.4, breaks=True):
    return jw.Whisker(
        1.0, Jump(jnp.asarray(place), jnp.asarray(beyond)), breaks=(place,) if breaks else None, mass_per_length=1.0
    )


def frequency(curvatures, form):
    """First frequency with curvatures that are sums of these, whose bending energy has this quadratic form."""
    angles = (np.cumsum(curvatures, axis=0) - curvatures / 2) / CELLS
    moves = (np.cumsum(angles, axis=0) - angles / 2) / CELLS
    return eigh(moves.T @ moves / CELLS, form, eigvals_only=True)[-1] ** -0.5


@pytest.mark.parametrize("shapes", [6, 10])
def test_the_estimated_error_is_about_that_of_the_first_frequency(shapes):
    own = basis(shapes)
    stiffness = [np.where(s < 0.53, 1.0, 0.4) for s in (MIDDLES, own.points)]
    exact = frequency(np.eye(CELLS), np.diag(stiffness[0]) / CELLS)
    series = [np.polynomial.Legendre.basis(k, domain=[0, 1])(MIDDLES) for k in range(shapes)]
    form = own.curvatures.T @ np.diag(own.weights * stiffness[1]) @ own.curvatures
    error = abs(frequency(np.stack(series, axis=1), form) / exact - 1)
    estimate = float(_error(jax.tree.map(jnp.asarray, jump()), shapes))
    assert error > RESOLVED and 0.5 < estimate / error < 2.0


def test_stiffness_that_polynomials_resolve_raises_no_warning():
    mild = jw.Whisker(1.0, Line(jnp.asarray(-0.5)), mass_per_length=1.0)
    warn_of_shapes((mild, jw.Whisker(mass_per_length=1.0)), 8)
    straight = jw.Whisker(1.0, Line(jnp.asarray(0.0)), mass_per_length=1.0)
    assert _error(jax.tree.map(jnp.asarray, straight), 8) < ROUNDING


def test_a_jump_of_the_stiffness_raises_a_warning_with_and_without_breaks():
    for breaks in (True, False):
        with pytest.warns(UserWarning, match=r"8 shape functions do not resolve `bending_stiffness`.*is [0-9.]+ %"):
            warn_of_shapes((jw.Whisker(mass_per_length=1.0), jump(beyond=0.05, breaks=breaks)), 8)


def test_a_traced_whisker_is_not_examined():
    def double(beyond):
        warn_of_shapes((jump(beyond=beyond),), 8)
        return 2 * beyond

    assert jax.vmap(double)(jnp.array([0.05, 0.1])).tolist() == [0.1, 0.2]
