"""What events and the status of a simulation depend on, in every step."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.motion_state import Moving
from jaxwhisker._dynamics.moving import System
from jaxwhisker._path.path import Status

DEEPEST = 0.01  # penetration beyond which it is a second contact
NO_ROOM = 1e-3  # penetration beyond which it is a contact for which there is no room
SHORTEST = 3e-6  # T: rounding errors of reactions grow with 1 / h^2, to 1e-5 EI/L here
CREATED = 0.05  # energy that contacts may create, relative to the energy at the start and the work of the drive
CREATED_AT_REST = 1e-3  # the same without either, in EI / L of the first whisker


class Trace(NamedTuple):
    """What events depend on, at the start and after every step; leading axis: times.

    If whiskers may have several contacts, columns are those of the first whisker, then of the second.
    """

    touches: Bool[Array, "times contacts"]
    force: Float[Array, "times contacts"]  # mean over the step before
    gap: Float[Array, "times contacts"]
    at_tip: Float[Array, "times contacts"]
    slope: Float[Array, "times contacts"]  # sine of the object's slope
    work: Float[Array, " times"]  # of the drive, dimensionless as all others
    contact: Float[Array, " times"]  # work of contact forces along the normal
    impact: Float[Array, " times"]  # loss
    arc: Float[Array, "times contacts"] | None = None  # with several contacts only, as all that follow
    inside: Float[Array, "times whiskers"] | None = None  # least gap where there is no room for a contact
    distance: Float[Array, "times whiskers"] | None = None


def numbers_of(trace: Trace, contacts: int) -> Int[Array, "times contacts"]:
    """Numbers of all contacts, from the tip to the base; of places without contact, that which they would have."""
    assert trace.arc is not None
    touches, arc = (values.reshape(values.shape[0], -1, contacts) for values in (trace.touches, trace.arc))
    beyond = touches[:, :, None] & (arc[:, :, None] > arc[..., None])
    return (1 + jnp.sum(beyond, axis=-1)).reshape(trace.touches.shape)


def trace_of(system: System, moving: Moving) -> Trace | None:
    """The trace of one state; None without an object."""
    at = moving.rod.touching
    if at is None:
        return None
    ledger = moving.ledger
    energies = map(jnp.asarray, (ledger.work, ledger.contact, ledger.impact))
    if at.away is not None:
        gap = jnp.where(at.away, jnp.inf, at.gap.distance)
        places = map(jnp.ravel, (at.touches, at.force, gap, at.gap.at_tip, at.gap.normal[..., 0]))
        return Trace(*places, *energies, arc=jnp.ravel(at.arc), inside=at.deepest, distance=at.distance)
    gap = jnp.minimum(at.gap.distance, at.deepest)
    gap = gap if at.others is None else jnp.minimum(gap, at.others)
    return Trace(at.touches, at.force, gap, at.gap.at_tip, at.gap.normal[:, 0], *energies)


def status_of(solved: Bool[Array, " times"], trace: Trace | None, before: Scalar, h: Scalar) -> Array:
    """The status after every step of size h: what fails first counts. `before` is the energy at the start."""
    failures = [(~solved, Status.lost), (jnp.broadcast_to(h < SHORTEST, solved.shape), Status.inexact)]
    if trace is not None:
        trace = jax.lax.stop_gradient(trace)
        most = before + jax.lax.cummax(jnp.abs(trace.work))
        if trace.inside is None:
            failures.append((jnp.any(trace.gap < -DEEPEST, axis=1), Status.second_contact))
        else:
            failures.append((jnp.any(trace.inside < -NO_ROOM, axis=1), Status.too_many_contacts))
            assert trace.distance is not None
            failures.append((jnp.any(trace.distance < -DEEPEST, axis=1), Status.inexact))
        # Contacts of a resting object do no work, and impacts give nothing back.
        created = jnp.abs(trace.contact) + jax.lax.cummax(trace.impact) - trace.impact
        failures.append((created > CREATED * most + CREATED_AT_REST, Status.inexact))
    failed = jnp.stack([failure for failure, _ in failures])
    first = jnp.argmax(jnp.any(failed, axis=0))
    kind = jnp.array([int(status) for _, status in failures])[jnp.argmax(failed[:, first])]
    return jnp.where(jnp.cumsum(jnp.any(failed, axis=0)) > 0, kind, int(Status.ok))
