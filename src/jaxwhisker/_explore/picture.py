"""What there is to show of a scene: a scan over its default range, all shapes, the drive and the object.

One function, compiled once for scenes of one structure, whatever their numbers are.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
from jaxtyping import Float

from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.silhouette import silhouette
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.scan import scan_across
from jaxwhisker._scan.shapes import Shapes, shapes_of

STEPS = 400  # of a scan, evenly over the range of the default control
POINTS = 32  # of a whisker's centre line
OUTLINE = 241  # points of the object


class Picture(NamedTuple):
    """A scan and its geometry, in the scene's own units."""

    result: Result
    lines: Shapes  # fields (steps, whiskers, points)
    drive: Pose  # fields (steps,)
    outline: Float[jax.Array, "points 2"]  # of the object; NaN where a graph ends


def _picture(scene: Scene) -> Picture:
    """The picture of a scene."""
    result = scan_across(scene, STEPS)
    lines = shapes_of(result, scene.whiskers, points=POINTS)
    drive = jax.vmap(scene.motion.pose)(result.control)
    return Picture(result, lines, drive, silhouette(scene.profile, scene.whiskers[0].length, points=OUTLINE))


_COMPILED: Any = {"compiler_options": COMPILER_OPTIONS}
picture = eqx.filter_jit(_picture, **_COMPILED)
