"""Decisions of the march: kinds of events."""

import jax.numpy as jnp
import pytest

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.march_state import Target
from jaxwhisker._path.path import AT_STOP, PHASE, RELEASE, STOP, TOUCH, VERTEX, EventKind
from jaxwhisker._path.transitions import _event_kind


@pytest.mark.parametrize(
    ("kind", "phase", "expected"),
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
def test_kinds_of_events(kind, phase, expected):
    # The other whisker, in the other phase, has no say.
    other = Phase.tangential if phase == Phase.tip else Phase.tip
    phases = jnp.array([int(other), int(phase)])
    whisker = jnp.array([False, kind != AT_STOP])
    none = jnp.zeros((2, 3))
    target = Target(jnp.asarray(kind), whisker, jnp.asarray(0.0), none, phases, jnp.ones(2))
    assert _event_kind(target, phases) == expected
