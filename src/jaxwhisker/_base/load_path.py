"""Continuation of an equilibrium while its loads grow, by arc length in the space of unknowns and load.

With the unknowns a and the share p of the loads, equilibria f(a, p) = 0 form a curve, which is followed from p = 0 to
p = 1. Its length is measured with a in radians or lengths of the whisker and with the load in EI/L^2: if p were not
scaled, all branches under a large load would seem parallel. Each step goes along the tangent and is corrected by
Newton's method on the plane across it. Close to a loss of stability, other branches are near. A step is
therefore accepted only if the correction is small, the tangent turns little and the determinant of df/da remains
positive; otherwise a shorter one is tried. Where even the shortest step changes the sign of the determinant, the
equilibrium is not stable any more, and dead loads would make the whisker snap.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import determinant, solve
from jaxwhisker._base.types import Scalar

FIRST, SHORTEST = 0.047, 1e-6  # steps along the curve
LONGEST = 0.3  # change of the unknowns in a step
LAST = 1.5  # times its length that the last step may have, so that none is left over that is too short
GROWTH, REDUCTION = 2.0, 0.25  # of the next step, after a good one and after one that is not accepted
CORRECTIONS = 5  # evaluations per step
CONVERGED = 1e-8  # last correction
NEAR = 0.1  # largest correction of an accepted step, relative to its length
MISSED = 0.3  # largest residual at the predicted end of an accepted step, where others are near under a large load
STRAIGHT = 0.97  # least cosine of the angle by which the tangent turns
VANISHES = (
    1e-2  # size of the determinant next to a loss of stability, where it is zero; it is 1 without springs and loads
)
MOST = 300  # steps


class LoadPath(NamedTuple):
    """The end of the curve."""

    unknowns: Float[Array, " n"]
    share: Float[Array, ""]  # up to which it was followed; exactly 1 if it is complete
    lost: Bool[Array, ""]  # whether stability is lost before


class _Curve(NamedTuple):
    at: Float[Array, " m"]  # unknowns and load
    tangent: Float[Array, " m"]  # of unit length
    step: Float[Array, ""]  # the next step's length; 0 at the beginning
    lost: Bool[Array, ""]
    count: Int[Array, ""]


def follow(
    equations: Callable[[Float[Array, " n"], Scalar], Float[Array, " n"]], start: Float[Array, " n"], load: Scalar
) -> LoadPath:
    """Follow the solution from no load to the full load.

    Args:
        equations: residuals at given unknowns and share of the loads.
        start: the unknowns without a load.
        load: size of the full load, positive.
    """
    along_load = jnp.append(jnp.zeros(start.size), 1.0)

    def evaluate(at):
        value = equations(at[:-1], at[-1] / load)
        return value, value

    def solved(slope, row, right):
        return solve(jnp.concatenate([slope, row[None]]), right[:, None])[:, 0]

    def advance(curve: _Curve) -> _Curve:
        reach = (load - curve.at[-1]) / jnp.maximum(curve.tangent[-1], 1e-300)
        last = (curve.tangent[-1] > 0) & (reach <= LAST * curve.step)
        length = jnp.where(last, reach, curve.step)
        begins = curve.step == 0
        row = jnp.where(last | begins, along_load, curve.tangent)
        predicted = curve.at + length * curve.tangent

        def correct(carry, _):
            at, *_ = carry
            slope, value = jax.jacfwd(evaluate, has_aux=True)(at)
            change = -solved(slope, row, jnp.append(value, row @ (at - predicted)))
            return (at + change, jnp.max(jnp.abs(change)), slope), jnp.max(jnp.abs(value))

        carry = predicted, jnp.asarray(0.0), jnp.zeros((start.size, start.size + 1))
        (at, change, slope), missed = jax.lax.scan(correct, carry, length=CORRECTIONS)
        tangent = solved(slope, curve.tangent, along_load)
        tangent /= jnp.sqrt(jnp.sum(tangent**2))
        apart = jnp.sqrt(jnp.sum((at - predicted) ** 2))
        solution = change < CONVERGED
        near = solution & (apart <= NEAR * length) & (tangent @ curve.tangent > STRAIGHT) & (missed[0] < MISSED)
        size = determinant(slope[:, :-1])
        stable = size > 0
        accepted = stable & (near | (begins & solution))
        short = curve.step < SHORTEST
        longer = jnp.where(apart <= NEAR / 4 * length, GROWTH, 1.0) * curve.step
        most = LONGEST / jnp.maximum(jnp.sqrt(jnp.sum(tangent[:-1] ** 2)), 1e-300)
        step = jnp.where(accepted, jnp.minimum(jnp.where(begins, FIRST, longer), most), REDUCTION * curve.step)
        return _Curve(
            jnp.where(accepted, jnp.where(last, at.at[-1].set(load), at), curve.at),
            jnp.where(accepted, tangent, curve.tangent),
            step,
            curve.lost | (~accepted & short & solution & ~stable & (size > -VANISHES)),
            curve.count + 1 + jnp.where(~accepted & short, MOST, 0),
        )

    def unfinished(curve: _Curve) -> Bool[Array, ""]:
        return (curve.at[-1] < load) & (curve.count < MOST)

    zero = jnp.zeros(())
    begin = _Curve(jnp.append(start, 0.0), along_load, zero, jnp.asarray(False), jnp.asarray(0))
    end = jax.lax.while_loop(unfinished, advance, begin)
    return LoadPath(end.at[:-1], end.at[-1] / load, end.lost)
