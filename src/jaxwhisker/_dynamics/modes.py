"""Small vibrations about an equilibrium: frequencies, shapes, reactions and damping ratios."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import in_double, with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.elements import ORDER
from jaxwhisker._dynamics.line import DeadLoads, Equilibrium
from jaxwhisker._dynamics.vibration import mass_unit, vibration
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import all_free
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.line_loads import lines_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.conic import Parabola
from jaxwhisker._model.loads import PointForce
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import Status
from jaxwhisker._scan.applied_loads import sorted_loads
from jaxwhisker._scan.blocks import in_blocks
from jaxwhisker._scan.contacts import check_one_contact
from jaxwhisker._scan.deflect import Deflection
from jaxwhisker._scan.plane import problem_now
from jaxwhisker._scan.resolution import warn_of_steps
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.signals import signals

BLOCK = 64  # steps computed by one call
CLAMP = Support.clamped()
MOST = ORDER - 4  # modes that the elements resolve


class Modes(eqx.Module):
    """Modes of vibration, from the slowest to the fastest; the leading axis `steps` is missing for one equilibrium.

    The displacement of a point in mode k is shape[k] times the modal coordinate, whose kinetic energy is half the
    square of its rate: each mode has unit generalised mass. The sign of a mode is such that its largest moment mz is
    positive. Where `status` is not `Status.ok`, values are NaN.
    """

    omega: Float[Array, "*steps count"]  # angular frequency without damping, rad per time
    damping_ratio: Float[Array, "*steps count"]  # of critical damping
    fx: Float[Array, "*steps count whiskers"]  # amplitude of the support reaction per modal coordinate: force along x
    fy: Float[Array, "*steps count whiskers"]  # force along y
    mz: Float[Array, "*steps count whiskers"]  # moment
    s: Float[Array, "whiskers points"]  # arc length from the base
    shape: Float[Array, "*steps count whiskers points 2"]  # displacement of these points, along x and y
    status: Int[Array, "*steps"]  # Status.ok; .unstable; .invalid; or the status of the step

    @property
    @in_double
    def frequency(self) -> Float[Array, "*steps count"]:
        """omega / (2 pi), cycles per time."""
        return self.omega / (2 * jnp.pi)


class _ModalDamping(eqx.Module):
    mass: Scalar
    stiffness: Scalar
    base: tuple[Scalar, Scalar, Scalar]


@with_own_settings
def modes(
    at: Whisker | Sensor | Scene | Deflection | Result,
    count: int = 4,
    *,
    step: int | None = None,
    support: Support = CLAMP,
    mass_damping: Scalar = 0.0,
    stiffness_damping: Scalar = 0.0,
    base_damping: Scalar | tuple[Scalar, Scalar, Scalar] = 0.0,
    points: int = 65,
) -> Modes:
    """Frequencies and shapes of small vibrations about an equilibrium.

    Whiskers that the springs of a support couple vibrate together; the drive and the object stay still. A whisker that
    touches the object keeps its contact: a tip stays on the object's surface, and a shaft stays tangent to it while
    the contact moves along both. With friction, contacts stick. Rods are inextensible, and the rotary inertia of their
    cross-sections is neglected.

    Args:
        at: a Whisker on `support`, a Sensor or a Scene, without any load; a Deflection; or the Result of a scan, all of
            whose steps are computed unless `step` selects one. All whiskers need a `mass_per_length`.
        count: number of modes, at most 12.
        step: index of a step of a Result.
        support: support of a Whisker, as for `deflect`.
        mass_damping: rate of damping proportional to the mass matrix, 1/time; not negative.
        stiffness_damping: time constant of damping proportional to the stiffness matrix; not negative.
        base_damping: viscous damping of each base relative to the drive: force per velocity along x and y and moment
            per angular velocity, in the frame of its mount, as a tuple; or a number for x. Not negative.
        points: number of equidistant points of the shapes, at least 2.

    Returns:
        Modes. The damping ratios are those of light damping, to first order: (mass_damping / omega + stiffness_damping
        omega + d . base_damping d / omega) / 2, with the amplitude d of the bases. Values are NaN with status
        `unstable` if the equilibrium is not stable, and with the status of the scan's step if it failed. At a fold the
        lowest frequency goes to zero.

    Raises:
        ValueError: if an argument has the wrong type, is out of its domain or does not belong to `at`, a whisker has no
            mass per length, whiskers of a Result may have several contacts, a load of the Deflection is a follower
            force, which has no potential, or JAX is in float32 mode.

    Warns:
        UserWarning: if stiffness, curvature or mass change too fast along a concrete whisker; see `Whisker(breaks=)`.

    Derivatives with respect to all numbers, in both modes, are those of simple frequencies; they do not exist for modes
    that share one frequency.

    Examples:
        >>> found = jw.modes(jw.Whisker(mass_per_length=1.0), count=3)
        >>> print(", ".join(f"{omega:.4f}" for omega in found.omega))
        3.5160, 22.0345, 61.6972
    """
    checks.float64_mode()
    kinds = Whisker, Sensor, Scene, Deflection, Result
    checks.instance("at", at, kinds, "a Whisker, Sensor, Scene, Deflection or Result")
    checks.count("count", count)
    if count > MOST:
        checks.fail("count", f"at most {MOST}", count)
    checks.count("points", points, least=2)
    damping = _checked_damping(mass_damping, stiffness_damping, base_damping)
    if support is not CLAMP and not isinstance(at, Whisker):
        checks.fail("support", "that of a Whisker: others have their own", repr(support))
    if step is not None and not isinstance(at, Result):
        checks.fail("step", "None unless `at` is a Result", repr(step))
    if isinstance(at, Deflection):
        return _of_deflection(at, count, damping, points)
    if isinstance(at, Result):
        return _of_result(at, step, count, damping, points)
    return _of_scene(_scene_of(at, support), count, damping, points)


def _checked_damping(mass: Any, stiffness: Any, base: Any) -> _ModalDamping:
    checks.number("mass_damping", mass, non_negative=True)
    checks.number("stiffness_damping", stiffness, non_negative=True)
    each = base if isinstance(base, tuple) else (base, 0.0, 0.0)
    if len(each) != 3:
        checks.fail("base_damping", "a number, or a tuple of three", repr(base))
    for one in each:
        checks.number("base_damping", one, non_negative=True)
    return jax.tree.map(checks.as_float, _ModalDamping(mass, stiffness, each))


def _scene_of(at: Whisker | Sensor | Scene, support: Support) -> Scene:
    """The scene, with any object out of reach if there is none."""
    if isinstance(at, Scene):
        return at
    if isinstance(at, Whisker):
        checks.instance("support", support, Support, "a Support")
        at = Sensor(at if support.whiskers == 1 else (at,) * support.whiskers, support)
    length = at.whiskers[0].length
    return at.before(Parabola(10.0 * length, 1.0 / length))


def _check_masses(whiskers: tuple[Whisker, ...]) -> None:
    if any(whisker.mass_per_length is None for whisker in whiskers):
        checks.fail("mass_per_length", "given for all whiskers that vibrate", "None")


def _prepared(scene: Scene) -> tuple[Problem, tuple[Whisker, ...]]:
    _check_masses(scene.whiskers)
    if scene.gravity is not None:
        checks.fail("at", "one without gravity; vibrations about a `deflect` with gravity are known", str(scene))
    if scene.support.shaft_loads:
        checks.fail("at", "one without springs between the shafts of two whiskers", str(scene))
    warn_of_steps(scene, masses=True)
    scene = jax.tree.map(checks.as_float, scene)
    return (problem_of if checks.is_staged(scene) else problem_now)(scene), scene.whiskers


def _of_scene(scene: Scene, count: int, damping: _ModalDamping, points: int) -> Modes:
    problem, whiskers = _prepared(scene)
    return _unloaded_modes(problem, whiskers, damping, count, points)


def _of_deflection(bent: Deflection, count: int, damping: _ModalDamping, points: int) -> Modes:
    if any(isinstance(load, PointForce) and load.follower for load in bent.loads):
        checks.fail("at", "a Deflection under dead loads: a follower force has no potential", "a follower force")
    problem, whiskers = _prepared(_scene_of(bent.whisker, bent.support))
    pose = bent.base_x, bent.base_y, bent.base_angle
    return _deflection_modes(
        problem, whiskers, (*pose, bent.fx, bent.fy, bent.mz), bent.status, bent.loads, damping, count, points
    )


def _of_result(result: Result, step: int | None, count: int, damping: _ModalDamping, points: int) -> Modes:
    if np.ndim(result.control) != 1:
        checks.fail("at", "the Result of a single scan; for a batch, use jax.vmap", f"one of shape {result.fx.shape}")
    check_one_contact("at", result)
    problem, whiskers = _prepared(result.scene)
    force = result.contact_force if result.normal_force is None else result.normal_force
    fields = {name: getattr(result, name) for name in Equilibrium._fields} | {"contact_force": force}
    states = Equilibrium(**fields), result.status, result.control
    if step is not None:
        steps = np.shape(result.control)[0]
        if not isinstance(step, int) or isinstance(step, bool) or not -steps <= step < steps:
            checks.fail("step", f"an int from {-steps} to {steps - 1}", repr(step))
        states = jax.tree.map(lambda leaf: leaf[step][None], states)

    def block(*states) -> Modes:
        return _result_modes(problem, whiskers, *states, damping, count, points)

    found = in_blocks(block, states, BLOCK if step is None else 1)
    found = eqx.tree_at(lambda modes: modes.s, found, found.s[0])
    return found if step is None else _at_step(found)


def _at_step(found: Modes) -> Modes:
    one = jax.tree.map(lambda leaf: leaf[0], found)
    return eqx.tree_at(lambda modes: modes.s, one, found.s)


def _modes_of(
    problem: Problem,
    whiskers: tuple[Whisker, ...],
    at: Equilibrium,
    status: Int[Array, ""],
    u: Scalar,
    loads: DeadLoads | None,
    damping: _ModalDamping,
    count: int,
    points: int,
) -> Modes:
    """Modes about one equilibrium, which is given in dimensionless form."""
    valid = problem.valid & jnp.all(jnp.stack([whisker.valid_masses() for whisker in whiskers]))
    rates = jnp.stack([damping.mass, damping.stiffness, *damping.base])
    valid &= jnp.all((rates >= 0) & jnp.isfinite(rates))
    status = jnp.where(valid, status, Status.invalid)
    # Failed steps are replaced by free whiskers, whose values and derivatives are finite.
    ok = (status == Status.ok) & checks.all_finite(at)
    whiskers = safe_placeholder(whiskers, valid)
    at = jax.tree.map(lambda leaf: jnp.where(ok, leaf, jnp.zeros_like(leaf)), at)
    found = vibration(problem, whiskers, at, jnp.where(ok, u, 0.0), loads, count, points)
    status = jnp.where((status == Status.ok) & ~found.stable, Status.unstable, status)
    ok = status == Status.ok
    length, force, moment, _ = problem.unit
    per_length = mass_unit(whiskers)
    rate = jnp.sqrt(force / per_length) / length
    size = 1 / jnp.sqrt(per_length * length)  # of shapes
    omega = jnp.where(ok, found.omega, jnp.nan) * rate
    lengths = jnp.stack([length, length, jnp.ones(())])[: found.base.shape[-1]]
    moved = found.base * size * lengths / length
    drag = jnp.sum(moved**2 * jnp.stack(damping.base)[: moved.shape[-1]], axis=(1, 2))
    ratio = (damping.mass / omega + damping.stiffness * omega + drag / omega) / 2

    def if_ok(values: Array) -> Array:
        return jnp.where(ok, values, jnp.nan)

    return Modes(
        omega=omega,
        damping_ratio=ratio,
        fx=if_ok(found.fx) * force * size / length,
        fy=if_ok(found.fy) * force * size / length,
        mz=if_ok(found.mz) * moment * size / length,
        s=jnp.linspace(0.0, 1.0, points) * (problem.length * length)[:, None],
        shape=if_ok(found.shape) * size,
        status=status,
    )


def _dimensionless(problem: Problem, at: Equilibrium) -> Equilibrium:
    length, force, moment, _ = problem.unit
    units = dict.fromkeys(("base_x", "base_y", "contact_arc", "contact_x", "contact_y"), length)
    units |= {"fx": force, "fy": force, "contact_force": force, "mz": moment}
    return at._replace(**{name: getattr(at, name) / unit for name, unit in units.items()})


@Program
def _result_modes(
    problem: Problem,
    whiskers: tuple[Whisker, ...],
    at: Equilibrium,
    status: Int[Array, " steps"],
    control: Float[Array, " steps"],
    damping: _ModalDamping,
    count: int,
    points: int,
) -> Modes:
    def one(at, status, control):
        u = control / problem.unit.control
        return _modes_of(problem, whiskers, _dimensionless(problem, at), status, u, None, damping, count, points)

    found = jax.vmap(one)(at, status, control)
    return eqx.tree_at(lambda modes: modes.s, found, found.s[0])


@Program
def _unloaded_modes(
    problem: Problem, whiskers: tuple[Whisker, ...], damping: _ModalDamping, count: int, points: int
) -> Modes:
    u = jnp.asarray(0.0 if problem.ends is None else problem.ends[0])
    z, _ = problem.unloaded(u)
    state, *_ = signals(problem, z, u, all_free(problem, jnp.ones_like(problem.length)))
    at = Equilibrium(**{name: getattr(state, name) for name in Equilibrium._fields})
    status = jnp.asarray(Status.ok)
    return _modes_of(problem, whiskers, _dimensionless(problem, at), status, u, None, damping, count, points)


@Program
def _deflection_modes(
    problem: Problem,
    whiskers: tuple[Whisker, ...],
    base: tuple[Scalar, ...],
    status: Int[Array, ""],
    loads: tuple,
    damping: _ModalDamping,
    count: int,
    points: int,
) -> Modes:
    zero = jnp.zeros(())
    at = Equilibrium(*(jnp.reshape(leaf, 1) for leaf in (*base, *[zero] * 5, jnp.asarray(Phase.free))))
    each = sorted_loads(whiskers[0], loads)
    force_x, force_y = each.force * jnp.cos(each.direction), each.force * jnp.sin(each.direction)
    dead = DeadLoads(each.position, force_x, force_y, each.moment, lines_of(whiskers[0], loads))
    dead = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], dead)
    return _modes_of(problem, whiskers, _dimensionless(problem, at), status, zero, dead, damping, count, points)
