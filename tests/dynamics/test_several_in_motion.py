"""Whiskers with several contacts in motion: slow sweeps against stored exact scans, events, energy, failures."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from several_cases import CASES, contacts_of, scene_of

SPEED, DAMPING = 0.05, 0.03
STEP = 0.006
SETTLES = 0.08  # way of the drive after an event of the scan on which whiskers may still vibrate
LATE = 0.02  # way before one: events come late by what the whisker lags behind
SIGNALS = 0.02  # of the peak: 12 shape functions, and a whisker that lags behind by its damping
PLACES = 1e-3  # lengths: of contacts, likewise
RESTS = 1e-3  # relative: forces at rest with 20 shape functions, energies
BALANCED = 1e-9  # of the ledger of energy
# Work of normal forces, relative to that of the drive: of order 2 in the step.
CREATED = {"two_circles": 4e-6, "groove": 4e-6, "box_curved": 1e-6}
DIFFERENCES = 1e-5  # relative
HEAVY = jw.Whisker(mass_per_length=1.0)


def moving(scene, contacts=None):
    whisker = eqx.tree_at(lambda w: w.mass_per_length, scene.whiskers[0], 1.0, is_leaf=lambda leaf: leaf is None)
    objects = scene.profile.objects
    profile = objects if len(objects) > 1 else objects[0]
    return jw.Scene(whisker, profile, scene.support, contacts=contacts or scene.contacts)


@cache
def swept(name):
    """A slow sweep with one sample per stored step."""
    control = np.array(CASES[name]["control"])
    duration, samples = (control[0] - control[-1]) / SPEED, control.size - 1
    every = int(np.ceil(duration / STEP / samples))
    ends, scene = control[[0, -1]], moving(scene_of(CASES[name]))
    return jw.simulate(scene, ends, duration, steps=every * samples, every=every, stiffness_damping=DAMPING)


def settled(name):
    """Stored steps at which a slow whisker is close to equilibrium."""
    control = np.array(CASES[name]["control"])
    events = np.array([event["control"] for event in CASES[name]["events"]])
    after = events[:, None] - control
    return np.flatnonzero(~np.any((after > -LATE) & (after < SETTLES), axis=0))


@pytest.mark.parametrize("name", CREATED)
def test_slow_sweeps_approach_scans(name):
    motion, case = swept(name), CASES[name]
    assert np.all(motion.status == jw.Status.ok)
    steps = settled(name)
    steps = steps[steps < np.flatnonzero(np.ravel(case["mz"]))[-1]]  # later, the whisker has come free, and vibrates
    assert max(len(case["contacts"][k]) for k in steps) == 2
    for k in steps:
        state = jax.tree.map(lambda leaf, k=k: leaf[k], jw.State(**{n: getattr(motion, n) for n in FIELDS}))
        ours, theirs = contacts_of(state, 0), [contact[2:] for contact in case["contacts"][k]]
        assert len(ours) == len(theirs), k
        for own, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(own[2:], other[2:], atol=PLACES)
    for field in ("fx", "fy", "mz"):
        ours, theirs = np.ravel(getattr(motion, field)), np.ravel(case[field])
        assert np.abs(ours - theirs)[steps].max() < SIGNALS * np.abs(theirs).max(), field


FIELDS = (
    *("base_x", "base_y", "base_angle", "fx", "fy", "mz", "contact_force"),
    *("contact_slope", "contact_arc", "contact_x", "contact_y", "phase"),
)


def test_fields_and_events_are_those_of_several_contacts():
    motion = swept("two_circles")
    samples = motion.time.size
    assert motion.mz.shape == motion.gap.shape == (samples, 1) and motion.phase.shape == (samples, 1, 2)
    touches = np.asarray(motion.phase) > 0
    assert np.all(touches[..., 0] | ~touches[..., 1])  # unused places are at the end
    both = touches.all(axis=-1)
    assert both.any() and np.all(motion.contact_arc[both][:, 0] > motion.contact_arc[both][:, 1])
    assert motion.contact_object is not None
    assert motion.contact_object[both].tolist() == [[1, 2]] * both.sum()
    for name in ("contact_force", "contact_slope", "contact_x", "contact_object"):
        assert np.all(np.asarray(getattr(motion, name))[~touches] == 0), name
    kinds = [(event.kind.name, event.contact) for event in motion.events if event.control > -1.0]
    first = [("touch", 1), ("touch", 2), ("tangential_to_tip", 1), ("release", 1)]
    assert [kind for k, kind in enumerate(kinds) if kind not in kinds[:k]] == first
    assert "touch of whisker 1 at contact 2" in str(motion)


@pytest.mark.parametrize("name", CREATED)
def test_energy_does_not_grow(name):
    energy = swept(name).energy
    spent = energy.work - energy.damping - energy.impact - energy.friction + energy.contact
    assert np.abs(energy.total - energy.total[0] - spent).max() < BALANCED * energy.work.max()
    assert energy.contact.max() < CREATED[name] * energy.work.max()


def test_derivatives_with_two_contacts():
    def signals(distance):
        objects = jw.Circle(0.5, 0.2), jw.Circle(distance, 0.12, position=-0.55)
        scene = jw.Scene(jw.Whisker(mass_per_length=1.0), objects, contacts=2)
        motion = jw.simulate(scene, np.array([0.22, -0.66]), 2.2, steps=550, every=50, stiffness_damping=0.05, shapes=5)
        return jnp.concatenate([motion.mz[:, 0], motion.contact_force[:, 0].ravel()])

    values, ours = jax.jvp(signals, (0.25,), (1.0,))
    assert values[-1] > 0  # the second contact
    differences = (signals(0.25 + 1e-6) - signals(0.25 - 1e-6)) / 2e-6
    np.testing.assert_allclose(ours, differences, atol=DIFFERENCES * np.abs(ours).max())


def test_more_contacts_than_there_is_room_for_end_the_motion():
    scene = moving(scene_of(CASES["three_circles"]), contacts=2)
    motion = jw.simulate(scene, np.array([0.2, -0.8]), 5.0, steps=1000, every=10, stiffness_damping=0.05, shapes=8)
    first = int(np.argmax(motion.status != jw.Status.ok))
    assert first > 0 and np.all(motion.status[first:] == jw.Status.too_many_contacts)
    assert np.all(motion.phase[first - 1, 0] > 0) and np.isnan(motion.mz[first:]).all()


def into_a_notch(whisker, friction=None):
    """A clamped whisker that rises into the inner corner of a notch."""
    notch = jw.Polygon([(-0.6, 1.3), (-0.4, 0.8), (0.0, 1.0), (0.4, 0.8), (0.6, 1.3), (0.0, 1.6)])
    rise = jw.Motion(lambda u: (0.1, u, 0.0), -0.1, 0.12)
    return jw.Scene(whisker, notch, contacts=2, friction=friction, motion=rise)


@pytest.mark.parametrize("friction", [None, 0.3], ids=["smooth", "rough"])
def test_a_tip_rests_in_an_inner_corner(friction):
    control = np.linspace(-0.1, 0.12, 12)
    motion = jw.simulate(into_a_notch(HEAVY, friction), control, 11.0, steps=2200, every=200, stiffness_damping=0.05)
    assert np.all(motion.status == jw.Status.ok)
    held = np.flatnonzero(control > 0.03)
    assert np.all(motion.phase[held, 0] == 1)
    np.testing.assert_allclose(motion.contact_x[held, 0], 0.0, atol=PLACES)
    np.testing.assert_allclose(motion.contact_y[held, 0], 1.0, atol=PLACES)
    result = jw.scan(into_a_notch(jw.Whisker(), friction), control)
    for field in ("fx", "fy", "mz"):
        ours, theirs = np.ravel(getattr(motion, field)), np.ravel(getattr(result, field))
        assert np.abs(ours - theirs)[held].max() < SIGNALS * np.abs(theirs).max(), field
    if friction is None:  # with friction, a scan shows one contact
        ours, theirs = np.asarray(motion.contact_force), np.asarray(result.contact_force)
        np.testing.assert_allclose(ours[held], theirs[held], atol=SIGNALS * np.abs(theirs[held]).max())
    else:
        assert motion.slip is not None and np.all(motion.slip[held] == 0)
        assert motion.friction_force is not None and np.all(motion.friction_force[held] == 0)


def test_whiskers_start_from_a_state_with_several_contacts():
    objects = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)

    def scene(distance=0.25):
        return jw.Scene(HEAVY, (objects[0], jw.Circle(distance, 0.12, position=-0.55)), contacts=2)

    result = jw.scan(scene(), np.array([0.3, -0.3, -0.66]))
    assert np.all(result.phase[-1] > 0)

    def rests(scene):
        options = {"steps": 400, "every": 40, "stiffness_damping": 0.1, "shapes": 20, "start": result}
        return jw.simulate(scene, -0.66, 0.8, **options)

    motion = rests(scene())
    assert np.all(motion.status == jw.Status.ok) and np.all(motion.phase == result.phase[-1])
    np.testing.assert_allclose(motion.contact_arc[0], result.contact_arc[-1], atol=PLACES)
    for field in ("fx", "fy", "mz"):
        ours, theirs = (np.ravel(getattr(of, field)) for of in (motion, result))
        np.testing.assert_allclose(ours[5:], theirs[-1], rtol=RESTS)
    stored = float(jw.stored_energy(scene(), result)[-1])
    np.testing.assert_allclose(motion.energy.total[0], stored, rtol=RESTS)
    free = jw.simulate(jw.Sensor(HEAVY), -0.66, 0.2, steps=200, every=20, start=result)
    np.testing.assert_allclose(free.energy.total, stored, rtol=RESTS)  # all of it becomes motion
    with pytest.raises(ValueError, match=r"`start` must be a state of these whiskers .*, got one that is off by"):
        rests(scene(0.3))
    alone = jw.scan(jw.Scene(HEAVY, objects[0]), np.array([0.3, -0.3]))
    with pytest.raises(ValueError, match="`start` must be a state with contacts=2, got one with contacts=1"):
        jw.simulate(scene(), -0.3, 0.8, start=alone, steps=400)
