"""Where a scan of whiskers with several contacts begins, and where it ends if nothing happens.

If the unloaded whiskers are clear of all objects at the first position of the control, the scan starts there, also
inside a hollow. If not, the drive comes from afar along its line.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, unused
from jaxwhisker._chain.march_state import MarchOfChain, TrialOfChain
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.stance import stance_of
from jaxwhisker._path.approach import MARGIN
from jaxwhisker._path.continuation import Limits

CLEAR = 1e-9  # lengths: distance of whiskers that are clear of an object
HIGHEST_FORCE = 100.0  # EI/L^2 on every base; forces before a release hardly ever reach it
PASSED = 0.25  # lengths from the object at which a scan right across it ends
REACH = 2.0  # lengths of the longest whisker from the object at which loaded ones have come free, too
PLACES = np.concatenate([0.05 * np.arange(120), 6.0 * 1.1 ** np.arange(32)])  # distances on the way, in lengths


def all_free(problem: ChainProblem) -> tuple[Float[Array, "rows 3"], ChainState]:
    """The contacts of free whiskers."""
    return jnp.zeros((problem.rows, 3)), unused(problem.rows, friction=problem.friction_angle is not None)


def clearance(problem: ChainProblem, u: Scalar) -> Float[Array, ""]:
    """Least distance of the unloaded whiskers from all objects."""
    return jnp.min(stance_of(problem, u, problem.rest, *all_free(problem))[0].distance)


def limits_of(problem: ChainProblem, first_stop: Scalar) -> Limits:
    """The limits of a scan to a first stop, or right across the object if that is NaN."""
    whole = jnp.isnan(first_stop)
    if problem.ends is not None:
        first, last = problem.ends
        late = problem.onwards * (first_stop - first) > 0
        return Limits(jnp.where(whole | late, first, first_stop), last, last)
    base = problem.in_scene(jnp.zeros(()), problem.rest)
    middle = jnp.where(whole, problem.profile.vertex()[0] - jnp.mean(base.x), first_stop)

    onwards = problem.onwards.astype(float)
    # Places before and behind the middle, and the middle itself.
    ways = np.concatenate([-PLACES, PLACES])
    each = jnp.reshape(jax.vmap(lambda way: clearance(problem, middle + onwards * way))(jnp.asarray(ways)), (2, -1))

    def outermost(distances):
        """The place beyond the last one at which whiskers are close to an object."""
        last = jnp.max(jnp.where(distances > 2 * MARGIN, -1, jnp.arange(PLACES.size)))
        return jnp.asarray(PLACES)[jnp.minimum(last + 1, PLACES.size - 1)]

    before, behind = outermost(each[0]), outermost(each[1])
    softness = jnp.max(jnp.abs(problem.displacement(jnp.full_like(problem.rest, HIGHEST_FORCE).at[:, 1:].set(0.0))))
    far = middle + onwards * (behind + REACH * jnp.max(problem.length) + softness)
    here = ~whole & (each[0, 0] > CLEAR)
    start = jnp.where(here, middle, middle - onwards * before)
    return Limits(start, far, far, each[0, -1] > 2 * MARGIN)


def has_passed(problem: ChainProblem, march: MarchOfChain, trial: TrialOfChain) -> Bool[Array, ""]:
    """Whether all whiskers have passed the objects and cannot meet them again: the drive moves on along a line."""
    if problem.ends is not None:
        return jnp.asarray(False)
    here, there = march.stance.distance, trial.stance.distance
    leaves = jnp.all((there > here) & (there > PASSED)) & ~jnp.any(march.state.touches)
    far = march.direction * (trial.point.u - far_side(problem)) > 0
    return march.touched & (march.goal > 0) & (march.goal >= trial.last) & leaves & far


def far_side(problem: ChainProblem) -> Scalar:
    """A control beyond which whiskers have passed the lowest points of all objects."""
    base = problem.in_scene(jnp.zeros(()), problem.rest)
    lowest = jnp.stack([jnp.asarray(one.vertex()[0], dtype=float) for one in problem.profile.objects])
    way = problem.onwards.astype(float)
    return way * (jnp.max(way * lowest) - jnp.min(way * base.x)) + way * jnp.max(problem.length)
