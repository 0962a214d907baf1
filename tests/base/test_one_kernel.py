"""Programs as one kernel: what XLA compiles, and that values and batches are those of the function."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.one_kernel import in_one_kernel


def halved(x):
    """A loop and a sum, each of them a kernel of its own."""
    end = jax.lax.while_loop(lambda x: jnp.max(x) > 1, lambda x: x / 2, x)
    return {"end": end, "sum": jnp.sum(jnp.sin(end))}


AT = jnp.linspace(1.0, 50.0, 2000)  # more than the bytes that XLA takes for small by itself


def operations(function):
    """Operations of the entry of a compiled program that may start a kernel."""
    _, entry = jax.jit(function).lower(AT).compile().as_text().split("ENTRY")  # pyright: ignore[reportOptionalMemberAccess]
    return [name for name in re.findall(r"= .*? ([a-z\-]+)\(", entry) if name not in ("parameter", "get-tuple-element")]


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="kernels of the CPU")
def test_a_loop_and_what_follows_are_one_kernel():
    assert "while" in operations(halved) and len(operations(halved)) > 1
    assert set(operations(in_one_kernel(halved))) <= {"call", "copy"}


@pytest.mark.parametrize("batch", [False, True])
def test_values_and_batches_are_those_of_the_function(batch):
    x = jnp.stack([AT, 2 * AT]) if batch else AT
    expected, found = (
        jax.jit(jax.vmap(function) if batch else function)(x) for function in (halved, in_one_kernel(halved))
    )
    np.testing.assert_array_equal(found["end"], expected["end"])
    np.testing.assert_allclose(found["sum"], expected["sum"], rtol=1e-14)
