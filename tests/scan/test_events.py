"""Events of a path: which of its nodes, and a table that agrees with the events of a result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.program import Program
from jaxwhisker._path.path import NO_EVENT, STOP
from jaxwhisker._scan.events import event_table, public_nodes
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.slopes import events_now

EXACT = 1e-12
CONTROL = np.array([1.2, -0.4, 1.0])
SCENES = {
    "plane": jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2)),
    "plane, friction": jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2), friction=0.3),
    "space": jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.2))),
    "space, friction": jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.2)), friction=0.3),
}
tables = Program(event_table, quick=True)


class Nodes:
    """As much of the nodes of a path as their events depend on."""

    kind = jnp.array([0, NO_EVENT, 1, STOP, 2, 4, 6, 0])
    travel = jnp.array([-0.5, -0.1, -0.1, 0.0, 0.1, 0.2, 0.4, 0.5])


def test_events_begin_at_the_first_position_and_end_with_the_path():
    public, at = public_nodes(Nodes, jnp.asarray(7), 4)
    assert np.flatnonzero(public).tolist() == [4, 5, 6]
    assert at.tolist() == [4, 5, 6, 0]


def test_of_too_many_events_the_first_and_the_last_are_kept():
    assert public_nodes(Nodes, jnp.asarray(8), 2)[1].tolist() == [4, 7]


@pytest.mark.parametrize("name", SCENES)
def test_a_table_agrees_with_the_events(name):
    scene = SCENES[name]
    mechanics, (route, _) = mechanics_of(scene), route_through(CONTROL)
    problem = dimensionless(scene)
    path = mechanics.follow(problem, route.stops, np.asarray(route.last)).path
    memory = mechanics.memory(problem, path, route.stops)
    table, events = tables(mechanics, problem, path, memory), events_now(mechanics, problem, path, memory)
    assert int(events.count) > 2
    for field in ("kind", "whiskers"):
        np.testing.assert_array_equal(getattr(table, field), getattr(events, field))
    for field in ("control", "travel"):
        np.testing.assert_allclose(getattr(table, field), getattr(events, field), atol=EXACT)
    before, after = (jnp.where(side.phase > 0, 1, 0) for side in (events.before, events.after))
    late = np.asarray(events.kind)[:, None] >= jw.EventKind.release
    np.testing.assert_array_equal(table.freed, (before > after) & late)
    assert jax.tree.structure(table) == jax.tree.structure(table._replace())
