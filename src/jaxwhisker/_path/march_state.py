"""The state of a march: where it is, what it is doing, and how a trial step is evaluated."""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import Solution
from jaxwhisker._equilibrium.point import Contacts, Mode, Point, dot, scale_of, unit
from jaxwhisker._equilibrium.problem import PerWhisker, Poses, Problem, Stance
from jaxwhisker._equilibrium.stability import is_stable
from jaxwhisker._path import snap_flow
from jaxwhisker._path.path import (
    MARGIN_NOISE,
    TOUCH,
    Margins,
    Node,
    Status,
    margin_rates,
    margins,
    select,
)


class Task(IntEnum):
    """What an iteration of the march is for."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    kick = 4
    flow = 5


class Target(NamedTuple):
    """An event being approached: the margin that vanishes, of which whisker (one-hot), and where it is expected."""

    kind: Int[Array, ""]  # index into Margins
    whisker: Bool[Array, " whiskers"]
    distance: Scalar
    contact: Contacts  # first contacts of whiskers that may touch
    phase: Int[Array, " whiskers"]
    side: PerWhisker


class Lead(NamedTuple):
    """Weights of the tangent whose sum has to grow when the path leaves an event, so that the new mode is valid."""

    z: Contacts
    pose: Poses
    u: Scalar


class MarchState(NamedTuple):
    """How far the march has got."""

    task: Int[Array, ""]
    mode: Mode
    point: Point
    pose: Poses
    tangent: Point
    tangent_pose: Poses
    bend: Point  # change of the tangent per arc length
    step: Scalar
    unstable_at: Scalar  # distance at which an unstable equilibrium is known, or infinity
    unstable_turn: Scalar  # du/ds there
    target: Target
    lead: Lead
    before_vertex: PerWhisker  # sign of sin(alpha) until the whisker passes the vertex
    goal: Int[Array, ""]  # index of the stop that the drive moves to
    direction: Scalar
    travel: Scalar
    pending: Node  # node to be written on arrival
    flow: snap_flow.Flow
    count: Int[Array, ""]
    status: Int[Array, ""]

    def turn(self, tangent: Point) -> Scalar:
        """du/ds along a tangent, positive while the drive moves towards its stop."""
        return self.direction * tangent.u

    def stopped(self, status: Status) -> "MarchState":
        """The end of the march."""
        return self._replace(task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status)))


SHORTEST_CHORD = 1e-6  # that determines a direction; a shorter one keeps the direction of the path
DIP_POINTS = 7  # points within a step at which margins are interpolated


class Trial(NamedTuple):
    """The solved end of a step, and its checks."""

    solution: Solution
    tangent: Point
    tangent_pose: Poses
    stable: Bool[Array, ""]
    convex: Bool[Array, ""]
    here: Margins  # at the start of the step
    there: Margins  # at its end
    stance: Stance  # at its end
    side: PerWhisker  # at its end


def evaluate_trial(problem: Problem, state: MarchState, solution: Solution, stop_u: Scalar) -> Trial:
    """Evaluate the solved end of a step: direction of the path, stability, convexity, margins."""
    newton = solution.newton
    free = state.mode.phase == Phase.free
    tangent, length = unit(newton.tangent, solution.point.z)
    ahead = jnp.where(dot(state.tangent, tangent, scale_of(state.point.z)) < 0, -1.0, 1.0) / length
    tangent, tangent_pose = Point(ahead * length * tangent.z, ahead * length * tangent.u), ahead * newton.tangent_pose
    # A touch is solved for as a contact, but the path arrives without it.
    touches = (state.task == Task.event) & (state.target.kind == TOUCH)
    arriving = _direction_of_parabola(state, solution, free)
    tangent, tangent_pose = select(touches, arriving, (tangent, tangent_pose))
    convex = jax.vmap(problem.profile.convex)(solution.point.z[:, 1])
    here, there = problem.stances((state.point.u, state.pose), (solution.point.u, newton.pose))
    margins_there = _margins_at(problem, state, solution.point, there, stop_u)
    # The touching whisker fulfils its contact's equations; its margin, interpolated in its outline, is less exact.
    touching = touches & state.target.whisker
    margins_there = margins_there._replace(touch=jnp.where(touching, jnp.inf, margins_there.touch))
    return Trial(
        solution,
        tangent,
        tangent_pose,
        is_stable(problem, state.mode, newton.condensed),
        jnp.all(convex | free),
        here=_margins_at(problem, state, state.point, here, stop_u),
        there=margins_there,
        stance=there,
        side=problem.updated_side(free, state.mode.side, there),
    )


def _direction_of_parabola(
    state: MarchState, solution: Solution, free: Bool[Array, " whiskers"]
) -> tuple[Point, Poses]:
    """Direction, at the end of a step, of the parabola that starts along the tangent; free whiskers have no contact."""
    chord = Point(jnp.where(free[:, None], 0.0, solution.point.z - state.point.z), solution.point.u - state.point.u)
    distance = dot(state.tangent, chord, scale_of(state.point.z))
    known = distance > SHORTEST_CHORD
    twice = jnp.where(known, 2 / jnp.where(known, distance, 1.0), 0.0)
    sign = jnp.where(known, -1.0, 1.0)
    direction = Point(twice * chord.z + sign * state.tangent.z, twice * chord.u + sign * state.tangent.u)
    return direction, twice * (solution.newton.pose - state.pose) + sign * state.tangent_pose


def _margins_at(problem: Problem, state: MarchState, point: Point, at: Stance, stop_u: Scalar) -> Margins:
    ahead = state.before_vertex * slope_sines(problem, point.z)
    return margins(state.mode, point, at, ahead, state.direction * (stop_u - point.u))


def slope_sines(problem: Problem, z: Contacts) -> PerWhisker:
    """sin(alpha) of the object at every contact."""
    return jax.vmap(lambda p: problem.profile.point(p).sin)(z[:, 1])


def first_violated(state: MarchState, trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Target]:
    """Whether an event lies within a step of this length, and the first one."""
    n = trial.here.touch.shape[0]
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    violated = then < -MARGIN_NOISE
    # A whisker that was out of reach may touch anywhere within the step.
    share = jnp.where(jnp.isfinite(now), jnp.clip(now / (now - then), 0.0, 1.0), 0.5)
    share = jnp.where(violated, share, jnp.inf)
    first = jnp.argmin(share)
    hit = jnp.arange(4 * n + 1) == first
    contact, phase, side = snap_flow.touching(trial.stance, state.mode.side)
    whisker = jnp.any(hit[: 4 * n].reshape(4, n), axis=0)
    return jnp.any(violated), Target(first // n, whisker, jnp.min(share) * distance, contact, phase, side)


def dip(problem: Problem, state: MarchState, trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative within a step, though not at its ends, and at which share of the step."""
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    start = distance * jnp.concatenate(margin_rates(problem, state.mode, state.tangent, state.tangent_pose))
    end = distance * jnp.concatenate(margin_rates(problem, state.mode, trial.tangent, trial.tangent_pose))
    t = jnp.linspace(0.0, 1.0, DIP_POINTS + 2)[1:-1, None]
    within = now + t * (start + t * ((3 * (then - now) - 2 * start - end) + t * (start + end - 2 * (then - now))))
    # The margin of an event just passed is zero at the start; rounding is no dip.
    within = jnp.where((start < 0) & (end > 0) & jnp.isfinite(within), within, 0.0)
    return jnp.any(within < -MARGIN_NOISE), t[jnp.argmin(jnp.min(within, axis=1)), 0]
