"""The state of a whisker nearest to its measured reaction: least squares in each contact phase, and the likelier phase.

The states of a whisker in one phase are a family with a few parameters y. The last of them, `beyond`, is the angle
between whisker and object in tip contact, or the arc beyond the contact in tangential contact; it is >= 0 in both.
Gauss-Newton finds the state nearest to the measured reactions, weighted with their noise. States may have to satisfy
conditions as well, with Lagrange multipliers. The nearest state of all phases decides the phase.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar

LAST_STEP = 1e-5  # largest last step of a converged iteration, relative to `scale`, absolute for angle or arc
LARGEST_STEP = 0.3  # rad or lengths
LEAST_CHANGE, LARGEST_CHANGE = -0.7, 2.0  # of the other parameters, relative to `scale`: a force must stay positive
SOLVED = 1e-7  # largest residual of the conditions


class PhaseCandidate(NamedTuple):
    """A candidate for the phase of a contact."""

    tip: Bool[Array | np.ndarray, "*phases"]
    angle: Float[Array | np.ndarray, "*phases"]  # from the object to the whisker, in tangential contact


class WhiskerState(NamedTuple):
    """A whisker with certain parameters."""

    reaction: Float[Array, " reactions"]
    conditions: Float[Array, " conditions"]  # which vanish for the states of a phase
    values: Float[Array, " values"]  # contact x, y, slope, arc, and others


@runtime_checkable
class Observation(Protocol):
    """What the state of a whisker is estimated from, and the family of its states; dimensionless."""

    phases: PhaseCandidate
    conditions: int  # number of conditions
    steps: int  # of Gauss-Newton
    handicaps: Any  # of the phases: added to chi-squared for the decision, because some have more parameters
    failed: Any  # y and multipliers that replace those of failed fits, because every derivative must be finite

    @property
    def reaction(self) -> Float[Array, " reactions"]:
        """The measured reaction."""
        ...

    @property
    def weight(self) -> Float[Array, " reactions"]:
        """1 / standard deviation of the reaction."""
        ...

    def state(self, y: Float[Array, " n"], phase: PhaseCandidate) -> WhiskerState:
        """The state with these parameters; its conditions need not hold."""
        ...

    def guesses(self) -> Float[Array, "phases n"]:
        """Parameters to start from in each phase."""
        ...

    def limits(self, phase: PhaseCandidate) -> tuple[Scalar, Scalar]:
        """Least and largest `beyond`."""
        ...

    def scale(self, y: Float[Array, " n"]) -> Float[Array, " others"]:
        """Size of the other parameters."""
        ...


class Estimate(NamedTuple):
    """The state of a whisker nearest to the observation."""

    y: Float[Array, " n"]
    state: WhiskerState
    by_y: WhiskerState  # its derivatives
    phase: PhaseCandidate
    ok: Bool[Array, ""]  # whether the iteration converged in at least one phase
    chi2: Float[Array, ""]
    gradient: Float[Array, "rows n"]  # of the whitened residuals and the conditions
    other: Float[Array, " n"]  # the nearest state in the other phase
    other_phase: PhaseCandidate
    doubt: Scalar  # probability of the other phase

    def follows(self, residuals: Float[Array, "reactions k"]) -> Float[Array, "n k"]:
        """Changes of y with changes of the whitened residuals; Gauss-Newton is exact to first order in the noise."""
        count = len(residuals)
        right = jnp.sum(self.gradient[:count, :, None] * residuals[:, None, :], axis=0)
        right = jnp.pad(right, ((0, len(self.gradient) - count), (0, 0)))
        return -solve(_kkt(self.gradient, count), right)[: self.y.size]

    def ambiguity(self, observed: Observation, contact: Float[Array, " n"]) -> Float[Array, "n n"]:
        """Covariance that the other phase adds: its distance, with its probability."""
        there = observed.state(self.other, self.other_phase).values[: contact.size]
        apart = jnp.where(self.doubt > 0, there - contact, 0.0)
        return self.doubt * apart[:, None] * apart


def nearest_state(observed: Observation) -> Estimate:
    """The state nearest to the observation, in the likeliest phase."""
    constant, phases = jax.lax.stop_gradient(observed), jax.tree.map(jnp.asarray, observed.phases)
    found, chi2, ok = jax.vmap(partial(_fit, constant))(constant.guesses(), phases)
    chi2 = jnp.where(ok, chi2, jnp.inf) + observed.handicaps
    best = jnp.argmin(chi2)
    second = jnp.argmin(jnp.where(phases.tip == phases.tip[best], jnp.inf, chi2))
    found = jax.lax.stop_gradient(jnp.where(ok[:, None], found, observed.failed))
    (phase, first, least), (other, second, more) = (
        # Slower if indexed by k.
        jax.tree.map(lambda leaf, k=k: jax.lax.select_n(k, *leaf), (phases, found, chi2))
        for k in (best, second)
    )
    n = second.size - observed.conditions
    y = solution_of(_stationarity, first, (phase, observed))[:n]
    state, by_y = value_and_jacobian(lambda y: observed.state(y, phase), y)
    residual, gradient = _whitened(state, by_y, observed)
    both = (more < jnp.inf) & (other.tip != phase.tip)
    doubt = jnp.where(both, jax.nn.sigmoid((least - more) / 2), 0.0)
    chi2 = jnp.sum(residual[: observed.reaction.size] ** 2)
    return Estimate(y, state, by_y, phase, jnp.any(ok), chi2, gradient, second[:n], other, doubt)


class LocatedContact(NamedTuple):
    """A contact that depends on the channels of its own whisker only."""

    values: Float[Array, "*whiskers values"]  # see WhiskerState
    by_channels: Float[Array, "*whiskers numbers channels"]  # of the first values, with respect to whitened channels
    ambiguous: Float[Array, "*whiskers numbers numbers"]  # covariance of these that the other phase adds
    tip: Bool[Array | np.ndarray, "*whiskers"]
    ok: Bool[Array, "*whiskers"]
    chi2: Float[Array, "*whiskers"]


def locate(observed: Observation, numbers: int) -> LocatedContact:
    """Locate the contact of one whisker; the first `numbers` of its values have a covariance."""
    near = nearest_state(observed)
    values, by_y = near.state.values, near.by_y.values[:numbers]
    by_channels = jnp.sum(by_y[:, :, None] * near.follows(-jnp.eye(observed.reaction.size)), axis=1)
    ambiguous = near.ambiguity(observed, values[:numbers])
    return LocatedContact(values, by_channels, ambiguous, jnp.asarray(near.phase.tip), near.ok, near.chi2)


def rotated(vectors: Float[Array, "*batch 3"], angle: Scalar) -> Float[Array, "*batch 3"]:
    """Rotate forces with moments, or shifts with angles, counter-clockwise."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, rest = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, rest], axis=-1)


def value_and_jacobian(function: Callable, y: Float[Array, " n"]) -> tuple[Any, Any]:
    """The value of a function and its derivative, in forward mode."""

    def twice(y):
        value = function(y)
        return value, value

    gradient, value = jax.jacfwd(twice, has_aux=True)(y)
    return value, gradient


def _whitened(state: WhiskerState, by_y: WhiskerState, observed: Observation):
    """Whitened residuals of the reactions and the conditions, and their gradients."""
    residuals = jnp.concatenate([(state.reaction - observed.reaction) * observed.weight, state.conditions])
    return residuals, jnp.concatenate([by_y.reaction * observed.weight[:, None], by_y.conditions])


def _linearised(y: Float[Array, " n"], phase: PhaseCandidate, observed: Observation):
    return _whitened(*value_and_jacobian(lambda y: observed.state(y, phase), y), observed)


def _kkt(gradient: Float[Array, "rows n"], reactions: int) -> Float[Array, "size size"]:
    """The matrix of the least-squares problem with conditions (Karush, Kuhn and Tucker)."""
    gradient, conditions = gradient[:reactions], gradient[reactions:]
    normal = jnp.sum(gradient[:, :, None] * gradient[:, None, :], axis=0)
    return jnp.block([[normal, conditions.T], [conditions, jnp.zeros((len(conditions),) * 2)]])


def _fit(observed: Observation, start: Float[Array, " n"], phase: PhaseCandidate):
    """y of least chi-squared in one phase with its multipliers, chi-squared, and whether the iteration converged."""
    (least, largest), last, count = observed.limits(phase), start.size - 1, observed.reaction.size

    def step(_, carry):
        y = carry[0]
        value, gradient = _linearised(y, phase, observed)
        kkt, downhill = _kkt(gradient, count), jnp.sum(gradient[:count] * value[:count, None], axis=0)
        right = -jnp.concatenate([downhill, value[count:]])
        increment = solve(kkt, right[:, None])[last, 0]
        bounded = jnp.clip(y[last] + jnp.clip(increment, -LARGEST_STEP, LARGEST_STEP), least, largest)
        right = jnp.delete(right - kkt[:, last] * (bounded - y[last]), last)
        solution, scale = solve(_kkt(gradient[:, :last], count), right[:, None])[:, 0], observed.scale(y)
        change = jnp.clip(solution[:last], LEAST_CHANGE * scale, LARGEST_CHANGE * scale)
        size = jnp.max(jnp.abs(jnp.append(change / scale, bounded - y[last])))
        return jnp.append(y[:last] + change, bounded), solution[last:], size

    carry = start, jnp.zeros(observed.conditions), jnp.zeros(())
    y, multipliers, size = jax.lax.fori_loop(0, observed.steps, step, carry)
    state, found = observed.state(y, phase), jnp.append(y, multipliers)
    chi2 = jnp.sum(((state.reaction - observed.reaction) * observed.weight) ** 2)
    solved = jnp.max(jnp.abs(state.conditions), initial=0.0) < SOLVED
    return found, chi2, (size < LAST_STEP) & solved & jnp.isfinite(chi2) & jnp.all(jnp.isfinite(found))


def _stationarity(found: Float[Array, " size"], known: tuple[PhaseCandidate, Observation]) -> Float[Array, " size"]:
    """Derivatives of half chi-squared plus multipliers times conditions, which vanish at the nearest state."""
    phase, observed = known
    count = observed.reaction.size
    n = found.size - observed.conditions
    value, gradient = _linearised(found[:n], phase, observed)
    downhill = jnp.sum(gradient * jnp.concatenate([value[:count], found[n:]])[:, None], axis=0)
    # At the border between the phases, the last parameter is fixed.
    fixed = (jnp.arange(found.size) == n - 1) & ~(found[n - 1] > 0)
    return jnp.where(fixed, found, jnp.concatenate([downhill, value[count:]]))
