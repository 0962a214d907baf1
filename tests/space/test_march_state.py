"""The state of a march: how it stops, and the nodes that it writes."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import NO_EVENT
from jaxwhisker._space.march import _start
from jaxwhisker._space.march_state import SpaceTask, node_at

SCENE = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))


def started():
    return _start(dimensionless(SCENE), jnp.asarray(-2.0), jnp.array([-1.0, 1.0]))


def test_a_march_stops_with_its_status():
    stopped = started().stopped(jw.Status.lost)
    assert int(stopped.task) == SpaceTask.done and int(stopped.status) == jw.Status.lost


def test_a_plain_node_counts_the_travel_of_the_drive_since_the_first_stop():
    march = started()
    assert float(march.travel) == -1.0
    node = node_at(march, Point(march.point.z, jnp.asarray(-1.5)), march.tangent)
    assert float(node.travel) == -0.5 and int(node.kind) == NO_EVENT and not np.any(node.whiskers)
