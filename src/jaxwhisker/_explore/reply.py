"""A reply: a scan and its shapes as bytes that a page can draw.

The bytes: the length of the header (four bytes, little end first), the header in JSON, padded so that eight divides
what comes before the arrays, and the arrays one after the other, the finest type first.
"""

import json
import struct
import textwrap
from typing import Any

import numpy as np

from jaxwhisker._explore.code import scanned
from jaxwhisker._explore.picture import Picture
from jaxwhisker._model.motion import Rotation, Translation
from jaxwhisker._model.scene import Scene
from jaxwhisker._scan.report import status_line
from jaxwhisker._scan.result import Event, State

SHORT = 0.1  # lengths: springs that rest shorter than this are drawn longer, from a wall that moves with the drive
LONGEST = 500  # characters of what is wrong with a scene
TYPES = {"f8": np.float64, "f4": np.float32, "i1": np.int8}


def success(picture: Picture, code: str) -> bytes:
    """The reply with a picture, and the code that makes its scene."""
    result, lines, drive, outline = picture
    if not np.isfinite(result.control).all():
        raise ValueError("The scene has no scan: " + status_line(result)[1] + ".")
    arrays = {name: getattr(result, name) for name in ("control", *State.__dataclass_fields__, "status")}
    arrays |= {"drive_x": drive.x, "drive_y": drive.y, "drive_angle": drive.angle}
    arrays = {name: array.astype(np.int8 if array.dtype.kind in "iu" else float) for name, array in arrays.items()}
    outline = outline[np.isfinite(outline).all(axis=1)]
    arrays |= {"line_x": lines.x, "line_y": lines.y, "outline_x": outline[:, 0], "outline_y": outline[:, 1]}
    arrays |= {name: array.astype(np.float32) for name, array in arrays.items() if name.startswith(("line", "outline"))}
    failed, summary = status_line(result)
    scene = result.scene
    header = {
        "title": str(scene),
        "dimensionless": _dimensionless(scene),
        "labels": _labels(scene),
        "failed": failed,
        "summary": summary,
        "events": [_event(event) for event in result.events],
        "springs": _springs(scene),
        "lowest": min(0.0, *(float(mount.y) for mount in scene.support.mounts)),
        "length": float(scene.whiskers[0].length),
        "code": scanned(code, np.asarray(result.control)),
    }
    return _packed(header, arrays)


def failure(error: Exception) -> bytes:
    """The reply that tells what is wrong with a scene."""
    words = textwrap.shorten(str(error), LONGEST, placeholder=" ...")
    return _packed({"error": words if isinstance(error, ValueError) else f"{type(error).__name__}: {words}"}, {})


def _packed(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> bytes:
    kinds = {dtype: kind for kind, dtype in TYPES.items()}
    ordered = sorted(arrays.items(), key=lambda item: -item[1].itemsize)
    listed = [[name, kinds[array.dtype.type], array.shape] for name, array in ordered]
    text = json.dumps(header | {"arrays": listed}, allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 8)
    return b"".join([struct.pack("<I", len(text)), text, *(array.tobytes() for _, array in ordered)])


def unpacked(reply: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a reply."""
    (length,) = struct.unpack_from("<I", reply)
    header, at, arrays = json.loads(reply[4 : 4 + length]), 4 + length, {}
    for name, kind, shape in header["arrays"]:
        size = int(np.prod(shape))
        arrays[name] = np.frombuffer(reply, TYPES[kind], size, at).reshape(shape)
        at += arrays[name].nbytes
    return header, arrays


def _dimensionless(scene: Scene) -> bool:
    first = scene.whiskers[0]
    return float(first.length) == float(first.base_stiffness) == 1.0


def _labels(scene: Scene) -> dict[str, str]:
    """Symbols with units; of what has dimensions only the symbols, since a scene does not tell its units."""
    motion, without = scene.motion, _dimensionless(scene)
    units = {"fx": " L²/EI", "fy": " L²/EI", "mz": " L/EI", "x": "/L", "y": "/L", "u": "/L"}
    labels = {name: name + unit * without for name, unit in units.items()}
    if not isinstance(motion, Translation):
        labels["u"] = "angle of the drive, rad" if isinstance(motion, Rotation) else "control"
    return labels


def _event(event: Event) -> dict[str, Any]:
    whiskers = [number - 1 for number in event.whiskers]
    return {
        "text": str(event),
        "control": event.control,
        "whiskers": whiskers,
        "snap": event.kind.name.startswith("snap"),
    }


def _springs(scene: Scene) -> list[dict[str, Any]]:
    length = float(scene.whiskers[0].length)
    mounts = [(0.0, 0.0, 0.0)] + [(float(m.x), float(m.y), float(m.angle)) for m in scene.support.mounts]
    return [
        {
            "between": spring.between,
            "axis": spring.axis,
            "rigid": float(spring.softness) == 0,
            "short": abs(float(spring.rest_length)) < SHORT * length,
            "offset": np.subtract(mounts[spring.between[1]], mounts[spring.between[0]]).tolist(),
        }
        for spring in scene.support.springs
    ]
