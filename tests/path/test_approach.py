"""The part of a path right across an object on which whiskers touch it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.approach import MARGIN, crop
from jaxwhisker._path.continuation import Limits
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, Path, Status

ROUNDING = 1e-14
LIMITS = Limits(jnp.asarray(1.0), jnp.asarray(-1.0), jnp.asarray(-2.0))
CONTROL = [0.9, 0.5, 0.3, -0.4, -0.6]
TIPS = [False, False, True, True, False]  # between these nodes the whisker touches; it comes free by an event


def path(touches=TIPS, kinds=(NO_EVENT,) * 4 + (int(EventKind.release),), onwards=-1, count=5) -> Path:
    """A path with these nodes of one whisker, whose travel begins at the start of the limits."""
    u = -onwards * jnp.array(CONTROL)
    phase = jnp.where(jnp.array(touches), int(Phase.tip), int(Phase.free))[:, None]
    state, z = ContactState(phase, jnp.ones((5, 1))), jnp.zeros((5, 1, 3))
    at, travel, nobody = Point(z, u), jnp.abs(u - -onwards * LIMITS.start), jnp.zeros((5, 1), bool)
    nodes = Node(at, z, at, at, state, state, travel, jnp.array(kinds), nobody)
    return Path(nodes, jnp.asarray(count), jnp.asarray(int(Status.ok)))


def cropped(whole=True, onwards=-1, **changes):
    """The cropped path, and where it starts and ends, for a drive to smaller controls."""
    limits = Limits(*(-onwards * at for at in LIMITS[:3]))
    found, start, stop = crop(jnp.asarray(onwards), path(onwards=onwards, **changes), limits, jnp.asarray(whole))
    return found, -onwards * float(start), -onwards * float(stop)


@pytest.mark.parametrize("onwards", [-1, 1])
def test_it_reaches_from_the_first_contact_to_the_last_event(onwards):
    _, start, stop = cropped(onwards=onwards)
    np.testing.assert_allclose([start, stop], [0.3 + MARGIN, -0.6 - MARGIN], atol=ROUNDING)


def test_travel_is_measured_from_its_start_if_the_scan_runs_right_across():
    found, start, _ = cropped()
    np.testing.assert_allclose(found.nodes.travel, start - np.array(CONTROL), atol=ROUNDING)
    found, _, _ = cropped(whole=False)
    np.testing.assert_array_equal(found.nodes.travel, path().nodes.travel)


def test_nodes_that_are_not_filled_do_not_count():
    _, start, stop = cropped(count=3)
    np.testing.assert_allclose([start, stop], [0.3 + MARGIN, 0.3 - MARGIN], atol=ROUNDING)


def test_without_contacts_it_is_everything():
    _, start, stop = cropped(touches=[False] * 5, kinds=(NO_EVENT,) * 5)
    assert (start, stop) == (float(LIMITS.start), float(LIMITS.far))


def test_it_stays_within_the_limits():
    _, start, stop = cropped(touches=[True] * 5)
    np.testing.assert_allclose([start, stop], [0.9 + MARGIN, -0.6 - MARGIN], atol=ROUNDING)
    near = Limits(jnp.asarray(0.9 + MARGIN / 2), LIMITS.end, jnp.asarray(-0.6 - MARGIN / 2))
    _, start, stop = crop(jnp.asarray(-1), path(touches=[True] * 5), near, jnp.asarray(True))
    np.testing.assert_allclose([float(start), float(stop)], [float(near.start), float(near.far)], atol=ROUNDING)


def test_it_ends_where_a_path_without_a_contact_fails():
    free = path(touches=[False] * 5, kinds=(NO_EVENT,) * 5)
    failed = free._replace(status=jnp.asarray(int(Status.lost)))
    _, start, stop = crop(jnp.asarray(-1), failed, LIMITS, jnp.asarray(True))
    np.testing.assert_allclose([start, stop], [-0.6 + MARGIN, -0.6 - MARGIN], atol=ROUNDING)


def test_without_a_known_start_there_is_no_path_right_across():
    unknown = LIMITS._replace(known=jnp.asarray(False))
    found, start, stop = crop(jnp.asarray(-1), path(), unknown, jnp.asarray(True))
    assert np.isnan(start) and np.isnan(stop) and found.count == 0 and found.status == Status.lost
    # A given control may be followed nevertheless.
    found, start, _ = crop(jnp.asarray(-1), path(), unknown, jnp.asarray(False))
    assert np.isfinite(start) and found.count == 5 and found.status == Status.ok
