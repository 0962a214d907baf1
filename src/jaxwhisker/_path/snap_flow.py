"""Relaxation: the overdamped flow of the bases at a fixed drive, which decides what follows a loss of stability.

Base i moves with the velocity load_i - [K (pose - rest)]_i. Its whisker stays on its clamped branch and slips when
it passes a fold. It is then free if its unloaded shape clears the object. Else it slides on along the branch until it
is held again at the same base position, as beneath the edge of a flat object; where its base is unbent before that, it
lands on the far side, bent the other way. Written with the flexibility C = K^-1 and one implicit step of pseudo-time
dt,

    (1 + C / dt - C D) d pose = rest + C load - pose,        D = d load / d pose,

which holds for rigid springs too. Where the bases run away faster than dt resolves, the matrix is not definite: what
destabilises (D > 0 along x) is then taken explicitly, and the next dt is shorter. (Always explicitly would not do: just
below a critical stiffness the bases creep, by a millionth of the way a step.)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.clearance import Stance, in_scene, stance
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.newton import (
    Contacts,
    Mode,
    PerWhisker,
    Point,
    Poses,
    Solution,
    by_blocks,
    definite,
    held,
    rest,
    scale_of,
    slopes,
    yielding,
)
from jaxwhisker._equilibrium.problem import Problem

STEP = 0.02  # largest change of any contact, in its scale; the flow is first order in it
SHORTEST = 1e-7  # ... tried where a whisker cannot follow a longer one
NEAR = 0.02  # Newton's method takes over where it would go less than this
ITERATIONS = 3000
NO_FORCE = 1e-9  # a contact that has just begun has none but rounding


class Flow(NamedTuple):
    """State of the relaxation between two iterations of the march."""

    pose: Poses
    guess: Contacts
    basis: Float[Array, "whiskers 3 axes"]  # steps along and across each whisker's branch, ...
    pose_by: Float[Array, "whiskers axes axes"]  # ... and how pose and load of the base go with them
    slope: Float[Array, "whiskers axes axes"]  # d load / d pose
    load: Poses
    gap: PerWhisker  # between a free whisker's base and where it would touch
    step: Scalar  # largest change of any contact
    time_step: Scalar
    slipped: Bool[Array, " whiskers"]
    sliding: Bool[Array, " whiskers"]  # past a fold of its branch
    landing: Bool[Array, " whiskers"]  # on the far side
    landing_x: PerWhisker  # where either has to end
    near: Scalar  # step below which Newton's method takes over
    iterations: Int[Array, ""]
    exhausted: Bool[Array, ""]


def start(mode: Mode, pose: Poses) -> Flow:
    """A flow about to begin."""
    n, axes = pose.shape
    no, none = jnp.zeros(n, bool), jnp.zeros(n)
    return Flow(
        pose,
        jnp.zeros((n, 3)),
        jnp.zeros((n, 3, axes)),
        jnp.broadcast_to(jnp.eye(axes), (n, axes, axes)),
        jnp.zeros((n, axes, axes)),
        jnp.zeros_like(pose),
        none,
        jnp.asarray(STEP),
        jnp.asarray(1e-3),
        no,
        no,
        no,
        none,
        jnp.asarray(NEAR),
        jnp.asarray(0),
        jnp.asarray(False),
    )


def kick(flow: Flow, point: Point, tangent: Point, tangent_pose: Poses) -> Flow:
    """The first step: on along the path that has just turned unstable, the drive at rest."""
    length = jnp.sqrt(jnp.sum((tangent.z / scale_of(point.z)) ** 2))
    step = flow.step / jnp.maximum(length, 1e-3)
    return flow._replace(guess=point.z + step * tangent.z, pose=flow.pose + step * tangent_pose)


def _displacement(problem: Problem, flow: Flow, pull: Poses, slope, damping: Scalar) -> Poses:
    """Solution of (1 + C damping - C slope) displacement = pull."""
    if problem.flexibility is None:
        return pull
    matrix = problem.flexibility.matrix
    system = jnp.eye(pull.size) + matrix * damping - by_blocks(matrix, slope)
    return jnp.reshape(solve(system, jnp.ravel(pull)[:, None]), pull.shape)


def _steps(flow: Flow, displacement: Poses) -> Poses:
    """Steps along and across the branches that take poses so far."""
    across = displacement[:, 1:]
    along = displacement[:, 0] - jnp.sum(flow.pose_by[:, 0, 1:] * across, axis=-1)
    return jnp.concatenate([(along / _nonzero(flow.pose_by[:, 0, 0]))[:, None], across], axis=1)


def propose(problem: Problem, flow: Flow, mode: Mode, point: Point) -> Flow:
    """The next step of the bases, and where it takes the contacts."""
    free = mode.phase == Phase.free
    slope, axes = flow.slope, flow.pose.shape[1]
    pull = rest(problem, point.u) + yielding(problem, flow.load) - flow.pose
    # By half of what dt damps: well conditioned.
    resolved = definite(problem, slope - 0.5 / flow.time_step * jnp.eye(axes))
    slope = jnp.where(resolved, slope, _not_along(slope))
    moves = _displacement(problem, flow, pull, slope, 1 / flow.time_step)
    # A whisker slips at once, and the others wait.
    slipping = flow.sliding | flow.landing
    slipping_now = jnp.any(slipping)
    steps = jnp.where(free[:, None], 0.0, _steps(flow, moves))
    # A free base may go half-way to where its whisker would touch.
    reach = (flow.step + 0.5 * flow.gap)[:, None]
    size = jnp.max(jnp.where(free[:, None], jnp.abs(moves) / reach, jnp.abs(steps) / flow.step))
    share = jnp.minimum(1.0, 1 / jnp.maximum(size, 1e-300))
    by_x = flow.pose_by[:, 0, 0]
    to_land = jnp.clip((flow.landing_x - flow.pose[:, 0]) / _nonzero(by_x), -flow.step, flow.step)
    to_land = jnp.where(flow.sliding & ~held(mode, by_x), flow.step, to_land)
    to_land = jnp.zeros_like(steps).at[:, 0].set(to_land)
    steps = jnp.where(slipping_now, jnp.where(slipping[:, None], to_land, 0.0), share * steps)
    moves = jnp.where(slipping_now, 0.0, share * moves)
    longer = jnp.where(resolved, jnp.where(share < 1, 0.7, 1.4), 0.25)
    # Across their branches bases are held where the flow has them; along these they come with the contacts. A contact
    # whose branch is not known yet waits.
    moved = free[:, None] | (_known(flow)[:, None] & (jnp.arange(axes) > 0))
    return flow._replace(
        guess=point.z + jnp.sum(flow.basis * steps[:, None, :], axis=-1),
        pose=flow.pose + jnp.where(moved, moves, 0.0),
        time_step=flow.time_step * jnp.where(slipping_now, 1.0, longer),
    )


def _known(flow: Flow) -> Bool[Array, " whiskers"]:
    return jnp.any(flow.basis[:, :, 0] != 0, axis=-1)


def _not_along(slope):
    """The slopes without what destabilises along x."""
    along = slope[:, 0, 0]
    return slope.at[:, 0, 0].set(jnp.minimum(along, 0.0)) if slope.shape[1] == 1 else jnp.zeros_like(slope)


def advance(problem: Problem, flow: Flow, mode: Mode, solution: Solution) -> tuple[Flow, Mode, Contacts]:
    """Take the solved step: phases that change, contacts that end or begin, whiskers that slip."""
    newton, z, u = solution.newton, solution.point.z, solution.point.u
    free = mode.phase == Phase.free
    pose = jnp.where(free[:, None], flow.pose, newton.pose)
    phase = jnp.where(free, Phase.free, jnp.where(z[:, 2] > 0, Phase.tangential, Phase.tip))
    turned = (phase != mode.phase) & ~free

    by_x = newton.local.by_x
    slipping, holds = flow.sliding | flow.landing, held(mode, by_x)
    ends = ~free & ~slipping & (z[:, 0] < -NO_FORCE)
    slips = ~free & ~slipping & ~ends & ~holds
    at = stance(problem, u, pose)
    clears = clear(at)
    freed = ends | (slips & clears)
    slides = slips & ~clears
    contact = jax.vmap(problem.profile.point)(z[:, 1])
    base = in_scene(problem, u, pose)
    unbent = mode.side * ((contact.x - base.x) * contact.cos + (contact.y - base.y) * contact.sin) <= 0
    lands = flow.sliding & (unbent | (z[:, 0] < 0))
    near = at.first(mode.side)
    begins = free & near.reaches & (mode.side * (at.x - near.x) < 0)

    side = jnp.where(freed, side_of(at), jnp.where(lands, -mode.side, mode.side))
    z, phase = jnp.where(freed[:, None], 0.0, z), jnp.where(freed, Phase.free, phase)
    fresh = begins | lands
    touched, how, bends = touching(at, side)
    z, phase = jnp.where(fresh[:, None], touched, z), jnp.where(fresh, how, phase)
    landing_x = jnp.where(slides, pose[:, 0], flow.landing_x)
    first = at.first(side)
    shift = (first.x - at.x)[:, None]
    if problem.mount is not None:
        frame, _ = problem.frames(u)
        shift = shift * jnp.stack([frame.cos, -frame.sin, jnp.zeros_like(frame.cos)], axis=1)
    pose = pose + jnp.where(fresh[:, None], shift, 0.0)
    side = jnp.where(fresh, bends, side)
    astray = jnp.abs(landing_x - pose[:, 0]) > LANDED * jnp.minimum(jnp.abs(by_x), 1.0)
    sliding = ((flow.sliding & (astray | ~holds)) | slides) & ~lands
    landing = (flow.landing & astray) | lands

    iterations = flow.iterations + 1
    missed = jnp.any(flow.landing & ~holds & ~fresh & (z[:, 0] > 0))
    none = (fresh | freed)[:, None]
    flow = flow._replace(
        pose=pose,
        # Where a phase has just begun the branch's direction is not known yet: first its point is solved for.
        basis=jnp.where((fresh | turned)[:, None, None], 0.0, newton.local.basis),
        pose_by=jnp.where(none[:, :, None], jnp.eye(pose.shape[1]), newton.local.pose_by),
        slope=jnp.where(none[:, :, None], 0.0, slopes(mode, newton.local)),
        load=jnp.where(none, 0.0, newton.load),
        gap=jnp.where(first.reaches, jnp.abs(at.x - first.x), jnp.inf),
        slipped=flow.slipped | slips,
        sliding=sliding,
        landing=landing,
        landing_x=landing_x,
        iterations=iterations,
        # Too many steps, or a far side that ends before it is reached.
        exhausted=(iterations > ITERATIONS) | missed,
        step=jnp.minimum(2 * flow.step, STEP),
        time_step=jnp.where(jnp.any(freed | fresh), 1e-3, flow.time_step),
    )
    return flow, Mode(phase, side, jnp.asarray(False)), z


LANDED = 1e-6  # by how much a slipped whisker's base and contact miss their place


def shortened(flow: Flow) -> Flow:
    """The flow before a step that a whisker could not follow: a shorter one is tried."""
    step, iterations = flow.step / 4, flow.iterations + 1
    return flow._replace(step=step, iterations=iterations, exhausted=(iterations > ITERATIONS) | (step < SHORTEST))


def at_rest(problem: Problem, flow: Flow, mode: Mode, solution: Solution, u: Scalar) -> Bool[Array, ""]:
    """Whether a stable equilibrium is near enough for Newton's method."""
    free = mode.phase == Phase.free
    known = jnp.all(free | _known(flow))
    slope = jnp.where(free[:, None, None], 0.0, flow.slope)
    pull = rest(problem, u) + yielding(problem, flow.load) - flow.pose
    moves = _displacement(problem, flow, pull, slope, jnp.asarray(0.0))
    steps = jnp.where(free[:, None], 0.0, _steps(flow, moves))
    near = jnp.max(jnp.maximum(jnp.abs(moves), jnp.abs(steps))) < flow.near
    settled = near & known & ~jnp.any(flow.sliding | flow.landing)
    own = jnp.all(free | held(mode, flow.pose_by[:, 0, 0]))
    return settled & own & definite(problem, slope)


def touching(at: Stance, side: PerWhisker) -> tuple[Contacts, Int[Array, " whiskers"], PerWhisker]:
    """Contacts, phases and sides of whiskers at their first touch from a side."""
    first = at.first(side)
    z = jnp.stack([jnp.zeros_like(first.slack), first.parameter, first.slack], axis=-1)
    return z, jnp.where(first.slack > 0, Phase.tangential, Phase.tip), first.side


def clear(at: Stance) -> Bool[Array, " whiskers"]:
    """Whether unloaded whiskers stand clear of the object."""
    right, left = at.right, at.left
    return ~right.reaches | (at.x > right.x) | (at.x < left.x)


def side_of(at: Stance) -> PerWhisker:
    """On which side of the object whiskers stand, or nearer to which."""
    return jnp.where(at.x - at.right.x >= at.left.x - at.x, 1.0, -1.0)


def _nonzero(x: PerWhisker) -> PerWhisker:
    return jnp.where(x == 0, 1.0, x)
