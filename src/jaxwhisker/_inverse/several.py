"""Reconstruction of whiskers that may have several contacts, in the plane.

Without friction, each contact is described by two numbers, such as its force and its arc length: the force is
perpendicular to the whisker. Three reactions determine one contact, and one degree of freedom is left, which shows
whether one contact explains them. Two contacts have four numbers, which three reactions do not determine.

A contact with a known object satisfies two equations more: the whisker passes through a point of the object, and is
parallel to the object there. The reactions then determine one contact with something unknown besides, and again one
degree of freedom is left. Contacts with known objects only follow from the pose of the base, and the reactions show
whether there are no others. Whiskers do not help each other: they touch an unknown object in different places.

On the shaft of a whisker whose stiffness and curvature are constant, no degree of freedom is left (`keeps_integral` in
inverse_rod.py). Contacts there with something unknown are ambiguous.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._chain.problem import chain_problem
from jaxwhisker._inverse.inverse_chain import KnownObjects
from jaxwhisker._inverse.plane import InversePlane, sensor_of
from jaxwhisker._inverse.points import ContactsReconstruction
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.objects import as_one
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, Sensor

MOST_WITH_OBJECTS = 2  # contacts of a whisker before known objects
BLOCK_OF_STEPS = 16  # that are searched for contacts at once


class InverseSeveral(InversePlane):
    """Whiskers in the plane that may have several contacts with unknown objects."""

    several = True

    @staticmethod
    def sensor(made):
        sensor = sensor_of(made, several=True)
        if sensor.support.on_shafts:
            checks.fail("contacts", "1 with springs or foundations on shafts", "more")
        return sensor


class InverseBeforeObjects(InverseSeveral):
    """Whiskers in the plane that may touch known objects, and something unknown once."""

    result, block = ContactsReconstruction, BLOCK_OF_STEPS

    @staticmethod
    def batches(located, steps):
        # The search for contacts takes memory.
        blocks = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, BLOCK_OF_STEPS, *leaf.shape[1:])), steps)
        found = jax.lax.map(lambda block: located(*block), blocks)
        return jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[2:])), found)

    @staticmethod
    def sensor(made):
        InverseSeveral.sensor(made)
        if made.friction is not None:
            checks.fail("objects", "None with friction", f"{made.profile}")
        if made.profile.has_edges:
            checks.fail("objects", "smooth", f"{made.profile}")
        if made.contacts > MOST_WITH_OBJECTS:
            checks.fail("contacts", f"at most {MOST_WITH_OBJECTS} with `objects`", repr(made.contacts))
        return made

    @staticmethod
    def parts(sensor):
        return (sensor,)

    @staticmethod
    def dimensionless(sensor, unit, kinds, readings):
        problem = chain_problem(canonical(sensor), sensor.contacts)
        lengths = jnp.stack([unit.length, unit.length, 1.0])
        drive = jnp.stack(jax.vmap(sensor.motion.pose)(readings.control), axis=-1) / lengths
        poses = None if readings.poses is None else readings.poses / lengths
        return KnownObjects(problem), drive, poses, None


class BeforeObjects(eqx.Module):
    """A sensor before known objects: the scene, as a function of parameters if one of them is a function."""

    sensor: Any
    objects: Any
    contacts: int | None = eqx.field(static=True)  # None: those of the scene

    def __call__(self, **parameters) -> Scene:
        made = _made(self.sensor, parameters)
        contacts = getattr(made, "contacts", 1) if self.contacts is None else self.contacts
        if contacts == 1:
            checks.fail("contacts", "at least 2 with `objects`", "1")
        sensor = sensor_of(made, several=True)
        objects = _made(self.objects, parameters)
        allowed = "a profile, a tuple of profiles, or a function of the parameters that returns them"
        each = objects if isinstance(objects, tuple) and objects else (objects,)
        for one in each:
            checks.instance("objects", one, AbstractProfile, allowed)
        return sensor.before(as_one(objects), contacts)


def _made(value: Any, parameters: dict[str, Any]) -> Any:
    return value(**parameters) if callable(value) and not isinstance(value, (Sensor, Scene)) else value
