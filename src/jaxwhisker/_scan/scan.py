"""The scan: drag whiskers past an object, quasi-statically, and read the signals at their bases.

A scan has two parts. The march (march.py) follows the path of equilibria from free to the end of the control, with
steps of its own, and finds all events: what is stable, what snaps and where to does not depend on the caller's grid.
Then every control position is solved for on its own, from the path's interpolation, all at once.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium import newton
from jaxwhisker._equilibrium.clearance import in_scene
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.implicit import solved
from jaxwhisker._equilibrium.newton import Contacts, Mode, Point, at_control, find, scale_of
from jaxwhisker._model.scene import Problem, Scene, problem, units
from jaxwhisker._path.march import first_touch, march, nowhere
from jaxwhisker._path.path import Path, Status, dot
from jaxwhisker._scan.result import Events, Result, State
from jaxwhisker._scan.signals import events, signals

STEP = 0.001  # of the default control, in lengths of the first whisker
MOST_STEPS = 1_000_000  # of the default control
MARGIN = 0.01  # of the default control before the first touch and after the last whisker is free
TRACED_STEPS = 2048  # of the default control where its length has to be known before its ends
BLOCK = 512  # steps computed by one call; a control is padded to a multiple
BATCH = 32  # steps of a block solved for at once
RESIDUAL = 1e-8  # of a step that is called ok: directions and, relative to the drive's, positions at the base
JUMP = 0.05  # a solution this far from the path's interpolation belongs to another branch


def scan(scene: Scene, control: Control | None = None) -> Result:
    """Scan the object quasi-statically with the drive at every position of `control`.

    Args:
        scene: whiskers, object and support.
        control: drive positions u, a length each (of a Rotation angles, rad), any spacing, reversing if you like;
            shape (steps,). The drive comes from the right of the object, or where its motion begins, all whiskers
            free, to control[0] and then moves as told. Default: from just before the first touch to just after the
            last whisker is free, in steps of 0.001 whisker lengths or rad (while traced, 2048 equal steps over that
            range); to the end of the motion where whiskers do not come free.

    Returns:
        A Result. What fails is NaN with a status at that step (`invalid`, of a parameter outside its domain, `lost`,
        `unsettled`, `not_convex`, `too_long`, `inexact`, `unstable`).

    Raises:
        ValueError: if an argument is wrong before tracing, if the default control would be longer than a million steps
            (springs so soft that the drive goes on for a thousand lengths), if a whisker is so curved that it would
            touch in two places, or JAX is in float32 mode.

    Goes through jax.jit, vmap and derivatives, first and second, in both modes, by every numeric field of the scene and
    by the control: of signals, states and the events' positions. Derivatives are those of the step's own branch, at
    fixed control; exactly at a change of phase those of the phase that begins. What failed, or is free, has derivative
    0. Within a lax.map or lax.scan of your own, jax.hessian is NaN with jax 0.10: use vmap, or jacfwd of jacfwd.
    """
    checks.float64_mode()
    if not isinstance(scene, Scene):
        raise ValueError(f"`scene` must be a Scene, but is {scene!r}.")
    if control is not None:
        checks.vector("control", control)
    scene = jax.tree.map(checks.as_float, scene)
    if checks.is_traced((scene, control)):
        return _traced(scene, control)
    if control is None:
        stops, last = np.full(2, np.nan), 1
    else:
        control = np.asarray(control, dtype=float)
        stops, last = stops_of(control)
    leaves, structure = jax.tree.flatten(scene)
    _compile(structure, tuple(leaf.shape if checks.is_numeric(leaf) else leaf for leaf in leaves), stops.size)
    way = travelled_now(scene, jnp.asarray(stops), jnp.asarray(last))
    if way.path.status == Status.invalid:
        # All else that is wrong with a scene its constructors have told.
        raise ValueError(
            "`intrinsic_curvature` must let an unloaded whisker stand out towards the object in one place only, but "
            "there are two, in both of which it would touch."
        )
    if control is None:
        control = _across(scene, way)
    # Blocks of one size: one compilation serves scans of every length.
    padded = np.concatenate([control, np.full(-control.size % BLOCK, control[-1])]).reshape(-1, BLOCK)
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(padded.ravel())))]).reshape(-1, BLOCK)
    blocks = [_steps_now(scene, way.path, jnp.asarray(u), jnp.asarray(s)) for u, s in zip(padded, travel, strict=True)]
    joined = jax.tree.map(lambda *leaves: jnp.asarray(np.concatenate(leaves)[: control.size]), *blocks)
    return _result(scene, way, jnp.asarray(control), *joined)


def default_control(scene: Scene) -> np.ndarray:
    """The drive positions of `scan(scene)`: from just before the first touch to just after the last whisker is free.

    Raises:
        ValueError: if the scene is traced: the number of positions depends on its values.
    """
    checks.float64_mode()
    if checks.is_traced(scene):
        raise ValueError("`scene` must be concrete, but is traced: the number of positions depends on its values.")
    scene = jax.tree.map(checks.as_float, scene)
    return _across(scene, travelled_now(scene, jnp.full(2, jnp.nan), jnp.asarray(1)))


def _across(scene: Scene, way: "Way") -> np.ndarray:
    start, stop = float(way.start), float(way.stop)
    onwards, step = scene.motion.onwards, STEP * float(units(scene).control)
    count = max(2, int(np.ceil(onwards * (stop - start) / step)) + 1)
    if count > MOST_STEPS:
        raise ValueError(
            f"`control` must be given for so soft springs: from {start:g} to {stop:g} the default has {count:,} steps, "
            f"and at most {MOST_STEPS:,} are allowed."
        )
    return start + onwards * step * np.arange(count)


def stops_of(control: np.ndarray) -> tuple[np.ndarray, int]:
    """First position, turning points and last position, padded; and the index of the last."""
    moves = np.flatnonzero(np.diff(control))
    signs = np.sign(np.diff(control)[moves])
    turns = moves[1:][signs[1:] != signs[:-1]]
    stops = np.concatenate([control[:1], control[turns], control[-1:]])
    room = 2 if stops.size == 2 else TURNS * int(np.ceil(stops.size / TURNS))
    return np.concatenate([stops, np.full(room - stops.size, stops[-1])]), stops.size - 1


class Way(NamedTuple):
    """A path, its events, and the range of control in which they lie."""

    path: Path
    events: Events
    start: Float[Array, ""]
    stop: Float[Array, ""]


def _capacity(scene: Scene, stops: int) -> int:
    """How many nodes the path to so many stops may have."""
    return (256 + 64 * scene.support.whiskers) * max(1, stops // 2)


@eqx.filter_jit
def travelled(scene: Scene, stops: Float[Array, " stops"], last: Int[Array, ""]) -> Way:
    """March to all stops; with NaN for the first, right across the object."""
    dimensionless = problem(scene)
    unit = dimensionless.unit
    capacity, onwards = _capacity(scene, stops.shape[0]), dimensionless.motion.onwards
    start, end, far = _ends(dimensionless)
    across, whole = jnp.full_like(stops, far).at[0].set(start), jnp.isnan(stops[0])
    stops = jnp.where(whole, across, stops / unit.control)
    path = march(*jax.lax.stop_gradient((dimensionless, stops)), last, capacity=capacity)
    passed, event = jnp.arange(capacity) < path.count, path.nodes.kind >= 0
    known = passed & (event | (path.status != Status.ok))
    way = onwards * path.nodes.point.u
    stop = onwards * jnp.where(jnp.any(known), jnp.max(jnp.where(known, way, -jnp.inf)), onwards * end)
    stop += onwards * MARGIN
    if dimensionless.motion.ends is not None:
        first = onwards * jnp.min(jnp.where(passed & event, way, jnp.inf))
        begun = jnp.where(jnp.any(passed & event), first - onwards * MARGIN, start)
        travel = path.nodes.travel - jnp.where(whole, jnp.abs(begun - start), 0.0)
        path, start = path._replace(nodes=path.nodes._replace(travel=travel)), begun
        # Whiskers need not come free on such a way.
        touching = jnp.any(path.nodes.phase[path.count - 1] != Phase.free)
        stop = jnp.where(touching & (path.status == Status.ok), far, stop)
    ends = jnp.asarray(start * unit.control), jnp.asarray(stop * unit.control)
    return Way(path, events(dimensionless, path), *ends)


def _ends(problem: Problem) -> tuple[Scalar, Scalar, Scalar]:
    """Where a scan begins, where it ends if nothing happens, and how far it goes on looking."""
    onwards = problem.motion.onwards
    if problem.motion.ends is not None:
        start, end = (jnp.asarray(end, dtype=float) / problem.unit.control for end in problem.motion.ends)
        return start, end, end
    unloaded = in_scene(problem, jnp.asarray(0.0), newton.rest(problem, jnp.asarray(0.0)))
    middle, first = problem.profile.vertex()[0] - jnp.mean(unloaded.x), first_touch(problem)
    start = jnp.where(jnp.isfinite(first), first, middle - onwards) - onwards * MARGIN
    hardest = jnp.zeros((problem.length.size, problem.axes)).at[:, 0].set(HIGHEST_FORCE)
    softness = jnp.max(newton.yielding(problem, hardest))
    return start, middle + onwards, start + onwards * (FAR + softness)


FAR = 1e4  # lengths beyond the start; a march past the object ends long before, unless springs are very soft
HIGHEST_FORCE = 1e3  # EI / L^2 on every whisker, which a scan before snap-off hardly meets


def along(scene: Scene, control: Float[Array, " steps"], stops: Float[Array, " stops"], last: Int[Array, ""]) -> Result:
    """Scan a traced scene, the stops of the control known: its ends and turning points, and the index of the last.

    For whoever compiles scans themselves: `stops_of` tells the stops of a concrete control.
    """
    return finished(scene, control, travelled(scene, stops, last))


class Ways:
    """The way of a traced scene: its events, and the signals wherever the drive passes.

    For whoever fits scans. With NaN for the first stop the way leads right across the object, and begins at `start`.
    """

    def __init__(self, scene: Scene, stops: Float[Array, " stops"], last: Int[Array, ""]):
        self._scene, self._way = scene, travelled(scene, stops, last)
        self.events, self.start, self.status = self._way.events, self._way.start, self._way.path.status

    def signals(
        self, control: Float[Array, " steps"], travel: Float[Array, " steps"]
    ) -> tuple[Float[Array, "steps whiskers 3"], Bool[Array, " steps"]]:
        """Reactions fx, fy, mz at controls that the drive passes after `travel`, and whether they are ok."""
        state, _, status = _steps(self._scene, self._way.path, control, travel)
        return jnp.stack([state.fx, state.fy, state.mz], axis=-1), status == Status.ok


def finished(scene: Scene, control: Float[Array, " steps"], way: "Way") -> Result:
    """The states at all positions of the control, once the way is travelled."""
    travel = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(control)))])
    return _result(scene, way, control, *_steps(scene, way.path, control, travel))


def contact_range(scene: Scene) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """First and last position of the drive that the default control of a scene, traced or not, spans."""
    way = travelled(scene, jnp.full(2, jnp.nan), jnp.asarray(1))
    return way.start, way.stop


def _traced(scene: Scene, control: Control | None) -> Result:
    if control is None:
        way = travelled(scene, jnp.full(2, jnp.nan), jnp.asarray(1))
        start, stop = jax.lax.stop_gradient((way.start, way.stop))  # derivatives are those at fixed positions
        return finished(scene, start + (stop - start) * jnp.linspace(0.0, 1.0, TRACED_STEPS), way)
    if not checks.is_traced(control):
        control = np.asarray(control, dtype=float)
        stops, last = stops_of(control)
        return along(scene, jnp.asarray(control), jnp.asarray(stops), jnp.asarray(last))
    control = jnp.asarray(control, dtype=float)
    moves = jnp.sign(jnp.diff(control))
    # A turn is where a move has the other sign than the last one; standing still carries the last sign on.
    carried = jax.lax.associative_scan(lambda a, b: jnp.where(b == 0, a, b), moves)
    turns = jnp.concatenate([jnp.ones(1, bool), carried[1:] * carried[:-1] < 0, jnp.ones(1, bool)])
    turns = turns[-control.size :].at[0].set(True)
    index = jnp.nonzero(turns, size=min(2 * TURNS, control.size), fill_value=control.size - 1)[0]
    way = travelled(scene, control[index], jnp.minimum(jnp.sum(turns), index.size) - 1)
    # Of a path with more turns than there is room for, or with positions that are none, nothing is known.
    finite, short = jnp.all(jnp.isfinite(control)), jnp.sum(turns) <= index.size
    status = jnp.where(finite, jnp.where(short, way.path.status, Status.too_long), Status.invalid)
    count = jnp.where(finite & short, way.path.count, 0)
    return finished(scene, control, way._replace(path=way.path._replace(count=count, status=status)))


TURNS = 8  # stops of a control that turns are padded to a multiple of this; a traced control may have twice as many


def _guess(path: Path, index: Int[Array, ""], u: Scalar) -> Point:
    """The path between a node and the next, at a control in between: cubic in arc length."""
    here = jax.tree.map(lambda leaf: leaf[index], path.nodes)
    there = jax.tree.map(lambda leaf: leaf[jnp.minimum(index + 1, path.count - 1)], path.nodes)
    end = Point(there.z_before, there.point.u)
    scale = scale_of(here.point.z)
    chord = Point(end.z - here.point.z, end.u - here.point.u)
    length = dot(here.leaving, chord, scale)
    apart = length > 0
    length = jnp.where(apart, length, 1.0)
    into = dot(here.leaving, there.arriving, scale)
    into = jnp.where(into > 0, into, 1.0)

    def cubic(start, end, leaving, arriving, t):
        leaving, arriving = leaving * length, arriving * length / into
        bend = 3 * (end - start) - 2 * leaving - arriving
        twist = leaving + arriving - 2 * (end - start)
        return start + t * (leaving + t * (bend + t * twist)), leaving + t * (2 * bend + t * 3 * twist)

    def towards(_, t):
        value, slope = cubic(here.point.u, end.u, here.leaving.u, there.arriving.u, t)
        return jnp.clip(t - (value - u) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)

    span = end.u - here.point.u
    t = jnp.clip((u - here.point.u) / jnp.where(span == 0, 1.0, span), 0.0, 1.0)
    t = jax.lax.fori_loop(0, 6, towards, t)
    z, _ = cubic(here.point.z, end.z, here.leaving.z, there.arriving.z, t)
    return Point(jnp.where(apart, z, here.point.z), u)


class _Found(NamedTuple):
    """A solved step and what is thought of it."""

    z: Contacts
    mode: Mode
    exact: Bool[Array, ""]
    stable: Bool[Array, ""]


def _found(problem: Problem, path: Path, index: Int[Array, ""], u: Scalar, known: Bool[Array, ""]) -> _Found:
    """The equilibrium at a control behind a node of the path, if the path is known there."""
    mode = Mode(path.nodes.phase[index], path.nodes.side[index], jnp.asarray(False))
    guess = _guess(path, index, u)
    solution = find(problem, mode, at_control(u, guess.z), guess)
    z = solution.point.z
    near = jnp.max(jnp.abs(z - guess.z) / scale_of(z)) < JUMP
    exact = solution.converged & near
    stable = newton.stable(problem, mode, solution.newton.local)
    sound = known & exact & stable
    # What is not sound is computed on as if it were free: finite, and so are its derivatives (see _lanes.py).
    mode = mode._replace(phase=jnp.where(sound, mode.phase, Phase.free))
    return _Found(jnp.where(sound, z, 0.0), mode, exact, stable)


def _moving(problem: Problem, u: Scalar, found: _Found) -> Point:
    """The equilibrium, with its derivatives."""
    return solved(Point(found.z, jax.lax.stop_gradient(u)), problem, found.mode, at_control(u, found.z))


def _state(problem: Problem, point: Point, found: _Found) -> tuple[State, Int[Array, ""]]:
    """State and status."""
    state, residual = signals(problem, point.z, point.u, found.mode)
    exact = found.exact & (residual < RESIDUAL)
    return state, jnp.where(exact, jnp.where(found.stable, Status.ok, Status.unstable), Status.inexact)


@eqx.filter_jit
def _steps(
    scene: Scene, path: Path, control: Float[Array, " steps"], travel: Float[Array, " steps"]
) -> tuple[State, Float[Array, "steps springs"], Int[Array, " steps"]]:
    """States, spring lengths and status at control positions that the drive passes after `travel`."""
    dimensionless, path = problem(scene), jax.lax.stop_gradient(path)
    unit = dimensionless.unit
    u, travel = control / unit.control, travel / unit.control
    node_travel = jnp.where(jnp.arange(path.nodes.travel.shape[0]) < path.count, path.nodes.travel, jnp.inf)
    end = node_travel[path.count - 1]
    noise = TRAVEL_NOISE * (1 + end)
    # Exactly at an event a step belongs to what begins there, whichever side rounding puts it on.
    index = jnp.clip(jnp.searchsorted(node_travel, travel + noise, side="right") - 1, 0, path.count - 1)
    beyond = (travel > end + noise) | (path.count == 0)

    known = dimensionless.valid & ~(beyond & (path.status != Status.ok))
    fixed, steps = jax.lax.stop_gradient((dimensionless, (index, u, known)))
    batch = min(BATCH, control.shape[0])
    found = jax.lax.map(lambda step: _found(fixed, path, *step), steps, batch_size=batch)
    # In no loop: differentiated backwards, a loop forgets the rules by which derivatives have derivatives.
    points = jax.vmap(partial(_moving, dimensionless))(jnp.where(jnp.isfinite(u), u, 0.0), found)
    state, status = jax.lax.map(lambda step: _state(dimensionless, *step), (points, found), batch_size=batch)
    status = jnp.where(beyond & (path.status != Status.ok), path.status, status)
    status = jnp.where(dimensionless.valid, status, Status.invalid)
    ok = (status == Status.ok)[:, None]
    state = jax.tree.map(lambda leaf: jnp.where(ok, leaf, jnp.nan if eqx.is_inexact_array(leaf) else 0), state)
    return state, jax.vmap(partial(_spring_length, scene, dimensionless))(state, u), status


def _spring_length(scene: Scene, problem: Problem, state: State, u: Scalar) -> Float[Array, " springs"]:
    """Lengths of the springs, in the drive's frame."""
    if problem.mount is None:
        return scene.support.spring_length((state.base_x - u * problem.unit.length)[:, None])
    x, y, angle = problem.drive(u)
    cos, sin, unit = jnp.cos(angle), jnp.sin(angle), problem.unit.length
    right, up = state.base_x - x * unit, state.base_y - y * unit
    mount = problem.mount
    along = [right * cos + up * sin - mount.x * unit, up * cos - right * sin - mount.y * unit]
    return scene.support.spring_length(jnp.stack([*along, state.base_angle - angle - mount.angle], axis=1))


def _result(
    scene: Scene,
    way: Way,
    control: Float[Array, " steps"],
    state: State,
    spring_length: Float[Array, "steps springs"],
    status: Int[Array, " steps"],
) -> Result:
    fields = {name: getattr(state, name) for name in State.__dataclass_fields__}
    return Result(**fields, control=control, spring_length=spring_length, status=status, events=way.events, scene=scene)


TRAVEL_NOISE = 1e-12


# Of concrete scenes; options of the compiler are allowed in no other function's jit.
_COMPILED: Any = {"compiler_options": COMPILER_OPTIONS}
travelled_now = eqx.filter_jit(travelled.__wrapped__, **_COMPILED)
_steps_now = eqx.filter_jit(_steps.__wrapped__, **_COMPILED)


@lru_cache(maxsize=1024)
def _compile(structure: Any, leaves: tuple, stops: int) -> None:
    """Compile march and steps for scenes of this structure, whose numeric leaves are given by their shapes.

    Not needed, but when both are compiled at once the second costs little: the compiler of one leaves a core idle.
    """
    filled = [jnp.asarray(np.ones(leaf)) if isinstance(leaf, tuple) else leaf for leaf in leaves]
    scene = jax.tree.unflatten(structure, filled)
    with ThreadPoolExecutor(1) as aside:
        lowered = travelled_now.lower(scene, jnp.asarray(np.ones(stops)), jnp.asarray(1))
        compiled = aside.submit(lowered.compile)
        path = jax.eval_shape(lambda: nowhere(problem(scene), _capacity(scene, stops)))
        path = jax.tree.map(lambda leaf: jnp.asarray(np.zeros(leaf.shape, leaf.dtype)), path)
        block = jnp.asarray(np.zeros(BLOCK))
        _steps_now.lower(scene, path, block, block).compile()
        compiled.result()
