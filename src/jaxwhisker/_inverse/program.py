"""Compiled programs: kept per user's function and argument shapes, and the least-squares fit among them."""

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

from jaxwhisker._base.program import COMPILER_OPTIONS
from jaxwhisker._inverse.parameters import Unknowns
from jaxwhisker._inverse.residuals import Comparison, Samples, residuals
from jaxwhisker._inverse.statistics import chi_squared
from jaxwhisker._model.scene import Scene

FIT_STEPS = 60  # of Levenberg-Marquardt
FINAL = 1e-6  # decrease of the sum of squares below which a fit ends: within 1e-3 standard errors of the minimum
COARSE = 1e-4  # the same for the first stages
SMALL = 1e-7  # change of variables of order one, and of residuals, below which a fit ends as well
RIDGE = 1e-14  # added to the diagonal of a scaled normal matrix, which is zero for an unknown that stays fixed
KEPT = 32  # functions whose programs are kept


def program(function: Callable, build: Callable, *static: Any) -> Any:
    """`function(build, *static, ...)`, compiled for each shape of its other arguments.

    Programs are kept, because compiling takes longer than running.
    """
    try:
        return _kept(function, build, *static)
    except TypeError:  # a module with arrays has no hash
        return _kept.__wrapped__(function, build, *static)


@lru_cache(maxsize=KEPT)
def _kept(function: Callable, build: Callable, *static: Any) -> Any:
    return jax.jit(partial(function, build, *static), compiler_options=COMPILER_OPTIONS)


def compile_all(run: Any, *several: tuple) -> None:
    """Compile a program for arguments of several shapes in parallel; calls then use the compiled code."""
    lowered = [run.lower(*args) for args in several]
    with ThreadPoolExecutor(len(several)) as threads:
        list(threads.map(lambda one: one.compile(), lowered))


class LevenbergMarquardt(optx.LevenbergMarquardt):
    """Levenberg-Marquardt that ends when another step would not lower the sum of squares by more than `least`.

    Otherwise unknowns that are hardly determined would keep moving for many steps, and near the minimum rounding would
    decide which steps are accepted.
    """

    least: Any = 0.0

    def __init__(self, least: Any):
        super().__init__(rtol=SMALL, atol=SMALL)
        self.least = least

    def terminate(self, fn, y, args, options, state, tags):
        """Whether the fit has ended, and its result code."""
        small, result = super().terminate(fn, y, args, options, state, tags)
        jacobian = jax.vmap(state.f_info.jac.mv, out_axes=1)(jnp.eye(y.size))
        settled = possible_decrease(state.f_info.residual, jacobian) < self.least
        return small | (settled & ~state.first_step), result


def possible_decrease(
    residual: Float[Array, " residuals"], jacobian: Float[Array, "residuals unknowns"]
) -> Float[Array, ""]:
    """Decrease of the sum of squares that a Gauss-Newton step predicts."""
    size = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    scaled = jacobian / jnp.where(size > 0, size, 1.0)
    slope, bend = scaled.T @ residual, scaled.T @ scaled + RIDGE * jnp.eye(size.size)
    return slope @ jnp.linalg.solve(bend, slope)


class Minimum(NamedTuple):
    """The end of a least-squares fit: a minimum, if it converged."""

    y: Any  # (unknowns,)
    residual: Any  # (residuals,)
    jacobian: Any  # (residuals, unknowns)
    compared: Comparison
    steps: Any
    converged: Any

    @property
    def misfit(self) -> float:
        """Sum of squares of all residuals, including those of the prior."""
        return chi_squared(self.residual)

    @property
    def observed(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives, without those of the prior."""
        rows = self.residual.size - self.y.size
        return self.residual[:rows], self.jacobian[:rows]


class LeastSquares:
    """Least-squares fits of one `build` to data of any shape; compiled at the first call for each."""

    def __init__(self, build: Callable[..., Scene], unknowns: Unknowns):
        self._program = program(_least_squares, build, unknowns)
        self._all = np.ones(len(unknowns.all_names), bool)

    def __call__(self, y: np.ndarray, data: Samples, free: np.ndarray | None = None, least: float = FINAL) -> Minimum:
        """Fit, starting from y; unknowns that are not free stay fixed."""
        return jax.tree.map(np.asarray, self._program(y, data, self._all if free is None else free, least))

    def compile_all(self, *several: Samples) -> None:
        """Compile for data of several shapes in parallel."""
        compile_all(self._program, *((np.zeros(self._all.size), data, self._all, FINAL) for data in several))


def _least_squares(
    build: Callable[..., Scene],
    unknowns: Unknowns,
    start: Float[Array, " unknowns"],
    data: Samples,
    free: Any,
    least: Any,
) -> Minimum:
    # jit traces and compiles this once, although the solver asks for values and for derivatives in different places.
    @jax.jit
    def both(y, data):
        value, push, compared = jax.linearize(lambda y: residuals(build, unknowns, y, data), y, has_aux=True)
        return value, jax.vmap(push, out_axes=1)(jnp.eye(y.size)), compared

    @eqx.filter_custom_jvp
    def value(y, data):
        residual, _, compared = both(y, data)
        return residual, compared

    @value.def_jvp
    def _(primals, tangents):
        residual, jacobian, compared = both(*primals)
        constant = jax.tree.map(lambda leaf: None, compared)
        return (residual, compared), (jacobian @ tangents[0], constant)

    solution = optx.least_squares(
        lambda y, _: value(jnp.where(free, y, jax.lax.stop_gradient(start)), data),
        LevenbergMarquardt(least),
        start,
        has_aux=True,
        max_steps=FIT_STEPS,
        throw=False,
        adjoint=optx.RecursiveCheckpointAdjoint(),
    )
    info = solution.state.f_info
    return Minimum(
        jnp.where(free, solution.value, start),
        info.residual,
        jax.vmap(info.jac.mv, out_axes=1)(jnp.eye(start.size)),
        solution.aux,
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )
