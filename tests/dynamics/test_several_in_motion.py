"""Whiskers with several contacts in motion: slow sweeps against stored exact scans, events, energy, failures."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from several import wavy
from several_cases import CASES, contacts_of, scene_of

SPEED, DAMPING = 0.05, 0.03
STEP = 0.006
SETTLES = 0.08  # way of the drive after an event of the scan on which whiskers may still vibrate
LATE = 0.02  # way before one: events come late by what the whisker lags behind
SIGNALS = 0.02  # of the peak: 12 shape functions, and a whisker that lags behind by its damping
PLACES = 1e-3  # lengths: of contacts, likewise
BALANCED = 1e-9  # of the ledger of energy
# Work of normal forces, relative to that of the drive: of order 2 in the step. A tip that slips off a corner lands
# inside, and is pushed out.
CREATED = {"two_circles": 4e-6, "groove": 4e-6, "box_curved": 1e-3}
DIFFERENCES = 1e-5  # relative


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


@pytest.mark.parametrize(
    ("profile", "options", "message"),
    [
        (jw.Polygon([(-0.5, 0.5), (0.0, 0.8), (0.5, 0.5), (0.0, 1.4)]), {}, "`profile` must be without inner corners"),
        (jw.Graph(wavy), {"start": "given"}, "`start` must be None for whiskers that may have several contacts"),
    ],
)
def test_what_is_not_simulated_says_so(profile, options, message):
    scene = jw.Scene(jw.Whisker(mass_per_length=1.0), profile, contacts=2)
    with pytest.raises(ValueError, match=message):
        jw.simulate(scene, 2.0, 1.0, **options)


def test_friction_of_several_contacts_is_not_simulated():
    scene = jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Graph(wavy), contacts=2, friction=0.3)
    with pytest.raises(ValueError, match="`scene` must be without friction for whiskers"):
        jw.simulate(scene, 2.0, 1.0)
