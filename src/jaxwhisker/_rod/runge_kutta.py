"""A Runge-Kutta method of order 8 for rods under loads that change along them."""

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.types import Scalar

# Dormand and Prince's method of order 8, without the stage that is only needed for an error estimate.
_TABLEAU = diffrax.Dopri8.tableau
STAGES = len(_TABLEAU.b_sol) - 1
TIMES = np.array([0.0, *_TABLEAU.c])[:STAGES]
WEIGHTS = np.array([np.pad(row, (0, STAGES - len(row))) for row in ([], *_TABLEAU.a_lower)][:STAGES])
TOTAL = np.array(_TABLEAU.b_sol[:STAGES])


def runge_kutta(
    rates: Callable[[Scalar, Float[Array, " values"], Any], Float[Array, " values"]],
    values: Float[Array, " values"],
    times: Float[Array, " times"],
    each: Any = None,
) -> Float[Array, " values"]:
    """Values at the last time.

    Args:
        rates: derivatives of the values, from the time, the values and what belongs to the step.
        values: at the first time.
        times: ends of the steps.
        each: what belongs to each step; stacked.
    """

    def step(values, own):
        start, stop, of_step = own
        size = stop - start

        def stage(known, row):
            k, time, weights = row
            here = values + jnp.sum(weights[:, None] * known, axis=0) * size
            return known.at[k].set(rates(start + time * size, here, of_step)), None

        # A loop of diffrax over the stages has derivatives in one mode only.
        known, _ = jax.lax.scan(stage, jnp.zeros((STAGES, values.size)), (np.arange(STAGES), TIMES, WEIGHTS))
        return values + jnp.sum(TOTAL[:, None] * known, axis=0) * size, None

    return jax.lax.scan(step, values, (times[:-1], times[1:], each))[0]
