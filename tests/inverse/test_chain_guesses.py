"""Guesses for the contacts of a whisker: one of them is close to the truth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.problem import chain_problem
from jaxwhisker._inverse.chain_guesses import BEST, guesses_of
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.motion import Pose
from several import BOTH, CONTROL, circles, scanned

NEAR = 0.1  # of lengths, and of the outer force relative to the whole force
FITS = 2 + 3 + 2 * BEST + 3 * BEST + 3 * BEST


@pytest.fixture(scope="module")
def guesses():
    """Guesses for a step with two contacts."""
    k, scan = int(BOTH[len(BOTH) // 2]), scanned()
    body = chain_problem(canonical(circles()), 2).bodies(jnp.asarray(CONTROL[k]))
    own = jax.tree.map(lambda leaf: leaf[0], (body.length, body.bending_stiffness, body.frame, body.frame_rate))
    body = body._replace(length=own[0], bending_stiffness=own[1], frame=own[2], frame_rate=own[3])
    base = Pose(*(jnp.asarray(v[k, 0]) for v in (scan.base_x, scan.base_y, scan.base_angle)))
    return k, guesses_of(body, base, jnp.stack([scan.fx[k, 0], scan.fy[k, 0], scan.mz[k, 0]]))


def test_all_hypotheses_are_there(guesses):
    _, found = guesses
    assert found.y.shape == (FITS, 8) and found.state.phase.shape == (FITS, 2)
    number = np.sum(np.asarray(found.state.touches), axis=1)
    assert np.sum(number == 1) == 5 and np.sum(number == 2) == FITS - 5
    fixed = np.asarray(found.fixed)
    np.testing.assert_array_equal(fixed[:, 6], ~np.asarray(found.unknown))
    spots = np.sum(np.asarray(found.state.piece == 2) & np.asarray(found.state.touches), axis=1)
    np.testing.assert_array_equal(spots, np.asarray(found.unknown))


def test_a_guess_with_known_objects_is_close(guesses):
    k, found = guesses
    scan = scanned()
    known = ~np.asarray(found.unknown) & np.all(np.asarray(found.state.touches), axis=1)
    force = np.asarray(scan.contact_force[k, 0])
    beyond = 1 - np.asarray(scan.contact_arc[k, 0])
    off = np.abs(np.asarray(found.y)[known][:, [2, 5]] - beyond)
    force_off = np.abs(np.asarray(found.y)[known][:, [0, 3]] - force) / force.sum()
    assert np.min(np.max(np.concatenate([off, force_off], axis=1), axis=1)) < 2 * NEAR
