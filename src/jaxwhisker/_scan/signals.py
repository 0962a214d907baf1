"""Signals: everything about solved points of the path in the scene's units, and the events among them."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact, newton
from jaxwhisker._equilibrium.clearance import in_scene
from jaxwhisker._equilibrium.contact import Phase, of_each
from jaxwhisker._equilibrium.implicit import solved, solved_event
from jaxwhisker._equilibrium.newton import Contacts, Mode, PerWhisker, Point, Row, at_control, harmless
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, Path, select
from jaxwhisker._scan.result import Events, State


def signals(problem: Problem, z: Contacts, u: Scalar, mode: Mode) -> tuple[State, Scalar]:
    """Everything about an equilibrium in the scene's units, and by how much it misses its equations."""
    touching, unit, bodies = mode.phase != Phase.free, problem.unit, problem.bodies(u)
    at = harmless(problem, z, mode.phase)
    base = of_each(bodies, contact.base, *at, mode.side)
    arc = of_each(bodies, contact.arc, z[:, 2], mode.phase)

    def of_touching(values: PerWhisker) -> PerWhisker:
        return jnp.where(touching, values, 0.0)

    frames = bodies.frame
    seen = jax.vmap(contact.seen, in_axes=(0, None if frames is None else 0))(base, frames)
    load = jnp.where(touching[:, None], newton.load_of(seen, problem.axes), 0.0)
    wanted = newton.rest(problem, u) + newton.yielding(problem, load)
    pose = newton.pose_of(seen, 3)
    # Poses across the branch stand on their own where they are no part of the network.
    apart = pose - jnp.concatenate([wanted, jnp.zeros((touching.size, 3 - problem.axes))], axis=1)
    apart = apart.at[:, 0].divide(1 + jnp.abs(u))
    misses = [*apart.T, *([jnp.where(base.sin > 0, 0.0, jnp.inf)] if problem.axes == 1 else [])]
    # Complementarity: the object only pushes, and the phase is what the slack says.
    excess = jnp.where(mode.phase == Phase.tip, z[:, 2], -z[:, 2])
    misses = jnp.concatenate([jnp.abs(jnp.stack(misses)), jnp.maximum(jnp.stack([-z[:, 0], excess]), 0.0)])
    here = in_scene(problem, u, jnp.where(touching[:, None], pose[:, : problem.axes], wanted))
    state = State(
        base_x=here.x * unit.length,
        base_y=here.y * unit.length,
        base_angle=here.angle,
        fx=of_touching(-base.force_x) * unit.force,
        fy=of_touching(-base.force_y) * unit.force,
        mz=of_touching(-base.bend) * unit.moment,
        contact_force=of_touching(z[:, 0]) * unit.force,
        contact_slope=of_touching(jnp.arctan2(base.slope_sin, base.slope_cos)),
        contact_arc=of_touching(arc) * unit.length,
        contact_x=of_touching(base.contact_x) * unit.length,
        contact_y=of_touching(base.contact_y) * unit.length,
        phase=mode.phase,
    )
    missed = jnp.max(jnp.where(touching, misses, 0.0))
    if problem.mount is None:
        return state, missed
    # A motion of one's own may be none somewhere; free whiskers have no equation that would miss it.
    return state, jnp.where(jnp.all(jnp.isfinite(jnp.stack(here))), missed, jnp.inf)


def _event_row(node: Node) -> Row:
    """The equation whose solution an event is; the control, where the node is none."""
    one = node.whiskers.astype(float)
    change = (node.kind == EventKind.tip_to_tangential) | (node.kind == EventKind.tangential_to_tip)
    unloaded = (node.kind == EventKind.release) | (node.kind == EventKind.touch)
    weight = jnp.zeros_like(node.z_before)
    weight = weight.at[:, 0].set(one * unloaded).at[:, 2].set(one * change)
    return Row(
        weight_z=weight,
        z0=jnp.zeros_like(weight),
        weight_u=(node.kind < 0).astype(float),
        u0=node.point.u,
        vertex=one * (node.kind == EventKind.vertex),
    )


def _before_and_after(problem: Problem, node: Node, previous: Node) -> tuple[tuple[Point, Mode], tuple[Point, Mode]]:
    """Both sides of an event; a snap happens where the node before it lies, at a fold or another event."""
    snap = node.kind >= EventKind.snap_through
    at = jax.tree.map(lambda a, b: jnp.where(snap, a, b), previous, node)
    no = jnp.asarray(False)
    before_mode, after_mode = Mode(at.phase_before, at.side_before, no), Mode(node.phase, node.side, no)
    fold = snap & (at.kind < 0)
    # A touch is solved for as the contact that begins.
    touches = at.kind == EventKind.touch
    solved_mode = select(touches, Mode(at.phase, at.side, no), before_mode)
    along = select(touches, at.leaving, at.arriving)
    z = jnp.where(touches, at.point.z, at.z_before)
    before = solved_event(Point(z, at.point.u), problem, solved_mode, along, _event_row(at), fold)
    after = solved(Point(node.point.z, before.u), problem, after_mode, at_control(before.u, node.point.z)).z
    return (before, before_mode), (Point(after, before.u), after_mode)


def _nothing(node: Node) -> Node:
    """A node at which all whiskers are free and nothing happens: what is computed where there is no event."""
    nowhere = jax.tree.map(jnp.zeros_like, node)
    along = Point(nowhere.point.z, jnp.asarray(-1.0))
    side = jnp.ones_like(node.side)
    return nowhere._replace(arriving=along, side=side, side_before=side, kind=jnp.asarray(NO_EVENT))


def events(problem: Problem, path: Path) -> Events:
    """The public events among the nodes: those after the drive has reached the first position of its control."""
    nodes = path.nodes
    room, n = nodes.phase.shape
    index = jnp.arange(room)
    reached = jnp.cumsum((nodes.travel >= 0) & (index < path.count)) > 0
    public = (nodes.kind >= 0) & reached & (index < path.count)
    size = min(room, 32 + 16 * n)
    at = jnp.nonzero(public, size=size, fill_value=0)[0]
    count = jnp.sum(public)
    filled = jnp.arange(size) < count
    empty = jax.tree.map(lambda leaf: leaf[0], nodes)
    node, previous = (
        jax.vmap(lambda k, is_one: select(is_one, jax.tree.map(lambda leaf: leaf[k], nodes), _nothing(empty)))(
            at - back, filled
        )
        for back in (0, 1)
    )
    sides = jax.vmap(partial(_before_and_after, problem))(node, previous)
    # Both sides at once: the rods are compiled once.
    both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *sides)
    states, _ = jax.vmap(lambda point, mode: signals(problem, point.z, point.u, mode))(*both)
    before, after = jax.tree.map(lambda leaf: leaf[:size], states), jax.tree.map(lambda leaf: leaf[size:], states)
    control = sides[0][0].u * problem.unit.control

    def filled_with(leaf):
        keep = filled if leaf.ndim == 1 else filled[:, None]
        return jnp.where(keep, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0)

    return Events(
        kind=jnp.where(filled, node.kind, -1),
        whiskers=node.whiskers & filled[:, None],
        control=filled_with(control),
        travel=filled_with(jax.lax.stop_gradient(node.travel) * problem.unit.control),
        before=jax.tree.map(filled_with, before),
        after=jax.tree.map(filled_with, after),
        count=count,
    )
