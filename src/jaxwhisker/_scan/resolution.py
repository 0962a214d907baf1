"""A warning about whiskers whose functions of arc length change within the steps of an integration."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.announce import warn
from jaxwhisker._base.program import Program
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import Shooting
from jaxwhisker._rod.resolution import bending_error, relative_error
from jaxwhisker._rod.rod import Section

RESOLVED = 1e-6  # rad or lengths: most signals of scans are then accurate to six digits


def warn_of_steps(scene: Scene, *, masses: bool = False) -> None:
    """Warn if the integration steps of a scene do not resolve its whiskers."""
    steps = scene.rod.steps if isinstance(scene.rod, Shooting) else Shooting().steps
    for whisker in scene.whiskers:
        warn_of_whisker(whisker, 2 * steps, masses=masses)


def warn_of_whisker(whisker: Whisker, steps: int, *, masses: bool = False) -> None:
    """Warn if so many steps do not resolve stiffness and curvature of a whisker or, on request, its mass.

    Whiskers without functions cost nothing, and traced ones are not examined.
    """
    names = ("bending_stiffness", "intrinsic_curvature", *["mass_per_length"] * masses)
    names = [name for name in names if callable(getattr(whisker, name))]
    if not names or checks.is_traced(whisker):
        return
    error = float(_error(jax.tree.map(checks.as_float, whisker if masses else whisker.without_masses()), steps))
    if error > RESOLVED:
        warn(
            f"Integration steps do not resolve {' and '.join(f'`{name}`' for name in names)}: the estimated error is "
            f"{error:.0e} rad or lengths. Pass the arc lengths of jumps and kinks as `Whisker(breaks=...)`. Where "
            "functions are steep but smooth, breaks help too, and so do more steps: `Scene(rod=Shooting(steps=...))`."
        )


@Program
def _error(whisker: Whisker, steps: int) -> Float[Array, ""]:
    length, one = jnp.asarray(whisker.length, dtype=float), jnp.ones(())
    error = jnp.zeros(())
    if not whisker.uniform:
        # Dimensionless, like the problems of scans.
        error = bending_error(one, whisker.section(length, whisker.base_stiffness), steps)
    if callable(whisker.mass_per_length):
        density = Section(one, whisker.mass_per_length, length, one, one, whisker.section(length, one).breaks)
        error = jnp.maximum(error, relative_error(one, density, steps))
    return error
