"""Pictures of scans in space; the page projects them and hides what is behind the object."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxwhisker._explore.picture import PAGE_LINE_POINTS, SCAN_STEPS
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE, UnitSystem, quantity
from jaxwhisker._scan.result import SpaceResult
from jaxwhisker._scan.scan import scan_across
from jaxwhisker.plot.body import Body
from jaxwhisker.plot.contacts_in_space import ways_of
from jaxwhisker.plot.signals import LEAST_HEIGHT
from jaxwhisker.plot.space import DIRECTOR, NAME_PLACES, SpaceDrawing, drawings, surroundings
from jaxwhisker.plot.view import CAMERA, shades_of

VIEWS = {"camera": CAMERA, "xy": (0.0, 0.0), "xz": (-90.0, 0.0), "yz": (0.0, -90.0)}  # elevation and azimuth, degrees
ROUND = 0.1  # of the whisker's length, to which windows are rounded, so that small changes do not move them


class SpacePicture(NamedTuple):
    """A scan in space and its geometry; lengths are in L of the first whisker."""

    result: SpaceResult
    drawing: SpaceDrawing  # fields (steps, ...)
    body: Body | None  # the object; None if it is far away
    window: Float[np.ndarray, "2 3"]  # least and largest coordinates

    def geometry(self, units: UnitSystem) -> tuple[dict[str, Any], dict[str, Any]]:
        scale, springs = units.scale("length"), units.scene.support.springs
        drawn, body = self.drawing.scaled(scale), self.body
        arrays = {
            "line": drawn.whiskers,
            "drive": drawn.drive,
            "directors": drawn.directors,
            "contacts": drawn.contacts,
            "ways": ways_of(drawn.contacts, drawn.whiskers.shape[1]),
            "forces": drawn.forces,
        }
        arrays |= {f"spring_{k}": line for k, line in enumerate(drawn.springs)}
        integers = {}
        if body is not None:
            body = body.scaled(scale)
            arrays |= {
                "corners": body.points,
                "normals": body.normals,
                "offsets": body.offsets,
                "shades": shades_of(body),
            }
            integers = {name: getattr(body, name).astype(np.int32) for name in ("faces", "edges", "beside", "part")}
            integers["sharp"] = body.sharp.astype(np.int8)
        header = {
            "window": (scale * self.window).tolist(),
            "rigid": [spring.is_rigid() for spring in springs],
            "least": {name: LEAST_HEIGHT * units.scale(quantity(name).kind) for name in REACTIONS_IN_SPACE},
            "director": scale * DIRECTOR,
            "namePlaces": NAME_PLACES.tolist(),
        }
        return header, {name: values.astype(np.float32) for name, values in arrays.items()} | integers


def picture_in_space(scene: SpaceScene) -> SpacePicture:
    """Scan a scene in space; scenes with the same structure share the programs."""
    result = scan_across(scene, SCAN_STEPS)
    drawn = drawings(result, np.arange(SCAN_STEPS), PAGE_LINE_POINTS)
    body, low, high = surroundings(scene, drawn)
    return SpacePicture(result, drawn, body, ROUND * np.stack([np.floor(low / ROUND), np.ceil(high / ROUND)]))
