"""The network: flexibility matrix, rest positions, rigid springs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxwhisker as jw

EXACT = 1e-12


def stiffness_matrix(springs, n):
    """Stiffness matrix and resting forces, assembled as in any finite-element text."""
    matrix, force = np.zeros((n, n)), np.zeros(n)
    for s in springs:
        row = np.zeros(n + 1)
        row[s.between[0]], row[s.between[1]] = -1, 1
        matrix += s.stiffness * np.outer(row[1:], row[1:])
        force += s.stiffness * s.rest_length * row[1:]
    return matrix, force


def flexibility_of(support):
    """The flexibility of a support that has springs."""
    flexibility = support.flexibility()
    assert flexibility is not None
    return flexibility


positive = st.floats(0.1, 1e3)


@given(st.lists(st.tuples(positive, st.floats(-1, 1)), min_size=5, max_size=5))
def test_flexibility_inverts_stiffness(values):
    ends = ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3))
    springs = tuple(jw.Spring(e, c, r) for e, (c, r) in zip(ends, values, strict=True))
    matrix, force = stiffness_matrix(springs, 3)
    flexibility = flexibility_of(jw.Support(springs))
    exact = np.linalg.inv(matrix)
    np.testing.assert_allclose(flexibility.matrix, exact, rtol=1e-9, atol=EXACT * float(np.max(np.abs(exact))))
    np.testing.assert_allclose(flexibility.offset, exact @ force, atol=1e-9)
    np.testing.assert_allclose(
        flexibility.root @ flexibility.root.T, exact, rtol=1e-9, atol=EXACT * float(np.max(np.abs(exact)))
    )


def test_rigid_springs_join_bases():
    springs = (
        jw.Spring((0, 1), 5.0, 0.1),
        jw.Spring((1, 2), jnp.inf, 0.2),
        jw.Spring((0, 2), 7.0, 0.3),
    )
    flexibility = flexibility_of(jw.Support(springs))
    np.testing.assert_allclose(flexibility.matrix, np.full((2, 2), 1 / 12), atol=EXACT)
    np.testing.assert_allclose(flexibility.offset, [0.1, 0.3], atol=EXACT)


def test_all_springs_rigid_is_a_clamp():
    flexibility = flexibility_of(jw.Support.fbfbr(jnp.inf, 0.2))
    assert np.all(np.asarray(flexibility.matrix) == 0)
    np.testing.assert_allclose(flexibility.offset, [0.2, 0.4], atol=EXACT)
    assert flexibility.consistent


def test_a_rigid_loop_that_does_not_close_is_told():
    with pytest.raises(ValueError, match="rest_length"):
        jw.Support.fbfbr(jnp.inf, [0.2, 0.2, 0.5])
    consistent = jax.jit(lambda rest: flexibility_of(jw.Support.fbfbr(jnp.inf, [0.2, 0.2, rest])).consistent)
    assert consistent(0.4)
    assert not consistent(0.5)


def test_stiffnesses_over_twelve_decades_stay_positive_semidefinite():
    springs = (jw.Spring((0, 1), 1e-4), jw.Spring((1, 2), 1e8), jw.Spring((0, 2), 1e8), jw.Spring((0, 1), 1e8))
    flexibility = flexibility_of(jw.Support(springs))
    assert np.min(np.linalg.eigvalsh(flexibility.matrix)) > -1e-16
    np.testing.assert_allclose(np.diag(flexibility.matrix), 2 / 3 * 1e-8, rtol=1e-3)


def test_derivatives_beside_a_rigid_spring_are_finite():
    def corner(soft, rigid):
        return flexibility_of(jw.Support.fbfb([soft, rigid], 0.2)).matrix[1, 1]

    by_soft, by_rigid = jax.grad(corner, argnums=(0, 1))(50.0, jnp.inf)
    assert abs(by_soft + 1 / 50.0**2) < EXACT
    assert by_rigid == 0


def test_named_models():
    assert jw.Support.clamped().name == "clamped"
    for name, springs, whiskers in (("FB", 1, 1), ("FBFB", 2, 2), ("FBFBR", 3, 2), ("FBFBFBR", 5, 3)):
        support = jw.Support.named(name, 70.0, 0.2)
        assert (support.name, len(support.springs), support.whiskers) == (name, springs, whiskers)
        offsets = flexibility_of(support).offset
        np.testing.assert_allclose(offsets, 0.2 * np.arange(1, whiskers + 1), atol=EXACT)
    assert jw.Support((jw.Spring((0, 2), 1.0), jw.Spring((1, 2), 1.0))).name == "network"


def test_a_scene_prints_itself():
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0, 0.2))
    assert str(scene) == "FBFBR: 2 whiskers, 3 springs, parabola q = 0.2"
    assert repr(jw.Scene(jw.Whisker(0.5), jw.Circle(0.2, 3.0))) == "clamped: 1 whisker, circle q = 0.2, r = 3, L = 0.5"
