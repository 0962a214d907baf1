"""One whisker in contact: from the unknowns at the contact to the pose of the base and the load on it.

A contact is described by z = (force, parameter, slack): the magnitude f >= 0 of the contact force, the parameter of the
profile at the contact point (of a contact that sticks, the lean of the force: see friction.py), and the slack. In
tangential contact the slack is positive: the arc length of the whisker beyond the contact. In tip contact it is
negative: minus the angle between whisker and object. Both phases share one system of equations, smooth within each
phase and regular at first touch (f = 0) and at a change of phase. The rod is integrated in the frame of the contact
force. A whisker that approaches from the left (side = -1) bends the other way: it is computed as a mirror image.

Springs on its shaft may bend a free whisker. It is then described by the pose of its tip in the drive's frame: position
x, y, and the angle to the upright. If springs connect the shafts of two whiskers, their loads follow (couplings.py).
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int

from jaxwhisker._base.program import is_array
from jaxwhisker._base.types import NamedInt, Scalar
from jaxwhisker._equilibrium.couplings import moved
from jaxwhisker._equilibrium.friction import Friction, contact_parameter, lean
from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws, base_of_walk
from jaxwhisker._model.motion import Frame
from jaxwhisker._model.profile import AbstractProfile, ContactPoint
from jaxwhisker._rod.elastica import AbstractRod, rod_end, uneven_rod_end
from jaxwhisker._rod.rod import Load, Material, RodState, Section, moment
from jaxwhisker._rod.walk import pressed

FORCE, PARAMETER, SLACK = range(3)  # numbers of a contact z
LEAN = PARAMETER  # of a contact that sticks


class Phase(NamedInt):
    """Contact phase of a whisker."""

    free = 0
    tip = 1
    tangential = 2


class WhiskerAtObject(NamedTuple):
    """A whisker and the object in front of it, dimensionless; or all whiskers, stacked (see `of_each`)."""

    length: Float[Array, "*batch"]
    bending_stiffness: Float[Array, "*batch"]  # at the base
    profile: AbstractProfile
    rod: AbstractRod
    section: Section | tuple[Section, ...] | None = None  # None if uniform; a tuple for whiskers of different kinds
    frame: Frame | None = None  # of the base's mount on the drive; None if bases stay upright and move along x only
    frame_rate: Frame | None = None  # derivative of the frame with respect to the control
    friction_angle: Float[Array, "*batch"] | None = None  # None without friction
    piece: Int[Array, "*batch"] | None = None  # of the profile at the contact; None without edges
    sprung: "Sprung | None" = None  # None without springs on any shaft
    laws: Laws = ()  # of such springs, for all whiskers


class Sprung(NamedTuple):
    """What a whisker with springs on its shaft needs to know."""

    held_by: Attachments
    drive: Frame
    drive_rate: Frame  # derivative with respect to the control
    held: Float[Array, "*batch axes axes"]  # stiffness of the network that the support does not have
    offset: Float[Array, "*batch axes"]  # coordinates at which it is unstrained
    placeholder_parameter: Float[Array, "*batch"]  # any parameter of the profile, for free whiskers
    incidence: Float[Array, "*batch places springs"] | None = None  # see couplings.incidence_of; None without couplings


class Base(NamedTuple):
    """Pose of the base, load on it, and the contact point, in the scene; dimensionless."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]  # direction of the whisker at its base
    sin: Float[Array, "*batch"]
    force_x: Float[Array, "*batch"]  # of the object, and of springs on the shaft above the base, on the whisker
    force_y: Float[Array, "*batch"]
    bend: Float[Array, "*batch"]  # EI (kappa - kappa0) at the base
    slope_sin: Float[Array, "*batch"]  # of the object at the contact
    slope_cos: Float[Array, "*batch"]
    contact_x: Float[Array, "*batch"]  # contact point
    contact_y: Float[Array, "*batch"]
    # Force x, y and moment about the base of springs at the base and on the follicle; None without springs on shafts.
    below: tuple[Float[Array, "*batch"], Float[Array, "*batch"], Float[Array, "*batch"]] | None = None
    places: Float[Array, "*batch places 3"] | None = None  # see couplings.Places; None without couplings


class BaseEquations(NamedTuple):
    """Quantities that enter the equilibrium equations, in the base's frame: values or derivatives.

    For a base that moves along x only, the frame is that of the scene, and `turn` is the sine of the base's angle.
    """

    x: Float[Array, "*batch"]  # pose of the base
    y: Float[Array, "*batch"]
    turn: Float[Array, "*batch"]  # angle to the frame's y axis, counter-clockwise
    force_x: Float[Array, "*batch"]  # on the base by all but the network, and moment about the base
    force_y: Float[Array, "*batch"] | None  # None where the scene does not need it
    moment: Float[Array, "*batch"] | None
    slope_sin: Float[Array, "*batch"]  # of the object at the contact, in the scene
    places: Float[Array, "*batch places 3"] | None = None  # of springs; None without couplings


class LinearisedEquations(NamedTuple):
    """The equations of a whisker, and their derivatives, whose last axis is that of what they are taken by."""

    value: BaseEquations
    by_contact: BaseEquations  # shape (3,)
    by_u: BaseEquations | None  # by the control; None if the frame does not move
    by_loads: BaseEquations | None = None  # by the loads of all springs between two shafts; None without any


def beyond(slack: Scalar | Float[Array, "*batch"], phase: Int[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Arc length of the whisker beyond the contact."""
    return jnp.where(phase == Phase.tangential, slack, 0.0)


def arc(body: WhiskerAtObject, slack: Scalar, phase: Int[Array, ""]) -> Float[Array, ""]:
    """Arc length from base to contact."""
    return body.length - beyond(slack, phase)


def parameter(
    profile: AbstractProfile,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None,
) -> Scalar:
    """The profile's parameter at the contact z."""
    known = z[PARAMETER]
    return known if friction is None else contact_parameter(profile, known, beyond(z[SLACK], phase), side, friction)


def across_force(
    at: ContactPoint, leans: Float[Array, "*batch"] | None
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Cosine and sine of the direction normal to the contact force: without friction, that of the object."""
    if leans is None:
        return at.cos, at.sin
    cos, sin = jnp.cos(leans), jnp.sin(leans)
    return at.cos * cos + at.sin * sin, at.sin * cos - at.cos * sin


def in_scene(
    at: ContactPoint, leans: Float[Array, ""] | None, end: Float[Array, "4 *points"], force: Scalar, side: Scalar
) -> Base:
    """Pose of the base and load on it, from the rod's end in the frame of the contact; or poses of several points."""
    x, y, cos, sin = end
    x, cos = side * x, side * cos
    along_cos, along_sin = across_force(at, leans)
    return Base(
        x=at.x + x * along_cos - y * along_sin,
        y=at.y + x * along_sin + y * along_cos,
        cos=cos * along_cos - sin * along_sin,
        sin=cos * along_sin + sin * along_cos,
        force_x=force * along_sin,
        force_y=-force * along_cos,
        bend=force * x,
        slope_sin=at.sin,
        slope_cos=at.cos,
        contact_x=at.x,
        contact_y=at.y,
    )


def base(
    body: WhiskerAtObject,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None = None,
    *,
    rates: AbstractRod | None = None,
) -> Base:
    """Pose of the base and load on it for the contact z; the rod method `rates` computes the derivatives."""
    rates = body.rod.for_rates() if rates is None else rates
    if body.sprung is not None:
        return _sprung_base(body, body.sprung, z, phase, side, friction, rates)
    at, leans, angle = contact_of(body, z, phase, side, friction)
    s = arc(body, z[SLACK], phase)
    if body.section is None:
        end = rod_end(z[FORCE] / body.bending_stiffness, s, angle, body.rod, rates)
    else:
        assert isinstance(body.section, Section)  # of one whisker
        section = dataclasses.replace(body.section, orientation=side)
        end = uneven_rod_end(z[FORCE], s, angle, section, body.rod, rates)
    return in_scene(at, leans, end, z[FORCE], side)


def contact_of(
    body: WhiskerAtObject, z: Float[Array, " numbers"], phase: Int[Array, ""], side: Scalar, friction: Friction | None
) -> tuple[ContactPoint, Float[Array, ""] | None, Float[Array, ""]]:
    """The contact point, the lean of the force, and the angle of the whisker to the normal of the force there."""
    angle = jnp.where(phase == Phase.tip, -z[SLACK], 0.0)
    p = parameter(body.profile.on(body.piece), z, phase, side, friction)
    if body.sprung is not None:
        p = jnp.where(phase == Phase.free, body.sprung.placeholder_parameter, p)
    leans = lean(z[LEAN], friction, body.friction_angle)
    return body.profile.point_on(body.piece, p), leans, angle if leans is None else angle + side * leans


def material_of(body: WhiskerAtObject) -> Material:
    """The material of a whisker in the scene."""
    assert not isinstance(body.section, tuple)  # of one whisker
    return body.bending_stiffness if body.section is None else body.section


def start_of(
    body: WhiskerAtObject,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None = None,
) -> tuple[RodState, Load, Base]:
    """State of the rod and the load on it, at the contact or at the tip of a free whisker; and the contact."""
    assert body.sprung is not None
    at, leans, angle = contact_of(body, z, phase, side, friction)
    zero, free, drive = jnp.zeros_like(z[FORCE]), phase == Phase.free, body.sprung.drive
    placed = in_scene(at, leans, jnp.stack([zero, zero, jnp.cos(angle), jnp.sin(angle)]), z[FORCE], side)
    cos, sin = -jnp.sin(z[2]), jnp.cos(z[2])
    tip = (
        drive.x + z[0] * drive.cos - z[1] * drive.sin,
        drive.y + z[0] * drive.sin + z[1] * drive.cos,
        cos * drive.cos - sin * drive.sin,
        cos * drive.sin + sin * drive.cos,
    )
    start = (placed.x, placed.y, placed.cos, placed.sin)
    start = jax.tree.map(lambda a, b: jnp.where(free, a, b), tip, start)
    force_x, force_y = (jnp.where(free, 0.0, force) for force in (placed.force_x, placed.force_y))
    load, weight = pressed(start[:2], force_x, force_y), body.sprung.held_by.weight
    if weight is not None:
        section, steps = material_of(body), getattr(body.rod, "steps", None)
        assert isinstance(section, Section) and isinstance(steps, int)
        carried = weight.beyond(start, arc(body, z[SLACK], phase), body.length, section, steps=steps)
        load = jax.tree.map(jnp.add, load, carried)
    return start, load, placed


def _sprung_base(
    body: WhiskerAtObject,
    sprung: Sprung,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None,
    rates: AbstractRod,
) -> Base:
    start, load, placed = start_of(body, z, phase, side, friction)
    s = arc(body, z[SLACK], phase)
    given = start, load, s, material_of(body), sprung.held_by, body.laws, sprung.drive, body.rod, rates
    (x, y, cos, sin), total, above, places = base_of_walk(*given)
    below = jax.tree.map(jnp.subtract, total, above)
    carried = above.force_x, above.force_y, moment(x, y, above)
    fx, fy, bend = map(jnp.asarray, carried)
    below = jnp.asarray(below.force_x), jnp.asarray(below.force_y), jnp.asarray(moment(x, y, below))
    return placed._replace(x=x, y=y, cos=cos, sin=sin, force_x=fx, force_y=fy, bend=bend, below=below, places=places)


def in_base_frame(body: WhiskerAtObject, b: Base) -> BaseEquations:
    """Pose of a base and load on it, in its frame."""
    frame = body.frame
    if frame is None:
        return BaseEquations(b.x, b.y, -b.cos, b.force_x, None, None, b.slope_sin)
    x, y, cos, sin = b.x - frame.x, b.y - frame.y, frame.cos, frame.sin
    values = BaseEquations(
        x=x * cos + y * sin,
        y=y * cos - x * sin,
        turn=jnp.arctan2(-b.cos * cos - b.sin * sin, b.sin * cos - b.cos * sin),
        force_x=b.force_x * cos + b.force_y * sin,
        force_y=b.force_y * cos - b.force_x * sin,
        moment=b.bend,
        slope_sin=b.slope_sin,
    )
    if body.sprung is None or b.below is None:
        return values
    # What the network holds without the support is taken off the load: neither changes the equilibrium.
    moved = jnp.stack([values.x, values.y, values.turn]) - body.sprung.offset
    below_x, below_y, turn = b.below
    below = jnp.stack([below_x * cos + below_y * sin, below_y * cos - below_x * sin, turn])
    load = jnp.stack(values[3:6]) + below + jnp.sum(body.sprung.held * moved, axis=-1)  # pyright: ignore
    return values._replace(force_x=load[0], force_y=load[1], moment=load[2], places=b.places)


def equations(
    body: WhiskerAtObject,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None = None,
) -> BaseEquations:
    """Quantities that enter the equations, for the contact z."""
    return in_base_frame(body, base(body, z, phase, side, friction))


def linearise(
    body: WhiskerAtObject,
    z: Float[Array, " numbers"],
    phase: Int[Array, ""],
    side: Scalar,
    friction: Friction | None = None,
    *,
    rates: AbstractRod,
) -> LinearisedEquations:
    """Linearise the equations of a whisker about the contact z."""

    def value_and_value(z, body=body):
        b = base(body, z, phase, side, friction, rates=rates)
        value = in_base_frame(body, b)
        return value, (value, b)

    if body.sprung is not None:
        # The load depends on the control, too.
        loads = 0 if body.sprung.incidence is None else 3 * body.sprung.incidence.shape[-1]
        gradient, (value, _) = jax.jacfwd(
            lambda at: value_and_value(at[:3], _moved(body, at[3], at[4:])), has_aux=True
        )(jnp.concatenate([z[:3], jnp.zeros(1 + loads)]))
        parts = [slice(3), 3, *([slice(4, None)] if loads else [])]
        return LinearisedEquations(
            value, *(jax.tree.map(lambda leaf, part=part: leaf[..., part], gradient) for part in parts)
        )
    gradient, (value, b) = jax.jacfwd(value_and_value, has_aux=True)(z)
    if body.frame_rate is None:
        return LinearisedEquations(value, gradient, None)
    _, by_control = jax.jvp(
        lambda frame: in_base_frame(body._replace(frame=frame), b), (body.frame,), (body.frame_rate,)
    )
    return LinearisedEquations(value, gradient, by_control)


def _moved(body: WhiskerAtObject, step: Scalar, loads: Float[Array, " loads"]) -> WhiskerAtObject:
    """The body after a change of the control and of the loads of springs to other whiskers, to first order."""
    assert body.sprung is not None
    held_by, incidence = body.sprung.held_by, body.sprung.incidence
    if held_by.given is not None and incidence is not None:
        held_by = held_by._replace(given=held_by.given + moved(incidence, loads))

    def ahead(frame: Frame | None, rate: Frame | None) -> Frame | None:
        return jax.tree.map(lambda a, b: a + step * b, frame, rate)

    drive = ahead(body.sprung.drive, body.sprung.drive_rate)
    return body._replace(
        frame=ahead(body.frame, body.frame_rate), sprung=body.sprung._replace(held_by=held_by, drive=drive)
    )


def of_each(bodies: WhiskerAtObject, function: Callable, *args, sequential: bool = False):
    """Apply a function of one body to every whisker; each whisker gets its own row of the arguments.

    Args:
        bodies: all whiskers.
        function: takes a body and a row of each argument.
        *args: leading axis: whiskers.
        sequential: in a batch, whether to compute one whisker after the other. Arrays of lanes alone are twice as fast
            as arrays of lanes and whiskers, but this has no derivatives in reverse mode.
    """
    section = bodies.section
    if not isinstance(section, tuple):
        own, own_rest = eqx.partition((bodies._replace(profile=None, rod=None, laws=()), args), is_array)
        shared, shared_rest = eqx.partition((bodies.profile, bodies.rod, bodies.laws), is_array)

        def one(own, shared):
            body, rest = eqx.combine(own, own_rest)
            profile, rod, laws = eqx.combine(shared, shared_rest)
            return function(body._replace(profile=profile, rod=rod, laws=laws), *rest)

        each = jax.vmap(one, in_axes=(0, None))
        return (_sequential(one, each) if sequential and bodies.length.shape[0] > 1 else each)(own, shared)
    # Whiskers of different kinds cannot be batched: each is computed separately.
    values = []
    for k, own in enumerate(section):
        shared = bodies._replace(profile=None, rod=None, section=None, laws=())
        body = jax.tree.map(lambda leaf, k=k: leaf[k], shared)
        body = body._replace(profile=bodies.profile, rod=bodies.rod, section=own, laws=bodies.laws)
        values.append(function(body, *jax.tree.map(lambda leaf, k=k: leaf[k], args)))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *values)


def _sequential(one: Callable, each: Callable) -> Callable:
    """`each`, which applies `one` to every whisker, but in a batch as a loop over whiskers."""
    whole = custom_vmap(each)

    @whole.def_vmap
    def _(_, batched, own, shared):
        lanes = jax.vmap(one, in_axes=jax.tree.map(lambda mapped: 0 if mapped else None, tuple(batched)))
        own = jax.tree.map(lambda leaf, mapped: jnp.swapaxes(leaf, 0, 1) if mapped else leaf, own, batched[0])
        results = jax.lax.map(lambda own: lanes(own, shared), own)
        return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), results), jax.tree.map(lambda _: True, results)

    return whole
