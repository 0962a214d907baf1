"""An elastic foundation: tissue around the shaft of a whisker."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar


class Foundation(eqx.Module):
    """Tissue that holds a stretch of a straight whisker's shaft, distributed along it.

    It pushes every point of the stretch back across the unloaded whisker, in the frame of the drive, in proportion to
    the displacement there. It frees the base along x, like a spring on the shaft. As a beam inside its follicle, a
    whisker is free in angle, too: `Support(foundation=..., free=("phi",))`.

    Args:
        start: arc length from the base at which the stretch begins; not negative.
        stop: arc length at which it ends; greater than `start`.
        stiffness: force per displacement and length; positive.
        rest_length: displacement across the whisker at which it is unstrained, as that of a spring along x; a length.

    Raises:
        ValueError: if a value is out of its domain.

    Examples:
        >>> tissue = jw.Foundation(start=0.0, stop=0.1, stiffness=2000.0)
        >>> jw.Support(foundation=tissue, free=("phi",)).axes
        ('x', 'phi')

    Source: Luo, Bresee, Rudnicki and Hartmann (2021), PLoS Comput. Biol. 17, e1007887, hold the whisker as a beam
    inside its follicle by springs and tissue.
    """

    start: Scalar
    stop: Scalar
    stiffness: Scalar
    rest_length: Scalar = 0.0

    def __check_init__(self):
        checks.number("start", self.start, non_negative=True)
        checks.number("stop", self.stop, positive=True)
        checks.number("stiffness", self.stiffness, positive=True)
        checks.number("rest_length", self.rest_length)
        if not checks.is_traced((self.start, self.stop)) and not float(self.stop) > float(self.start):
            checks.fail("stop", f"greater than start = {self.start}", self.stop)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        start, stop = jnp.asarray(self.start), jnp.asarray(self.stop)
        return checks.all_finite(self) & (start >= 0) & (stop > start) & (jnp.asarray(self.stiffness) > 0)
