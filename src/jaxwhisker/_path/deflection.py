"""Deflection of a whisker while its loads grow: the branch of solutions that begins at rest, and what is known of it.

Rods in the plane and in space differ in their equations, and in what tells whether they are stable.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.load_path import follow
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._path.path import Status

ROD_STEPS = 32  # of the rod between two loads
LEAST_LOAD = 1e-3  # added to the size of loads, which may vanish
ACCURACY = 1e-8  # largest accepted error at the base, by comparison with twice as many steps
UNEVEN_ACCURACY = 1e-4  # of whiskers with functions of arc length: a warning tells where steps do not resolve these

Unknowns = Float[Array, " unknowns"]
Shares = Float[Array, " stages"]  # of what grows, such as springs and then loads, one after the other: 1 in the end


class AtBase(NamedTuple):
    """Where a rod ends that is integrated from its top."""

    missed: Unknowns  # residuals of the equations: by how much the rod misses its base
    pose: Float[Array, " coordinates"]  # of the rod's end; every error of the rod shows in it or in what is missed


class AbstractLoadedRod(eqx.Module):
    """The dimensionless equations of one whisker under given loads."""

    @property
    @abstractmethod
    def stages(self) -> int:
        """Number of things that grow one after the other; the loads come last."""

    @property
    @abstractmethod
    def sizes(self) -> list[Scalar]:
        """Sizes of what grows, positive; that of the loads in EI/L^2."""

    @property
    @abstractmethod
    def uniform(self) -> bool:
        """Whether the rod is the same everywhere."""

    @property
    @abstractmethod
    def unbent(self) -> Unknowns:
        """The unknowns before anything grows."""

    @abstractmethod
    def at_base(self, unknowns: Unknowns, shares: Shares) -> AtBase:
        """The end of the rod, with shares of what grows."""

    @abstractmethod
    def refined(self, unknowns: Unknowns, shares: Shares) -> tuple[AtBase, Bool[Array, ""]]:
        """The end of a rod with at least twice as many steps, and whether the equilibrium is stable."""


class AbstractLoadCase(eqx.Module):
    """A whisker and what loads and supports it, in the units of the whisker."""

    @abstractmethod
    def equations(self) -> AbstractLoadedRod:
        """The equations."""

    @abstractmethod
    def valid(self, rods: Any) -> Bool[Array, ""]:
        """Whether all numbers are in their domains."""

    @abstractmethod
    def values(self, rods: Any, unknowns: Unknowns, points: int) -> dict[str, Array]:
        """Reaction and shape of the deflected whisker at `points` points on each stretch between loads."""


class Checks(NamedTuple):
    """Errors and stability of a solution."""

    residual: Float[Array, ""]
    by_steps: Float[Array, ""]  # residual and change of the rod's end with twice as many steps
    stable: Bool[Array, ""]


class Branch(NamedTuple):
    """The end of the branch of solutions that begins before anything grows."""

    unknowns: Unknowns
    shares: Shares
    lost: Bool[Array, ""]  # whether stability is lost there


def misfit(unknowns: Unknowns, rods: AbstractLoadedRod) -> Unknowns:
    """The equations under the full loads."""
    return rods.at_base(unknowns, jnp.ones(rods.stages)).missed


def branch_of(rods: AbstractLoadedRod) -> Branch:
    """Follow the branch of solutions while one thing grows after the other."""
    sizes, stages = jnp.stack(rods.sizes), np.arange(rods.stages)

    def stage(before: Branch, k):
        def equations(unknowns, share):
            return rods.at_base(unknowns, before.shares.at[k].set(share)).missed

        path = follow(equations, before.unknowns, sizes[k])
        after = Branch(path.unknowns, before.shares.at[k].set(path.share), path.lost)
        complete = jnp.all((before.shares == 1) | (stages >= k))
        return jax.tree.map(lambda a, b: jnp.where(complete, a, b), after, before), None

    start = Branch(rods.unbent, jnp.zeros(stages.size), jnp.asarray(False))
    return jax.lax.scan(stage, start, stages)[0]


def checks_of(rods: AbstractLoadedRod, unknowns: Unknowns, shares: Shares) -> Checks:
    """Error and stability of a solution."""
    coarse, (fine, stable) = rods.at_base(unknowns, shares), rods.refined(unknowns, shares)
    by_steps = jnp.max(jnp.abs(jnp.concatenate([fine.missed, fine.pose - coarse.pose])))
    return Checks(jnp.max(jnp.abs(coarse.missed)), by_steps, stable)


def _solution(case: AbstractLoadCase) -> tuple[Unknowns, Int[Array, ""]]:
    """Unknowns and status."""
    rods = case.equations()
    end = branch_of(rods)
    found = checks_of(rods, end.unknowns, end.shares)
    # What the steps of the rod do not resolve is inexact, even if it seems to be unstable.
    by_steps = ACCURACY if rods.uniform else UNEVEN_ACCURACY
    exact = (found.residual < ACCURACY) & (found.by_steps < by_steps) & ((end.shares[-1] == 1) | end.lost)
    status = jnp.where(exact, jnp.where(found.stable & ~end.lost, Status.ok, Status.unstable), Status.inexact)
    return end.unknowns, jnp.where(case.valid(rods), status, Status.invalid)


@Program
def deflected(case: AbstractLoadCase, points: int) -> dict[str, Array]:
    """The values of a load case, NaN unless the status, which is one of them, is ok."""
    unknowns, status = _solution(jax.lax.stop_gradient(case))
    ok = status == Status.ok
    case = safe_placeholder(case, ok)
    rods = case.equations()
    unknowns = solution_of(misfit, jnp.where(ok, unknowns, jax.lax.stop_gradient(rods.unbent)), rods)
    values = case.values(rods, unknowns, points)
    return {name: jnp.where(ok, value, jnp.nan) for name, value in values.items()} | {"status": status}
