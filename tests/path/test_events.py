"""Kinds of events: their numbers, and what results call them."""

import jax.numpy as jnp
import pytest

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.events import AT_STOP, PHASE, RELEASE, SMOOTH, TOUCH, VERTEX, facts_of, number_of
from jaxwhisker._path.path import STOP, EventKind


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
