"""Stance: distances, speeds, and whether object and shaft part at contacts."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._chain.approach import all_free
from jaxwhisker._chain.stance import bases_of, stance_of
from jaxwhisker._equilibrium.contact import Phase
from several_cases import CASES
from several_engine import of_event, problem, with_contacts

CLOSE = 1e-7  # of gaps of stored states
PLACE = 1e-5  # of places at which gaps are least: they change little with the place


def stance(problem, u, z, state):
    return stance_of(problem, u, problem.rest, z, state)[0]


def candidates_of(problem, u, z, state):
    return stance_of(problem, u, problem.rest, z, state)[1]


def test_bases_stand_upright_on_the_drive():
    at = np.array(bases_of(problem(), jnp.asarray(0.3), problem().rest))
    np.testing.assert_allclose(at[:, 0], [0.3, 0.0, 0.0, 1.0], atol=1e-15)


def test_a_free_whisker_is_as_far_as_its_tip():
    u = 1.2
    z, state = all_free(problem())
    found = jax.jit(stance)(problem(), jnp.asarray(u), z, state)
    x = np.linspace(0.8, 1.3, 200_001)
    wave = CASES["wavy"]["objects"][0]
    y = wave["distance"] + wave["amplitude"] * (1 - np.cos(2 * np.pi * x / wave["wavelength"])) + wave["a"] * x**2
    np.testing.assert_allclose(found.distance, [np.min(np.hypot(x - u, y - 1.0))], rtol=1e-3)  # to first order
    assert float(found.speed) == 1.0
    assert bool(found.opens)


def test_a_whisker_in_contact_has_no_candidate_at_its_contacts():
    for count in (1, 2):
        u, z, state = with_contacts(count)
        found = jax.jit(stance)(problem(), u, z, state)
        assert bool(found.opens)
        assert np.all(np.asarray(found.gap) > CLOSE)


def test_where_a_contact_begins_its_candidate_closes():
    touches = [event for event in CASES["wavy"]["events"] if event["kind"] == "touch"][1:]
    assert len(touches) > 2
    for event in touches:
        own, (new,) = ([c for c in event["before"]["contacts"] if (c[3] > 0) == pushes] for pushes in (True, False))
        u, z, state = of_event(event, own)
        candidates = jax.tree.map(lambda leaf: leaf[0], jax.jit(candidates_of)(problem(), u, z, state))
        k = int(np.argmin(candidates.gap))
        assert abs(float(candidates.gap[k])) < CLOSE
        assert int(candidates.phase[k]) == (Phase.tip if new[4] == 1.0 else Phase.tangential)
        np.testing.assert_allclose(candidates.numbers[k, 1], new[5], atol=PLACE)
        if new[4] < 1.0:
            np.testing.assert_allclose(1 - candidates.numbers[k, 2], new[4], atol=PLACE)
