"""Motion in time of whiskers on a moving drive, free or in contact with an object."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.advance import Forces, advance
from jaxwhisker._dynamics.drive import drive_of
from jaxwhisker._dynamics.held import ends_of, energies
from jaxwhisker._dynamics.motion_state import Moving
from jaxwhisker._dynamics.moving import Damping, MotionUnits, System, drive_pose, motion_units, system_of
from jaxwhisker._dynamics.outline import ObjectChain, number_of
from jaxwhisker._dynamics.places import from_the_tip
from jaxwhisker._dynamics.resolution import warn_of_shapes
from jaxwhisker._dynamics.simulation import MotionEnergy, Simulation, TimedEvents, events_of
from jaxwhisker._dynamics.start import Start, initial, misfit, start_of
from jaxwhisker._dynamics.trace import status_of, trace_of
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._model.support import Support
from jaxwhisker._path.path import Status
from jaxwhisker._scan.deflect import Deflection
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.state import State

SHAPES = 12  # shape functions per whisker
MOST_SHAPES, MOST_SHAPES_OF_SEVERAL = 20, 40  # the shear force jumps at each contact
STEP = 0.001  # default time step, in L^2 sqrt(rho A / EI) of the first whisker
MOST_STEPS = 10_000_000  # of the default step
INSIDE = 1e-6  # accepted penetration at the start, in lengths of the first whisker
MISFIT = 0.01  # of a given state, see `misfit`
INSIDE_BENT = 1e-3  # accepted penetration of a given shape, which is projected onto the shape functions


@with_own_settings
def simulate(
    scene: Scene | Sensor,
    drive: Any,
    duration: Scalar,
    *,
    start: State | Deflection | Result | None = None,
    steps: int | None = None,
    every: int = 1,
    mass_damping: Scalar = 0.0,
    stiffness_damping: Scalar = 0.0,
    base_damping: Scalar | tuple[Scalar, Scalar, Scalar] = 0.0,
    shapes: int = SHAPES,
) -> Simulation:
    """Simulate the motion of whiskers whose drive moves in time, with inertia, damping and contact.

    Args:
        scene: whiskers, object and support; or a Sensor, whose whiskers move without an object. All whiskers need a
            `mass_per_length`.
        drive: drive position u as a function of time, which JAX must be able to trace (parameters of an
            `equinox.Module`, such as `Whisking` or `Sweep`, are differentiable); or an array of samples, equidistant
            from time 0 to the end, between which a cubic runs; or a number for a drive at rest. The unit of u is that
            of the scene's motion: a length, or rad for a Rotation.
        duration: a time; positive. The unit of time is that in which mass_per_length * length^4 / bending_stiffness is
            a time squared: seconds in SI units.
        start: equilibrium from which the whiskers are let go: the state of an event, a Deflection, or the Result of a
            scan, of which the step nearest to the initial drive position counts. It must be a state of these whiskers,
            on this support with the drive where it starts, and on this object. A Sensor lets the whiskers go without
            an object. Default: unloaded, bent only by springs on their shafts that disagree. In both cases whiskers are
            at rest relative to the drive.
        steps: number of time steps. Default: steps of 0.001 length^2 sqrt(mass_per_length / bending_stiffness) of the
            first whisker, a period of its first mode divided by 1787; required under tracing.
        every: number of time steps between two samples of the result.
        mass_damping: drag of the surrounding air, proportional to the mass, 1/time; not negative.
        stiffness_damping: time constant tau of a Kelvin-Voigt material, moment EI (kappa + tau d kappa / dt), and of
            springs, tension T + tau dT / dt; not negative.
        base_damping: viscous damping of each base relative to the drive: force per velocity along x and y and moment
            per angular velocity, in the frame of its mount, as a tuple; or a number for x. Not negative.
        shapes: number of shape functions per whisker, from 2 to 20; up to 40 if whiskers may have several contacts.

    Returns:
        A Simulation. If a parameter is outside its domain under tracing, the drive starts inside the object, `start` is
        a state of another scene, or no unloaded equilibrium with springs on shafts is found, the status is `invalid`;
        if a time step is not solved, it is `lost` from there on; if any point of a whisker gets inside the object by
        more than 0.01 lengths of the first whisker, because it has met it in a second place, `second_contact`, or
        `too_many_contacts` (0.001 lengths) if it may have several contacts, and has met objects in more places; if
        contacts have created more energy than 5 % of that at the start and the work of the drive, or time steps are
        shorter than 0.3 % of the default, where rounding is amplified, `inexact`. Values are then NaN, but for `time`
        and `control`.

    Raises:
        ValueError: if an argument has the wrong type or value (a whisker without mass, a duration that is not
            positive, a drive that is not finite), the drive starts inside the object, `start` is a state of another
            scene, or the scene has springs between the shafts of two whiskers, or rigid springs, which are not
            simulated.

    Warns:
        UserWarning: if the shape functions do not resolve the bending stiffness of a concrete whisker, such as a jump.

    Derivatives of first order exist in both modes, with respect to all numbers of the scene, the drive, the duration
    and the damping. They are those of the discrete motion in which the same whiskers touch in the same steps: through
    smooth stretches, changes between tip and tangential contact, and releases. Where an impact begins, they are not
    defined for the exact motion if the order of events depends on the parameter. Second derivatives are NaN, except in
    forward mode (`jax.jacfwd` twice) without an object and without springs on shafts.

    Examples:
        >>> whisker = jw.Whisker(mass_per_length=1.0)
        >>> motion = jw.simulate(jw.Sensor(whisker), lambda t: 0.1 * jnp.sin(3.0 * t), duration=2.0)
        >>> motion.mz.shape
        (2001, 1)
    """
    checks.float64_mode()
    _check_scene(scene)
    checks.number("duration", duration, positive=True)
    for name, value in (("mass_damping", mass_damping), ("stiffness_damping", stiffness_damping)):
        checks.number(name, value, non_negative=True)
    base = base_damping if isinstance(base_damping, tuple) else (base_damping, 0.0, 0.0)
    if len(base) != 3:
        checks.fail("base_damping", "a number or a tuple of three", repr(base_damping))
    for value in base:
        checks.number("base_damping", value, non_negative=True)
    checks.count("every", every)
    checks.count("shapes", shapes, least=2)
    most = MOST_SHAPES if getattr(scene, "contacts", 1) == 1 else MOST_SHAPES_OF_SEVERAL
    if shapes > most:
        checks.fail("shapes", f"at most {most}", shapes)
    if steps is not None:
        checks.count("steps", steps)
    warn_of_shapes(scene.whiskers, shapes)
    scene, duration, damping = jax.tree.map(
        checks.as_float, (scene, duration, Damping(mass_damping, stiffness_damping, base))
    )
    steps = _default_steps(scene, duration) if steps is None else steps
    control = jax.tree.map(checks.as_float, drive_of(drive, duration))
    begin = None if start is None else start_of(scene, start, control)
    result, clear, off = _simulate(
        scene, control, duration, begin, damping, steps=-(-steps // every) * every, every=every, shapes=shapes
    )
    if not checks.is_traced(result.control) and (gaps := np.flatnonzero(~np.isfinite(result.control))).size:
        checks.fail("drive", "finite at all times", f"{result.control[gaps[0]]} at time {result.time[gaps[0]]:g}")
    if not checks.is_traced(off) and off > MISFIT:
        allowed = "a state of these whiskers on this object and support, with the drive where it starts"
        checks.fail("start", allowed, f"one that is off by {float(off):.2g} (length, rad, or energy in EI / L)")
    if not checks.is_traced(clear) and not bool(clear):
        u = float(control(jnp.zeros(())))
        raise ValueError(f"`drive` must start where no whisker is inside the object, got a drive that starts at {u:g}.")
    return result


def _check_scene(scene: Any) -> None:
    checks.instance("scene", scene, (Scene, Sensor), "a Scene or a Sensor")
    for whisker in scene.whiskers:
        if whisker.mass_per_length is None:
            checks.fail("mass_per_length", "given for every whisker that moves", None)
    if scene.gravity is not None:
        checks.fail("scene", "one without gravity for a simulation", str(scene))
    allowed = "one without {} for a simulation"
    if scene.support.shaft_loads:
        checks.fail("support", allowed.format("springs between the shafts of two whiskers"), scene.support.name)
    for spring in scene.support.springs:
        if spring.linear and not checks.is_traced(spring.softness) and spring.is_rigid():
            checks.fail("stiffness", "finite for a simulation", spring.stiffness)


def _default_steps(scene: Scene | Sensor, duration: Scalar) -> int:
    unit = motion_units(scene).time
    if checks.is_traced((unit, duration)):
        raise ValueError("`steps` must be given under tracing, got None.")
    steps = math.ceil(float(duration) / (STEP * float(unit)))
    if steps > MOST_STEPS:
        checks.fail("duration", f"at most {MOST_STEPS:,} default time steps, or `steps`", float(duration))
    return steps


@Program
def _simulate(
    scene: Scene | Sensor,
    control: Callable[[Scalar], Scalar],
    duration: Float[Array, ""],
    start: Start | None,
    damping: Damping,
    *,
    steps: int,
    every: int,
    shapes: int,
) -> tuple[Simulation, Bool[Array, ""], Float[Array, ""]]:
    valid = _valid(scene, duration, damping, control)
    given = scene
    scene = safe_placeholder(scene, valid)
    unit, system = motion_units(scene), system_of(scene, damping, shapes)
    time = duration * jnp.linspace(0.0, 1.0, steps + 1)
    h = duration / unit.time / steps

    def pose(t):
        return drive_pose(scene.motion, control(t), unit)

    poses, rates = jax.vmap(lambda t: jax.jvp(pose, (t,), (jnp.ones_like(t),)))(time)
    rates = rates * unit.time
    first, found = initial(system, unit, start, poses[0], rates[0])
    clear = jnp.asarray(True)
    if first.rod.touching is not None:
        at = first.rod.touching
        least = at.gap.distance if at.distance is None else at.distance
        clear = jnp.all(least > -(INSIDE if start is None else INSIDE_BENT))
    off = jnp.zeros(()) if start is None else misfit(system, unit, start, poses[0])
    good = valid & found & clear & ~(off > MISFIT) & jnp.all(jnp.isfinite(poses))
    first = first._replace(solved=good)

    def step(moving, drive):
        moving, forces = advance(system, moving, drive[:3], drive[3:], h)
        return moving, (forces, moving.solved, trace_of(system, moving))

    def sample(moving, drives):
        moving, traces = jax.lax.scan(step, moving, drives)
        return moving, (moving, traces)

    drives = jnp.concatenate([poses, rates], axis=-1)[1:].reshape(-1, every, 6)
    _, (samples, each) = jax.lax.scan(sample, first, drives)
    forces, solved, trace = jax.tree.map(lambda leaf: leaf.reshape(steps, *leaf.shape[2:]), each)
    samples, solved, trace = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b]), (first, good, trace_of(system, first)), (samples, solved, trace)
    )
    result = _result(given, system, unit, samples, _at_samples(forces, every))
    before = jax.lax.stop_gradient(result["energy"].total[0] / unit.energy)
    status = jnp.where(good, status_of(solved, trace, before, h), Status.invalid)
    ok = status == Status.ok
    events = _no_events() if trace is None else events_of(trace, ok, time, control, system.contacts)
    status = status[::every]
    ok = status == Status.ok
    blank = {name: _where_ok(ok, value) for name, value in result.items()}
    at = time[::every]
    return (
        Simulation(
            **blank, time=at, control=jnp.asarray(jax.vmap(control)(at)), status=status, events=events, scene=given
        ),
        clear | ~valid | (off > MISFIT),
        jnp.where(valid, off, 0.0),
    )


def _where_ok(ok: Bool[Array, " samples"], tree: Any) -> Any:
    def blank(leaf):
        mask = ok.reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.where(mask, leaf, jnp.nan if jnp.issubdtype(leaf.dtype, jnp.inexact) else 0)

    return jax.tree.map(blank, tree)


def _valid(scene: Scene | Sensor, duration: Array, damping: Damping, control: Any) -> Bool[Array, ""]:
    """Whether traced parameters are in the domains that concrete ones are checked for."""
    rates = jnp.stack([jnp.asarray(leaf, dtype=float) for leaf in jax.tree.leaves(damping)])
    valid = scene.support.valid() & scene.motion.valid() & (duration > 0) & jnp.isfinite(duration)
    valid &= jnp.all((rates >= 0) & jnp.isfinite(rates)) & checks.all_finite(control)
    for whisker in scene.whiskers:
        valid &= whisker.valid() & whisker.valid_masses()
    for _, whisker, place in scene.support.attachments():
        valid &= jnp.asarray(place) < scene.whiskers[whisker - 1].length
    return valid & scene.profile.valid() if isinstance(scene, Scene) else valid


def _at_samples(forces: Forces, every: int) -> Forces:
    """Forces at samples: means of those of the steps before and after; extrapolated at both ends."""

    def mean(values):
        after, before = values[::every], values[every - 1 :: every]
        second, last = values[min(1, len(values) - 1)], values[max(-2, -len(values))]
        start, end = (3 * values[0] - second) / 2, (3 * values[-1] - last) / 2
        return jnp.concatenate([start[None], (before[:-1] + after[1:]) / 2, end[None]])

    return jax.tree.map(mean, forces)


def _no_events() -> TimedEvents:
    none, zeros = jnp.zeros(0, int), jnp.zeros(0)
    return TimedEvents(none, none, zeros, zeros, jnp.zeros((), int))


def _result(
    scene: Scene | Sensor, system: System, unit: MotionUnits, samples: Moving, forces: Forces
) -> dict[str, Any]:
    """Fields of the Simulation that are unknown after a failure."""
    rods, base = system.rods, samples.rod.base
    tip, touching = samples.rod.at[..., -1], samples.rod.touching
    zero = jnp.zeros_like(forces.normal)
    contact: dict[str, Any] = dict.fromkeys(("contact_slope", "contact_arc", "contact_x", "contact_y"), zero)
    gap, phase = jnp.full_like(samples.rod.spin, jnp.inf), jnp.full_like(zero, int(Phase.free), int)
    if touching is not None:
        at, touches = touching.gap.object, touching.touches
        gap = (touching.gap.distance if touching.distance is None else touching.distance) * unit.length
        phase = jnp.where(touching.gap.at_tip > 0, Phase.tip, Phase.tangential)
        phase = jnp.where(touches, phase, Phase.free)
        values = (
            jnp.arctan2(at.sin, at.cos),
            touching.arc * system.over_contacts(rods.length) * unit.length,
            at.x * unit.length,
            at.y * unit.length,
        )
        contact = {name: jnp.where(touches, value, 0.0) for name, value in zip(contact, values, strict=True)}
        if isinstance(system.profile, ObjectChain) and len(system.profile.each) > 1:
            contact["contact_object"] = jnp.where(touches, number_of(system.profile, touching.parameter) + 1, 0)
    friction: dict[str, Any] = {}
    contact_force = forces.normal
    if system.friction is not None and touching is not None:
        contact_force = jnp.hypot(forces.normal, forces.drag)
        friction = {"normal_force": forces.normal * unit.force, "friction_force": forces.drag * unit.force}
        friction["slip"] = jnp.where(touching.touches, touching.slip, 0)
    contact |= {"contact_force": contact_force * unit.force, "phase": phase}
    if system.contacts > 1 and touching is not None:
        contact, friction = (from_the_tip(touching, fields) for fields in (contact, friction))
    fx, fy, mz = jnp.moveaxis(forces.reaction, -1, 0)
    length = _lengths_on_shafts(system, samples)
    return {
        "base_x": base[..., 0] * unit.length,
        "base_y": base[..., 1] * unit.length,
        "base_angle": base[..., 2],
        "fx": fx * unit.force,
        "fy": fy * unit.force,
        "mz": mz * unit.moment,
        **contact,
        **friction,
        "gap": gap,
        "spring_length": _spring_lengths(scene.support, system, unit, samples, length),
        "energy": _energy(system, unit, samples, length),
        "curvature": samples.rod.q,
        "tip_x": tip[..., 0] * unit.length,
        "tip_y": tip[..., 1] * unit.length,
    }


def _lengths_on_shafts(system: System, samples: Moving) -> Float[Array, "samples whiskers places"] | None:
    if system.rods.held is None:
        return None

    def one(held, length, rod, drive):
        return ends_of(held, length, rod.q, rod.base, rod.angle, drive).length

    each = jax.vmap(one, in_axes=(0, 0, 0, None))
    rod = samples.rod._replace(touching=None)
    return jax.vmap(each, in_axes=(None, None, 0, 0))(system.rods.held, system.rods.length, rod, samples.drive)


def _spring_lengths(
    support: Support, system: System, unit: MotionUnits, samples: Moving, on_shafts: Array | None
) -> Float[Array, "samples springs"]:
    """Lengths of all springs in the order of the support, in its units."""
    d = jax.vmap(system.displacement)(samples.z) * jnp.stack([unit.length, unit.length, 1.0])
    linear = support.spring_length(d)
    if on_shafts is None:
        return linear
    own, network = [iter(jnp.moveaxis(one, -1, 0)) for one in jnp.moveaxis(on_shafts, 1, 0)], iter(linear.T)
    lengths = [
        next(network) if spring.linear else next(own[whisker - 1]) * (1.0 if spring.axis == "phi" else unit.length)
        for spring in support.springs
        for whisker in spring.between[1:]
    ]
    return jnp.stack(lengths, axis=-1) if lengths else linear


def _energy(system: System, unit: MotionUnits, samples: Moving, length: Array | None) -> MotionEnergy:
    rods, rod = system.rods, samples.rod
    kinetic = jnp.sum(rods.mass[:, None] * rod.velocity**2, axis=(1, 2, 3)) / 2
    kinetic += jnp.sum(rods.inertia * rod.spin**2, axis=-1) / 2
    bending = jnp.einsum("twi,wij,twj->t", rod.q, rods.stiffness, rod.q) / 2
    springs = jnp.zeros_like(kinetic)
    if system.network is not None:
        strain = jax.vmap(system.strain)(samples.z)
        springs = jnp.sum(strain * jax.vmap(system.elastic)(strain), axis=-1) / 2
    if length is not None:
        each = jax.vmap(lambda held, length: energies(held, system.laws, length))
        springs += jnp.sum(jax.vmap(lambda length: each(system.rods.held, length))(length), axis=(1, 2))
    ledger = samples.ledger
    parts = (kinetic, bending, springs, ledger.work, ledger.damping, ledger.impact, ledger.friction, ledger.contact)
    return MotionEnergy(*(jnp.asarray(part * unit.moment) for part in parts))
