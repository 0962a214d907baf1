"""Rotations in space as matrices: from and to rotation vectors and quaternions.

A rotation vector has the direction of the axis and the length of the angle (rad, right-handed). A quaternion has its
scalar part first and the length 1; `quaternions.py` computes with quaternions. All functions have derivatives of any
order where they are smooth, at a rotation by zero as well.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar

TERMS = 8  # of power series: exact to rounding for angles below 0.5 rad, with two derivatives
NEAR = 0.25  # square of the angle (rad) below which they are used
ARC_TERMS, ARC_NEAR = 10, 0.01  # the same for the arc tangent, and the square of its argument


def cross_matrix(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """The matrix whose product with another vector is the cross product `vector` x other."""
    x, y, z = (vector[..., k] for k in range(3))
    none = jnp.zeros_like(x)
    return jnp.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(*x.shape, 3, 3)


def about(axis: int, angle: Scalar) -> Float[Array, "3 3"]:
    """The rotation by an angle (rad) about a coordinate axis: 0 for x, 1 for y, 2 for z."""
    cos, sin = jnp.cos(jnp.asarray(angle, dtype=float)), jnp.sin(jnp.asarray(angle, dtype=float))
    second, third = (axis + 1) % 3, (axis + 2) % 3
    matrix = jnp.zeros((3, 3)).at[axis, axis].set(1.0).at[second, second].set(cos).at[third, third].set(cos)
    return matrix.at[third, second].set(sin).at[second, third].set(-sin)


def rotation_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The rotation of a rotation vector (rad)."""
    sinc, half, _ = _coefficients(vector)
    cos = 1 - jnp.sum(vector**2) * half
    return cos * jnp.eye(3) + sinc * cross_matrix(vector) + half * vector[:, None] * vector


def left_jacobian(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """J_l of a rotation vector v: a change dv turns the rotation of v by J_l dv, in fixed axes.

    exp(v + dv) = exp(J_l dv) exp(v) to first order. The Jacobian in the turned axes is its transpose.
    """
    sinc, half, sixth = _coefficients(vector)
    return sinc * jnp.eye(3) + half * cross_matrix(vector) + sixth * vector[:, None] * vector


def rotation_vector(matrix: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The rotation vector (rad) of a rotation: its length is at most pi, where it jumps to the opposite one."""
    w, *direction = quaternion_of(matrix)
    half = jnp.stack(direction)  # unit axis times the sine of half the angle
    size = jnp.sum(half**2)
    near = size < ARC_NEAR * w**2
    ratio = jnp.where(near, size, 0.0) / jnp.where(near, w, 1.0) ** 2
    arctangent = np.array([(-1) ** k / (2 * k + 1) for k in range(ARC_TERMS)])
    series = _power_series(ratio, arctangent) / jnp.where(near, w, 1.0)
    sine = jnp.sqrt(jnp.where(near, 1.0, size))
    return 2 * jnp.where(near, series, jnp.arctan2(sine, jnp.where(near, 1.0, w)) / sine) * half


def quaternion_of(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """The quaternion of a rotation, with a scalar part that is not negative."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    # Rows of 4 q q^T; the one with the largest diagonal element is never close to zero.
    rows = jnp.stack(
        [
            jnp.stack([1 + a + e + i, h - f, c - g, d - b]),
            jnp.stack([h - f, 1 + a - e - i, b + d, c + g]),
            jnp.stack([c - g, b + d, 1 - a + e - i, f + h]),
            jnp.stack([d - b, c + g, f + h, 1 - a - e + i]),
        ]
    )
    largest = jnp.argmax(jnp.diagonal(rows))
    row = rows[largest]
    return row / (jnp.where(row[0] < 0, -2.0, 2.0) * jnp.sqrt(row[largest]))


def matrix_of(quaternion: Float[Array, "4"] | tuple[Any, Any, Any, Any]) -> Float[Array, "*batch 3 3"]:
    """The rotation of a unit quaternion, whose four parts are numbers or equal arrays; both signs give the same."""
    w, *direction = map(jnp.asarray, quaternion)
    axis = jnp.stack(direction, axis=-1)
    straight, w = (part[..., None, None] for part in (w**2 - jnp.sum(axis**2, axis=-1), w))
    return straight * jnp.eye(3) + 2 * w * cross_matrix(axis) + 2 * axis[..., :, None] * axis[..., None, :]


def _coefficients(vector: Float[Array, "3"]) -> tuple[Scalar, Scalar, Scalar]:
    """sin(a) / a, (1 - cos a) / a^2 and (a - sin a) / a^3 of the angle a."""
    square = jnp.sum(vector**2)
    near = square < NEAR
    small, large = jnp.where(near, square, 0.0), jnp.where(near, 1.0, square)
    angle = jnp.sqrt(large)
    far = jnp.sin(angle) / angle, (1 - jnp.cos(angle)) / large, (angle - jnp.sin(angle)) / (large * angle)
    # All three at once: users wait for the operations to be compiled.
    each = [[(-1) ** k / math.factorial(2 * k + first) for first in (1, 2, 3)] for k in range(TERMS)]
    first, second, third = jnp.where(near, _power_series(small, np.array(each)), jnp.stack(far))
    return first, second, third


def _power_series(x: Scalar, coefficients: Float[np.ndarray, "terms *series"]) -> Any:
    total = jnp.asarray(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * x + coefficient
    return total
