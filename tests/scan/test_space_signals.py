"""Signals in space: events agree with the states of a scan at their controls; reactions balance the contact force."""

import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-8  # events are solved for to 1e-10
CENTRE = np.array([0.0, 1.3, 0.2])


@pytest.fixture(scope="module")
def result():
    """A scan of a clamped whisker past a sphere."""
    scene = jw.Scene(jw.Whisker(), jw.Sphere(1.0, tuple(map(float, CENTRE))), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))
    return jw.scan(scene, np.linspace(-1.2, 1.2, 49))


def test_a_touch_and_a_release_have_no_force_and_opposite_places(result):
    first, *_, last = result.events
    assert (first.kind, last.kind) == (jw.EventKind.touch, jw.EventKind.release)
    for event in (first, last):
        np.testing.assert_allclose([*event.before.force[0], *event.after.force[0]], 0.0, atol=EXACT)
    assert first.control == pytest.approx(-last.control, abs=EXACT)
    # The tip of the unloaded whisker is on the sphere.
    assert np.hypot(np.hypot(first.control, 0.2), 0.3) == pytest.approx(1.0, abs=EXACT)


def test_the_state_of_a_change_of_phase_is_that_of_a_scan_that_stops_there(result):
    event = result.events.of(jw.EventKind.tip_to_tangential)[0]
    there = jw.scan(result.scene, np.array([-1.2, event.control]))
    for name in ("force", "moment", "contact_force"):
        np.testing.assert_allclose(np.asarray(getattr(there, name))[1], getattr(event.state, name), atol=EXACT)
    assert float(event.state.contact_arc[0]) == pytest.approx(1.0, abs=EXACT)


def test_reactions_balance_the_contact_force_at_the_contact(result):
    point = np.stack([result.contact_x, result.contact_y, result.contact_z], axis=-1)
    base = np.stack([result.base_x, result.base_y, result.base_z], axis=-1)
    touching = np.asarray(result.phase) > 0
    out = (point - CENTRE)[touching]
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1.0, atol=EXACT)
    push = np.asarray(result.contact_force)[touching][:, None] * out
    np.testing.assert_allclose(np.asarray(result.force)[touching], -push, atol=EXACT)
    np.testing.assert_allclose(
        np.asarray(result.moment)[touching], -np.cross((point - base)[touching], push), atol=EXACT
    )
    assert np.all(np.asarray(result.force)[~touching] == 0)
