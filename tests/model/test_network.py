"""Networks of springs: flexibility matrix, rest positions, rigid springs."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import jaxwhisker as jw
from jaxwhisker._model.network import connected
from jaxwhisker._model.spring import AXES_IN_SPACE

EXACT = 1e-12


def stiffness_matrix(springs, n):
    """Stiffness matrix and forces at rest along one axis, assembled as in finite elements."""
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


def test_rest_lengths_around_a_rigid_loop_must_add_up():
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


def test_connected_bases_are_found_in_any_order_of_springs():
    springs = (jw.Spring((2, 3), 1.0), jw.Spring((1, 2), 1.0), jw.Spring((4, 5), 1.0), jw.Spring((0, 1), 1.0))
    assert connected(springs) == {0, 1, 2, 3}
    assert connected(springs[:3]) == {0}


def test_frames_of_the_bases_turn_the_flexibility():
    # One base on springs along x and y, in a frame at 0.3 rad: R.T diag(1/cx, 1/cy) R, and moments about the base.
    support = jw.Support.follicle(x=20.0, y=30.0, phi=8.0)
    cos, sin = np.cos(0.3), np.sin(0.3)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    framed = flexibility_of(support).in_frames(jnp.array([0.3]), 2.0, 5.0)
    units = np.diag([5.0, 5.0, 10.0])  # loads: force, force, force times length
    exact = np.diag([0.5, 0.5, 1.0]) @ turn @ np.diag([1 / 20, 1 / 30, 1 / 8]) @ turn.T @ units
    np.testing.assert_allclose(framed.matrix, exact, atol=EXACT)
    np.testing.assert_allclose(framed.root @ framed.root.T, exact, atol=EXACT)


BETWEEN = ((0, 1), (1, 2), (0, 2))


@given(st.lists(st.tuples(positive, st.floats(-1, 1)), min_size=18, max_size=18))
def test_in_space_the_flexibility_inverts_the_stiffness_along_all_axes(values):
    ends = [(k, axis) for axis in AXES_IN_SPACE for k in BETWEEN]
    springs = tuple(jw.Spring(k, c, r, axis) for (k, axis), (c, r) in zip(ends, values, strict=True))
    matrix, force = np.zeros((2, 6, 2, 6)), np.zeros((2, 6))
    for a, axis in enumerate(("x", "y", "z", "phi_x", "phi_y", "phi")):
        matrix[:, a, :, a], force[:, a] = stiffness_matrix([s for s in springs if s.axis == axis], 2)
    exact = np.linalg.inv(matrix.reshape(12, 12))
    flexibility = jw.Support(springs).flexibility_in_space()
    size = EXACT * float(np.max(np.abs(exact)))
    np.testing.assert_allclose(flexibility.matrix, exact, rtol=1e-9, atol=size)
    np.testing.assert_allclose(flexibility.offset, exact @ force.reshape(-1), atol=1e-9)
    np.testing.assert_allclose(flexibility.root @ flexibility.root.T, exact, rtol=1e-9, atol=size)


def test_in_space_bases_are_rigid_along_axes_without_springs_and_on_rigid_ones():
    springs = (
        jw.Spring((0, 1), 4.0, 0.1, "z"),
        jw.Spring((1, 2), jnp.inf, 0.2, "z"),
        jw.Spring((0, 1), compliance=0.0, axis="phi_y"),
        jw.Spring((1, 2), 5.0, 0.3, "phi_y"),
        jw.Spring((0, 2), 8.0, axis="phi"),
    )
    flexibility = jw.Support(springs).flexibility_in_space()
    exact, offset = np.zeros((2, 6, 2, 6)), np.zeros((2, 6))
    exact[:, 2, :, 2], offset[:, 2] = 1 / 4, (0.1, 0.3)
    exact[1, 4, 1, 4], offset[1, 4] = 1 / 5, 0.3
    exact[1, 5, 1, 5] = 1 / 8
    np.testing.assert_allclose(flexibility.matrix, exact.reshape(12, 12), atol=EXACT)
    np.testing.assert_allclose(flexibility.offset, offset.reshape(-1), atol=EXACT)
    assert flexibility.consistent
    loop = jw.Support.follicle(z=jnp.inf).springs
    unequal = jax.jit(lambda rest: jw.Support((*loop, jw.Spring((0, 1), jnp.inf, rest, "z"))).flexibility_in_space())
    assert unequal(0.0).consistent and not unequal(0.1).consistent


def test_in_space_supports_of_the_plane_keep_their_flexibility():
    support = jw.Support.follicle(x=20.0, y=30.0, phi=8.0)
    plane, space = support.flexibility(), support.flexibility_in_space()
    rows = np.array([0, 1, 5])
    np.testing.assert_array_equal(space.matrix[np.ix_(rows, rows)], plane.matrix)
    assert np.count_nonzero(space.matrix) == 3
    clamped = jw.Support(mount=(jw.Mount(), jw.Mount(0.2))).flexibility_in_space()
    assert clamped.matrix.shape == (12, 12) and not np.any(clamped.matrix) and not np.any(clamped.offset)
    assert np.isnan(jw.Support.fb(5.0).flexibility_in_space().offset[0])  # a scene sets the rest length


def test_in_space_units_scale_lengths_and_angles():
    springs = jw.Support.follicle(x=20.0, phi=8.0, z=40.0, phi_y=2.0).springs
    support = jw.Support((*springs, jw.Spring((0, 1), 10.0, 0.4, "y"), jw.Spring((0, 1), 10.0, 0.3, "phi_x")))
    scaled = support.flexibility_in_space().in_space(0.5, 3.0)
    # A force of 3 moves the base by 3 / c = 6 / c lengths of 0.5; a moment of 1.5 turns it by 1.5 / c.
    exact = np.diag([6 / 20, 6 / 10, 6 / 40, 1.5 / 10, 1.5 / 2, 1.5 / 8])
    np.testing.assert_allclose(scaled.matrix, exact, atol=EXACT)
    np.testing.assert_allclose(scaled.root @ scaled.root.T, exact, atol=EXACT)
    np.testing.assert_allclose(scaled.offset, [0.0, 0.8, 0.0, 0.3, 0.0, 0.0], atol=EXACT)


def test_in_space_the_flexibility_is_differentiable():
    def entry(stiffness, between):
        springs = jw.Support.follicle(z=stiffness).springs
        return jw.Support((*springs, jw.Spring((1, 2), between, axis="z"))).flexibility_in_space().matrix[8, 8]

    for grad in (jax.grad, jax.jacfwd):
        slopes = jax.jit(grad(entry, argnums=(0, 1)))(4.0, 5.0)
        np.testing.assert_allclose(slopes, [-1 / 4.0**2, -1 / 5.0**2], rtol=EXACT)
