"""The nearest state of families whose least squares have closed forms, with and without conditions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._inverse.nearest import PhaseCandidate, WhiskerState, nearest_state, rotated

EXACT = 1e-12
MATRIX = np.array([[1.0, 0.5], [0.2, 1.0], [-0.3, 0.4]])
WEIGHT = np.array([1.0, 2.0, 0.5])
START = np.array([1.0, 0.5])
CONTACT = np.arange(8.0).reshape(4, 2)
CONDITION = np.array([[1.0, 2.0]])  # which must be 1.5


class Linear(NamedTuple):
    """Reactions are linear in y. Tangential contact has the matrix from bottom to top."""

    reaction: Float[Array, "3"]
    weight: Float[Array, "3"]
    bound: Float[Array, "1"]

    phases = PhaseCandidate(np.array([True, False]), np.zeros(2))
    conditions = 0
    steps = 7
    handicaps = np.zeros(2)
    failed = START

    def state(self, y, phase):
        matrix = jnp.where(phase.tip, MATRIX, MATRIX[::-1])
        bound = CONDITION @ y - self.bound
        return WhiskerState(matrix @ y, bound[: self.conditions], CONTACT @ y)

    def guesses(self):
        return jnp.stack([START, START])

    def limits(self, phase):
        return 0.0, 3.0

    def scale(self, y):
        return 1 + jnp.abs(y[:1])


class Bound(Linear):
    """The same with a condition."""

    conditions = 1
    failed = np.append(START, 0.0)


def nearest(reaction, family=Linear):
    return jax.jit(lambda reaction: nearest_state(family(reaction, jnp.asarray(WEIGHT), jnp.full(1, 1.5))))(
        jnp.asarray(reaction)
    )


def least_squares(matrix, reaction):
    return np.linalg.lstsq(matrix * WEIGHT[:, None], reaction * WEIGHT, rcond=None)


def test_the_nearer_phase_is_weighed_against_the_other():
    reaction = MATRIX @ [1.4, 0.8] + [0.1, -0.2, 0.3]
    (y, tip, *_), (other, tangential, *_) = (least_squares(matrix, reaction) for matrix in (MATRIX, MATRIX[::-1]))
    found = nearest(reaction)
    assert found.ok and found.phase.tip and not found.other_phase.tip and tip[0] < tangential[0]
    np.testing.assert_allclose(found.y, y, rtol=EXACT)
    np.testing.assert_allclose(found.other, other, rtol=EXACT)
    np.testing.assert_allclose(found.chi2, tip[0], rtol=EXACT)
    np.testing.assert_allclose(found.doubt, 1 / (1 + np.exp((tangential[0] - tip[0]) / 2)), rtol=EXACT)
    apart = CONTACT @ (other - y)
    observed = Linear(jnp.asarray(reaction), jnp.asarray(WEIGHT), jnp.zeros(1))
    ambiguity = found.ambiguity(observed, jnp.asarray(CONTACT @ y))
    np.testing.assert_allclose(ambiguity, float(found.doubt) * np.outer(apart, apart), rtol=1e-9)


def test_errors_follow_from_the_normal_equations():
    found = nearest(MATRIX @ [1.4, 0.8])
    whitened = MATRIX * WEIGHT[:, None]
    np.testing.assert_allclose(found.follows(-jnp.eye(3)), np.linalg.pinv(whitened), atol=EXACT)


def test_beyond_stays_at_its_bound_and_the_force_is_free():
    reaction = MATRIX @ [1.4, -0.05]
    found = nearest(reaction)
    one = least_squares(MATRIX[:, :1], reaction)[0][0]
    assert found.phase.tip
    np.testing.assert_allclose(found.y, [one, 0.0], atol=EXACT)
    by = jax.jacfwd(lambda reaction: nearest(reaction).y)(jnp.asarray(reaction))
    pull = MATRIX[:, 0] * WEIGHT**2
    np.testing.assert_allclose(by, [pull / (pull @ MATRIX[:, 0]), np.zeros(3)], atol=EXACT)


def test_conditions_hold_and_bind_the_errors():
    reaction = MATRIX @ [0.7, 0.3] + [0.1, -0.2, 0.3]
    found = nearest(reaction, Bound)
    # With the condition, one unknown t remains: y = (1.5 - 2 t, t).
    direction, start = np.array([-2.0, 1.0]), np.array([1.5, 0.0])
    (t,), *_ = least_squares(MATRIX @ direction[:, None], reaction - MATRIX @ start)
    assert found.ok and found.phase.tip
    np.testing.assert_allclose(found.y, start + t * direction, rtol=EXACT)
    along = (MATRIX * WEIGHT[:, None]) @ direction
    np.testing.assert_allclose(found.follows(-jnp.eye(3)), np.outer(direction, along) / (along @ along), atol=EXACT)


def test_derivatives_are_those_of_the_normal_equations():
    reaction = jnp.asarray(MATRIX @ [1.4, 0.8])
    by = jax.jacfwd(lambda reaction: nearest_state(Linear(reaction, jnp.asarray(WEIGHT), jnp.zeros(1))).y)(reaction)
    np.testing.assert_allclose(by, np.linalg.pinv(MATRIX * WEIGHT[:, None]) * WEIGHT, atol=EXACT)


def test_vectors_turn_counter_clockwise():
    np.testing.assert_allclose(rotated(jnp.array([1.0, 0.0, 5.0]), np.pi / 2), [0.0, 1.0, 5.0], atol=EXACT)
    cos, sin = np.cos(0.7), np.sin(0.7)
    turned = [0.3 * cos - 0.4 * sin, 0.3 * sin + 0.4 * cos, 5.0]
    np.testing.assert_allclose(rotated(jnp.array([[0.3, 0.4, 5.0]]), 0.7), [turned], atol=EXACT)
