"""Shape of curved whiskers in contact, and whether they meet the object in a second place.

A straight round whisker bends in a plane, away from the object, and touches a strictly convex object once. A curved one
may touch it twice, which is not modelled: a scan ends there.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, points
from jaxwhisker._rod.space_end import contact_rotation
from jaxwhisker._space.contact import FORCE, POINT, ROLL, Body, Contact, angle_and_arc, frame_of
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each

LOADED, UNLOADED = 16, 8  # intervals between base and contact, and between contact and tip
DEPTH = 1e-6  # lengths: shafts that are deeper inside the object touch it in a second place


def curved_shape(problem: SpaceProblem, body: Body, z: Contact, phase: Int[Array, ""]) -> Float[Array, "points 3"]:
    """Points of a curved whisker in contact, in the scene: from the contact to the base, and from there to the tip."""
    section = body.section
    assert isinstance(section, SpaceSection)
    chi, arc = angle_and_arc(body, z, phase)
    zero = jnp.zeros_like(arc)
    start = (zero, zero, zero), contact_rotation(chi, z[ROLL])

    def along(length, force, intervals):
        load, at = SpaceLoad((zero, zero, force)), jnp.linspace(0.0, 1.0, intervals + 1)
        r, _ = points(start, length, load, section, at=at, from_base=arc)
        return jnp.stack(r, axis=-1)

    both = jnp.concatenate([along(arc, z[FORCE], LOADED), along(arc - body.length, zero, UNLOADED)[1:]])
    return z[POINT] + jnp.sum(frame_of(problem.surface, z) * both[:, None, :], axis=-1)


def touches_twice(problem: SpaceProblem, z: Contacts, phase: Phases) -> Bool[Array, ""]:
    """Whether any whisker in contact is inside the object elsewhere; straight ones never are."""
    if not problem.curved:
        return jnp.asarray(False)

    def deepest(body, z, phase):
        return jnp.max(-jax.vmap(problem.surface.off)(curved_shape(problem, body, z, phase)))

    return jnp.any((of_each(problem, deepest, z, phase) > DEPTH) & (phase != Phase.free))
