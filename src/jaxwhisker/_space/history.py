"""Derivatives of paths with friction, which remember how they came about.

Every step of a path is a set of equations for its stages, given its start (slip.py). The derivatives of its end follow
from those of its start, from the first touch on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import PathCondition, Point, at_arc_length
from jaxwhisker._path.path import STOP, EventKind, Node, Path, Stops
from jaxwhisker._space.contact import FORCE, SLACK, TRACTION, UNKNOWNS
from jaxwhisker._space.march_state import SETTLED
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.residuals import residuals
from jaxwhisker._space.slip import FOLLOWING, SlipMode, laws, radau, stages_of, without_traction


class PathStep(NamedTuple):
    """A step along a path: what its stages follow from."""

    problem: SpaceProblem
    start: Point
    phase: Int[Array, "stages whiskers"]
    mode: Phases
    measure: PathCondition  # of how far a stage is from the start
    condition: PathCondition  # of the end
    cone: Float[Array, " whiskers"]  # weights in the condition, as in slip.ContactMotion
    power: Float[Array, " whiskers"]
    known: Point  # the stages: values of free whiskers, and of all if there is nothing to solve
    active: Bool[Array, ""]


def stages_after(step: PathStep) -> Point:
    """The stages of a step, with their derivatives."""
    z, u = jax.lax.stop_gradient(step.known)
    unknowns = solution_of(_equations, jnp.append(jnp.ravel(z), u), step)
    return Point(jnp.reshape(unknowns[: z.size], z.shape), unknowns[z.size :])


def _equations(unknowns: Float[Array, " n"], step: PathStep) -> Float[Array, " n"]:
    problem, start, phase = step.problem, step.start, step.phase
    stages, n = phase.shape
    z, u = jnp.reshape(unknowns[:-stages], (stages, n, UNKNOWNS)), unknowns[-stages:]
    touching = (phase != Phase.free)[:, :, None]
    # A whisker that touches at the end of a step has no history: its traction is given.
    begins = (phase[-1] != Phase.free) & (phase[0] == Phase.free)
    mode = jnp.where(begins, int(SlipMode.waits), step.mode)
    own, _, _ = jax.vmap(lambda *at: residuals(problem, *at))(z, u, phase, step.known.z)
    law, moves = laws(problem.surface, z, start.z, phase, mode, step.known.z[-1, :, TRACTION])
    own = own.at[:, :, TRACTION].set(jnp.where(touching, law, own[:, :, TRACTION]))
    places, _ = radau(stages)
    traction = z[-1, :, TRACTION]
    missed = step.condition.residual(Point(z[-1], u[-1]), jnp.zeros(n))
    missed += jnp.sum(step.cone * (jnp.sum(traction**2, axis=1) - 1) / 2)
    missed += jnp.sum(step.power * jnp.sum(traction * moves[-1], axis=1))
    reach = jax.vmap(lambda z, u: step.measure.residual(Point(z - start.z, u - start.u), jnp.zeros(n)))(z, u)
    rows = jnp.concatenate([jnp.ravel(own), (reach - places * reach[-1])[:-1], missed[None]])
    still = unknowns - jnp.append(jnp.ravel(step.known.z), step.known.u)
    return jnp.where(step.active, rows, still)


class Followed(NamedTuple):
    """An equilibrium within a step: what it follows from."""

    problem: SpaceProblem
    u: Scalar
    phase: Phases
    mode: Phases
    within: Contacts  # interpolated


def contacts_within(known: Followed, z: Contacts) -> Contacts:
    """Solved contacts within a step, with their derivatives."""
    return jnp.reshape(solution_of(_equations_within, jnp.ravel(jax.lax.stop_gradient(z)), known), z.shape)


def _equations_within(unknowns: Float[Array, " n"], known: Followed) -> Float[Array, " n"]:
    problem, u, phase, mode, within = known
    z = jnp.reshape(unknowns, within.shape)
    own, _, _ = residuals(problem, z, u, phase, within)
    law, _ = laws(problem.surface, z[None], within, phase[None], mode, within[:, TRACTION], jnp.asarray(FOLLOWING))
    return jnp.ravel(own.at[:, TRACTION].set(jnp.where((phase != Phase.free)[:, None], law[0], own[:, TRACTION])))


def measure_of(start: Point, tangent: Point) -> PathCondition:
    """What measures how far points are along a tangent; of differences to the start."""
    still = jax.tree.map(jax.lax.stop_gradient, start)
    along = at_arc_length(still, without_traction(jax.lax.stop_gradient(tangent)), jnp.zeros(()))
    return along._replace(z0=jnp.zeros_like(start.z), u0=jnp.zeros_like(start.u))


def interpolated(start: Point, stages: Point, before: Phases, phase: Phases, u: Scalar) -> Contacts:
    """Contacts at a control within a step, on the polynomial through its start and its stages.

    `before` and `phase` are the phases on both sides of the start.
    """
    places, _ = radau(stages.z.shape[0])
    powers, stages_u = np.arange(places.size), jnp.asarray(stages.u)
    # Through all stages, and through the start. The traction of a contact that begins there is a guess.
    whole, part = (np.linalg.inv(places[:, None] ** exponents) for exponents in (powers + 1, powers))
    z_by = jnp.sum(whole[:, :, None, None] * (stages.z - start.z), axis=1)
    u_by = jnp.sum(whole * (stages_u - start.u), axis=1)
    guessed_by = jnp.sum(part[:, :, None, None] * stages.z[:, :, TRACTION], axis=1)

    def towards(t):
        slope = jnp.sum(u_by * (powers + 1) * t**powers)
        missed = start.u + jnp.sum(u_by * t ** (powers + 1)) - u
        return jnp.clip(t - missed / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = stages_u[-1] - start.u
    t = jnp.clip((u - start.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, lambda _, t: towards(t), jax.lax.stop_gradient(t))
    t = towards(jax.lax.stop_gradient(t))  # with derivatives
    z = start.z + jnp.sum((t ** (powers + 1))[:, None, None] * z_by, axis=0)
    guessed = jnp.sum((t**powers)[:, None, None] * guessed_by, axis=0)
    z = z.at[:, TRACTION].set(jnp.where((before == Phase.free)[:, None], guessed, z[:, TRACTION]))
    return jnp.where((phase != Phase.free)[:, None], z, start.z)


def stages_before(nodes: Node, end: Int[Array, ""]) -> Point:
    """The stages of the step that ends at a node."""
    assert nodes.inner is not None
    inner, z, u = jax.tree.map(lambda leaf: leaf[end], (nodes.inner, nodes.z_before, nodes.point.u))
    return Point(jnp.concatenate([inner.z, z[None]]), jnp.append(inner.u, u))


class LinkedNodes(NamedTuple):
    """Nodes of a path, with derivatives; fields (nodes, ...)."""

    point: Point
    stages: Point  # of the steps that end there, fields (nodes, stages, ...)


def linked(problem: SpaceProblem, path: Path, stops: Stops) -> LinkedNodes:
    """The nodes of a path with friction, with their derivatives by everything, the stops of the drive included.

    The contacts that come to rest after a loss of stability have no derivatives.
    """
    index, stages = jnp.arange(path.nodes.kind.shape[0]), radau(stages_of(problem))[0].size
    follows = index < path.count
    # Padding, which is the last node, has no derivatives, not even infinite ones.
    padded = jnp.minimum(index, jnp.maximum(path.count - 1, 0))
    nodes = jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf)[padded], path.nodes)
    turn = jnp.clip(jnp.cumsum((nodes.kind == STOP) & follows) - 1, 0, stops.size - 1)

    @jax.checkpoint  # otherwise all that the derivatives of a node need is kept, and filled with zeros for padding
    def link(start: Point, at):
        node, before, stop, follows = at
        rest = LinkedNodes(node.point, Point(*(jnp.stack([leaf] * stages) for leaf in node.point)))
        # Padding costs nothing.
        end = jax.lax.cond(follows, lambda: _node_after(problem, start, before, node, stop, follows), lambda: rest)
        return end.point, end

    def first(leaf):
        return leaf[0]

    start = jax.tree.map(first, nodes.point)
    before = jax.tree.map(lambda leaf: jnp.concatenate([leaf[:1], leaf[:-1]]), nodes)
    _, links = jax.lax.scan(link, start, (nodes, before, stops[turn] / problem.unit.control, follows))
    return links


def _node_after(
    problem: SpaceProblem, start: Point, before: Node, node: Node, stop: Scalar, follows: Array
) -> LinkedNodes:
    """A node, with derivatives, from those of the node before."""
    assert node.before.mode is not None and node.inner is not None
    kind, concerned = node.kind, node.whiskers.astype(float)
    touches = kind == EventKind.touch
    snaps = (kind == EventKind.snap_through) | (kind == EventKind.snap_off) | (kind == SETTLED)
    begins = touches & node.whiskers
    z_end = jnp.where(begins[:, None], node.point.z.at[:, TRACTION].set(0.0), node.z_before)
    known = Point(jnp.concatenate([node.inner.z, z_end[None]]), jnp.append(node.inner.u, node.point.u))
    phase = jnp.broadcast_to(node.before.phase, (known.z.shape[0], concerned.size))
    phase = phase.at[-1].set(jnp.where(begins, node.state.phase, node.before.phase))
    measure = measure_of(before.point, before.leaving)
    of_force = touches | (kind == EventKind.release)
    of_slack = (kind == EventKind.tip_to_tangential) | (kind == EventKind.tangential_to_tip)
    weight = jnp.where(of_force, concerned, 0.0)[:, None] * (jnp.arange(UNKNOWNS) == FORCE)
    weight += jnp.where(of_slack, concerned, 0.0)[:, None] * (jnp.arange(UNKNOWNS) == SLACK)
    plain = kind < 0
    at_stop = kind == STOP
    condition = PathCondition(
        jnp.where(plain & ~at_stop, measure.weight_z, weight),
        jnp.where(plain, z_end, 0.0),
        jnp.where(at_stop, 1.0, jnp.where(plain, measure.weight_u, 0.0)),
        jnp.where(at_stop, stop, node.point.u),
        jnp.zeros_like(concerned),
    )
    cone, power = (jnp.where(kind == of, concerned, 0.0) for of in (EventKind.slip, EventKind.stick))
    step = PathStep(problem, start, phase, node.before.mode, measure, condition, cone, power, known, follows & ~snaps)
    stages = stages_after(step)
    z, u = jax.tree.map(lambda leaf: leaf[-1], stages)
    z, u = jnp.where(snaps, start.z, z), jnp.where(snaps, jnp.where(kind == SETTLED, node.point.u, start.u), u)
    back = jnp.sum(node.point.z[:, TRACTION] * node.z_before[:, TRACTION], axis=1) < 0  # contacts slip back
    traction = jnp.where(back[:, None], -z[:, TRACTION], z[:, TRACTION])
    traction = jnp.where(begins[:, None], node.point.z[:, TRACTION], traction)
    after = jnp.where(snaps, node.point.z, z).at[:, TRACTION].set(traction)
    after = jnp.where((node.state.phase == Phase.free)[:, None], node.point.z, after)
    rests = snaps & jnp.any(node.state.phase != Phase.free)
    end = Point(without_rule(after, (problem, start), rests), u)
    return LinkedNodes(end, stages._replace(z=stages.z.at[-1].set(jnp.where(begins[:, None], node.z_before, z))))
