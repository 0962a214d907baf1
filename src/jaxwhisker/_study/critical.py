"""The critical stiffness: below it a scan snaps through the vertex and skips the maximum.

A base on a spring is stable while the spring is stiffer than the object's force is steep, c > dF_x/dx0 of the clamped
whisker, F_x = -fx being the force on the whisker. The steepest slope near the vertex is therefore the critical
stiffness of one whisker. (Towards the snap-off the slope grows without bound: there every spring gives way, and none
skips a maximum.) Coupled whiskers: as much more as the softest base yields more than a single spring, if the forces on
the others stayed as they are; they don't, so that this is an estimate.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._equilibrium.problem import problem_of
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, units
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.scan import scan

STEPS = 257  # of a search; every further one looks between the neighbours of the last one's best
SEARCHES = 4  # the last one's steps are 1e-8 of the first one's range


class Steepest(NamedTuple):
    """The steepest slope dF_x/dx0 of a clamped whisker (force per length), and the position x0 of its base there."""

    slope: float
    base_x: float


def steepest(whisker: Whisker, profile: AbstractProfile) -> Steepest:
    """The largest slope of the clamped whisker's force between its first touch and its snap-off, to 1e-9 of it.

    NaN if there is none: the whisker is out of reach, or so far from the object that the slope only grows, up to the
    snap-off.

    Args:
        whisker: the whisker; concrete, as is the profile: the place of the maximum is searched for.
        profile: the object.
    """
    checks.float64_mode()
    if checks.is_traced((whisker, profile)):
        raise ValueError(
            "`whisker` and `profile` must be concrete, but are traced: the steepest slope is searched for."
        )
    scene = jax.tree.map(checks.as_float, Scene(whisker, profile))
    touch, length = problem_of(scene), float(units(scene).length)
    first, last = float(touch.touch_right.x[0]) * length, float(touch.touch_left.x[0]) * length
    best = Steepest(np.nan, np.nan)
    for _ in range(SEARCHES):
        x = np.linspace(first, last, STEPS)
        slope, force = (np.asarray(leaf) for leaf in _slope(scene, jnp.asarray(x)))
        known = np.isfinite(slope) & (force > 0) & (slope > 0)
        # What is largest next to the snap-off, where contact ends, is no maximum.
        top = known[1:-1] & known[:-2] & known[2:] & (slope[1:-1] >= slope[:-2]) & (slope[1:-1] >= slope[2:])
        if not top.any():
            break
        k = 1 + int(np.argmax(np.where(top, slope[1:-1], -np.inf)))
        best, first, last = Steepest(float(slope[k]), float(x[k])), x[k - 1], x[k + 1]
    return best


@eqx.filter_jit
def _slope(scene: Scene, base_x: Float[Array, " steps"]) -> tuple[Float[Array, " steps"], Float[Array, " steps"]]:
    """dF_x/dx0 and the contact force at positions of the clamped base."""

    def force(base_x):
        result = scan(scene, base_x)
        return -result.fx[:, 0], result.contact_force[:, 0]

    (_, size), (slope, _) = jax.jvp(force, (base_x,), (jnp.ones_like(base_x),))
    return slope, size


def softest(support: Support) -> float:
    """How far the softest base yields to a force there: max C_ii, a length per force; 0 for a clamped one."""
    flexibility = support.flexibility()
    return 0.0 if flexibility is None else float(np.max(np.diag(np.asarray(flexibility.matrix))))
