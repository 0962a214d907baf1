"""Events: what happens where a margin vanishes. Each kind of event is a class, and contact laws are sums of kinds.

A margin is a distance of each whisker from its event: positive before it, negative beyond. The event is solved for with
a condition in place of the control or arc length. Afterwards, another contact state holds, and the path leaves in the
direction in which the event is not undone. A further contact law is a further class here, named in `events_of`.
"""

import abc
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.couplings import as_contacts
from jaxwhisker._equilibrium.newton import Condensed, slip_by_contact, with_slips
from jaxwhisker._equilibrium.point import Contacts, PathCondition
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker, Poses, Stance
from jaxwhisker._equilibrium.touch import TouchAlongX
from jaxwhisker._path.margins import FAR, Margins
from jaxwhisker._path.path import STOP, EventKind
from jaxwhisker._path.slips import LEAN_NOISE

MARGIN_NOISE = 1e-12  # accuracy of margins; with it, two events at the same place do not violate each other
CONE_NOISE = 1e-12  # largest error of the force across the normal of others, in EI/L^2

Which = Bool[Array, " whiskers"]
Ends = tuple[PerWhisker, PerWhisker]


class Seen(NamedTuple):
    """A point of the path, as margins see it."""

    problem: Problem
    state: ContactState
    free: Which
    z: Contacts
    stance: Stance
    ahead: PerWhisker  # sin(alpha), with the sign that makes it positive before the vertex
    remaining: Scalar  # distance of the drive to its next stop
    ends: Ends | None  # of the pieces on which contacts are; None without edges


class PathDirection(NamedTuple):
    """A point of the path, and the direction there."""

    problem: Problem
    state: ContactState
    free: Which
    z: Contacts
    z_rate: Contacts
    pose_rate: Poses


class Lead(NamedTuple):
    """Weights for the tangent's components: their weighted sum must be positive where the path leaves an event."""

    z: Contacts
    pose: Poses
    u: Scalar


class Happened(NamedTuple):
    """An event that has been solved for, and the state that holds after it."""

    problem: Problem
    state: ContactState
    z: Contacts
    condensed: Condensed


class After(NamedTuple):
    """What contacts will be after an event."""

    problem: Problem
    stance: Stance
    phase: Int[Array, " whiskers"]  # of contacts that begin
    side: PerWhisker
    piece: Int[Array, " whiskers"] | None  # of contacts that begin or pass on
    limit: PerWhisker | None
    parameters: PerWhisker | None  # of the profile at contacts; None without friction


class PathEvent(abc.ABC):
    """A kind of event."""

    kinds: ClassVar[tuple[int, ...]]  # EventKind or STOP; if there are two, the first one is that of a tip contact
    # Its condition: that a weighted sum of a contact's three numbers, the object's slope there and the control has a
    # given value, which is 0 for contacts unless there is a `limit`.
    of_contact: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    of_slope: ClassVar[float] = 0.0
    of_control: ClassVar[float] = 0.0
    # The path leaves it where that sum for the contact grows (1) or falls (-1): of a tip contact, and of any other.
    leaves: ClassVar[tuple[float, float]] = (0.0, 0.0)
    continues: ClassVar[bool] = False  # whether the state does not change, and the path goes on as it arrives
    before_release: ClassVar[bool] = False  # whether it does not happen to a contact that ends in the same step

    @abc.abstractmethod
    def margin(self, seen: Seen) -> Float[Array, "..."]:
        """Margins of all whiskers; of all objects and whiskers; or of the drive, with one element."""

    def rate(self, moving: PathDirection) -> Float[Array, "..."]:
        """Derivatives of the margins along the path; zero for events that are passed only once."""
        return jnp.zeros_like(moving.state.side)

    def limit(self, problem: Problem, z: Contacts, ends: Ends | None) -> PerWhisker | None:
        """Value of the contact's second number, parameter or lean, at which it happens."""
        del problem, z, ends

    def piece(self, state: ContactState, first: TouchAlongX) -> Int[Array, " whiskers"] | None:
        """The piece on which contacts are after it; None if that does not change."""
        del state, first

    def changed(self, which: Which, z: Contacts, state: ContactState, after: After) -> tuple[Contacts, ContactState]:
        """Contacts and their state after it has happened to these whiskers."""
        del which, after
        return z, state

    def lead(self, which: Which, lead: Lead, happened: Happened) -> Lead:
        """The lead, with what `leaves` does not say."""
        del which, happened
        return lead


class Touch(PathEvent):
    """A contact begins. It is solved for as a contact without force."""

    kinds = (EventKind.touch,)
    of_contact = (1.0, 0.0, 0.0)
    leaves = (1.0, 1.0)

    def margin(self, seen):
        standing, first = seen.state.standing, seen.stance.first(seen.state.standing)
        return jnp.where(seen.free & first.reaches, standing * (seen.stance.x - first.x), FAR)

    def rate(self, moving):
        return jnp.where(moving.free, moving.problem.touch_rate(moving.state.standing, moving.pose_rate), 0.0)

    def piece(self, state, first):
        return first.piece

    def changed(self, which, z, state, after):
        return z, state.begun(which, after.phase, after.side, after.piece)


class Release(PathEvent):
    """A contact ends, without force."""

    kinds = (EventKind.release,)
    of_contact = (1.0, 0.0, 0.0)

    def margin(self, seen):
        return jnp.where(seen.free, FAR, seen.z[:, FORCE])

    def rate(self, moving):
        return jnp.where(moving.free, 0.0, moving.z_rate[:, FORCE])

    def changed(self, which, z, state, after):
        z = jnp.where(which[:, None], after.stance.contact_if_free, z)
        return z, state.ended(which, after.stance.side)

    def lead(self, which, lead, happened):
        # In the direction in which the contact would have to pull.
        at, problem = happened.condensed, happened.problem
        by_pose, by_u = _pulling(at)
        pose = jnp.where(which[:, None], by_pose, 0.0)
        if at.coupled is not None and problem.attached is not None and problem.attached.couplings is not None:
            by_loads = -jnp.sum(pose[:, :, None] * at.coupled.pose_by_loads, axis=(0, 1))
            more = as_contacts(problem.attached.couplings, jnp.reshape(by_loads, (-1, 3)), lead.z)
            lead = lead._replace(z=lead.z + more)
        return lead._replace(pose=lead.pose + pose, u=lead.u + jnp.sum(jnp.where(which, by_u, 0.0)))


def _pulling(at: Condensed) -> tuple[Poses, PerWhisker]:
    """Decrease of each contact force per motion of the whisker's base, and per change of the control."""
    by_x = jnp.where(at.by_x == 0, 1.0, at.by_x)[:, None]
    force = at.basis[:, 0, :]
    along = force[:, :1] / by_x
    weight = -jnp.concatenate([along, force[:, 1:] - along * at.pose_by[:, 0, 1:]], axis=1)
    return weight, jnp.zeros_like(by_x[:, 0]) if at.pose_by_u is None else -jnp.sum(weight * at.pose_by_u, axis=1)


class PhaseChange(PathEvent):
    """Tip contact becomes tangential, or the reverse."""

    kinds = (EventKind.tip_to_tangential, EventKind.tangential_to_tip)
    of_contact = (0.0, 0.0, 1.0)
    leaves = (1.0, -1.0)

    def margin(self, seen):
        slack = seen.z[:, SLACK]
        return jnp.where(seen.free, FAR, jnp.where(seen.state.phase == Phase.tip, -slack, slack))

    def rate(self, moving):
        way = jnp.where(moving.state.phase == Phase.tip, -1.0, 1.0)
        return jnp.where(moving.free, 0.0, way * moving.z_rate[:, SLACK])

    def changed(self, which, z, state, after):
        other = jnp.where(state.phase == Phase.tip, Phase.tangential, Phase.tip)
        z = z.at[:, SLACK].set(jnp.where(which, 0.0, z[:, SLACK]))
        return z, state._replace(phase=jnp.where(which, other, state.phase))


class Vertex(PathEvent):
    """A contact passes the lowest point of the object."""

    kinds = (EventKind.vertex,)
    of_slope = 1.0
    continues = True

    def margin(self, seen):
        return jnp.where(seen.free, FAR, seen.ahead)


class Stop(PathEvent):
    """The drive arrives at a stop."""

    kinds = (STOP,)
    of_control = 1.0
    continues = True

    def margin(self, seen):
        return jnp.reshape(seen.remaining, 1)

    def rate(self, moving):
        return jnp.zeros(1)


class Slip(PathEvent):
    """With friction, a contact that stuck begins to slip: its force leans as far as friction lets it."""

    kinds = (EventKind.slip,)
    of_contact = (0.0, 1.0, 0.0)

    def margin(self, seen):
        assert seen.problem.friction_angle is not None
        force, lean = seen.z[:, FORCE], seen.z[:, LEAN]
        # Rounding may make the leans of contacts that stick exceed their limit.
        noise = jnp.minimum(LEAN_NOISE, CONE_NOISE / jnp.maximum(force, CONE_NOISE))
        return jnp.where(seen.state.sticks, seen.problem.friction_angle - jnp.abs(lean) + noise, FAR)

    def rate(self, moving):
        return jnp.where(moving.state.sticks, -jnp.sign(moving.z[:, LEAN]) * moving.z_rate[:, LEAN], 0.0)

    def limit(self, problem, z, ends):
        assert problem.friction_angle is not None
        return jnp.sign(z[:, LEAN]) * problem.friction_angle

    def changed(self, which, z, state, after):
        assert state.friction is not None and after.limit is not None and after.parameters is not None
        slip = jnp.where(which, jnp.sign(after.limit).astype(int), state.friction.slip)
        slipping, state = with_slips(after.problem, z, state, slip, after.parameters)
        return jnp.where(state.free[:, None], z, slipping), state

    def lead(self, which, lead, happened):
        assert happened.state.friction is not None
        slips = happened.state.friction.slip[:, None] * slip_by_contact(happened.problem, happened.z, happened.state)
        return lead._replace(z=lead.z + jnp.where(which[:, None], slips, 0.0))


class _Edge(PathEvent):
    """A contact passes an end of its piece."""

    kinds = (EventKind.edge,)
    of_contact = (0.0, 1.0, 0.0)
    before_release = True  # as on the vertical side of a box
    way: ClassVar[int]  # +1 or -1: to the next piece, or to the one before

    def margin(self, seen):
        distance = self.way * (self.limit(seen.problem, seen.z, seen.ends) - seen.z[:, PARAMETER])
        return jnp.where(seen.free, FAR, distance)

    def rate(self, moving):
        return -self.way * jnp.where(moving.free, 0.0, moving.z_rate[:, PARAMETER])

    def limit(self, problem, z, ends):
        assert ends is not None
        return ends[0] if self.way < 0 else ends[1]

    def piece(self, state, first):
        return None if state.piece is None else state.piece + self.way

    def changed(self, which, z, state, after):
        assert state.piece is not None and after.piece is not None
        return z, state._replace(piece=jnp.where(which, after.piece, state.piece))


class EdgeBelow(_Edge):
    """A contact passes to the piece before."""

    way = -1
    leaves = (-1.0, -1.0)


class EdgeAbove(_Edge):
    """A contact passes to the next piece."""

    way = 1
    leaves = (1.0, 1.0)


Events = tuple[PathEvent, ...]
SMOOTH: Events = (Touch(), Release(), PhaseChange(), Vertex(), Stop())
TOUCH, RELEASE, PHASE, VERTEX, AT_STOP = range(len(SMOOTH))  # their numbers in every tuple of events


def events_of(problem: Problem) -> Events:
    """The kinds of events that the contacts of a problem know."""
    law = SMOOTH
    if problem.friction_angle is not None:
        law += (Slip(),)
    if problem.profile.has_edges:
        law += (EdgeBelow(), EdgeAbove())
    return law


def margins(seen: Seen) -> Margins:
    """Margins at a point."""
    return tuple(event.margin(seen) for event in events_of(seen.problem))


def margin_rates(moving: PathDirection) -> Margins:
    """Derivatives of the margins along the path."""
    return tuple(event.rate(moving) for event in events_of(moving.problem))


class Facts(NamedTuple):
    """Constants of a kind of event."""

    of_contact: Float[Array, "3"]
    of_slope: Scalar
    of_control: Scalar
    continues: Bool[Array, ""]
    leaves: Scalar
    kind: Int[Array, ""]


def facts_of(events: Events, number: Int[Array, ""], tip: Bool[Array, ""] | bool = False) -> Facts:
    """Constants of the kind of event with a number; `tip` tells whether it concerns a tip contact."""
    table = jnp.asarray(np.array([_constants(event) for event in events]))
    row = jax.lax.dynamic_index_in_dim(table, number, keepdims=False)
    leaves, kind = jnp.where(tip, row[6:8], row[8:10])
    return Facts(row[:3], row[3], row[4], row[5] > 0, leaves, kind.astype(int))


def _constants(event: PathEvent) -> list[float]:
    by_phase = zip(event.leaves, (event.kinds[0], event.kinds[-1]), strict=True)
    own = [*event.of_contact, event.of_slope, event.of_control, event.continues]
    return [float(value) for value in [*own, *(value for phase in by_phase for value in phase)]]


def condition_of(facts: Facts, whiskers: Which, like: Contacts, limit: PerWhisker | None, u0: Scalar) -> PathCondition:
    """The condition of an event of these whiskers.

    Args:
        facts: the kind of event.
        whiskers: the whiskers that it concerns.
        like: contacts, of which only the shape is used.
        limit: see `PathEvent.limit`; None if no event has one.
        u0: the control of a stop.
    """
    none, one = jnp.zeros_like(like), whiskers.astype(float)
    z0 = none if limit is None else none.at[:, PARAMETER].set(jnp.where(whiskers, limit, 0.0))
    weight = none.at[:, :3].set(one[:, None] * facts.of_contact)
    return PathCondition(weight, z0, facts.of_control, u0, one * facts.of_slope)


def limit_of(
    events: Events, number: Int[Array, ""], problem: Problem, z: Contacts, ends: Ends | None
) -> PerWhisker | None:
    """The limit of an event; None if no event has one."""
    found = None
    for k, event in enumerate(events):
        limit = event.limit(problem, z, ends)
        if limit is not None:
            found = jnp.where(number == k, limit, 0.0 if found is None else found)
    return found


def number_of(events: Events, kind: Int[Array, ""]) -> Int[Array, ""]:
    """The number of the event of a kind; that of a stop for those that no margin announces."""
    numbers = np.full(len(EventKind), AT_STOP)
    for k, event in enumerate(events):
        numbers[[own for own in event.kinds if own >= 0]] = k
    return jnp.where(kind < 0, AT_STOP, jnp.asarray(numbers)[jnp.maximum(kind, 0)])
