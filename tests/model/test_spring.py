"""Springs: stiffness and compliance, traced values out of their domain, errors."""

import jax
import jax.numpy as jnp
import pytest

import jaxwhisker as jw


def test_compliance_is_the_reciprocal_of_stiffness():
    assert jw.Spring((0, 1), 8.0).softness == jw.Spring((0, 1), compliance=0.125).softness == 0.125
    assert jw.Spring((0, 1), jnp.inf).softness == 0


def test_a_rigid_link_has_a_derivative_by_its_compliance():
    def softness(compliance):
        return jw.Spring((0, 1), compliance=compliance).softness

    assert jax.grad(softness)(0.0) == 1


@pytest.mark.parametrize(
    ("stiffness", "valid"), [(70.0, True), (jnp.inf, True), (0.0, False), (-1.0, False), (jnp.nan, False)]
)
def test_traced_stiffness(stiffness, valid):
    assert jax.jit(lambda c: jw.Spring((0, 1), c).valid())(stiffness) == valid


@pytest.mark.parametrize(("compliance", "valid"), [(0.1, True), (0.0, True), (-0.1, False), (jnp.inf, False)])
def test_traced_compliance(compliance, valid):
    assert jax.jit(lambda c: jw.Spring((0, 1), compliance=c).valid())(compliance) == valid


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Spring((0, 1)), "one of `stiffness` and `compliance` must be given, got None and None"),
        (lambda: jw.Spring((0, 1), 3.0, compliance=1.0), "one of `stiffness` and `compliance` .* got 3.0 and 1.0"),
        (
            lambda: jw.Spring((0, 1), 1.0, 0.0, "phi_x", at=0.1),
            "`axis` must be one of x, y, phi, axial for a spring that is on a shaft or not linear, got 'phi_x'",
        ),
        (lambda: jw.Spring((0, 1), jnp.sinh, axis="z"), "`axis` must be one of x, y, phi, axial for a spring that is"),
        (lambda: jw.Spring((0, 1), 1.0, 0.0, "w"), "`axis` must be one of x, y, z, phi_x, phi_y, phi, axial, got 'w'"),
        (lambda: jw.Spring((0, 1), 1.0, None, "phi"), "`rest_length` must be a finite number, got None"),
        (lambda: jw.Spring((1, 1), 70.0), r"`between` must be two different ends, got \(1, 1\)"),
        (lambda: jw.Spring((0, -1), 70.0), "`between` must be a pair of ints, 0 for the drive"),
    ],
)
def test_wrong_springs(make, message):
    with pytest.raises(ValueError, match=message):
        make()
