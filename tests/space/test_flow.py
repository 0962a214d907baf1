"""What follows from a loss of stability: where contacts come to rest, and what that does to the energy."""

# pyright: reportAttributeAccessIssue=false

import numpy as np

import jaxwhisker as jw

EXACT = 1e-8  # states after a snap are solved for to 1e-10
RATE = 1e-3  # error of the trapezoidal rule for the work of the drive in steps of 0.004


def test_past_an_ellipsoid_the_whisker_comes_to_rest_on_the_mirror_image():
    """The ellipsoid is symmetric about its centre, and the whisker passes below it: x and z change their signs."""
    half_axes, heading = (1.2, 0.7, 0.5), (-0.9438583564, 0.0, -0.3303504247)
    drive = jw.LinearDrive(heading)
    result = jw.scan(jw.SpaceScene(jw.Whisker(), jw.Ellipsoid(half_axes, (0.0, 1.1, 0.0)), motion=drive), CONTROL)
    (snap,) = result.events.of(jw.EventKind.snap_through)
    there = jw.scan(result.scene, np.array([-1.2, -snap.control]))  # before the loss, as far from the centre
    after = snap.after
    np.testing.assert_allclose(after.contact_force, there.contact_force[-1], atol=EXACT)
    np.testing.assert_allclose([after.fx, after.fz], [-there.fx[-1], -there.fz[-1]], atol=EXACT)
    np.testing.assert_allclose(after.fy, there.fy[-1], atol=EXACT)


def test_a_snap_takes_energy_from_the_whisker():
    drive = jw.LinearDrive((-0.9438583564, 0.0, -0.3303504247))
    scene = jw.SpaceScene(jw.Whisker(), jw.Ellipsoid((1.2, 0.7, 0.5), (0.0, 1.1, 0.0)), motion=drive)
    result = jw.scan(scene, CONTROL)
    (snap,) = result.events.of(jw.EventKind.snap_through)
    direction = np.array([-0.9438583564, 0.0, -0.3303504247])
    force = np.asarray(result.force)[:, 0] @ direction  # of the drive
    before = np.asarray(result.control) < snap.control
    at = np.append(result.control[before], snap.control)
    stored = np.trapezoid(np.append(force[before], np.asarray(snap.before.force)[0] @ direction), at)
    at = np.append(snap.control, result.control[~before])
    given_back = -np.trapezoid(np.append(np.asarray(snap.after.force)[0] @ direction, force[~before]), at)
    assert 0 < given_back < stored - RATE
    assert int(result.phase[-1, 0]) == jw.Phase.free  # all of the energy after the snap is given back


CONTROL = np.linspace(-1.2, 1.2, 601)
