"""The mechanics of scans whose whiskers may have several contacts each, with the signals of an equilibrium."""

from concurrent.futures import Executor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.program import Program
from jaxwhisker._base.slopes import by_slopes
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.approach import all_free
from jaxwhisker._chain.contacts import ChainState, held_of, lean_of, slack_of
from jaxwhisker._chain.continuation import ContinuationOfChain
from jaxwhisker._chain.implicit import after_event, sides_of_events, solved
from jaxwhisker._chain.margins import may_turn
from jaxwhisker._chain.newton import of_whiskers, residuals, solve_points
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._chain.problem import ChainProblem, chain_problem
from jaxwhisker._chain.rows import RowsOfContacts, any_of_whisker
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, Phase
from jaxwhisker._equilibrium.point import at_control
from jaxwhisker._model.canonical import canonical
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.march import follow
from jaxwhisker._path.path import Last, Node, Path, ScanPath, Status, Stops
from jaxwhisker._scan.mechanics import EventSides, Solutions
from jaxwhisker._scan.memory import Memory, memory_of, remembered
from jaxwhisker._scan.plane import InThePlane
from jaxwhisker._scan.resolution import warn_of_steps
from jaxwhisker._scan.signals import beyond_phase
from jaxwhisker._scan.state import FRICTION, State
from jaxwhisker._scan.steps import interpolate, is_near

EVENTS = 64  # events of one whisker that a scan has room for
BLOCK = 256  # steps computed by one call
LANES = 16  # of a batch that run together


def follow_path(problem: ChainProblem, stops: Stops, last: Last, sweeps: int | None = None) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN."""
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    return follow(ContinuationOfChain(problem), stops, last, sweeps)


canonical_problem_now = Program(chain_problem, tangent=by_slopes(chain_problem))
follow_path_now = Program(follow_path, frozen=True, together=LANES)


def problem_now(scene: Scene) -> ChainProblem:
    """The dimensionless problem of a scene, by a program that all scenes of one canonical form share."""
    return canonical_problem_now(canonical(scene), scene.contacts)


class SeveralContacts(InThePlane):
    """Whiskers in the plane with several contacts."""

    block, follows = BLOCK, follow_path_now
    problem = staticmethod(problem_now)

    @staticmethod
    def check(scene: Scene, problem: ChainProblem) -> None:
        if not bool(problem.valid):
            raise ValueError(f"`scene` must have parameters that its constructors accept, got {scene}.")
        warn_of_steps(scene)

    @staticmethod
    def detected(scene: Scene, problem: ChainProblem, path: Path) -> Path:
        return path  # the march knows all contacts

    @staticmethod
    def prepare(pool: Executor, scene: Scene, problem: ChainProblem, stops: int) -> tuple[Path, Memory | None]:
        path = follow_path_now.prepare(pool, problem, np.zeros(stops), np.asarray(0)).path
        return path, jax.eval_shape(memory_of, path)

    @staticmethod
    def remember(problem: ChainProblem, path: Path, stops: Stops) -> Memory | None:
        return None if problem.friction_angle is None else remembered(after_event, problem, path, stops)

    @staticmethod
    def solve(problem, path, index, u, known) -> Solutions:
        index = jnp.maximum(index, 0)  # of a path without nodes
        state = jax.tree.map(lambda leaf: leaf[index], path.nodes.state)
        guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
        guess = guess._replace(z=jnp.where(state.touches[:, :, None], guess.z, 0.0))
        solution = solve_points(problem, state, jax.vmap(at_control)(u, guess.z), guess)
        z = solution.point.z
        status = jnp.where(solution.converged & is_near(z, guess.z), Status.ok, Status.inexact)
        status = jnp.where(known == Status.ok, status, known)
        accepted = (status == Status.ok)[:, None]
        none, free = all_free(problem)
        # Rejected steps are replaced by free whiskers, with finite values and derivatives (see `safe_placeholder`).
        state = jax.tree.map(lambda own, other: jnp.where(accepted, own, other), state, free)
        return Solutions(jnp.where(accepted[:, None], z, none), state, status, index)

    @staticmethod
    def states(problem, u, solutions, remembered):
        def one(u: Scalar, z: RowsOfContacts, state: ChainState):
            return signals(problem, solved(problem, z, u, state), u, state)

        return jax.vmap(one)(u, solutions.z, solutions.state.stuck_at(remembered))

    @staticmethod
    def signals(problem, *side):
        return signals(problem, *side)

    @staticmethod
    def event_room(whiskers: int) -> int:
        return EVENTS * whiskers

    @staticmethod
    def event_nodes(problem: ChainProblem, path: Path) -> Node:
        return path.nodes._replace(whiskers=any_of_whisker(path.nodes.whiskers, problem.contacts))

    @staticmethod
    def at_events(problem, path, memory, at, filled) -> EventSides:
        nodes = (path if memory is None else memory.on(path)).nodes
        return EventSides(*sides_of_events(problem, nodes, at, filled))

    @staticmethod
    def event_controls(problem, path, memory, at, filled):
        nodes = (path if memory is None else memory.on(path)).nodes
        control, before, after = sides_of_events(problem, nodes, at, filled)
        touched, touches = (any_of_whisker(side.state.touches, problem.contacts) for side in (before, after))
        return control, touched & ~touches


def signals(problem: ChainProblem, z: RowsOfContacts, u: Scalar, state: ChainState) -> tuple[State, Scalar, None]:
    """State of an equilibrium in the scene's units, its largest residual, and None for the displacement of bases."""
    residual, at = residuals(problem, z, u, state)
    unit, each = problem.unit, of_whiskers(problem, state)
    touches, touching = each.touches, jnp.any(each.touches, axis=1)
    pose = problem.rest + problem.displacement(at.load)
    here, chain, base = problem.in_scene(u, pose), at.chain, at.base
    force, own = z[:, FORCE], of_whiskers(problem, z)
    slack = jnp.where(may_turn(problem, state), 0.0, slack_of(problem.profile, z, state))
    wrong = jnp.where(state.touches, beyond_phase(state.phase, force, slack), 0.0)

    def if_touching(values: Array) -> Array:
        return jnp.where(touching, values, 0.0)

    number = problem.profile.object_of(each.piece)
    assert number is not None
    contact = ContactFields(
        force=own[..., FORCE] * unit.force,
        slope=jnp.arctan2(chain.contact.sin, chain.contact.cos),
        arc=(problem.length[:, None] - chain.beyond) * unit.length,
        x=chain.contact.x * unit.length,
        y=chain.contact.y * unit.length,
        phase=each.phase,
        number=number + 1,
    )
    contact = jax.tree.map(lambda leaf: jnp.where(touches, leaf, jnp.zeros_like(leaf)), contact)
    friction, lean = {}, lean_of(problem.profile, problem.friction_angle, z, state)
    if state.friction is None or lean is None or problem.friction_angle is None:
        contact = _apart(problem, each, contact)
    else:
        # The force of a tip in an inner corner leans from the nearest normal there. It stays one contact, without slip.
        pinned, p = held_of(problem.profile, state).pinned, z[:, PARAMETER]
        beyond = jnp.where(pinned, p - jnp.clip(p, *problem.profile.ends_on(jnp.where(pinned, state.piece, 0))), 0.0)
        contact = contact._replace(slope=contact.slope + of_whiskers(problem, beyond))
        lean = lean + beyond
        slip = jnp.where(pinned, 0, state.friction.slip)
        parts = slip, force * jnp.cos(lean) * unit.force, -force * jnp.sin(lean) * unit.force
        parts = jax.tree.map(lambda leaf: jnp.where(state.touches, leaf, 0), parts)
        friction = dict(zip(FRICTION, of_whiskers(problem, parts), strict=True))
        cone = (jnp.abs(lean) - problem.friction_angle) * jnp.minimum(force, 1.0)
        wrong = jnp.maximum(wrong, jnp.where(state.touches, cone, 0.0))
    values = State(
        base_x=here.x * unit.length,
        base_y=here.y * unit.length,
        base_angle=here.angle,
        fx=if_touching(-base.force_x) * unit.force,
        fy=if_touching(-base.force_y) * unit.force,
        mz=if_touching(-base.bend) * unit.moment,
        contact_force=contact.force,
        contact_slope=contact.slope,
        contact_arc=contact.arc,
        contact_x=contact.x,
        contact_y=contact.y,
        phase=contact.phase,
        contact_object=contact.number if len(problem.profile.objects) > 1 else None,
        **friction,
    )
    scale = jnp.where(jnp.isfinite(u), 1 + jnp.abs(u), jnp.inf)
    largest = jnp.maximum(jnp.max(jnp.abs(residual)) / scale, jnp.max(wrong))
    return values, jnp.where(jnp.any(at.backwards), jnp.inf, largest), None


class ContactFields(NamedTuple):
    """The fields of a state that belong to contacts, (whiskers, contacts)."""

    force: Float[Array, "whiskers contacts"]
    slope: Float[Array, "whiskers contacts"]
    arc: Float[Array, "whiskers contacts"]
    x: Float[Array, "whiskers contacts"]
    y: Float[Array, "whiskers contacts"]
    phase: Int[Array, "whiskers contacts"]
    number: Int[Array, "whiskers contacts"]  # of the object; 0 without contact


def _apart(problem: ChainProblem, state: ChainState, contact: ContactFields) -> ContactFields:
    """The contacts, with a tip that is in an inner corner as two contacts, one with each face, if there is room."""
    signs, profile = corner_signs(problem.profile), problem.profile
    pinned = (state.phase[:, 0] == Phase.tip) & (signs[state.piece[:, 0]] < 0) & ~state.touches[:, -1]
    if problem.contacts == 1 or not profile.has_edges:
        return contact
    piece = jnp.where(pinned, state.piece[:, 0], 0)
    low, high = (jnp.where(pinned, end, 0.0) for end in profile.ends_on(piece))
    before, after = (jax.vmap(profile.point_on)(piece, end) for end in (low, high))
    first, last = (jnp.arctan2(at.sin, at.cos) for at in (before, after))
    turn = jnp.where(pinned, jnp.sin(last - first), 1.0)
    force, slope = contact.force[:, 0], contact.slope[:, 0]
    shares = jnp.sin(last - slope) / turn, jnp.sin(slope - first) / turn
    moved = jax.tree.map(lambda leaf: jnp.concatenate([leaf[:, :1], leaf[:, :-1]], axis=1), contact)
    two = moved._replace(
        force=moved.force.at[:, 0].set(force * shares[0]).at[:, 1].set(force * shares[1]),
        slope=moved.slope.at[:, 0].set(first).at[:, 1].set(last),
    )
    return jax.tree.map(lambda a, b: jnp.where(pinned[:, None], a, b), two, contact)
