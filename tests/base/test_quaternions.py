"""Vectors and quaternions with absent parts, against numpy and scipy's rotations."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxwhisker._base import quaternions
from jaxwhisker._base.rotation import matrix_of

ROUNDING = 1e-15
SMALL_ANGLE = 1e-14  # documented error of small rotations, whose changes are as accurate
A, B = np.array([0.3, -0.7, 1.1]), np.array([-0.4, 0.5, 0.2])
P, Q = np.array([0.5, 0.1, -0.7, 0.5]), np.array([0.1, 0.7, 0.1, -0.7])
ABSENT = [(), (0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)]


def without(a, parts):
    """A tuple whose absent parts are None, and the same with zeros."""
    return tuple(None if i in parts else x for i, x in enumerate(a)), tuple(
        0.0 if i in parts else x for i, x in enumerate(a)
    )


def filled(a):
    return np.array([0.0 if x is None else x for x in a])


def scipy_rotation(q):
    w, x, y, z = q
    return Rotation.from_quat([x, y, z, w])


@pytest.mark.parametrize("parts", ABSENT)
def test_absent_parts_are_zeros(parts):
    (few, zeros), (few_q, zeros_q) = without(A, parts), without(Q, parts)
    for operation in (quaternions.cross, quaternions.plus, quaternions.dot):
        got, expected = operation(few, tuple(B)), operation(zeros, tuple(B))
        np.testing.assert_array_equal(np.atleast_1d(filled(np.atleast_1d(got))), np.atleast_1d(expected))
    for given, full in ((few_q, zeros_q), (quaternions.small_rotation(few), quaternions.small_rotation(zeros))):
        np.testing.assert_allclose(filled(quaternions.product(given, tuple(P))), quaternions.product(full, tuple(P)))
        np.testing.assert_allclose(filled(quaternions.product(tuple(P), given)), quaternions.product(tuple(P), full))


def test_vectors_as_in_numpy():
    np.testing.assert_allclose(quaternions.cross(tuple(A), tuple(B)), np.cross(A, B), atol=ROUNDING)
    assert quaternions.total(None, None) is None
    assert quaternions.times(None, tuple(A)) == quaternions.times(2.0, quaternions.NONE) == quaternions.NONE


def test_rotations_as_in_scipy():
    p, q = scipy_rotation(P), scipy_rotation(Q)
    matrix = np.array(matrix_of(tuple(Q)))
    np.testing.assert_allclose(matrix, q.as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(quaternions.third_axis(tuple(Q)), matrix[:, 2], atol=ROUNDING)
    np.testing.assert_allclose(quaternions.turned(tuple(Q), tuple(A)), q.apply(A), atol=ROUNDING)
    both = quaternions.product(tuple(P), tuple(Q))
    np.testing.assert_allclose(matrix_of(both), (p * q).as_matrix(), atol=ROUNDING)
    back = quaternions.product(both, quaternions.inverse_rotation(tuple(Q)))
    np.testing.assert_allclose(back, P, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.1, 0.5])
def test_small_rotations_are_exact_and_smooth(angle):
    vector = angle * A / np.linalg.norm(A)
    got = scipy_rotation(quaternions.small_rotation(tuple(vector))).as_matrix()
    np.testing.assert_allclose(got, Rotation.from_rotvec(vector).as_matrix(), atol=SMALL_ANGLE)
    slope = jax.jacfwd(lambda v: jnp.stack(quaternions.small_rotation(tuple(v))))(jnp.asarray(vector))
    assert np.all(np.isfinite(slope))


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.5])
def test_changes_of_small_rotations_are_their_derivatives(angle):
    vector, change, about = angle * A / np.linalg.norm(A), P[1:], Q[1:]

    def turned(share):
        moving = quaternions.small_rotation(tuple(jnp.asarray(vector) + share * about))
        return matrix_of(quaternions.product(moving, quaternions.small_rotation(tuple(share * change))))

    before, slope = jax.jvp(turned, (0.0,), (1.0,))
    spin = slope @ before.T
    expected = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    got = quaternions.change_after(quaternions.pivot(tuple(vector)), tuple(change), tuple(about))
    np.testing.assert_allclose(got, expected, atol=SMALL_ANGLE)
