"""Deflection of one whisker under given loads: forces and moments at points along it.

The rod is integrated from the outermost load towards the base. The direction of the whisker at that load is the only
unknown, and the angle of the base is the only equation (Steigenberger 2013). With springs on the shaft, there are
three unknowns: see deflect_held.py.
"""

from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.implicit import without_rule
from jaxwhisker._model.loads import PointForce, PointMoment
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section
from jaxwhisker._scan.applied_loads import Loads, sorted_loads, with_load
from jaxwhisker._scan.deflect_held import differentiable, errors, held_equations, held_state, solved_tip, unbent_tip

LOAD_STEPS = 32  # from no load to the full load, to follow the branch of solutions that begins at rest
ROD_STEPS = 32  # of the rod between two loads
ACCURACY = 1e-8  # largest accepted error of the base's angle and position, by comparison with twice as many steps
CLAMP = Support.clamped()

Given: TypeAlias = tuple[PointForce | PointMoment, ...]


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
    spring_length: Float[Array, " springs"]  # length of each spring, or angle of a torsion spring, as in a Result
    status: Int[Array, ""]  # Status.ok, .inexact or .invalid
    whisker: Whisker
    loads: tuple[PointForce | PointMoment, ...]
    support: Support


class _Equations(eqx.Module):
    """The dimensionless equations of one whisker and its loads."""

    loads: Loads
    section: Section | None  # None for a uniform whisker
    rest: Float[Array, "3"]  # pose (x, y, angle to the upright) of the unloaded base
    compliance: Float[Array, "3"]  # of the base to forces and moment; zero for a clamp


def _equations_of(whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support) -> _Equations:
    length, stiffness = whisker.length, whisker.base_stiffness
    section = None if whisker.uniform else whisker.section(length, stiffness)
    mount, flexibility = support.mounts[0], support.flexibility()
    rest, compliance = jnp.array([mount.x / length, mount.y / length, mount.angle], dtype=float), jnp.zeros(3)
    if flexibility is not None:
        framed = flexibility.in_frames(jnp.zeros(1), length, stiffness / length**2)
        rest, compliance = rest + framed.offset, jnp.diagonal(framed.matrix)
    return _Equations(sorted_loads(whisker, loads), section, rest, compliance)


class _Stretch(eqx.Module):
    """A stretch of the rod between two loads, or between a load and the base, seen from its outer end."""

    start: rod.RodState
    load: rod.Load
    arc: Scalar
    position: Scalar  # of the outer end


class _Bent(NamedTuple):
    """A whisker under its loads, for some direction of its tip."""

    stretches: _Stretch  # leading axis: stretches from the outermost load, the origin, to the base
    x: Scalar  # position of the base
    y: Scalar
    load: Float[Array, "3"]  # forces and moment on the base
    pose: Float[Array, "3"]  # of the base under this load, in the scene
    misfit: Scalar  # angle of the base minus that of the whisker there


def _bend(equations: _Equations, tip_angle: Scalar, factor: Scalar = 1.0, steps: int = ROD_STEPS) -> _Bent:
    """Integrate from the outermost load to the base, under `factor` times the loads."""
    loads, zero = equations.loads, jnp.zeros(())

    def stretch(carry, load_and_end):
        (state, total), (load, end) = carry, load_and_end
        total = with_load(total, load, state, factor)
        here = _Stretch(state, total, load.position - end, load.position)
        state = rod.integrate(state, here.arc, total, equations.section, steps=steps, from_base=here.position)
        return (state, total), here

    start = (zero, zero, jnp.cos(tip_angle), jnp.sin(tip_angle)), rod.Load(zero, zero, zero)
    ends = jnp.append(loads.position[1:], 0.0)
    ((x, y, cos, sin), total), stretches = jax.lax.scan(stretch, start, (loads, ends))
    load = jnp.stack([total.force_x, total.force_y, rod.moment(x, y, total)])  # pyright: ignore[reportArgumentType]
    pose = equations.rest + equations.compliance * load
    return _Bent(stretches, x, y, load, pose, pose[2] - jnp.arctan2(-cos, sin))


@eqx.filter_custom_jvp
def _differentiable(tip_angle: Scalar, equations: _Equations) -> Scalar:
    """The solved tip angle with its derivatives by the implicit function theorem (see implicit.py)."""
    return without_rule(tip_angle, equations)


@_differentiable.def_jvp
def _(primals, tangents):
    tip_angle, equations = primals
    _, equations_dot = tangents
    here = _differentiable(tip_angle, equations)
    slope = jax.jacfwd(lambda angle: _bend(equations, angle).misfit)(here)
    _, change = eqx.filter_jvp(lambda equations: _bend(equations, here).misfit, (equations,), (equations_dot,))
    return here, -change / slope


def _tip_angle(equations: _Equations) -> Scalar:
    """Direction of the whisker beyond the outermost load, on the branch of solutions that begins at rest."""
    newton = optx.Newton(rtol=1e-10, atol=1e-10)

    def increase(carry, factor):
        angle, change = carry
        solution = optx.root_find(
            lambda angle, _: _bend(equations, angle, factor).misfit, newton, angle + change, max_steps=20, throw=False
        ).value
        return (solution, solution - angle), None

    upright = jnp.asarray(jnp.pi / 2)
    unloaded = upright + _bend(equations, upright, 0.0).misfit  # not upright if the whisker is curved or mounted so
    factors = jnp.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:]
    (angle, _), _ = jax.lax.scan(increase, (unloaded, jnp.asarray(0.0)), factors)
    return angle


def _solution(whisker: Whisker, loads: Given, support: Support) -> tuple[Array, Int[Array, ""]]:
    """Direction of the tip, or its pose if springs hold the shaft; and the status."""
    valid = whisker.valid() & support.valid()
    if support.on_shafts:
        held, _ = held_equations(whisker, loads, support)
        tip, position = solved_tip(held, LOAD_STEPS, ROD_STEPS), held.loads.position
        given, missed = held.loads, errors(held, tip, ROD_STEPS)
        valid &= jnp.all(jnp.stack([jnp.asarray(place) < whisker.length for _, _, place in support.attachments()]))
    else:
        equations = _equations_of(whisker, loads, support)
        given, position, tip = equations.loads, equations.loads.position, _tip_angle(equations)
        coarse, fine = (_bend(equations, tip, steps=steps) for steps in (ROD_STEPS, 2 * ROD_STEPS))
        missed = jnp.stack([coarse.misfit, fine.misfit, fine.x - coarse.x, fine.y - coarse.y])
    valid &= jnp.all((position > 0) & (position <= 1)) & checks.all_finite(given)
    exact = jnp.max(jnp.abs(missed)) < ACCURACY
    return jnp.asarray(tip), jnp.where(valid, jnp.where(exact, Status.ok, Status.inexact), Status.invalid)


@with_own_settings
def deflect(
    whisker: Whisker, *loads: PointForce | PointMoment, support: Support = CLAMP, points: int = 101
) -> Deflection:
    """Reaction and shape of a whisker under given loads, clamped at (0, 0) along +y or on a support.

    Loads are increased from zero in steps, and the solution is the one that begins at rest.

    Args:
        whisker: the whisker.
        *loads: at least one PointForce or PointMoment, in any order. Their directions refer to the upright whisker at
            rest, also if it is mounted at an angle; a dead load keeps its direction.
        support: support of one whisker, with the drive at (0, 0). Default: a clamp. Springs on the shaft grow from zero
            before the loads do. fx, fy and mz are then what the shaft carries at its base, as in a scan.
        points: number of points on each stretch between loads, and between a load and the base; at least 2.

    Returns:
        A Deflection. Its values are NaN with status `inexact` if the load is too large for the steps (beyond a few
        hundred EI/L^2) or no equilibrium is found, and NaN with status `invalid` if a traced parameter is outside its
        domain or a traced load or spring is beyond the tip.

    Raises:
        ValueError: if an argument has the wrong type, there is no load, a load or a spring lies beyond the tip, the
            support is for several whiskers, `points` is less than 2, or JAX is in float32 mode.

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
    for name, _, place in support.attachments():
        if not checks.is_traced((place, whisker)) and float(place) >= float(whisker.length):
            checks.fail(name, f"less than the length {whisker.length}", place)
    if support.foundations[0] is not None and whisker.intrinsic_curvature is not None:
        checks.fail("whisker", "straight on a Foundation", "one with an intrinsic curvature")
    for load in loads:
        if load.position is None or checks.is_traced((load.position, whisker)):
            continue
        if float(load.position) > float(whisker.length):
            checks.fail("position", f"at most the length {whisker.length}", load.position)
    whisker, loads, support = jax.tree.map(checks.as_float, (whisker, loads, support))
    return Deflection(
        **_deflect(whisker.without_masses(), loads, support, points), whisker=whisker, loads=loads, support=support
    )


@Program
def _deflect(whisker: Whisker, loads: Given, support: Support, points: int) -> dict[str, Array]:
    tip, status = _solution(*jax.lax.stop_gradient((whisker, loads, support)))
    ok = status == Status.ok
    whisker, loads, support = safe_placeholder((whisker, loads, support), ok)
    found = (_on_shaft if support.on_shafts else _on_base)(whisker, loads, support, tip, ok, points)
    length, stiffness = whisker.length, whisker.base_stiffness
    fx, fy, mz = -found.load
    base_x, base_y, base_angle = found.pose
    values = {
        "fx": fx * stiffness / length**2,
        "fy": fy * stiffness / length**2,
        "mz": mz * stiffness / length,
        "base_x": base_x * length,
        "base_y": base_y * length,
        "base_angle": base_angle,
        "s": found.s * length,
        "x": found.x * length,
        "y": found.y * length,
        "angle": jnp.unwrap(found.angle),
        "curvature": found.curvature / length,
        "spring_length": found.spring_length,
    }
    return {name: jnp.where(ok, value, jnp.nan) for name, value in values.items()} | {"status": status}


class _Found(NamedTuple):
    """An equilibrium, dimensionless but for the lengths of springs."""

    load: Float[Array, "3"]  # on the base
    pose: Float[Array, "3"]  # of the base
    s: rod.Along
    x: rod.Along
    y: rod.Along
    angle: rod.Along
    curvature: rod.Along
    spring_length: Float[Array, " springs"]


def _on_base(whisker: Whisker, loads: Given, support: Support, tip: Array, ok: Array, points: int) -> _Found:
    """A whisker whose base is all that is held."""
    equations = _equations_of(whisker, loads, support)
    bent = _bend(equations, _differentiable(jnp.where(ok, tip, jnp.pi / 2), equations))
    shape, (base_x, base_y, _) = _shape(equations, bent, points), bent.pose
    x, y, angle = shape.x - bent.x + base_x, shape.y - bent.y + base_y, jnp.arctan2(shape.sin, shape.cos)
    lengths = _network_lengths(whisker, support, bent.pose)
    return _Found(bent.load, bent.pose, shape.s, x, y, angle, jnp.asarray(shape.curvature), lengths)


def _on_shaft(whisker: Whisker, loads: Given, support: Support, tip: Array, ok: Array, points: int) -> _Found:
    """A whisker with springs or a foundation on its shaft."""
    equations, places = held_equations(whisker, loads, support)
    tip = differentiable(jnp.where(ok, tip, jax.lax.stop_gradient(unbent_tip(equations))), equations, ROD_STEPS)
    held = held_state(equations, tip, points, ROD_STEPS)
    (x, y, cos, sin), section = held.states, equations.section
    curvature = jnp.asarray(held.moment if section is None else jax.vmap(section.total_curvature)(held.moment, held.s))
    network = iter(_network_lengths(whisker, support, held.pose))
    own = iter(held.lengths[places[k]] for k in range(len(support.attached)))
    lengths = []
    for spring in support.springs:
        turns = spring.axis == "phi"
        lengths.append(next(network) if spring.linear else next(own) * (1.0 if turns else whisker.length))
    return _Found(held.load, held.pose, held.s, x, y, jnp.arctan2(sin, cos), curvature, jnp.array(lengths, dtype=float))


def _network_lengths(whisker: Whisker, support: Support, pose: Float[Array, "3"]) -> Float[Array, " springs"]:
    """Lengths of the springs between the drive and the base."""
    mount, (x, y, angle) = support.mounts[0], pose
    moved = [x * whisker.length - mount.x, y * whisker.length - mount.y, angle - mount.angle]
    return support.spring_length(jnp.stack(moved)[None])


class _Shape(eqx.Module):
    """Points of the whisker from base to tip, dimensionless, relative to the outermost load."""

    s: rod.Along
    x: rod.Along
    y: rod.Along
    cos: rod.Along
    sin: rod.Along
    curvature: Scalar | rod.Along


def _shape(equations: _Equations, bent: _Bent, points: int) -> _Shape:
    outermost = jax.tree.map(lambda leaf: leaf[0], bent.stretches)
    # Beyond the outermost load the whisker is unloaded; a straight line needs two points.
    nothing = rod.Load(None, jnp.zeros(()), jnp.zeros(()))
    tip = _Stretch(outermost.start, nothing, outermost.position - 1.0, outermost.position)
    beyond = _stretch_shape(equations, tip, 2 if equations.section is None else points)
    lines = jax.vmap(lambda stretch: _stretch_shape(equations, stretch, points))(bent.stretches)
    return jax.tree.map(lambda line, tip: jnp.concatenate([jnp.ravel(line)[::-1], tip[1:]]), lines, beyond)


def _stretch_shape(equations: _Equations, stretch: _Stretch, points: int) -> _Shape:
    """Points of a stretch, from its outer end on."""
    x, y, cos, sin = rod.points(
        stretch.start, stretch.arc, stretch.load, equations.section, count=points, from_base=stretch.position
    )
    s = stretch.position - stretch.arc * jnp.linspace(0.0, 1.0, points)
    bent = rod.moment(x, y, stretch.load)
    return _Shape(
        s, x, y, cos, sin, bent if equations.section is None else jax.vmap(equations.section.total_curvature)(bent, s)
    )
