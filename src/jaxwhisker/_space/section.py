"""From a whisker to the section of its rod in space."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from jaxwhisker._base.types import Scalar
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.space import SpaceSection


class Opposite(eqx.Module):
    """A function of arc length with the opposite sign."""

    function: Callable

    def __call__(self, s: Scalar) -> Scalar:
        return -self.function(s)


def space_section(
    whisker: Whisker, length_unit: Scalar, stiffness_unit: Scalar, *, heavy: bool = False
) -> SpaceSection:
    """Stiffness and curvature along a whisker, in these units of length and EI, and its mass if it is `heavy`."""
    # A curvature in the plane is positive counter-clockwise, and d2 points along -z.
    bow, breaks = whisker.intrinsic_curvature, whisker.breaks
    second = None if bow is None else Opposite(bow) if callable(bow) else -jnp.asarray(bow)
    curvatures = whisker.lateral_curvature, second, whisker.twist
    ratio = whisker.lateral_ratio
    if ratio is not None or any(curvature is not None for curvature in curvatures):
        # One kind of curved whiskers instead of seven costs a whisker curved in one way two percent of the operations.
        first, second, third = (jnp.zeros(()) if curvature is None else curvature for curvature in curvatures)
        curvatures = first, second, third
    return SpaceSection(
        whisker.bending_stiffness,
        jnp.asarray(whisker.torsion, dtype=float),
        curvatures,
        jnp.asarray(length_unit, dtype=float),
        jnp.asarray(stiffness_unit, dtype=float),
        None if breaks is None else jnp.asarray(breaks),
        None if ratio is None else jnp.asarray(ratio, dtype=float),
        whisker.mass_per_length if heavy else None,
    )
