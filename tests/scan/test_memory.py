"""Places where contacts stick, from nodes of a path to the steps after them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import Node, Path
from jaxwhisker._scan.memory import with_memory
from jaxwhisker._scan.steps import Solutions, with_places


def state(steps, places=None):
    """Contacts of two whiskers, with friction if there are places."""
    shape = steps, 2
    friction = None if places is None else Friction(jnp.ones(shape, int), *places)
    return ContactState(jnp.ones(shape, int), jnp.ones(shape), friction)


def places(steps, first=0.0):
    both = first + np.arange(4.0 * steps).reshape(2, steps, 2)
    return jnp.asarray(both[0]), jnp.asarray(both[1])


NODES = np.array([0, 0, 2, 1])


def solutions(own):
    count = NODES.size
    return Solutions(jnp.zeros((count, 2, 3)), state(count, own), jnp.zeros(count, int), jnp.asarray(NODES))


def test_steps_have_the_places_of_the_node_before_them():
    known = places(3)
    found = with_places(solutions(places(NODES.size, first=100.0)), known)
    assert found.state.places is not None and found.state.friction is not None
    for step, node in zip(found.state.places, known, strict=True):
        np.testing.assert_array_equal(step, np.asarray(node)[NODES])
    np.testing.assert_array_equal(found.state.friction.slip, 1)


def test_derivatives_pass_from_nodes_to_steps():
    def total(parameter):
        found = with_places(solutions(places(NODES.size)), (parameter, jnp.zeros((3, 2))))
        assert found.state.places is not None
        return jnp.sum(found.state.places[0] * jnp.array([1.0, 10.0, 100.0, 1000.0])[:, None])

    np.testing.assert_array_equal(jax.grad(total)(jnp.zeros((3, 2))), [[11.0] * 2, [1000.0] * 2, [100.0] * 2])


def test_without_friction_there_is_no_memory():
    own = solutions(None)
    assert with_places(own, None) is own


def test_a_path_remembers_controls_and_places_on_both_sides_of_its_nodes():
    count = 3
    fields: dict[str, Any] = dict.fromkeys(Node._fields) | {
        "point": Point(jnp.zeros((count, 2, 3)), jnp.zeros(count)),
        "state": state(count, places(count)),
        "before": state(count, places(count)),
    }
    path = Path(Node(**fields), jnp.asarray(count), jnp.asarray(0))
    controls, now, before = jnp.arange(3.0), places(count, 10.0), places(count, 50.0)
    nodes = with_memory(path, controls, now, before).nodes
    assert nodes.point.z is fields["point"].z and nodes.point.u is controls
    assert nodes.state.places == now and nodes.before.places == before
    assert all(getattr(nodes, name) is None for name in set(Node._fields) - {"point", "state", "before"})
