"""Bending along the shafts of whiskers, and the strain that fibres and gauges on them measure.

The internal moment follows from the equilibrium of the part between the base and a place, which the reaction holds. A
plane cross-section stays plane, and the rod does not stretch: at the distance d from the axis, in the direction a, the
strain is d (k1 sin a - k2 cos a), where k1 and k2 are the changes of curvature about d1 and d2. In the plane, d1 is the
right side of an upright whisker, k1 is zero and -k2 is the change of curvature, positive counter-clockwise.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Along
from jaxwhisker._scan.blocks import BLOCK, in_blocks
from jaxwhisker._scan.contacts import has_several, of_whisker, past_contacts, with_axis_of_contacts
from jaxwhisker._scan.result import AbstractResult, check_not_batched
from jaxwhisker._scan.springs import Held, Holds, hanging, held, holds, moment_at
from jaxwhisker._scan.state import SpaceState, State, base_of, material, state_of

INTERVALS = 64  # of a shaft, between which integration steps end; with a pointed tip, moments are exact to 1e-7


class Bending(eqx.Module):
    """How whiskers are bent at places on their shafts; NaN at steps that failed, and at places that a whisker does not
    have. Beyond the outermost contact, only its weight bends a whisker.

    In the plane, moments and curvatures are numbers, positive counter-clockwise. In space, a last axis has those about
    d1 and d2, the axes of the cross-section, and the torque and twist about d3, the tangent.
    """

    moment: Float[Array, "..."]  # internal moment, that of the outer part on the inner one; a force times a length
    curvature: Float[Array, "..."]  # change of curvature from that of the unloaded whisker, 1/length
    in_space: bool = eqx.field(static=True, default=False)


@in_double
def bending(result: Any, at: Any) -> Bending:
    """Internal moments and changes of curvature at places on the shafts, at all steps of a scan.

    Args:
        result: the result of a single scan, in the plane or in space.
        at: arc lengths from the base, shape (places,), between 0 and the length of the longest whisker.

    Returns:
        Bending, with arrays of shape (steps, whiskers, places), in space (steps, whiskers, places, 3).

    Raises:
        ValueError: if `result` is not the result of a single scan, or `at` is not a non-empty one-dimensional array of
            numbers between 0 and the length of the longest whisker.
    """
    checks.instance("result", result, AbstractResult, "the Result of a scan")
    check_not_batched(result, "the result of a single scan")
    checks.vector("at", at)
    scene: Any = result.scene
    if not checks.is_traced((at, scene.whiskers)):
        length = max(float(whisker.length) for whisker in scene.whiskers)
        if np.min(at) < 0 or np.max(at) > length:
            checks.fail("at", f"arc lengths between 0 and {length:g}, the length of the longest whisker", at)
    whiskers, by = jax.tree.map(checks.as_float, (scene.whiskers, holds(scene)))
    past = jax.tree.map(checks.as_float, scene.surface) if scene.in_space and has_several(result) else None
    at = _as_array(at)

    def block(state: Any, control: Any) -> Bending:
        return _bending(state, whiskers, by, None if by is None else control, past, at)

    return in_blocks(block, (state_of(result), result.control), BLOCK)


@in_double
def strain(result: Any, at: Any, distance: Any, direction: Any = 0.0) -> Array:
    """Strain at places on the shafts, as fibre Bragg gratings and strain gauges measure it, at all steps of a scan.

    It is that of bending: distance times change of curvature. The whisker's axis does not stretch, and torsion strains
    no fibre that runs along the shaft.

    Args:
        result: the result of a single scan, in the plane or in space.
        at: arc lengths from the base, shape (places,), between 0 and the length of the longest whisker.
        distance: from the whisker's axis, a length: a number, or an array (places,). On the surface of a round shaft it
            is the radius there.
        direction: of the fibre from the axis, rad, about the whisker's tangent from d1 to d2 (right-handed): a number,
            or an array (places,). 0 is the right side (+x) of an upright whisker, pi the left one. In the plane, fibres
            at pi/2 are not strained.

    Returns:
        Array of shape (steps, whiskers, places), positive where the shaft is stretched; zero beyond the outermost
        contact without a weight, NaN at steps that failed. Young's modulus times the strain is the stress.

    Raises:
        ValueError: as `bending`, or if `distance` or `direction` is neither a number nor an array (places,).
    """
    for name, value in (("distance", distance), ("direction", direction)):
        if np.ndim(value) == 0:
            checks.number(name, value)
            continue
        checks.vector(name, value)
        if np.shape(value) != np.shape(at):
            checks.fail(name, f"a number or an array of shape {np.shape(at)}, one value for each place", value)
    found = bending(result, at)
    fibre = _as_array(distance), _as_array(direction)
    return in_blocks(lambda found: _strain(found, *fibre), (found,), BLOCK)


def _as_array(values: Any) -> Any:
    return jnp.asarray(values, dtype=float) if checks.is_traced(values) else checks.as_float(np.asarray(values))


@Program
def _strain(
    found: Bending, distance: Scalar | Along, direction: Scalar | Along
) -> Float[Array, "steps whiskers places"]:
    if not found.in_space:
        return distance * found.curvature * jnp.cos(direction)
    k1, k2, _ = jnp.moveaxis(found.curvature, -1, 0)
    return distance * (k1 * jnp.sin(direction) - k2 * jnp.cos(direction))


@Program
def _bending(
    state: State | SpaceState,
    whiskers: tuple[Whisker, ...],
    by: Holds | None,
    control: Float[Array, " steps"] | None,
    past: Any,
    at: Along,
) -> Bending:
    """Bending at places; in space with several contacts, `past` is the surface that has them."""
    in_space = isinstance(state, SpaceState)
    if past is not None:
        from jaxwhisker._space_chain.shape import bending_past_contacts
    elif in_space:
        from jaxwhisker._space.shape import bending_of

    def one(state: Any, control: Scalar | None) -> Bending:
        each: list[Held | None] = [None] * len(whiskers)
        if by is not None and control is not None and not in_space:
            each = [*held(by, whiskers, control, state.shaft_loads)[0]]
        found = []
        for k, (whisker, own) in enumerate(zip(whiskers, each, strict=True)):
            of_state = jax.tree.map(lambda field, k=k: field[k], state) if in_space else None
            if past is not None:
                bent = bending_past_contacts(whisker, past, of_state, at, INTERVALS)
            elif in_space:
                bent = bending_of(whisker, of_state, at, INTERVALS, None if by is None else by.gravity)
            else:
                moment = _moments(whisker, of_whisker(state, k), at, own)
                stiffness = jax.vmap(whisker.stiffness_at)(at)
                stiff = stiffness > 0  # a pointed tip has no stiffness and carries no moment
                bent = moment, jnp.where(stiff, moment / jnp.where(stiff, stiffness, 1.0), 0.0)
            known = jnp.isfinite(state.base_x[k]) & (at >= 0) & (at <= whisker.length)
            known = known[:, None] if in_space else known
            found.append([jnp.where(known, part, jnp.nan) for part in bent])
        return Bending(*(jnp.stack(part) for part in zip(*found, strict=True)), in_space=in_space)

    return jax.vmap(one, in_axes=(0, None if by is None else 0))(state, control)


def _moments(whisker: Whisker, state: State, at: Along, own: Held | None) -> Along:
    """Internal moments of one whisker in the plane."""
    length, zero = whisker.length, jnp.zeros(())
    ends = rod.step_ends(jnp.negative(length), material(whisker), steps=INTERVALS, from_base=zero)
    s = jnp.append(length * ends, jnp.clip(at, 0.0, length))
    if own is None:
        if not has_several(state):
            state = with_axis_of_contacts(state)
        _, moment = past_contacts(whisker, state, s)
        return moment[INTERVALS + 1 :]
    arc = jnp.where(state.phase == Phase.free, whisker.length, state.contact_arc)
    loaded = s < arc
    given = whisker, base_of(state), (state.fx, state.fy, state.mz)
    moment = moment_at(*given, jnp.where(loaded, s, arc), own)
    beyond = jnp.zeros(())
    if own.section is not None:
        order = jnp.argsort(s)
        (x, y, _, _), load = hanging(*given, arc, jnp.maximum(s[order], arc), own)
        beyond = jnp.asarray(rod.moment(x, y, load))[jnp.argsort(order)]
    return jnp.where(loaded, moment, beyond)[INTERVALS + 1 :]
