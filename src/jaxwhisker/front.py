"""The front of a march: where it has got to, what it heads for, and how a solved end of a step is judged."""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker import relax
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Phase
from jaxwhisker.equilibrium import Contacts, Mode, PerWhisker, Point, Solution, scale_of, stable
from jaxwhisker.path import Margins, Node, Status, dot, margins, rates, unit
from jaxwhisker.scene import Problem


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


class Lead(NamedTuple):
    """A weighted sum of the tangent that has to grow on leaving an event: what makes the new mode valid."""

    z: Contacts
    x: PerWhisker
    u: Scalar


class Front(NamedTuple):
    """Where the march has got to."""

    task: Int[Array, ""]
    mode: Mode
    point: Point
    base_x: PerWhisker
    tangent: Point
    tangent_x: PerWhisker
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
    flow: relax.Flow
    count: Int[Array, ""]
    status: Int[Array, ""]


TOUCH, RELEASE, PHASE, VERTEX, AT_STOP = range(len(Margins._fields))  # indices into Margins
MARGIN_NOISE = 1e-12  # margins are exact to this: two events at once are not each other's violation
DIP_POINTS = 7  # at which a margin is looked at within a step


class Trial(NamedTuple):
    """A solved end of a step, judged."""

    solution: Solution
    tangent: Point
    tangent_x: PerWhisker
    stable: Bool[Array, ""]
    convex: Bool[Array, ""]
    here: Margins
    there: Margins


def judge(problem: Problem, front: Front, solution: Solution, stop_u: Scalar) -> Trial:
    newton = solution.newton
    tangent, length = unit(newton.tangent, solution.point.z)
    ahead = jnp.where(dot(front.tangent, tangent, scale_of(front.point.z)) < 0, -1.0, 1.0)
    tangent = Point(ahead * tangent.z, ahead * tangent.u)
    touching = front.mode.phase != Phase.free
    convex = jax.vmap(problem.profile.convex)(solution.point.z[:, 1])
    return Trial(
        solution,
        tangent,
        ahead * newton.base_x_tangent / length,
        stable(problem, front.mode, newton.local),
        jnp.all(convex | ~touching),
        here=_margins_at(problem, front, front.point, front.base_x, stop_u),
        there=_margins_at(problem, front, solution.point, newton.base_x, stop_u),
    )


def stopped(front: Front, status: Status) -> Front:
    return front._replace(task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status)))


def _margins_at(problem: Problem, front: Front, point: Point, base_x: PerWhisker, stop_u: Scalar) -> Margins:
    slope_sin = jax.vmap(lambda p: problem.profile.point(p).sin)(point.z[:, 1])
    way = front.direction * (stop_u - point.u)
    return margins(problem, front.mode, point, base_x, front.before_vertex * slope_sin, way)


def first_violated(trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Target]:
    """Whether any event lies between here and there, and the first of them; there is a distance away."""
    n = trial.here.touch.shape[0]
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    violated = then < -MARGIN_NOISE
    share = jnp.where(violated, jnp.clip(now / (now - then), 0.0, 1.0), jnp.inf)
    first = jnp.argmin(share)
    hit = jnp.arange(4 * n + 1) == first
    target = Target(first // n, jnp.any(hit[: 4 * n].reshape(4, n), axis=0), jnp.min(share) * distance)
    return jnp.any(violated), target


def dip(front: Front, trial: Trial, distance: Scalar) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative between here and there, though not at the ends, and at which share of the way."""
    now, then = jnp.concatenate(trial.here), jnp.concatenate(trial.there)
    start = distance * jnp.concatenate(rates(front.mode, front.tangent, front.tangent_x))
    end = distance * jnp.concatenate(rates(front.mode, trial.tangent, trial.tangent_x))
    t = jnp.linspace(0.0, 1.0, DIP_POINTS + 2)[1:-1, None]
    within = now + t * (start + t * ((3 * (then - now) - 2 * start - end) + t * (start + end - 2 * (then - now))))
    # A margin that has just been left is zero at the start; rounding is no dip.
    within = jnp.where((start < 0) & (end > 0) & jnp.isfinite(within), within, 0.0)
    return jnp.any(within < -MARGIN_NOISE), t[jnp.argmin(jnp.min(within, axis=1)), 0]


def turn_of(front: Front, tangent: Point) -> Scalar:
    return front.direction * tangent.u
