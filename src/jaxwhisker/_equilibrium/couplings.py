"""Springs between the shafts of two whiskers.

Their loads are unknowns, like the contacts, because the force of such a spring is known only where both whiskers are.
A contact z = (force, parameter, slack) is followed by the loads of the springs whose second end is on this whisker:
force along x and y, and moment, in the drive's frame. Everything else is as for springs between the drive and a shaft.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws, ShaftSprings, anchor_of, length_of, tension_of

Contacts = Float[Array, "whiskers numbers"]
Places = Float[Array, "whiskers places 3"]  # position and angle of the shaft at each place, in the drive's frame


class End(NamedTuple):
    """One end of each spring."""

    whisker: Int[Array, " springs"]
    place: Int[Array, " springs"]  # among those of the whisker


class Couplings(NamedTuple):
    """All springs between two shafts."""

    spring: ShaftSprings  # fields of shape (springs,); where they are attached is not used
    first: End
    second: End
    columns: Int[Array, "springs 3"]  # of its load in the contacts, flattened


class CouplingLoads(NamedTuple):
    """The loads that springs between two shafts have in a state, and their derivatives."""

    load: Float[Array, "springs 3"]  # on the second whisker; minus that on the first
    by_first: Float[Array, "springs 3 3"]  # by position and angle of the ends
    by_second: Float[Array, "springs 3 3"]


def loads_in(couplings: Couplings, z: Contacts) -> Float[Array, "springs 3"]:
    """Loads of the springs on their second whiskers, out of the contacts."""
    return jnp.ravel(z)[couplings.columns]


def as_contacts(couplings: Couplings, loads: Float[Array, "springs 3"], like: Contacts) -> Contacts:
    """Contacts that are zero but for these loads."""
    return jnp.reshape(jnp.zeros(like.size).at[couplings.columns].set(loads, unique_indices=True), like.shape)


def given_by(couplings: Couplings, z: Contacts, held_by: Attachments) -> Float[Array, "whiskers places 3"]:
    """Loads of the springs on all whiskers, at each place."""
    loads, (first, second) = loads_in(couplings, z), (couplings.first, couplings.second)
    none = jnp.zeros((*held_by.springs.at.shape, 3))
    return (
        none.at[second.whisker, second.place]
        .set(loads, unique_indices=True)
        .at[first.whisker, first.place]
        .set(-loads, unique_indices=True)
    )


def incidence_of(couplings: Couplings, held_by: Attachments) -> Float[Array, "whiskers places springs"]:
    """+1 where the second end of a spring is, -1 where its first end is, 0 elsewhere."""
    first, second = couplings.first, couplings.second
    each = jnp.arange(couplings.columns.shape[0])
    none = jnp.zeros((*held_by.springs.at.shape, each.size))
    return none.at[second.whisker, second.place, each].set(1.0).at[first.whisker, first.place, each].set(-1.0)


def ends_of(couplings: Couplings, held_by: Attachments, places: Places) -> tuple[Array, Array]:
    """Positions and angles of both ends, and those from which springs along an axis measure; (springs, 2, 3)."""
    both = couplings.first, couplings.second
    at = [jax.tree.map(lambda leaf, end=end: leaf[end.whisker, end.place], held_by.springs) for end in both]
    ends = jnp.stack([places[end.whisker, end.place] for end in both], axis=1)
    return ends, jnp.stack([jax.vmap(anchor_of)(own) for own in at], axis=1)


def length_between(couplings: Couplings, held_by: Attachments, places: Places) -> Float[Array, " springs"]:
    """Lengths of the springs, or angles of torsion springs."""
    ends, anchors = ends_of(couplings, held_by, places)
    return jax.vmap(lambda *given: jnp.asarray(_length(*given)[0]))(couplings.spring, ends, anchors)


def _length(spring: ShaftSprings, ends: Float[Array, "2 3"], anchors: Float[Array, "2 3"]):
    apart = ends[1] - ends[0]
    return length_of(spring, apart - (anchors[1] - anchors[0]), apart)


def law_of(couplings: Couplings, laws: Laws, held_by: Attachments, places: Places) -> CouplingLoads:
    """Loads of the springs where their ends are at these places."""

    def load(spring, ends, anchors):
        length, by = _length(spring, ends, anchors)
        value = -tension_of(spring, laws, length) * jnp.stack(by)
        return value, value

    slopes, value = jax.vmap(jax.jacfwd(load, argnums=1, has_aux=True))(
        couplings.spring, *ends_of(couplings, held_by, places)
    )
    return CouplingLoads(value, slopes[:, :, 0], slopes[:, :, 1])


class Coupled(NamedTuple):
    """Linearised whiskers at the ends of the springs, and how they depend on the springs' loads (flattened)."""

    places: Places  # after the particular step
    places_by: Float[Array, "whiskers places 3 axes"]  # derivative with respect to the steps (see newton.Condensed)
    places_by_u: Places
    places_by_loads: Float[Array, "whiskers places 3 loads"]
    pose_by_loads: Float[Array, "whiskers axes loads"]
    load_by_loads: Float[Array, "whiskers axes loads"]


class CouplingRows(NamedTuple):
    """The equations of the loads: load - law(places) = 0, linearised."""

    law: Float[Array, "springs 3"]
    by_steps: Float[Array, "loads rows"]
    by_loads: Float[Array, "loads loads"]
    by_u: Float[Array, " loads"]


def rows(couplings: Couplings, laws: Laws, held_by: Attachments, at: Coupled) -> CouplingRows:
    """Derivatives of these equations with respect to the steps, the loads and the control."""
    law = law_of(couplings, laws, held_by, at.places)
    n, _, _, axes = at.places_by.shape
    count, each = 3 * couplings.columns.shape[0], jnp.arange(couplings.columns.shape[0])

    def pulled(by_places: Array) -> list[tuple[End, Array]]:
        """Derivatives of the law through the places of the first and of the second ends."""
        ends = (couplings.first, law.by_first), (couplings.second, law.by_second)
        return [
            (end, jnp.sum(slope[:, :, :, None] * by_places[end.whisker, end.place][:, None, :, :], axis=2))
            for end, slope in ends
        ]

    by_steps = jnp.zeros((each.size, 3, n, axes))
    for end, own in pulled(at.places_by):
        by_steps = by_steps.at[each, :, end.whisker, :].add(-own, unique_indices=True)
    by_loads = jnp.eye(count) - jnp.reshape(sum(own for _, own in pulled(at.places_by_loads)), (count, count))
    by_u = -jnp.reshape(sum(own for _, own in pulled(at.places_by_u[..., None])), count)
    return CouplingRows(law.load, jnp.reshape(by_steps, (count, n * axes)), by_loads, by_u)


def moved(incidence: Float[Array, "places springs"], loads: Float[Array, " loads"]) -> Float[Array, "places 3"]:
    """Change of the loads at all places of a whisker when the springs' loads change."""
    return jnp.sum(incidence[:, :, None] * jnp.reshape(loads, (1, -1, 3)), axis=1)
