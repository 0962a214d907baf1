"""The control that all points of a study share."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._equilibrium.problem import problem_of
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.approach import MARGIN
from jaxwhisker._scan.scan import STEP, contact_range
from jaxwhisker._study.local import threads
from jaxwhisker._study.parameters import Parameters, padded

MAX_STEPS = 100_000
LANES = 64


def common_control(build: Callable[..., Scene], parameters: Parameters) -> Float[np.ndarray, " steps"]:
    """Drive positions from before the first touch to after the last contact of all points.

    Raises:
        ValueError: if they would be more than `MAX_STEPS`.
    """

    def point(values):
        scene = build(**values)
        valid, length = problem_of(scene).valid, jnp.asarray(scene.whiskers[0].length, dtype=float)
        return tuple(jnp.where(valid, x, jnp.nan) for x in (*contact_range(scene), length))

    total = int(np.prod(parameters.shape))
    lanes = min(total, LANES)
    shapes = {name: jax.ShapeDtypeStruct((lanes,), float) for name in parameters.values}
    compiled = jax.jit(jax.vmap(point)).lower(shapes).compile(COMPILER_OPTIONS)

    def block(first: int) -> np.ndarray:
        values = parameters.numbered(np.arange(first, min(first + lanes, total)))
        return np.stack(compiled(padded(values, lanes)))

    with ThreadPoolExecutor(threads()) as pool:
        start, stop, length = np.concatenate(list(pool.map(block, range(0, total, lanes))), axis=1)
    known = np.isfinite(start) & np.isfinite(stop) & np.isfinite(length)
    if not known.any():  # every point is bad
        return np.array([MARGIN, -MARGIN])
    start, stop, step = start[known].max(), stop[known].min(), STEP * length[known].max()
    steps = int(np.ceil((start - stop) / step)) + 1
    if steps > MAX_STEPS:
        raise ValueError(
            f"`control` must be given: from {start:.6g}, the first touch of all, to {stop:.6g}, the last contact, "
            f"in steps of {step:.6g} would be {steps} positions, more than {MAX_STEPS}."
        )
    return start - step * np.arange(max(2, steps))
