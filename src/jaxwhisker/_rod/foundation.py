"""A rod on an elastic foundation: a distributed load that depends on the rod's position.

The load on the rod changes along it. It is integrated together with the state: two forces and a moment about the
origin, so that the internal moment remains an affine function of position.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import Load, Material, RodState, Section, moment, one_sided, step_ends, with_breaks
from jaxwhisker._rod.runge_kutta import runge_kutta

# Force on the rod per length, along x and y, at a position and an arc length from the base.
Density = Callable[[Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]
DeadDensity = Callable[
    [Scalar], Float[Array, "3"]
]  # along x, y and z, at an arc length: it does not depend on position


def integrate_on(
    start: RodState,
    load: Load,
    arc: Scalar,
    material: Material,
    density: Density,
    *,
    steps: int,
    from_base: Scalar,
) -> tuple[RodState, Load]:
    """State of a rod on a foundation and the load on it, at an arc length `arc` from `start` towards the base.

    Args:
        start: state (x, y, cos phi, sin phi) at the beginning.
        load: load on the rod there, by everything beyond.
        arc: arc length to the end; negative to integrate away from the base.
        material: bending stiffness, or the section of a rod that is not uniform.
        density: force of the foundation on the rod per length.
        steps: number of steps of a Runge-Kutta method of order 8.
        from_base: arc length from the base to the beginning.
    """

    times = step_ends(arc, material, steps=steps, from_base=from_base)
    times, _, between = with_breaks(times, arc, material, from_base)

    def towards_base(t, values, between):
        x, y, cos, sin, force_x, force_y, about_origin = values
        s = from_base - t * arc
        s = s if between is None else one_sided(s, *between)
        bent = moment(x, y, Load(force_x, force_y, about_origin))
        if isinstance(material, Section):
            bent = material.total_curvature(jnp.asarray(bent), s)
        elif material is not None:
            bent = bent / material
        turn, (push_x, push_y) = arc * bent, density(x, y, s)
        return jnp.stack([
            -arc * cos,
            -arc * sin,
            turn * sin,
            -turn * cos,
            arc * push_x,
            arc * push_y,
            arc * (x * push_y - y * push_x),
        ])  # fmt: skip

    loads = load.force_x, load.force_y, load.moment
    values = jnp.stack([jnp.asarray(value, dtype=float) for value in (*start, *loads)])
    x, y, cos, sin, *loads = runge_kutta(towards_base, values, times, between)
    return (x, y, cos, sin), Load(loads[0], loads[1], loads[2])
