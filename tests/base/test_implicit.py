"""Implicit derivatives: against closed forms, in both modes and to second order; never a silent zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.linear_algebra import UNROLLED

EXACT = 1e-12  # relative; the equations are solved in closed form

CUBES = jnp.array([1.0, 8.0, 27.0])


def cube_roots(unknowns, known):
    """Coupled equations whose unknowns are the cube roots of known numbers, times a known factor."""
    cubes, factor = known
    return (unknowns / factor["by"]) ** 3 - cubes + jnp.sum((unknowns / factor["by"]) ** 3 - cubes)


def solved(cubes, by):
    """Cube roots times `by`, which know their derivatives from the equations alone."""
    constant = jax.lax.stop_gradient(by * jnp.cbrt(cubes))
    return solution_of(cube_roots, constant, (cubes, {"by": by}))


def closed(cubes, by):
    return by * jnp.cbrt(cubes)


@pytest.mark.parametrize("size", [3, UNROLLED + 2])  # elimination is unrolled, or runs in a loop
def test_derivatives_agree_with_the_closed_form(size):
    at, by = jnp.arange(1.0, size + 1), jnp.asarray(2.0)
    np.testing.assert_array_equal(solved(at, by), closed(at, by))
    for mode in (jax.jacfwd, jax.jacrev):
        for one, other in zip(*(jax.jit(mode(f, argnums=(0, 1)))(at, by) for f in (solved, closed)), strict=True):
            np.testing.assert_allclose(one, other, rtol=EXACT, atol=EXACT)
    second = [jax.jit(jax.jacfwd(jax.jacrev(f, argnums=1), argnums=0))(at, by) for f in (solved, closed)]
    np.testing.assert_allclose(*second, rtol=EXACT, atol=EXACT)


def test_equations_that_do_not_depend_on_what_is_known_have_a_constant_solution():
    def solution(known):
        return solution_of(lambda unknowns, known: unknowns - 2.0, jnp.array([2.0]), (known,))

    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(mode(solution)(jnp.asarray(3.0)), [0.0])


def test_a_singular_system_is_a_failure_of_its_own_batch_element():
    batch = jnp.stack([CUBES, CUBES.at[1].set(0.0), CUBES])
    slopes = jax.jit(jax.vmap(jax.jacfwd(solved), in_axes=(0, None)))(batch, jnp.asarray(2.0))
    expected = jax.jacfwd(closed)(CUBES, 2.0)
    assert not np.all(np.isfinite(slopes[1]))
    for lane in (0, 2):
        np.testing.assert_allclose(slopes[lane], expected, rtol=EXACT, atol=EXACT)


def test_second_derivatives_in_a_loop_are_right_or_nan():
    def total(loop, scale):
        return jnp.sum(loop(lambda x: solved(jnp.reshape(scale * x, 1), 1.0)[0], jnp.arange(1.0, 4.0)))

    batch, loop = (lambda scale, map=map: total(map, scale) for map in (lambda f, x: jax.vmap(f)(x), jax.lax.map))
    expected = -2 / 9 * jnp.sum(jnp.cbrt(jnp.arange(1.0, 4.0))) * 2.0 ** (-5 / 3)
    np.testing.assert_allclose([jax.hessian(batch)(2.0), jax.jacfwd(jax.jacfwd(loop))(2.0)], expected, rtol=EXACT)
    within = jax.hessian(loop)(2.0)  # jax 0.10 loses the rule for second derivatives, 0.12 does not
    assert np.isnan(within) or abs(within - expected) < EXACT
    assert np.isfinite(jax.grad(lambda scale: total(jax.lax.map, scale))(2.0))


def test_without_a_rule_the_derivative_is_nan_and_the_value_stays():
    point, known = jnp.array([1.0, 2.0]), {"some": jnp.array([3.0, jnp.inf]), "count": 4}
    assert without_rule(point, known).tolist() == [1.0, 2.0]
    by_known = jax.grad(lambda some: without_rule(point, {**known, "some": some}).sum())(known["some"])
    assert np.isnan(by_known[0]) and by_known[1] == 0  # no derivative with respect to infinity
    by_point = jax.grad(lambda point: without_rule(point, known).sum())(point)
    assert by_point.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_only_where_a_condition_holds_derivatives_are_unknown(mode):
    def slope(lost):
        return mode(lambda x: without_rule(2 * x, x, jnp.asarray(lost)))(jnp.asarray(3.0))

    assert slope(False) == 2 and jnp.isnan(slope(True))
