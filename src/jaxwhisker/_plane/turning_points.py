"""Turning points of the path: where the drive, or what a contact must not undo, comes to rest.

Beyond the first of them, the path has lost its stability (a fold) or would, with friction, slip back. Steps that
end beyond it are shortened until it is located. Rates along the path are positive before it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.continuation import Loss
from jaxwhisker._path.slips import RATE_NOISE
from jaxwhisker._plane.law import FOLD_SLOPE, Turns, contact_law
from jaxwhisker._plane.march_state import MarchInPlane, TrialInPlane

REST_SLOPE = 2e-9  # rates of contacts above which they count as at rest; larger than the noise of these rates
AT_FOLD = 1e-5  # distance to a fold within which slips that come to rest do so at the fold
FOLD_BRACKET = 1e-9  # a loss of stability within a step this short counts as located, too
RESOLVED_STEP = 0.02  # step within which du/ds is a parabola to a few percent of its change
PARABOLA_ERROR = 0.25  # assumed error of the parabola's slopes, relative to that change, with a margin
SHORTEST_DIP = 1e-4  # step within which du/ds changes by about 1e-6 at most: folds closer together are overlooked


def turning_point(march: MarchInPlane, trial: TrialInPlane) -> Loss:
    """Compare the end of a step with what is known of a loss of stability ahead."""
    (turn, rates), known = (trial.turns[0], trial.turns[1:]), jnp.isfinite(march.unstable_at)
    located, short = jnp.abs(turn) < FOLD_SLOPE, march.step < FOLD_BRACKET
    back = jnp.min(rates, where=rates <= -RATE_NOISE, initial=jnp.inf)
    located = jnp.where(back < turn, back > -REST_SLOPE, located)
    # A rate that is always small says nothing; one that is known to turn back ahead has come to rest here.
    rests = known & (march.unstable_turns[1:] < -RATE_NOISE) & (rates < FOLD_SLOPE)
    # At a fold, all contacts that only the drive moves rest with it.
    ahead = march.unstable_turns[0]
    rests &= (ahead >= 0) | (turn * (march.unstable_at - march.step) > AT_FOLD * (turn - ahead))
    reached = (known & (turn < FOLD_SLOPE)) | jnp.any(rests)
    return Loss(trial.stable & (back > 0), located | short, reached, rests)


def step_to_loss(turns: Turns, unstable_at: Scalar, unstable_turns: Turns) -> Scalar:
    """Length of the step towards a known loss of stability, but not beyond; infinite if none is known."""
    # These rates fall nearly linearly, so that the first zero is a secant away; a loss without a fold is bisected.
    share = jnp.min(jnp.where(unstable_turns < 0, turns / (turns - unstable_turns), jnp.inf))
    share = jnp.where(jnp.isfinite(share), share, 0.5)
    return jnp.where(jnp.isfinite(unstable_at), unstable_at * jnp.clip(share, 1e-3, 0.999), jnp.inf)


def before_loss(problem: Problem, march: MarchInPlane, trial: TrialInPlane, distance: Scalar) -> MarchInPlane:
    """The state before a step at whose end, at this distance, stability is lost; with a shorter step to try."""
    start = contact_law(problem).turns(march, march.point.z, march.tangent)
    step = step_to_loss(start, distance, trial.turns)
    return march.replace(unstable_at=distance, unstable_turns=trial.turns, step=step)


def may_fold_twice(march: MarchInPlane, trial: TrialInPlane) -> tuple[Bool[Array, ""], Scalar]:
    """Whether u may turn back and forth within a step whose ends are stable, and at which share of the step.

    Within the step, du/ds is taken for a parabola with the values at the step's ends and the step's mean. Near a
    critical stiffness it dips towards zero. Such a dip is passed in short steps; a dip below zero is a pair of folds.
    """
    start, end = march.drive_rate(march.tangent), march.drive_rate(trial.tangent)
    mean = march.direction * (trial.solution.point.u - march.point.u) / march.step
    least, highest = jnp.minimum(start, end), jnp.maximum(start, end)
    slope, bend = 6 * mean - 4 * start - 2 * end, 3 * start + 3 * end - 6 * mean
    # The lowest value that du/ds may have if the slope at either end is wrong by this much.
    wrong = PARABOLA_ERROR * (highest - least)
    bowl = jnp.where(bend > 0, bend, 1.0)
    steeper, flatter = slope - wrong, slope + 2 * bend + wrong
    at = -steeper / (2 * bowl)
    lowest = start + at * (steeper + at * bend)
    inside = (at > 0) & (at < 1) & ((lowest < 0) | ((march.step > RESOLVED_STEP) & (lowest < 0.5 * least)))
    at_end = (slope < 0) & (flatter > 0) & (end < wrong**2 / (4 * bowl))
    possible = trial.stable & (bend > 0) & (least > 0) & (march.step > SHORTEST_DIP)
    return possible & (inside | at_end), jnp.where(inside, jnp.clip(at, 0.2, 0.8), 0.6)
