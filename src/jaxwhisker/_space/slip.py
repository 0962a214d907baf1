"""How contacts move over the surface: they do not (without friction), stick, slip, or flow after a loss of stability.

A point of contact of the whisker's material moves by dp + t d(arc beyond it), with the contact point p and the tangent
t. Slipping contacts move against their traction, which is mu f. Sticking ones do not move, but may roll.

The direction of slip has a history, and its equation is stiff: it is integrated implicitly, with Radau's method. A step
along the path has several stages, points of the path between its start and its end. A polynomial runs through all of
them, and at each stage its rate satisfies the law of the contact. This needs nothing before the start of a step:
corners of the path are no special case.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, dot, scale_of
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._space.contact import AHEAD, FORCE, POINT, SLACK, TRACTION, Traction, frame_of
from jaxwhisker._space.linear import Linear
from jaxwhisker._space.problem import Contacts, SpaceProblem

STAGES = 5  # of a step; with three, paths of the same accuracy need four times as many nodes
FAINT = 1e-6  # EI/L^2: less friction does not bend a whisker, and its direction has no rate
FELT = 0.1  # EI/L^2: the direction of smaller friction matters less
RELAXATION = 1e-6  # arc length of the path: directions of slip that relax faster have no rate of their own
FOLLOWING = 0.01  # lengths, for which a traction of mu f counts as much as the place of a contact
Pair = Float[Array, "2"]  # along the whisker, and across


class SlipMode(IntEnum):
    """What a contact does while the drive moves."""

    slips = 0
    sticks = 1
    waits = 2  # its traction is given


class SpaceContactState(NamedTuple):
    """How each whisker touches the object, or that it is free, and with friction what its contact does."""

    phase: Int[Array, "*batch whiskers"]
    mode: Int[Array, "*batch whiskers"] | None = None  # SlipMode; None without friction


class SlipState(NamedTuple):
    """What the march knows of contacts that stick or slip, besides what they do."""

    changes: Int[Array, ""]  # of modes at a corner of the path, so far
    at_corner: Bool[Array, ""]  # whether the last node is one
    begins: Bool[Array, " whiskers"]  # whether a contact has just begun: the direction of its traction is a guess
    guess: Int[Array, ""]  # number of this guess


class ContactMotion(NamedTuple):
    """How contacts move from the start of a step to its stages."""

    start: Contacts
    traction: Traction
    time: Scalar  # length of a step of the flow
    mode: Int[Array, " whiskers"] | None = None  # this and what follows: None without friction
    waits: Bool[Array, " whiskers"] | None = None  # whether tractions are given, whatever the mode
    given: Float[Array, "whiskers 2"] | None = None  # these tractions
    # Weights, in the condition of a step, of how far a traction is beyond mu f, and of its power.
    cone: Float[Array, " whiskers"] | None = None
    power: Float[Array, " whiskers"] | None = None
    turn: Scalar | None = None  # the same of the rate of the control at the end of the step
    # The start is where contacts are known to be nearly, and this length weighs their tractions; otherwise None.
    follows: Scalar | None = None


def following(z: Contacts, friction: Scalar, mode: Int[Array, " whiskers"]) -> ContactMotion:
    """The motion of contacts that are known to be nearly there."""
    none, plain = jnp.zeros(mode.size), Traction(friction, jnp.asarray(False))
    return ContactMotion(z, plain, none[0], mode, mode < 0, z[:, TRACTION], none, none, None, jnp.asarray(FOLLOWING))


def radau(stages: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the stages of Radau's method in a step, and the rates there of the polynomial through all points.

    The rates have one row for the start, and one for each stage; and one column for each stage, as the polynomial is
    measured from the start.
    """
    x = np.polynomial.Polynomial([0.0, 1.0])
    places = np.sort((x ** (stages - 1) * (x - 1) ** stages).deriv(stages - 1).roots().real)
    powers = np.arange(1, stages + 1)
    rates = powers * np.append(0.0, places)[:, None] ** (powers - 1)
    return places, rates @ np.linalg.inv(places[:, None] ** powers)


def stages_of(problem: SpaceProblem) -> int:
    """Number of stages of a step: one is enough without friction, where nothing has a history."""
    return 1 if problem.friction is None else STAGES


class Laws(NamedTuple):
    """The laws of the contacts, linearised about the stages of a step."""

    residual: Float[Array, "stages whiskers 2"]
    by: Float[Array, "stages whiskers 2 stages steps"]  # with respect to the steps of all stages
    rates: Float[Array, "whiskers 2 steps"]  # at the last stage: vanish along the tangent of the path
    missed: Scalar  # of the condition
    missed_by: Float[Array, "stages whiskers steps"]


def laws_of(motion: ContactMotion, z: Array, phase: Array, at: Linear, rates: np.ndarray) -> Laws:
    """The laws of all contacts, which are linearised at all stages; `rates` are those of the polynomial there."""
    stages, axis = len(rates), None if motion.mode is None else 0

    def one(z, phase, at, start, mode, waits, given, cone, power):
        moves, moves_by, unit_by = _movement(z, start, phase, at, rates)
        traction, force, friction = z[:, TRACTION], z[:, FORCE], motion.traction.friction
        last = mode
        if friction is not None:
            last = jnp.where(force[-1] * friction < FAINT, int(SlipMode.waits), mode)
            mode = jnp.where(waits, int(SlipMode.waits), mode)

        def residual(mode, *contact):
            return _law(motion, mode, given, *contact)

        def slopes(mode, *contact):
            by_moves, by_traction, by_force = jax.jacfwd(residual, (1, 2, 3))(mode, *contact)
            return by_moves, jnp.concatenate([by_traction, by_force[:, None]], axis=1)

        def times(by_moves, by_own, moves_by, own_by):
            """Derivatives by all steps; those of tractions and force by the steps of their stage only."""
            return jnp.sum(by_moves[:, :, None] * moves_by, axis=1), jnp.sum(by_own[:, :, None] * own_by, axis=1)

        own_by = jnp.concatenate([at.directions[:, TRACTION], at.directions[:, FORCE, None]], axis=1)
        by_moves, by_own = jax.vmap(slopes, (None, 0, 0, 0))(mode, moves, traction, force)
        through_moves, through_own = jax.vmap(times)(by_moves, by_own, jnp.reshape(moves_by, (stages, 2, -1)), own_by)
        by = jnp.reshape(through_moves, moves_by.shape) + np.eye(stages)[:, None, :, None] * through_own[:, :, None]
        # The law of a path's tangent is that of a contact that moves little. How fast a direction of slip relaxes is
        # not resolved.
        still = slopes(last, -RELAXATION * traction[-1], traction[-1], force[-1])
        along_tangent = jnp.add(*times(*still, unit_by, own_by[-1]))
        value = jax.vmap(residual, (None, 0, 0, 0))(mode, moves, traction, force)
        if cone is None or power is None:
            return value, by, along_tangent, jnp.zeros(()), jnp.zeros_like(own_by[:, 0])
        missed = cone * (jnp.sum(traction[-1] ** 2) - 1) / 2 + power * jnp.sum(traction[-1] * moves[-1])
        missed_by = power * jnp.sum(traction[-1][:, None, None] * moves_by[-1], axis=0)
        by_own = jnp.sum((cone * traction[-1] + power * moves[-1])[:, None] * own_by[-1, :2], axis=0)
        return value, by, along_tangent, missed, missed_by.at[-1].add(by_own)

    value, by, along, missed, missed_by = jax.vmap(one, (1, 1, 1, 0, *[axis] * 5), (1, 1, 0, 0, 1))(
        z, phase, at, motion.start, motion.mode, motion.waits, motion.given, motion.cone, motion.power
    )
    return Laws(value, by, along, jnp.sum(missed), missed_by)


def laws(
    surface: AbstractSurface,
    z: Float[Array, "stages whiskers 11"],
    start: Contacts,
    phase: Int[Array, "stages whiskers"],
    mode: Int[Array, " whiskers"],
    given: Float[Array, "whiskers 2"],
    follows: Scalar | None = None,
) -> tuple[Float[Array, "stages whiskers 2"], Float[Array, "stages whiskers 2"]]:
    """Residuals of the laws of contacts with friction, and how far these move; see `Laws` and `ContactMotion`."""
    _, rates = radau(z.shape[0])

    def one(z, start, phase, mode, given):
        frame = jax.vmap(lambda z: frame_of(surface, z))(z)
        moves = _moves(z, start, phase, frame, rates[1:])
        law = jax.vmap(lambda moves, z: _plain_law(mode, given, moves, z[TRACTION], follows))
        return law(moves, z), moves

    return jax.vmap(one, (1, 0, 1, 0, 0), 1)(z, start, phase, mode, given)


def _moves(z: Array, start: Array, phase: Array, frame: Array, rates: np.ndarray) -> Float[Array, "stages 2"]:
    ahead, across, _ = jnp.moveaxis(frame, -1, 0)
    velocity = jnp.sum(rates[:, :, None] * (z[:, POINT] - start[POINT]), axis=1)
    beyond = jnp.where(phase == Phase.tangential, z[:, SLACK], 0.0) - jnp.maximum(start[SLACK], 0.0)
    rolls = jnp.sum(rates * beyond, axis=1)
    return jnp.stack([jnp.sum(velocity * ahead, axis=1) + rolls, jnp.sum(velocity * across, axis=1)], axis=1)


def _movement(
    z: Float[Array, "stages 11"], start: Float[Array, "11"], phase: Int[Array, " stages"], at: Linear, rates: np.ndarray
) -> tuple[Float[Array, "stages 2"], Float[Array, "stages 2 stages steps"], Float[Array, "2 steps"]]:
    """Rates of one whisker's material point at the stages, times the length of the step, and their derivatives.

    The derivatives are with respect to the steps of all stages. The last result is the displacement of that point by
    the steps of the last stage.
    """
    ahead, across, out = jnp.moveaxis(at.frame, -1, 0)
    tangential = phase == Phase.tangential
    by_point, by_beyond = at.directions[:, POINT], jnp.where(tangential[:, None], at.directions[:, SLACK], 0.0)
    velocity = jnp.sum(rates[:, :, None] * (z[:, POINT] - start[POINT]), axis=1)

    def along_by(axis):
        return rates[:, :, None] * jnp.sum(by_point * axis[:, None, :, None], axis=2)

    def with_frame(turned):  # the frame turns with the contact of its own stage
        return np.eye(len(rates))[:, :, None] * jnp.sum(velocity[:, :, None] * turned, axis=1)[:, None]

    ahead_by = at.directions[:, AHEAD]
    across_by = jnp.cross(at.out_by, ahead[:, :, None], axis=1) + jnp.cross(out[:, :, None], ahead_by, axis=1)
    first_by = along_by(ahead) + rates[:, :, None] * by_beyond + with_frame(ahead_by)
    second_by = along_by(across) + with_frame(across_by)
    displaced = jnp.stack([jnp.sum(by_point[-1] * axis[-1, :, None], axis=0) for axis in (ahead, across)])
    unit_by = displaced.at[0].add(by_beyond[-1])
    return _moves(z, start, phase, at.frame, rates), jnp.stack([first_by, second_by], axis=1), unit_by


def _law(
    motion: ContactMotion, mode: Int[Array, ""] | None, given: Pair | None, moves: Pair, traction: Pair, force: Scalar
):
    """Residuals of the law of one contact, which moves over the length of a step."""
    flows, friction = motion.traction.flows, motion.traction.friction
    if friction is None or mode is None or given is None:
        return jnp.where(flows, moves + motion.time * traction, traction)
    # What exceeds friction drives the flow: the return mapping of plasticity, with sticking as its other case.
    square = jnp.sum(traction**2)
    holds = square <= (friction * force) ** 2
    size = jnp.sqrt(jnp.where(holds, 1.0, square))
    excess = jnp.where(holds, 0.0, (1 - friction * jnp.maximum(force, 0.0) / size) * traction)
    plain = _plain_law(mode, given, moves, traction, motion.follows)
    return jnp.where(flows, moves + motion.time * excess, plain)


def _plain_law(mode: Int[Array, ""], given: Pair, moves: Pair, traction: Pair, follows: Scalar | None) -> Pair:
    square, along = jnp.sum(traction**2), traction
    if follows is not None:
        # Either the place of a contact or its traction may hardly depend on the other one.
        moves, along = moves + follows * (traction - given), given
    slips = jnp.stack([(square - 1) / 2, along[0] * moves[1] - along[1] * moves[0]])
    return jnp.where(mode == SlipMode.slips, slips, jnp.where(mode == SlipMode.sticks, moves, traction - given))


def speeds(surface: AbstractSurface, z: Contacts, phase: Int[Array, " whiskers"], rate: Contacts) -> Array:
    """Velocities of the material points that touch, (whiskers, 2), at this rate of the contacts."""

    def one(z, phase, rate):
        ahead, across, _ = frame_of(surface, z).T
        rolls = jnp.where(phase == Phase.tangential, rate[SLACK], 0.0)
        return jnp.stack([jnp.sum(rate[POINT] * ahead) + rolls, jnp.sum(rate[POINT] * across)])

    return jax.vmap(one)(z, phase, rate)


def grip_of(problem: SpaceProblem, mode: Int[Array, " whiskers"], phase: Array, point: Point, tangent: Point) -> Array:
    """Margins to the next change of mode: the speed of slip, or what friction can hold besides; infinite if free."""
    traction = point.z[:, TRACTION]
    speed = -jnp.sum(traction * speeds(problem.surface, point.z, phase, tangent.z), axis=1)
    margin = jnp.where(mode == SlipMode.slips, speed, (1 - jnp.sum(traction**2, axis=1)) / 2)
    return jnp.where(phase == Phase.free, jnp.inf, margin)


def ends_of_step(slip: SlipState, start: Point, points: Point) -> tuple[Point, Point]:
    """Rates of the polynomial through all stages at the start of a step and at its end, times the length of the step.

    The equations themselves give the rate of a direction of slip that hardly matters only very roughly.
    """
    places, rates = radau(points.z.shape[0])
    # The first traction of a contact that begins is that of the polynomial through the stages alone.
    powers = np.arange(places.size)
    before = np.linalg.inv(places[:, None] ** powers)[0]
    first = jnp.sum(before[:, None, None] * points.z[:, :, TRACTION], axis=0)
    start = with_traction(start, jnp.where(slip.begins[:, None], first, start.z[:, TRACTION]))

    def at(row):
        z = jnp.sum(row[:, None, None] * (points.z - start.z), axis=0)
        return Point(z, jnp.sum(row * (points.u - start.u)))

    return at(rates[0]), at(rates[-1])


def defect_of(friction: Scalar, slip: SlipState, start: Point, tangent: Point, points: Point) -> Scalar:
    """How far a step begins in another direction than the path arrives, over the length of the step."""
    scale, (first, _) = scale_of(start.z), ends_of_step(slip, start, points)
    length = dot(without_traction(tangent), first, scale)
    off = as_felt(friction, start.z, Point(first.z - length * tangent.z, first.u - length * tangent.u))
    return jnp.sqrt(dot(off, off, scale))


def as_felt(friction: Scalar, z: Contacts, change: Point) -> Point:
    """A change of a point, with those of tractions as whiskers feel them.

    The direction of a small force hardly matters, and towards a release it may have no rate.
    """
    weight = jnp.clip(friction * z[:, FORCE] / FELT, 0.0, 1.0)
    return change._replace(z=change.z.at[:, TRACTION].multiply(weight[:, None]))


def with_traction(point: Point, traction: Float[Array, "whiskers 2"]) -> Point:
    """The point with these tractions."""
    return point._replace(z=point.z.at[:, TRACTION].set(traction))


def without_traction(change: Point) -> Point:
    """A change of a point, in which tractions do not count: they follow the motion, and do not measure it."""
    return change._replace(z=change.z.at[..., TRACTION].set(0.0))


def first_traction(velocity: Float[Array, "whiskers 2"]) -> Float[Array, "whiskers 2"]:
    """Guess of tractions of contacts that begin with these velocities, as they have without friction.

    A tip that does not move along the surface at first slips down along its axis.
    """
    speed = jnp.sqrt(jnp.sum(velocity**2, axis=1, keepdims=True))
    moves = speed > LEAST_SPEED
    return jnp.where(moves, -velocity / jnp.where(moves, speed, 1.0), np.array([1.0, 0.0]))


def next_guess(
    slip: SlipState, mode: Int[Array, " whiskers"], traction: Float[Array, "whiskers 2"]
) -> tuple[SlipState, Int[Array, " whiskers"], Float[Array, "whiskers 2"]]:
    """The next guess of what contacts that begin do, and their tractions.

    They slip against their first velocity, or on either side of that, or stick. A straight whisker whose tip would
    stick slips down along its axis, because it cannot stretch.
    """
    angle = jnp.array([1.0, -2.0, 1.0, 0.0])[slip.guess] * np.pi / 3
    cos, sin, (ahead, across) = jnp.cos(angle), jnp.sin(angle), traction.T
    turned = jnp.stack([cos * ahead - sin * across, sin * ahead + cos * across], axis=1)
    guess = (slip.guess + 1) % 4
    mode = jnp.where(slip.begins, jnp.where(guess == 3, int(SlipMode.sticks), int(SlipMode.slips)), mode)
    return slip._replace(guess=guess), mode, jnp.where(slip.begins[:, None], turned, traction)


def mode_after(
    mode: Int[Array, " whiskers"], grips: Bool[Array, " whiskers"], turns: Bool[Array, ""], touches: Array
) -> Int[Array, " whiskers"]:
    """What contacts do after an event: those whose margin vanishes change, and where the drive turns, all stick."""
    other = jnp.where(mode == SlipMode.slips, int(SlipMode.sticks), int(SlipMode.slips))
    mode = jnp.where(grips, other, mode)
    mode = jnp.where(turns, int(SlipMode.sticks), mode)
    return jnp.where(touches, int(SlipMode.slips), mode)


LEAST_SPEED = 1e-9  # per arc length of the path: contacts must not slip with their traction


def mode_at_corner(
    problem: SpaceProblem, state: SpaceContactState, begins: Bool[Array, " whiskers"], point: Point, tangent: Point
) -> tuple[Int[Array, " whiskers"], Float[Array, " whiskers"]]:
    """What contacts do after a corner of the path, along this tangent, and their margins there.

    The first contact that would slip with its traction sticks instead, and one at its largest traction slips if this
    would grow. Contacts that have just begun do what they are taken to do.
    """
    phase, mode = state
    assert mode is not None
    traction, slips = point.z[:, TRACTION], mode == SlipMode.slips
    margin = grip_of(problem, mode, phase, point, tangent)
    growth = jnp.sum(traction * tangent.z[:, TRACTION], axis=1)
    changes = jnp.where(slips, margin < -LEAST_SPEED, (margin < LEAST_SPEED) & (growth > LEAST_SPEED))
    wrong = (phase != Phase.free) & ~begins & changes
    first = jnp.arange(wrong.size) == jnp.argmax(wrong)
    other = jnp.where(slips, int(SlipMode.sticks), int(SlipMode.slips))
    return jnp.where(wrong & first, other, mode), margin
