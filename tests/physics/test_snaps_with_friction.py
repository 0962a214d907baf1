"""Snaps with friction come to rest where an explicit flow of the bases does."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from snap_with_friction import Whisker, rest_of

import jaxwhisker as jw
from ordinary_scenes import KINDS, drawn, scene_of
from scenes import all_ok

CASES = json.loads((Path(__file__).parent.parent / "data/snap_friction.json").read_text())["cases"]
SNAPS = (jw.EventKind.snap_through, jw.EventKind.snap_off)
STORED = 5e-4  # accuracy of the bases after the snap that the reference is good for
BASES = 5e-4  # where contacts stick on the way, they do so within a step of the flow
SNAP_AT = 1e-6  # the reference gives six digits
DIGITS = 6e-4  # of the energies


@pytest.mark.parametrize("number", range(len(CASES)))
def test_snaps_end_at_the_reference(number):
    case = CASES[number]
    whiskers = tuple(map(jw.Whisker, case["length"], case["bending_stiffness"]))
    support = jw.Support.fbfb(case["stiffness"], case["rest_length"])
    scene = jw.Scene(whiskers, jw.Parabola(**case["parabola"]), support, friction=case["friction"])
    result = jw.scan(scene, np.array(case["control"]))
    assert all_ok(result)
    (snap,) = [e for e in result.events if e.kind in SNAPS and abs(e.control - case["snap_at"]) < SNAP_AT]
    np.testing.assert_allclose(snap.after.base_x, case["bases_after"], atol=STORED)
    free = [k + 1 for k, phase in enumerate(np.asarray(snap.after.phase)) if phase == jw.Phase.free]
    assert free == case["free_after"]
    for name, state in (("energy_before", snap.before), ("energy_after", snap.after)):
        if name in case:
            assert abs(jw.stored_energy(scene, state) - case[name]) < DIGITS


def by_oracle(scene, snap):
    """Bases after a snap, by the explicit flow."""
    before = jax.tree.map(np.asarray, snap.before)
    mu, profile, whiskers = float(scene.friction), scene.profile, []
    for k in range(scene.support.whiskers):
        one = Whisker(1.0, 1.0, float(profile.a), float(profile.distance), mu)
        if before.phase[k] != jw.Phase.free:
            lean = -np.arctan2(before.friction_force[k], before.normal_force[k])
            force, slope, arc = (float(v[k]) for v in (before.contact_force, before.contact_slope, before.contact_arc))
            one.touches(force, slope, float(lean), arc, int(before.slip[k]), before.phase[k] == jw.Phase.tip)
        whiskers.append(one)
    springs = [(*s.between, float(s.stiffness), float(s.rest_length)) for s in scene.support.springs]
    return rest_of(whiskers, before.base_x, springs, snap.control)


@pytest.mark.parametrize(("kind", "scenes"), [("two whiskers", 15), ("weak friction", 3), ("three whiskers", 3)])
def test_snaps_end_where_the_explicit_flow_comes_to_rest(kind, scenes):
    p = drawn(kind, scenes)
    compared = 0
    for number in range(scenes):
        scene = scene_of(kind, jax.tree.map(lambda leaf, number=number: leaf[number], p))
        result = jw.scan(scene, np.array(KINDS[kind].control))
        assert all_ok(result)
        snaps = [event for event in result.events if event.kind in SNAPS]
        # Where all whiskers are free, nothing is left to compare.
        touching = [snap for snap in snaps if np.any(np.asarray(snap.after.phase) != jw.Phase.free)]
        for snap in (touching or snaps)[-1:]:
            bases = by_oracle(scene, snap)
            np.testing.assert_allclose(snap.after.base_x, bases, atol=BASES, err_msg=f"{kind} {number}")
            compared += 1
    assert compared == scenes
