"""Deflection of one whisker under given loads: forces and moments at points along it.

The rod is integrated from the outermost load towards the base. The direction of the whisker at that load is the only
unknown, and the angle of the base is the only equation (Steigenberger 2013).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.jit import jit
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.implicit import without_rule
from jaxwhisker._model.loads import PointForce, PointMoment
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section

LOAD_STEPS = 32  # from no load to the full load, to follow the branch of solutions that begins at rest
STEPS = 32  # of the rod between two loads
RESIDUAL = 1e-8  # largest accepted error of the base's angle and position, by comparison with twice as many steps
CLAMPED = Support.clamped()


class Deflection(eqx.Module):
    """A deflected whisker: support reaction, pose of its base, and its shape at arc lengths s from the base.

    Values are in the units of the whisker. All of them are NaN unless `status` is `Status.ok`.

    Examples:
        >>> bent = jw.deflect(jw.Whisker(), jw.PointForce(1.0))
        >>> print(bent.status == jw.Status.ok, bent.x.shape)
        True (102,)
    """

    fx: Float[Array, ""]  # support reaction on the whisker: force along +x
    fy: Float[Array, ""]  # force along +y
    mz: Float[Array, ""]  # moment, force times length, counter-clockwise positive
    base_x: Float[Array, ""]  # position of the base, a length
    base_y: Float[Array, ""]
    base_angle: Float[Array, ""]  # to the upright, rad, counter-clockwise positive
    s: Float[Array, " points"]  # arc length from the base
    x: Float[Array, " points"]  # position, a length
    y: Float[Array, " points"]
    angle: Float[Array, " points"]  # from +x to the whisker's direction, rad; pi/2 at an upright base
    curvature: Float[Array, " points"]  # 1/length, counter-clockwise positive
    status: Int[Array, ""]  # Status.ok, .inexact or .invalid


class _Loads(eqx.Module):
    """Forces and moments in one form, sorted from the tip to the base; dimensionless."""

    force: Float[Array, " loads"]
    direction: Float[Array, " loads"]
    follower: Float[Array, " loads"]
    moment: Float[Array, " loads"]
    position: Float[Array, " loads"]


class _Base(eqx.Module):
    """Pose (x, y, angle) of the unloaded base, and its compliance to forces and moment; dimensionless."""

    rest: Float[Array, "3"]
    compliance: Float[Array, "3"] | None  # None for a clamp

    def angle(self, moment: Scalar) -> Scalar:
        """Angle to the upright under the moment of the whisker on the base."""
        return self.rest[2] if self.compliance is None else self.rest[2] + self.compliance[2] * moment

    def residual(self, cos: Scalar, sin: Scalar, moment: Scalar) -> Scalar:
        """Difference between the angle of the base and the whisker's angle for this direction at its base."""
        if self.compliance is None:
            # The sine of the difference is cheaper. It also vanishes at a half turn, which the final check detects.
            return cos * jnp.cos(self.rest[2]) + sin * jnp.sin(self.rest[2])
        return self.angle(moment) - jnp.arctan2(-cos, sin)

    def position(self, force_x: Scalar, force_y: Scalar) -> tuple[Scalar, Scalar]:
        """x and y under the forces of the whisker on the base."""
        x, y, _ = self.rest
        if self.compliance is None:
            return x, y
        return x + self.compliance[0] * force_x, y + self.compliance[1] * force_y


class _Problem(eqx.Module):
    """The dimensionless equations of one whisker and its loads."""

    loads: _Loads
    section: Section | None  # None for a uniform whisker
    base: _Base


def _problem_of(whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support) -> _Problem:
    section = None if whisker.uniform else whisker.section(whisker.length, whisker.base_stiffness)
    return _Problem(_sorted_loads(whisker, loads), section, _base_of(whisker, support))


def _sorted_loads(whisker: Whisker, loads: tuple[PointForce | PointMoment, ...]) -> _Loads:
    length, stiffness = whisker.length, whisker.base_stiffness
    rows = []
    for load in loads:
        position = 1.0 if load.position is None else load.position / length
        if isinstance(load, PointForce):
            size = load.force * length**2 / stiffness
            rows.append((size, load.direction, float(load.follower), 0.0, position))
        else:
            rows.append((0.0, 0.0, 0.0, load.moment * length / stiffness, position))
    columns = [jnp.stack([jnp.asarray(value, dtype=float) for value in column]) for column in zip(*rows, strict=True)]
    order = jnp.argsort(-columns[-1])
    return _Loads(*(column[order] for column in columns))


def _base_of(whisker: Whisker, support: Support) -> _Base:
    length, stiffness = whisker.length, whisker.base_stiffness
    mount, flexibility = support.mounts[0], support.flexibility()
    rest = jnp.stack([jnp.asarray(v, dtype=float) for v in (mount.x / length, mount.y / length, mount.angle)])
    if flexibility is None:
        return _Base(rest, None)
    framed = flexibility.in_frames(jnp.zeros(1), length, stiffness / length**2)
    return _Base(rest + framed.offset, jnp.diagonal(framed.matrix))


class _Stretch(eqx.Module):
    """A stretch of the rod between two loads, or between a load and the base, seen from its outer end."""

    start: rod.RodState
    load: rod.Load
    arc: Scalar
    position: Scalar  # of the outer end


def _stretches(problem: _Problem, tip_angle: Scalar, factor: Scalar, steps: int) -> tuple[list[_Stretch], rod.RodState]:
    """All stretches from the outermost load (the origin) to the base, and the state at the base."""
    loads, zero = problem.loads, jnp.zeros(())
    state = (zero, zero, jnp.cos(tip_angle), jnp.sin(tip_angle))
    total = rod.Load(zero, zero, zero)
    stretches = []
    ends = jnp.append(loads.position[1:], 0.0)
    for k in range(loads.force.shape[0]):
        total = _with_load(total, loads, k, state, factor)
        stretch = _Stretch(state, total, loads.position[k] - ends[k], loads.position[k])
        stretches.append(stretch)
        state = rod.integrate(state, stretch.arc, total, problem.section, steps=steps, from_base=loads.position[k])
    return stretches, state


def _with_load(total: rod.Load, loads: _Loads, k: int, state: rod.RodState, factor: Scalar) -> rod.Load:
    """The load on the rod between load k, which acts at this state, and the base."""
    x, y, cos, sin = state
    angle = loads.direction[k]
    turned_cos = jnp.sin(angle) * cos + jnp.cos(angle) * sin  # of angle + (phi - pi/2)
    turned_sin = jnp.sin(angle) * sin - jnp.cos(angle) * cos
    follower = loads.follower[k] > 0
    force = factor * loads.force[k]
    fx = force * jnp.where(follower, turned_cos, jnp.cos(angle))
    fy = force * jnp.where(follower, turned_sin, jnp.sin(angle))
    moment = total.moment + x * fy - y * fx + factor * loads.moment[k]  # pyright: ignore[reportOptionalOperand]
    return rod.Load(total.force_x + fx, total.force_y + fy, moment)  # pyright: ignore[reportOptionalOperand]


def _residual(tip_angle: Scalar, args: tuple[_Problem, Scalar]) -> Scalar:
    problem, factor = args
    stretches, (x, y, cos, sin) = _stretches(problem, tip_angle, factor, STEPS)
    return problem.base.residual(cos, sin, rod.moment(x, y, stretches[-1].load))


@eqx.filter_custom_jvp
def _differentiable(tip_angle: Scalar, problem: _Problem) -> Scalar:
    """The solved tip angle with its derivatives by the implicit function theorem (see implicit.py)."""
    return without_rule(tip_angle, problem)


@_differentiable.def_jvp
def _(primals, tangents):
    tip_angle, problem = primals
    _, problem_dot = tangents
    here, one = _differentiable(tip_angle, problem), jnp.asarray(1.0)
    slope = jax.jacfwd(_residual)(here, (problem, one))
    _, change = eqx.filter_jvp(lambda problem: _residual(here, (problem, one)), (problem,), (problem_dot,))
    return here, -change / slope


def _unloaded_angle(problem: _Problem) -> Scalar:
    """Direction of the unloaded whisker at the outermost load, which is not upright if the whisker is curved."""
    upright = jnp.asarray(jnp.pi / 2)
    if problem.section is None:
        return upright + problem.base.rest[2]
    _, (_, _, cos, sin) = _stretches(problem, upright, jnp.asarray(0.0), STEPS)
    return jnp.pi - jnp.arctan2(sin, cos) + problem.base.rest[2]


def _tip_angle(problem: _Problem) -> Scalar:
    """Direction of the whisker beyond the outermost load, on the branch of solutions that begins at rest."""
    newton = optx.Newton(rtol=1e-10, atol=1e-10)

    def solve(guess, factor):
        return optx.root_find(_residual, newton, guess, args=(problem, factor), max_steps=20, throw=False).value

    def increase(carry, factor):
        angle, change = carry
        solution = solve(angle + change, factor)
        return (solution, solution - angle), None

    factors = jnp.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:]
    (angle, _), _ = jax.lax.scan(increase, (_unloaded_angle(problem), jnp.asarray(0.0)), factors)
    return angle


def _solve(
    whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support
) -> tuple[Scalar, Int[Array, ""]]:
    """Direction of the tip, and the status."""
    problem = _problem_of(whisker, loads, support)
    position = problem.loads.position
    valid = whisker.valid() & support.valid() & jnp.all((position > 0) & (position <= 1))
    valid &= jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(problem.loads)]))
    tip_angle = _tip_angle(problem)
    error = _error(problem, tip_angle)
    return tip_angle, jnp.where(valid, jnp.where(error < RESIDUAL, Status.ok, Status.inexact), Status.invalid)


def _error(problem: _Problem, tip_angle: Scalar) -> Float[Array, ""]:
    """Largest error of the base's angle and position, by comparison with twice as many steps."""

    def at_base(steps):
        stretches, (x, y, cos, sin) = _stretches(problem, tip_angle, jnp.asarray(1.0), steps)
        turn = jnp.arctan2(-cos, sin)
        return turn - problem.base.angle(rod.moment(x, y, stretches[-1].load)), x, y

    (misfit, x, y), (fine_misfit, fine_x, fine_y) = at_base(STEPS), at_base(2 * STEPS)
    return jnp.max(jnp.abs(jnp.stack([misfit, fine_misfit, fine_x - x, fine_y - y])))


def deflect(
    whisker: Whisker, *loads: PointForce | PointMoment, support: Support = CLAMPED, points: int = 101
) -> Deflection:
    """Reaction and shape of a whisker under given loads, clamped at (0, 0) along +y or on a support.

    Loads are increased from zero in steps, and the solution is the one that begins at rest.

    Args:
        whisker: the whisker.
        *loads: at least one PointForce or PointMoment, in any order. Their directions refer to the upright whisker at
            rest, also if it is mounted at an angle; a dead load keeps its direction.
        support: support of one whisker, with the drive at (0, 0). Default: a clamp.
        points: number of points on each stretch between loads, and between a load and the base; at least 2.

    Returns:
        A Deflection. Its values are NaN with status `inexact` if the load is too large for the steps (beyond a few
        hundred EI/L^2), and NaN with status `invalid` if a traced parameter is outside its domain or a traced load is
        beyond the tip.

    Raises:
        ValueError: if an argument has the wrong type, there is no load, a load lies beyond the tip, the support is for
            several whiskers, `points` is less than 2, or JAX is in float32 mode.

    Examples:
        >>> bent = jw.deflect(jw.Whisker(), jw.PointForce(5.0, position=1.0, follower=True))
        >>> print(f"fx = {bent.fx:.4f}, fy = {bent.fy:.4f}, mz = {bent.mz:.4f}")
        fx = -2.5163, fy = 4.3207, mz = -2.9396
        >>> print(f"tip at ({bent.x[-1]:.3f}, {bent.y[-1]:.3f})")
        tip at (-0.781, 0.172)

    Source: Steigenberger (2013).
    """
    checks.float64_mode()
    checks.instance("whisker", whisker, Whisker, "a Whisker")
    if not loads or not all(isinstance(load, PointForce | PointMoment) for load in loads):
        checks.fail("loads", "one or more of PointForce and PointMoment", repr(loads))
    if not isinstance(support, Support) or support.whiskers != 1:
        checks.fail("support", "a Support of one whisker", repr(support))
    checks.count("points", points, least=2)
    for load in loads:
        if load.position is None or checks.is_traced((load.position, whisker)):
            continue
        if float(load.position) > float(whisker.length):
            checks.fail("position", f"at most the length {whisker.length}", load.position)
    whisker, loads, support = jax.tree.map(checks.as_float, (whisker, loads, support))
    return _deflect(whisker, loads, support, points)


@jit
def _deflect(
    whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support, points: int
) -> Deflection:
    tip_angle, status = _solve(*jax.lax.stop_gradient((whisker, loads, support)))
    ok = status == Status.ok
    whisker, loads, support = safe_placeholder((whisker, loads, support), ok)
    problem = _problem_of(whisker, loads, support)
    tip_angle = _differentiable(jnp.where(ok, tip_angle, jnp.pi / 2), problem)
    stretches, (x, y, _, _) = _stretches(problem, tip_angle, jnp.asarray(1.0), STEPS)
    load, shape = stretches[-1].load, _shape(problem, tip_angle, stretches, points)
    assert load.force_x is not None
    moment, (base_x, base_y) = rod.moment(x, y, load), problem.base.position(load.force_x, load.force_y)
    length, stiffness = whisker.length, whisker.base_stiffness

    def where_ok(value):
        return jnp.where(ok, value, jnp.nan)

    return Deflection(
        fx=where_ok(-load.force_x * stiffness / length**2),
        fy=where_ok(-load.force_y * stiffness / length**2),
        mz=where_ok(-moment * stiffness / length),
        base_x=where_ok(base_x * length),
        base_y=where_ok(base_y * length),
        base_angle=where_ok(problem.base.angle(moment)),
        s=where_ok(shape.s * length),
        x=where_ok((shape.x - x + base_x) * length),
        y=where_ok((shape.y - y + base_y) * length),
        angle=where_ok(jnp.unwrap(jnp.arctan2(shape.sin, shape.cos))),
        curvature=where_ok(shape.curvature / length),
        status=status,
    )


class _Shape(eqx.Module):
    """Points of the whisker from base to tip, dimensionless, relative to the outermost load."""

    s: rod.Along
    x: rod.Along
    y: rod.Along
    cos: rod.Along
    sin: rod.Along
    curvature: Scalar | rod.Along


def _shape(problem: _Problem, tip_angle: Scalar, stretches: list[_Stretch], points: int) -> _Shape:
    parts = [_loaded_shape(problem, stretch, points) for stretch in reversed(stretches)]
    # Beyond the outermost load the whisker is unloaded; a straight line needs two points.
    tip = _unloaded_shape(problem, tip_angle, 2 if problem.section is None else points)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts, tip)


def _loaded_shape(problem: _Problem, stretch: _Stretch, points: int) -> _Shape:
    line = rod.points(
        stretch.start, stretch.arc, stretch.load, problem.section, count=points, from_base=stretch.position
    )
    x, y, cos, sin = (values[::-1] for values in line)
    s = stretch.position - stretch.arc * jnp.linspace(1.0, 0.0, points)
    return _Shape(s, x, y, cos, sin, _curvature(problem, rod.moment(x, y, stretch.load), s))


def _unloaded_shape(problem: _Problem, tip_angle: Scalar, points: int) -> _Shape:
    """The shape beyond the outermost load, without the point of that load."""
    position, zero = problem.loads.position[0], jnp.zeros(())
    start, nothing = (zero, zero, jnp.cos(tip_angle), jnp.sin(tip_angle)), rod.Load(None, zero, None)
    line = rod.points(start, position - 1.0, nothing, problem.section, count=points, from_base=position)
    x, y, cos, sin = (values[1:] for values in line)
    s = jnp.linspace(position, 1.0, points)[1:]
    return _Shape(s, x, y, cos, sin, _curvature(problem, jnp.zeros(points - 1), s))


def _curvature(problem: _Problem, moment: Scalar | rod.Along, s: rod.Along) -> Scalar | rod.Along:
    return moment if problem.section is None else jax.vmap(problem.section.total_curvature)(moment, s)
