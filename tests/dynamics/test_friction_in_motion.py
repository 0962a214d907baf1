"""Friction of whiskers with several contacts in motion: slow sweeps against stored scans, laws, energy, derivatives."""

# pyright: reportArgumentType=false, reportOptionalSubscript=false, reportOptionalMemberAccess=false
# pyright: reportOptionalOperand=false, reportCallIssue=false, reportGeneralTypeIssues=false

import json
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from several_cases import CASES, scene_of

SLIPPING = {
    c["name"]: c
    for c in json.loads((Path(__file__).parents[1] / "data" / "several_contacts_slipping.json").read_text())["cases"]
}
SPEED, DAMPING, STEP = 0.05, 0.03, 0.006
STRIDE = 0.04  # of the drive between two samples
SETTLES = 0.08  # way of the drive after an event on which whiskers may still vibrate
SIGNALS = 0.02  # of the peak: 12 shape functions, and a whisker that lags behind by its damping
EXACT = 1e-9  # relative: of the ledger of energy, and of the cone
SAME = 1e-8  # of the peak: the same steps with one contact and with two
CREATED = 1e-6  # work of normal forces, relative to that of the drive
DIFFERENCES = 1e-5  # relative
HEAVY = jw.Whisker(mass_per_length=1.0)


@cache
def swept(name):
    """A slow sweep with one sample per stored step."""
    case, scene = SLIPPING[name], scene_of(CASES[name])
    control = np.array(case["control"])
    duration, samples = (control[0] - control[-1]) / SPEED, control.size - 1
    every, objects = int(np.ceil(duration / STEP / samples)), scene.profile.objects
    whisker = eqx.tree_at(lambda w: w.mass_per_length, scene.whiskers[0], 1.0, is_leaf=lambda leaf: leaf is None)
    profile = objects if len(objects) > 1 else objects[0]
    scene = jw.Scene(whisker, profile, scene.support, contacts=2, friction=case["mu"])
    ends = control[[0, -1]]
    return jw.simulate(scene, ends, duration, steps=every * samples, every=every, stiffness_damping=DAMPING)


@pytest.mark.parametrize("name", ["two_circles", "groove"])
def test_slow_sweeps_approach_scans(name):
    motion, case = swept(name), SLIPPING[name]
    assert np.all(motion.status == jw.Status.ok)
    control = np.array(case["control"])
    events = np.array([u for _, u in case["events"]])
    after = events[:, None] - control
    steps = np.flatnonzero(~np.any((after > -SETTLES / 4) & (after < SETTLES), axis=0))
    counts = [sum(row[2] > 0 for row in case["contacts"][k]) for k in steps]
    assert max(counts) == 2
    for k, count in zip(steps, counts, strict=True):
        slips = np.asarray(motion.slip)[k, 0]
        assert np.sum(slips != 0) == count and np.all(slips[:count] == -1), k  # all slip towards the drive
    for field in ("fx", "fy", "mz"):
        ours, theirs = np.ravel(getattr(motion, field)), np.ravel(case[field])
        assert np.abs(ours - theirs)[steps].max() < SIGNALS * np.abs(theirs).max(), field


@pytest.mark.parametrize("name", ["two_circles", "groove"])
def test_forces_obey_the_law_of_friction_and_energy_does_not_grow(name):
    motion, mu = swept(name), SLIPPING[name]["mu"]
    normal, drag = motion.normal_force, motion.friction_force
    assert normal.shape == drag.shape == motion.slip.shape == (*motion.mz.shape, 2)
    assert np.all(normal >= 0) and np.all(np.abs(drag) <= mu * normal * (1 + EXACT))
    np.testing.assert_allclose(motion.contact_force, np.hypot(normal, drag), rtol=EXACT)
    e = motion.energy
    spent = e.work - e.damping - e.impact - e.friction + e.contact
    assert np.abs(e.total - e.total[0] - spent).max() < EXACT * e.work.max()
    assert np.all(np.diff(e.friction) >= 0) and e.friction[-1] > e.work.max() / 4
    assert e.contact.max() < CREATED * e.work.max()


def to_and_fro(whisker):
    """Two circles, both of which are touched where the drive turns."""
    objects = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)
    return jw.Scene(whisker, objects, contacts=2, friction=0.3)


def test_contacts_slip_back_and_stick_as_in_a_scan():
    legs = (0.29, -0.67), (-0.67, -0.47), (-0.47, -0.63)
    control = np.concatenate([[0.29], *(np.linspace(a, b, round(abs(b - a) / STRIDE) + 1)[1:] for a, b in legs)])
    result = jw.scan(to_and_fro(jw.Whisker()), control)
    samples, every = control.size - 1, int(STRIDE / SPEED / STEP)
    at = np.linspace(0, samples, every * samples + 1)
    drive, duration = np.interp(at, np.arange(samples + 1), control), samples * STRIDE / SPEED
    motion = jw.simulate(to_and_fro(HEAVY), drive, duration, steps=at.size - 1, every=every, stiffness_damping=DAMPING)
    ours, theirs = np.asarray(motion.slip)[:, 0], np.asarray(result.slip)[:, 0]
    turns = np.append(False, np.diff(np.sign(np.diff(control))) != 0)
    turns = np.append(turns, False)  # where all contacts of a scan stick
    np.testing.assert_array_equal(ours[~turns], theirs[~turns])
    assert {(-1, -1), (1, 1), (1, 0), (-1, 0)} <= set(map(tuple, ours.tolist()))


def test_one_contact_moves_as_in_a_scene_with_one_contact():
    def moved(contacts):
        scene = jw.Scene(HEAVY, jw.Circle(0.5, 0.2), friction=0.8, contacts=contacts)
        return jw.simulate(scene, DOWN_AND_UP, 4.0, steps=800, every=8, stiffness_damping=0.05, shapes=5)

    one, two = moved(1), moved(2)
    for field in ("fx", "fy", "mz"):
        ours, theirs = np.asarray(getattr(two, field)), np.asarray(getattr(one, field))
        np.testing.assert_allclose(ours, theirs, atol=SAME * np.abs(theirs).max())
    np.testing.assert_array_equal(two.slip[..., 0], one.slip)
    assert {-1, 0, 1} == set(np.asarray(one.slip)[one.phase > 0].tolist())


DOWN_AND_UP = 0.25 - 0.45 * np.sin(np.linspace(0.0, np.pi, 41))


def test_derivatives_in_both_modes():
    def signals(numbers):
        distance, friction = numbers
        objects = jw.Circle(0.5, 0.2), jw.Circle(distance, 0.12, position=-0.55)
        scene = jw.Scene(HEAVY, objects, contacts=2, friction=friction)
        motion = jw.simulate(scene, np.array([0.22, -0.66]), 2.2, steps=550, every=50, stiffness_damping=0.05, shapes=5)
        return jnp.concatenate([motion.mz[:, 0], motion.friction_force[:, 0].ravel()])

    at, way = jnp.array([0.25, 0.3]), jnp.array([1.0, 0.4])
    values, ours = jax.jvp(signals, (at,), (way,))
    assert values[-1] != 0  # friction at the second contact
    differences = (signals(at + 1e-6 * way) - signals(at - 1e-6 * way)) / 2e-6
    np.testing.assert_allclose(ours, differences, atol=DIFFERENCES * np.abs(ours).max())
    weights = jnp.asarray(np.random.default_rng(0).normal(size=ours.size))
    back = jax.grad(lambda numbers: weights @ signals(numbers))(at)
    np.testing.assert_allclose(back @ way, weights @ ours, rtol=EXACT)
