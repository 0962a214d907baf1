"""Ordinary scenes with friction of every kind run to their end, in the same way with and without jit and vmap."""

from functools import cache

import jax
import numpy as np
import pytest
from independent_friction import all_laws

import jaxwhisker as jw
import random_scenes
from ordinary_scenes import KINDS, control_of, drawn, scans, scene_of

SCENES = 100  # of each kind
SAME = 1e-7  # positions of events may differ by rounding, next to events that are badly conditioned
SOUND = 1e-7  # largest relative residual of a law
# Contacts that are not modelled: whiskers that are wound around the object, or pressed against it below a spring.
NOT_MODELLED = {jw.Status.second_contact, jw.Status.at_spring}
# Kinds that are also compiled without vmap: one of each problem shape that differs in how contacts stick.
ONE_BY_ONE = ("two whiskers", "curved", "follicle")
NETWORKS = {"two whiskers": "FBFB", "weak friction": "FBFBR", "feedback": "FBFBR", "three whiskers": "FBFBFBR"}


@cache
def scanned(kind, vmapped=True):
    """All scans of a kind, in one compiled program."""
    return jax.tree.map(np.asarray, scans(kind, vmapped)(drawn(kind, SCENES)))


@pytest.mark.parametrize("kind", KINDS)
def test_no_scene_fails(kind):
    status = np.max(scanned(kind).status, axis=1)
    failed = {n: jw.Status(s).name for n, s in enumerate(status) if s != jw.Status.ok and s not in NOT_MODELLED}
    assert not failed
    assert np.mean(status == jw.Status.ok) > 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_eager_and_staged_scans_agree(kind):
    p, staged = drawn(kind, SCENES), scanned(kind)
    for number in range(SCENES):
        one = jax.tree.map(lambda leaf, number=number: leaf[number], p)
        eager = jw.scan(scene_of(kind, one), control_of(kind))
        assert np.array_equal(eager.status, staged.status[number]), number
        kinds = [int(e.kind) for e in eager.events]
        assert kinds == staged.events.kind[number][: len(kinds)].tolist(), number
        np.testing.assert_allclose(
            [e.control for e in eager.events], staged.events.control[number][: len(kinds)], atol=SAME, err_msg=number
        )


@pytest.mark.parametrize("kind", ONE_BY_ONE)
def test_staged_scans_agree_with_batches(kind):
    single, batched = scanned(kind, vmapped=False), scanned(kind)
    assert np.array_equal(single.status, batched.status)
    assert np.array_equal(single.events.kind, batched.events.kind)
    np.testing.assert_allclose(single.events.control, batched.events.control, atol=SAME)


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
