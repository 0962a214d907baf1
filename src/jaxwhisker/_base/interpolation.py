"""Cubics in t from 0 to 1 with given values and rates at both ends (Hermite)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

Values = Float[Array, "..."]


class Cubic(NamedTuple):
    """A cubic, or arrays of cubics."""

    start: Values
    end: Values
    leaving: Values  # rate at the start
    arriving: Values  # rate at the end

    def _powers(self) -> tuple[Values, Values]:
        """Factors of t squared and of t cubed."""
        rise = self.end - self.start
        return 3 * rise - 2 * self.leaving - self.arriving, self.leaving + self.arriving - 2 * rise

    def value(self, t: Values) -> Values:
        """The value at t."""
        bend, twist = self._powers()
        return self.start + t * (self.leaving + t * (bend + t * twist))

    def rate(self, t: Values) -> Values:
        """The derivative by t at t."""
        bend, twist = self._powers()
        return self.leaving + t * (2 * bend + t * 3 * twist)

    def valley(self) -> Values:
        """The t at which it is least, if it falls at the start and rises at the end; otherwise 1."""
        bend, twist = self._powers()
        turns = (self.leaving < 0) & (self.arriving > 0)
        root = jnp.sqrt(jnp.where(turns, bend**2 - 3 * twist * self.leaving, 1.0))
        return jnp.where(turns, -self.leaving / jnp.where(turns, bend + root, 1.0), 1.0)

    def minimum(self) -> Values:
        """The t of the minimum of the whole cubic, which need not lie between 0 and 1; infinite without one."""
        bend, twist = self._powers()
        square = bend**2 - 3 * twist * self.leaving
        root = jnp.sqrt(jnp.where(square > 0, square, 1.0))
        # Without loss of digits on either side.
        above, below = jnp.where(bend > 0, -self.leaving, root - bend), jnp.where(bend > 0, bend + root, 3 * twist)
        return jnp.where((square > 0) & (below != 0), above / jnp.where(below == 0, 1.0, below), jnp.inf)

    def least(self) -> Float[Array, "..."]:
        """The smallest value between the ends, in closed form."""
        bend, twist = self._powers()
        # Both places where leaving + 2 bend t + 3 twist t^2 vanishes, without loss of digits.
        root = jnp.sqrt(jnp.maximum(bend**2 - 3 * twist * self.leaving, 0.0))
        sum_ = -(bend + jnp.where(bend < 0, -root, root))
        least = jnp.minimum(self.start, self.end)
        for above, below in ((sum_, 3 * twist), (self.leaving, sum_)):
            least = jnp.minimum(least, self.value(jnp.clip(above / jnp.where(below == 0, 1.0, below), 0.0, 1.0)))
        return least


def between(values: Float[Array, "points *of"], rates: Float[Array, "points *of"], cells: Values) -> Cubic:
    """The cubics between neighbouring points, whose rates are per arc length of cells of these lengths."""
    return Cubic(values[:-1], values[1:], rates[:-1] * cells, rates[1:] * cells)
