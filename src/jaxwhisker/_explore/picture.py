"""Pictures: a scan of a scene, or a motion, with all shapes, as bytes that a page can draw.

The bytes are the length of the header (four bytes, little-endian), the header in JSON, padded to a total multiple of
eight bytes, and the arrays one after the other, those with the largest items first.
"""

import json
import struct
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._dynamics.simulation import Simulation, TimedEvent
from jaxwhisker._explore.code import code_of_motion, code_of_scan
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import AbstractScene, Scene, Sensor, objects_of
from jaxwhisker._model.silhouette import behind, silhouette
from jaxwhisker._scan.quantities import STATE, Unit, UnitSystem, control_kind, quantity, reactions_of
from jaxwhisker._scan.report import status_line
from jaxwhisker._scan.result import AbstractResult, Event, Result, check_not_batched
from jaxwhisker._scan.scan import scan_across
from jaxwhisker._scan.shapes import Shapes, shapes_of
from jaxwhisker._scan.state import state_of

SCAN_STEPS = 400  # of a scan, evenly over the range of the default control
PAGE_LINE_POINTS = 32  # of a whisker's centre line
OUTLINE_POINTS = 241  # of the object
SHORTEST_DRAWN = 0.1  # lengths: springs with a shorter rest length begin at a wall that moves with the drive
LONGEST_MESSAGE = 500  # characters
DTYPES = {"f8": np.float64, "f4": np.float32, "i4": np.int32, "i1": np.int8}  # by their names in a header
FURTHER_COLUMNS = {"base_x": "base x", "contact_arc": "contact arc"}  # of the table, beside the reactions


@runtime_checkable
class AnyPicture(Protocol):
    """A picture in the plane or in space."""

    @property
    def result(self) -> Any:
        """The scan or the motion."""

    def geometry(self, units: UnitSystem) -> tuple[dict[str, Any], dict[str, Any]]:
        """What a page draws, in the units in which it shows lengths: a part of the header, and arrays."""
        ...


class Picture(NamedTuple):
    """A scan or a motion and its geometry, in the scene's units."""

    result: Result | Simulation
    lines: Shapes  # fields (steps, whiskers, points)
    drive: Pose  # fields (steps,)
    outline: Float[jax.Array, "points 2"]  # of the object; NaN where a graph ends

    def geometry(self, units: UnitSystem) -> tuple[dict[str, Any], dict[str, Any]]:
        length, scene = units.of_kind("length").size, units.scene
        outline = _closed(np.asarray(self.outline), objects_of(self.result.scene))
        header = {
            "springs": _springs(scene, length),
            "lowest": min(0.0, *(float(mount.y) / length for mount in scene.support.mounts)),
        }
        if len(objects_of(self.result.scene)) == 1:
            outline = outline[np.isfinite(outline).all(axis=1)]
        arrays = {"drive_x": self.drive.x / length, "drive_y": self.drive.y / length, "drive_angle": self.drive.angle}
        coarse = {
            "line_x": self.lines.x,
            "line_y": self.lines.y,
            "outline_x": outline[:, 0],
            "outline_y": outline[:, 1],
        }
        return header, arrays | {name: (values / length).astype(np.float32) for name, values in coarse.items()}


def picture_of(scene: Scene) -> Picture:
    """Scan a scene; scenes with the same structure share the programs."""
    result = scan_across(scene, SCAN_STEPS)
    lines = shapes_of(scene, state_of(result), result.control, points=PAGE_LINE_POINTS)
    return Picture(result, lines, *_around(scene, result.control))


def picture_of_motion(motion: Simulation) -> Picture:
    """The picture of a motion, whose samples are its steps.

    Raises:
        ValueError: if it is a batch.
    """
    check_not_batched(motion, "a single simulation")
    return Picture(motion, _lines(motion), *_around(motion.scene, motion.control))


@Program
def _lines(motion: Simulation) -> Shapes:
    return motion.shapes(PAGE_LINE_POINTS)


@Program
def _around(scene: Scene | Sensor, control: Float[jax.Array, " steps"]) -> tuple[Pose, Float[jax.Array, "points 2"]]:
    """The drive at all steps, and the outlines of all objects, between which are NaN."""
    outlines = [jnp.zeros((0, 2))]
    for one in objects_of(scene):
        outlines += [silhouette(one, scene.whiskers[0].length, points=OUTLINE_POINTS), jnp.full((1, 2), jnp.nan)]
    return jax.vmap(scene.motion.pose)(control), jnp.concatenate(outlines)[:-1]


def _closed(
    outline: Float[np.ndarray, "points 2"], objects: Sequence[AbstractProfile]
) -> Float[np.ndarray, "points 2"]:
    """The outlines of all objects with points that close those of objects that go on and are not convex."""
    parts = []
    for k, one in enumerate(objects):
        own = outline[k * (OUTLINE_POINTS + 1) :][: OUTLINE_POINTS + 1]  # with the NaN behind it
        known = own[np.isfinite(own).all(axis=1)]
        rest = np.empty((0, 2)) if one.closed else behind(*known.T)
        parts += [own[:OUTLINE_POINTS], rest, own[OUTLINE_POINTS:]]
    return np.concatenate([outline[:0], *parts])


def packed_picture(picture: AnyPicture, scene: AbstractScene | Sensor, code: str, note: str = "") -> bytes:
    """Pack a picture, its labels and its code, with all numbers in the units in which the scene is shown.

    Args:
        picture: a picture with numpy arrays.
        scene: the scene of the picture, with the numbers that the user gave.
        code: Python code that constructs the scene, or makes the motion.
        note: a message for the user.

    Raises:
        ValueError: if the scene has no default control to scan, or the motion has no second sample.
    """
    result = picture.result
    shown, places = {"u": "control"}, np.asarray(result.control)
    if isinstance(result, Simulation):
        shown, time = {"t": "time"} | shown, np.asarray(result.time)
        places = time[0] + (time[1] - time[0]) * np.arange(time.size)  # known even where the simulation has failed
    failed, summary = status_line(result)
    if not np.isfinite(places).all():
        raise ValueError(f"The scene has no {'motion' if 't' in shown else 'scan'}: {summary}.")
    units, signals = UnitSystem(scene), reactions_of(scene)
    drawn, arrays = picture.geometry(units)
    columns = {name: name for name in signals} | FURTHER_COLUMNS
    header = {
        "title": str(scene),
        "note": note,
        "dimensionless": units.dimensionless,
        "places": [[symbol, name, _after_number(units.unit(name))] for symbol, name in shown.items()],
        "signals": signals,
        "labels": _labels(units, shown),
        "columns": [[name, heading + _in_brackets(units.unit(name))] for name, heading in columns.items()],
        "failed": failed,
        "summary": summary,
        "events": [_event(event, units) for event in result.events],
        "length": float(scene.whiskers[0].length) / units.of_kind("length").size,
        "code": code_of_motion(scene, code) if "t" in shown else code_of_scan(scene, code, places),
    }
    first = next(iter(shown.values()))
    return _packed(header | drawn, _states(result, units) | arrays | {first: units.shown(first, places)})


def _states(result: AbstractResult | Simulation, units: UnitSystem) -> dict[str, np.ndarray]:
    return {
        name: units.shown(name, getattr(result, name)).astype(quantity(name).dtype)
        for name in ("control", *STATE, "status")
        if getattr(result, name, None) is not None
    }


def packed_error(error: Exception) -> bytes:
    """Pack the message of an error; that of a ValueError needs no type in front."""
    message = textwrap.shorten(str(error), LONGEST_MESSAGE, placeholder=" ...")
    return _packed({"error": message if isinstance(error, ValueError) else f"{type(error).__name__}: {message}"}, {})


def _packed(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> bytes:
    names = {dtype: name for name, dtype in DTYPES.items()}
    ordered = sorted(arrays.items(), key=lambda item: -item[1].itemsize)
    listed = [[name, names[array.dtype.type], array.shape] for name, array in ordered]
    text = json.dumps(header | {"arrays": listed}, allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 8)
    return b"".join([struct.pack("<I", len(text)), text, *(array.tobytes() for _, array in ordered)])


# How a symbol is made dimensionless, in plain text.
_DIMENSIONLESS = {"length": "/L", "force": " L²/EI", "moment": " L/EI", "time": "/T"}


def _after_number(unit: Unit) -> str:
    return f" {unit.name}" * bool(unit.name)


def _in_brackets(unit: Unit) -> str:
    return f" ({unit.name})" * bool(unit.name)


def _labels(units: UnitSystem, shown: Mapping[str, str]) -> dict[str, str]:
    """Labels of axes: symbols with units; `shown` are the symbols of control and time."""

    def label(symbol: str, kind: str) -> str:
        return symbol + (_DIMENSIONLESS[kind] if units.dimensionless else _in_brackets(units.of_kind(kind)))

    along_x = control_kind(units.scene) == "length"
    signals = reactions_of(units.scene)
    labels = {name: label(name, "length") for name in ("xyz" if "fz" in signals else "xy")}
    labels |= {name: label(name, quantity(name).kind) for name in signals}
    labels |= {symbol: label(symbol, "time") for symbol in shown if symbol == "t"}
    return labels | {"u": label("u", "length") if along_x else units.label("control")}


def _event(event: Event | TimedEvent, units: UnitSystem) -> dict[str, Any]:
    along = units.unit("control")
    place = control = event.control / along.size
    event = event._replace(control=control)
    if isinstance(event, TimedEvent):
        unit, whiskers = units.unit("time"), (event.whisker,)
        place = event.time / unit.size
        text = str(event._replace(time=place)).replace(",", f"{_after_number(unit)},", 1)
    else:
        text, whiskers = str(event), event.whiskers
    return {
        "text": text.replace("  ", f"{_after_number(along)}  ", 1),
        "place": place,
        "whiskers": [number - 1 for number in whiskers],
        "snap": event.kind.name.startswith("snap"),
    }


def _springs(scene: Scene | Sensor, length: float) -> list[dict[str, Any]]:
    """Data for drawing the springs; lengths are divided by `length`."""
    if scene.support.on_shafts:
        checks.fail("build", "a function that returns a scene without springs on shafts", scene.support.name)
    whisker_length = float(scene.whiskers[0].length)
    mounts = ((float(m.x) / length, float(m.y) / length, float(m.angle)) for m in scene.support.mounts)
    poses = [(0.0, 0.0, 0.0), *mounts]
    return [
        {
            "between": spring.between,
            "axis": spring.axis,
            "rigid": float(spring.softness) == 0,
            "short": abs(float(spring.rest_length)) < SHORTEST_DRAWN * whisker_length,
            "offset": np.subtract(poses[spring.between[1]], poses[spring.between[0]]).tolist(),
        }
        for spring in scene.support.springs
    ]
