"""Equilibria in space at events: they agree with states at their controls; derivatives of a snap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-8  # events are solved for to 1e-10
DIFFERENCES = 1e-6  # of central differences with steps of 1e-5
CENTRE = 0.0, 1.3, 0.2


@pytest.fixture(scope="module")
def result():
    """A scan of a clamped whisker past a sphere."""
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, CENTRE), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))
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


def past_ellipsoid(size):
    """Drive positions of all events, and the force before and after the snap."""
    ellipsoid = jw.Ellipsoid((1.1 * size, 0.8, 0.6), (0.0, 1.1, 0.0)).rotated((0.3, 0.2, -0.4))
    scene = jw.SpaceScene(jw.Whisker(), ellipsoid, motion=jw.LinearDrive((-0.944, 0.0, -0.33)))
    found = jw.scan(scene, np.linspace(-1.0, 1.0, 11)).events
    return found.control[:5], found.before.contact_force[2], found.after.contact_force[2]


def test_a_snap_has_the_derivatives_of_its_position_and_of_what_follows():
    one, step = jnp.asarray(1.0), 1e-5
    ends = [past_ellipsoid(one + sign * step) for sign in (1, -1)]
    control, before, after = jax.jacfwd(past_ellipsoid)(one)
    np.testing.assert_allclose(control, (ends[0][0] - ends[1][0]) / (2 * step), atol=DIFFERENCES)
    np.testing.assert_allclose(after, (ends[0][2] - ends[1][2]) / (2 * step), rtol=DIFFERENCES, atol=10 * DIFFERENCES)
    assert jnp.isnan(before)  # rather than a wrong number
    backwards = jax.jacrev(lambda size: past_ellipsoid(size)[0])(one)
    np.testing.assert_allclose(backwards, control, atol=1e-9)
