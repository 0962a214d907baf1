"""Random scenes, checked by laws that share no code with the package (many more in benchmarks/soak.py)."""

from functools import cache

import equinox as eqx
import jax
import numpy as np
import pytest
from independent import violations

import jaxwhisker as jw
from random_scenes import drawn, mechanics, scans

SOUND = 1e-7  # largest relative residual of a law; the package itself requires 1e-8
REFUSED = 0.01  # largest share of scenes that end with a status; about 0.2 % do, all with a known reason
KINDS = {("FB", "parabola"): 600, ("FBFB", "ellipse"): 400}  # scenes of each
COUPLED = ("FBFB", "ellipse")


@cache
def scanned(network, profile):
    """Parameters and scans of one kind; each kind uses another method for rods."""
    p = drawn(network, profile, KINDS[network, profile], np.random.default_rng(1))
    rod = jw.Shooting() if network == "FB" else jw.ClosedForm()
    return p, jax.block_until_ready(scans(network, profile, rod)(p))


@pytest.mark.parametrize("kind", KINDS)
def test_states_with_status_ok_satisfy_all_laws(kind):
    network, profile = kind
    p, result = scanned(network, profile)
    for law, amount in violations(mechanics(network, profile, p), p.control, result).items():
        worst = np.unravel_index(np.argmax(amount), amount.shape)
        assert amount[worst] < SOUND, f"{law}: scene and step {worst}"


@pytest.mark.parametrize("kind", KINDS)
def test_few_scenes_fail(kind):
    _, result = scanned(*kind)
    worst = np.max(np.asarray(result.status), axis=1)
    assert np.mean(worst != jw.Status.ok) <= REFUSED
    assert not np.any(worst == jw.Status.invalid)
    touched = np.any(np.asarray(result.phase) != jw.Phase.free, axis=(1, 2))
    assert np.mean(touched) > 0.9  # otherwise little was checked


WRONG = {
    "fx": lambda r: -r.fx,
    "mz": lambda r: r.mz * (1 + 1e-5),
    "base_x": lambda r: r.base_x + 1e-5 * np.max(np.nan_to_num(np.abs(r.base_x)), axis=(1, 2), keepdims=True),
    "contact_arc": lambda r: r.contact_arc * (1 - 1e-5),
    "contact_slope": lambda r: r.contact_slope + 1e-5,
    "contact_force": lambda r: r.contact_force * (1 + 1e-5),
    "phase": lambda r: np.where(np.asarray(r.phase) == jw.Phase.tip, jw.Phase.tangential, r.phase),
}


@pytest.mark.parametrize("field", WRONG)
def test_wrong_fields_violate_a_law(field):
    p, result = scanned(*COUPLED)
    wrong = eqx.tree_at(lambda r: getattr(r, field), result, WRONG[field](result))
    missed = violations(mechanics(*COUPLED, p), p.control, wrong)
    assert max(np.max(amount) for amount in missed.values()) > SOUND


def test_an_unstable_state_violates_a_law():
    # The springs are a hundred times softer than those of the scan.
    p, result = scanned(*COUPLED)
    scenes = mechanics(*COUPLED, p)
    missed = violations(scenes._replace(flexibility=100 * scenes.flexibility), p.control, result)
    assert np.max(missed["stable network"]) > SOUND
