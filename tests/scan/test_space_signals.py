"""Signals in space: balance of forces and moments at the base, and what derivatives are known at a loss."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
EXACT = 1e-10  # of balances, for forces of about 5
STEPS = np.linspace(-1.2, 1.2, 25)
DIFFERENCES = 1e-6  # of central differences with steps of 1e-5


@pytest.fixture(scope="module")
def result():
    return jw.scan(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=ALONG), STEPS)


def test_the_reaction_balances_the_contact_force(result):
    contact = np.stack([result.contact_x, result.contact_y, result.contact_z], axis=-1)[:, 0]
    base = np.stack([result.base_x, result.base_y, result.base_z], axis=-1)[:, 0]
    touching = np.asarray(result.phase)[:, 0] != jw.Phase.free
    force, moment = np.asarray(result.force)[:, 0], np.asarray(result.moment)[:, 0]
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), np.asarray(result.contact_force)[:, 0], atol=EXACT)
    # The object pushes with -force at the contact; its normal points away from the centre.
    outwards = (contact - [0.0, 1.3, 0.2])[touching]
    np.testing.assert_allclose(np.cross(outwards, force[touching]), 0.0, atol=EXACT)
    np.testing.assert_allclose(moment[touching], np.cross(contact - base, force)[touching], atol=EXACT)


def test_in_the_frame_of_the_whisker_a_straight_one_has_no_twisting_moment(result):
    np.testing.assert_allclose(np.asarray(result.own_moment)[..., 2], 0.0, atol=EXACT)
    np.testing.assert_allclose(
        np.sum(np.asarray(result.own_force) ** 2, axis=-1), np.sum(np.asarray(result.force) ** 2, axis=-1), atol=EXACT
    )


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
