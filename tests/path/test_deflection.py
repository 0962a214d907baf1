"""Deflections that are known in closed form: what grows and in which order, all statuses, and derivatives."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._path.deflection import (
    ACCURACY,
    UNEVEN_ACCURACY,
    AbstractLoadCase,
    AbstractLoadedRod,
    AtBase,
    branch_of,
    checks_of,
    deflected,
)

SOLVED = 1e-10  # of Newton's method
FOLD = 0.25  # largest load that a rod bears


class FoldingRod(AbstractLoadedRod):
    """A rod with the equation a - a^2 = load, after a spring has moved its base by its length."""

    load: jax.Array
    spring: jax.Array | None
    error: jax.Array  # of the rod's steps
    uniform: bool = eqx.field(static=True, default=True)  # pyright: ignore[reportIncompatibleMethodOverride]

    @property
    def stages(self):
        return 1 if self.spring is None else 2

    @property
    def sizes(self):
        return [self.load] if self.spring is None else [jnp.ones(()), self.load]

    @property
    def unbent(self):
        return jnp.zeros(1)

    def at_base(self, unknowns, shares):
        moved = 0.0 if self.spring is None else shares[0] * self.spring
        a = unknowns - moved
        return AtBase(a - a**2 - shares[-1] * self.load, unknowns)

    def refined(self, unknowns, shares):
        missed, pose = self.at_base(unknowns, shares)
        return AtBase(missed, pose + self.error), unknowns[0] > -1.0


class Case(AbstractLoadCase):
    load: jax.Array
    spring: jax.Array | None = None
    error: Any = 0.0
    uniform: bool = eqx.field(static=True, default=True)

    def equations(self):
        return FoldingRod(self.load, self.spring, jnp.asarray(self.error), self.uniform)

    def valid(self, rods):
        return rods.load < 10.0

    def values(self, rods, unknowns, points):
        return {"a": unknowns[0] + jnp.zeros(points)}


def exact(load, spring=0.0):
    return spring + (1 - np.sqrt(1 - 4 * load)) / 2


def case(load, spring=None, error=0.0):
    return Case(jnp.asarray(load), None if spring is None else jnp.asarray(spring), jnp.asarray(error))


@pytest.mark.parametrize("spring", [None, 0.7])
def test_the_branch_begins_at_rest_and_ends_under_the_full_load(spring):
    end = jax.jit(lambda: branch_of(case(0.2, spring).equations()))()
    np.testing.assert_allclose(end.unknowns, [exact(0.2, spring or 0.0)], atol=SOLVED)
    np.testing.assert_array_equal(end.shares, np.ones(1 if spring is None else 2))
    assert not end.lost


def test_the_branch_ends_where_stability_is_lost():
    end = jax.jit(lambda: branch_of(case(1.0, spring=0.7).equations()))()
    assert end.lost and end.shares[0] == 1.0
    np.testing.assert_allclose(end.shares[1], FOLD, atol=1e-4)  # the last step before the fold
    # A spring that the branch does not survive: the loads do not begin to grow.
    end = jax.jit(lambda: branch_of(Breaking(jnp.asarray(0.1), None, jnp.asarray(0.0))))()
    assert end.lost and end.shares[0] < 0.3 and end.shares[1] == 0.0


class Breaking(FoldingRod):
    """A rod that folds while its spring grows."""

    @property
    def stages(self):
        return 2

    @property
    def sizes(self):
        return [jnp.ones(()), self.load]

    def at_base(self, unknowns, shares):
        return AtBase(unknowns - unknowns**2 - shares[0] - shares[1] * self.load, unknowns)


def test_errors_are_residuals_and_what_finer_steps_change():
    rods = case(0.2, error=3e-4).equations()
    found = checks_of(rods, jnp.array([0.5]), jnp.ones(1))
    np.testing.assert_allclose(found.residual, 0.25 - 0.2, rtol=1e-12)
    np.testing.assert_allclose(found.by_steps, 0.25 - 0.2, rtol=1e-12)
    at_solution = checks_of(rods, jnp.array([exact(0.2)]), jnp.ones(1))
    assert at_solution.residual < SOLVED and found.stable
    np.testing.assert_allclose(at_solution.by_steps, 3e-4, rtol=1e-6)


STATUSES = [
    ({"load": 0.2}, jw.Status.ok),
    ({"load": 0.3}, jw.Status.unstable),
    ({"load": 0.2, "error": 2 * ACCURACY}, jw.Status.inexact),
    ({"load": 0.3, "error": 2 * ACCURACY}, jw.Status.inexact),  # even if it seems to be unstable
    ({"load": 11.0}, jw.Status.invalid),
    ({"load": 0.2, "spring": -2.0}, jw.Status.unstable),  # by its own criterion
    ({"load": jnp.nan}, jw.Status.invalid),
]


@pytest.mark.parametrize(("given", "status"), STATUSES)
def test_values_are_nan_unless_the_status_is_ok(given, status):
    values = deflected(case(**given), 3)
    assert values["status"] == status
    expected = exact(0.2) if status == jw.Status.ok else np.nan
    np.testing.assert_allclose(values["a"], np.full(3, expected), atol=SOLVED)


def test_rods_that_are_not_uniform_may_be_less_accurate():
    for error, status in ((UNEVEN_ACCURACY / 2, jw.Status.ok), (UNEVEN_ACCURACY * 2, jw.Status.inexact)):
        assert deflected(Case(jnp.asarray(0.2), None, jnp.asarray(error), uniform=False), 2)["status"] == status


def test_derivatives_in_both_modes_and_in_a_batch_with_a_lane_that_fails():
    def a(load):
        return deflected(Case(load), 2)["a"][0]

    slope = 1 / np.sqrt(1 - 4 * 0.2)
    for derivative in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(derivative(a)(jnp.asarray(0.2)), slope, rtol=1e-8)
    np.testing.assert_allclose(jax.jit(jax.grad(jax.grad(a)))(jnp.asarray(0.2)), 2 * slope**3, rtol=1e-7)
    values, slopes = jax.vmap(jax.value_and_grad(a))(jnp.array([0.2, 0.3]))
    np.testing.assert_allclose(values, [exact(0.2), np.nan], atol=SOLVED)
    np.testing.assert_allclose(slopes[0], slope, rtol=1e-8)
    shared = jax.grad(lambda load: jnp.nansum(jax.vmap(lambda k: a(k * load))(jnp.array([1.0, 1.5]))))(jnp.asarray(0.2))
    np.testing.assert_allclose(shared, slope, rtol=1e-8)
