"""Polygons: objects with straight faces and corners, at which whiskers touch edges."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, text_unless
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.polygon_chain import Corners, Count, PolygonChain, chain, is_convex, is_simple, positive
from jaxwhisker._model.profile import AbstractProfile


class _AbstractPolygon(AbstractProfile):
    """A polygon by its corners, with the geometry of its chain."""

    # Subclasses declare their fields, because the order of the fields is that of their arguments.

    @property
    def has_edges(self):
        return True

    @abc.abstractmethod
    def corners(self) -> Corners:
        """Corners of the polygon, counter-clockwise."""

    @property
    def has_corners(self):
        return True

    def chain(self) -> PolygonChain:
        """The polygon as a chain of corners and faces."""
        corners = self.corners()
        return chain(corners, np.asarray(corners.shape[0]), concave=self.is_concave)

    def point(self, parameter):
        return self.chain().point(parameter)

    def point_on(self, piece, parameter):
        return self.chain().point_on(piece, parameter)

    def breaks(self):
        return self.chain().breaks()

    def ends(self):
        return self.chain().ends()

    def faces(self):
        return self.chain().faces()

    def at_slope(self, slope):
        return self.chain().at_slope(slope)

    def first_touch(self, height, side):
        return self.chain().first_touch(height, side)

    def above_widest(self, height, side):
        return self.chain().above_widest(height, side)

    def vertex(self):
        return self.chain().vertex()

    def in_unit(self, length):
        return _filled(self.corners(), concave=self.is_concave).in_unit(length)

    def _positive(self):
        return positive(self.corners(), concave=self.is_concave)


class Polygon(_AbstractPolygon):
    """Polygon with straight faces and sharp corners; inner corners need a scene with several contacts.

    Its parameter is the sum of the lengths of faces and of the angles by which the outline turns at corners (rad),
    starting from the top.

    Args:
        vertices: corners (x, y), shape (corners, 2), lengths: counter-clockwise, which is from left to right along the
            lower side; at least two. Two corners make a thin plate. The side that faces up most, back from the last
            corner of the lower side to the first, is the top, which whiskers cannot touch.
        concave: whether the polygon has inner corners. Default: as the corners tell; convex if they are traced.

    Raises:
        ValueError: if `vertices` is not such an array of finite numbers, the corners are not those of a polygon in this
            order that does not cross itself, or three of them are in line.

    Examples:
        >>> wedge = jw.Polygon([(-0.4, 0.6), (0.1, 0.2), (0.5, 0.6)])
        >>> print(wedge)
        polygon of 3 corners
        >>> x, y = wedge.vertex()
        >>> print(f"x = {x:.1f}, y = {y:.1f}")
        x = 0.1, y = 0.2
    """

    vertices: Corners = eqx.field(converter=lambda values: _as_rows(values))
    concave: bool = eqx.field(static=True, default=False, kw_only=True)

    def __init__(self, vertices: Any, *, concave: bool | None = None):
        self.vertices = _as_rows(vertices)
        checks.rows("vertices", self.vertices, columns=2, least=2)
        self.concave = bool(concave)
        if checks.is_traced(self.vertices):
            return
        corners = np.asarray(self.vertices)
        convex = bool(_is_convex_now(corners))
        if concave is not None and concave == convex:
            checks.fail("concave", f"{not convex} for these corners", repr(concave))
        self.concave = not convex
        if self.concave and not is_simple(corners):
            allowed = "the corners of a polygon that does not cross itself, counter-clockwise, no three of them in line"
            checks.fail("vertices", allowed, corners.tolist())

    @property
    def is_concave(self):
        return self.concave

    def corners(self):
        return self.vertices

    def canonical(self):
        if checks.is_traced(self.vertices):
            return _filled(self.vertices, concave=self.concave)
        filled = _filled(np.asarray(self.vertices), concave=self.concave)  # compiles nothing
        return eqx.tree_at(lambda own: own.vertices, filled, jax.device_put(filled.vertices))

    def __str__(self):
        return f"polygon of {len(self.vertices)} corners"


class _Filled(_AbstractPolygon):
    """A polygon whose last corner may be repeated, so that polygons of different numbers of corners share programs."""

    vertices: Corners | Float[np.ndarray, "corners 2"]
    count: Count
    concave: bool = eqx.field(static=True, default=False, kw_only=True)

    @property
    def is_concave(self):
        return self.concave

    def corners(self):
        return jnp.asarray(self.vertices)

    def chain(self):
        return chain(self.corners(), self.count, concave=self.concave)

    def in_unit(self, length):
        return chain(self.corners() / length, self.count, concave=self.concave)

    def _positive(self):
        return positive(self.corners(), self.count, concave=self.concave)

    def __str__(self):
        return f"polygon of {self.count} corners"


class Box(_AbstractPolygon):
    """Box with a horizontal bottom, vertical flanks and sharp corners.

    An upright whisker touches it at a lower corner, if it reaches that high.

    Args:
        distance: q, height of the bottom above the bases, a length; positive.
        width: along x, a length; positive.
        height: from the bottom to the top, a length; positive.
        position: x of the centre, a length.

    Raises:
        ValueError: if a value is not a finite number, or not positive where it must be.

    Examples:
        >>> print(jw.Box(distance=0.3, width=0.8, height=0.5))
        box q = 0.3, width 0.8, height 0.5
    """

    distance: Scalar
    width: Scalar
    height: Scalar
    position: Scalar = 0.0

    def __check_init__(self):
        for name in self.__dataclass_fields__:
            checks.number(name, getattr(self, name), positive=name != "position")

    def corners(self):
        left, right = self.position - self.width / 2, self.position + self.width / 2
        low, high = self.distance, self.distance + self.height
        values = left, high, left, low, right, low, right, high
        return jnp.reshape(jnp.stack([jnp.asarray(value, dtype=float) for value in values]), (4, 2))

    def _positive(self):
        return [self.distance, self.width, self.height]

    def __str__(self):
        size = f"width {as_text(self.width)}, height {as_text(self.height)}"
        return f"box q = {as_text(self.distance)}, {size}{text_unless(0.0, ', x = ', self.position)}"


def _filled(corners: Any, *, concave: bool) -> _Filled:
    """A polygon of 8, 16, 32, ... corners, of which the last one is repeated."""
    count = corners.shape[0]
    last = np.minimum(np.arange(max(8, 1 << (count - 1).bit_length())), count - 1)
    return _Filled(corners[last], np.asarray(count), concave=concave)


_is_convex_now = Program(is_convex)


def _as_rows(values):
    try:
        return jnp.asarray(checks.unmasked(values), dtype=float)
    except (TypeError, ValueError):
        return values  # the constructor rejects it
