"""User-defined functions as fields, numbers as text, placeholders for invalid values."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.leaves import as_field, as_text, name_of, number_or_function, safe_placeholder, text_unless


class Line(eqx.Module):
    growth: float

    def __call__(self, x):
        return self.growth * x


def parabola(x):
    return x**2


def test_a_plain_function_has_no_leaves():
    field = as_field(parabola)
    assert jax.tree.leaves(field) == []
    assert field(3.0) == 9.0
    assert field == as_field(parabola)


def test_modules_and_numbers_stay():
    line = Line(2.0)
    assert as_field(line) is line
    assert jax.tree.leaves(as_field(line)) == [2.0]
    assert as_field(3.0) == 3.0
    assert as_field(None) is None


def test_names_of_functions():
    assert name_of(as_field(parabola)) == "parabola"
    assert name_of(Line(2.0)) == "Line"
    assert name_of(jnp.cosh) == "cosh"


def test_a_field_that_may_be_a_function_checks_it():
    convert = number_or_function("stiffness")
    assert convert(3.0) == 3.0
    assert convert(parabola)(2.0) == 4.0
    with pytest.raises(ValueError, match="`stiffness` must be a function"):
        convert(lambda x, y: x)


def test_numbers_as_text():
    assert as_text(0.1 + 0.2) == "0.3"
    assert as_text(np.ones(2)) == "..."
    seen = []
    jax.jit(lambda x: seen.append(as_text(x)))(1.0)
    assert seen == ["?"]


def test_the_default_is_not_written():
    assert text_unless(1.0, ", a = ", 1.0 + 1e-12) == ""
    assert text_unless(1.0, ", a = ", 2.0) == ", a = 2"


@pytest.mark.parametrize("bad", [jnp.nan, jnp.inf, -3.0, 0.0, 0.5, 7.0])
def test_placeholders_are_positive_and_have_no_derivative(bad):
    def root(value, valid):
        return jnp.sqrt(safe_placeholder(value, valid))

    value, slope = jax.value_and_grad(root)(bad, jnp.asarray(False))
    assert 0 < value <= 1 and slope == 0
    value, slope = jax.value_and_grad(root)(4.0, jnp.asarray(True))
    assert value == 2.0 and slope == 0.25


def test_placeholders_keep_functions():
    tree = safe_placeholder((parabola, jnp.asarray(-1.0)), jnp.asarray(False))
    assert tree[0] is parabola
    assert tree[1] == 1.0
