"""Signals: states of solved points of the path in the scene's units, and the points of its events."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact, newton
from jaxwhisker._equilibrium.contact import FORCE, LEAN, SLACK, Base, Phase, of_each
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.couplings import law_of, loads_in
from jaxwhisker._equilibrium.friction import lean, slipping_from
from jaxwhisker._equilibrium.implicit import Sides, Turning, event_control, event_points
from jaxwhisker._equilibrium.newton import with_dummy_contacts
from jaxwhisker._equilibrium.pieces import break_between
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, at_control
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker, Poses, ScenePose
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, Path, is_snap, select
from jaxwhisker._plane.events import condition_of, events_of, facts_of, limit_of, number_of
from jaxwhisker._scan.mechanics import EventSides
from jaxwhisker._scan.state import State


def signals(problem: Problem, z: Contacts, u: Scalar, state: ContactState) -> tuple[State, Scalar, None]:
    """State of an equilibrium in the scene's units, its largest residual, and None for the displacement of bases."""
    touching, bodies = state.touches, problem.bodies(u, z, state.piece)
    loaded = touching if problem.attached is None else problem.solved(state.phase)
    contacts = with_dummy_contacts(problem, z, state.phase)
    base = of_each(bodies, contact.base, *contacts, state.side, state.friction)
    arc = of_each(bodies, contact.arc, z[:, SLACK], state.phase)
    in_frame = of_each(bodies, contact.in_base_frame, base)
    load = jnp.where(loaded[:, None], newton.load_of(in_frame, problem.axes), 0.0)
    wanted = problem.rest(u) + problem.displacement(load)
    pose = newton.pose_of(in_frame, 3)
    here = problem.in_scene(u, jnp.where(loaded[:, None], pose[:, : problem.axes], wanted))
    residual = _residual(problem, z, u, state, base, pose, wanted, here)
    if problem.attached is not None and problem.attached.couplings is not None and in_frame.places is not None:
        held, couplings = problem.attached, problem.attached.couplings
        law = law_of(couplings, held.laws, held.held_by, in_frame.places)
        residual = jnp.maximum(residual, jnp.max(jnp.abs(loads_in(couplings, z) - law.load)))
    return _state(problem, z, state, base, arc, here, loaded), residual, None


def _residual(
    problem: Problem,
    z: Contacts,
    u: Scalar,
    state: ContactState,
    base: Base,
    pose: Float[Array, "whiskers 3"],
    wanted: Poses,
    here: ScenePose,
) -> Scalar:
    """Largest residual of any equation or inequality of the whiskers that are solved for."""
    touching = state.touches
    # Coordinates that are not part of the network must be zero.
    apart = pose - jnp.concatenate([wanted, jnp.zeros((touching.size, 3 - problem.axes))], axis=1)
    apart = apart.at[:, 0].divide(1 + jnp.abs(u))
    equalities = [*apart.T, *problem.further_residuals(base, here)]
    inequalities = [beyond_phase(state.phase, z[:, FORCE], z[:, SLACK])]
    leans = lean(z[:, LEAN], state.friction, problem.friction_angle)
    if leans is not None and problem.friction_angle is not None:
        # The lean of a small force is not known to the same accuracy.
        inequalities += [(jnp.abs(leans) - problem.friction_angle) * jnp.minimum(z[:, FORCE], 1.0)]
    equal, excess = jnp.abs(jnp.stack(equalities)), jnp.maximum(jnp.stack(inequalities), 0.0)
    if problem.attached is not None:
        return problem.if_defined(jnp.maximum(jnp.max(equal), jnp.max(jnp.where(touching, excess, 0.0))), here)
    residuals = jnp.where(touching, jnp.concatenate([equal, excess]), 0.0)
    return problem.if_defined(jnp.max(residuals), here)


def beyond_phase(phase: Int[Array, " whiskers"], force: PerWhisker, slack: PerWhisker) -> PerWhisker:
    """How far contacts are beyond their phase: the object only pushes, and the slack has the sign of its phase."""
    return jnp.maximum(-force, jnp.where(phase == Phase.tip, slack, -slack))


def _state(
    problem: Problem,
    z: Contacts,
    state: ContactState,
    base: Base,
    arc: PerWhisker,
    here: ScenePose,
    loaded: Bool[Array, " whiskers"],
) -> State:
    touching, unit = state.touches, problem.unit

    def if_touching(values: PerWhisker) -> PerWhisker:
        return jnp.where(touching, values, 0.0)

    def if_loaded(values: PerWhisker) -> PerWhisker:
        return jnp.where(loaded, values, 0.0)

    return State(
        base_x=here.x * unit.length,
        base_y=here.y * unit.length,
        base_angle=here.angle,
        fx=if_loaded(-base.force_x) * unit.force,
        fy=if_loaded(-base.force_y) * unit.force,
        mz=if_loaded(-base.bend) * unit.moment,
        contact_force=if_touching(z[:, FORCE]) * unit.force,
        contact_slope=if_touching(jnp.arctan2(base.slope_sin, base.slope_cos)),
        contact_arc=if_touching(arc) * unit.length,
        contact_x=if_touching(base.contact_x) * unit.length,
        contact_y=if_touching(base.contact_y) * unit.length,
        phase=state.phase,
        shaft_loads=_shaft_loads(problem, z),
        **_friction(problem, z, state),
        **_objects(problem, state),
    )


def _shaft_loads(problem: Problem, z: Contacts) -> tuple[PerWhisker, ...] | None:
    """The loads of springs between two shafts; None without any."""
    if z.shape[1] == 3:
        return None
    units = [problem.unit.force, problem.unit.force, problem.unit.moment] * (z.shape[1] // 3 - 1)
    return tuple(load * unit for load, unit in zip(z[:, 3:].T, units, strict=True))


def _friction(problem: Problem, z: Contacts, state: ContactState) -> dict[str, Array]:
    """Fields of a state with friction."""
    leans = lean(z[:, LEAN], state.friction, problem.friction_angle)
    if state.friction is None or leans is None:
        return {}
    touching, force = state.touches, z[:, FORCE] * problem.unit.force
    return {
        "slip": jnp.where(touching, state.friction.slip, 0),
        "normal_force": jnp.where(touching, force * jnp.cos(leans), 0.0),
        "friction_force": jnp.where(touching, -force * jnp.sin(leans), 0.0),
    }


def _objects(problem: Problem, state: ContactState) -> dict[str, Array]:
    """Fields of a state with several objects."""
    number = problem.profile.object_of(state.piece)
    return {} if number is None else {"contact_object": jnp.where(state.touches, number + 1, 0)}


def _event_condition(problem: Problem, node: Node) -> PathCondition:
    """The equation that defines a node's event; for a node without an event, its control is given."""
    events, before, after = events_of(problem), node.before.piece, node.state.piece
    number = number_of(events, node.kind)
    if problem.profile.has_edges and before is not None and after is not None:
        limit = break_between(problem.profile, before, after)
    else:
        limit = limit_of(events, number, problem, node.z_before, None)
    return condition_of(facts_of(events, number), node.whiskers, node.z_before, limit, node.point.u)


class EventPoint(NamedTuple):
    """What defines the point of an event, as it is before the event."""

    point: Point
    state: ContactState  # in which the point is solved for
    along: Point  # direction of the path
    condition: PathCondition
    turning: Turning


def event_point(problem: Problem, node: Node, previous: Node) -> tuple[EventPoint, ContactState]:
    """The point of an event, and the contact state before it.

    A snap, and a change of slips at another event, happen at the node before: at a turning point of the path, or at an
    event.
    """
    corner = is_snap(node.kind) if node.corner is None else node.corner
    at = jax.tree.map(lambda a, b: jnp.where(corner, a, b), previous, node)
    # A touch is solved for as the contact that begins.
    begun = after = at.kind == EventKind.touch
    condition, turns = _event_condition(problem, at), corner & (at.kind == NO_EVENT)
    sticks = None
    if node.corner is not None:
        # The node before is the outcome of an event itself, and its control is known.
        known = corner & at.corner
        after, turns = after | known, turns & ~known
        condition = select(known, at_control(at.point.u, at.point.z), condition)
        sticks = turns & (node.kind == EventKind.stick) & node.whiskers
    state = select(after, at.state, at.before)
    before = select(begun, at.before, state)
    along = select(after, at.leaving, at.arriving)
    point = Point(jnp.where(after, at.point.z, at.z_before), at.point.u)
    return EventPoint(point, state, along, condition, Turning(turns & is_snap(node.kind), sticks)), before


def control_at_event(problem: Problem, node: Node, previous: Node) -> tuple[Scalar, ContactState]:
    """Control of an event, with derivatives, and the contact state before it."""
    at, state = event_point(problem, node, previous)
    if at.turning.slip is not None:
        points = event_points(Sides(at.point, None), problem, Sides(at.state, None), at.along, at.condition, at.turning)
        return points.before.u, state
    return event_control(at.point, problem, at.state, at.along, at.condition, at.turning.control), state


def _points_at_event(problem: Problem, node: Node, previous: Node) -> tuple[Sides, Sides]:
    """Points before and after an event, with derivatives, and their contact states."""
    at, before = event_point(problem, node, previous)
    points = Sides(at.point, Point(node.point.z, at.point.u))
    points = event_points(points, problem, Sides(at.state, node.state), at.along, at.condition, at.turning)
    return points, Sides(before, node.state)


def _placeholder(node: Node) -> Node:
    """A node at which all whiskers are free and nothing happens: a placeholder for unused room."""
    blank = jax.tree.map(jnp.zeros_like, node)
    along = Point(blank.point.z, jnp.asarray(-1.0))
    side = jnp.ones_like(node.state.side)
    slipping = None if node.state.friction is None else slipping_from(side)
    state = blank.state._replace(side=side, friction=slipping)
    return blank._replace(arriving=along, state=state, before=state, kind=jnp.asarray(NO_EVENT))


def nodes_at(path: Path, at: Int[Array, " events"], filled: Bool[Array, " events"]) -> tuple[Node, Node]:
    """The nodes of events and those before them, fields (events, ...); placeholders where there is no event."""
    nodes = path.nodes
    empty = jax.tree.map(lambda leaf: leaf[0], nodes)

    def chosen(k, is_one):
        return select(is_one, jax.tree.map(lambda leaf: leaf[k], nodes), _placeholder(empty))

    node, previous = (jax.vmap(chosen)(at - back, filled) for back in (0, 1))
    return node, previous


def sides_of_events(
    problem: Problem, path: Path, at: Int[Array, " events"], filled: Bool[Array, " events"]
) -> EventSides:
    """Equilibria before and after the events at these nodes; placeholders where there is no event."""
    points, states = jax.vmap(partial(_points_at_event, problem))(*nodes_at(path, at, filled))
    sides = ((point.z, point.u, state) for point, state in zip(points, states, strict=True))
    return EventSides(jnp.asarray(points.before.u), *sides)
