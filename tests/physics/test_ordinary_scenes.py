"""Ordinary scenes with friction of every kind run to their end, in the same way with and without jit and vmap."""

from functools import cache

import jax
import numpy as np
import pytest
from independent_friction import all_laws

import jaxwhisker as jw
import random_scenes
from ordinary_scenes import KINDS, control_of, drawn, one_by_one, scan_of, staged_scans

SCENES = 100  # of each kind
# Kinds that are also staged without vmap: one of each problem shape that differs in how contacts stick.
ONE_BY_ONE = ("two whiskers", "curved", "follicle")
CHUNKS = 4  # of so few scenes that they run one by one
SAME = 1e-7  # positions of events may differ by rounding, next to events that are badly conditioned
SOUND = 1e-7  # largest relative residual of a law
# Contacts that are not modelled: whiskers that are wound around the object, or pressed against it below a spring.
NOT_MODELLED = {jw.Status.second_contact, jw.Status.at_spring}
NETWORKS = {"two whiskers": "FBFB", "weak friction": "FBFBR", "feedback": "FBFBR", "three whiskers": "FBFBFBR"}


@cache
def scanned(kind):
    """All scans of a kind outside any jit, by the programs of single scans that other tests use, too."""
    parts = np.split(np.arange(SCENES), CHUNKS)
    p, one = drawn(kind, SCENES), jax.vmap(scan_of(kind))
    chunks = [one(jax.tree.map(lambda leaf, part=part: jax.numpy.asarray(leaf[part]), p)) for part in parts]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *chunks)


@pytest.mark.parametrize("kind", KINDS)
def test_no_scene_fails(kind):
    status = np.max(scanned(kind).status, axis=1)
    failed = {n: jw.Status(s).name for n, s in enumerate(status) if s != jw.Status.ok and s not in NOT_MODELLED}
    assert not failed
    assert np.mean(status == jw.Status.ok) > 0.5


@pytest.mark.parametrize(
    ("kind", "along"),
    [*((kind, jax.vmap) for kind in KINDS), *((kind, one_by_one) for kind in ONE_BY_ONE)],
    ids=[*KINDS, *(f"{kind}, one by one" for kind in ONE_BY_ONE)],
)
def test_staged_scans_agree(kind, along):
    staged, apart = jax.tree.map(np.asarray, staged_scans(kind, along)(drawn(kind, SCENES))), scanned(kind)
    assert np.array_equal(staged.status, apart.status)
    assert np.array_equal(staged.events.kind, apart.events.kind)
    np.testing.assert_allclose(staged.events.control, apart.events.control, atol=SAME)


@pytest.mark.parametrize("kind", NETWORKS)
def test_states_and_snaps_satisfy_all_laws(kind):
    p, ones = drawn(kind, SCENES), np.ones(SCENES)
    springs = random_scenes.NETWORKS[NETWORKS[kind]]
    whiskers = max(end for pair in springs for end in pair)
    rest = [0.2 * (second - first) for first, second in springs]
    numbers = random_scenes.Drawn(
        profile={"distance": p.distance, "a": ones},
        stiffness=np.broadcast_to(p.stiffness, (SCENES, len(springs))),
        rest_length=np.broadcast_to(rest, (SCENES, len(springs))),
        length=np.ones((SCENES, whiskers)),
        bending_stiffness=np.ones((SCENES, whiskers)),
        control=np.broadcast_to(control_of(kind), (SCENES, len(control_of(kind)))),
        friction=p.friction,
    )
    mechanics = random_scenes.mechanics(NETWORKS[kind], "parabola", numbers)
    for law, amount in all_laws(mechanics, p.friction, numbers.control, scanned(kind)).items():
        assert np.max(amount) < SOUND, law
