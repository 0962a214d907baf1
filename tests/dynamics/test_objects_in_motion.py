"""Moving whiskers and objects with edges or a back: sweeps, second contacts, derivatives."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

ROD = jw.Whisker(mass_per_length=1.0)
START, STOP, SPEED, STEPS = 0.5, -1.5, 0.05, 4000
# They have as many corners, so that they share a program.
STEEP = np.array([(-0.42, 0.8), (-0.4, 0.3), (0.0, 0.28), (0.4, 0.3), (0.42, 0.8)])
SLANTED = np.array([(-0.3, 0.5), (-0.2, 0.25), (0.0, 0.2), (0.2, 0.25), (0.35, 0.5)])
LOW = np.array([(-0.474, 0.234), (-0.31, 0.166), (-0.075, 0.16), (0.068, 0.172), (0.474, 0.321)])
SIGNALS = 0.015  # rms difference from the scan up to the first snap, relative to the peak: bouncing after the touch
LATE = 0.02  # length: delay of the loss of contact
BALANCED = 1e-9
INSIDE = 0.01  # length: penetration by a second contact that ends a simulation
CREATED = 0.05  # relative work of contacts at which a simulation ends
PUSHED_OUT = 0.02  # relative work on what is inside when contacts change places; depths are about 1e-3 lengths
DIFFERENCES = 1e-5


def sweep(profile, stiffness=70.0):
    scene = jw.Scene(ROD, profile, jw.Support.fb(stiffness))
    motion = jw.simulate(
        scene, np.array([START, STOP]), (START - STOP) / SPEED, steps=STEPS, every=10, stiffness_damping=0.02
    )
    e = motion.energy
    return motion, e.total - (e.total[0] + e.work - e.damping - e.impact - e.friction + e.contact)


@pytest.mark.parametrize(
    ("profile", "until"),
    [
        (jw.Polygon(STEEP), -1.35),
        (jw.Polygon(SLANTED), -0.3),  # then the shaft almost snaps onto a face, and vibrates
        (jw.Cut(jw.Parabola(0.2), -0.3, 0.5), -1.22),
        (jw.Circle(0.2, 0.05), -0.52),  # a pole, beyond whose widest point the whisker reaches
    ],
)
def test_slow_sweeps_approach_scans(profile, until):
    motion, unbalanced = sweep(profile)
    assert np.all(motion.status == jw.Status.ok)
    assert np.abs(unbalanced).max() < BALANCED
    scan = jw.scan(jw.Scene(jw.Whisker(), profile, jw.Support.fb(70.0)), np.asarray(motion.control))
    before = (motion.control < scan.events[0].control - 0.1) & (motion.control > until)
    for name in ("fx", "fy", "mz"):
        ours, theirs = (np.asarray(getattr(r, name))[:, 0] for r in (motion, scan))
        assert np.sqrt(np.mean((ours - theirs)[before] ** 2)) < SIGNALS * np.abs(theirs).max(), name
    (snap,) = scan.events.of(jw.EventKind.snap_off)
    assert 0 < snap.control - motion.events.of(jw.EventKind.release)[-1].control < LATE
    assert motion.gap.min() > -INSIDE


def test_a_second_contact_ends_the_simulation():
    """The whisker snaps onto the lower side and lies on two edges."""
    motion, _ = sweep(jw.Polygon(LOW), 124.0)
    first = int(np.argmax(motion.status != jw.Status.ok))
    assert first > 0
    np.testing.assert_array_equal(motion.status[first:], jw.Status.second_contact)
    assert motion.gap[:first].min() > -INSIDE
    assert np.isnan(motion.mz[first:]).all() and np.isfinite(motion.mz[:first]).all()
    assert np.isfinite(motion.time).all() and "second_contact" in str(motion)
    assert max(e.time for e in motion.events) < motion.time[first]


def test_a_shaft_inside_the_object_ends_the_simulation():
    """The free end of a whisker that is curved more than the circle stays in contact, and its shaft gets inside."""
    whisker, circle = jw.Whisker(mass_per_length=1.0, intrinsic_curvature=1.1), jw.Circle(0.3, 1.0)
    scene, drive = jw.Scene(whisker, circle, jw.Support.fb(70.0)), np.array([1.3, -0.7])
    motion = jw.simulate(scene, drive, 10.0, steps=600, stiffness_damping=0.05, shapes=6)
    line = motion.shapes(200)
    depth = 1.0 - np.hypot(line.x, line.y - 1.3).min(axis=(1, 2))
    good = np.asarray(motion.status == jw.Status.ok)
    first = int(np.argmin(good))
    np.testing.assert_array_equal(motion.status[first:], jw.Status.second_contact)
    assert 0.9 * INSIDE < depth[first - 1] < INSIDE
    assert np.nanmax(depth) < INSIDE and np.abs(motion.gap[first - 1]) < BALANCED  # the contact is not inside
    assert motion.phase[first - 1, 0] == jw.Phase.tip


def past_a_block(block, stop, speed):
    """A sweep in which a shaft hits a straight flank between two corners at once."""
    half, low, high = block
    corners = np.array([(-half, high), (-half, low), (0.0, low - 1e-3), (half, low), (half, high)])
    scene, start = jw.Scene(ROD, jw.Polygon(corners), jw.Support.fb(70.0)), half + 0.05
    drive, duration = np.array([start, stop]), (start - stop) / speed
    return jw.simulate(scene, drive, duration, steps=STEPS, every=10, stiffness_damping=0.05)


@pytest.mark.parametrize(("block", "speed"), [((0.2887, 0.2683, 0.6208), 0.1), ((0.25, 0.67, 0.78), 0.2)])
def test_contacts_that_change_places_on_a_flank_create_no_energy(block, speed):
    motion = past_a_block(block, -1.35, speed)
    assert np.all(motion.status == jw.Status.ok)
    e = motion.energy
    assert np.all(np.abs(e.contact) < PUSHED_OUT * np.max(e.work))
    assert np.min(np.diff(e.impact)) > -PUSHED_OUT * np.max(e.work)


@pytest.mark.parametrize("stop", [-1.2, -1.35, -2.0])
def test_contacts_that_create_energy_end_the_simulation(stop):
    """A fast whisker hits a flank with its shaft, and slips off the corners."""
    motion = past_a_block((0.2887, 0.2683, 0.6208), stop, 2.5)
    e, good = motion.energy, np.asarray(motion.status == jw.Status.ok)
    most = e.total[0] + np.maximum.accumulate(np.abs(e.work))
    assert np.all(e.total[good] < (1 + CREATED) * most[good] + 1e-3)
    assert np.all(np.abs(e.contact[good]) < CREATED * most[good] + 1e-3)
    assert motion.status[-1] in (jw.Status.inexact, jw.Status.second_contact)


def past_two(distance, position):
    """The scan and a slow sweep past two circles."""
    scene = jw.Scene(ROD, (jw.Circle(0.3, 0.15), jw.Circle(distance, 0.15, position)), jw.Support.fb(70.0))
    drive = np.array([0.2, -2.3])
    motion = jw.simulate(scene, drive, 2.5 / SPEED, steps=STEPS, every=10, stiffness_damping=0.05)
    return jw.scan(scene, np.asarray(motion.control)), motion


def test_several_objects():
    scan, motion = past_two(0.4, -1.2)
    assert np.all(motion.status == jw.Status.ok)
    assert motion.contact_object is not None
    first, second = (e.control for e in scan.events.of(jw.EventKind.snap_off))
    touch = scan.events.of(jw.EventKind.touch)
    for start, stop, number in ((touch[0].control, first, 1), (touch[1].control, second, 2)):
        during = (motion.control < start - 0.1) & (motion.control > stop + 0.02)
        np.testing.assert_array_equal(motion.contact_object[during], number)
        for name in ("fx", "fy", "mz"):
            ours, theirs = (np.asarray(getattr(r, name))[:, 0] for r in (motion, scan))
            assert np.sqrt(np.mean((ours - theirs)[during] ** 2)) < SIGNALS * np.abs(theirs).max(), name
    assert np.all(motion.contact_object[motion.phase == jw.Phase.free] == 0)
    assert 0 < second - motion.events.of(jw.EventKind.release)[-1].control < 2 * LATE


def test_a_second_object_ends_the_simulation():
    scan, motion = past_two(0.3, -0.5)
    ours, theirs = (float(r.control[np.argmax(r.status == jw.Status.second_contact)]) for r in (motion, scan))
    assert -1.0 < ours < -0.8 and theirs - 0.04 < ours <= theirs  # 0.01 inside


def measured(p):
    """Signals of a whisker that slides over an edge onto a face, as a function of this edge and of the stiffness."""
    corners = jnp.asarray(SLANTED).at[3].set(p[:2])
    scene = jw.Scene(ROD, jw.Polygon(corners), jw.Support.fb(p[2]))
    motion = jw.simulate(scene, np.array([0.1713, -0.4]), 2.5, steps=100, stiffness_damping=0.05, shapes=5)
    return jnp.stack([motion.mz[-1, 0], motion.fy[-1, 0], motion.contact_arc[-1, 0], motion.contact_slope[-1, 0]])


def test_derivatives_by_an_edge():
    at = np.array([0.2, 0.25, 70.0])
    forward = jax.jacfwd(measured)(at)
    for k, size in enumerate((1e-6, 1e-6, 1e-4)):
        change = size * np.eye(3)[k]
        difference = (measured(at + change) - measured(at - change)) / (2 * size)
        np.testing.assert_allclose(forward[:, k], difference, rtol=DIFFERENCES, atol=DIFFERENCES)
    np.testing.assert_allclose(jax.grad(lambda p: measured(p)[0])(at), forward[0], rtol=1e-8, atol=1e-10)
    assert np.all(np.abs(forward[0]) > 1e-4)
