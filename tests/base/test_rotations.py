"""Vectors and rotations with absent parts, against numpy and scipy's rotations."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxwhisker._base import rotations

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
    for operation in (rotations.cross, rotations.plus, rotations.dot):
        got, expected = operation(few, tuple(B)), operation(zeros, tuple(B))
        np.testing.assert_array_equal(np.atleast_1d(filled(np.atleast_1d(got))), np.atleast_1d(expected))
    for given, full in ((few_q, zeros_q), (rotations.small_rotation(few), rotations.small_rotation(zeros))):
        np.testing.assert_allclose(filled(rotations.product(given, tuple(P))), rotations.product(full, tuple(P)))
        np.testing.assert_allclose(filled(rotations.product(tuple(P), given)), rotations.product(tuple(P), full))


def test_vectors_as_in_numpy():
    np.testing.assert_allclose(rotations.cross(tuple(A), tuple(B)), np.cross(A, B), atol=ROUNDING)
    assert rotations.total(None, None) is None
    assert rotations.times(None, tuple(A)) == rotations.times(2.0, rotations.NONE) == rotations.NONE


def test_rotations_as_in_scipy():
    p, q = scipy_rotation(P), scipy_rotation(Q)
    matrix = np.array(rotations.matrix(tuple(Q)))
    np.testing.assert_allclose(matrix, q.as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(rotations.third_axis(tuple(Q)), matrix[:, 2], atol=ROUNDING)
    np.testing.assert_allclose(rotations.turned(tuple(Q), tuple(A)), q.apply(A), atol=ROUNDING)
    both = rotations.product(tuple(P), tuple(Q))
    np.testing.assert_allclose(rotations.matrix(both), (p * q).as_matrix(), atol=ROUNDING)
    back = rotations.product(both, rotations.inverse_rotation(tuple(Q)))
    np.testing.assert_allclose(back, P, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.1, 0.5])
def test_small_rotations_are_exact_and_smooth(angle):
    vector = angle * A / np.linalg.norm(A)
    got = scipy_rotation(rotations.small_rotation(tuple(vector))).as_matrix()
    np.testing.assert_allclose(got, Rotation.from_rotvec(vector).as_matrix(), atol=SMALL_ANGLE)
    slope = jax.jacfwd(lambda v: jnp.stack(rotations.small_rotation(tuple(v))))(jnp.asarray(vector))
    assert np.all(np.isfinite(slope))


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.5])
def test_changes_of_small_rotations_are_their_derivatives(angle):
    vector, change, about = angle * A / np.linalg.norm(A), P[1:], Q[1:]

    def turned(share):
        moving = rotations.small_rotation(tuple(jnp.asarray(vector) + share * about))
        return rotations.matrix(rotations.product(moving, rotations.small_rotation(tuple(share * change))))

    before, slope = jax.jvp(turned, (0.0,), (1.0,))
    spin = slope @ before.T
    expected = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    got = rotations.change_after(rotations.pivot(tuple(vector)), tuple(change), tuple(about))
    np.testing.assert_allclose(got, expected, atol=SMALL_ANGLE)
