"""The object in space: a rigid body inside its surface, which whiskers touch.

Frame: x along the scan, y up, z = x cross y. Surfaces whose equation is quadratic become one class, `Quadric`, however
they are placed, so that scenes with any of them share their programs. So do capsules and boxes (`rounded.py`).
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.rotation import rotation_matrix
from jaxwhisker._base.types import Scalar, Triple, Vector

Point = Float[Array, "3"]
NOWHERE = (0.0, 0.0, 0.0)
RIDDERS_STEPS = 8  # by which a point of the surface is found; errors of planes there are of second order
FARTHEST = 1e3  # of a point inside from the object's inner point, the surface may be so many times farther away


class AbstractSurface(eqx.Module):
    """A surface: the points where a smooth function, its level, is zero. The level is negative inside the object.

    The contact force acts on the whisker along the outward normal. Points are arrays (x, y, z) of shape (3,), lengths.
    """

    is_surface: ClassVar[bool] = True

    @abc.abstractmethod
    def level(self, x: Point) -> Float[Array, ""]:
        """A smooth function, negative inside, zero on the surface, positive outside; its scale is arbitrary.

        Its gradient does not vanish within about one size of the object around the surface.
        """

    def gradient(self, x: Point) -> Point:
        """Gradient of the level."""
        return jax.grad(self.level)(x)

    def hessian(self, x: Point) -> Float[Array, "3 3"]:
        """Second derivatives of the level."""
        return jax.jacfwd(self.gradient)(x)

    def normal(self, x: Point) -> Point:
        """Outward unit normal."""
        gradient = self.gradient(x)
        return gradient / _norm(gradient)

    def curvature(self, x: Point) -> Float[Array, "3 3"]:
        """Second derivatives of the level over the norm of its gradient, 1/length.

        t.H t is the normal curvature along a unit tangent t, positive where the object is convex.
        """
        return self.hessian(x) / _norm(self.gradient(x))

    def off(self, x: Point) -> Float[Array, ""]:
        """Distance from the surface to first order, a length, positive outside."""
        return self.level(x) / _norm(self.gradient(x))

    def plane_before(self, x: Point) -> tuple[Float[Array, ""], Point]:
        """A plane between a point and the object: its distance from the point, and its normal, towards the point.

        The distance is negative for points inside the convex hull of the object, which have no such plane. If the level
        is a convex function, its linear part at the point is positive where the object is not; objects with a level of
        another kind need a plane of their own.
        """
        gradient = self.gradient(x)
        size = _norm(gradient)
        return self.level(x) / size, gradient / size

    @property
    def has_planes(self) -> bool:
        """Whether such planes are known."""
        return True

    def ball_before(self, x: Point) -> tuple[Float[Array, ""], Point]:
        """A ball around a point that the object does not enter: its radius, and the direction away from the object.

        Near the surface, the radius is the distance from it, to first order; inside, it is negative. Above a plane
        between the point and the object, there is such a ball; objects that are not convex need one of their own.
        """
        return self.plane_before(x)

    @property
    def is_convex(self) -> bool:
        """Whether there is one object, and it is convex."""
        return True

    @property
    def objects(self) -> tuple["AbstractSurface", ...]:
        """The single objects."""
        return (self,)

    def object_of(self, x: Point) -> Int[Array, ""]:
        """Which object a point on the surface belongs to, from 0."""
        del x
        return jnp.asarray(0)

    def of_each(self, function: Callable[["AbstractSurface"], Any]) -> Any:
        """A function of every object, in their order along a leading axis."""
        return jax.tree.map(lambda leaf: leaf[None], function(self))

    @abc.abstractmethod
    def in_unit(self, length: Scalar) -> "AbstractSurface":
        """The same surface with lengths measured in `length`."""

    @abc.abstractmethod
    def interior_point(self) -> Point:
        """A point inside the object: its centre, or a point near the vertex or axis of an unbounded object.

        The centre of a ring is not inside it.
        """

    def absorbed(self, turn: Float[Array, "3 3"], before: Point, after: Point) -> "AbstractSurface | None":
        """A surface of the same class after a motion that takes a point to another one; None if there is none."""
        del turn, before, after
        return None

    def moved(self, by: Vector) -> "Placed":
        """The surface after a shift.

        Args:
            by: (x, y, z) of the shift, lengths.

        Raises:
            ValueError: if `by` is not three finite numbers.
        """
        return Placed(self, by=by)

    def rotated(self, rotation: Vector, about: Vector | None = None) -> "Placed":
        """The surface after a rotation.

        Args:
            rotation: rotation vector: the axis times the angle (rad, right-handed).
            about: (x, y, z) of a point on the axis, lengths; by default the object's `interior_point`: the centre of a
                sphere, ellipsoid or torus, and the given point of a cylinder.

        Raises:
            ValueError: if an argument is not three finite numbers.
        """
        return Placed(self, rotation=rotation, about=about)

    def steps_to_joint(self, x: Point, way: Point) -> Float[Array, ""]:
        """Number of steps this way from a point before the curvature begins to change abruptly; infinite if nowhere."""
        del x, way
        return jnp.asarray(jnp.inf)

    def thickness(self) -> Float[Array, ""]:
        """Roughly the least half thickness of the object, a length; infinite if unknown."""
        return jnp.asarray(jnp.inf)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domain that the constructor checks."""
        return checks.all_finite(self) & jnp.all(jnp.asarray(self._positive(), dtype=float) > 0)

    @abc.abstractmethod
    def _positive(self) -> list[Scalar]:
        """Values that must be positive."""

    @abc.abstractmethod
    def __str__(self) -> str: ...


class Placed(AbstractSurface):
    """A surface after a rotation and a shift; `AbstractSurface.rotated` and `moved` make it."""

    surface: AbstractSurface
    by: Triple = eqx.field(default=NOWHERE, converter=checks.as_tuple)
    rotation: Triple = eqx.field(default=NOWHERE, converter=checks.as_tuple)
    about: Triple | None = eqx.field(default=None, converter=checks.as_tuple)

    def __check_init__(self):
        checks.triple("by", self.by)
        checks.triple("rotation", self.rotation)
        if self.about is not None:
            checks.triple("about", self.about)

    def _place(self) -> tuple[Float[Array, "3 3"], Point, Point]:
        """The matrix of the rotation, and a point before and after the motion."""
        before = self.surface.interior_point() if self.about is None else as_point(self.about)
        return rotation_matrix(as_point(self.rotation)), before, before + as_point(self.by)

    def _before(self, x: Point) -> tuple[Float[Array, "3 3"], Point]:
        """The matrix of the rotation, and where a point of the object was before the motion."""
        turn, before, after = self._place()
        return turn, before + _times(turn.T, x - after)

    def level(self, x):
        return self.surface.level(self._before(x)[1])

    def gradient(self, x):
        turn, x = self._before(x)
        return _times(turn, self.surface.gradient(x))

    def hessian(self, x):
        turn, x = self._before(x)
        return _turned(turn, self.surface.hessian(x))

    @property
    def is_convex(self):
        return self.surface.is_convex

    @property
    def has_planes(self):
        return self.surface.has_planes

    def plane_before(self, x):
        turn, x = self._before(x)
        distance, normal = self.surface.plane_before(x)
        return distance, _times(turn, normal)

    def ball_before(self, x):
        turn, x = self._before(x)
        radius, away = self.surface.ball_before(x)
        return radius, _times(turn, away)

    def steps_to_joint(self, x, way):
        turn, x = self._before(x)
        return self.surface.steps_to_joint(x, _times(turn.T, way))

    def thickness(self):
        return self.surface.thickness()

    def in_unit(self, length):
        about = None if self.about is None else _over(self.about, length)
        placed = Placed(self.surface.in_unit(length), _over(self.by, length), self.rotation, about)
        absorbed = placed.surface.absorbed(*placed._place())
        return placed if absorbed is None else absorbed

    def interior_point(self):
        turn, before, after = self._place()
        return after + _times(turn, self.surface.interior_point() - before)

    def _positive(self):
        return self.surface._positive()

    def __str__(self):
        nowhere = triple_text(NOWHERE)
        words = {"turned by": triple_text(self.rotation), "moved by": triple_text(self.by)}
        return ", ".join([str(self.surface), *(f"{w} {text}" for w, text in words.items() if text != nowhere)])


class Quadric(AbstractSurface):
    """Quadric d.M d / 2 + w.d = depth, d = x - inside, with a symmetric matrix M that is positive semidefinite."""

    inside: Point  # a point inside
    matrix: Float[Array, "3 3"]  # M, 1/length
    slope: Point  # w
    depth: Float[Array, ""]  # a length, positive

    def level(self, x):
        d = x - self.inside
        return jnp.sum(d * (_times(self.matrix, d) / 2 + self.slope)) - self.depth

    def gradient(self, x):
        return _times(self.matrix, x - self.inside) + self.slope

    def hessian(self, x):
        del x
        return self.matrix

    def in_unit(self, length):
        return Quadric(self.inside / length, self.matrix * length, self.slope, self.depth / length)

    def absorbed(self, turn, before, after):
        inside = after + _times(turn, self.inside - before)
        return Quadric(inside, _turned(turn, self.matrix), _times(turn, self.slope), self.depth)

    def interior_point(self):
        return self.inside

    def thickness(self):
        return jnp.sqrt(2 * self.depth / jnp.sqrt(jnp.sum(self.matrix**2)))

    def _positive(self):
        return [self.depth]

    def __str__(self):
        return "quadric"


class AbstractDescribed(AbstractSurface):
    """A surface that is given by the numbers or the profile that describe it, and evaluated in another form."""

    @abc.abstractmethod
    def form(self) -> AbstractSurface:
        """The surface as it is evaluated."""

    def level(self, x):
        return self.form().level(x)

    def gradient(self, x):
        return self.form().gradient(x)

    def hessian(self, x):
        return self.form().hessian(x)

    def plane_before(self, x):
        return self.form().plane_before(x)

    def ball_before(self, x):
        return self.form().ball_before(x)

    def steps_to_joint(self, x, way):
        return self.form().steps_to_joint(x, way)

    def thickness(self):
        return self.form().thickness()

    def in_unit(self, length):
        return self.form().in_unit(length)

    def interior_point(self):
        return self.form().interior_point()


def as_point(triple: Triple) -> Point:
    """Three numbers as an array."""
    return jnp.stack([jnp.asarray(part, dtype=float) for part in triple])


def triple_text(triple: Triple) -> str:
    """Three numbers as text."""
    return f"({', '.join(map(as_text, triple))})"


def _over(triple: Triple, length: Scalar) -> Triple:
    x, y, z = triple
    return x / length, y / length, z / length


def _norm(vector: Point) -> Float[Array, ""]:
    return jnp.sqrt(jnp.sum(vector**2))


# A batch of small products is faster as sums.
def _times(matrix: Float[Array, "3 3"], vector: Point) -> Point:
    return jnp.sum(matrix * vector, axis=-1)


def _turned(turn: Float[Array, "3 3"], matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """turn @ matrix @ turn.T, of a symmetric matrix."""
    half = jnp.sum(turn[:, :, None] * matrix, axis=1)
    return jnp.sum(half[:, None, :] * turn, axis=-1)


def outermost(level: Callable) -> Float[Array, ""]:
    """Where a function, negative at 0, becomes positive, at most at `FARTHEST`; by Ridders' method."""
    middle = jnp.asarray(0.5)

    def at(place):  # from 0 to 1, so that distances of any size are within reach
        return level(place / (1 - place))

    here = at(middle)
    outside = here > 0
    low, high = jnp.where(outside, 0.0, middle), jnp.where(outside, middle, FARTHEST / (1 + FARTHEST))
    below, above = jnp.where(outside, at(jnp.zeros(())), here), jnp.where(outside, here, at(high))

    def improve(_, state):
        low, high, below, above = state
        middle = (low + high) / 2
        between = at(middle)
        root = jnp.sqrt(between**2 - below * above)
        new = jnp.clip(middle - (middle - low) * between / jnp.where(root > 0, root, 1.0), low, high)
        value = at(new)
        for place, own in ((middle, between), (new, value)):
            inner, inside = (place >= low) & (place <= high), own < 0
            low, below = jnp.where(inner & inside, place, low), jnp.where(inner & inside, own, below)
            high, above = jnp.where(inner & ~inside, place, high), jnp.where(inner & ~inside, own, above)
        return low, high, below, above

    low, high, below, above = jax.lax.fori_loop(0, RIDDERS_STEPS, improve, (low, high, below, above))
    place = jnp.where(-below < above, low, high)
    return place / (1 - place)
