"""The snap flow: the overdamped motion of the bases at a fixed drive, which decides what follows a loss of stability.

Base i moves with the velocity load_i - [K (pose - rest)]_i. Its whisker stays on its clamped branch until it passes a
fold of that branch; then it slips:

1. If its unloaded shape clears all objects, it is free.
2. Otherwise it slides on along its branch until it is stable again at the same base position, as beneath the edge of a
   flat object.
3. If the bending moment at its base or its contact force vanishes before that, it lands on the far side, bent the other
   way.
4. If it clears its object, but another one is in its way as it straightens, it lands on that one, bent the same way.

With the flexibility C = K^-1, one implicit step of pseudo-time dt is

    (1 + C / dt - C D) d pose = rest + C load - pose,        D = d load / d pose,

which is valid for rigid springs too. If the bases run away faster than dt resolves, the matrix is not positive
definite. The destabilising part of D (D > 0 along x; in the plane, all of D) is then treated explicitly, and the next
dt is shorter; with friction, nothing moves before dt is short enough. Treating it explicitly throughout would be too
slow: just below a critical stiffness the bases creep by a millionth of the distance per step.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import solve, times_block_diagonal
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN, PARAMETER, SLACK, Phase, across_force
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import lean
from jaxwhisker._equilibrium.newton import Condensed
from jaxwhisker._equilibrium.pieces import after_step
from jaxwhisker._equilibrium.point import Contacts, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._equilibrium.stability import (
    Slopes,
    clamped_is_stable,
    load_slopes,
    network_is_stable,
    on_stable_branch,
)
from jaxwhisker._equilibrium.stance import PerObject, PerWhisker, Poses, Stance, of_object

LARGEST_CHANGE = 0.02  # largest change of any contact in a step, in its scale; the flow is first order in it
FIRST_CHANGE = 0.0025  # the same for the first step: contacts may stick, or the end of a short snap may be as near
FARTHEST = 5.0  # largest motion of a base per change of contacts: a flat object moves far beneath a steady contact
SHORTEST = 1e-7  # smallest such change that is tried if a whisker cannot follow a larger one
FIRST_TIME_STEP = 1e-3
GROWTH = 1.4  # factor by which time steps that are short enough grow
FAST_GROWTH = 4.0  # the same with friction, where a time step that is too long costs little
NEAR = 0.02  # distance from the equilibrium at which Newton's method takes over
ITERATIONS = 2000  # fewer than a march may have in all: a flow that does not end is `unsettled`, not `too_long`
TOUCH = 1e-8  # tolerance for the position of a base where its whisker touches, and thus for the force of a new contact
LANDED = 1e-6  # tolerance for the base position at which a slipped whisker's slide or landing ends


class Flow(NamedTuple):
    """State of the snap flow between two iterations of the march."""

    pose: Poses
    guess: Contacts  # for the next solution
    basis: Float[Array, "whiskers numbers axes"]  # steps along and across each whisker's branch, as in Condensed
    pose_by: Float[Array, "whiskers axes axes"]  # derivative of the base's pose with respect to these steps
    slope: Slopes  # d load / d pose
    load: Poses
    gap: PerWhisker  # distance of a free whisker's base from where the whisker would touch
    step: Scalar  # largest change of any contact in the next step
    time_step: Scalar
    slipped: Bool[Array, " whiskers"]  # since the flow began
    sliding: Bool[Array, " whiskers"]  # past a fold of its branch
    landing: Bool[Array, " whiskers"]  # on the far side, or on another object
    landing_x: PerWhisker  # base position at which sliding or landing ends
    near: Scalar  # distance from the equilibrium at which Newton's method takes over
    iterations: Int[Array, ""]
    exhausted: Bool[Array, ""]  # whether the flow has failed to come to rest
    # +1 or -1: along its branch, or back, as a whisker slides; None without edges and friction.
    way: PerWhisker | None = None
    clamped: Bool[Array, ""] | None = None  # whether coupled shafts are stable with clamped bases; None without
    share: Scalar | None = None  # of the next step that is taken; None without friction


def start(state: ContactState, pose: Poses, z: Contacts, edges: bool = False) -> Flow:
    """The state of a flow that is about to begin; `edges` tells whether the object has any."""
    (n, axes), numbers = pose.shape, z.shape[1]
    coupled = numbers > 3
    no, none = jnp.zeros(n, bool), jnp.zeros(n)
    return Flow(
        pose=pose,
        guess=jnp.zeros((n, numbers)),
        basis=jnp.zeros((n, numbers, axes)),
        pose_by=jnp.broadcast_to(jnp.eye(axes), (n, axes, axes)),
        slope=jnp.zeros((n * axes, n * axes) if coupled else (n, axes, axes)),
        load=jnp.zeros_like(pose),
        gap=none,
        step=jnp.asarray(FIRST_CHANGE),
        time_step=jnp.asarray(FIRST_TIME_STEP),
        slipped=no,
        sliding=no,
        landing=no,
        landing_x=none,
        near=jnp.asarray(NEAR),
        iterations=jnp.asarray(0),
        exhausted=jnp.asarray(False),
        way=none + 1.0 if edges or state.friction is not None else None,
        clamped=jnp.asarray(False) if coupled else None,
        share=None if state.friction is None else jnp.asarray(1.0),
    )


def kick(flow: Flow, point: Point, tangent: Point, tangent_pose: Poses) -> Flow:
    """Take the first step: onwards along the path that has just become unstable, with the drive at rest."""
    length = jnp.maximum(jnp.sqrt(jnp.sum((tangent.z / scale_of(point.z)) ** 2)), 1e-3)
    step = flow.step
    if flow.share is not None:
        step, length = flow.share * step, jnp.maximum(length, jnp.max(jnp.abs(tangent_pose)) / FARTHEST)
    step = step / length
    return flow._replace(guess=point.z + step * tangent.z, pose=flow.pose + step * tangent_pose)


def _implicit_displacement(problem: Problem, pull: Poses, slope, damping: Scalar) -> Poses:
    """Solution of (1 + C damping - C slope) displacement = pull."""
    matrix = problem.flexibility.matrix
    system = jnp.eye(pull.size) + matrix * damping - times_block_diagonal(matrix, slope)
    return jnp.reshape(solve(system, jnp.ravel(pull)[:, None]), pull.shape)


def _resolves(problem: Problem, slope: Slopes, time_step: Scalar) -> Bool[Array, ""]:
    """Whether the system is stable even with half of the damping: otherwise, it would be badly conditioned."""
    return network_is_stable(problem, slope - 0.5 / time_step * jnp.eye(slope.shape[-1]))


def _steps(flow: Flow, displacement: Poses) -> Poses:
    """Steps along and across the branches that give the bases this displacement."""
    across = displacement[:, 1:]
    along = displacement[:, 0] - jnp.sum(flow.pose_by[:, 0, 1:] * across, axis=-1)
    return jnp.concatenate([(along / _nonzero(flow.pose_by[:, 0, 0]))[:, None], across], axis=1)


def propose(problem: Problem, flow: Flow, state: ContactState, point: Point) -> Flow:
    """Propose the next step of the bases, and a guess for the contacts that it leads to."""
    free, loose, axes = state.free, ~problem.solved(state.phase), flow.pose.shape[1]
    pull = problem.rest(point.u) + problem.displacement(flow.load) - flow.pose
    time_step, growth = flow.time_step, GROWTH
    resolved = _resolves(problem, flow.slope, time_step)
    if flow.share is not None:
        # Nothing moves before the time step is short enough. If it is too long, a shorter one is tried at once.
        time_step, growth = jnp.where(resolved, time_step, time_step / 4), FAST_GROWTH
        resolved = _resolves(problem, flow.slope, time_step)
    slope = jnp.where(resolved, flow.slope, problem.not_destabilising(flow.slope))
    moves = _implicit_displacement(problem, pull, slope, 1 / time_step)
    # A slip takes no time: the other whiskers wait until it ends.
    slipping = flow.sliding | flow.landing
    slipping_now = jnp.any(slipping)
    steps = jnp.where(loose[:, None], 0.0, _steps(flow, moves))
    # A free base may move half-way to where its whisker would touch.
    reach = (flow.step + 0.5 * flow.gap)[:, None]
    sizes = jnp.maximum(jnp.where(free[:, None], jnp.abs(moves) / reach, 0.0), jnp.abs(steps) / flow.step)
    if flow.share is not None:
        sizes = jnp.maximum(sizes, jnp.where(loose[:, None], 0.0, jnp.abs(moves) / (FARTHEST * flow.step)))
    size = jnp.max(sizes)
    share = jnp.minimum(1.0, 1 / jnp.maximum(size, 1e-300))
    to_land = jnp.zeros_like(steps).at[:, 0].set(_step_to_landing(problem, flow, state))
    steps = jnp.where(slipping_now, jnp.where(slipping[:, None], to_land, 0.0), share * steps)
    moves = jnp.where(slipping_now, 0.0, share * moves)
    longer = jnp.where(resolved, jnp.where(share < 1, 0.7, growth), 0.25)
    if flow.share is not None:
        # With the slopes of another slip or phase of one contact, the others would be led astray.
        looks = jnp.any(~loose & ~branch_known(flow))
        part = jnp.where(looks | ~(resolved | slipping_now), 0.0, flow.share)
        steps, moves, longer = part * steps, part * moves, jnp.where(looks, 1.0, longer)
    # Across the branches, bases are held where the flow puts them; along the branches, they follow the contacts. A base
    # whose branch is not known yet waits.
    moved = loose[:, None] | (branch_known(flow)[:, None] & (jnp.arange(axes) > 0))
    return flow._replace(
        guess=point.z + jnp.sum(flow.basis * steps[:, None, :], axis=-1),
        pose=flow.pose + jnp.where(moved, moves, 0.0),
        time_step=jnp.where(slipping_now, flow.time_step, time_step * longer),
    )


def _step_to_landing(problem: Problem, flow: Flow, state: ContactState) -> PerWhisker:
    """Step along the branch of a slipping whisker towards the base position at which its slip ends."""
    by_x, most = flow.pose_by[:, 0, 0], flow.step
    if flow.share is not None:
        most /= jnp.maximum(jnp.abs(by_x) / FARTHEST, 1.0)
    to_land = jnp.clip((flow.landing_x - flow.pose[:, 0]) / _nonzero(by_x), -most, most)
    step = most if flow.way is None else flow.way * most
    return jnp.where(flow.sliding & ~on_stable_branch(problem, state, by_x), step, to_land)


def branch_known(flow: Flow) -> Bool[Array, " whiskers"]:
    """Whether the direction of each whisker's branch is known."""
    return jnp.any(flow.basis[:, :, 0] != 0, axis=-1)


class _Jumps(NamedTuple):
    """Whiskers whose contact ends, begins, or passes a fold in a step of the flow."""

    slips: Bool[Array, " whiskers"]  # passes a fold
    slides: Bool[Array, " whiskers"]  # passes a fold and does not come free
    freed: Bool[Array, " whiskers"]  # comes free
    begins: Bool[Array, " whiskers"]  # a free whisker touches
    lands: Bool[Array, " whiskers"]  # on the far side
    holds: Bool[Array, " whiskers"]  # on the stable part of its branch
    among: "_Among | None" = None  # None with a single object


class _Among(NamedTuple):
    """Whiskers among several objects."""

    hits: Bool[Array, " whiskers"]  # passes a fold and lands on another object
    stuck: Bool[Array, " whiskers"]  # comes free inside or beyond another object: unknown how
    number: Int[Array, " whiskers"]  # the object on which its next contact begins
    own: Bool[Array, "objects whiskers"]  # the object that it touches


def _slip(
    problem: Problem,
    flow: Flow,
    state: ContactState,
    z: Contacts,
    u: Scalar,
    pose: Poses,
    at: Stance,
    condensed: Condensed,
    parameters: PerWhisker | None,
) -> _Jumps:
    """Apply the snap rule above."""
    free, by_x = state.free, condensed.by_x
    slipping, holds = flow.sliding | flow.landing, on_stable_branch(problem, state, by_x)
    if condensed.coupled is not None:
        # A whisker past the fold of its own branch may be held by springs to others.
        holds |= clamped_is_stable(problem, state, condensed)
    force_by_x = condensed.basis[:, 0, 0] / _nonzero(by_x)
    ends = ~free & ~slipping & (z[:, FORCE] < -TOUCH * jnp.maximum(jnp.abs(force_by_x), 1.0))
    slips = ~free & ~slipping & ~ends & ~holds
    contact = jax.vmap(problem.profile.point_on)(state.piece, z[:, PARAMETER] if parameters is None else parameters)
    base = problem.in_scene(u, pose)
    cos, sin = across_force(contact, lean(z[:, LEAN], state.friction, problem.friction_angle))
    unbent = state.side * ((contact.x - base.x) * cos + (contact.y - base.y) * sin) <= 0
    lands = flow.sliding & (unbent | (z[:, FORCE] < 0))
    if state.sides is not None:
        return _slip_among_objects(problem, state, state.sides, at, _Jumps(slips, slips, ends, free, lands, holds))
    near = at.first(state.side)
    return _Jumps(
        slips=slips,
        slides=slips & ~at.clear,
        freed=ends | (slips & at.clear),
        begins=free & near.reaches & (state.side * (at.x - near.x) < 0),
        lands=lands,
        holds=holds,
    )


def _slip_among_objects(problem: Problem, state: ContactState, sides: PerObject, at: Stance, alone: _Jumps) -> _Jumps:
    """Apply the snap rule to whiskers that may slip, come free or touch, if all objects let them."""
    near = at.first(sides)
    gap = jnp.where(near.reaches, sides * (at.x - near.x), jnp.inf)
    own = jnp.arange(len(sides))[:, None] == problem.profile.object_of(state.piece)
    others = ~own | state.free
    in_way, number = jnp.any(others & (gap < 0), axis=0), jnp.argmin(jnp.where(others, gap, jnp.inf), axis=0)
    clears = alone.slips & jnp.any(own & at.clear, axis=0)
    # It moves towards the side to which it is bent.
    hits = clears & in_way & (of_object(sides, number) == state.side)
    leaves = alone.freed | clears
    return alone._replace(
        slides=alone.slips & ~clears,
        freed=leaves & ~in_way,
        begins=alone.begins & in_way,
        among=_Among(hits, leaves & in_way & ~hits, jnp.where(alone.lands, jnp.argmax(own, axis=0), number), own),
    )


def advance(
    problem: Problem,
    flow: Flow,
    state: ContactState,
    previous: Contacts,
    solution: Solution,
    at: Stance,
    parameters: PerWhisker | None,
) -> tuple[Flow, ContactState, Contacts]:
    """Accept the solved step from the previous contacts: phases change, contacts end or begin, whiskers slip.

    The stance is that of the bases at the end of the step, those of free whiskers where the flow puts them. The
    profile's parameters at its contacts are needed with friction only.
    """
    newton, z, u = solution.newton, solution.point.z, solution.point.u
    free = state.free
    pose = jnp.where(problem.solved(state.phase)[:, None], newton.pose, flow.pose)
    piece, edges = state.piece, problem.profile.has_edges
    if piece is not None and edges:
        # The first point on a new piece is solved for from its end, and may lie a little beyond it.
        piece, z = after_step(problem.profile, piece, previous, z, ~free & branch_known(flow))
    phase = jnp.where(free, Phase.free, jnp.where(z[:, SLACK] > 0, Phase.tangential, Phase.tip))
    turned = (phase != state.phase) & ~free
    if piece is not None and edges:
        turned |= piece != state.piece
    by_x = newton.condensed.by_x
    slip = _slip(problem, flow, state, z, u, pose, at, newton.condensed, parameters)

    now = state._replace(phase=phase, piece=piece).ended(slip.freed, at.side)
    side, fresh = jnp.where(slip.lands, -now.side, now.side), slip.begins | slip.lands
    among, number = slip.among, None
    if among is not None and now.sides is not None:
        # A whisker that hits another object has left its own one.
        fresh, number = fresh | among.hits, among.number
        now = now._replace(sides=jnp.where(among.hits & among.own, at.side, now.sides))
        side = jnp.where(slip.begins | among.hits, state.side_of(number), side)
    before = at.of(number)
    first = before.first(side)
    touched, touched_phase, touched_side = touching(before, side)
    now = now.begun(fresh, touched_phase, touched_side, first.piece)
    z = jnp.where(fresh[:, None], touched, jnp.where(slip.freed[:, None], at.contact_if_free, z))
    way = flow.way
    if way is not None:
        # Where a tip slips over a corner, or a contact begins to slip, a branch begins. A whisker slides back along one
        # that begins past its fold.
        moved = jnp.sum(newton.condensed.basis[:, :, 0] * (z - previous) / scale_of(z) ** 2, axis=-1)
        way = jnp.where(slip.slides & (flow.iterations == 0) & (moved < 0), -1.0, way)
    landing_x = jnp.where(slip.slides if among is None else slip.slides | among.hits, pose[:, 0], flow.landing_x)
    pose = pose + jnp.where(fresh[:, None], problem.shift(u, first.x - at.x), 0.0)
    astray = jnp.abs(landing_x - pose[:, 0]) > LANDED * jnp.minimum(jnp.abs(by_x), 1.0)

    gap, landing = jnp.where(first.reaches, jnp.abs(at.x - first.x), jnp.inf), slip.lands
    iterations = flow.iterations + 1
    missed = jnp.any(flow.landing & ~slip.holds & ~fresh & (z[:, FORCE] > 0))
    if among is not None:
        nearest = at.first(now.standing)
        gap = jnp.min(jnp.where(nearest.reaches, jnp.abs(at.x - nearest.x), jnp.inf), axis=0)
        landing, missed = landing | among.hits, missed | jnp.any(among.stuck)
    no_branch = (fresh | slip.freed)[:, None]
    flow = flow._replace(
        pose=pose,
        # The direction of the branch in a phase that has just begun is unknown until a point in it has been solved for.
        basis=jnp.where((fresh | slip.freed | turned)[:, None, None], 0.0, newton.condensed.basis),
        pose_by=jnp.where(no_branch[:, :, None], jnp.eye(pose.shape[1]), newton.condensed.pose_by),
        slope=_known_slopes(load_slopes(problem, state, newton.condensed), no_branch),
        load=jnp.where(no_branch, 0.0, newton.load),
        gap=gap,
        slipped=flow.slipped | slip.slips,
        sliding=((flow.sliding & (astray | ~slip.holds)) | slip.slides) & ~slip.lands,
        landing=(flow.landing & astray) | landing,
        landing_x=landing_x,
        way=way,
        iterations=iterations,
        # Too many steps, or the branch on the far side ends before the whisker has landed.
        exhausted=(iterations > ITERATIONS) | missed,
        step=jnp.minimum(2 * flow.step, LARGEST_CHANGE),
        time_step=jnp.where(jnp.any(slip.freed | fresh), FIRST_TIME_STEP, flow.time_step),
        clamped=None if flow.clamped is None else jnp.all(slip.holds),
        share=None if flow.share is None else jnp.ones_like(flow.share),
    )
    return flow, now, z


def _known_slopes(slopes: Slopes, unknown: Bool[Array, "whiskers 1"]) -> Slopes:
    """The slopes, zero for whiskers whose branch is not known."""
    if slopes.ndim > 2:
        return jnp.where(unknown[:, :, None], 0.0, slopes)
    rows = jnp.repeat(unknown[:, 0], slopes.shape[0] // unknown.shape[0])
    return jnp.where(rows[:, None] | rows, 0.0, slopes)


def shortened(flow: Flow) -> Flow:
    """The flow before a step that a whisker could not follow, with a shorter step to try."""
    step, iterations = flow.step / 4, flow.iterations + 1
    return flow._replace(step=step, iterations=iterations, exhausted=(iterations > ITERATIONS) | (step < SHORTEST))


def at_rest(problem: Problem, flow: Flow, state: ContactState, u: Scalar) -> Bool[Array, ""]:
    """Whether a stable equilibrium is near enough for Newton's method to take over."""
    loose = ~problem.solved(state.phase)
    known = jnp.all(loose | branch_known(flow))
    slope = _known_slopes(flow.slope, loose[:, None])
    pull = problem.rest(u) + problem.displacement(flow.load) - flow.pose
    moves = _implicit_displacement(problem, pull, slope, jnp.asarray(0.0))
    steps = jnp.where(loose[:, None], 0.0, _steps(flow, moves))
    near = jnp.max(jnp.maximum(jnp.abs(moves), jnp.abs(steps))) < flow.near
    settled = near & known & ~jnp.any(flow.sliding | flow.landing)
    branches = jnp.all(loose | on_stable_branch(problem, state, flow.pose_by[:, 0, 0]))
    return settled & (branches if flow.clamped is None else flow.clamped) & network_is_stable(problem, slope)


def touching(at: Stance, side: PerWhisker) -> tuple[Contacts, Int[Array, " whiskers"], PerWhisker]:
    """Contacts, phases and sides of whiskers at their first touch from a side."""
    first = at.first(side)
    z = jnp.stack([jnp.zeros_like(first.slack), first.parameter, first.slack], axis=-1)
    if at.loads is not None:
        z = jnp.concatenate([z, at.loads], axis=-1)
    return z, jnp.where(first.slack > 0, Phase.tangential, Phase.tip), first.side


def _nonzero(x: PerWhisker) -> PerWhisker:
    return jnp.where(x == 0, 1.0, x)
