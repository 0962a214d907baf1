"""The kernel: one compiled least-squares fit, for every guess, every data set and every profile of its shape."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._inverse.misfit import Compared, Samples, Sought, residuals
from jaxwhisker._model.scene import Scene

MOST_STEPS = 60  # of Levenberg-Marquardt
FINE = 1e-6  # of the sum of squares, by which another step would lower it: within 1e-3 standard errors of the minimum
COARSE = 1e-4
SMALL = 1e-7  # change of variables of size one, and of residuals, at which a fit ends, too


class LevenbergMarquardt(optx.LevenbergMarquardt):
    """Levenberg-Marquardt that ends when another step would not lower the misfit by more than `fall`.

    What data hardly tell moves on long after that, and at the minimum rounding decides which steps are taken.
    """

    fall: Any = 0.0

    def __init__(self, fall: Any):
        super().__init__(rtol=SMALL, atol=SMALL)
        self.fall = fall

    def terminate(self, fn, y, args, options, state, tags):
        """As of any solver of optimistix."""
        small, result = super().terminate(fn, y, args, options, state, tags)
        jacobian = jax.vmap(state.f_info.jac.mv, out_axes=1)(jnp.eye(y.size))
        settled = could_fall(state.f_info.residual, jacobian) < self.fall
        return small | (settled & ~state.first_step), result


def could_fall(residual: Float[Array, " residuals"], jacobian: Float[Array, "residuals sought"]) -> Float[Array, ""]:
    """By how much a step of Gauss and Newton lowers the sum of squares, by its own account."""
    size = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    scaled = jacobian / jnp.where(size > 0, size, 1.0)
    slope, bend = scaled.T @ residual, scaled.T @ scaled + ROUNDING * jnp.eye(size.size)
    return slope @ jnp.linalg.solve(bend, slope)


ROUNDING = 1e-14  # of a scaled normal matrix; what is not sought has no row of its own


class Solved(NamedTuple):
    """Where a fit ended."""

    y: Any  # (sought,)
    residual: Any  # (residuals,)
    jacobian: Any  # (residuals, sought)
    compared: Compared
    steps: Any
    converged: Any

    @property
    def misfit(self) -> float:
        """Sum of squares."""
        return float(np.sum(np.square(self.residual)))


class Kernel:
    """Fits of one `build` and one kind of data; compiled at its first call."""

    def __init__(self, build: Callable[..., Scene], sought: Sought):
        self._build, self._sought = build, sought
        self._compiled: dict[Any, Any] = {}

    def __call__(self, y: np.ndarray, data: Samples, free: np.ndarray | None = None, fall: float = FINE) -> Solved:
        """Fit from y on; what is not free stays."""
        free = np.ones(y.shape, bool) if free is None else free
        arguments = jax.tree.map(jnp.asarray, (y, data, free, fall))
        return jax.tree.map(np.asarray, self._function(data)(*arguments))

    def compile(self, *several: Samples) -> None:
        """Compile for data of several shapes side by side."""
        with ThreadPoolExecutor(len(several)) as threads:
            list(threads.map(self._function, several))

    def _function(self, data: Samples):
        shape = np.shape(data.values), np.shape(data.stops)
        if shape not in self._compiled:
            arguments = np.zeros(len(self._sought.all_names)), data, np.ones(len(self._sought.all_names), bool), FINE
            lowered = jax.jit(partial(_fit, self._build, self._sought)).lower(*jax.tree.map(jnp.asarray, arguments))
            self._compiled[shape] = lowered.compile(COMPILER_OPTIONS)
        return self._compiled[shape]


def kernel(build: Callable[..., Scene], sought: Sought) -> Kernel:
    """The kernel of a `build`; kept, since compiling takes longer than fitting."""
    try:
        hash(build)
    except TypeError:  # a module with arrays
        return Kernel(build, sought)
    return _kept(build, sought)


_kept = lru_cache(maxsize=32)(Kernel)


def _fit(
    build: Callable[..., Scene], sought: Sought, y: Float[Array, " sought"], data: Samples, free: Any, fall: Any
) -> Solved:
    # Traced and compiled once, although a solver asks for values here and for derivatives there.
    @jax.jit
    def both(y, data):
        def value(y):
            found, compared = residuals(build, sought, y, data)
            return found, compared

        found, push, compared = jax.linearize(value, y, has_aux=True)
        return found, jax.vmap(push, out_axes=1)(jnp.eye(y.size)), compared

    @eqx.filter_custom_jvp
    def value(y, data):
        found, _, compared = both(y, data)
        return found, compared

    @value.def_jvp
    def _(primals, tangents):
        found, jacobian, compared = both(*primals)
        still = jax.tree.map(lambda leaf: None, compared)
        return (found, compared), (jacobian @ tangents[0], still)

    def of_free(y, _):
        return value(jnp.where(free, y, jax.lax.stop_gradient(start)), data)

    start = y
    solver = LevenbergMarquardt(fall)
    solution = optx.least_squares(
        of_free, solver, y, has_aux=True, max_steps=MOST_STEPS, throw=False, adjoint=optx.RecursiveCheckpointAdjoint()
    )
    info = solution.state.f_info
    jacobian = jax.vmap(info.jac.mv, out_axes=1)(jnp.eye(y.size))
    return Solved(
        jnp.where(free, solution.value, start),
        info.residual,
        jacobian,
        solution.aux,
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )
