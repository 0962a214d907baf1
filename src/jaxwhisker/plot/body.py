"""The objects of a scene in space as figures draw them: convex polyhedra with their vertices on the surfaces.

Vertices are where rays from inside meet the surface. An object that goes on beyond a box around the whiskers is cut off
there. A ring consists of slices. Lengths are in L of the first whisker.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.torus import Ring

RAYS, COARSE, AROUND = 2400, 400, 160  # all over the object, for its extent, and in the plane of a cut
SLICES, SIDES = 72, 32  # of a ring, and of each of its cross-sections
SPREADS = 4  # rounds in which its extent is found
PADDING = 800  # rays are padded to a multiple of this, because pictures then share a compiled program
BISECTIONS = 45
WHOLE = 2.5  # an object is whole if it ends within this distance of the whiskers ...
NEAR = 0.9  # ... and otherwise is cut off at this one
ON = 1e-6  # of a box: points this close to a face lie on it
SHARP = 0.98  # cosine of the angle between two faces below which a cut has an edge between them
PARALLEL = 1e-12  # sine of the angle between a face and a line of sight below which they are parallel
SUNK = 2e-3  # points this deep below the surface, which whiskers touch, are not hidden by it

Points = Float[np.ndarray, "_ 3"]  # rows x, y, z
Point = Float[np.ndarray, "3"]


class Body(NamedTuple):
    """Convex polyhedra: one for every object, or one for every slice of a ring."""

    points: Points
    faces: Int[np.ndarray, "faces 3"]  # indices of points; where slices adjoin, a face has no area
    normals: Float[np.ndarray, "faces 3"]  # outward, of the flat faces
    offsets: Float[np.ndarray, " faces"]  # x.normal + offset is positive outside the polyhedron without a thin layer
    smooth: Float[np.ndarray, "faces 3"]  # outward normals of the surface itself
    cut: Bool[np.ndarray, " faces"]  # where the object goes on
    edges: Int[np.ndarray, "edges 2"]  # indices of points
    beside: Int[np.ndarray, "edges 2"]  # indices of the faces on both sides of an edge
    sharp: Bool[np.ndarray, " edges"]  # edges of cuts
    part: Int[np.ndarray, " faces"]  # number of the polyhedron, from 0

    @property
    def parts(self) -> range:
        """The numbers of the polyhedra."""
        return range(int(self.part[-1]) + 1)

    def hides(self, points: Points, towards: Point) -> Bool[np.ndarray, " points"]:
        """Whether an object lies between points and a distant eye in the direction `towards`."""
        return np.any([self._part_hides(part, points, towards) for part in self.parts], axis=0)

    def _part_hides(self, part: int, points: Points, towards: Point) -> Bool[np.ndarray, " points"]:
        own = self.part == part
        normals, offsets = self.normals[own], self.offsets[own]
        rate = normals @ towards
        front, back, beside = rate > PARALLEL, rate < -PARALLEL, np.abs(rate) <= PARALLEL

        def meets(faces: np.ndarray) -> np.ndarray:  # distance of each face along the line of sight
            return -(points @ (normals[faces] / rate[faces, None]).T + offsets[faces] / rate[faces])

        passes = (points @ normals[beside].T + offsets[beside] > 0).any(axis=1)
        return ~passes & (np.maximum(meets(back).max(axis=1), 0.0) < meets(front).min(axis=1))

    def scaled(self, factor: float) -> "Body":
        """The body in another unit of length."""
        return self._replace(points=factor * self.points, offsets=factor * self.offsets)

    def outline(self, towards: Point) -> Int[np.ndarray, "edges 2"]:
        """Edges of the silhouettes for a distant eye, and those of cuts that it sees."""
        return self.edges[self.shown(towards)]

    def shown(self, towards: Point) -> Int[np.ndarray, " shown"]:
        """The numbers of these edges."""
        seen = (self.normals @ towards > 0)[self.beside]
        shown = np.flatnonzero((seen[:, 0] != seen[:, 1]) | (self.sharp & seen.any(axis=1)))
        if len(self.parts) == 1:
            return shown
        middles, own = self.points[self.edges[shown]].mean(axis=1), self.part[self.beside[shown, 0]]
        hidden = [(own != part) & self._part_hides(part, middles, towards) for part in self.parts]
        return shown[~np.any(hidden, axis=0)]


def body_of(surface: AbstractSurface, low: Point, high: Point) -> Body | None:
    """The parts of all objects near a box that holds the whiskers; None if all are too far away.

    Args:
        surface: the object.
        low: least x, y and z of the box.
        high: largest x, y and z.

    Raises:
        ValueError: if an object is neither convex nor a ring.
    """
    for one in surface.objects:
        if not (one.is_convex or isinstance(one, Ring)):
            checks.fail("scene", "one with convex objects and rings, to be drawn", f"one with a {one}")
    each = (_ring(one, low, high) if isinstance(one, Ring) else _near(one, low, high) for one in surface.objects)
    return _joined([near for near in each if near is not None])


def _joined(each: list[Body]) -> Body | None:
    """Polyhedra as one body; None without any."""
    if len(each) < 2:
        return each[0] if each else None
    shifted, points, faces, parts = [], 0, 0, 0
    for body in each:
        own = {"faces": body.faces + points, "edges": body.edges + points, "beside": body.beside + faces}
        shifted.append(body._replace(**own, part=body.part + parts))
        points, faces, parts = points + len(body.points), faces + len(body.faces), parts + len(body.parts)
    return Body(*(np.concatenate(leaves) for leaves in zip(*shifted, strict=True)))


def _near(surface: AbstractSurface, low: Point, high: Point) -> Body | None:
    """The part of an object near a box; None if it is too far away."""
    box = np.stack([low - WHOLE, high + WHOLE])
    points = _spread(surface, box)
    if points is None:
        return None
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    goes_on = np.abs(extent - box) < ON * np.ptp(box, axis=0)
    box = np.where(goes_on, np.stack([low - NEAR, high + NEAR]), box)
    points = _spread(surface, box)
    return None if points is None else _polyhedron(surface, box, points)


def _ring(ring: Ring, low: Point, high: Point) -> Body | None:
    """The slices of a ring near a box, each from one cross-section to the next; None if it is too far away."""
    middle, axis, radius, tube = (np.asarray(part) for part in (ring.middle, ring.axis, ring.radius, ring.tube))
    out = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    out /= np.linalg.norm(out)
    turn, angle = (2 * np.pi * np.arange(count)[:, None] / count for count in (SLICES, SIDES))
    radial = np.cos(turn) * out + np.sin(turn) * np.cross(axis, out)
    centres = middle + radius * radial
    if not np.any(np.all((centres > low - WHOLE) & (centres < high + WHOLE), axis=1)):
        return None
    ways = (np.cos(angle) * radial[:, None] + np.sin(angle) * axis).reshape(-1, 3)
    points = np.repeat(centres, SIDES, axis=0) + tube * ways
    # Corner a of a quadrilateral; b is beside it, d is on the next cross-section, and c is beside d.
    a = np.arange(SLICES * SIDES)
    b = a - a % SIDES + (a + 1) % SIDES
    c, d = (b + SIDES) % a.size, (a + SIDES) % a.size
    outward = np.cross(points[c] - points[a], points[b] - points[d])
    outward *= np.sign(np.sum(outward * ways, axis=1, keepdims=True)) / np.linalg.norm(outward, axis=1)[:, None]
    along = np.cross(axis, radial)
    own, first = np.arange(SLICES), SIDES * np.arange(SLICES)
    ends = np.stack([first, np.roll(first, -1)])[..., None].repeat(3, axis=-1).reshape(-1, 3)
    normals = np.concatenate([outward, outward, -along, np.roll(along, -1, axis=0)])
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), ends])
    lean = ways[a] + ways[b] + ways[c] + ways[d]
    lean /= np.linalg.norm(lean, axis=1, keepdims=True)
    none, flat = np.zeros(len(faces), bool), np.arange(len(faces)) >= 2 * a.size
    return Body(
        points=points,
        faces=faces,
        normals=normals,
        offsets=np.where(flat, 0.0, SUNK) - np.sum(normals * points[faces[:, 0]], axis=1),
        smooth=np.concatenate([lean, lean, normals[flat]]),
        cut=none,
        edges=np.concatenate([np.stack([a, d], axis=1), np.stack([a, b], axis=1)]),
        beside=np.concatenate(
            [
                np.stack([a, a - a % SIDES + (a - 1) % SIDES], axis=1),
                np.stack([a, (a - SIDES) % a.size], axis=1),
            ]
        ),
        sharp=np.zeros(2 * a.size, bool),
        part=np.concatenate([np.repeat(own, SIDES), np.repeat(own, SIDES), own, own]),
    )


def _spread(surface: AbstractSurface, box: Float[np.ndarray, "2 3"]) -> Points | None:
    """Some points all over the part of an object in a box."""
    centre, size = _inside(surface, box), np.ptp(box, axis=0)
    if centre is None:
        return None
    points = centre[None]
    for _ in range(SPREADS):  # each time from the middle of the points, and as far in each direction as they are
        points = _crossings(surface, centre, _exits(centre, _directions(COARSE) * size, box))
        centre, size = points.mean(axis=0), np.ptp(points, axis=0)
    return points


def _inside(surface: AbstractSurface, box: Float[np.ndarray, "2 3"]) -> Point | None:
    """A point of the object in a box."""
    from scipy.optimize import minimize

    middle = box.mean(axis=0)
    low, high = middle + 0.95 * (box - middle)
    near = np.clip(np.asarray(surface.interior_point()), low, high)
    if not _level(surface, near)[0] < 0:
        bounds = list(zip(low, high, strict=True))
        near = minimize(lambda x: tuple(map(np.asarray, _level(surface, x))), near, jac=True, bounds=bounds).x
    return near if _level(surface, near)[0] < 0 else None


@Program
def _level(surface: AbstractSurface, x: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    return surface.level(x), surface.gradient(x)


def _directions(count: int) -> Points:
    """Directions that are spread evenly over a sphere, on a spiral."""
    index = np.arange(count) + 0.5
    height, turn = 1 - 2 * index / count, np.pi * (1 + np.sqrt(5.0)) * index
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), height, across * np.sin(turn)], axis=1)


def _exits(start: Point, directions: Points, box: Float[np.ndarray, "2 3"]) -> Points:
    """Where rays from a point in a box leave it."""
    ahead = np.where(directions > 0, box[1], box[0]) - start
    parallel = directions == 0
    length = np.where(parallel, np.inf, ahead / np.where(parallel, 1.0, directions)).min(axis=1)
    return start + length[:, None] * directions


def _crossings(surface: AbstractSurface, inside: Point, ends: Points) -> Points:
    """Where lines from a point inside meet the surface; their ends, if these are inside, too."""
    padded = np.pad(ends, [(0, -len(ends) % PADDING), (0, 0)], mode="edge")
    return np.asarray(_meet(surface, inside, padded))[: len(ends)]


@Program
def _meet(surface: AbstractSurface, inside: Float[Array, "3"], ends: Float[Array, "rays 3"]) -> Float[Array, "rays 3"]:
    level = jax.vmap(surface.level)

    def halve(_, shares):
        low, high = shares
        middle = (low + high) / 2
        within = level(inside + middle[:, None] * (ends - inside)) < 0  # outside its domain, a level is NaN
        return jnp.where(within, middle, low), jnp.where(within, high, middle)

    none = jnp.zeros(ends.shape[0])
    low, _ = jax.lax.fori_loop(0, BISECTIONS, halve, (none, none + 1))
    return inside + jnp.where(level(ends) < 0, 1.0, low)[:, None] * (ends - inside)


@Program
def _normals(surface: AbstractSurface, points: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
    return jax.vmap(surface.normal)(points)


def _polyhedron(surface: AbstractSurface, box: Float[np.ndarray, "2 3"], spread: Points) -> Body:
    from scipy.spatial import ConvexHull

    centre = spread.mean(axis=0)
    points = [_crossings(surface, centre, _exits(centre, _directions(RAYS) * np.ptp(spread, axis=0), box))]
    on = ON * np.ptp(box, axis=0)
    for plane in box:
        for axis in range(3):
            there = points[0][np.abs(points[0][:, axis] - plane[axis]) < on[axis]]
            if len(there):
                points.append(_around(surface, there.mean(axis=0), axis, box))
    points += _on_edges(surface, box)
    cloud = np.concatenate(points)
    hull = ConvexHull(cloud)
    corners = cloud[hull.simplices]
    flat = [np.abs(corners - plane).max(axis=1) < on for plane in box]
    cut = np.any(flat, axis=(0, 2))
    middles = corners.mean(axis=1)
    room = -len(middles) % PADDING
    smooth = np.asarray(_normals(surface, np.pad(middles, [(0, room), (0, 0)], mode="edge")))[: len(middles)]
    normals = hull.equations[:, :3]
    smooth = np.where(cut[:, None] | ~np.isfinite(smooth), normals, smooth)
    # Neighbour k of a face is opposite to its vertex k.
    face, opposite = np.nonzero(hull.neighbors > np.arange(len(corners))[:, None])
    edges = np.stack([hull.simplices[face, (opposite + 1) % 3], hull.simplices[face, (opposite + 2) % 3]], axis=1)
    beside = np.stack([face, hull.neighbors[face, opposite]], axis=1)
    sharp = cut[beside].any(axis=1) & (np.sum(normals[beside[:, 0]] * normals[beside[:, 1]], axis=1) < SHARP)
    offsets, part = hull.equations[:, 3] + SUNK, np.zeros(len(corners), dtype=int)
    return Body(cloud, hull.simplices, normals, offsets, smooth, cut, edges, beside, sharp, part)


def _around(surface: AbstractSurface, middle: Point, axis: int, box: Float[np.ndarray, "2 3"]) -> Points:
    """Points around the part of the object in a plane normal to an axis, from a point in it."""
    turn = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    directions = np.zeros((AROUND, 3))
    directions[:, (axis + 1) % 3], directions[:, (axis + 2) % 3] = np.cos(turn), np.sin(turn)
    return _crossings(surface, middle, _exits(middle, directions * np.ptp(box, axis=0), box))


def _on_edges(surface: AbstractSurface, box: Float[np.ndarray, "2 3"]) -> list[Points]:
    """Ends of the parts of the edges of a box that are inside the object."""
    ends = []
    for axis in range(3):
        for corner in (k for k in range(8) if not k >> axis & 1):
            first = box[[corner >> one & 1 for one in range(3)], range(3)]
            last = np.where(np.arange(3) == axis, box[1], first)
            along = first + np.linspace(0.0, 1.0, AROUND)[:, None] * (last - first)
            inside = along[np.asarray(_levels(surface, along)) < 0]
            if len(inside):
                ends.append(_crossings(surface, inside.mean(axis=0), np.stack([first, last])))
    return ends


@Program
def _levels(surface: AbstractSurface, points: Float[Array, "points 3"]) -> Float[Array, " points"]:
    return jax.vmap(surface.level)(points)
