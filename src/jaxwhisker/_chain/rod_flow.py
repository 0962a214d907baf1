"""Where whiskers come to rest that have lost their stability: the flow of coarse rods at a fixed control.

Each whisker is a chain of links with springs between them, whose drag is that of turning links. Time steps are linearly
implicit and grow until nothing moves. The contacts in which the rods come to rest are a guess for the exact equations.
With friction, rods stretch the objects along themselves until friction gives way.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.linear_algebra import solve_definite
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.coarse_rods import (
    BETWEEN,
    LINKS,
    POINTS,
    SHARES,
    Links,
    TouchingLinks,
    ends_of_shares,
    links_of,
    poses_of,
    tangents,
    touching,
)
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.friction import landed
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._chain.problem import BasePoses, ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._chain.shaft import WholeShaft
from jaxwhisker._equilibrium.contact import Phase, of_each

MOST = 48  # points that are pushed at the same time, as far as second derivatives are concerned
STRIDE, LONGEST_STRIDE = 0.01, 0.1  # lengths by which a point may move in a step, close to objects and far from them
FIRST_TIME, LONGEST_TIME = 1e-3, 1e4
REST = 1e-7  # lengths by which points at rest may move in a step of the longest time
STEPS = 3000
SINKS, SHIFTS = 8, 16  # steps in which rods sink into the objects, and in which the drive then moves on
ROUNDING = 1e-13  # lengths, of stretches
LEAST_FORCE = 1e-4  # EI/L^2, of a contact
NEIGHBOURS = 1.6 * SHARES  # shares of links between two places that belong to one contact
AT_TIP = 0.5  # shares from the tip within which a contact is one at the tip


class CoarseRods(NamedTuple):
    """The state of the flow."""

    angle: Float[Array, "whiskers links"]  # of the links to the x axis
    springs: Float[Array, " springs"]  # elongations of the network in units of its root
    time: Scalar  # length of the next step
    steps: Int[Array, ""]
    rests: Bool[Array, ""]
    shift: Scalar  # of the drive, as a share of that to where rods come to rest; not above 0 while they sink
    # With friction, by how much objects are stretched along themselves where rods touch them; else None.
    stretch: Float[Array, "whiskers elements"] | None = None


class Landing(NamedTuple):
    """Contacts in which rods have come to rest, as a guess."""

    z: RowsOfContacts
    state: ChainState
    settled: Bool[Array, ""]
    too_many: Bool[Array, ""]  # whether there are more contacts than there is room for


class Pushed(NamedTuple):
    """Where objects push a rod."""

    ends: Float[Array, "*whiskers points 2"]  # of shares of links
    touch: TouchingLinks
    apart: Float[Array, "*whiskers points"]  # distances of the ends from the nearest object
    stretch: Float[Array, "*whiskers elements"] | None


def _stretch(problem: ChainProblem, touch: TouchingLinks, stretch: Array) -> Float[Array, " elements"]:
    """The stretch that friction holds."""
    assert problem.friction_angle is not None
    most = jnp.tan(problem.friction_angle) * jnp.maximum(touch.depth, 0.0)
    return jnp.clip(stretch, -most, most)


def _slides(held: Array, stretch: Array) -> Bool[Array, "*whiskers elements"]:
    """Where friction gives way."""
    return jnp.abs(stretch - held) > ROUNDING


def _system(
    problem: ChainProblem,
    own: Links,
    before: Array | None,
    length: Scalar,
    angle: Array,
    pose: Array,
    stretch: Array | None,
):
    """Gradient and second derivatives of a whisker's energy by the angles of its links and the pose of its base.

    Ends of shares were at `before` when objects were stretched like this; then the drive has moved on.
    """
    ends, size = ends_of_shares(own, angle, pose), own.link / SHARES
    touch, apart = touching(problem, own, length, angle, ends)
    depth = jnp.maximum(touch.depth, 0.0)
    force = (touch.stiffness * depth)[:, None] * touch.normal
    sticks = jnp.zeros_like(depth)
    if stretch is not None:
        assert before is not None
        stretch = jnp.where(touch.depth > 0, stretch + _slid(touch, before, ends), stretch)
        held = _stretch(problem, touch, stretch)
        force -= (touch.stiffness * held)[:, None] * tangents(touch)
        sticks = jnp.where(~_slides(held, stretch) & (depth > 0), touch.stiffness, 0.0)
    fine = BETWEEN @ angle
    cos, sin = size * jnp.cos(fine), size * jnp.sin(fine)
    # The force on each share is that on its end and on all beyond.
    k = jnp.clip(jnp.ceil(touch.arc).astype(int) - 1, 0, POINTS - 1)
    share = (touch.arc - k)[:, None]
    on_ends = jnp.zeros((POINTS + 1, 2)).at[k].add((1 - share) * force).at[k + 1].add(share * force)
    beyond = jnp.cumsum(on_ends[::-1], axis=0)[:-1][::-1]
    before = jnp.append(own.upright + pose[2], angle[:-1])
    moment = own.joint * (angle - before - own.bend)
    by_angle = moment - jnp.append(moment[1:], 0.0) - (beyond[:, 1] * cos - beyond[:, 0] * sin) @ BETWEEN
    by_pose = -jnp.append(jnp.sum(force, axis=0) @ own.axes, moment[0])
    _, pushed = jax.lax.top_k(touch.depth, min(MOST, touch.depth.size))
    some = jax.tree.map(lambda leaf: leaf[pushed], touch)
    reach = jnp.clip(some.arc[:, None] - np.arange(POINTS), 0.0, 1.0)
    # Derivatives of the points that are pushed, across and along the object, by the angles of links and the pose.
    way = jnp.concatenate([some.normal, tangents(some)])
    lever = jnp.concatenate([reach, reach]) * (way[:, 1:] * cos - way[:, :1] * sin)
    moves = jnp.concatenate([lever @ BETWEEN, way @ own.axes, jnp.zeros_like(way[:, :1])], axis=1)
    stiff, bends = jnp.where(some.depth > 0, some.stiffness, 0.0), -some.stiffness * depth[pushed] * some.curvature
    weights = jnp.append(stiff, bends + sticks[pushed])
    second = moves.T @ (weights[:, None] * moves)
    along = beyond[:, 0] * cos + beyond[:, 1] * sin
    next_joint = jnp.append(own.joint[1:], 0.0)
    beside = along @ (BETWEEN[:, 1:] * BETWEEN[:, :-1]) - own.joint[1:]
    tight = jnp.diag(along @ BETWEEN**2 + own.joint + next_joint) + jnp.diag(beside, 1) + jnp.diag(beside, -1)
    second = second.at[:LINKS, :LINKS].add(tight)
    second = second.at[-1, -1].add(own.joint[0]).at[0, -1].add(-own.joint[0]).at[-1, 0].add(-own.joint[0])
    return jnp.append(by_angle, by_pose), second, Pushed(ends, touch, apart, stretch)


def _slid(touch: TouchingLinks, before: Array, after: Array) -> Float[Array, " elements"]:
    """By how much rods move along objects where they touch them, between two positions of all points."""
    k = jnp.clip(jnp.ceil(touch.arc).astype(int) - 1, 0, POINTS - 1)
    moved = jnp.concatenate([jnp.zeros((1, 2)), after - before])
    share = (touch.arc - k)[:, None]
    return jnp.sum(tangents(touch) * ((1 - share) * moved[k] + share * moved[k + 1]), axis=1)


def rods_of(
    problem: ChainProblem, u: Scalar, shafts: WholeShaft, load: BasePoses, slips: tuple[Array, Array, Array] | None
) -> CoarseRods:
    """The rods with the shapes of these shafts.

    Args:
        problem: the problem.
        u: the control.
        shafts: of all whiskers.
        load: on their bases.
        slips: of all contacts, with friction: number of the object, -1 without contact; direction of slip, 0 if it
            sticks; length of the whisker beyond it.
    """

    def one(shaft, length):
        beyond, cos, sin, bend = (jnp.ravel(leaf) for leaf in (shaft.beyond, shaft.cos, shaft.sin, shaft.curvature))
        angle = jnp.unwrap(jnp.arctan2(sin, cos))
        at = length * (1 - (np.arange(LINKS) + 0.5) / LINKS)
        k = jnp.clip(jnp.searchsorted(beyond, at, side="right") - 1, 0, beyond.size - 2)
        apart = beyond[k + 1] - beyond[k]
        between = Cubic(angle[k], angle[k + 1], -apart * bend[k], -apart * bend[k + 1])
        return between.value((at - beyond[k]) / jnp.where(apart > 0, apart, 1.0))

    angle = jax.vmap(one)(shafts, problem.length)
    # Angles of the links continue that of the base.
    turn = jnp.round((angle[:, :1] - np.pi / 2) / (2 * np.pi)) * 2 * np.pi
    springs = jnp.sum(problem.flexibility.root * jnp.ravel(load)[:, None], axis=0)
    rods = CoarseRods(
        angle - turn, springs, jnp.asarray(FIRST_TIME), jnp.asarray(0), jnp.asarray(False), jnp.asarray(-SINKS / SHIFTS)
    )
    if problem.friction_angle is None:
        return rods
    each, pose = of_each(problem.bodies(u), links_of), poses_of(problem, springs)
    number, slip, beyond = of_whiskers(problem, slips)
    own = each, problem.length, rods.angle, pose, number, slip, beyond
    return rods._replace(stretch=jax.vmap(lambda *own: _slipping(problem, *own))(*own))


def _slipping(
    problem: ChainProblem,
    own: Links,
    length: Scalar,
    angle: Array,
    pose: Array,
    number: Array,
    slip: Array,
    beyond: Array,
) -> Float[Array, " elements"]:
    """Objects stretched as far as they can by contacts that slip: near each contact, in the direction of its slip."""
    touch, _ = touching(problem, own, length, angle, ends_of_shares(own, angle, pose))
    away = jnp.abs(touch.arc[:, None] - POINTS * (1 - beyond / length))
    own_object = jnp.asarray(problem.profile.object_of(touch.piece))
    away = jnp.where(own_object[:, None] == number, away, jnp.inf)
    nearest = jnp.argmin(away, axis=1)
    return jnp.where(jnp.isfinite(jnp.min(away, axis=1)), slip[nearest], 0).astype(float)


def flow(problem: ChainProblem, loss: Scalar, u: Scalar, start: CoarseRods, begins: Bool[Array, ""]) -> CoarseRods:
    """The rods at rest at a control, to which the drive moves on from the loss of stability.

    They sink into the objects at first, and would be pushed far away by a drive that moved at once. Nothing is computed
    unless the flow begins.
    """
    n, root = problem.length.shape[0], problem.flexibility.root
    size = n * LINKS
    drag = jnp.append(jnp.repeat(problem.length / LINKS, LINKS), jnp.ones(root.shape[1]))

    def links_at(shift: Scalar) -> Links:
        return of_each(problem.bodies(loss + jnp.maximum(shift, 0.0) * (u - loss)), links_of)

    def linearised(rods: CoarseRods, each: Links, before: Array | None):
        pose = poses_of(problem, rods.springs)
        own = each, before, problem.length, rods.angle, pose, rods.stretch
        gradient, second, pushed = jax.vmap(lambda *own: _system(problem, *own))(*own)
        roots = jnp.reshape(root, (n, 3, -1))
        by_angle = jnp.reshape(np.eye(n)[:, None, :, None] * second[:, :LINKS, None, :LINKS], (size, size))
        mixed = jnp.reshape(jnp.sum(second[:, :LINKS, LINKS:, None] * roots[:, None], axis=2), (size, -1))
        pulled = jnp.sum(second[:, LINKS:, LINKS:, None] * roots[:, None], axis=2)
        by_springs = jnp.eye(root.shape[1]) + jnp.sum(roots[:, :, :, None] * pulled[:, :, None, :], axis=(0, 1))
        on_springs = rods.springs + jnp.sum(roots * gradient[:, LINKS:, None], axis=(0, 1))
        right = jnp.append(jnp.ravel(gradient[:, :LINKS]), on_springs)
        return right, jnp.block([[by_angle, mixed], [mixed.T, by_springs]]), pushed

    def step(rods: CoarseRods) -> CoarseRods:
        shift = jnp.minimum(rods.shift + 1 / SHIFTS, 1.0)
        each = links_at(shift)
        before = None
        if rods.stretch is not None:
            before = jax.vmap(ends_of_shares)(links_at(rods.shift), rods.angle, poses_of(problem, rods.springs))
        right, system, (ends, touch, apart, stretch) = linearised(rods, each, before)
        system += jnp.diag(drag / rods.time)
        change, definite = solve_definite(system, -right)
        angle = rods.angle + jnp.reshape(change[:size], (n, LINKS))
        springs = rods.springs + change[size:]
        there = jax.vmap(ends_of_shares)(each, angle, poses_of(problem, springs))
        moved = jnp.sqrt(jnp.sum((there - ends) ** 2, axis=-1))
        room = jnp.clip(apart / 2, STRIDE, LONGEST_STRIDE)
        share = jnp.max(moved / room)
        # Longer steps would also end at saddles.
        good, time = (share < 1) & definite, rods.time / 4
        if stretch is not None and rods.stretch is not None:
            held = jax.vmap(lambda touch, stretch: _stretch(problem, touch, stretch))(touch, stretch)
            slid = jax.vmap(_slid)(touch, ends, there)
            # What has turned back within the step has stuck in it: the step is repeated so.
            touches = (touch.depth > 0) & (shift > 0)
            turns = good & touches & _slides(held, stretch) & (held * slid < 0)
            good, time = good & ~jnp.any(turns), jnp.where(jnp.any(turns), rods.time, time)
            shifted = stretch - rods.stretch
            stretch = jnp.where(turns, held - shifted, jnp.where(good & touches, held + slid, rods.stretch))
        growth = jnp.where(share < 1 / 8, 3.0, jnp.where(share < 1 / 2, 1.5, 1.0))
        longer = jnp.minimum(growth * rods.time, LONGEST_TIME)
        rests = good & (rods.shift == 1) & (jnp.max(moved) < REST) & (rods.time >= LONGEST_TIME / 4)
        return CoarseRods(
            jnp.where(good, angle, rods.angle),
            jnp.where(good, springs, rods.springs),
            jnp.where(good, longer, time),
            rods.steps + 1,
            rests,
            jnp.where(good, shift, rods.shift),
            stretch,
        )

    def goes_on(rods: CoarseRods):
        return begins & ~rods.rests & (rods.steps < STEPS) & (rods.time > 1e-12)

    return jax.lax.while_loop(goes_on, step, start)


def landing_of(problem: ChainProblem, u: Scalar, rods: CoarseRods) -> Landing:
    """The contacts of rods at rest."""
    each, room = of_each(problem.bodies(u), links_of), problem.contacts
    owner = problem.profile.object_of

    def one(own, length, angle, pose, stretch):
        touch, _ = touching(problem, own, length, angle, ends_of_shares(own, angle, pose))
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
    given = each, problem.length, rods.angle, poses_of(problem, rods.springs), rods.stretch
    *contacts, count = jax.vmap(one)(*given)
    z, phase, side, piece, lean = (jnp.reshape(leaf, (-1, *leaf.shape[2:])) for leaf in contacts)
    z, state = landed(problem, z, ChainState(phase, side, piece), lean)
    return Landing(z, state, rods.rests, jnp.any(count > room))
