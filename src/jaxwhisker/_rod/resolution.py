"""How well integration steps resolve functions along a rod: an estimate that integrates no rod.

Under a small force at the arc length a, the base turns against the loaded point by the integral of the curvature
kappa0 + (a - s) / EI, and the loaded point moves by that of a - s times the curvature. The steps of an integration are
a quadrature of both.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import NODE_WEIGHTS, NODES, Section, step_ends, with_breaks

# Loaded points, in lengths: several, because one may put the end of a step where a function jumps. Closer to the tip of
# a thin cone, forces are so small that the error there does not matter.
LOADED = np.array([0.95, 0.83, 0.64])


def bending_error(length: Scalar, section: Section, steps: int) -> Float[Array, ""]:
    """Estimate the error of rods with this number of steps, by comparison with twice as many.

    It is an angle, or a displacement in lengths of the rod, due to the intrinsic curvature or to a force that turns the
    base by one radian.
    """

    def loaded(share: Scalar) -> Float[Array, ""]:
        coarse, fine = (_integrals(share * length, section, n) for n in (steps, 2 * steps))
        return jnp.max(jnp.abs(fine - coarse) / jnp.array([1.0, fine[0, 1]]))

    return jnp.max(jax.vmap(loaded)(jnp.asarray(LOADED)))


def relative_error(length: Scalar, density: Section, steps: int) -> Float[Array, ""]:
    """Estimate the error of the integral and of the first moment of a density, relative to the integral.

    Args:
        length: of the rod.
        density: a section whose curvature is the density.
        steps: as in `bending_error`.
    """
    coarse, fine = (_integrals(length, density, n)[:, 0] for n in (steps, 2 * steps))
    return jnp.max(jnp.abs(fine - coarse)) / fine[0]


def _integrals(arc: Scalar, section: Section, steps: int) -> Float[Array, "2 2"]:
    """Turn, and displacement in units of the arc (rows), by intrinsic curvature and by a unit force (columns)."""
    times = with_breaks(step_ends(arc, section, steps=steps, from_base=arc), arc, section, arc).times
    lever = arc * jnp.ravel(times[:-1, None] + jnp.diff(times)[:, None] * NODES)
    weights = arc * jnp.ravel(jnp.diff(times)[:, None] * NODE_WEIGHTS)
    stiffness = jax.vmap(section.stiffness)(arc - lever)
    own = jax.vmap(lambda s: jnp.asarray(section.curvature(s), dtype=float))(arc - lever)
    bent = jnp.stack([own, lever / stiffness])
    return jnp.stack([bent @ weights, bent @ (weights * lever) / arc])
