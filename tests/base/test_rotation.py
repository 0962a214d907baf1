"""Rotations against scipy, identities, and derivatives at a rotation by zero and elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxwhisker._base.rotation import (
    about,
    cross_matrix,
    left_jacobian,
    matrix_of,
    quaternion_of,
    rotation_matrix,
    rotation_vector,
)

EXACT = 1e-14  # of rotations of order 1
LOGARITHM = 1e-12  # of angles near pi, where the scalar part of the quaternion vanishes
DIFFERENCES = 1e-7  # central differences with steps of 1e-4: the square of the step, times derivatives of order 1
AXIS = np.array([0.48, -0.6, 0.64])  # of length 1
ANGLES = (0.0, 1e-12, 1e-5, 0.3, 0.43, 0.46, 0.999, 1.001, 2.5, np.pi - 1e-6)
VECTORS = [angle * AXIS for angle in ANGLES]


@pytest.mark.parametrize("vector", VECTORS)
def test_matrices_are_those_of_scipy(vector):
    expected = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(rotation_matrix(jnp.asarray(vector)), expected.as_matrix(), atol=EXACT)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_vector_of_a_matrix_is_the_one_it_came_from(vector):
    matrix = jnp.asarray(Rotation.from_rotvec(vector).as_matrix())
    np.testing.assert_allclose(rotation_vector(matrix), vector, atol=LOGARITHM)


def test_quaternions_are_those_of_scipy_wherever_the_axis_points():
    rng = np.random.default_rng(0)
    turns = [Rotation.from_rotvec(rng.normal(size=3)) for _ in range(20)]
    # Half a turn about each axis: the scalar part vanishes.
    turns += [Rotation.from_rotvec(3.14 * axis) for axis in np.eye(3)]
    for turn in turns:
        quaternion = quaternion_of(jnp.asarray(turn.as_matrix()))
        assert quaternion[0] >= 0
        np.testing.assert_allclose(quaternion, turn.as_quat(canonical=True, scalar_first=True), atol=EXACT)
        for sign in (1, -1):
            np.testing.assert_allclose(matrix_of(sign * quaternion), turn.as_matrix(), atol=EXACT)


@pytest.mark.parametrize("axis", range(3))
def test_rotations_about_coordinate_axes(axis):
    expected = Rotation.from_rotvec(0.7 * np.eye(3)[axis]).as_matrix()
    np.testing.assert_allclose(about(axis, 0.7), expected, atol=EXACT)


def test_the_cross_matrix_multiplies_like_the_cross_product():
    first, second = np.array([0.3, -0.5, 0.9]), np.array([1.2, 0.4, -0.7])
    np.testing.assert_allclose(cross_matrix(jnp.asarray(first)) @ second, np.cross(first, second), atol=EXACT)


@pytest.mark.parametrize("vector", VECTORS[:-1])
def test_the_left_jacobian_turns_in_fixed_axes(vector):
    step, jacobian = 1e-4, left_jacobian(jnp.asarray(vector))
    for k, change in enumerate(step * np.eye(3)):
        after, before = Rotation.from_rotvec(vector + change), Rotation.from_rotvec(vector - change)
        turn = (after * before.inv()).as_rotvec() / (2 * step)
        np.testing.assert_allclose(jacobian[:, k], turn, atol=DIFFERENCES)


def test_the_left_jacobian_is_the_integral_of_the_rotation():
    nodes, weights = np.polynomial.legendre.leggauss(20)
    for vector in VECTORS:
        parts = [Rotation.from_rotvec((1 + node) / 2 * vector).as_matrix() for node in nodes]
        expected = np.tensordot(weights / 2, parts, 1)
        np.testing.assert_allclose(left_jacobian(jnp.asarray(vector)), expected, atol=EXACT)


def there_and_back(vector):
    return rotation_vector(rotation_matrix(vector))


# One program for all vectors.
JACOBIANS = [jax.jit(jacobian(there_and_back)) for jacobian in (jax.jacfwd, jax.jacrev)]
HESSIANS = [jax.jit(jax.jacfwd(jacobian)) for jacobian in JACOBIANS]


@pytest.mark.parametrize("vector", VECTORS[:-1])
def test_first_and_second_derivatives_of_a_vector_through_its_matrix_and_back(vector):
    # The identity: its Jacobian is the unit matrix, and its second derivatives vanish.
    vector = jnp.asarray(vector)
    for jacobian, hessian in zip(JACOBIANS, HESSIANS, strict=True):
        np.testing.assert_allclose(jacobian(vector), np.eye(3), atol=LOGARITHM)
        np.testing.assert_allclose(hessian(vector), 0.0, atol=1e-10)


@pytest.mark.parametrize("function", (rotation_matrix, left_jacobian, lambda v: quaternion_of(rotation_matrix(v))))
def test_derivatives_in_both_modes(function):
    compiled = jax.jit(function)
    for vector in (VECTORS[0], VECTORS[3], VECTORS[8]):
        check_grads(compiled, (jnp.asarray(vector),), order=2, modes=("fwd", "rev"))


def test_second_derivatives_at_zero():
    # exp(v) = 1 + [v] + [v]^2 / 2 + ...
    second = jax.hessian(rotation_matrix)(jnp.zeros(3))
    crosses = [np.asarray(cross_matrix(jnp.asarray(axis))) for axis in np.eye(3)]
    expected = [[(p @ q + q @ p) / 2 for q in crosses] for p in crosses]
    np.testing.assert_allclose(np.moveaxis(second, (0, 1), (2, 3)), expected, atol=EXACT)


def test_batches_are_those_of_single_vectors():
    batch = jnp.asarray(VECTORS)
    together = jax.jit(jax.vmap(there_and_back))(batch)
    np.testing.assert_allclose(together, [there_and_back(vector) for vector in batch], atol=EXACT)
