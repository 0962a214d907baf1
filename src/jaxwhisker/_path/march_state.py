"""The front of a march: where it has got to, what it heads for, and how a solved end of a step is judged."""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.clearance import Stance, stance
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import (
    Contacts,
    Mode,
    PerWhisker,
    Point,
    Poses,
    Solution,
    dot,
    scale_of,
    stable,
    unit,
)
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path import snap_flow
from jaxwhisker._path.path import Margins, Node, Status, margins, rates, select


class Task(IntEnum):
    """What an iteration is for."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    kick = 4
    flow = 5


class Target(NamedTuple):
    """An event being approached: which margin of which whisker (one-hot), and where it is expected."""

    kind: Int[Array, ""]  # index into Margins
    whisker: Bool[Array, " whiskers"]
    distance: Scalar
    contact: Contacts  # of whiskers that would touch: about where, and how
    phase: Int[Array, " whiskers"]
    side: PerWhisker


class Lead(NamedTuple):
    """A weighted sum of the tangent that has to grow on leaving an event: what makes the new mode valid."""

    z: Contacts
    pose: Poses
    u: Scalar


class Front(NamedTuple):
    """Where the march has got to."""

    task: Int[Array, ""]
    mode: Mode
    point: Point
    pose: Poses
    tangent: Point
    tangent_pose: Poses
    bend: Point  # change of the tangent per arc length
    step: Scalar
    unstable_at: Scalar  # distance at which instability is known, or infinity; and how u turns there
    unstable_turn: Scalar
    target: Target
    lead: Lead
    before_vertex: PerWhisker  # sign of sin(alpha) until the whisker passes the vertex
    goal: Int[Array, ""]  # index of the stop that the drive heads for
    direction: Scalar
    travel: Scalar
    pending: Node  # node to be written on arrival
    flow: snap_flow.Flow
    count: Int[Array, ""]
    status: Int[Array, ""]


TOUCH, RELEASE, PHASE, VERTEX, AT_STOP = range(len(Margins._fields))  # indices into Margins
MARGIN_NOISE = 1e-12  # margins are exact to this: two events at once are not each other's violation
SHORTEST_CHORD = 1e-6  # that tells a direction; below, the path is as straight as it was
DIP_POINTS = 7  # at which a margin is looked at within a step


class Trial(NamedTuple):
    """A solved end of a step, judged."""

    solution: Solution
    tangent: Point
    tangent_pose: Poses
    stable: Bool[Array, ""]
    convex: Bool[Array, ""]
    here: Margins
    there: Margins
    stance: Stance  # there
    side: PerWhisker  # there, of whiskers that pass below the object out of reach


def judge(problem: Problem, front: Front, solution: Solution, stop_u: Scalar) -> Trial:
    """What there is to say of a solved end of a step."""
    newton = solution.newton
    free = front.mode.phase == Phase.free
    tangent, length = unit(newton.tangent, solution.point.z)
    ahead = jnp.where(dot(front.tangent, tangent, scale_of(front.point.z)) < 0, -1.0, 1.0) / length
    tangent, tangent_pose = Point(ahead * length * tangent.z, ahead * length * tangent.u), ahead * newton.tangent_pose
    # What touches is solved for as a contact; the path comes without it, on a parabola.
    touches = (front.task == Task.event) & (front.target.kind == TOUCH)
    chord = Point(jnp.where(free[:, None], 0.0, solution.point.z - front.point.z), solution.point.u - front.point.u)
    way = dot(front.tangent, chord, scale_of(front.point.z))
    known = way > SHORTEST_CHORD
    twice = jnp.where(known, 2 / jnp.where(known, way, 1.0), 0.0)
    onwards = jnp.where(known, -1.0, 1.0)
    come = Point(twice * chord.z + onwards * front.tangent.z, twice * chord.u + onwards * front.tangent.u)
    come_pose = twice * (newton.pose - front.pose) + onwards * front.tangent_pose
    tangent, tangent_pose = select(touches, (come, come_pose), (tangent, tangent_pose))
    convex = jax.vmap(problem.profile.convex)(solution.point.z[:, 1])
    here, there = _stances(problem, (front.point.u, front.pose), (solution.point.u, newton.pose))
    margins_there = _margins_at(problem, front, solution.point, there, stop_u)
    # It touches here as its contact's equations say; where that is looked up in its outline is less exact.
    touching = touches & front.target.whisker
    margins_there = margins_there._replace(touch=jnp.where(touching, jnp.inf, margins_there.touch))
    return Trial(
        solution,
        tangent,
        tangent_pose,
        stable(problem, front.mode, newton.local),
        jnp.all(convex | free),
        here=_margins_at(problem, front, front.point, here, stop_u),
        there=margins_there,
        stance=there,
        side=_sides(problem, front.mode, there),
    )


def _stances(problem: Problem, *at: tuple[Scalar, Poses]) -> list[Stance]:
    if problem.axes == 1:
        return [stance(problem, *one) for one in at]
    # All at once: the search for a touch is compiled once.
    found = jax.vmap(lambda u, pose: stance(problem, u, pose))(*map(jnp.stack, zip(*at, strict=True)))
    return [jax.tree.map(lambda leaf, k=k: leaf[k], found) for k in range(len(at))]


def _sides(problem: Problem, mode: Mode, at: Stance) -> PerWhisker:
    if problem.axes == 1:
        return mode.side
    away = (mode.phase == Phase.free) & ~at.right.reaches & ~at.left.reaches
    return jnp.where(away, snap_flow.side_of(at), mode.side)


def stopped(front: Front, status: Status) -> Front:
    return front._replace(task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status)))


def _margins_at(problem: Problem, front: Front, point: Point, at: Stance, stop_u: Scalar) -> Margins:
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(point.z[:, 1])
    way = front.direction * (stop_u - point.u)
    return margins(front.mode, point, at, front.before_vertex * slope_sin, way)


def first_violated(front: Front, trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Target]:
    """Whether any event lies between here and there, and the first of them; there is a distance away."""
    n = trial.here.touch.shape[0]
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    violated = then < -MARGIN_NOISE
    # What was out of reach may be met anywhere.
    share = jnp.where(jnp.isfinite(now), jnp.clip(now / (now - then), 0.0, 1.0), 0.5)
    share = jnp.where(violated, share, jnp.inf)
    first = jnp.argmin(share)
    hit = jnp.arange(4 * n + 1) == first
    contact, phase, side = snap_flow.touching(trial.stance, front.mode.side)
    one = jnp.any(hit[: 4 * n].reshape(4, n), axis=0)
    return jnp.any(violated), Target(first // n, one, jnp.min(share) * distance, contact, phase, side)


def dip(front: Front, trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative between here and there, though not at the ends, and at which share of the way."""
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    start = distance * jnp.concatenate(rates(front.mode, front.tangent, front.tangent_pose))
    end = distance * jnp.concatenate(rates(front.mode, trial.tangent, trial.tangent_pose))
    t = jnp.linspace(0.0, 1.0, DIP_POINTS + 2)[1:-1, None]
    within = now + t * (start + t * ((3 * (then - now) - 2 * start - end) + t * (start + end - 2 * (then - now))))
    # A margin that has just been left is zero at the start; rounding is no dip.
    within = jnp.where((start < 0) & (end > 0) & jnp.isfinite(within), within, 0.0)
    return jnp.any(within < -MARGIN_NOISE), t[jnp.argmin(jnp.min(within, axis=1)), 0]


def turn_of(front: Front, tangent: Point) -> Scalar:
    return front.direction * tangent.u
