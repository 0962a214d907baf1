"""The rod in space under a distributed dead load, which changes force and moment along it."""

import jax.numpy as jnp

from jaxwhisker._base.quaternions import cross, opposite, product, third_axis, times
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.foundation import DeadDensity
from jaxwhisker._rod.rod import one_sided, step_ends, with_breaks
from jaxwhisker._rod.runge_kutta import runge_kutta
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState, curvature


def integrate_under(
    start: SpaceState,
    load: SpaceLoad,
    arc: Scalar,
    section: SpaceSection,
    density: DeadDensity,
    *,
    steps: int,
    from_base: Scalar,
) -> tuple[SpaceState, SpaceLoad]:
    """State of the rod and load on it, at an arc length `arc` from `start` towards the base.

    Args:
        start: position and rotation at the beginning, without absent parts.
        load: load on the rod there, by everything beyond, without absent parts.
        arc: arc length to the end; negative to integrate away from the base.
        section: stiffness and intrinsic curvature.
        density: force on the rod per length.
        steps: number of steps of a Runge-Kutta method of order 8.
        from_base: arc length from the base to the beginning.
    """
    at = step_ends(arc, section.in_plane, steps=steps, from_base=from_base)
    at, _, between = with_breaks(at, arc, section.in_plane, from_base)

    def towards_base(t, values, between):
        r, q, carried = _parts(values)
        s = from_base - t * arc
        s = s if between is None else one_sided(s, *between)
        turn, push = curvature((r, q), carried, section, s), tuple(density(s))
        spin = times(-0.5, turn)
        rates = *opposite(third_axis(q)), *product(q, (None, *spin)), *push, *cross(r, push)
        return arc * jnp.stack(rates)

    parts = *start[0], *start[1], *load.force, *load.moment
    values = jnp.stack([jnp.asarray(value, dtype=float) for value in parts])
    r, q, carried = _parts(runge_kutta(towards_base, values, at, between))
    return (r, q), carried


def _parts(values) -> tuple:
    """Position, rotation and load."""
    x, y, z, *q, fx, fy, fz, mx, my, mz = values
    return (x, y, z), tuple(q), SpaceLoad((fx, fy, fz), (mx, my, mz))
