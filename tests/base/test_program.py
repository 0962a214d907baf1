"""The compilation wrapper: static arguments, use inside a caller's jit, compilation ahead of time."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp

from jaxwhisker._base.program import Program


def counted():
    """A compiled function, and how often it has been traced."""
    traces = []

    @Program
    def scale(x, name):
        """Twice the argument."""
        traces.append(name)
        return 2 * x

    return scale, traces


def test_arguments_that_are_no_arrays_are_static():
    scale, traces = counted()
    assert scale.__doc__ == "Twice the argument."
    assert scale(jnp.asarray(3.0), "a") == scale(jnp.asarray(3.0), "b") == 6.0
    assert scale(jnp.asarray(4.0), "a") == 8.0
    assert traces == ["a", "b"]


def test_inside_a_caller_it_is_part_of_the_callers_program():
    scale, _ = counted()
    assert jax.jit(lambda x: scale(x, "a") + 1)(3.0) == 7.0
    assert jax.grad(lambda x: scale(x, "a"))(3.0) == 2.0
    assert jax.vmap(lambda x: scale(x, "a"))(jnp.arange(2.0)).tolist() == [0.0, 2.0]


def test_compilation_ahead_of_time():
    scale, traces = counted()
    scale.compile(jnp.asarray(3.0), "a")
    with ThreadPoolExecutor(1) as pool:
        scale.compile_aside(pool, jnp.asarray(3.0), "b").result()
    assert scale(jnp.asarray(3.0), "a") == scale(jnp.asarray(3.0), "b") == 6.0
    assert sorted(set(traces)) == ["a", "b"]
