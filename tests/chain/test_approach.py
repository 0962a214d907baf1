"""Where scans begin."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._chain.approach import all_free, clearance, limits_of
from jaxwhisker._equilibrium.contact import Phase
from several_engine import problem


def test_free_whiskers_have_no_contacts():
    z, state = all_free(problem())
    assert z.shape == (2, 3) and np.all(state.phase == Phase.free) and not np.any(state.touches)


@pytest.mark.parametrize(("u", "clear"), [(1.2, True), (1.0, False), (0.0, False), (-1.2, True)])
def test_whiskers_are_clear_beyond_the_first_touch(u, clear):
    """That of `wavy` is at 1.056."""
    assert (float(jax.jit(clearance)(problem(), jnp.asarray(u))) > 0) == clear


def test_a_scan_begins_at_its_first_step_or_before_the_object():
    limits = jax.jit(limits_of)
    assert float(limits(problem(), jnp.asarray(1.3)).start) == 1.3
    for first in (0.2, np.nan):
        found = limits(problem(), jnp.asarray(first))
        assert float(clearance(problem(), found.start)) > 0
        assert 1.056 < float(found.start) < 1.2
        assert float(found.far) < -3.0 and found.known
