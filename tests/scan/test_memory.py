"""Places where contacts stick, from nodes of a path to the steps after them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import Node, Path
from jaxwhisker._scan.mechanics import Solutions
from jaxwhisker._scan.memory import Memory, memory_of
from jaxwhisker._scan.plane import InThePlane


def state(steps, places=None):
    """Contacts of two whiskers, with friction if there are places."""
    shape = steps, 2
    friction = None if places is None else Friction(jnp.ones(shape, int), *places)
    return ContactState(jnp.ones(shape, int), jnp.ones(shape), friction)


def places(steps, first=0.0):
    both = first + np.arange(4.0 * steps).reshape(2, steps, 2)
    return jnp.asarray(both[0]), jnp.asarray(both[1])


def test_a_path_remembers_controls_and_places_on_both_sides_of_its_nodes():
    count = 3
    fields: dict[str, Any] = dict.fromkeys(Node._fields) | {
        "point": Point(jnp.zeros((count, 2, 3)), jnp.zeros(count)),
        "state": state(count, places(count)),
        "before": state(count, places(count)),
    }
    path = Path(Node(**fields), jnp.asarray(count), jnp.asarray(0))
    controls, now, before = jnp.arange(3.0), places(count, 10.0), places(count, 50.0)
    remembering = Memory(controls, now, before).on(path)
    nodes = remembering.nodes
    assert nodes.point.z is fields["point"].z and nodes.point.u is controls
    assert nodes.state.places == now and nodes.before.places == before
    assert all(getattr(nodes, name) is None for name in set(Node._fields) - {"point", "state", "before"})
    found = memory_of(remembering)
    assert found is not None and found.control is controls and (found.places, found.places_before) == (now, before)


NODES = np.array([0, 0, 2, 1])


def solutions():
    count = NODES.size
    own = state(count, places(count, first=100.0))
    return Solutions(jnp.zeros((count, 2, 3)), own, jnp.zeros(count, int), jnp.asarray(NODES))


def remembered(known):
    path: Any = None
    found = InThePlane.remembered(Memory(jnp.zeros(3), known, known), path, solutions())
    assert found is not None
    return found


def test_steps_have_the_places_of_the_node_before_them():
    known = places(3)
    found = remembered(known)
    for step, node in zip(found, known, strict=True):
        np.testing.assert_array_equal(step, np.asarray(node)[NODES])


def test_derivatives_pass_from_nodes_to_steps():
    def total(parameter):
        found = remembered((parameter, jnp.zeros((3, 2))))
        return jnp.sum(found[0] * jnp.array([1.0, 10.0, 100.0, 1000.0])[:, None])

    np.testing.assert_array_equal(jax.grad(total)(jnp.zeros((3, 2))), [[11.0] * 2, [1000.0] * 2, [100.0] * 2])


def test_without_friction_there_is_no_memory():
    path: Any = None
    assert InThePlane.remembered(None, path, solutions()) is None
