"""The mechanics of scans in space whose whiskers may have several contacts each, with the signals of an equilibrium."""

from concurrent.futures import Executor

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts, any_of_whisker
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import at_control
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.march import follow
from jaxwhisker._path.path import Last, Node, Path, ScanPath, Status, Stops
from jaxwhisker._scan.mechanics import EventSides, Solutions
from jaxwhisker._scan.signals import beyond_phase
from jaxwhisker._scan.space import LANES, Space, SpaceSignals
from jaxwhisker._scan.state import SpaceState
from jaxwhisker._scan.steps import interpolate, is_near
from jaxwhisker._space.contact import FORCE, POINT, SLACK
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space_chain.continuation import ContinuationOfChainInSpace
from jaxwhisker._space_chain.implicit import sides_of_events, solved
from jaxwhisker._space_chain.newton import PhasesOfRows, of_whiskers, outermost, plain, residuals, solve_points
from jaxwhisker._space_chain.stance import bases_of

EVENTS = 64  # events of one whisker that a scan has room for


def follow_path(problem: SpaceProblem, stops: Stops, last: Last, sweeps: int | None = None) -> ScanPath:
    """March to all stops, given in the scene's units; right across the object if the first one is NaN."""
    problem, stops = jax.lax.stop_gradient((problem, jnp.asarray(stops)))
    return follow(ContinuationOfChainInSpace(problem), stops, last, sweeps)


follow_path_now = Program(follow_path, frozen=True, together=LANES)


class SeveralContactsInSpace(Space):
    """Whiskers in space with several contacts."""

    follows = follow_path_now

    @staticmethod
    def prepare(pool: Executor, scene: SpaceScene, problem: SpaceProblem, stops: int) -> tuple[Path, None]:
        return follow_path_now.prepare(pool, problem, np.zeros(stops), np.asarray(0)).path, None

    @staticmethod
    def solve(problem, path, index, u, known) -> Solutions:
        index = jnp.maximum(index, 0)  # of a path without nodes
        phase = path.nodes.state.phase[index]
        guess = jax.vmap(lambda index, u: interpolate(path, index, u))(index, u)
        guess = guess._replace(z=jnp.where((phase != Phase.free)[:, :, None], guess.z, 0.0))
        solution = solve_points(problem, phase, jax.vmap(at_control)(u, guess.z), plain(guess.z), guess)
        z = solution.point.z
        status = jnp.where(solution.converged & is_near(z, guess.z), Status.ok, Status.inexact)
        status = jnp.where(known == Status.ok, status, known)
        accepted = (status == Status.ok)[:, None]
        # Rejected steps are replaced by free whiskers, with finite values and derivatives (see `safe_placeholder`).
        phase = jnp.where(accepted, phase, int(Phase.free))
        return Solutions(jnp.where(accepted[:, None], z, 0.0), phase, status, index)

    @staticmethod
    def states(problem, u, solutions, remembered):
        del remembered

        def one(u: Scalar, z: RowsOfContacts, phase: PhasesOfRows):
            return signals(problem, solved(problem, z, u, phase), u, phase)

        return jax.vmap(one)(u, solutions.z, solutions.state)

    @staticmethod
    def checked(problem, solutions, status):
        return status

    @staticmethod
    def signals(problem, *side):
        return signals(problem, *side[:3])

    @staticmethod
    def event_room(whiskers: int) -> int:
        return EVENTS * whiskers

    @staticmethod
    def event_nodes(problem: SpaceProblem, path: Path) -> Node:
        return path.nodes._replace(whiskers=any_of_whisker(path.nodes.whiskers, problem.contacts))

    @staticmethod
    def at_events(problem, path, memory, at, filled) -> EventSides:
        return EventSides(*sides_of_events(problem, path.nodes, at, filled))

    @staticmethod
    def event_controls(problem, path, memory, at, filled):
        control, before, after = sides_of_events(problem, path.nodes, at, filled)
        touched, touches = (any_of_whisker(side.phase != Phase.free, problem.contacts) for side in (before, after))
        return control, touched & ~touches


def signals(problem: SpaceProblem, z: RowsOfContacts, u: Scalar, phase: PhasesOfRows) -> SpaceSignals:
    """State of an equilibrium, its largest residual, and the displacement of bases, None if they are clamped."""
    residual, pose, here = residuals(problem, z, u, phase, z)
    unit, each = problem.unit, of_whiskers(problem, phase)
    touches, touching, base = each != Phase.free, each[:, :1] != Phase.free, here.at.base
    placed = bases_of(problem, u, pose)
    slack = jnp.where(outermost(problem), z[:, SLACK], jnp.where(phase == Phase.free, 0.0, 1.0))
    wrong = jnp.where(phase == Phase.free, 0.0, jnp.maximum(beyond_phase(phase, z[:, FORCE], slack), 0.0))
    own = of_whiskers(problem, z)
    vectors = {
        ("fx", "fy", "fz"): jnp.where(touching, -base.force, 0.0) * unit.force,
        ("mx", "my", "mz"): jnp.where(touching, -base.moment, 0.0) * unit.moment,
        ("base_x", "base_y", "base_z"): placed.position * unit.length,
        ("contact_x", "contact_y", "contact_z"): jnp.where(touches[..., None], own[..., POINT], 0.0) * unit.length,
    }
    components = {name: vector[..., k] for names, vector in vectors.items() for k, name in enumerate(names)}
    objects = {}
    if len(problem.surface.objects) > 1:
        number = jax.vmap(problem.surface.object_of)(z[:, POINT]) + 1
        objects = {"contact_object": jnp.where(touches, of_whiskers(problem, number), 0)}
    state = SpaceState(
        **components,
        base_rotation=placed.rotation,
        contact_force=jnp.where(touches, own[..., FORCE], 0.0) * unit.force,
        contact_arc=jnp.where(touches, problem.length[:, None] - here.at.chain.beyond, 0.0) * unit.length,
        phase=each,
        **objects,
    )
    displacement = None
    if problem.springs is not None:
        displacement = jnp.concatenate([pose[:, :3] * unit.length, pose[:, 3:]], axis=1)
    return SpaceSignals(state, jnp.maximum(jnp.max(jnp.abs(residual)), jnp.max(wrong)), displacement)
