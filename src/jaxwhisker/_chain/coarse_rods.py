"""Coarse rods: chains of links along which directions are linear between their middles, and how they touch objects.

Objects push back points of all links in proportion to their depth, and corners the links themselves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.gaps import nearest, outline_of
from jaxwhisker._chain.polygons import at_corner, faces_of, nearest_face, of_corners
from jaxwhisker._chain.problem import BasePoses, ChainProblem
from jaxwhisker._equilibrium.contact import WhiskerAtObject, material_of
from jaxwhisker._model.objects import of_each_object
from jaxwhisker._model.polygon_chain import PolygonChain
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._rod.rod import Section

LINKS = 60
SHARES = 4  # of each link, at whose ends objects push
POINTS = LINKS * SHARES
STIFFNESS = 2e4  # EI/L^3, of an object along a link
DEEPEST = 0.1  # lengths: a corner this far beyond a rod is on another side of the object
BESIDE = 1.5  # shares of a link from a corner that pushes, within which the sides next to it do not


def _between() -> np.ndarray:
    """Angles at the middles of all shares by those of links, between whose middles they are linear.

    With straight links, a contact would have to jump from kink to kink.
    """
    at = (np.arange(POINTS) + 0.5) / SHARES - 0.5
    left, rows = np.clip(np.floor(at).astype(int), 0, LINKS - 2), np.arange(POINTS)
    weights = np.zeros((POINTS, LINKS))
    weights[rows, left], weights[rows, left + 1] = 1 - (at - left), at - left
    return weights


BETWEEN = _between()


class Links(NamedTuple):
    """What does not change in the flow, of each whisker."""

    link: Scalar  # length of a link
    joint: Float[Array, " links"]  # stiffness of the springs between links; the first one is that at the base
    bend: Float[Array, " links"]  # angle of each joint without a moment
    origin: Float[Array, "2"]  # of the base's frame
    axes: Float[Array, "2 2"]  # columns: its x and y axes
    upright: Scalar  # angle of the unloaded base to the x axis


def links_of(body: WhiskerAtObject) -> Links:
    link = body.length / LINKS
    at = link * jnp.asarray(np.append(0.25, np.arange(1, LINKS)))
    part = jnp.asarray(np.append(0.5, np.ones(LINKS - 1))) * link
    material = material_of(body)
    if isinstance(material, Section):
        stiffness = jax.vmap(material.stiffness)(at)
        curvature = jax.vmap(lambda s: jnp.asarray(material.curvature(s), dtype=float))(at)
    else:
        stiffness, curvature = jnp.broadcast_to(jnp.asarray(material), at.shape), jnp.zeros_like(at)
    frame = body.frame
    assert frame is not None
    axes = jnp.stack([jnp.stack([frame.cos, frame.sin]), jnp.stack([-frame.sin, frame.cos])], axis=1)
    upright = jnp.arctan2(frame.sin, frame.cos) + np.pi / 2
    return Links(link, stiffness / part, curvature * part, jnp.stack([frame.x, frame.y]), axes, upright)


class TouchingLinks(NamedTuple):
    """How rods touch objects: with the ends of the shares of links, and anywhere at corners; fields (elements,)."""

    depth: Float[Array, " elements"]
    piece: Int[Array, " elements"]
    parameter: Float[Array, " elements"]
    normal: Float[Array, "elements 2"]
    curvature: Float[Array, " elements"]  # of the object; positive if it is convex
    arc: Float[Array, " elements"]  # from the base, in shares
    stiffness: Float[Array, " elements"]


def touching(
    problem: ChainProblem, own: Links, length: Scalar, angle: Array, ends: Array
) -> tuple[TouchingLinks, Float[Array, " points"]]:
    """How a rod touches all objects, and the distances of the ends of its shares from the nearest one."""

    def of_one(one, first):
        if not isinstance(one, PolygonChain):
            return _at_curve(one, first, own, length, ends)
        (faces, apart), corners = _at_faces(one, first, ends), _at_corners(one, first, own, angle, ends)
        # Points that pass a corner would otherwise catch on it.
        beside = jnp.abs(faces.arc[:, None] - corners.arc) < BESIDE
        caught = jnp.any(beside & (corners.depth > 0), axis=1)
        both = faces._replace(depth=jnp.where(caught, -1.0, faces.depth)), corners
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *both), apart

    touch, apart = zip(*of_each_object(problem.profile, of_one), strict=True)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *touch), jnp.min(jnp.stack(apart), axis=0)


def _at_curve(one: AbstractProfile, first: Int[Array, ""], own: Links, length: Scalar, ends: Array):
    outline = outline_of(one, own.origin[0], own.origin[1], 1.5 * length)

    def at_end(x, y):
        p = nearest(one, outline, x, y)
        at, rate = jax.jvp(one.point, (p,), (jnp.ones_like(p),))
        curvature = (rate.sin * at.cos - rate.cos * at.sin) / (rate.x * at.cos + rate.y * at.sin)
        return -at.off(x, y), p, at.normal, curvature, jnp.hypot(x - at.x, y - at.y)

    depth, parameter, normal, curvature, apart = jax.vmap(at_end)(*ends.T)
    return TouchingLinks(depth, jnp.full(POINTS, first), parameter, normal, curvature, *_at_points()), apart


def _at_faces(one: PolygonChain, first: Int[Array, ""], ends: Array):
    faces = faces_of(one)

    def at_end(x, y, is_tip):
        at = nearest_face(faces, x, y)
        k = jnp.minimum(at.number, faces.x.size - 2)
        depth = jnp.where(faces.touchable[at.number], -at.distance, -1.0)
        away_x = faces.x[at.number] + at.along * faces.cos[at.number] - x
        away_y = faces.y[at.number] + at.along * faces.sin[at.number] - y
        # Behind an inner corner, the corner itself is nearest: it pulls the point back like a spring.
        first_corner, second_corner = at.along <= 0, at.along >= faces.length[at.number]
        behind, size = (depth > 0) & (first_corner | second_corner), jnp.where(depth > 0, depth, 1.0)
        normal_x = jnp.where(behind, away_x / size, faces.sin[k])
        normal_y = jnp.where(behind, away_y / size, -faces.cos[k])
        curvature = jnp.where(behind, -1 / size, 0.0)
        # Only a tip can be in a corner itself, where the parameter is the angle by which the normal turns.
        corner = k + second_corner
        slope, turn = one.slopes[corner], one.slopes[corner] - one.slopes[corner + 1]
        turned = jnp.arctan2(
            jnp.sin(slope) * -normal_y - jnp.cos(slope) * normal_x,
            jnp.cos(slope) * -normal_y + jnp.sin(slope) * normal_x,
        )
        in_corner = behind & is_tip & (turn > 0)
        piece = jnp.where(in_corner, 2 * corner, 2 * k + 1)
        parameter = one.start[piece] + jnp.where(in_corner, jnp.clip(turned, 0.0, turn), at.along)
        normal = jnp.stack([normal_x, normal_y])
        return depth, first + piece, parameter, normal, curvature, jnp.abs(at.distance)

    (x, y), is_tip = ends.T, np.arange(1, POINTS + 1) == POINTS
    depth, piece, parameter, normal, curvature, apart = jax.vmap(at_end)(x, y, is_tip)
    return TouchingLinks(depth, piece, parameter, normal, curvature, *_at_points()), apart


def _at_corners(one: PolygonChain, first: Int[Array, ""], own: Links, angle: Array, ends: Array) -> TouchingLinks:
    fine, size = BETWEEN @ angle, own.link / SHARES
    faces, cos, sin = faces_of(one), jnp.cos(fine), jnp.sin(fine)
    begins = ends - size * jnp.stack([cos, sin], axis=1)

    def at(k):
        right, up = (one.xy[k] - begins).T
        share = (right * cos + up * sin) / size
        apart = jnp.abs(up * cos - right * sin)
        j = jnp.argmin(jnp.where((share >= 0) & (share <= 1), apart, jnp.inf))
        x, y = begins[j, 0] + share[j] * size * cos[j], begins[j, 1] + share[j] * size * sin[j]
        touch = at_corner(one, faces, k, x, y, cos[j], sin[j])
        passes = (share[j] >= 0) & (share[j] <= 1) & touch.meets & (touch.gap > -DEEPEST)
        normal = touch.side * jnp.stack([sin[j], -cos[j]])
        depth = jnp.where(passes, -touch.gap, -1.0)
        return depth, first + 2 * k, touch.parameter, normal, j + share[j]

    depth, piece, parameter, normal, arc = of_corners(one, at)
    return TouchingLinks(depth, piece, parameter, normal, jnp.zeros_like(depth), arc, jnp.full_like(depth, STIFFNESS))


def _at_points() -> tuple[Array, Array]:
    """Arcs of the ends of shares, and the stiffness of an object there."""
    arc = np.arange(1.0, POINTS + 1)
    return jnp.asarray(arc), jnp.asarray(np.where(arc == POINTS, STIFFNESS, STIFFNESS / SHARES))


def ends_of_shares(own: Links, angle: Float[Array, " links"], pose: Float[Array, "3"]) -> Float[Array, "points 2"]:
    base, fine = own.origin + jnp.sum(own.axes * pose[:2], axis=1), BETWEEN @ angle
    way = own.link / SHARES * jnp.stack([jnp.cos(fine), jnp.sin(fine)], axis=1)
    return base + jnp.cumsum(way, axis=0)


def tangents(touch: TouchingLinks) -> Float[Array, "elements 2"]:
    """Directions of the object's tangent."""
    return touch.normal[:, ::-1] * np.array([-1.0, 1.0])


def poses_of(problem: ChainProblem, springs: Array) -> BasePoses:
    root = problem.flexibility.root
    return problem.rest + jnp.reshape(jnp.sum(root * springs, axis=1), (-1, 3))
