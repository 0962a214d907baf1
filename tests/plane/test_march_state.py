"""The state of a march: how it starts and ends."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import Status

ROUNDING = 1e-12


def test_a_march_starts_free_ahead_of_the_object():
    march = begun_march(dimensionless(scene(jw.Support.fb(70.0))), jnp.array([0.3, -1.0]))
    assert march.task == Task.arrive and march.status == Status.ok and march.count == 0
    assert march.state.phase.tolist() == [Phase.free] and march.state.side.tolist() == [1.0]
    np.testing.assert_allclose(march.pose[0, 0], march.point.u + 0.2, rtol=ROUNDING)
    assert march.point.u > np.sqrt(0.8) - 0.2
    # What lies ahead of the first stop is travelled before travel counts.
    np.testing.assert_allclose(march.travel, 0.3 - march.point.u, rtol=ROUNDING)
    # The drive moves towards -x: du/ds counts as positive.
    assert march.drive_rate(march.tangent) == 1.0
    ended = march.stopped(Status.lost)
    assert ended.task == Task.done and ended.status == Status.lost
