"""Pictures of scenes in space: whiskers, springs, drive, directors, object and contact forces.

Lengths are in L of the first whisker, until they are drawn.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.drives import Placement, SpaceMotion, mount_in_space, placement_of
from jaxwhisker._model.motion import AbstractMotion
from jaxwhisker._model.quadrics import Sphere
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.spring import AXES_IN_SPACE
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._scan.array import Array as WhiskerArray
from jaxwhisker._scan.quantities import UnitSystem
from jaxwhisker._scan.result import SpaceResult
from jaxwhisker._scan.shapes import SpaceShapes, shapes_of
from jaxwhisker._scan.space import free_state_now, problem_now
from jaxwhisker._scan.state import SpaceState, state_of
from jaxwhisker._space.approach import limits_of
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.stance import distance
from jaxwhisker.plot.axes import OBJECT, SUPPORT, colour, legend_above
from jaxwhisker.plot.body import Body, Points, body_of
from jaxwhisker.plot.contacts_in_space import contacts_of, padded, pushes_of, ways_of
from jaxwhisker.plot.drawing import (
    AMPLITUDE,
    COIL,
    CONTROLS,
    LINE_POINTS,
    STAND,
    THICK,
    THIN,
    arrow_length,
    zigzag_shape,
)
from jaxwhisker.plot.view import Flat, Turned, check_view, picture

DIRECTOR = 0.17  # length of the arrows of d1, d2 and d3
NAMED = 0.35  # a director whose arrow appears shorter than this share has no name
NAME_PLACES = np.array([(1.35, 0.0, 0.0), (0.0, 1.35, 0.0), (-0.4, 0.0, 0.9)])  # that of d3 is beside the whisker
DIRECTOR_ROOM = 1.5  # of a director and its name
MARGIN = 0.1  # of the window, around what is drawn
PALEST = 0.25  # opacity of the earliest of several states
COIL_TURNS = 2.25
ANYWHERE = Sphere(1.0, (0.0, 0.0, 0.0))  # the object of scenes that are drawn without one
LEAST_DEPTH = 0.35  # of the window around an array, as a share of its longest side
MOST_NAMES = 9  # whiskers of an array that a legend names


class SpaceDrawing(NamedTuple):
    """A state without the object, or several ones."""

    drive: Float[np.ndarray, "*steps 1 3"]
    whiskers: Float[np.ndarray, "*steps whiskers points 3"]  # centre lines from base to tip
    directors: Float[np.ndarray, "*steps whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    springs: tuple[Float[np.ndarray, "*steps _ 3"], ...]  # in the order of the support
    # Those of one whisker after those of another, and NaN where there is none, or it is unknown.
    contacts: Float[np.ndarray, "*steps contacts 3"]
    forces: Float[np.ndarray, "*steps contacts 2 3"]  # tail and head of arrows

    def at(self, step: int) -> "SpaceDrawing":
        """One of several states."""
        return jax.tree.map(lambda part: part[step], self)

    def scaled(self, factor: float) -> "SpaceDrawing":
        """The drawing in another unit of length."""
        return jax.tree.map(lambda part: factor * part, self)._replace(directors=self.directors)

    def extent(self) -> Points:
        """All points that a window should hold."""
        named = self.whiskers[..., 0, :, None] + DIRECTOR_ROOM * DIRECTOR * self.directors
        parts = [self.drive, named.swapaxes(-1, -2), self.whiskers, *self.springs, self.contacts, self.forces]
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        return points[np.isfinite(points).all(axis=1)]


def draw_scene(setup: SpaceScene, system: UnitSystem, view: Any, ax: Axes | None) -> Axes:
    """Draw a scene in space before its scan; see `states.scene`."""
    view, problem = check_view(view, ax), problem_now(jax.tree.map(checks.as_float, setup))
    control = _start_of(problem) * float(problem.unit.control)
    state = rest_state(setup, control) if problem.weight is None else free_state_now(problem, control)
    drawn = jax.tree.map(lambda part: part[None], drawing(setup, np.asarray(control), state))
    return _draw(drawn, system, picture(view, ax), None)


def draw_array(array: WhiskerArray, surface: AbstractSurface | None, units: str, view: Any, ax: Axes | None) -> Axes:
    """Draw the unloaded whiskers of an array at the control 0, and an object; see `states.scene`."""
    view = check_view(view, ax)
    scenes = [array.scene(k, ANYWHERE if surface is None else surface) for k in range(len(array))]
    system = UnitSystem(scenes[0], units)
    sizes = [float(one.whiskers[0].length / scenes[0].whiskers[0].length) for one in scenes]
    states = [
        drawing(one, np.zeros(()), rest_state(one, 0.0)).scaled(size) for one, size in zip(scenes, sizes, strict=True)
    ]
    lines, scale = [one.whiskers[0] for one in states], system.scale("length")
    points = np.concatenate(lines)
    body, low, high = window_around(None if surface is None else scenes[0], points)
    thin = np.maximum(LEAST_DEPTH * np.max(high - low) - (high - low), 0.0) / 2
    low, high = low - thin, high + thin
    body, seen = None if body is None else body.scaled(scale), picture(view, ax)
    if body is not None:
        seen.body(body)
    for k, (name, line) in enumerate(zip(array.names, lines, strict=True)):
        seen.line(scale * line, body, color=colour(k), linewidth=2, zorder=3, label=name)
        seen.line(scale * line[:1], color=colour(k), linestyle="none", marker="o", markersize=4, zorder=4)
    seen.window(scale * low, scale * high, [system.label_of(name, "length") for name in "xyz"])
    if len(array) <= MOST_NAMES:
        legend_above(seen.ax, [line for line in seen.ax.get_lines() if line.get_label() in array.names])
    return seen.ax


def draw_shapes(result: SpaceResult, steps: Sequence[int], system: UnitSystem, view: Any, ax: Axes | None) -> Axes:
    """Draw steps of a scan in space, and the way of its contacts; see `states.shapes`."""
    view = check_view(view, ax)
    way = ways_of(contacts_of(result, float(system.natural.length)), len(result.scene.whiskers))
    return _draw(drawings(result, np.asarray(steps)), system, picture(view, ax), way)


def drawings(result: SpaceResult, steps: np.ndarray, points: int = LINE_POINTS) -> SpaceDrawing:
    """Geometry of steps of a scan; its largest contact force has the longest arrow."""
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[steps], state_of(result))
    control = np.asarray(result.control)[steps]
    lines = shapes_of(result.scene, states, control, points=points)
    largest = float(np.nan_to_num(np.asarray(result.contact_force)).max())
    return drawing(result.scene, control, states, lines=lines, largest=largest)


def drawing(
    scene: SpaceScene,
    control: Float[np.ndarray, "*steps"],
    state: SpaceState,
    *,
    lines: SpaceShapes | None = None,
    largest: float | None = None,
) -> SpaceDrawing:
    """Geometry of a state of a scene, or of several ones; NaN where a state is NaN.

    Args:
        scene: scene of the states.
        control: control of the drive, in the scene's units.
        state: a state with fields (*steps, whiskers) in the scene's units, and those of contacts.
        lines: centre lines (*steps, whiskers, points) in the scene's units; by default those of the states.
        largest: contact force with the longest arrow; by default the largest one of the states.
    """
    size = float(scene.whiskers[0].length)
    if lines is None:
        lines = shapes_of(scene, state, control, points=LINE_POINTS)
    whiskers = np.stack([lines.x, lines.y, lines.z], axis=-1) / size
    contacts = contacts_of(state, size)
    push = pushes_of(scene, state)
    force = np.linalg.norm(push, axis=-1)
    most = float(np.nan_to_num(force).max()) if largest is None else largest
    arrows = arrow_length(np.nan_to_num(force), most)[..., None] * push / np.where(force > 0, force, np.nan)[..., None]
    drive = _placed(scene, control)
    return SpaceDrawing(
        np.asarray(drive.position)[..., None, :] / size,
        whiskers,
        np.asarray(state.base_rotation),
        _springs(scene, np.asarray(drive.rotation), whiskers[..., 0, :]),
        contacts,
        np.stack([contacts - arrows, contacts], axis=-2),
    )


def rest_state(scene: SpaceScene, control: float) -> SpaceState:
    """State of the unloaded whiskers on their mounts at a control, as if there were no object."""
    drive = _placed(scene, np.asarray(control))
    bases = [drive.containing(jax.tree.map(np.asarray, mount_in_space(mount))) for mount in scene.support.mounts]
    position, rotation = (np.stack(parts) for parts in zip(*bases, strict=True))
    none = np.zeros(len(bases))
    names = (name for name, field in SpaceState.__dataclass_fields__.items() if not field.kw_only)
    fields: dict[str, Any] = dict.fromkeys(names, none) | {"phase": none.astype(int), "base_rotation": rotation}
    fields |= dict(zip(("base_x", "base_y", "base_z"), position.T, strict=True))
    return SpaceState(**{name: jnp.asarray(value) for name, value in fields.items()})


def _placed(scene: SpaceScene, control: Float[np.ndarray, "*steps"]) -> Placement:
    """The frames of the drive at one or several controls, in the scene's units."""
    placed = _placements(jax.tree.map(checks.as_float, scene.motion), padded(control.ravel()))
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: control.size].reshape(*control.shape, *leaf.shape[1:]), placed)


@Program
def _placements(motion: SpaceMotion | AbstractMotion, controls: Float[Array, " controls"]) -> Placement:
    return jax.vmap(lambda control: placement_of(motion, control))(controls)


def _start_of(problem: SpaceProblem) -> float:
    """Control just before the first unloaded whisker touches the object; dimensionless.

    If no whisker touches, it is the first one of a motion that has ends, or else that nearest to the object.
    """
    first, last = map(float, _limits(problem))
    for _ in range(2):  # the second time more finely
        controls = np.linspace(first, last, CONTROLS)
        distances = np.asarray(_distances(problem, controls))
        meets = np.flatnonzero(distances <= 0)
        if not meets.size:
            return float(controls[0 if problem.ends is not None else int(np.argmin(distances))])
        first, last = controls[max(meets[0] - 1, 0)], controls[meets[0]]
    return float(first)


@Program
def _limits(problem: SpaceProblem) -> tuple[Scalar, Scalar]:
    limits = limits_of(problem, jnp.full((), jnp.nan))
    return limits.start, limits.far


@Program
def _distances(problem: SpaceProblem, controls: Float[Array, " controls"]) -> Float[Array, " controls"]:
    """Distance of the unloaded whiskers from the object at each control."""
    return jax.vmap(lambda u: distance(problem, u))(controls)


def _springs(scene: SpaceScene, frame: np.ndarray, bases: np.ndarray) -> tuple[np.ndarray, ...]:
    """Springs of the support: zigzags between bases, or from a wall that moves with the drive; coils about axes."""
    lines = []
    for spring in scene.support.springs:
        first, second = spring.between
        axis, rigid = AXES_IN_SPACE.index(spring.axis) % 3, spring.is_rigid()
        end = bases[..., max(second, 1) - 1, :]
        if spring.turns:
            lines.append(_coil(end, frame, axis, rigid))
        else:
            start = bases[..., first - 1, :] if first else end - STAND * frame[..., axis]
            lines.append(_zigzag(start, end, frame, rigid))
    return tuple(lines)


def _zigzag(start: np.ndarray, end: np.ndarray, frame: np.ndarray, rigid: bool) -> np.ndarray:
    turns, swing = zigzag_shape(rigid)
    way = end - start
    # Across the spring, along the axis of the drive's frame that is most nearly normal to it.
    normal = np.argmin(np.abs(way[..., None, :] @ frame), axis=-1)[..., None]
    across = np.cross(way, np.take_along_axis(frame, normal, axis=-1)[..., 0])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    start, way, across = start[..., None, :], way[..., None, :], across[..., None, :]
    wall = start + 2 * AMPLITUDE * np.array([-1.0, 1.0, 0.0])[:, None] * across
    return np.concatenate([wall, start + turns[:, None] * way + swing[:, None] * across], axis=-2)


def _coil(centre: np.ndarray, frame: np.ndarray, axis: int, rigid: bool) -> np.ndarray:
    share = np.linspace(0.0, 1.0, 97)
    angle = -np.pi / 4 - (1 - share) * (0.0 if rigid else 2 * np.pi * COIL_TURNS)
    spiral = COIL * share[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centre[..., None, :] + spiral @ frame[..., [(axis + 1) % 3, (axis + 2) % 3]].swapaxes(-1, -2)


class SpaceArtists:
    """Whiskers, springs, drive, directors and contact forces in a picture, which may move.

    Args:
        view: the picture.
        first: what is drawn first, in the unit of the picture.
        body: the object in the same unit, or None.
        scale: the length of the first whisker in this unit.
        springs: the support's springs.
    """

    def __init__(self, view: Flat | Turned, first: SpaceDrawing, body: Body | None, scale: float, springs: Any):
        own = [colour(k) for k in range(len(first.whiskers))]
        of_contacts = [colour(k) for k in whisker_of_contacts(first)]
        dot, self._scale = {"linestyle": "none", "marker": "o", "zorder": 4}, scale
        square = {"marker": "s", "markersize": 8, "markerfacecolor": OBJECT, "markeredgecolor": SUPPORT, "zorder": 1.5}
        self._drive = view.line(first.drive, linestyle="none", label="drive", **square)
        widths = [THICK if spring.is_rigid() else THIN for spring in springs]
        self._springs = [
            view.line(line, body, color=SUPPORT, linewidth=width, zorder=2)
            for line, width in zip(first.springs, widths, strict=True)
        ]
        self._directors = [view.arrow(ends, SUPPORT, 1.0, 7.0) for ends in self._ends(first)]
        self._whiskers = [
            view.line(line, body, color=c, linewidth=2, zorder=3, label=f"whisker {k + 1}")
            for k, (line, c) in enumerate(zip(first.whiskers, own, strict=True))
        ]
        self._bases = [
            view.line(line[:1], color=c, markersize=5, **dot) for line, c in zip(first.whiskers, own, strict=True)
        ]
        self._contacts = [
            view.line(point[None], color=c, markersize=4, **dot)
            for point, c in zip(first.contacts, of_contacts, strict=True)
        ]
        self._forces = [view.arrow(ends, c) for ends, c in zip(first.forces, of_contacts, strict=True)]

    @property
    def parts(self) -> list[Any]:
        """All artists, from back to front."""
        parts = [self._drive, *self._springs, *self._directors, *self._whiskers, *self._bases]
        return [artist for part in (*parts, *self._contacts, *self._forces) for artist in part.artists]

    def move(self, drawn: SpaceDrawing) -> None:
        """Move all artists to another state."""
        self._drive.move(drawn.drive)
        points = [*drawn.springs, *self._ends(drawn), *drawn.whiskers, *drawn.whiskers[:, :1], *drawn.contacts[:, None]]
        moving = [*self._springs, *self._directors, *self._whiskers, *self._bases, *self._contacts, *self._forces]
        for part, own in zip(moving, [*points, *drawn.forces], strict=True):
            part.move(own)

    def _ends(self, drawn: SpaceDrawing) -> Float[np.ndarray, "arrows 2 3"]:
        """Tails and heads of the arrows of all directors."""
        bases = np.repeat(drawn.whiskers[:, 0], 3, axis=0)
        along = np.moveaxis(drawn.directors, -1, 1).reshape(-1, 3)
        return np.stack([bases, bases + self._scale * DIRECTOR * along], axis=1)


def _draw(drawn: SpaceDrawing, system: UnitSystem, view: Flat | Turned, way: np.ndarray | None) -> Axes:
    """Draw the object, the last state, and, paler, the whiskers of the states before."""
    scale, scene = system.scale("length"), system.scene
    body, low, high = surroundings(scene, drawn)
    body = None if body is None else body.scaled(scale)
    if body is not None:
        view.body(body)
    if way is not None:
        for k, whisker in enumerate(whisker_of_contacts(drawn)):
            view.line(scale * way[:, k], body, color=colour(whisker), linewidth=1, linestyle=":", zorder=2.5)
    *before, last = (drawn.at(step).scaled(scale) for step in range(len(drawn.drive)))
    for age, one in enumerate(before):
        style: dict[str, Any] = {
            "alpha": PALEST + (0.7 - PALEST) * age / max(len(before), 1),
            "zorder": 2.6 + 0.01 * age,
        }
        for k, line in enumerate(one.whiskers):
            view.line(line, body, color=colour(k), linewidth=1.4, **style)
            view.line(line[:1], color=colour(k), linestyle="none", marker="o", markersize=3, **style)
    SpaceArtists(view, last, body, scale, scene.support.springs)
    for base, frame in zip(last.whiskers[:, 0], last.directors, strict=True):
        for k, along in enumerate(frame.T):
            if np.isfinite(along).all() and _across(along, view.towards) > NAMED:
                place = NAME_PLACES[k] @ frame.T
                view.words(base + scale * DIRECTOR * place, f"$d_{k + 1}$", color=SUPPORT, fontsize=9)
    view.window(scale * low, scale * high, [system.label_of(name, "length") for name in "xyz"])
    named = [line for line in view.ax.get_lines() if str(line.get_label()).startswith("whisker")]
    legend_above(view.ax, named)
    return view.ax


def whisker_of_contacts(drawn: SpaceDrawing) -> list[int]:
    """The number of the whisker, from 0, of each contact."""
    whiskers, contacts = drawn.whiskers.shape[-3], drawn.contacts.shape[-2]
    return [k * whiskers // contacts for k in range(contacts)]


def _across(along: np.ndarray, towards: np.ndarray) -> float:
    """How long a unit vector appears."""
    return float(np.linalg.norm(along - (along @ towards) * towards))


def surroundings(scene: SpaceScene, drawn: SpaceDrawing) -> tuple[Body | None, np.ndarray, np.ndarray]:
    """The object near some states, and the least and largest coordinates of a window that holds all of it."""
    return window_around(scene, drawn.extent())


def window_around(scene: SpaceScene | None, points: Points) -> tuple[Body | None, np.ndarray, np.ndarray]:
    """The object of a scene near some points, and the least and largest coordinates of a window that holds all."""
    low, high = points.min(axis=0), points.max(axis=0)
    if scene is None:
        return None, low - MARGIN, high + MARGIN
    body = body_of(scene.surface.in_unit(jnp.asarray(scene.whiskers[0].length, dtype=float)), low, high)
    low, high = low - MARGIN, high + MARGIN
    if body is not None:
        ends = body.normals[body.cut]
        low = np.minimum(low, body.points.min(axis=0) - MARGIN * ~(ends < -0.99).any(axis=0))
        high = np.maximum(high, body.points.max(axis=0) + MARGIN * ~(ends > 0.99).any(axis=0))
    return body, low, high
