"""First touch: where an unloaded whisker that approaches from one side meets the object."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.pieces import ends_of, first_corner
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.profile import AbstractProfile, ContactPoint, FirstTouch, bisect
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section

SHAFT_FIRST = 1e-12  # a first contact is tangential if more than this share of the length lies above it
# A whisker that reaches beyond the lowest point of the object by less than this share of its length passes below it.
# There, rounding decides where it touches, and it would do so on a way of 1e-5 of its length.
GRAZE = 5e-11
POINTS = 65  # along a whisker that is not upright and straight, at which the first touch is searched for
SAME_HEIGHT = 1e-6  # dimensionless tolerance for whisker and object at the same height, and for equal distances
HALVINGS = 20  # of two cells around the point of the whisker that touches first: to within 1e-8 of the length
NEWTON_STEPS = 8
SAME_PLACE = 1e-9  # dimensionless: points of a whisker this close to the first touch touch at the same time


class TouchAlongX(NamedTuple):
    """A contact that is about to begin if the base moves along x.

    Fields are (whiskers,) for several whiskers, and (objects, whiskers) with several objects.
    """

    parameter: Float[Array, "*batch"]  # of the profile
    x: Float[Array, "*batch"]  # position of the base
    slack: Float[Array, "*batch"]  # as in contact.py
    side: Float[Array, "*batch"]  # the side it approaches from or, if it leans past vertical, will bend to
    reaches: Bool[Array, "*batch"]  # whether it is high enough to meet the object; if not, x only tells the nearer side
    piece: Int[Array, "*batch"] | None = None  # of the profile; None without edges


Touches = tuple[TouchAlongX, TouchAlongX]  # from the right and from the left


def of_objects(profile: AbstractProfile, touches: Callable[[AbstractProfile], Touches]) -> Touches:
    """First touches of all whiskers with an object or, if there are several, with each; (objects, whiskers)."""
    if not isinstance(profile, Objects):
        return touches(profile)
    each = []
    for one, first in zip(profile.objects, profile.first_pieces(), strict=True):
        own = touches(one)
        pieces = (jnp.zeros_like(touch.parameter, int) if touch.piece is None else touch.piece for touch in own)
        each.append(tuple(touch._replace(piece=first + piece) for touch, piece in zip(own, pieces, strict=True)))
    right, left = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    return right, left


class Outline(NamedTuple):
    """Equidistant points and directions of an unloaded, upright whisker with its base at the origin."""

    x: Float[Array, "*batch points"]
    y: Float[Array, "*batch points"]
    cos: Float[Array, "*batch points"]
    sin: Float[Array, "*batch points"]


def outline(length: Scalar, section: Section | None) -> Outline:
    """The outline of a whisker; a whisker without a section is straight."""
    zero = jnp.zeros_like(length)
    upright, nothing = (zero, zero, zero, zero + 1.0), rod.Load(None, zero, None)
    if section is None:
        line = length * jnp.linspace(0.0, 1.0, POINTS)
        return Outline(0.0 * line, line, 0.0 * line, jnp.ones_like(line))
    return Outline(*rod.points(upright, -length, nothing, section, count=POINTS, from_base=zero))


def _angle(cos: Scalar, sin: Scalar, at: ContactPoint, side: Scalar) -> Scalar:
    """Angle between a whisker of this direction and the object, seen from the side to which it bends."""
    return jnp.arctan2(sin * at.cos - cos * at.sin, side * (cos * at.cos + sin * at.sin))


def first_touch_upright(profile: AbstractProfile, length: Scalar, side: Scalar) -> TouchAlongX:
    """The first touch of a straight whisker that stands upright at height 0."""
    touch = profile.first_touch(length, side)
    at = profile.point(touch.parameter)
    beyond = length - touch.y
    # An upright whisker never points below the tangent of an object that ends in a wall.
    angle = jnp.arctan2(jnp.abs(at.cos), side * at.sin)
    slack = jnp.where(beyond > SHAFT_FIRST * length, beyond, -angle)
    reaches = jnp.asarray((1 - GRAZE) * length > profile.vertex()[1])
    return TouchAlongX(touch.parameter, touch.x, slack, jnp.asarray(side, dtype=float), reaches, touch.piece)


class _Approach(NamedTuple):
    """Points of a whisker with its base at x = 0, and where each would touch in an approach along x."""

    x: Float[Array, " points"]
    y: Float[Array, " points"]
    cos: Float[Array, " points"]
    sin: Float[Array, " points"]
    touch: FirstTouch
    ahead: Float[Array, " points"]  # side times position of the base at the touch; -inf for points that are too low


def _approach(profile: AbstractProfile, own: Outline, y: Scalar, angle: Scalar, side: Scalar) -> _Approach:
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = own.x * cos - own.y * sin, y + own.x * sin + own.y * cos
    touch = jax.vmap(lambda height: profile.above_widest(height, side))(y)
    meets = (y > profile.vertex()[1]) & (jnp.abs(touch.y - y) < SAME_HEIGHT)
    ahead = jnp.where(meets, side * (touch.x - x), -jnp.inf)
    return _Approach(x, y, own.cos * cos - own.sin * sin, own.sin * cos + own.cos * sin, touch, ahead)


def in_two_places(profile: AbstractProfile, own: Outline, y: Scalar, angle: Scalar) -> Bool[Array, ""]:
    """Whether a whisker that approaches along x would touch in more than one place, from either side."""

    def dips(side):
        ahead = _approach(profile, own, y, angle, side).ahead
        before, after = jax.lax.cummax(ahead), jax.lax.cummax(ahead, reverse=True)
        return jnp.any(jnp.isfinite(ahead) & (jnp.minimum(before, after) - ahead > SAME_HEIGHT))

    return dips(1.0) | dips(-1.0)


def first_touch(
    profile: AbstractProfile, length: Scalar, own: Outline, y: Scalar, angle: Scalar, side: Scalar
) -> TouchAlongX:
    """The first touch, with its tip or along its shaft, of a whisker with its base at height y and turned by an angle.

    It is searched for at points of the whisker and then solved for between them, where the outline is interpolated as a
    cubic in arc length. The result is accurate to about 1e-10 and has no derivatives: it is a guess for the equations
    of the contact.
    """
    profile, length, own, y, angle = jax.lax.stop_gradient((profile, length, own, y, angle))
    xs, ys, coses, sines, touch, ahead = _approach(profile, own, y, angle, side)
    k, reaches = jnp.argmax(ahead), jnp.any(jnp.isfinite(ahead))
    at = profile.point(touch.parameter[k])
    # The whisker bends away from the direction in which its base moves across it.
    across = side * (at.sin * jnp.cos(angle) - at.cos * jnp.sin(angle))
    bends_to = jnp.where(across < 0, -side, side)
    tip_angle = _angle(coses[k], sines[k], at, bends_to)
    tip = (k == POINTS - 1) & (tip_angle > 0)

    table = jnp.stack([xs, ys, coses * length / (POINTS - 1), sines * length / (POINTS - 1)])

    def whisker(cell):
        """Position and direction, a number of cells from the base."""
        first = jnp.clip(jnp.floor(jax.lax.stop_gradient(cell)).astype(int), 0, POINTS - 2)
        here, there = table[:, first], table[:, first + 1]
        cubic = Cubic(here[:2], there[:2], here[2:], there[2:])
        return cubic.value(cell - first), cubic.rate(cell - first)

    def residual(unknowns, piece):
        at = profile.point_on(piece, unknowns[0])
        (_, height), (cos, sin) = whisker(unknowns[1])
        return jnp.stack([height - at.y, (cos * at.sin - sin * at.cos) * (POINTS - 1) / length])

    def newton(piece, unknowns):
        (a, b), (c, d) = jax.jacfwd(residual)(unknowns, piece)
        e, f = residual(unknowns, piece)
        step = jnp.stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)
        return unknowns - jnp.where(jnp.isfinite(step), step, 0.0)

    def touched(cell):
        """The object's point at the height of a point of the whisker, and whether it lies before the first touch."""
        (_, height), (cos, sin) = whisker(cell)
        there = profile.above_widest(height, side)
        at = profile.point(there.parameter)
        meets = (height > profile.vertex()[1]) & (jnp.abs(there.y - height) < SAME_HEIGHT)
        return there, jnp.where(meets, sin * at.cos > cos * at.sin, cell < k)

    # From the point alone, Newton's method may go astray: the object may be curved as strongly as the whisker. But only
    # from there it finds a touch higher than where the object is widest.
    low, high = jnp.maximum(k - 1.0, 0.0), jnp.minimum(k + 1.0, POINTS - 1.0)
    cell = bisect(lambda cell: touched(cell)[1], low, high, steps=HALVINGS)
    point = jnp.stack([touch.parameter[k], k * 1.0])
    starts = jnp.stack([jnp.stack([touched(cell)[0].parameter, cell]), point.at[1].min(POINTS - 1.5)])
    pieces = corner = None
    if touch.piece is not None:
        corner = first_corner(profile, whisker, ys, side)
        starts = jnp.concatenate([starts, jnp.stack([corner.parameter, corner.cell])[None]])
        before = touched(cell)[0].piece
        assert before is not None
        pieces = jnp.stack([before, touch.piece[k], corner.piece])

    def solved(start, piece):
        unknowns = jax.lax.fori_loop(0, NEWTON_STEPS, lambda _, at: newton(piece, at), start)
        reached = side * (profile.point(unknowns[0]).x - whisker(unknowns[1])[0][0])
        inside = (unknowns[1] >= 0) & (unknowns[1] <= POINTS - 1)
        # No other point touches before the first one.
        found = jnp.all(jnp.abs(residual(unknowns, piece)) < SAME_HEIGHT) & inside & (reached > ahead[k] - SAME_HEIGHT)
        if piece is not None:
            start, end = ends_of(profile, piece)
            found &= (unknowns[0] > start - SAME_HEIGHT) & (unknowns[0] < end + SAME_HEIGHT)
        return unknowns, found

    each, found = jax.vmap(solved)(starts, pieces)
    parameter, cell = jnp.where(found[0], each[0], jnp.where(found[1], each[1], point))
    piece = None
    if corner is not None and pieces is not None:
        # A straight shaft that lies flat on a face first touches the corner where the face begins.
        at_corner = jnp.isfinite(corner.ahead) & (corner.ahead > ahead[k] - SAME_PLACE)
        parameter, cell = jnp.where(at_corner, each[2], jnp.stack([parameter, cell]))
        piece = jnp.where(at_corner, pieces[2], jnp.where(~tip & found[0], pieces[0], pieces[1]))
        tip, reaches = tip & ~at_corner, reaches | at_corner
    at = profile.point(parameter)
    (shaft_x, _), (cos, sin) = whisker(cell)
    along = jnp.where(cos * at.cos + sin * at.sin < 0, -1.0, 1.0)
    return jax.lax.stop_gradient(
        TouchAlongX(
            jnp.where(tip, touch.parameter[k], parameter),
            jnp.where(reaches, jnp.where(tip, touch.x[k] - xs[k], at.x - shaft_x), profile.vertex()[0] - xs[-1]),
            jnp.where(tip, -tip_angle, length * (1 - cell / (POINTS - 1))),
            jnp.where(tip, bends_to, along),
            reaches,
            piece,
        )
    )


def first_touches(
    profile: AbstractProfile, length: Scalar, own: Outline, y: Scalar, angle: Scalar
) -> tuple[TouchAlongX, TouchAlongX]:
    """First touches of a whisker approaching from the right and from the left."""
    both = jax.vmap(lambda side: first_touch(profile, length, own, y, angle, side))(jnp.array([1.0, -1.0]))
    return jax.tree.map(lambda leaf: leaf[0], both), jax.tree.map(lambda leaf: leaf[1], both)
