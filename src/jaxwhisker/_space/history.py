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
from jaxwhisker._path.path import STOP, EventKind
from jaxwhisker._space.contact import FORCE, SLACK, TRACTION, UNKNOWNS
from jaxwhisker._space.march_state import Node, SpacePath
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.residuals import residuals
from jaxwhisker._space.slip import Mode, laws, radau, without_traction


class Step(NamedTuple):
    """A step along a path: what its stages follow from."""

    problem: SpaceProblem
    start: Point
    phase: Int[Array, "stages whiskers"]
    mode: Phases
    measure: PathCondition  # of how far a stage is from the start
    condition: PathCondition  # of the end
    cone: Float[Array, " whiskers"]  # weights in the condition, as in slip.Motion
    power: Float[Array, " whiskers"]
    known: Point  # the stages: values of free whiskers, and of all if there is nothing to solve
    active: Bool[Array, ""]


def stages_after(step: Step) -> Point:
    """The stages of a step, with their derivatives."""
    z, u = jax.lax.stop_gradient(step.known)
    unknowns = solution_of(_equations, jnp.append(jnp.ravel(z), u), step)
    return Point(jnp.reshape(unknowns[: z.size], z.shape), unknowns[z.size :])


def _equations(unknowns: Float[Array, " n"], step: Step) -> Float[Array, " n"]:
    problem, start, phase = step.problem, step.start, step.phase
    stages, n = phase.shape
    z, u = jnp.reshape(unknowns[:-stages], (stages, n, UNKNOWNS)), unknowns[-stages:]
    touching = (phase != Phase.free)[:, :, None]
    # A whisker that touches at the end of a step has no history: its traction is given.
    begins = (phase[-1] != Phase.free) & (phase[0] == Phase.free)
    mode = jnp.where(begins, int(Mode.waits), step.mode)
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


def measure_of(start: Point, tangent: Point) -> PathCondition:
    """What measures how far points are along a tangent; of differences to the start."""
    still = jax.tree.map(jax.lax.stop_gradient, start)
    along = at_arc_length(still, without_traction(jax.lax.stop_gradient(tangent)), jnp.zeros(()))
    return along._replace(z0=jnp.zeros_like(start.z), u0=jnp.zeros_like(start.u))


def stages_between(path: SpacePath, index: Int[Array, ""], u: Scalar) -> Point:
    """Guess of the stages of a step that ends at a control between a node and the next one."""
    nodes = path.nodes
    assert nodes.inner is not None
    start, phase = jax.tree.map(lambda leaf: leaf[index], (nodes.point, nodes.phase))
    end = jnp.minimum(index + 1, path.count - 1)
    z = jnp.concatenate([nodes.inner.z[end], nodes.z_before[end][None]])
    places, _ = radau(z.shape[0])
    powers = np.arange(places.size)
    # Polynomials through all stages, and through the start. Its traction may be a guess.
    all_, stages = (np.linalg.inv(places[:, None] ** exponents) for exponents in (powers + 1, powers))
    z_by = jnp.tensordot(all_, z - start.z, axes=1)
    u_by = jnp.sum(all_ * (jnp.append(nodes.inner.u[end], nodes.point.u[end]) - start.u), axis=1)
    traction_by = jnp.tensordot(stages, z[:, :, TRACTION], axes=1)

    def towards(_, t):
        slope = jnp.sum(u_by * (powers + 1) * t**powers)
        missed = start.u + jnp.sum(u_by * t ** (powers + 1)) - u
        return jnp.clip(t - missed / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = nodes.point.u[end] - start.u
    t = jnp.clip((u - start.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    at = (jax.lax.fori_loop(0, 6, towards, t) * places)[:, None]
    z = start.z + jnp.tensordot(at ** (powers + 1), z_by, axes=1)
    z = z.at[:, :, TRACTION].set(jnp.tensordot(at**powers, traction_by, axes=1))
    touching = (phase != Phase.free)[:, None]
    reached = start.u + jnp.sum(u_by * at ** (powers + 1), axis=1)
    return Point(jnp.where(touching, z, start.z), reached.at[-1].set(u))


class Linked(NamedTuple):
    """Nodes of a path, with derivatives."""

    z_before: Contacts  # fields (nodes, ...)
    z: Contacts
    u: Float[Array, " nodes"]


def linked(problem: SpaceProblem, path: SpacePath, stops: Float[Array, " stops"]) -> Linked:
    """The nodes of a path with friction, with their derivatives by everything, the stops of the drive included.

    The contacts that come to rest after a loss of stability have no derivatives.
    """
    nodes = jax.lax.stop_gradient(path.nodes)
    capacity = nodes.kind.shape[0]
    turn = jnp.clip(jnp.cumsum(nodes.kind == STOP) - 1, 0, stops.size - 1)
    follows = jnp.arange(capacity) < path.count

    def link(start: Point, at):
        node, before, stop, follows = at
        end = _node_after(problem, start, before, node, stop, follows)
        return Point(end.z, end.u), end

    def first(leaf):
        return leaf[0]

    start = jax.tree.map(first, nodes.point)
    before = jax.tree.map(lambda leaf: jnp.concatenate([leaf[:1], leaf[:-1]]), nodes)
    _, links = jax.lax.scan(link, start, (nodes, before, stops[turn] / problem.unit.control, follows))
    return links


def _node_after(problem: SpaceProblem, start: Point, before: Node, node: Node, stop: Scalar, follows: Array) -> Linked:
    """A node, with derivatives, from those of the node before."""
    kind, concerned = node.kind, node.whiskers.astype(float)
    touches = kind == EventKind.touch
    snaps = (kind == EventKind.snap_through) | (kind == EventKind.snap_off)
    begins = touches & node.whiskers
    z_end = jnp.where(begins[:, None], node.point.z.at[:, TRACTION].set(0.0), node.z_before)
    known = Point(
        jnp.concatenate([node.inner.z, z_end[None]]), jnp.append(node.inner.u, node.point.u)
    )
    stages = known.u.size
    phase = jnp.broadcast_to(node.phase_before, (stages, concerned.size))
    phase = phase.at[-1].set(jnp.where(begins, node.phase, node.phase_before))
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
    assert node.mode is not None
    step = Step(problem, start, phase, node.mode, measure, condition, cone, power, known, follows & ~snaps)
    solved = stages_after(step)
    z, u = solved.z[-1], solved.u[-1]
    z, u = jnp.where(snaps, start.z, z), jnp.where(snaps, start.u, u)
    z_before = jnp.where(begins[:, None], node.z_before, z)
    free = (node.phase == Phase.free)[:, None]
    after = jnp.where(snaps, node.point.z, z).at[:, TRACTION].set(
        jnp.where(begins[:, None], node.point.z[:, TRACTION], z[:, TRACTION])
    )
    after = jnp.where(free, node.point.z, after)
    rests = snaps & jnp.any(node.phase != Phase.free)
    return Linked(z_before, without_rule(after, (problem, start), rests), u)
