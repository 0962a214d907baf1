"""Shapes: the whiskers' centre lines at steps of a scan."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker._scan.state import State, base_of, material, outwards, state_of


class Shapes(eqx.Module):
    """Centre lines of whiskers: along the last axis, equidistant points from base to contact, then the tip.

    For whiskers with intrinsic curvature, half of the points lie between contact and tip. Steps that failed are NaN.
    """

    x: Float[Array, "*at whiskers points"]  # a length
    y: Float[Array, "*at whiskers points"]


def shapes(result: Result, at: Control | None = None, *, points: int = 64) -> Shapes:
    """Centre lines of all whiskers at the scan steps nearest to given drive positions.

    They are integrated from the bases to the tips under the scan's reactions.

    Args:
        result: the Result of a scan.
        at: drive positions, shape (positions,), in the unit of the control. If the drive passes a position several
            times, the first pass counts. Default: every step.
        points: number of points per whisker, at least 3.

    Returns:
        Shapes, with arrays of shape (positions, whiskers, points).

    Raises:
        ValueError: if `result` is not the result of a single scan, `at` is not a non-empty one-dimensional array of
            finite numbers, or `points` is less than 3.
    """
    check_one_scan(result)
    checks.count("points", points, least=3)
    index = np.arange(result.control.shape[0])
    if at is not None:
        checks.vector("at", at)
        index = np.argmin(np.abs(np.asarray(result.control)[:, None] - np.asarray(at)), axis=0)
    state = state_of(result)
    if checks.is_traced(state):
        state = jax.tree.map(lambda values: values[index], state)
    else:  # NumPy compiles nothing for a new shape
        state = jax.tree.map(lambda values: jax.device_put(np.asarray(values)[index]), state)
    whiskers = result.scene.whiskers
    return shapes_of(state, jax.tree.map(checks.as_float, whiskers), points=points)


@Program
def shapes_of(state: State, whiskers: tuple[Whisker, ...], *, points: int) -> Shapes:
    """Centre lines of whiskers in one or more states."""
    fields = base_of(state), state.fx, state.fy, state.mz, state.contact_arc, state.phase == Phase.free
    lines = []
    for k, whisker in enumerate(whiskers):
        line = partial(_line, whisker, points)
        for _ in range(state.base_x.ndim - 1):
            line = jax.vmap(line)
        lines.append(line(*jax.tree.map(lambda field, k=k: field[..., k], fields)))
    x, y = (jnp.stack(coordinates, axis=-2) for coordinates in zip(*lines, strict=True))
    return Shapes(x, y)


def _line(
    whisker: Whisker, points: int, base: Pose, fx: Scalar, fy: Scalar, mz: Scalar, arc: Scalar, free: Bool[Array, ""]
) -> tuple[rod.Along, rod.Along]:
    """x and y of one whisker from base to tip."""
    arc = jnp.where(free, whisker.length, arc)
    loaded = points - 1 if whisker.intrinsic_curvature is None else points - points // 2
    x, y, cos, sin = outwards(whisker, base, fx, fy, mz, arc, count=loaded)
    # Beyond the contact the whisker is unloaded. If it is straight there, one more point suffices.
    end, nothing = (x[-1], y[-1], cos[-1], sin[-1]), rod.Load(None, jnp.zeros_like(arc), None)
    tip_x, tip_y, _, _ = rod.points(
        end, arc - whisker.length, nothing, material(whisker), count=points - loaded + 1, from_base=arc
    )
    return jnp.append(x, tip_x[1:]), jnp.append(y, tip_y[1:])
