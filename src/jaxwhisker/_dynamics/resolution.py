"""A warning about whiskers whose stiffness the shape functions of moving whiskers do not resolve.

Curvatures of moving whiskers are polynomials. Where the stiffness jumps, so does the curvature, and the convergence is
slow. The error is estimated with a load f(s) = rho A s^2, which resembles the inertia in the first mode: the relative
error of the energy int M^2 / (2 EI) ds is about that of the square of the first frequency.
"""

import warnings

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.program import Program
from jaxwhisker._base.quadrature import gauss
from jaxwhisker._dynamics.legendre import basis, polynomials_at
from jaxwhisker._model.whisker import Whisker

RESOLVED = 1e-3  # largest relative error of the first frequency without a warning
CELLS = 32  # of the quadrature of the exact energy; breaks are further ends
_AT, _WEIGHTS = gauss(4)


def warn_of_shapes(whiskers: tuple[Whisker, ...], shapes: int) -> None:
    """Warn if so many shape functions do not resolve the stiffness of a whisker. Traced ones are not examined."""
    for whisker in whiskers:
        if not callable(whisker.bending_stiffness) or checks.is_traced(whisker):
            continue
        error = float(_error(jax.tree.map(checks.as_float, whisker), shapes))
        if error > RESOLVED:
            warnings.warn(
                f"{shapes} shape functions do not resolve `bending_stiffness`: the estimated error of the first "
                f"frequency is {100 * error:.1g} %. Curvatures are polynomials here, also with `breaks`; `modes` and "
                "`scan` resolve jumps.",
                stacklevel=3,
            )


@Program
def _error(whisker: Whisker, shapes: int) -> Float[Array, ""]:
    ends = jnp.linspace(0.0, 1.0, CELLS + 1)
    if whisker.breaks is not None:
        ends = jnp.sort(jnp.append(ends, whisker.breaks / whisker.length))
    sizes = jnp.diff(ends)[:, None]
    s, weights = jnp.ravel(ends[:-1, None] + sizes * _AT), jnp.ravel(sizes * _WEIGHTS)

    def stiffness(s: Array) -> Array:
        return jax.vmap(whisker.stiffness_at)(s * whisker.length) / whisker.base_stiffness

    load = weights * jax.vmap(whisker.mass_at)(s * whisker.length) * s**2
    moment = jnp.maximum(s - s[:, None], 0.0) @ load
    energy = jnp.sum(weights * moment**2 / stiffness(s))
    own = basis(shapes)
    matrix = own.curvatures.T @ ((own.weights * stiffness(jnp.asarray(own.points)))[:, None] * own.curvatures)
    push = jax.vmap(lambda s: polynomials_at(s, shapes))(s).T @ (weights * moment)
    return jnp.abs(1 - push @ solve(jnp.asarray(matrix), push[:, None])[:, 0] / energy) / 2
