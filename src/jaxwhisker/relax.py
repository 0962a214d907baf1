"""Relaxation: the overdamped flow of the bases at a fixed drive, which decides what follows a loss of stability.

Base i moves with the velocity force_x_i - [K (base_x - rest)]_i. Its whisker stays on its clamped branch and slips when
it passes a fold. It is then free if its unloaded shape clears the object. Else it slides on along the branch until it
is held again at the same base position, as beneath the edge of a flat object; where its base is unbent before that, it
lands on the far side, bent the other way. Written with the flexibility C = K^-1 and one implicit step of pseudo-time
dt,

    (1 + C / dt - C D) dx = rest + C force_x - base_x,        D = d force_x / d base_x,

which holds for rigid springs too. Where the bases run away faster than dt resolves, the matrix is not definite: what
destabilises (D > 0) is then taken explicitly, and the next dt is shorter. (Always explicitly would not do: just below a
critical stiffness the bases creep, by a millionth of the way a step.)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker import contact
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Phase
from jaxwhisker.equilibrium import (
    BRANCH_SIGN,
    Contacts,
    Mode,
    PerWhisker,
    Point,
    Solution,
    rest,
    scale_of,
    stable,
    yielding,
)
from jaxwhisker.linear import positive_definite, solve
from jaxwhisker.scene import Problem

STEP = 0.02  # largest change of any contact, in its scale; the flow is first order in it
SHORTEST = 1e-7  # ... tried where a whisker cannot follow a longer one
NEAR = 0.02  # Newton's method takes over where it would go less than this
ITERATIONS = 3000
NO_FORCE = 1e-9  # a contact that has just begun has none but rounding


class Flow(NamedTuple):
    """State of the relaxation between two iterations of the march."""

    base_x: PerWhisker
    guess: Contacts
    tangent: Contacts  # each whisker's branch, and how base and force move along it
    by_x: PerWhisker
    by_force: PerWhisker
    force_x: PerWhisker
    step: Scalar  # largest change of any contact
    time_step: Scalar
    slipped: Bool[Array, " whiskers"]
    sliding: Bool[Array, " whiskers"]  # past a fold of its branch
    landing: Bool[Array, " whiskers"]  # on the far side
    landing_x: PerWhisker  # where either has to end
    near: Scalar  # step below which Newton's method takes over
    iterations: Int[Array, ""]
    exhausted: Bool[Array, ""]


def start(mode: Mode, base_x: PerWhisker) -> Flow:
    """A flow about to begin."""
    none = jnp.zeros_like(base_x)
    no = jnp.zeros(base_x.shape, bool)
    z = jnp.zeros((*base_x.shape, 3))
    return Flow(
        base_x,
        z,
        z,
        none + 1.0,
        none,
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


def kick(flow: Flow, point: Point, tangent: Point, tangent_x: PerWhisker) -> Flow:
    """The first step: on along the path that has just turned unstable, the drive at rest."""
    length = jnp.sqrt(jnp.sum((tangent.z / scale_of(point.z)) ** 2))
    step = flow.step / jnp.maximum(length, 1e-3)
    return flow._replace(guess=point.z + step * tangent.z, base_x=flow.base_x + step * tangent_x)


def propose(problem: Problem, flow: Flow, mode: Mode, point: Point) -> Flow:
    """The next step of the bases, and where it takes the contacts."""
    n = flow.base_x.shape[0]
    free = mode.phase == Phase.free
    slope = jnp.where(free, 0.0, flow.by_force / _nonzero(flow.by_x))
    pull = rest(problem, point.u) + yielding(problem, flow.force_x) - flow.base_x
    resolved = jnp.asarray(True)
    if problem.flexibility is None:
        dx = pull
    else:
        matrix, root = problem.flexibility.matrix, problem.flexibility.root
        growth = (slope - 0.5 / flow.time_step)[:, None, None]  # by half of what dt damps: well conditioned
        resolved = positive_definite(jnp.eye(n) - jnp.sum(root[:, :, None] * growth * root[:, None, :], axis=0))
        slope = jnp.where(resolved, slope, jnp.minimum(slope, 0.0))
        dx = solve(jnp.eye(n) + matrix / flow.time_step - matrix * slope, pull[:, None])[:, 0]
    # A whisker slips at once, and the others wait.
    slipping = flow.sliding | flow.landing
    slipping_now = jnp.any(slipping)
    along = jnp.where(free, 0.0, dx / _nonzero(flow.by_x))
    # A free base may go half-way to where its whisker would touch.
    first = jnp.where(mode.side > 0, problem.touch_right.x, problem.touch_left.x)
    reach = flow.step + jnp.where(problem.reaches, 0.5 * jnp.abs(flow.base_x - first), jnp.inf)
    size = jnp.max(jnp.where(free, jnp.abs(dx) / reach, jnp.abs(along) / flow.step))
    share = jnp.minimum(1.0, 1 / jnp.maximum(size, 1e-300))
    to_land = jnp.clip((flow.landing_x - flow.base_x) / _nonzero(flow.by_x), -flow.step, flow.step)
    to_land = jnp.where(flow.sliding & ~_holds(mode, flow.by_x), flow.step, to_land)
    along = jnp.where(slipping_now, jnp.where(slipping, to_land, 0.0), share * along)
    dx = jnp.where(slipping_now, 0.0, share * dx)
    longer = jnp.where(resolved, jnp.where(share < 1, 0.7, 1.4), 0.25)
    return flow._replace(
        guess=point.z + flow.tangent * along[:, None],
        base_x=flow.base_x + jnp.where(free, dx, 0.0),
        time_step=flow.time_step * jnp.where(slipping_now, 1.0, longer),
    )


def advance(problem: Problem, flow: Flow, mode: Mode, solution: Solution) -> tuple[Flow, Mode, Contacts]:
    """Take the solved step: phases that change, contacts that end or begin, whiskers that slip."""
    newton, z = solution.newton, solution.point.z
    free = mode.phase == Phase.free
    base_x = jnp.where(free, flow.base_x, newton.base_x)
    phase = jnp.where(free, Phase.free, jnp.where(z[:, 2] > 0, Phase.tangential, Phase.tip))
    turned = (phase != mode.phase) & ~free

    slipping, holds = flow.sliding | flow.landing, _holds(mode, newton.local.by_x)
    ends = ~free & ~slipping & (z[:, 0] < -NO_FORCE)
    slips = ~free & ~slipping & ~ends & ~holds
    right, left = problem.touch_right.x, problem.touch_left.x
    clears = contact.clear(base_x, right, left)
    freed = ends | (slips & clears)
    slides = slips & ~clears
    at = jax.vmap(problem.profile.point)(z[:, 1])
    unbent = mode.side * ((at.x - base_x) * at.cos + at.y * at.sin) <= 0
    lands = flow.sliding & (unbent | (z[:, 0] < 0))
    begins = free & problem.reaches & (mode.side * (base_x - jnp.where(mode.side > 0, right, left)) < 0)

    side = jnp.where(slips & clears, jnp.where(base_x > right, 1.0, -1.0), jnp.where(lands, -mode.side, mode.side))
    z, phase = jnp.where(freed[:, None], 0.0, z), jnp.where(freed, Phase.free, phase)
    fresh = begins | lands
    z, phase = enter_contact(problem, side, fresh, z, phase)
    landing_x = jnp.where(slides, base_x, flow.landing_x)
    base_x = jnp.where(fresh, jnp.where(side > 0, right, left), base_x)
    astray = jnp.abs(landing_x - base_x) > LANDED * jnp.minimum(jnp.abs(newton.local.by_x), 1.0)
    sliding = ((flow.sliding & (astray | ~holds)) | slides) & ~lands
    landing = (flow.landing & astray) | lands

    iterations = flow.iterations + 1
    missed = jnp.any(flow.landing & ~holds & ~fresh & (z[:, 0] > 0))
    flow = flow._replace(
        base_x=base_x,
        # Where a phase has just begun the branch's direction is not known yet: first its point is solved for.
        tangent=jnp.where((fresh | turned)[:, None], 0.0, newton.local.tangent),
        by_x=jnp.where(fresh | freed, 1.0, newton.local.by_x),
        by_force=jnp.where(fresh | freed, 0.0, newton.local.by_force),
        force_x=jnp.where(fresh | freed, 0.0, newton.force_x),
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


def _holds(mode: Mode, by_x: PerWhisker) -> Bool[Array, " whiskers"]:
    # Along its branch a whisker's base moves as it did from first touch on; between two folds it moves back.
    return mode.side * by_x * BRANCH_SIGN > 0


LANDED = 1e-6  # by how much a slipped whisker's base and contact miss their place


def shortened(flow: Flow) -> Flow:
    """The flow before a step that a whisker could not follow: a shorter one is tried."""
    step, iterations = flow.step / 4, flow.iterations + 1
    return flow._replace(step=step, iterations=iterations, exhausted=(iterations > ITERATIONS) | (step < SHORTEST))


def at_rest(problem: Problem, flow: Flow, mode: Mode, solution: Solution, u: Scalar) -> Bool[Array, ""]:
    """Whether a stable equilibrium is near enough for Newton's method."""
    free = mode.phase == Phase.free
    known = jnp.all(free | jnp.any(flow.tangent != 0, axis=-1))
    slope = jnp.where(free, 0.0, flow.by_force / _nonzero(flow.by_x))
    pull = rest(problem, u) + yielding(problem, flow.force_x) - flow.base_x
    if problem.flexibility is None:
        dx = pull
    else:
        n = pull.shape[0]
        dx = solve(jnp.eye(n) - problem.flexibility.matrix * slope, pull[:, None])[:, 0]
    near = jnp.max(jnp.maximum(jnp.abs(dx), jnp.abs(jnp.where(free, 0.0, dx / _nonzero(flow.by_x))))) < flow.near
    local = solution.newton.local._replace(by_x=flow.by_x, by_force=flow.by_force)
    return near & known & ~jnp.any(flow.sliding | flow.landing) & stable(problem, mode, local)


def enter_contact(
    problem: Problem, side: PerWhisker, entering: Bool[Array, " whiskers"], z: Contacts, phase: Int[Array, " whiskers"]
) -> tuple[Contacts, Int[Array, " whiskers"]]:
    """Contacts and phases with the entering whiskers at their first touch from their side."""
    touch = jax.tree.map(lambda right, left: jnp.where(side > 0, right, left), problem.touch_right, problem.touch_left)
    touched = jnp.stack([jnp.zeros_like(touch.slack), touch.parameter, touch.slack], axis=-1)
    how = jnp.where(touch.slack > 0, Phase.tangential, Phase.tip)
    return jnp.where(entering[:, None], touched, z), jnp.where(entering, how, phase)


def _nonzero(x: PerWhisker) -> PerWhisker:
    return jnp.where(x == 0, 1.0, x)
