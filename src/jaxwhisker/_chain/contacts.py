"""One whisker and its contacts: a chain of elastica segments, each from one contact towards the base to the next.

A contact is described by z = (force, parameter, slack): the magnitude f >= 0 of the contact force, the parameter of the
object's profile, and the slack. At the tip, the slack is negative: minus the angle between the whisker and the object's
tangent. Elsewhere it is positive: the arc length of the whisker beyond the contact. Contacts are ordered from the tip
to the base, and places that are not used follow. Only the outermost contact may be at the tip.

Between two contacts nothing acts on the whisker. The internal force is therefore the sum R of the contact forces
beyond, and the moment is known wherever the shaft passes:

    EI (kappa - kappa0) = A - x R_y + y R_x,    A = sum of (c_x F_y - c_y F_x) over the contacts c beyond.

Each segment is integrated from the contact itself. At its other end, it must meet the next contact and be parallel to
the object there, or it ends at the base.

With friction, contact forces lean away from the object's normal (see friction.py of the equilibria). The lean of a
contact that sticks is unknown. Among its numbers it takes the place of what sticking fixes: of the parameter, which
follows from rolling, and of the slack where a corner of an object sticks to the shaft. A tip in an inner corner cannot
slip: its force may lean as far as both faces allow, and its numbers are those without friction.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._equilibrium.contact import (
    FORCE,
    PARAMETER,
    SLACK,
    Base,
    Phase,
    WhiskerAtObject,
    across_force,
    in_base_frame,
    material_of,
)
from jaxwhisker._equilibrium.friction import Friction, rolled, slipping_from
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.profile import ContactPoint
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Load, RodStates, Section, moment

Places = tuple[Float[Array, "*batch contacts"], Float[Array, "*batch contacts"]]  # parameter, beyond: see Friction
PerContact = Float[Array, "*batch contacts"]
Points = Float[Array, "segments ends"]  # at the ends of integration steps

MORE_STEPS = 1.5  # steps of a segment, relative to those of a whole rod: they are shorter near its ends


class ChainState(NamedTuple):
    """How each contact touches: of one whisker, or of all whiskers one after the other."""

    phase: Int[Array, "*batch contacts"]
    side: (
        PerContact  # +1 where the whisker runs along the object's tangent from base to tip, -1 where it runs against it
    )
    piece: Int[Array, "*batch contacts"]  # of the profile
    friction: Friction | None = None  # None without friction; a tip in an inner corner does not slip

    @property
    def touches(self) -> Bool[Array, "*batch contacts"]:
        """Whether the places are used."""
        return self.phase != Phase.free

    @property
    def places(self) -> Places | None:
        """Where contacts began to stick; None without friction."""
        return None if self.friction is None else self.friction[1:]

    def stuck_at(self, places: Places | None) -> "ChainState":
        """The state of contacts that began to stick at these places; None without friction."""
        if self.friction is None or places is None:
            return self
        return self._replace(friction=Friction(self.friction.slip, *places))


class Segments(NamedTuple):
    """A whisker from its contacts on; fields (contacts, ...)."""

    parameter: PerContact  # of the object, at the contact
    contact: ContactPoint
    beyond: PerContact  # arc length of the whisker beyond the contact; all of it for places that are not used
    start: RodStates
    load: Load  # on the segment
    arc: PerContact  # length of the segment


def unused(rows: int, *, friction: bool) -> ChainState:
    """Places without contacts."""
    side = jnp.ones(rows)
    return ChainState(
        jnp.full(rows, int(Phase.free)), side, jnp.zeros(rows, int), slipping_from(side) if friction else None
    )


class HeldByFriction(NamedTuple):
    """How contacts are held by friction and by corners."""

    sticks: Bool[Array, " contacts"]  # by friction alone
    at_corner: Bool[Array, " contacts"]  # whether a corner of an object sticks to the shaft
    pinned: Bool[Array, " contacts"]  # whether a tip is in an inner corner

    @property
    def rolls(self) -> Bool[Array, " contacts"]:
        """Whether the lean takes the place of the parameter."""
        return self.sticks & ~self.at_corner


def held_of(profile: Objects, state: ChainState) -> HeldByFriction:
    """How contacts are held, with friction."""
    assert state.friction is not None
    if not profile.has_edges:
        none = jnp.zeros_like(state.touches)
        return HeldByFriction(state.touches & (state.friction.slip == 0), none, none)
    signs = corner_signs(profile)[jnp.where(state.touches, state.piece, 0)]
    pinned = (state.phase == Phase.tip) & (signs < 0)
    sticks = state.touches & (state.friction.slip == 0) & ~pinned
    return HeldByFriction(sticks, sticks & (signs > 0), pinned)


def parameter_of(profile: Objects, z: Float[Array, "contacts 3"], state: ChainState) -> Float[Array, " contacts"]:
    """Parameter of the object at contacts, of one whisker or of all."""
    parameter, slack, friction = z[:, PARAMETER], z[:, SLACK], state.friction
    if friction is None:
        return parameter
    held, placeholders = held_of(profile, state), profile.placeholder_parameter
    assert placeholders is not None
    # Corners have no length: contacts that do not roll take a smooth piece instead.
    smooth = 1 if profile.objects[0].has_edges else 0
    piece = jnp.where(held.rolls, state.piece, smooth)
    start = jnp.where(held.rolls, friction.parameter, placeholders[0])
    beyond = jnp.where(state.phase == Phase.tangential, slack, 0.0)
    way = jnp.where(held.rolls, state.side * (friction.beyond - beyond), 0.0)
    rolling = jax.vmap(lambda piece, start, way: rolled(profile.on(piece), start, way))(piece, start, way)
    return jnp.where(held.rolls, rolling, parameter)


def slack_of(profile: Objects, z: Float[Array, "contacts 3"], state: ChainState) -> Float[Array, " contacts"]:
    """Slack of the whisker at contacts, of one whisker or of all."""
    if state.friction is None:
        return z[:, SLACK]
    return jnp.where(held_of(profile, state).at_corner, state.friction.beyond, z[:, SLACK])


def lean_of(
    profile: Objects, friction_angle: Scalar | None, z: Float[Array, "contacts 3"], state: ChainState
) -> Float[Array, " contacts"] | None:
    """Lean of the forces of contacts, of one whisker or of all; None without friction."""
    if state.friction is None or friction_angle is None:
        return None
    held = held_of(profile, state)
    slipping = jnp.where(held.pinned, 0.0, state.friction.slip * friction_angle)
    return jnp.where(held.at_corner, z[:, SLACK], jnp.where(held.rolls, z[:, PARAMETER], slipping))


def objects_of_body(body: WhiskerAtObject) -> Objects:
    """The objects before a whisker, also if there is only one."""
    assert isinstance(body.profile, Objects)
    return body.profile


def chain_of(body: WhiskerAtObject, z: Float[Array, "contacts 3"], state: ChainState) -> Segments:
    """The segments of a whisker with these contacts, and the loads on them."""
    touches, profile = state.touches, objects_of_body(body)
    assert profile.placeholder_parameter is not None
    piece = jnp.where(touches, state.piece, 0)
    parameter = jnp.where(touches, parameter_of(profile, z, state), profile.placeholder_parameter[0])
    slack, lean = slack_of(profile, z, state), lean_of(profile, body.friction_angle, z, state)
    at = jax.vmap(body.profile.point_on)(piece, parameter)
    tip = state.phase == Phase.tip
    angle = jnp.where(tip, -slack, 0.0)
    beyond = jnp.where(touches, jnp.where(tip, 0.0, slack), body.length)
    cos, sin = state.side * jnp.cos(angle), jnp.sin(angle)
    direction = at.cos * cos - at.sin * sin, at.sin * cos + at.cos * sin
    force = jnp.where(touches, z[:, FORCE], 0.0)
    across_cos, across_sin = across_force(at, lean)
    fx, fy = force * across_sin, -force * across_cos
    load = Load(jnp.cumsum(fx), jnp.cumsum(fy), jnp.cumsum(at.x * fy - at.y * fx))
    arc = jnp.append(beyond[1:], body.length) - beyond
    return Segments(parameter, at, beyond, (at.x, at.y, *direction), load, arc)


def step_count(body: WhiskerAtObject) -> int:
    """Number of integration steps of a segment."""
    steps = int(np.ceil(MORE_STEPS * getattr(body.rod, "steps", 8)))
    return steps if body.section is None else 2 * steps


def fractions(steps: int) -> np.ndarray:
    """Ends of the integration steps of a segment, closer together near its ends, where new contacts begin."""
    return (1 - np.cos(np.pi * np.arange(steps + 1) / steps)) / 2


def segments(
    body: WhiskerAtObject, starts: RodStates, loads: Load, arcs: Array, from_base: Array
) -> tuple[Points, Points, Points, Points]:
    """States at the ends of all integration steps of some segments; fields (segments, points)."""
    material, times = material_of(body), jnp.asarray(fractions(step_count(body)))

    def one(start, load, arc, from_base):
        at = times
        if isinstance(material, Section):
            at = rod.graded(times, material.stiffness(from_base), material.stiffness(from_base - arc))
        return rod.points(start, arc, load, material, at=at, from_base=from_base)

    return jax.vmap(one)(starts, loads, arcs, from_base)


def ends_of(body: WhiskerAtObject, chain: Segments) -> RodStates:
    """States at the ends of all segments; fields (contacts,)."""
    material = material_of(body)
    if isinstance(material, Section):
        states = segments(body, chain.start, chain.load, chain.arc, body.length - chain.beyond)
        return jax.tree.map(lambda leaf: leaf[:, -1], states)

    def one(start, load, arc):
        x, y, cos, sin = start
        fx, fy = load.force_x, load.force_y
        bends = jnp.stack([jnp.asarray(moment(x, y, load)), fx * cos + fy * sin, fy * cos - fx * sin])
        bends = bends / jnp.asarray(material)
        along, across, turned_cos, turned_sin = _uniform_end(bends, arc, step_count(body))
        ends = x + along * cos - across * sin, y + along * sin + across * cos
        return *ends, cos * turned_cos - sin * turned_sin, sin * turned_cos + cos * turned_sin

    return jax.vmap(one)(chain.start, chain.load, chain.arc)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _uniform_end(bends: Float[Array, "3"], arc: Scalar, steps: int) -> Float[Array, "4"]:
    """The end of a uniform segment in the frame of its start.

    `bends` are the moment and the force at the start, along and across the segment, divided by EI. Derivatives need
    only three tangents through the integration, for any number of contacts.
    """
    return _integrated(bends, arc, steps)


def _integrated(bends: Float[Array, "3"], arc: Scalar, steps: int) -> Float[Array, "4"]:
    load = Load(bends[1], bends[2], bends[0])
    ends = rod.points((0.0, 0.0, 1.0, 0.0), arc, load, None, at=jnp.asarray(fractions(steps)))
    return jnp.stack([leaf[-1] for leaf in ends])


@_uniform_end.defjvp
def _(steps, primals, tangents):
    bends, arc = primals
    by_bends, end = jax.jacfwd(lambda bends: (_integrated(bends, arc, steps),) * 2, has_aux=True)(bends)
    x, y, cos, sin = end
    turn = bends[0] - x * bends[2] + y * bends[1]
    by_arc = jnp.stack([-cos, -sin, turn * sin, -turn * cos])
    return end, jnp.sum(by_bends * tangents[0], axis=1) + by_arc * tangents[1]


class ChainEquations(NamedTuple):
    """What enters the equations of a whisker."""

    own: Float[Array, "contacts 3"]  # residuals, but in the row of the last contact the pose of the base in its frame
    load: Float[Array, "3"]  # on the base, in its frame: force x, force y, moment
    base: Base
    backwards: Bool[Array, ""]  # whether the whisker runs the wrong way at a contact
    chain: Segments


def last_contact(touches: Bool[Array, " contacts"]) -> Bool[Array, " contacts"]:
    """One-hot: the contact that is nearest to the base; none of a free whisker."""
    return touches & ~jnp.append(touches[1:], False)


def equations(body: WhiskerAtObject, z: Float[Array, "contacts 3"], state: ChainState) -> ChainEquations:
    """The equations of a whisker with these contacts."""
    chain = chain_of(body, z, state)
    x, y, cos, sin = ends_of(body, chain)
    at, last = chain.contact, last_contact(state.touches)

    def at_next(values: Array) -> Array:
        return jnp.roll(values, -1)

    side = at_next(state.side)
    along_cos, along_sin = side * at_next(at.cos), side * at_next(at.sin)
    meets = jnp.stack([x - at_next(at.x), y - at_next(at.y), along_cos * sin - along_sin * cos], axis=1)
    inner = state.touches & ~last
    backwards = jnp.any(inner & (along_cos * cos + along_sin * sin <= 0))

    def of_last(values: Array) -> Array:
        return jnp.sum(jnp.where(last, values, 0.0))

    load = Load(*(of_last(jnp.asarray(part)) for part in (chain.load.force_x, chain.load.force_y, chain.load.moment)))
    base_x, base_y, upwards, zero = of_last(x), of_last(y), of_last(sin), jnp.zeros(())
    upwards = jnp.where(jnp.any(last), upwards, 1.0)  # free whiskers stand upright here
    reaction = jnp.asarray(load.force_x), jnp.asarray(load.force_y), jnp.asarray(moment(base_x, base_y, load))
    base = Base(base_x, base_y, of_last(cos), upwards, *reaction, zero, zero, zero, zero)
    in_frame = in_base_frame(body, base)
    pose = jnp.stack([in_frame.x, in_frame.y, in_frame.turn])
    own = jnp.where(last[:, None], pose, jnp.where(inner[:, None], meets, z))
    on_base = jnp.stack([in_frame.force_x, jnp.asarray(in_frame.force_y), jnp.asarray(in_frame.moment)])
    return ChainEquations(own, jnp.where(jnp.any(last), on_base, 0.0), base, backwards, chain)
