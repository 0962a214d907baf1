"""Deflection of one whisker under given loads: forces and moments at points along it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import harmless
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.implicit import without_rule
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section

LOAD_STEPS = 32  # from rest to the full load: the state that grows out of rest is found, not just any
STEPS = 32  # of the rod between two loads
RESIDUAL = 1e-8  # of the base's direction, with twice the steps
CLAMPED = Support.clamped()


class PointForce(eqx.Module):
    """A force at one point of the whisker.

    Args:
        force: its size, a force (EI/L^2 with the default whisker).
        position: arc length of the point from the base; the tip by default.
        follower: whether the force turns with the whisker, or keeps its direction (a dead load).
        direction: angle to +x at rest, rad; pi by default, towards -x: across the upright whisker.
    """

    force: Scalar
    position: Scalar | None = None
    follower: bool = eqx.field(static=True, default=False)
    direction: Scalar = float(np.pi)

    def __check_init__(self):
        checks.number("force", self.force)
        if not isinstance(self.follower, bool):
            raise ValueError(f"`follower` must be True or False, but is {self.follower!r}.")
        checks.number("direction", self.direction)
        if self.position is not None:
            checks.number("position", self.position, positive=True)


class PointMoment(eqx.Module):
    """A moment at one point of the whisker, counter-clockwise positive.

    Args:
        moment: its size, force times length (EI/L with the default whisker).
        position: arc length of the point from the base; the tip by default.
    """

    moment: Scalar
    position: Scalar | None = None

    def __check_init__(self):
        checks.number("moment", self.moment)
        if self.position is not None:
            checks.number("position", self.position, positive=True)


class Deflection(eqx.Module):
    """A deflected whisker: support reaction, pose of its base, and shape at arc lengths s from there.

    Everything is NaN unless `status` is `Status.ok`.
    """

    fx: Float[Array, ""]  # support reaction on the whisker
    fy: Float[Array, ""]
    mz: Float[Array, ""]  # counter-clockwise positive
    base_x: Float[Array, ""]
    base_y: Float[Array, ""]
    base_angle: Float[Array, ""]  # to the upright, rad, counter-clockwise
    s: Float[Array, " points"]
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    angle: Float[Array, " points"]  # of the whisker's direction to +x, rad; pi/2 at a clamped base
    curvature: Float[Array, " points"]
    status: Int[Array, ""]


class _Loads(eqx.Module):
    # All loads as one kind, sorted from the tip to the base; dimensionless.
    force: Float[Array, " loads"]
    direction: Float[Array, " loads"]
    follower: Float[Array, " loads"]
    moment: Float[Array, " loads"]
    position: Float[Array, " loads"]


class _Base(eqx.Module):
    # Where the base is without load, and how it yields to force and moment; dimensionless, x, y and angle.
    rest: Float[Array, "3"]
    compliance: Float[Array, "3"] | None  # None for a clamp

    def angle(self, moment: Scalar) -> Scalar:
        """To the upright, under the moment of the whisker on it."""
        return self.rest[2] if self.compliance is None else self.rest[2] + self.compliance[2] * moment

    def misses(self, cos: Scalar, sin: Scalar, moment: Scalar) -> Scalar:
        """By how much a whisker with this direction at its base misses the base's angle."""
        if self.compliance is None:
            # The sine of it, which tells a whisker that has wound half round, too, but costs less.
            return cos * jnp.cos(self.rest[2]) + sin * jnp.sin(self.rest[2])
        return self.angle(moment) - jnp.arctan2(-cos, sin)


def _base(whisker: Whisker, support: Support) -> _Base:
    length, stiffness = whisker.length, whisker.base_stiffness
    mount, flexibility = support.mounts[0], support.flexibility()
    rest = jnp.stack([jnp.asarray(v, dtype=float) for v in (mount.x / length, mount.y / length, mount.angle)])
    if flexibility is None:
        return _Base(rest, None)
    framed = flexibility.in_frames(jnp.zeros(1), length, stiffness / length**2)
    return _Base(rest + framed.offset, jnp.diagonal(framed.matrix))


def _along(whisker: Whisker) -> Section | None:
    """What changes along the whisker, dimensionless; None if it is uniform."""
    return None if whisker.uniform else whisker.section(whisker.length, whisker.base_stiffness)


def _collect(whisker: Whisker, loads: tuple[PointForce | PointMoment, ...]) -> _Loads:
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


class _Stretch(eqx.Module):
    """A stretch of the rod between two loads (or load and base), from its outer end."""

    start: rod.RodState
    load: rod.Load
    arc: Scalar


def _stretches(
    loads: _Loads, section: Section | None, tip_angle: Scalar, factor: Scalar, steps: int
) -> tuple[list[_Stretch], rod.RodState]:
    """All stretches from the outermost load to the base, and the state at the base; origin at the outermost load."""
    zero = jnp.zeros(())
    state = (zero, zero, jnp.cos(tip_angle), jnp.sin(tip_angle))
    force_x, force_y, bend = zero, zero, zero
    stretches = []
    ends = jnp.append(loads.position[1:], 0.0)
    for k in range(loads.force.shape[0]):
        x, y, cos, sin = state
        angle = loads.direction[k]
        turned_cos = jnp.sin(angle) * cos + jnp.cos(angle) * sin  # angle + (phi - pi/2)
        turned_sin = jnp.sin(angle) * sin - jnp.cos(angle) * cos
        follower = loads.follower[k] > 0
        force = factor * loads.force[k]
        fx = force * jnp.where(follower, turned_cos, jnp.cos(angle))
        fy = force * jnp.where(follower, turned_sin, jnp.sin(angle))
        force_x, force_y = force_x + fx, force_y + fy
        bend = bend + x * fy - y * fx + factor * loads.moment[k]
        total = rod.Load(force_x, force_y, bend)
        stretch = _Stretch(state, total, loads.position[k] - ends[k])
        stretches.append(stretch)
        state = rod.integrate(state, stretch.arc, total, section, steps=steps, from_base=loads.position[k])
    return stretches, state


def _misdirection(tip_angle: Scalar, args: tuple[_Loads, Section | None, _Base, Scalar]) -> Scalar:
    loads, section, base, factor = args
    stretches, (x, y, cos, sin) = _stretches(loads, section, tip_angle, factor, STEPS)
    return base.misses(cos, sin, rod.moment(x, y, stretches[-1].load))


@eqx.filter_custom_jvp
def _balanced(tip_angle: Scalar, loads: _Loads, section: Section | None, base: _Base) -> Scalar:
    """The tip angle, at which the base points as its support lets it, with its derivatives (see implicit.py)."""
    return without_rule(tip_angle, (loads, section, base))


@_balanced.def_jvp
def _(primals, tangents):
    tip_angle, *known = primals
    _, *known_dot = tangents
    here, one = _balanced(tip_angle, *known), jnp.asarray(1.0)
    slope = jax.jacfwd(_misdirection)(here, (*known, one))
    _, missed = eqx.filter_jvp(lambda *known: _misdirection(here, (*known, one)), tuple(known), tuple(known_dot))
    return here, -missed / slope


def _misdirected(loads: _Loads, section: Section | None, base: _Base) -> Scalar:
    """Direction of the unloaded whisker where the outermost load will act: away from upright if it is curved."""
    upright = jnp.asarray(jnp.pi / 2)
    if section is None:
        return upright + base.rest[2]
    _, (_, _, cos, sin) = _stretches(loads, section, upright, jnp.asarray(0.0), STEPS)
    return jnp.pi - jnp.arctan2(sin, cos) + base.rest[2]


def _grown(loads: _Loads, section: Section | None, base: _Base) -> Scalar:
    """Direction of the whisker beyond the outermost load, on the branch that grows out of rest."""
    newton = optx.Newton(rtol=1e-10, atol=1e-10)

    def solve(guess, factor):
        return optx.root_find(
            _misdirection, newton, guess, args=(loads, section, base, factor), max_steps=20, throw=False
        ).value

    def grow(carry, factor):
        angle, change = carry
        found = solve(angle + change, factor)
        return (found, found - angle), None

    factors = jnp.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:]
    (angle, _), _ = jax.lax.scan(grow, (_misdirected(loads, section, base), jnp.asarray(0.0)), factors)
    return angle


def _found(
    whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support
) -> tuple[Scalar, Int[Array, ""]]:
    """Direction of the tip, and the status."""
    collected, section, base = _collect(whisker, loads), _along(whisker), _base(whisker, support)
    valid = whisker.valid() & support.valid() & jnp.all((collected.position > 0) & (collected.position <= 1))
    valid &= jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(collected)]))
    tip_angle = _grown(collected, section, base)
    one = jnp.asarray(1.0)
    stretches, (x, y, cos, sin) = _stretches(collected, section, tip_angle, one, STEPS)
    _, (fine_x, fine_y, fine_cos, fine_sin) = _stretches(collected, section, tip_angle, one, 2 * STEPS)
    load = stretches[-1].load
    turn, wanted = jnp.arctan2(-cos, sin), base.angle(rod.moment(x, y, load))
    fine_turn, fine_wanted = jnp.arctan2(-fine_cos, fine_sin), base.angle(rod.moment(fine_x, fine_y, load))
    miss = jnp.max(jnp.abs(jnp.stack([turn - wanted, fine_turn - fine_wanted, fine_x - x, fine_y - y])))
    return tip_angle, jnp.where(valid, jnp.where(miss < RESIDUAL, Status.ok, Status.inexact), Status.invalid)


def deflect(
    whisker: Whisker, *loads: PointForce | PointMoment, support: Support = CLAMPED, points: int = 101
) -> Deflection:
    """Reaction and shape of a whisker under the given loads, clamped at (0, 0) along +y or on a support.

    Dead loads are raised from zero, so that the state found is the one that grows out of rest. The rod is integrated
    from the outermost load inwards, with the direction there as the only unknown (Steigenberger 2013).

    Args:
        whisker: the whisker.
        *loads: at least one PointForce or PointMoment, in any order. Their directions are those at rest of an upright
            whisker, whatever its mount; a dead load keeps its own.
        support: of one whisker; the drive stands at (0, 0). A clamp by default.
        points: shape points on each stretch between loads.

    Returns:
        A Deflection; NaN with status `inexact` where the load is too large for the steps (beyond a few hundred EI/L^2)
        and `invalid` for a load that is off the whisker.

    Raises:
        ValueError: if there is no load, one lies beyond the tip, or the support is for several whiskers.
    """
    checks.float64_mode()
    if not isinstance(whisker, Whisker):
        raise ValueError(f"`whisker` must be a Whisker, but is {whisker!r}.")
    if not loads or not all(isinstance(load, PointForce | PointMoment) for load in loads):
        raise ValueError(f"`loads` must be one or more of PointForce and PointMoment, but is {loads!r}.")
    if not isinstance(support, Support) or support.whiskers != 1:
        raise ValueError(f"`support` must be a Support of one whisker, but is {support!r}.")
    if not isinstance(points, int) or points < 2:
        raise ValueError(f"`points` must be an int of at least 2, but is {points!r}.")
    for load in loads:
        if load.position is None or checks.is_traced((load.position, whisker)):
            continue
        if float(load.position) > float(whisker.length):
            raise ValueError(f"`position` must be at most the length {whisker.length}, but is {load.position}.")
    whisker, loads, support = jax.tree.map(checks.as_float, (whisker, loads, support))
    return _deflect(whisker, loads, support, points)


def _curvature(moment: Scalar | rod.Along, section: Section | None, s: rod.Along) -> Scalar | rod.Along:
    return moment if section is None else jax.vmap(section.total_curvature)(moment, s)


@eqx.filter_jit
def _deflect(
    whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support, points: int
) -> Deflection:
    tip_angle, status = _found(*jax.lax.stop_gradient((whisker, loads, support)))
    ok = status == Status.ok
    whisker, loads, support = harmless((whisker, loads, support), ok)
    collected, section, base = _collect(whisker, loads), _along(whisker), _base(whisker, support)
    tip_angle = _balanced(jnp.where(ok, tip_angle, jnp.pi / 2), collected, section, base)
    stretches, (base_x, base_y, _, _) = _stretches(collected, section, tip_angle, jnp.asarray(1.0), STEPS)

    shapes, bends, arcs = [], [], []
    for stretch, outer in zip(stretches, collected.position, strict=True):
        line = rod.points(stretch.start, stretch.arc, stretch.load, section, count=points, from_base=outer)
        states = jnp.stack(line)[:, ::-1]
        s = outer - stretch.arc * jnp.linspace(1.0, 0.0, points)
        shapes.append(states)
        bends.append(_curvature(rod.moment(states[0], states[1], stretch.load), section, s))
        arcs.append(s)
    # Innermost stretch first; beyond the outermost load the whisker is as it was: straight, which two points tell.
    first, zero = collected.position[0], jnp.zeros(())
    start, nothing = (zero, zero, jnp.cos(tip_angle), jnp.sin(tip_angle)), rod.Load(None, zero, None)
    count = 2 if section is None else points
    beyond = rod.points(start, first - 1.0, nothing, section, count=count, from_base=first)
    x, y, cos, sin = jnp.concatenate([*shapes[::-1], jnp.stack(beyond)[:, 1:]], axis=1)
    s = jnp.concatenate([*arcs[::-1], jnp.linspace(first, 1.0, count)[1:]])
    bends.append(_curvature(jnp.zeros(count - 1), section, s[1 - count :]))
    curvature = jnp.concatenate([*bends[-2::-1], bends[-1]])

    load = stretches[-1].load
    assert load.force_x is not None
    length, stiffness = whisker.length, whisker.base_stiffness
    bent = rod.moment(base_x, base_y, load)
    # How far its loads move the base.
    rest_x, rest_y, _ = base.rest
    if base.compliance is not None:
        rest_x, rest_y = rest_x + base.compliance[0] * load.force_x, rest_y + base.compliance[1] * load.force_y

    def where_ok(value):
        return jnp.where(ok, value, jnp.nan)

    return Deflection(
        fx=where_ok(-load.force_x * stiffness / length**2),  # pyright: ignore[reportOptionalOperand]
        fy=where_ok(-load.force_y * stiffness / length**2),
        mz=where_ok(-bent * stiffness / length),
        base_x=where_ok(rest_x * length),
        base_y=where_ok(rest_y * length),
        base_angle=where_ok(base.angle(bent)),
        s=where_ok(s * length),
        x=where_ok((x - base_x + rest_x) * length),
        y=where_ok((y - base_y + rest_y) * length),
        angle=where_ok(jnp.unwrap(jnp.arctan2(sin, cos))),
        curvature=where_ok(curvature / length),
        status=status,
    )
