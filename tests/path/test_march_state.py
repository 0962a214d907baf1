"""The state of a march: how it stops, and its plain nodes."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import NO_EVENT


def test_a_march_stops_with_its_status_and_writes_plain_nodes():
    march = begun_march(dimensionless(scene(jw.Support.fb(70.0))), jnp.array([1.0, -1.0]))
    stopped = march.stopped(jw.Status.lost)
    assert int(stopped.task) == Task.done and int(stopped.status) == jw.Status.lost
    assert stopped.point is march.point
    ahead = march.point._replace(u=march.point.u - 0.5)
    node = march.node(ahead, march.tangent)
    assert int(node.kind) == NO_EVENT and not np.any(node.whiskers)
    assert node.before is node.state is march.state and node.z_before is ahead.z
    np.testing.assert_allclose(node.travel, march.travel + 0.5, rtol=1e-12)
