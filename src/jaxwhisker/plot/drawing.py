"""The geometry of a state: what there is to draw, in lengths of the first whisker, before anything draws it.

Nothing here knows matplotlib: pictures and films share it. A state is one of a scan's steps, one beside an event, or
any other; the number of lines and of their points depends on the scene alone, so that films move what they have drawn.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.problem import problem_of
from jaxwhisker._model.motion import Pose, Rotation
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._model.spring import AXES, Spring
from jaxwhisker._path.approach import FromAfar
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.shapes import shapes_of
from jaxwhisker._scan.state import State

POINTS = 64  # of a whisker's centre line
AMPLITUDE = 0.018  # of a spring's zigzag
SHORT = 0.1  # springs that rest shorter than this ...
STAND = 0.16  # ... are drawn longer by this, from a wall that moves with the drive
DEPTH = 0.08  # by which springs hang that pass other bases, one below the other
COIL = 0.085  # radius of a torsion spring
THIN, THICK = 0.9, 2.5  # line widths, points
NEAR = 1.5  # lengths from the drive up to which a pivot is shown
AHEAD = 0.05  # lengths before the first touch
LOOKED_AT = 241  # controls of a motion at which the first touch is looked for
_TURNS = 2.25  # of a torsion spring at rest: it ends below to the right, away from springs along x and y
_LEAST_ARROW, _LONGEST_ARROW = 0.1, 0.35


class Line(NamedTuple):
    """A polyline."""

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]
    width: float = THIN  # points


class Arrow(NamedTuple):
    """A contact force: it ends where it acts, and points the way the object pushes the whisker."""

    tail: tuple[float, float]
    head: tuple[float, float]


class Drawing(NamedTuple):
    """Everything that there is to draw of a state but the object."""

    drive: Pose  # where the drive stands
    arm: Line | None  # from the pivot of a rotation to the drive
    whiskers: tuple[Line, ...]  # centre lines from base to tip
    bases: Line  # the bases as points, one per whisker
    springs: tuple[Line, ...]  # as the support has them; rigid ones straight and thick, as what holds clamped bases
    arrows: tuple[Arrow | None, ...]  # per whisker; None where it is free or unknown

    def extent(self, *, springs: bool = True) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """x and y of whatever a window should hold; without springs only of whiskers and drive."""
        lines = [*self.whiskers, Line(np.array([self.drive.x]), np.array([self.drive.y]))]
        if springs:
            lines += self.springs
            lines += [Line(*np.array(arrow.tail)[:, None]) for arrow in self.arrows if arrow is not None]
            if self.arm is not None and np.hypot(np.ptp(self.arm.x), np.ptp(self.arm.y)) < NEAR:
                lines += [self.arm]
        x, y = (np.concatenate([line[k] for line in lines]) for k in (0, 1))
        known = np.isfinite(x)
        return x[known], y[known]


def drawing(scene: Scene, control: float, state: State, *, largest: float | None = None) -> Drawing:
    """What there is to draw of any state of a scene; NaN where the state is.

    Args:
        scene: of which it is a state.
        control: where the drive is, in the scene's units.
        state: fields (whiskers,), in the scene's units: of an event, say, or of `state_at`.
        largest: the contact force whose arrow is longest; by default that of the state.
    """
    size = float(units(scene).length)
    whiskers = jax.tree.map(checks.as_float, scene.whiskers)
    lines = shapes_of(jax.tree.map(np.asarray, state), whiskers, points=POINTS)
    x, y = np.asarray(lines.x) / size, np.asarray(lines.y) / size
    bases = Line(np.asarray(state.base_x) / size, np.asarray(state.base_y) / size)
    drive = drive_pose(scene, control)
    forces = np.nan_to_num(np.asarray(state.contact_force))
    most = forces.max() if largest is None else largest
    pivot = scene.motion.pivot if isinstance(scene.motion, Rotation) else None
    ends = None if pivot is None else [(float(p) / size, here) for p, here in zip(pivot, drive, strict=False)]
    return Drawing(
        drive,
        None if ends is None else Line(*np.array(ends)),
        tuple(Line(*line) for line in zip(x, y, strict=True)),
        bases,
        spring_lines(scene, drive, bases, np.asarray(state.base_angle)),
        tuple(force_arrow(state, k, most, size) for k in range(forces.size)),
    )


def drawing_at(result: Result, step: int) -> Drawing:
    """What there is to draw of a scan's step; arrows compare with the scan's largest contact force."""
    control = float(result.control[step])
    return drawing(result.scene, control, state_at(result, step), largest=largest_force(result))


def start_of(scene: Scene) -> float:
    """The control at which the first unloaded whisker is about to touch, in the scene's units.

    The vertex, for whiskers that never do; of a motion of one's own, where it then begins.
    """
    equations = problem_of(jax.tree.map(checks.as_float, scene))
    motion, unit = equations.motion, float(equations.unit.control)
    if motion.ends is None:
        first = float(FromAfar(equations).first_touch()) - AHEAD * motion.onwards
        return unit * (first if np.isfinite(first) else float(equations.profile.vertex()[0]))

    def clears(u):
        return jnp.all(equations.stance(u, equations.rest(u)).clear)

    start, end = (float(end) / unit for end in motion.ends)
    controls = np.linspace(start, end, LOOKED_AT)
    meets = np.flatnonzero(~np.asarray(jax.vmap(clears)(jnp.asarray(controls))))
    return unit * (float(controls[max(meets[0] - 1, 0)]) if meets.size else start)


def rest_state(scene: Scene, control: float) -> State:
    """The unloaded whiskers with the drive there, whether or not the object stands in their way."""
    equations = problem_of(jax.tree.map(checks.as_float, scene))
    u = jnp.asarray(control, dtype=float) / equations.unit.control
    at = equations.in_scene(u, equations.rest(u))
    size, none = float(units(scene).length), np.zeros(scene.support.whiskers)
    fields = dict.fromkeys(State.__dataclass_fields__, none)
    fields |= {"base_x": np.asarray(at.x) * size, "base_y": np.asarray(at.y) * size, "base_angle": np.asarray(at.angle)}
    return _state(fields | {"phase": none.astype(int)})


def state_at(result: Result, step: int) -> State:
    """The state at a step."""
    return _state({name: np.asarray(getattr(result, name))[step] for name in State.__dataclass_fields__})


def _state(fields: dict[str, np.ndarray]) -> State:
    return State(**{name: jnp.asarray(field) for name, field in fields.items()})


def largest_force(result: Result) -> float:
    """The largest contact force of a scan; 0 if nothing is known or touched."""
    return float(np.nan_to_num(np.asarray(result.contact_force)).max(initial=0.0))


def drive_pose(scene: Scene, control: float) -> Pose:
    """Where the drive stands."""
    size = float(units(scene).length)
    x, y, angle = (float(value) for value in scene.motion.pose(control))
    return Pose(x / size, y / size, angle)


def force_arrow(state: State, whisker: int, largest: float, size: float = 1.0) -> Arrow | None:
    """The contact force on a whisker, counted from 0; its length tells the share of the largest one."""
    force, slope = float(state.contact_force[whisker]), float(state.contact_slope[whisker])
    if int(state.phase[whisker]) == Phase.free or not force > 0:
        return None
    x, y = float(state.contact_x[whisker]) / size, float(state.contact_y[whisker]) / size
    length = _LEAST_ARROW + (_LONGEST_ARROW - _LEAST_ARROW) * force / max(largest, force)
    return Arrow((x - length * np.sin(slope), y + length * np.cos(slope)), (x, y))


def spring_lines(scene: Scene, drive: Pose, bases: Line, angle: Float[np.ndarray, " whiskers"]) -> tuple[Line, ...]:
    """The springs of the support, with the bases there, at these angles to the upright.

    Springs along x and y are as long as they are, but for those that rest at nearly no length (see SHORT): these start
    from a wall. Torsion springs wind up and unwind with their angle.
    """
    size = float(units(scene).length)
    cos, sin = np.cos(drive.angle), np.sin(drive.angle)
    right, up = bases.x - drive.x, bases.y - drive.y
    # In the drive's frame; the drive itself comes first.
    poses = np.stack([right * cos + up * sin, up * cos - right * sin, angle - drive.angle], axis=1)
    poses = np.concatenate([np.zeros((1, 3)), poses])
    mounts = np.array(
        [(0.0, 0.0, 0.0), *((m.x / size, m.y / size, m.angle) for m in scene.support.mounts)], dtype=float
    )
    lowest = mounts[:, 1].min()
    springs, lines = scene.support.springs, []
    for spring, depth in zip(springs, _depths(springs), strict=True):
        first, second = spring.between
        here, there, offset = poses[first], poses[second], mounts[second] - mounts[first]
        rigid = float(spring.softness) == 0
        if spring.axis == "phi":
            x, y = _coil(there, there[2] - here[2] - offset[2], here[2], rigid)
        else:
            along = AXES.index(spring.axis)
            level = lowest - DEPTH * depth if depth else there[1 - along]
            short = abs(float(spring.rest_length)) / size < SHORT
            x, y = _straight(here, there, along, level, offset[along], short, rigid)
        turned = drive.x + cos * x - sin * y, drive.y + sin * x + cos * y
        lines.append(Line(np.asarray(turned[0]), np.asarray(turned[1]), THICK if rigid else THIN))
    if not springs:
        ends = zip(bases.x, bases.y, strict=True)
        lines = [Line(np.array([drive.x, x]), np.array([drive.y, y]), THICK) for x, y in ends]
    return tuple(lines)


def _depths(springs: Sequence[Spring]) -> list[int]:
    """How deep each spring hangs: along x those that pass other bases, or would lie on another one."""
    depths, seen = [], set()
    for spring in springs:
        first, second = spring.between
        hangs = spring.axis == "x" and (abs(second - first) > 1 or spring.between in seen)
        depths.append(1 + max(depths, default=0) if hangs else 0)
        seen |= {spring.between} if spring.axis == "x" else set()
    return depths


def _straight(
    here: np.ndarray, there: np.ndarray, along: int, level: float, offset: float, short: bool, rigid: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A spring between two ends along an axis of the drive's frame, on some level of the other axis."""
    across = 1 - along
    start, end = here[along] + offset - STAND * short, there[along]
    swing = 0.0 if rigid else AMPLITUDE
    # Straight ends and six turns between: the number stays, so a stretched spring looks stretched.
    turns = np.r_[0.0, 0.2, 0.2 + 0.6 * (np.arange(12) + 0.5) / 12, 0.8, 1.0]
    zigzag = swing * np.r_[0.0, 0.0, np.tile([1.0, -1.0], 6), 0.0, 0.0]
    wall = 2 * AMPLITUDE * np.array([-1.0, 1.0, 0.0])
    head = (
        (np.full(3, start), level + wall)
        if short
        else ([here[along], here[along], start], [here[across], level, level])
    )
    line = (
        np.concatenate([head[0], start + turns * (end - start), [end]]),
        np.concatenate([head[1], level + zigzag, [there[across]]]),
    )
    return line if along == 0 else (line[1], line[0])


def _coil(there: np.ndarray, angle: float, holder: float, rigid: bool) -> tuple[np.ndarray, np.ndarray]:
    """A torsion spring around a base: its inner end turns with it, its outer end with what holds it."""
    share = np.linspace(0.0, 1.0, 97)
    outer = holder - np.pi / 4
    turned = outer + (1 - share) * (0.0 if rigid else angle - 2 * np.pi * _TURNS)
    radius = COIL * np.append(share, 1.4)
    turned = np.append(turned, outer)
    return there[0] + radius * np.cos(turned), there[1] + radius * np.sin(turned)
