"""Turning points of the path: where the drive, or with friction the slip of a contact, comes to rest.

Beyond the first of them, the path has lost its stability (a fold) or would slip back (the contact sticks). Steps that
end beyond it are shortened until it is located. Rates along the path are positive before it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._path.leaving import SLIP_NOISE, to_snap, with_changed_slips
from jaxwhisker._path.march_state import MarchState, Trial, slips_on
from jaxwhisker._path.path import Node, select

FOLD_SLOPE = 1e-9  # du/ds below which a fold counts as located: the error of the state is of this size, of u its square
STICK_SLOPE = 2e-9  # the same for slips that come to rest; larger than the noise of their rates
AT_FOLD = 1e-5  # distance to a fold within which slips that come to rest do so at the fold
FOLD_BRACKET = 1e-9  # a loss of stability within a step this short counts as located, too
RESOLVED_STEP = 0.02  # step within which du/ds is a parabola to a few percent of its change
PARABOLA_ERROR = 0.25  # assumed error of the parabola's slopes, relative to that change, with a margin
SHORTEST_DIP = 1e-4  # step within which du/ds changes by about 1e-6 at most: folds closer together are overlooked

Turns = Float[Array, "*rates"]  # of the drive and, with friction, of slips


class TurningPoint(NamedTuple):
    """Whether a turning point lies within a step or at its end."""

    holds: Bool[Array, ""]  # nothing turns back within the step
    located: Bool[Array, ""]  # what turns back does so at the end
    reached: Bool[Array, ""]  # what is known to turn back ahead rests at the end
    rests: Bool[Array, " whiskers"] | None  # the contacts among this; None without friction


def turning_point(march: MarchState, trial: Trial) -> TurningPoint:
    """Compare the end of a step with what is known of a loss of stability ahead."""
    turn, known = march.turn(trial.tangent), jnp.isfinite(march.unstable_at)
    located, short = jnp.abs(turn) < FOLD_SLOPE, march.step < FOLD_BRACKET
    reached = known & (turn < FOLD_SLOPE)
    if trial.slips_on is None:
        return TurningPoint(trial.stable, located | short, reached, None)
    back = jnp.min(jnp.where(trial.slips_on > -SLIP_NOISE, jnp.inf, trial.slips_on))
    located = jnp.where(back < turn, back > -STICK_SLOPE, located)
    # A slip rate that is always small says nothing; one that is known to turn back ahead has come to rest here.
    rests = known & (march.unstable_turn[1:] < -SLIP_NOISE) & (trial.slips_on < FOLD_SLOPE)
    # At a fold, all contacts that only the drive moves rest with it.
    ahead = march.unstable_turn[0]
    rests &= (ahead >= 0) | (turn * (march.unstable_at - march.step) > AT_FOLD * (turn - ahead))
    return TurningPoint(trial.stable & (back > 0), located | short, reached | jnp.any(rests), rests)


def turns_of(march: MarchState, trial: Trial) -> Turns:
    """Rates, at the end of a step, of what must not turn back."""
    return _turns(march.turn(trial.tangent), trial.slips_on)


def _turns(turn: Scalar, slips_on: PerWhisker | None) -> Turns:
    """Rates of the drive and, with friction, of slips, as one array."""
    return jnp.asarray(turn) if slips_on is None else jnp.concatenate([jnp.reshape(turn, 1), slips_on])


def step_to_loss(turns: Turns, unstable_at: Scalar, unstable_turns: Turns) -> Scalar:
    """Length of the step towards a known loss of stability, but not beyond; infinite if none is known."""
    # These rates fall nearly linearly, so that the first zero is a secant away; a loss without a fold is bisected.
    share = jnp.where(unstable_turns < 0, turns / (turns - unstable_turns), jnp.inf if turns.ndim else 0.5)
    if turns.ndim:
        share = jnp.min(share)
        share = jnp.where(jnp.isfinite(share), share, 0.5)
    return jnp.where(jnp.isfinite(unstable_at), unstable_at * jnp.clip(share, 1e-3, 0.999), jnp.inf)


def before_loss(problem: Problem, march: MarchState, trial: Trial, distance: Scalar) -> MarchState:
    """The state before a step at whose end, at this distance, stability is lost; with a shorter step to try."""
    start = _turns(march.turn(march.tangent), slips_on(problem, march.state, march.point.z, march.tangent.z))
    turns = turns_of(march, trial)
    step = step_to_loss(start, distance, turns)
    return march._replace(unstable_at=distance, unstable_turn=turns, step=step)


def after_turning_point(
    problem: Problem, moved: MarchState, trial: Trial, node: Node, rests: Bool[Array, " whiskers"] | None
) -> MarchState:
    """The state at a located turning point: the path loses stability at a fold, or a contact begins to stick."""
    fold = to_snap(moved)
    friction, limit = moved.state.friction, problem.friction_angle
    if trial.slips_on is None or friction is None or limit is None or rests is None:
        return fold
    sticks = (trial.slips_on < -SLIP_NOISE) | rests
    sticks &= trial.slips_on < moved.turn(trial.tangent)
    # Without any friction, slips that come to rest turn back at once.
    slip = jnp.where(sticks, jnp.where(limit > 0, 0, -friction.slip), friction.slip)
    stick = with_changed_slips(problem, moved, node, slip, trial.tangent, rest=True)
    return select(jnp.any(sticks), stick, fold)


def may_fold_twice(march: MarchState, trial: Trial) -> tuple[Bool[Array, ""], Scalar]:
    """Whether u may turn back and forth within a step whose ends are stable, and at which share of the step.

    Within the step, du/ds is taken for a parabola with the values at the step's ends and the step's mean. Near a
    critical stiffness it dips towards zero. Such a dip is passed in short steps; a dip below zero is a pair of folds.
    """
    start, end = march.turn(march.tangent), march.turn(trial.tangent)
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
