"""Where whiskers come to rest that have lost their stability: the flow of coarse rods at a fixed control.

Each whisker is a chain of links with springs between them, along which directions are linear between the middles of
links. Its drag is that of turning links, and objects push back points of all links in proportion to their depth, and
corners the links themselves. Time steps are linearly implicit and grow until nothing moves. The contacts in which the
rods come to rest are a guess for the exact equations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import positive_definite, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.friction import landed
from jaxwhisker._chain.gaps import nearest, outline_of
from jaxwhisker._chain.polygons import at_corner, corner_signs, faces_of, nearest_face, of_corners
from jaxwhisker._chain.problem import BasePoses, ChainProblem
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, material_of, of_each
from jaxwhisker._equilibrium.point import Contacts
from jaxwhisker._model.objects import of_each_object
from jaxwhisker._model.polygon_chain import PolygonChain
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._rod.rod import Section

LINKS = 60
SHARES = 4  # of each link, at whose ends objects push
POINTS = LINKS * SHARES
STIFFNESS = 2e4  # EI/L^3, of an object along a link
MOST = 48  # points that are pushed at the same time, as far as second derivatives are concerned
STRIDE = 0.01  # lengths by which any point may move in a step
FIRST_TIME, LONGEST_TIME = 1e-3, 1e4
REST = 1e-7  # lengths by which points at rest may move in a step of the longest time
STEPS = 600
LEAST_FORCE = 1e-4  # EI/L^2, of a contact
NEIGHBOURS = 1.6 * SHARES  # shares of links between two places that belong to one contact
AT_TIP = 0.5  # shares from the tip within which a contact is one at the tip


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


class CoarseRods(NamedTuple):
    """The state of the flow."""

    angle: Float[Array, "whiskers links"]  # of the links to the x axis
    springs: Float[Array, " springs"]  # elongations of the network in units of its root
    time: Scalar  # length of the next step
    steps: Int[Array, ""]
    rests: Bool[Array, ""]
    # With friction, by how much objects are stretched along themselves where rods touch them; else None.
    stretch: Float[Array, "whiskers elements"] | None = None


class Landing(NamedTuple):
    """Contacts in which rods have come to rest, as a guess."""

    z: Contacts
    state: ChainState
    settled: Bool[Array, ""]
    too_many: Bool[Array, ""]  # whether there are more contacts than there is room for


class _Links(NamedTuple):
    """What does not change in the flow, of each whisker."""

    link: Scalar  # length of a link
    joint: Float[Array, " links"]  # stiffness of the springs between links; the first one is that at the base
    bend: Float[Array, " links"]  # angle of each joint without a moment
    origin: Float[Array, "2"]  # of the base's frame
    axes: Float[Array, "2 2"]  # columns: its x and y axes
    upright: Scalar  # angle of the unloaded base to the x axis


def _whisker(body: WhiskerAtObject) -> _Links:
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
    return _Links(link, stiffness / part, curvature * part, jnp.stack([frame.x, frame.y]), axes, upright)


class _TouchingLinks(NamedTuple):
    """How rods touch objects: with the ends of the shares of links, and anywhere at corners; fields (elements,)."""

    depth: Float[Array, " elements"]
    piece: Int[Array, " elements"]
    parameter: Float[Array, " elements"]
    normal: Float[Array, "elements 2"]
    curvature: Float[Array, " elements"]  # of the object; positive if it is convex
    arc: Float[Array, " elements"]  # from the base, in shares
    stiffness: Float[Array, " elements"]


def _touching(problem: ChainProblem, own: _Links, length: Scalar, angle: Array, ends: Array) -> _TouchingLinks:
    def of_one(one, first):
        if not isinstance(one, PolygonChain):
            return _at_curve(one, first, own, length, ends)
        both = _at_faces(one, first, ends), _at_corners(one, first, own, angle, ends)
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *both)

    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *of_each_object(problem.profile, of_one))


def _at_curve(one: AbstractProfile, first: Int[Array, ""], own: _Links, length: Scalar, ends: Array) -> _TouchingLinks:
    outline = outline_of(one, own.origin[0], own.origin[1], 1.5 * length)

    def at_end(x, y):
        p = nearest(one, outline, x, y)
        at, rate = jax.jvp(one.point, (p,), (jnp.ones_like(p),))
        curvature = (rate.sin * at.cos - rate.cos * at.sin) / (rate.x * at.cos + rate.y * at.sin)
        return -at.off(x, y), p, at.normal, curvature

    depth, parameter, normal, curvature = jax.vmap(at_end)(*ends.T)
    return _TouchingLinks(depth, jnp.full(POINTS, first), parameter, normal, curvature, *_at_points())


def _at_faces(one: PolygonChain, first: Int[Array, ""], ends: Array) -> _TouchingLinks:
    faces = faces_of(one)

    def at_end(x, y):
        at = nearest_face(faces, x, y)
        k = jnp.minimum(at.number, faces.x.size - 2)
        depth = jnp.where(faces.touchable[at.number], -at.distance, -1.0)
        return depth, first + 2 * k + 1, one.start[2 * k + 1] + at.along, jnp.stack([faces.sin[k], -faces.cos[k]])

    depth, piece, parameter, normal = jax.vmap(at_end)(*ends.T)
    return _TouchingLinks(depth, piece, parameter, normal, jnp.zeros(POINTS), *_at_points())


def _at_corners(one: PolygonChain, first: Int[Array, ""], own: _Links, angle: Array, ends: Array) -> _TouchingLinks:
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
        passes = (share[j] >= 0) & (share[j] <= 1) & touch.meets
        normal = touch.side * jnp.stack([sin[j], -cos[j]])
        depth = jnp.where(passes, -touch.gap, -1.0)
        return depth, first + 2 * k, touch.parameter, normal, j + share[j]

    depth, piece, parameter, normal, arc = of_corners(one, at)
    return _TouchingLinks(depth, piece, parameter, normal, jnp.zeros_like(depth), arc, jnp.full_like(depth, STIFFNESS))


def _at_points() -> tuple[Array, Array]:
    """Arcs of the ends of shares, and the stiffness of an object there."""
    arc = np.arange(1.0, POINTS + 1)
    return jnp.asarray(arc), jnp.asarray(np.where(arc == POINTS, STIFFNESS, STIFFNESS / SHARES))


def _ends(own: _Links, angle: Float[Array, " links"], pose: Float[Array, "3"]) -> Float[Array, "points 2"]:
    base, fine = own.origin + jnp.sum(own.axes * pose[:2], axis=1), BETWEEN @ angle
    way = own.link / SHARES * jnp.stack([jnp.cos(fine), jnp.sin(fine)], axis=1)
    return base + jnp.cumsum(way, axis=0)


def _tangents(touch: _TouchingLinks) -> Float[Array, "elements 2"]:
    """Directions of the object's tangent."""
    return touch.normal[:, ::-1] * np.array([-1.0, 1.0])


def _stretch(problem: ChainProblem, touch: _TouchingLinks, stretch: Array) -> Float[Array, " elements"]:
    """The stretch that friction holds."""
    assert problem.friction_angle is not None
    most = jnp.tan(problem.friction_angle) * jnp.maximum(touch.depth, 0.0)
    return jnp.clip(stretch, -most, most)


def _system(problem: ChainProblem, own: _Links, length: Scalar, angle: Array, pose: Array, stretch: Array | None):
    """Gradient and second derivatives of a whisker's energy by the angles of its links and the pose of its base."""
    ends, size = _ends(own, angle, pose), own.link / SHARES
    touch = _touching(problem, own, length, angle, ends)
    depth = jnp.maximum(touch.depth, 0.0)
    force = (touch.stiffness * depth)[:, None] * touch.normal
    sticks = jnp.zeros_like(depth)
    if stretch is not None:
        held = _stretch(problem, touch, stretch)
        force -= (touch.stiffness * held)[:, None] * _tangents(touch)
        sticks = jnp.where((held == stretch) & (depth > 0), touch.stiffness, 0.0)
    fine = BETWEEN @ angle
    cos, sin = jnp.cos(fine), jnp.sin(fine)
    # Derivatives of the ends of all shares, and of the base, by the angles of the links.
    rates = jnp.stack([-sin, cos], axis=1)[:, :, None] * BETWEEN[:, None, :]
    rates = jnp.concatenate([jnp.zeros((1, 2, LINKS)), size * jnp.cumsum(rates, axis=0)])

    def turns(arc, way):
        """Derivatives along `way` of the points at these arcs."""
        k = jnp.clip(jnp.ceil(arc).astype(int) - 1, 0, POINTS - 1)
        at = rates[k] + (arc - k)[:, None, None] * (rates[k + 1] - rates[k])
        return jnp.sum(way[:, :, None] * at, axis=1)

    before = jnp.append(own.upright + pose[2], angle[:-1])
    moment = own.joint * (angle - before - own.bend)
    by_angle = moment - jnp.append(moment[1:], 0.0) - jnp.sum(turns(touch.arc, force), axis=0)
    by_pose = -jnp.append(jnp.sum(own.axes * jnp.sum(force, axis=0)[:, None], axis=0), moment[0])
    _, pushed = jax.lax.top_k(touch.depth, min(MOST, touch.depth.size))
    some = jax.tree.map(lambda leaf: leaf[pushed], touch)

    def moves(way):
        shifts = jnp.stack([jnp.sum(way * own.axes[:, k], axis=1) for k in (0, 1)], axis=1)
        return jnp.concatenate([turns(some.arc, way), shifts, jnp.zeros_like(way[:, :1])], axis=1)

    into, along = moves(some.normal), moves(_tangents(some))
    stiff, bends = jnp.where(some.depth > 0, some.stiffness, 0.0), -some.stiffness * depth[pushed] * some.curvature
    bends += sticks[pushed]
    second = into.T @ (stiff[:, None] * into) + along.T @ (bends[:, None] * along)
    beyond = jnp.clip(some.arc[:, None] - np.arange(POINTS), 0.0, 1.0).T @ force[pushed]
    geometric = BETWEEN.T @ (size * (beyond[:, 0] * cos + beyond[:, 1] * sin)[:, None] * BETWEEN)
    next_joint = jnp.append(own.joint[1:], 0.0)
    tight = geometric + jnp.diag(own.joint + next_joint) - jnp.diag(own.joint[1:], 1) - jnp.diag(own.joint[1:], -1)
    second = second.at[:LINKS, :LINKS].add(tight)
    second = second.at[-1, -1].add(own.joint[0]).at[0, -1].add(-own.joint[0]).at[-1, 0].add(-own.joint[0])
    return jnp.append(by_angle, by_pose), second, ends, touch


def _slid(touch: _TouchingLinks, before: Array, after: Array) -> Float[Array, " elements"]:
    """By how much rods move along objects where they touch them, between two positions of all points."""
    k = jnp.clip(jnp.ceil(touch.arc).astype(int) - 1, 0, POINTS - 1)
    moved = jnp.concatenate([jnp.zeros((1, 2)), after - before])
    share = (touch.arc - k)[:, None]
    return jnp.sum(_tangents(touch) * ((1 - share) * moved[k] + share * moved[k + 1]), axis=1)


def _poses(problem: ChainProblem, springs: Array) -> BasePoses:
    root = problem.flexibility.root
    return problem.rest + jnp.reshape(jnp.sum(root * springs, axis=1), (-1, 3))


def rods_of(problem: ChainProblem, shafts: WholeShaft, load: BasePoses) -> CoarseRods:
    """The rods with the shapes of these shafts; `load` are those on their bases."""

    def one(shaft, length):
        beyond, cos, sin = (jnp.ravel(leaf) for leaf in (shaft.beyond, shaft.cos, shaft.sin))
        angle = jnp.unwrap(jnp.arctan2(sin, cos))
        at = length * (1 - (np.arange(LINKS) + 0.5) / LINKS)
        return jnp.interp(at, beyond, angle)

    angle = jax.vmap(one)(shafts, problem.length)
    # Angles of the links continue that of the base.
    turn = jnp.round((angle[:, :1] - np.pi / 2) / (2 * np.pi)) * 2 * np.pi
    springs = jnp.sum(problem.flexibility.root * jnp.ravel(load)[:, None], axis=0)
    # Friction that has acted before stretches the objects again as soon as anything moves.
    corners = [one.xy.shape[0] for one in problem.profile.objects if isinstance(one, PolygonChain)]
    elements = POINTS * len(problem.profile.objects) + sum(corners)
    stretch = None if problem.friction_angle is None else jnp.zeros((problem.length.size, elements))
    return CoarseRods(angle - turn, springs, jnp.asarray(FIRST_TIME), jnp.asarray(0), jnp.asarray(False), stretch)


def flow(problem: ChainProblem, u: Scalar, start: CoarseRods, begins: Bool[Array, ""]) -> CoarseRods:
    """The rods at rest; nothing is computed unless the flow begins."""
    n, root = problem.length.shape[0], problem.flexibility.root
    each, size = of_each(problem.bodies(u), _whisker), n * LINKS
    drag = jnp.append(jnp.repeat(each.link, LINKS), jnp.ones(root.shape[1]))

    def linearised(rods: CoarseRods):
        pose = _poses(problem, rods.springs)
        own = each, problem.length, rods.angle, pose, rods.stretch
        gradient, second, ends, touch = jax.vmap(lambda *own: _system(problem, *own))(*own)
        roots = jnp.reshape(root, (n, 3, -1))
        by_angle = jnp.reshape(np.eye(n)[:, None, :, None] * second[:, :LINKS, None, :LINKS], (size, size))
        mixed = jnp.reshape(jnp.sum(second[:, :LINKS, LINKS:, None] * roots[:, None], axis=2), (size, -1))
        pulled = jnp.sum(second[:, LINKS:, LINKS:, None] * roots[:, None], axis=2)
        by_springs = jnp.eye(root.shape[1]) + jnp.sum(roots[:, :, :, None] * pulled[:, :, None, :], axis=(0, 1))
        on_springs = rods.springs + jnp.sum(roots * gradient[:, LINKS:, None], axis=(0, 1))
        right = jnp.append(jnp.ravel(gradient[:, :LINKS]), on_springs)
        return right, jnp.block([[by_angle, mixed], [mixed.T, by_springs]]), ends, touch

    def step(rods: CoarseRods) -> CoarseRods:
        right, system, ends, touch = linearised(rods)
        system += jnp.diag(drag / rods.time)
        change = -solve(system, right[:, None])[:, 0]
        angle = rods.angle + jnp.reshape(change[:size], (n, LINKS))
        springs = rods.springs + change[size:]
        there = jax.vmap(_ends)(each, angle, _poses(problem, springs))
        moved = jnp.max(jnp.sqrt(jnp.sum((there - ends) ** 2, axis=-1)))
        # Longer steps would also end at saddles.
        good = (moved < STRIDE) & positive_definite(system)
        growth = jnp.where(moved < STRIDE / 8, 3.0, jnp.where(moved < STRIDE / 2, 1.5, 1.0))
        longer = jnp.minimum(growth * rods.time, LONGEST_TIME)
        rests = good & (moved < REST) & (rods.time >= LONGEST_TIME / 4)
        stretch = rods.stretch
        if stretch is not None:
            held = jax.vmap(lambda touch, stretch: _stretch(problem, touch, stretch))(touch, stretch)
            stretch = jnp.where(good, held + jax.vmap(_slid)(touch, ends, there), stretch)
        return CoarseRods(
            jnp.where(good, angle, rods.angle),
            jnp.where(good, springs, rods.springs),
            jnp.where(good, longer, rods.time / 4),
            rods.steps + 1,
            rests,
            stretch,
        )

    def goes_on(rods: CoarseRods):
        return begins & ~rods.rests & (rods.steps < STEPS) & (rods.time > 1e-12)

    return jax.lax.while_loop(goes_on, step, start)


def landing_of(problem: ChainProblem, u: Scalar, rods: CoarseRods) -> Landing:
    """The contacts of rods at rest."""
    each, room = of_each(problem.bodies(u), _whisker), problem.contacts
    owner = problem.profile.object_of

    def one(own, length, angle, pose, stretch):
        touch = _touching(problem, own, length, angle, _ends(own, angle, pose))
        held = None if stretch is None else _stretch(problem, touch, stretch)
        order = jnp.argsort(-jnp.where(touch.depth > 0, touch.arc, -1.0))
        held = None if held is None else held[order]
        touch = jax.tree.map(lambda leaf: leaf[order], touch)  # from the tip
        depth = jnp.maximum(touch.depth, 0.0)
        active, number = depth * touch.stiffness > LEAST_FORCE, owner(touch.piece)
        assert number is not None
        near = (number[1:] == number[:-1]) & (touch.arc[:-1] - touch.arc[1:] < NEIGHBOURS)
        joins = active & jnp.append(False, active[:-1] & near)
        begins = active & ~joins
        group = jnp.where(active, jnp.cumsum(begins) - 1, room)
        beyond, fine = own.link / SHARES * (POINTS - touch.arc), BETWEEN @ angle

        def of_group(k):
            weight = jnp.where(group == k, touch.stiffness * depth, 0.0)
            total = jnp.sum(weight)
            some = total > 0
            deepest = jnp.argmax(weight)
            at_tip = some & (POINTS - touch.arc[deepest] < AT_TIP) & (signs[touch.piece[deepest]] <= 0)
            mean = jnp.sum(weight * beyond) / jnp.where(some, total, 1.0)
            # A corner knows its place; a curve is touched by the ends of several links.
            mean = jnp.where(signs[touch.piece[deepest]] > 0, beyond[deepest], mean)
            share = fine[jnp.clip(jnp.ceil(touch.arc[deepest]).astype(int) - 1, 0, POINTS - 1)]
            normal = touch.normal[deepest]
            into = -(jnp.cos(share) * normal[0] + jnp.sin(share) * normal[1])
            # The object's tangent is (-n_y, n_x).
            along = -jnp.cos(share) * normal[1] + jnp.sin(share) * normal[0]
            slack = jnp.where(at_tip, -jnp.arctan2(into, jnp.abs(along)), mean)
            numbers = jnp.stack([total, touch.parameter[deepest], slack])
            phase = jnp.where(at_tip, int(Phase.tip), int(Phase.tangential))
            pulled = 0.0 if held is None else jnp.sum(jnp.where(group == k, touch.stiffness * held, 0.0))
            return (
                jnp.where(some, numbers, 0.0),
                jnp.where(some, phase, int(Phase.free)),
                jnp.where(along < 0, -1.0, 1.0),
                jnp.where(some, touch.piece[deepest], 0),
                jnp.arctan(pulled / jnp.where(some, total, 1.0)),
            )

        return *jax.vmap(of_group)(jnp.arange(room)), jnp.sum(begins)

    signs = corner_signs(problem.profile)
    given = each, problem.length, rods.angle, _poses(problem, rods.springs), rods.stretch
    *contacts, count = jax.vmap(one)(*given)
    z, phase, side, piece, lean = (jnp.reshape(leaf, (-1, *leaf.shape[2:])) for leaf in contacts)
    z, state = landed(problem, z, ChainState(phase, side, piece), lean)
    return Landing(z, state, rods.rests, jnp.any(count > room))
