"""The rod: a planar elastica, integrated from a loaded point back to its base.

The load is known at the start of the integration. Therefore the internal moment is an affine function of position, the
state is (x, y, cos phi, sin phi), and the right-hand side is a polynomial:

    dx/ds = cos phi,  dy/ds = sin phi,  dphi/ds = kappa = kappa0 + (M0 - x Fy + y Fx) / EI.

The position changes with the angle only, and the angle with the position only. This suits Runge-Kutta-Nystroem
splittings: shifts at constant direction alternate with rotations at constant moment. If EI or kappa0 depends on s, then
s is advanced together with the position. Where they jump or have kinks, steps end.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeAlias

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar

RodState: TypeAlias = tuple[Scalar, Scalar, Scalar, Scalar]  # x, y, cos phi, sin phi
Along: TypeAlias = Float[Array, " points"]  # one value per point of the rod
RodStates: TypeAlias = tuple[Along, Along, Along, Along]  # the same at several points
AlongRod: TypeAlias = Scalar | Callable[[Any], Any]  # a number, or a function of the arc length from the base


class Section(eqx.Module):
    """Bending stiffness and intrinsic curvature along a rod that is not uniform, in given units of length and EI."""

    bending_stiffness: AlongRod  # in the scene's units
    intrinsic_curvature: AlongRod | None  # in the scene's units, 1/length
    length_unit: Scalar  # in the scene's units
    stiffness_unit: Scalar  # of EI, in the scene's units
    orientation: Scalar = 1.0  # -1.0 for the mirror image
    breaks: Along | None = None  # arc lengths at which EI or curvature jumps or has a kink, in the scene's units
    mass_per_length: AlongRod | None = None  # in the scene's units; None if its weight does not matter

    def stiffness(self, s: Scalar) -> Float[Array, ""]:
        """EI at the arc length s from the base."""
        return at_arc(self.bending_stiffness, s * self.length_unit) / self.stiffness_unit

    def curvature(self, s: Scalar) -> Scalar:
        """Intrinsic curvature at the arc length s from the base."""
        if self.intrinsic_curvature is None:
            return 0.0
        return self.orientation * at_arc(self.intrinsic_curvature, s * self.length_unit) * self.length_unit

    def mass(self, s: Scalar) -> Float[Array, ""]:
        """Mass per length at the arc length s from the base, in the scene's units."""
        return at_arc(0.0 if self.mass_per_length is None else self.mass_per_length, s * self.length_unit)

    def total_curvature(self, moment: Scalar, s: Scalar) -> Scalar:
        """Curvature under a moment; a point without stiffness carries no moment and keeps its intrinsic curvature."""
        stiffness = self.stiffness(s)
        stiff = stiffness > 0
        return jnp.where(stiff, moment / jnp.where(stiff, stiffness, 1.0), 0.0) + self.curvature(s)

    def break_times(self, arc: Scalar, from_base: Scalar) -> Along:
        """Breaks as fractions of an arc towards the base; also those outside the arc, below 0 or above 1."""
        assert self.breaks is not None
        return (from_base - self.breaks / self.length_unit) / jnp.where(arc == 0, 1.0, arc)


def at_arc(value: AlongRod, s: Scalar) -> Float[Array, ""]:
    """Value at an arc length of a quantity that is given as a number or a function."""
    return jnp.asarray(value(s) if callable(value) else value, dtype=float)


class Load(eqx.Module):
    """Load on the rod at and beyond the start of the integration: force, moment about the origin; None if absent."""

    force_x: Scalar | Float[Array, "*batch"] | None  # stacked for several rods, or for the segments of one
    force_y: Scalar | Float[Array, "*batch"]
    moment: Scalar | Float[Array, "*batch"] | None


Material: TypeAlias = Scalar | Section | None  # bending stiffness, or the section of a non-uniform rod; None: EI = 1


class _RodArgs(eqx.Module):
    arc: Scalar
    load: Load
    material: Material
    from_base: Scalar | None  # arc length from the base to the start of the integration; None for a uniform rod
    between: tuple[Scalar, Scalar] | None = None  # breaks below and above the step; None without breaks


def moment(x: Scalar | Along, y: Scalar | Along, load: Load) -> Scalar | Along:
    """The internal moment M0 - x Fy + y Fx at (x, y)."""
    # This is evaluated in the innermost loop of the package: absent loads must cost nothing.
    total = -x * load.force_y
    total = total if load.force_x is None else total + y * load.force_x
    return total if load.moment is None else total + load.moment


def _towards_base(t, state: RodState, args: _RodArgs) -> RodState:
    x, y, cos, sin = state
    bent = moment(x, y, args.load)
    if isinstance(args.material, Section):
        assert args.from_base is not None
        s = args.from_base - t * args.arc
        s = s if args.between is None else one_sided(s, *args.between)
        bent = args.material.total_curvature(bent, s)
    elif args.material is not None:
        bent = bent / args.material
    turn = args.arc * bent
    return -args.arc * cos, -args.arc * sin, turn * sin, -turn * cos


def _cos_sin(angle: Scalar) -> tuple[Scalar, Scalar]:
    # With 8 steps, a stage turns by at most 0.2 rad, where these Taylor polynomials are accurate to 1e-14 (1e-12 with 4
    # steps). Inside a fused loop they are three times cheaper than the library functions.
    u = angle * angle
    cos = 1 + u * (-1 / 2 + u * (1 / 24 + u * (-1 / 720 + u * (1 / 40320 - u / 3628800))))
    sin = angle * (1 + u * (-1 / 6 + u * (1 / 120 + u * (-1 / 5040 + u / 362880))))
    return cos, sin


def _symmetric(half: list[float], total: float, middle: bool) -> list[float]:
    # The coefficients are a palindrome with the sum `total`; `half` is one side without the innermost entry.
    inner = total - 2 * sum(half) if middle else total / 2 - sum(half)
    return [*half, inner, *([] if middle else [inner]), *half[::-1]]


# For each number of rotations: fractions of a step for shifts and rotations, which alternate, starting with a shift.
METHODS = {
    6: (
        _symmetric([0.0829844064174052, 0.396309801498368, -0.0390563049223486], total=1.0, middle=True),
        _symmetric([0.245298957184271, 0.604872665711080], total=1.0, middle=False),
    ),
    10: (
        _symmetric(
            [0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780],
            total=1.0,
            middle=True,
        ),
        _symmetric(
            [0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175],
            total=1.0,
            middle=False,
        ),
    ),
    11: (
        _symmetric(
            [0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879],
            total=1.0,
            middle=False,
        ),
        _symmetric(
            [0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928],
            total=1.0,
            middle=True,
        ),
    ),
}


# Points of a step of the default method for sections at which it evaluates stiffness and curvature, and their weights.
NODES, NODE_WEIGHTS = np.cumsum(METHODS[10][0])[:-1], np.array(METHODS[10][1])


class Splitting(diffrax.AbstractSolver):
    """Splitting methods for rods: alternating shifts and rotations, of order 4 (6 rotations) or order 6 (10 or 11).

    A stage is a dozen operations on a state that stays in registers, and the stages run as a loop. Compared with an
    eighth-order Runge-Kutta step with unrolled stages, this compiles ten times faster and runs two to four times faster
    at the same error. Rotations preserve cos^2 + sin^2 = 1.

    Args:
        stages: number of rotations per step: 6, 10 or 11. The order of the methods with 6 and 11 requires a moment that
            is linear in position; for sections that change along the rod they converge with order 4 only.

    Raises:
        ValueError: if `stages` is not 6, 10 or 11.

    Source: Blanes and Moan (2002), J. Comput. Appl. Math. 142, 313, methods SRKN 6 (order 4), S 10 and SRKN 11 (both
    of order 6).
    """

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar[Callable[..., Any]] = diffrax.LocalLinearInterpolation

    stages: int = eqx.field(static=True, default=11)

    def __check_init__(self):
        if self.stages not in METHODS:
            checks.fail("stages", "6, 10 or 11", repr(self.stages))

    def order(self, terms):
        del terms
        return {6: 4, 10: 6, 11: 6}[self.stages]

    def init(self, terms, t0, t1, y0, args):
        del terms, t0, t1, y0, args
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump
        h = t1 - t0

        def shift(state, fraction):
            x, y, cos, sin = state
            dx, dy, _, _ = terms.vf(t0, state, args)
            return x + fraction * h * dx, y + fraction * h * dy, cos, sin

        def rotate(state, fraction, passed):
            x, y, cos, sin = state
            # The rate does not depend on the direction; for (cos, sin) = (1, 0) it is d sin / dt.
            *_, rate = terms.vf(t0 + passed * h, (x, y, 1.0, 0.0), args)
            c, s = _cos_sin(fraction * h * rate)
            return x, y, cos * c - sin * s, sin * c + cos * s

        def stage(state, fractions):
            rotation, passed, next_shift = fractions
            return shift(rotate(state, rotation, passed), next_shift), None

        shifts, rotations = METHODS[self.stages]
        passed = np.cumsum(shifts)[:-1]  # time advances with the position
        stages = tuple(jnp.asarray(fractions) for fractions in (rotations, passed, shifts[1:]))
        y1, _ = jax.lax.scan(stage, shift(y0, shifts[0]), stages)
        return y1, None, dict(y0=y0, y1=y1), None, diffrax.RESULTS.successful


def default_solver(material: Material) -> Splitting:
    """The splitting of order 6 that suits the material: S 10 for a section, otherwise SRKN 11."""
    return Splitting(10 if isinstance(material, Section) else 11)


def integrate(
    start: RodState,
    arc: Scalar,
    load: Load,
    material: Material = None,
    *,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    from_base: Scalar | None = None,
) -> RodState:
    """State of the rod at an arc length `arc` from `start` towards the base.

    The number of steps is fixed: an adaptive controller would wait for the slowest element of a batch and add noise to
    the residual of a Newton solve.

    Args:
        start: state (x, y, cos phi, sin phi) at the loaded point.
        arc: arc length between the loaded point and the end; negative to integrate away from the base.
        load: load at the loaded point and beyond.
        material: bending stiffness, or the section of a rod that is not uniform.
        steps: number of steps.
        solver: any diffrax solver. Default: `default_solver(material)`.
        from_base: arc length from the base to the loaded point; required for a section.
    """
    times = step_ends(arc, material, steps=steps, from_base=from_base)
    end, _ = _march(start, _RodArgs(arc, load, material, from_base), times, solver or default_solver(material))
    return end


def step_ends(
    arc: Scalar, material: Material, *, steps: int, from_base: Scalar | None = None
) -> Float[Array, " points"]:
    """Ends of integration steps as fractions of the arc length: equidistant, but for sections closer where thinner.

    They do not include the breaks of a section: see `with_breaks`.
    """
    times = jnp.arange(steps + 1) / steps
    if not isinstance(material, Section):
        return times
    assert from_base is not None
    return graded(times, material.stiffness(from_base), material.stiffness(from_base - arc))


def has_breaks(material: Material) -> bool:
    """Whether the stiffness or the curvature of a rod jumps or has kinks."""
    return isinstance(material, Section) and material.breaks is not None


MEETING = 1e-6  # lengths of the scene: breaks closer to the end of an arc lie where two arcs may meet
INWARDS = 1e-12  # lengths of the scene: above rounding, and without effect on the error of a step


class Steps(NamedTuple):
    """Integration steps that end at the breaks of a section."""

    times: Float[Array, " ends"]  # fractions of the arc, including the breaks
    place: Int[Array, " times"] | None  # of the given times among them; None without breaks
    between: tuple[Along, Along] | None  # breaks below and above each step, infinite if there are none


def with_breaks(times: Float[Array, " times"], arc: Scalar, material: Material, from_base: Scalar | None) -> Steps:
    """Steps that end at these fractions of an arc and at breaks. Breaks outside the arc make steps of no length.

    Derivatives with respect to the position of a break pass through the end of steps there. A break where two arcs meet
    belongs to both of them by half, also if rounding puts it into one of them, both or neither.
    """
    if not (isinstance(material, Section) and material.breaks is not None):
        return Steps(times, None, None)
    assert from_base is not None
    s, own = material.breaks / material.length_unit, material.break_times(arc, from_base)
    low, high = jnp.minimum(from_base, from_base - arc), jnp.maximum(from_base, from_base - arc)
    inside = jnp.clip((s - low) / MEETING + 0.5, 0.0, 1.0) * jnp.clip((high - s) / MEETING + 0.5, 0.0, 1.0)
    inside, constant = jax.lax.stop_gradient((inside, own))
    clipped = jnp.clip(constant, times[0], times[-1]) + inside * (own - constant)
    # Breaks come after the first time and before the last one, and each of them separates the steps beside it.
    key = jnp.concatenate([times.at[0].set(-jnp.inf).at[-1].set(jnp.inf), constant])
    order = jnp.argsort(jax.lax.stop_gradient(key))
    passed = jnp.cumsum(order >= times.size)[:-1]
    far = jnp.where(arc < 0, -jnp.inf, jnp.inf)
    ascending = jnp.sort(jax.lax.stop_gradient(s))
    ordered = jnp.concatenate([far[None], jnp.where(arc < 0, ascending, ascending[::-1]), -far[None]])
    ends = ordered[passed], ordered[passed + 1]
    return Steps(
        jnp.concatenate([times, clipped])[order],
        jnp.argsort(order)[: times.size],
        (jnp.minimum(*ends), jnp.maximum(*ends)),
    )


def one_sided(s: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """A point of a step, moved off breaks at its ends: there, functions that jump must have the values of this side."""
    # No whisker has negative arc lengths, where functions may be undefined.
    return s + jax.lax.stop_gradient(jnp.clip(s, low + INWARDS, jnp.maximum(high - INWARDS, 0.0)) - s)


def _march(
    start: RodState, args: _RodArgs, times: Float[Array, " times"], solver: diffrax.AbstractSolver, keep: bool = False
) -> tuple[RodState, Any]:
    """The last state, and those at all times if they are kept. `times` are fractions of the arc length."""
    # The rate of change at the end of a step before a break is not that at the beginning of the next one.
    terms, breaks = diffrax.ODETerm(_towards_base), has_breaks(args.material)
    jumps = jnp.asarray(breaks)
    if isinstance(solver, diffrax.AbstractRungeKutta) and solver.scan_kind is None:
        # This loop over stages supports forward derivatives only, and no others are taken through a rod.
        solver = dataclasses.replace(solver, scan_kind="lax")
    times, place, between = with_breaks(times, args.arc, args.material, args.from_base)

    def step(carry, ends):
        state, memory = carry
        t0, t1, between = ends
        within = dataclasses.replace(args, between=between)
        state, _, _, memory, _ = solver.step(terms, t0, t1, state, within, memory, jumps)
        return (state, memory), state if keep else None

    start = jax.tree.map(jnp.asarray, start)
    first = dataclasses.replace(args, between=jax.tree.map(lambda leaf: leaf[0], between))
    memory = solver.init(terms, times[0], times[1], start, first)
    (end, _), states = jax.lax.scan(step, (start, memory), (times[:-1], times[1:], between))
    if keep:
        states = jax.tree.map(jnp.append, start, states)
        states = states if place is None else jax.tree.map(lambda leaf: leaf[place], states)
    return end, states


THICKEST = 100.0  # steps are graded for a ratio of thicknesses of at most this


def graded(times: Float[Array, "*times"], first: Scalar, last: Scalar) -> Float[Array, "*times"]:
    """Step boundaries such that the thickness of a conical rod changes by the same ratio in each step."""
    # Thickness is the fourth root of stiffness. No derivative: the solution does not depend on the boundaries.
    first, last = jax.lax.stop_gradient((first, last))
    ratio = (last / jnp.where(first > 0, first, last)) ** (1 / 4)
    ratio = jnp.where(first > 0, jnp.clip(ratio, 1 / THICKEST, THICKEST), THICKEST)
    growth = jnp.log(ratio)
    even = jnp.abs(growth) < 1e-6
    growth = jnp.where(even, 1.0, growth)
    return jnp.where(even, times, jnp.expm1(times * growth) / jnp.expm1(growth))


def points(
    start: RodState,
    arc: Scalar,
    load: Load,
    material: Material,
    *,
    count: int | None = None,
    at: Along | None = None,
    solver: diffrax.AbstractSolver | None = None,
    from_base: Scalar | None = None,
) -> RodStates:
    """States x, y, cos phi, sin phi at points from `start` on, over `arc` towards the base.

    They are `count` equidistant points, or those at the fractions `at` of the arc, which begin with 0. Other arguments
    are those of `integrate`.
    """
    args = _RodArgs(arc, load, material, from_base)
    if at is None:
        assert count is not None
        at = jnp.linspace(0.0, 1.0, count)
    _, states = _march(start, args, at, solver or default_solver(material), keep=True)
    return states
