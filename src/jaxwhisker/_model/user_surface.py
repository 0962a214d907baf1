"""The surface of a user-defined function."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field, name_of
from jaxwhisker._base.types import Scalar, Triple, Vector
from jaxwhisker._model.surface import AbstractSurface, as_point, outermost, triple_text

# Around a point, the steepest gradient of a level is looked for in these directions, at these shares of a distance.
WAYS = np.array([way for way in np.ndindex(3, 3, 3) if np.sum(np.array(way) == 1) in (0, 2)]) - 1.0
WAYS /= np.linalg.norm(WAYS, axis=1, keepdims=True)
SHARES = 0.5 ** np.arange(8)[::-1]
FLATTEST = 1e-9  # gradient of a level: smaller ones have no direction
FARTHEST = 100.0  # lengths: a larger ball is not needed


class Surface(AbstractSurface):
    """User-defined surface G(x) = 0.

    Args:
        function: G of a point (x, y, z), an array of shape (3,), lengths. It must be negative inside and positive
            outside, and smooth, with a gradient other than zero around the surface; its scale is arbitrary. JAX must be
            able to trace it. The parameters of an `equinox.Module` are differentiable; a plain function is constant.
        inside: (x, y, z) of a point inside, lengths.
        convex: whether the object is strictly convex. If not, a whisker may touch it in several places, for which the
            scene needs `contacts=2` or more. Details must then be larger than about a fortieth of the whisker. Right
            across an object that reaches beyond 126 lengths of the whisker along the drive, a scan needs a `control`.

    Raises:
        ValueError: if `function` is not a function of one array that JAX can trace, does not return one number, or is
            not negative at `inside`, or `inside` is not three finite numbers.

    Examples:
        >>> import jax.numpy as jnp
        >>> rounded = jw.Surface(lambda x: jnp.sum((x - jnp.array([0.0, 1.2, 0.0])) ** 4) - 1, inside=(0.0, 1.2, 0.0))
        >>> print(f"{rounded.off(jnp.array([0.0, 0.1, 0.0])):.4f}")
        0.0872
    """

    function: Callable
    inside: Triple
    convex: bool = eqx.field(static=True)
    _unit: Scalar  # of points; `function` stays in the user's unit

    def __init__(self, function: Callable, inside: Vector, *, convex: Any = True):
        point: Any = checks.as_tuple(inside)
        checks.function("function", function, shape=(3,))
        checks.triple("inside", point)
        checks.instance("convex", convex, bool, "True or False")
        self.function, self.inside, self.convex, self._unit = as_field(function), point, convex, 1.0
        level = self.level(as_point(point))
        if not checks.is_traced(level) and not level < 0:
            checks.fail("inside", "a point at which `function` is negative", f"{triple_text(point)}: {level:.6g}")

    def level(self, x):
        return jnp.asarray(self.function(x * self._unit), dtype=float)

    @property
    def is_convex(self):
        return self.convex

    @property
    def has_planes(self):
        return self.convex

    def plane_before(self, x):
        if not self.convex:
            return jnp.asarray(-1.0), self.normal(x)
        # The level may be anything far from the surface. The tangent plane in the direction of the point will do.
        inside = self.interior_point()
        out = x - inside
        out = jnp.where(jnp.all(out == 0), jnp.array([1e-9, 0.0, 0.0]), out)
        foot = inside + outermost(lambda share: self.level(inside + share * out)) * out
        normal = self.normal(foot)
        return jnp.sum(normal * (x - foot)) + self.off(foot), normal

    def ball_before(self, x):
        if self.convex:
            return self.plane_before(x)
        # In a ball, the level changes by no more than the radius times its steepest gradient.
        level, gradient = self.level(x), self.gradient(x)
        size = jnp.maximum(jnp.sqrt(jnp.sum(gradient**2)), FLATTEST)
        radii = SHARES * jnp.minimum(jnp.abs(level) / size, FARTHEST)
        around = jax.vmap(jax.vmap(self.gradient))(x + radii[:, None, None] * WAYS)
        steepest = jax.lax.cummax(jnp.max(jnp.sqrt(jnp.sum(around**2, axis=-1)), axis=1))
        radius = jnp.max(jnp.minimum(jnp.abs(level) / jnp.maximum(steepest, size), radii))
        return jnp.sign(level) * radius, gradient / size

    def in_unit(self, length):
        inside = tuple(part / length for part in self.inside)
        return eqx.tree_at(lambda s: (s.inside, s._unit), self, (inside, self._unit * length))

    def interior_point(self):
        return as_point(self.inside)

    def _positive(self):
        return [-self.level(self.interior_point())]

    def __str__(self):
        return f"surface {name_of(self.function)}(x) = 0"
