"""Random scenes with friction, checked by laws that share no code with the package (benchmarks/soak_friction.py)."""

from functools import cache

import equinox as eqx
import jax
import numpy as np
import pytest
from independent_friction import all_laws

import jaxwhisker as jw
from random_scenes import NETWORKS, PROFILES, mechanics, reversing, scans, scene_of

KIND = ("FB", "parabola")
SCENES = 24
SOUND = 1e-7  # largest relative residual of a law
REFUSED = 0.1  # largest share of scenes that end with a status; about 0.02 do


@cache
def scanned():
    p = reversing(*KIND, SCENES, np.random.default_rng(1))
    # As numbers, because tests replace some of them.
    return p, jax.tree.map(np.asarray, jax.block_until_ready(scans(*KIND, jw.ClosedForm())(p)))


def residuals(p, result):
    missed = all_laws(mechanics(*KIND, p), p.friction, p.control, result)
    return {law: np.max(amount) for law, amount in missed.items()}


def test_scans_satisfy_all_laws():
    p, result = scanned()
    assert np.mean(np.any(result.status != jw.Status.ok, axis=1)) < REFUSED
    touching = result.phase != jw.Phase.free
    assert all(np.sum(touching & (result.slip == way)) > SCENES for way in (-1, 0, 1))
    for law, amount in residuals(p, result).items():
        assert amount < SOUND, law


WRONG = {
    "slip": (lambda r: -r.slip, "slip has its direction"),
    "friction_force": (lambda r: r.friction_force * (1 + 1e-5), "force of slip"),
    "normal_force": (lambda r: r.normal_force * (1 - 1e-5), "cone of friction"),
    "fx": (lambda r: r.fx * (1 + 1e-5), "reaction balances the force, x"),
    "mz": (lambda r: r.mz * (1 + 1e-5), "arc of the elastica"),
    "base_x": (lambda r: r.base_x + 1e-5 * np.max(np.abs(r.base_x)), "base under the contact, x"),
    "contact_x": (lambda r: r.contact_x * (1 + 1e-5), "contacts that stick roll"),
    "contact_arc": (lambda r: r.contact_arc * (1 - 1e-5), "contacts that stick roll"),
}


@pytest.mark.parametrize("field", WRONG)
def test_wrong_fields_violate_their_law(field):
    p, result = scanned()
    change, law = WRONG[field]
    assert residuals(p, eqx.tree_at(lambda r: getattr(r, field), result, change(result)))[law] > SOUND


def test_events_at_other_places_violate_a_law():
    p, result = scanned()
    control = result.events.control + 1e-5 * p.length
    wrong = eqx.tree_at(lambda r: r.events.control, result, control)
    assert residuals(p, wrong)["balance of bases, before an event"] > SOUND


def test_a_snap_that_gains_energy_violates_a_law():
    p, result = scanned()
    assert np.any(result.events.kind == jw.EventKind.snap_off)
    events = result.events
    swapped = eqx.tree_at(lambda r: (r.events.before, r.events.after), result, (events.after, events.before))
    assert residuals(p, swapped)["snaps lose energy"] > SOUND


# Scenes of the soak test that failed or were wrong at first, as batch and number.
ONCE_FAILED = {
    ("clamped", "parabola"): [(1, 10), (133, 11)],  # slides back along a branch that begins past its fold
    ("clamped", "ellipse"): [(1, 14), (40, 13)],  # slips far beneath a flat object
    ("FBFB", "circle"): [(3, 5), (14, 8), (16, 15)],  # short whiskers that stick; slips beside a fold of the drive
    ("FBFB", "ellipse"): [(4, 11), (9, 13), (11, 5), (12, 12)],  # creeping bases; contacts that nearly roll
}
BLOCK = 16  # scenes in a batch of the soak test


@pytest.mark.parametrize(("network", "profile"), ONCE_FAILED)
def test_scenes_that_once_failed(network, profile):
    def drawn(batch, number):
        seed = [list(NETWORKS).index(network), list(PROFILES).index(profile), batch]
        p = reversing(network, profile, BLOCK, np.random.default_rng(seed))
        return jax.tree.map(lambda leaf: leaf[number], p)

    p = jax.tree.map(lambda *leaves: np.stack(leaves), *(drawn(*one) for one in ONCE_FAILED[network, profile]))

    def one(p):
        return jw.scan(scene_of(network, profile, p, jw.ClosedForm()), p.control)

    # Not as a batch: all would wait for the longest.
    run = jax.jit(lambda p: jax.lax.map(one, p), compiler_options={"xla_backend_optimization_level": 1})
    result = jax.tree.map(np.asarray, run(jax.tree.map(jax.numpy.asarray, p)))
    assert np.all(result.status == jw.Status.ok)
    for law, amount in all_laws(mechanics(network, profile, p), p.friction, p.control, result).items():
        assert np.max(amount) < SOUND, law
