"""Programs below vmap and jvp: which lanes run together, axes of several vmaps, tangents that are zero."""

# pyright: reportArgumentType=false

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.primitive import LANES, threads
from jaxwhisker._base.program import MOST_ALONE, MOST_SINGLE, Program, Shape

EXACT = 1e-14


def test_large_batches_run_together_if_the_program_allows_it():
    both = [Program(jnp.sin, together=together) for together in (LANES, 0)]
    shape = Shape(None, (), (), ())
    counts = (0, 1, MOST_SINGLE, MOST_SINGLE + 1, MOST_ALONE, MOST_ALONE + 1)
    assert [both[0].lanes_together(shape, count) for count in counts] == [0, 0, 0, 0, 0, LANES]
    assert not any(both[1].lanes_together(shape, count) for count in counts)


def test_threads_are_the_processors_of_this_process(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 5}, raising=False)
    assert threads() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert threads() == 1


RNG = np.random.default_rng(0)
A, B, C = RNG.normal(size=(2, 3, 4)), RNG.normal(size=(5, 3)), RNG.normal(size=5)


def product(a, b, c):
    return a * b + c, jnp.stack([a, b, c])


@pytest.mark.parametrize("together", [0, LANES])
def test_axes_of_several_vmaps_stay_in_their_order(together, monkeypatch):
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", LANES)
    run = Program(product, together=together)
    # Axes 3 (of a and b), 5 (of b and c), 2 and 4 (of a), from the outermost one inwards.
    over = jax.vmap(run, (0, None, None))
    over = jax.vmap(jax.vmap(over, (0, None, None)), (None, 0, 0))
    (value, stack) = jax.vmap(over, (1, 1, None))(A, B, C)
    expected = A.transpose(1, 0, 2)[:, None] * B.T[:, :, None, None] + C[:, None, None]
    assert value.shape == (3, 5, 2, 4) and stack.shape == (3, 5, 2, 4, 3)
    np.testing.assert_allclose(value, expected, atol=EXACT)
    np.testing.assert_allclose(stack[..., 1], np.broadcast_to(B.T[:, :, None, None], value.shape), atol=EXACT)


def test_the_last_block_of_a_batch_is_filled_with_its_last_lane(monkeypatch):
    monkeypatch.setattr("jaxwhisker._base.program.MOST_ALONE", LANES)
    seen = []

    def noted(x):
        jax.debug.callback(lambda x: seen.append(float(x)), x)
        return 2 * x

    x = np.arange(float(LANES + 3))
    found = jax.vmap(Program(noted, together=LANES))(x)
    jax.effects_barrier()
    np.testing.assert_array_equal(found, 2 * x)
    assert sorted(seen) == sorted([*x, *[x[-1]] * (LANES - 3)])


def test_a_result_without_a_tangent_has_a_zero_one():
    given = []

    def tangent(args, dots, _):
        given.append([dot is None for dot in dots])
        (_, y), (x_dot, _) = args, dots
        return {"a": None if x_dot is None else 7.0 * y * x_dot, "b": None}

    run = Program(lambda x, y: {"a": x * y, "b": x + y}, tangent=tangent)
    x, y = jnp.array([1.0, 2.0]), jnp.asarray(3.0)
    values, dots = jax.jvp(lambda x: jax.vmap(run, (0, None))(x, y), (x,), (jnp.array([1.0, -1.0]),))
    np.testing.assert_array_equal(values["b"], [4.0, 5.0])
    np.testing.assert_array_equal(dots["a"], [21.0, -21.0])
    np.testing.assert_array_equal(dots["b"], [0.0, 0.0])
    assert given and all(some == [False, True] for some in given)
    assert jax.grad(lambda y: run(x[0], y)["b"])(y) == 0.0
