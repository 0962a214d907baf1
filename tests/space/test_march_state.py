"""The state of a march: how it stops, and the nodes that it writes."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.continuation import Limits
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import NO_EVENT
from jaxwhisker._space.friction import continuation_of

SCENE = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))


def started():
    start, far = jnp.asarray(-2.0), jnp.asarray(2.0)
    return continuation_of(dimensionless(SCENE)).start(jnp.array([-1.0, 1.0]), Limits(start, far, far))


def test_a_march_begins_free_on_the_way_to_its_first_stop():
    march = started()
    assert int(march.task) == Task.arrive and march.phase.tolist() == [jw.Phase.free]
    assert (float(march.travel), float(march.direction)) == (-1.0, 1.0)


def test_a_plain_node_counts_the_travel_of_the_drive_since_the_first_stop():
    march = started()
    assert float(march.travel) == -1.0
    node = march.node(Point(march.point.z, jnp.asarray(-1.5)), march.tangent)
    assert float(node.travel) == -0.5 and int(node.kind) == NO_EVENT and not np.any(node.whiskers)
