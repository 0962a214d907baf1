"""Lengths of steps along a path in space: next to objects, abrupt changes of curvature, and losses of stability."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.transitions import LOSS_BRACKET
from jaxwhisker._space.contact import POINT
from jaxwhisker._space.march_state import AnyTrialInSpace, MarchInSpace
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space.stance import SpaceStance

FOLD = 1e-3  # rate of the control just before a loss, per arc length, below which it is a fold


def longest_step(problem: SpaceProblem, march: MarchInSpace, stance: SpaceStance) -> Scalar:
    """Length of a step in which no free whisker passes through the object, and no contact where its curvature jumps."""
    speed = jnp.maximum(stance.speed * jnp.abs(march.tangent.u), 1e-12)
    clear = jnp.where(stance.free, stance.advance / speed, jnp.inf)
    even = jax.vmap(problem.surface.steps_to_joint)(march.point.z[:, POINT], march.tangent.z[:, POINT])
    return jnp.min(jnp.minimum(clear, jnp.where(march.phase == Phase.free, jnp.inf, even)))


def branches(march: MarchInSpace, trial: AnyTrialInSpace) -> Bool[Array, ""]:
    """Whether a loss of stability between two points close to each other is a bifurcation, and no fold."""
    turns = march.tangent.u * trial.tangent.u < 0  # next to an edge with a small radius, a fold is very narrow
    return ~turns & (jnp.abs(march.tangent.u) >= FOLD)


def step_to_loss(march: MarchInSpace) -> Scalar:
    """Length of the step that is expected to reach the loss of stability."""
    share = march.size / (march.size - march.unstable_size)
    share = jnp.where(march.unstable_size < 0, share, 0.5)
    share = jnp.clip(jnp.where(jnp.isfinite(share), share, 0.5), 0.02, 0.98)
    # A last step to the unstable state itself, which false position approaches for ever.
    return march.unstable_at * jnp.where(march.unstable_at < LOSS_BRACKET, 1.0, share)
