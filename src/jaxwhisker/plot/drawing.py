"""Geometry of a state as polylines and arrows, with the length of the first whisker as unit.

Figures and films share it, so it does not use matplotlib. A state may belong to a step or to an event. The number of
lines and points depends only on the scene, because films draw every line once and then move it.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import all_free
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.motion import Pose, Rotation
from jaxwhisker._model.scene import Scene, Sensor, units
from jaxwhisker._model.spring import AXES, Spring
from jaxwhisker._plane.approach import Bounded, FromAfar
from jaxwhisker._scan.plane import problem_now
from jaxwhisker._scan.quantities import is_of_contacts
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker._scan.signals import signals
from jaxwhisker._scan.springs import holds, loads_of, on_shafts
from jaxwhisker._scan.state import OPTIONAL, State, base_of, state_of
from jaxwhisker.plot.runs import PlaneRun, Run, lines_of_motion, states_at

if TYPE_CHECKING:
    from jaxwhisker._chain.problem import ChainProblem

# Lengths are in L of the first whisker.
LINE_POINTS = 64  # per centre line
AMPLITUDE = 0.018  # of a spring's zigzag
NO_LENGTH = 1e-3  # a spring with a smaller rest length has no length to draw ...
STAND = 0.16  # ... and starts this far behind, at a wall that moves with the drive
DEPTH = 0.08  # vertical distance between springs that pass below other bases
COIL = 0.085  # radius of a torsion spring
THIN, THICK = 0.9, 2.5  # line widths, points
PIVOT_NEAR = 1.5  # a window holds the pivot of a rotation up to this distance from the drive
BEFORE_TOUCH = 0.05  # distance between the drive and its position at the first touch in the figure of a scene
CONTROLS = 241  # of a motion that are searched for the first touch
IMPACTS = 0.02  # share of the samples in contact that may be impacts
_TURNS = 2.25  # of a torsion spring at rest: it ends below to the right, clear of springs along x and y
_LEAST_ARROW, _LONGEST_ARROW = 0.1, 0.35


class Line(NamedTuple):
    """A polyline."""

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]
    width: float = THIN  # points

    def scaled(self, factor: float) -> "Line":
        """The line with coordinates multiplied by a factor."""
        return Line(factor * self.x, factor * self.y, self.width)


class Arrow(NamedTuple):
    """A contact force on a whisker; the head is at the contact point."""

    tail: tuple[float, float]
    head: tuple[float, float]

    def scaled(self, factor: float) -> "Arrow":
        """The arrow with coordinates multiplied by a factor."""
        return Arrow(*((factor * x, factor * y) for x, y in self))


class Drawing(NamedTuple):
    """A state without the object."""

    drive: Pose
    arm: Line | None  # from the pivot of a rotation to the drive
    whiskers: tuple[Line, ...]  # centre lines from base to tip
    bases: Line  # one point per whisker
    springs: tuple[Line, ...]  # in the order of the support; rigid springs and clamps are straight and thick
    arrows: tuple[Arrow | None, ...]  # per whisker, and per contact of it; None where it is free or unknown

    def scaled(self, factor: float) -> "Drawing":
        """The drawing in another unit of length."""

        def scale(part):
            return part.scaled(factor) if isinstance(part, Line | Arrow) else part

        x, y, angle = self.drive
        scaled = jax.tree.map(scale, self, is_leaf=lambda part: isinstance(part, Line | Arrow))
        return scaled._replace(drive=Pose(factor * x, factor * y, angle))

    def extent(self, *, springs: bool = True) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """x and y of all points that a window should hold; without springs, those of whiskers and drive."""
        points = [np.array(self.drive[:2])[:, None], *(line[:2] for line in self.whiskers)]
        if springs:
            points += [line[:2] for line in self.springs]
            points += [np.array(arrow.tail)[:, None] for arrow in self.arrows if arrow is not None]
            if self.arm is not None and np.hypot(np.ptp(self.arm.x), np.ptp(self.arm.y)) < PIVOT_NEAR:
                points.append(self.arm[:2])
        x, y = np.concatenate(points, axis=1)
        known = np.isfinite(x)
        return x[known], y[known]


def drawing(
    scene: Scene | Sensor,
    control: float,
    state: State,
    *,
    lines: Shapes | None = None,
    largest: float | None = None,
) -> Drawing:
    """Geometry of a state of a scene; NaN where the state is NaN.

    Args:
        scene: scene of the state.
        control: control of the drive, in the scene's units.
        state: a state with fields (whiskers,) in the scene's units, for example of an event or from `states_at`.
        lines: centre lines (whiskers, points) in the scene's units; by default those of whiskers in equilibrium.
        largest: contact force with the longest arrow; by default the largest one of the state.
    """
    size = float(units(scene).length)
    if lines is None:
        assert isinstance(scene, Scene)
        lines = shapes_of(scene, jax.tree.map(np.asarray, state), control, points=LINE_POINTS)
    bases = Line(np.asarray(state.base_x) / size, np.asarray(state.base_y) / size)
    ends = ends_on_shafts(scene, state, control, lines)
    drive, arm = drive_pose(scene, control), None
    forces = np.nan_to_num(np.asarray(state.contact_force))
    most = forces.max() if largest is None else largest
    if isinstance(scene.motion, Rotation):
        x, y = (float(value) / size for value in scene.motion.pivot)
        arm = Line(np.array([x, drive.x]), np.array([y, drive.y]))
    return Drawing(
        drive,
        arm,
        tuple(Line(*line) for line in zip(np.asarray(lines.x) / size, np.asarray(lines.y) / size, strict=True)),
        bases,
        spring_lines(scene, drive, bases, np.asarray(state.base_angle), ends),
        tuple(force_arrow(state, k, most, size) for k in range(forces.size)),
    )


def drawing_at(result: PlaneRun, step: int) -> Drawing:
    """Geometry of a step of a scan or a sample of a simulation; its largest contact force has the longest arrow."""
    lines = None
    if isinstance(result, Simulation):
        lines = jax.tree.map(lambda line: line[0], lines_of_motion(result, [step], points=LINE_POINTS))
    state, largest = states_at(result, step), largest_force(result)
    return drawing(result.scene, float(result.control[step]), state, lines=lines, largest=largest)


def start_of(scene: Scene) -> float:
    """Control just before the first unloaded whisker touches the object, in the scene's units.

    If no whisker touches, it is x of the object's vertex, or the start of a motion that has ends.
    """
    if scene.contacts > 1:
        return _start_of_several(scene)
    problem = problem_now(jax.tree.map(checks.as_float, scene))
    unit = float(problem.unit.control)
    if problem.ends is None:
        first = float(_first_touch(problem)) - BEFORE_TOUCH * scene.motion.onwards
        return unit * (first if np.isfinite(first) else float(problem.profile.vertex()[0]))
    first, last = map(float, problem.ends)
    controls = np.linspace(first, last, CONTROLS)
    meets = np.flatnonzero(~np.asarray(_clear(problem, controls)))
    return unit * (float(controls[max(meets[0] - 1, 0) if meets.size else 0]))


def _start_of_several(scene: Scene) -> float:
    """The same for whiskers that may have several contacts; a translation stops up to twice as far away."""
    from jaxwhisker._scan.chain import problem_now as chain_problem_now

    problem = chain_problem_now(jax.tree.map(checks.as_float, scene))
    return float(problem.unit.control) * float(_last_clear(problem))


@Program
def _last_clear(problem: "ChainProblem") -> Scalar:
    from jaxwhisker._chain.approach import CLEAR, clearance, limits_of

    limits = limits_of(problem, jnp.asarray(jnp.nan))
    if problem.ends is None:
        return limits.start - BEFORE_TOUCH * problem.onwards
    controls = jnp.linspace(limits.start, limits.far, CONTROLS)
    clear = jax.lax.map(lambda u: clearance(problem, u) > CLEAR, controls, batch_size=16)
    meets = jnp.argmin(clear)  # 0 if all are clear
    return controls[jnp.maximum(meets - 1, 0)]


@Program
def _first_touch(problem: Problem) -> Scalar:
    return FromAfar(problem).first_touch()


@Program
def _clear(problem: Problem, controls: Float[Array, " controls"]) -> Bool[Array, " controls"]:
    """Whether all unloaded whiskers are clear of the object, at each control."""
    return jax.vmap(Bounded(problem).starts_clear)(controls)


def rest_state(scene: Scene, control: float) -> State:
    """State of the unloaded whiskers at a control, as if there were no object."""
    return _rest_state(*jax.tree.map(checks.as_float, (scene, control)))


@Program
def _rest_state(scene: Scene, control: Scalar) -> State:
    problem = problem_of(scene)
    u = control / problem.unit.control
    if problem.attached is not None:
        free = all_free(problem, jnp.ones(scene.support.whiskers))
        return signals(problem, problem.unloaded(u)[0], u, free)[0]
    at, size = problem.in_scene(u, problem.rest(u)), problem.unit.length
    none = jnp.zeros(scene.support.whiskers)
    fields: dict[str, Any] = dict.fromkeys((name for name in State.__dataclass_fields__ if name not in OPTIONAL), none)
    if scene.contacts > 1:
        of_contacts = jnp.zeros((scene.support.whiskers, scene.contacts))
        fields = {name: of_contacts if is_of_contacts(name) else value for name, value in fields.items()}
    fields["phase"] = fields["phase"].astype(int)
    return State(**fields | {"base_x": at.x * size, "base_y": at.y * size, "base_angle": at.angle})  # pyright: ignore


def largest_force(result: Run) -> float:
    """Largest contact force; 0 without contact. Impacts of a simulation, which last for one time step, do not count."""
    force = np.nan_to_num(np.asarray(result.contact_force))
    if isinstance(result, Simulation) and np.any(force > 0):
        return float(np.quantile(force[force > 0], 1 - IMPACTS))
    return float(force.max(initial=0.0))


def drive_pose(scene: Scene | Sensor, control: float) -> Pose:
    """Pose of the drive at a control."""
    size = float(units(scene).length)
    x, y, angle = (float(value) for value in scene.motion.pose(control))
    return Pose(x / size, y / size, angle)


def force_arrow(state: State, contact: int, largest: float, size: float = 1.0) -> Arrow | None:
    """Force of a contact; the length of the arrow grows with its share of the largest force.

    Contacts are counted from 0, first those of the first whisker.
    """
    fields = state.contact_force, state.contact_slope, state.contact_x, state.contact_y, state.phase
    force, slope, x, y, phase = (float(np.ravel(field)[contact]) for field in fields)
    if phase == Phase.free or not force > 0:
        return None
    x, y = x / size, y / size
    length = arrow_length(force, largest)
    return Arrow((x - length * np.sin(slope), y + length * np.cos(slope)), (x, y))


def arrow_length(force: Any, largest: float) -> Any:
    """Length of the arrow of a force, or of several ones."""
    return _LEAST_ARROW + (_LONGEST_ARROW - _LEAST_ARROW) * force / np.maximum(np.maximum(largest, force), 1e-300)


Place = tuple[float, float]
Ends = Sequence[tuple[Place, Place]]  # on the drive and on the whisker


def ends_on_shafts(scene: Scene | Sensor, state: State, control: float, lines: Shapes) -> Ends:
    """Ends of the springs on shafts, in the order of the support, in lengths of the first whisker."""
    by, size = holds(scene), float(units(scene).length)
    if by is None:
        return ()
    known = state_of(state)
    given = jax.tree.map(checks.as_float, (by, scene.whiskers, base_of(known), loads_of(known), control))
    every = jax.tree.map(lambda end: float(end) / size, _on_shafts(*given))
    places = []
    for spring, one in zip(scene.support.attached, every, strict=True):
        # Whiskers in motion are not in equilibrium: their centre lines tell where springs end.
        *first, last = [_on_line(lines, state, whisker - 1, float(at), size) for whisker, at in spring.ends]
        places.append((first[0] if first else (one.anchor_x, one.anchor_y), last))
    return places


def _on_line(lines: Shapes, state: State, whisker: int, at: float, size: float) -> Place:
    """The point of a centre line, or of the follicle below it, at an arc length."""
    x, y = np.asarray(lines.x)[whisker], np.asarray(lines.y)[whisker]
    arc = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    below, angle = min(at, 0.0), float(state.base_angle[whisker])
    end_x, end_y = np.interp(at, arc, x) - below * np.sin(angle), np.interp(at, arc, y) + below * np.cos(angle)
    return float(end_x) / size, float(end_y) / size


_on_shafts = Program(on_shafts)


def spring_lines(
    scene: Scene | Sensor, drive: Pose, bases: Line, angle: Float[np.ndarray, " whiskers"], on_shafts: Ends
) -> tuple[Line, ...]:
    """Springs of the support for given poses of the drive and of the bases; angles are measured from the upright.

    Springs along x and y have their true length. Springs with a rest length near zero (below NO_LENGTH) start at a wall
    instead. Torsion springs wind and unwind with their angle.
    """
    size, ends = float(units(scene).length), np.stack(bases[:2], axis=1)
    cos, sin = np.cos(drive.angle), np.sin(drive.angle)
    turn, origin = np.array([[cos, -sin], [sin, cos]]), np.array([drive.x, drive.y])
    springs, lines = scene.support.springs, []
    if not springs:
        return tuple(Line(*np.stack([origin, end], axis=1), width=THICK) for end in ends)
    # Poses in the frame of the drive; the first one is the drive itself.
    poses = np.column_stack([(ends - origin) @ turn, angle - drive.angle])
    poses = np.concatenate([np.zeros((1, 3)), poses])
    mounts = np.array([(0.0, 0.0, 0.0), *((m.x / size, m.y / size, m.angle) for m in scene.support.mounts)])
    attached = iter(on_shafts)
    for spring, depth in zip(springs, _depths(springs), strict=True):
        if not spring.linear:
            lines.append(_between(*next(attached)))
            continue
        first, second = spring.between
        here, there, offset = poses[first], poses[second], mounts[second] - mounts[first]
        rigid = float(spring.softness) == 0
        if spring.axis == "phi":
            own = _coil(there, there[2] - here[2] - offset[2], here[2], rigid)
        else:
            along = AXES.index(spring.axis)
            level = mounts[:, 1].min() - DEPTH * depth if depth else there[1 - along]
            short = abs(float(spring.rest_length)) / size < NO_LENGTH
            own = _straight(here, there, along, level, offset[along], short, rigid)
        lines.append(Line(*(origin[:, None] + turn @ own), width=THICK if rigid else THIN))
    return tuple(lines)


def _depths(springs: Sequence[Spring]) -> list[int]:
    """Level of each spring below the bases: 0, or 1, 2, ... for springs along x that pass a base or overlap another."""
    depths, drawn = [], set()
    for spring in springs:
        first, second = spring.between
        hangs = spring.linear and spring.axis == "x" and (abs(second - first) > 1 or spring.between in drawn)
        depths.append(1 + max(depths, default=0) if hangs else 0)
        drawn |= {spring.between} if spring.linear and spring.axis == "x" else set()
    return depths


def _between(start: Place, end: Place) -> Line:
    """Zigzag from one point to another."""
    first, way = np.array(start), np.subtract(end, start)
    length = np.hypot(*way)
    across = np.array([-way[1], way[0]]) / max(length, 1e-12)
    turns, swing = zigzag_shape(rigid=False)
    return Line(*(first[:, None] + way[:, None] * turns + across[:, None] * swing), width=THIN)


def zigzag_shape(rigid: bool) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the length, and deflections, of the points of a spring."""
    # The number of turns is fixed, so a stretched spring looks stretched.
    turns = np.r_[0.0, 0.2, 0.2 + 0.6 * (np.arange(12) + 0.5) / 12, 0.8, 1.0]
    return turns, (0.0 if rigid else AMPLITUDE) * np.r_[0.0, 0.0, np.tile([1.0, -1.0], 6), 0.0, 0.0]


def _straight(
    here: np.ndarray, there: np.ndarray, along: int, level: float, offset: float, short: bool, rigid: bool
) -> np.ndarray:
    """Zigzag along one axis of the drive's frame, at a level of the other axis; x and y in rows."""
    start, end = here[along] + offset - STAND * short, there[along]
    turns, swing = zigzag_shape(rigid)
    if short:  # a wall
        head = np.stack([np.full(3, start), level + 2 * AMPLITUDE * np.array([-1.0, 1.0, 0.0])])
    else:
        head = np.array([[here[along], here[along], start], [here[1 - along], level, level]])
    zigzag, tail = np.stack([start + turns * (end - start), level + swing]), np.array([[end], [there[1 - along]]])
    line = np.concatenate([head, zigzag, tail], axis=1)
    return line if along == 0 else line[::-1]


def _coil(there: np.ndarray, angle: float, holder: float, rigid: bool) -> np.ndarray:
    """Spiral around a base: the inner end turns with the base, the outer end with the body that holds it."""
    share = np.linspace(0.0, 1.0, 97)
    outer = holder - np.pi / 4
    turned = np.append(outer + (1 - share) * (0.0 if rigid else angle - 2 * np.pi * _TURNS), outer)
    return there[:2, None] + COIL * np.append(share, 1.4) * np.stack([np.cos(turned), np.sin(turned)])
