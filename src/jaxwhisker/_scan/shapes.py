"""Shapes: the whiskers' centre lines at steps of a scan, in the plane and in space."""

from typing import TYPE_CHECKING, Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._scan.contacts import has_several, past_contacts
from jaxwhisker._scan.result import AbstractResult, Result, SpaceResult, check_not_batched
from jaxwhisker._scan.springs import Held, Holds, hanging, held, holds, outwards
from jaxwhisker._scan.state import SpaceState, State, base_of, material, state_of

if TYPE_CHECKING:
    from jaxwhisker._model.space_scene import SpaceScene

PADDING = 64  # states are padded to a multiple of this, because figures and films then share a compiled program


class Shapes(eqx.Module):
    """Centre lines of whiskers: along the last axis, equidistant points from base to contact, then the tip.

    For whiskers with intrinsic curvature or a weight, half of the points lie between contact and tip. If a whisker has
    several contacts, this is the outermost one. Steps that failed are NaN.
    """

    x: Float[Array, "*at whiskers points"]  # a length
    y: Float[Array, "*at whiskers points"]


class SpaceShapes(eqx.Module):
    """Centre lines of whiskers in space: along the last axis, points from base to contact, then to the tip.

    Two thirds of the points lie between base and contact, and the others beyond; both parts are equidistant. All points
    of a free whisker are. Steps that failed are NaN.
    """

    x: Float[Array, "*at whiskers points"]  # a length
    y: Float[Array, "*at whiskers points"]
    z: Float[Array, "*at whiskers points"]


@overload
def shapes(result: Result, at: Control | None = None, *, points: int = 64) -> Shapes: ...
@overload
def shapes(result: SpaceResult, at: Control | None = None, *, points: int = 64) -> SpaceShapes: ...
@in_double
def shapes(result: Any, at: Control | None = None, *, points: int = 64) -> Any:
    """Centre lines of all whiskers at the scan steps nearest to given drive positions.

    They are integrated from the bases to the tips under the scan's reactions.

    Args:
        result: the Result of a scan.
        at: drive positions, shape (positions,), in the unit of the control. If the drive passes a position several
            times, the first pass counts. Default: every step.
        points: number of points per whisker, at least 3.

    Returns:
        Shapes, with arrays of shape (positions, whiskers, points); SpaceShapes of a scan in space.

    Raises:
        ValueError: if `result` is not the result of a single scan, `at` is not a non-empty one-dimensional array of
            finite numbers within the scan, or `points` is less than 3.
    """
    checks.instance("result", result, AbstractResult, "the Result of a scan")
    check_not_batched(result, "the result of a single scan")
    checks.count("points", points, least=3)
    index = np.arange(result.control.shape[0])
    if at is not None:
        checks.vector("at", at)
        checks.within("at", at, result.control, "drive positions of the scan")
        index = np.argmin(np.abs(np.asarray(result.control)[:, None] - np.asarray(at)), axis=0)
    state = state_of(result)
    if checks.is_traced(state):
        state = jax.tree.map(lambda values: values[index], state)
    else:  # NumPy compiles nothing for a new shape
        state = jax.tree.map(lambda values: jax.device_put(np.asarray(values)[index]), state)
    control = result.control[index] if checks.is_traced(result.control) else np.asarray(result.control)[index]
    return shapes_of(result.scene, state, control, points=points)


@overload
def shapes_of(scene: Scene, state: State, control: Any, *, points: int) -> Shapes: ...
@overload
def shapes_of(scene: "SpaceScene", state: SpaceState, control: Any, *, points: int) -> SpaceShapes: ...
def shapes_of(scene: Any, state: Any, control: Any, *, points: int) -> Any:
    """Centre lines of whiskers in a state at a control, or in several states of this scene at several controls.

    They have derivatives with respect to the states and the whiskers.
    """
    whiskers, by = jax.tree.map(checks.as_float, (scene.whiskers, holds(scene)))
    state, control = state_of(state), None if by is None else checks.as_float(control)
    past = jax.tree.map(checks.as_float, scene.surface) if scene.in_space and has_several(state) else None
    if checks.is_traced((state, control, whiskers, by, past)):
        return _shapes_of(state, whiskers, by, control, past, points=points)
    one = np.ndim(state.fx) == 1
    rows = jax.tree.map(lambda leaf: np.asarray(leaf)[None] if one else np.asarray(leaf), (state, control))
    steps = rows[0].phase.shape[0]

    def padded(leaf):
        return jax.device_put(np.pad(leaf, [(0, -steps % PADDING), *[(0, 0)] * (leaf.ndim - 1)]))

    rows, control = jax.tree.map(padded, rows)
    lines = _shapes_of(rows, whiskers, by, control, past, points=points)
    return jax.tree.map(lambda line: jax.device_put(np.asarray(line)[0 if one else slice(steps)]), lines)


@Program
def _shapes_of(
    state: State | SpaceState,
    whiskers: tuple[Whisker, ...],
    by: Holds | None,
    control: Float[Array, "*steps"] | None,
    past: Any,
    *,
    points: int,
) -> Shapes | SpaceShapes:
    """Centre lines; in space with several contacts, `past` is the surface that has them."""
    in_space = isinstance(state, SpaceState)
    if past is not None:
        from jaxwhisker._space_chain.shape import line_past_contacts
    elif in_space:
        from jaxwhisker._space.shape import centre_line

    def lines(state: Any, control: Scalar | None) -> list[tuple[Array, ...]]:
        each: list[Held | None] = [None] * len(whiskers)
        if by is not None and control is not None and not in_space:
            each = [*held(by, whiskers, control, state.shaft_loads)[0]]
        found = []
        for k, (whisker, own) in enumerate(zip(whiskers, each, strict=True)):
            at = jax.tree.map(lambda field, k=k: field[k], state)
            if past is not None:
                found.append(line_past_contacts(whisker, past, points, at))
            else:
                gravity = None if by is None else by.gravity
                found.append(centre_line(whisker, points, at, gravity) if in_space else _line(whisker, points, at, own))
        return found

    for _ in range(state.base_x.ndim - 1):
        lines = jax.vmap(lines, in_axes=(0, None if by is None else 0))
    coordinates = [jnp.stack(each, axis=-2) for each in zip(*lines(state, control), strict=True)]
    return SpaceShapes(*coordinates) if in_space else Shapes(*coordinates)


def _line(whisker: Whisker, points: int, at: State, held: Held | None) -> tuple[rod.Along, rod.Along]:
    """x and y of one whisker from base to tip."""
    if has_several(at):
        return _line_past_contacts(whisker, points, at)
    arc, reaction = jnp.where(at.phase == Phase.free, whisker.length, at.contact_arc), (at.fx, at.fy, at.mz)
    heavy = held if held is not None and held.section is not None else None
    bent_beyond = heavy is not None or whisker.intrinsic_curvature is not None
    loaded = points - points // 2 if bent_beyond else points - 1
    x, y, cos, sin = outwards(whisker, base_of(at), reaction, arc, held, count=loaded)
    if heavy is not None:
        s = arc + (whisker.length - arc) * jnp.linspace(0.0, 1.0, points - loaded + 1)[1:]
        (tip_x, tip_y, _, _), _ = hanging(whisker, base_of(at), reaction, arc, s, heavy)
        return jnp.append(x, tip_x), jnp.append(y, tip_y)
    # Beyond the contact the whisker is unloaded. If it is straight there, one more point suffices.
    end, nothing = (x[-1], y[-1], cos[-1], sin[-1]), rod.Load(None, jnp.zeros_like(arc), None)
    tip_x, tip_y, _, _ = rod.points(
        end, arc - whisker.length, nothing, material(whisker), count=points - loaded + 1, from_base=arc
    )
    return jnp.append(x, tip_x[1:]), jnp.append(y, tip_y[1:])


def _line_past_contacts(whisker: Whisker, points: int, at: State) -> tuple[rod.Along, rod.Along]:
    """x and y of one whisker that may have several contacts."""
    outermost = jnp.where(at.phase[0] == Phase.free, whisker.length, at.contact_arc[0])
    loaded = points - 1 if whisker.intrinsic_curvature is None else points - points // 2
    beyond = outermost + (whisker.length - outermost) * jnp.linspace(0.0, 1.0, points - loaded + 1)[1:]
    (x, y, _, _), _ = past_contacts(whisker, at, jnp.append(outermost * jnp.linspace(0.0, 1.0, loaded), beyond))
    return x, y
