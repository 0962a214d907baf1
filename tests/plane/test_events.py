"""Kinds of events: their numbers, what results call them, and the conditions that they are solved for with."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import STOP, EventKind
from jaxwhisker._plane.events import (
    AT_STOP,
    PHASE,
    RELEASE,
    SMOOTH,
    TOUCH,
    VERTEX,
    Slip,
    condition_of,
    facts_of,
    number_of,
)


@pytest.mark.parametrize(
    ("number", "phase", "expected"),
    [
        (TOUCH, Phase.free, EventKind.touch),
        (RELEASE, Phase.tip, EventKind.release),
        (RELEASE, Phase.tangential, EventKind.release),
        (PHASE, Phase.tip, EventKind.tip_to_tangential),
        (PHASE, Phase.tangential, EventKind.tangential_to_tip),
        (VERTEX, Phase.tip, EventKind.vertex),
        (AT_STOP, Phase.tip, STOP),
    ],
)
def test_kinds_of_events(number, phase, expected):
    assert facts_of(SMOOTH, jnp.asarray(number), jnp.asarray(phase == Phase.tip)).kind == expected
    assert number_of(SMOOTH, jnp.asarray(int(expected))) == number


ROUNDING = 1e-14
Z = np.array([[3.0, 0.4, -0.2], [-0.5, -0.7, 0.3]])
U, SINES = 0.8, np.array([0.3, -0.9])
SECOND, LIMITS = np.array([False, True]), np.array([np.inf, 0.25])
LAW = (*SMOOTH, Slip())


@Program
def residual(number, limits):
    condition = condition_of(facts_of(LAW, number), jnp.asarray(SECOND), jnp.asarray(Z), limits, jnp.asarray(0.3))
    return condition.residual(Point(jnp.asarray(Z), jnp.asarray(U)), jnp.asarray(SINES))


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (TOUCH, Z[1, 0]),
        (RELEASE, Z[1, 0]),
        (PHASE, Z[1, 2]),
        (VERTEX, SINES[1]),
        (AT_STOP, U - 0.3),
        (len(SMOOTH), Z[1, 1] - 0.25),
    ],
)
def test_the_condition_of_an_event_is_its_margin(number, expected):
    # Of other whiskers, the limit may be infinite.
    limits = jnp.asarray(LIMITS if number == len(SMOOTH) else 0 * SINES)
    np.testing.assert_allclose(residual(jnp.asarray(number), limits), expected, atol=ROUNDING)
