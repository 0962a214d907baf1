"""The start of a simulation: the equilibrium from which whiskers are let go, in its coordinates."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.linear_algebra import inverse, solve
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.first_order import first_order
from jaxwhisker._dynamics.gap import closest, gap_at, others_distance
from jaxwhisker._dynamics.legendre import polynomials_at, weights_at
from jaxwhisker._dynamics.motion_state import Ledger, Moving, Rod, Touching, angles_of, nodes_of, posed
from jaxwhisker._dynamics.moving import MotionUnits, Rods, System
from jaxwhisker._dynamics.places import places_at
from jaxwhisker._dynamics.time_step import load_at
from jaxwhisker._dynamics.unloaded import unloaded
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.motion import AbstractMotion, pose_of
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.contacts import check_one_contact, has_several, past_contacts
from jaxwhisker._scan.deflect import Deflection
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker._scan.springs import Held, Holds, held, holds, moment_at, outwards
from jaxwhisker._scan.state import State, base_of, state_of

CLOSINGS = 3  # iterations that close the gaps of a given shape, whose projection does not touch exactly
POINTS = 513  # along the loaded part of a whisker


class Start(NamedTuple):
    """Shapes and bases of all whiskers."""

    s: Float[Array, "whiskers points"]  # arc length in lengths of the whisker, from base to tip; may have jumps
    curvature: Float[Array, "whiskers points"]  # times the length, without the intrinsic one
    base: Float[Array, "whiskers 3"]  # pose in the scene, in its units
    # Whether they touch the object of a scene that has one, and where: fraction of the length, and x and y in the
    # scene, 0 if free. If whiskers may have several contacts, these have an axis for them.
    touches: Bool[Array, "*contacts"]
    contact: Float[Array, "*contacts 3"]
    off: Float[Array, " whiskers"]  # distance of the shape from its contact, in lengths: 0 if it is of this whisker
    reaction: Float[Array, "whiskers 3"] | None = None  # of the support; None if it does not matter

    def coefficients(self, n: int) -> Float[Array, "whiskers n"]:
        """The curvature's best approximation by Legendre polynomials, in the norm of the elastic energy."""

        def project(s, curvature):
            values = jax.vmap(lambda s: polynomials_at(s, n))(s) * curvature[:, None]
            integrals = jnp.sum((values[1:] + values[:-1]) / 2 * jnp.diff(s)[:, None], axis=0)
            return (2 * jnp.arange(n) + 1) * integrals

        return jax.vmap(project)(self.s, self.curvature)

    def free(self, system: System, drive: Float[Array, "3"], unit: MotionUnits) -> Float[Array, " free"]:
        """The free coordinates of the bases, with the drive at this dimensionless pose."""
        x, y = self.base[:, 0] / unit.length - drive[0], self.base[:, 1] / unit.length - drive[1]
        cos, sin = jnp.cos(drive[2]), jnp.sin(drive[2])
        angle = self.base[:, 2] - drive[2] - system.mount.angle
        d = [cos * x + sin * y - system.mount.x, cos * y - sin * x - system.mount.y, angle]
        return jnp.ravel(jnp.stack(d, axis=-1))[jnp.array(system.free, int)]


def start_of(scene: Scene | Sensor, start: Any, control: Callable[[Scalar], Scalar]) -> Start:
    """The start of a simulation from a user's equilibrium.

    Raises:
        ValueError: if it is not a State, a Deflection or the Result of a scan, or not one of this many whiskers.
    """
    at, contacts = control(jnp.zeros(())), scene.contacts if isinstance(scene, Scene) else 1
    if isinstance(start, Deflection):
        if scene.support.whiskers != 1:
            checks.fail("start", f"a State of {scene.support.whiskers} whiskers", "a Deflection of one")
        known = jax.tree.map(checks.as_float, (scene.whiskers[0], scene.motion))
        return _from_deflection(*known, start, at, contacts=contacts)
    checks.instance("start", start, State, "a State, a Deflection or the Result of a scan")
    if contacts > 1:
        own = np.shape(start.phase)[-1] if has_several(start) else 1
        if own != contacts:
            checks.fail("start", f"a state with contacts={contacts}", f"one with contacts={own}")
    elif isinstance(scene, Scene):
        check_one_contact("start", start)
    if isinstance(start, Result):
        check_one_scan(start)
        k = jnp.argmin(jnp.abs(start.control - at))
        at, start = start.control[k], jax.tree.map(lambda leaf: leaf[k], state_of(start))
    start = state_of(start)
    if start.fx.shape != (scene.support.whiskers,):
        checks.fail("start", f"a State of {scene.support.whiskers} whiskers", f"fields of shape {start.fx.shape}")
    return _from_state(*jax.tree.map(checks.as_float, (scene.whiskers, holds(scene))), start, at)


@Program
def _from_deflection(
    whisker: Whisker, motion: AbstractMotion, start: Deflection, control: Scalar, *, contacts: int
) -> Start:
    drive = pose_of(motion, control)
    cos, sin = jnp.cos(drive.angle), jnp.sin(drive.angle)
    x, y = start.base_x, start.base_y
    base = [drive.x + cos * x - sin * y, drive.y + sin * x + cos * y, drive.angle + start.base_angle]
    extra = start.curvature - jax.vmap(whisker.curvature_at)(start.s)
    s, extra = start.s / whisker.length, extra * whisker.length
    none = jnp.zeros((1, 3) if contacts == 1 else (1, contacts, 3))
    return Start(s[None], extra[None], jnp.stack(base)[None], none[..., 0] > 0, none, jnp.zeros(1))


@Program
def _from_state(whiskers: tuple[Whisker, ...], by: Holds | None, state: State, control: Scalar) -> Start:
    holds = [None] * len(whiskers) if by is None else held(by, whiskers, control, None)[0]
    states = [jax.tree.map(lambda leaf, k=k: leaf[k], state) for k in range(len(whiskers))]
    each = [_shape(*own) for own in zip(whiskers, states, holds, strict=True)]
    s, curvature = (jnp.stack(parts) for parts in zip(*each, strict=True))
    base = jnp.stack([state.base_x, state.base_y, state.base_angle], axis=-1)
    touches, length = state.phase != Phase.free, jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers])
    over = length[:, None] if has_several(state) else length
    contact = jnp.stack([state.contact_arc / over, state.contact_x, state.contact_y], axis=-1)
    ends = jnp.stack([_end(*own) for own in zip(whiskers, s, curvature, base, strict=True)])
    outer = (contact, touches) if not has_several(state) else (contact[:, 0], touches[:, 0])
    off = jnp.where(outer[1], jnp.linalg.norm(ends - outer[0][:, 1:], axis=-1) / length, 0.0)
    reaction = jnp.stack([state.fx, state.fy, state.mz], axis=-1) if by is None else None
    return Start(s, curvature, base, touches, contact, off, reaction)


def _end(whisker: Whisker, s: Array, curvature: Array, base: Array) -> Float[Array, "2"]:
    """Where the loaded part of a whisker of this shape ends."""
    s, curvature = whisker.length * s[:-1], curvature[:-1] / whisker.length
    way = jnp.diff(s)

    def means(values):
        return (values[1:] + values[:-1]) / 2

    turns = means(curvature + jax.vmap(whisker.curvature_at)(s)) * way
    angle = jnp.pi / 2 + base[2] + jnp.append(0.0, jnp.cumsum(turns))
    return base[:2] + means(jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)).T @ way


def _shape(whisker: Whisker, at: State, by: Held | None) -> tuple[Array, Array]:
    """Arc lengths and curvatures of one whisker, loaded up to its contact, or its outermost one."""
    several = has_several(at)
    touches, arc = (values[0] if several else values for values in (at.phase != Phase.free, at.contact_arc))
    length = jnp.asarray(whisker.length, dtype=float)
    arc, reaction = jnp.where(touches, arc, length), (at.fx, at.fy, at.mz)
    s = arc * jnp.linspace(0.0, 1.0, POINTS)
    if several:
        _, moment = past_contacts(whisker, at, s)
    elif by is None:
        x, y, _, _ = outwards(whisker, base_of(at), reaction, arc, count=POINTS)
        moment = -at.mz + (x - at.base_x) * at.fy - (y - at.base_y) * at.fx
    else:
        moment = moment_at(whisker, base_of(at), reaction, s, by)
    stiffness = jax.vmap(whisker.stiffness_at)(s)
    stiff = stiffness > 0
    loaded = stiff & touches if by is None else stiff
    extra = jnp.where(loaded, moment / jnp.where(stiff, stiffness, 1.0), 0.0)
    return jnp.append(s, length) / length, jnp.append(extra, 0.0) * length


def initial(
    system: System, unit: MotionUnits, start: Start | None, drive: Array, rate: Array
) -> tuple[Moving, Bool[Array, ""]]:
    """Whiskers at rest relative to the drive, and whether they are known."""
    whiskers, found = system.rods.length.shape[0], jnp.asarray(True)
    q, z = jnp.zeros((whiskers, system.n)), system.at_rest
    if start is None and system.rods.held is not None:
        q, z, found = unloaded(system)
    if start is not None:
        q, z = start.coefficients(system.n), start.free(system, drive, unit)
    base, carried = jax.jvp(lambda drive: system.bases(z, drive), (drive,), (rate,))
    angle = angles_of(system, q, base)
    at = nodes_of(system, base, angle)
    apart = at - base[:, :2, None]
    velocity = carried[:, :2, None] + carried[:, 2, None, None] * jnp.stack([-apart[:, 1], apart[:, 0]], axis=1)
    touching = None
    if system.profile is not None:
        none = jnp.zeros(system.contact_shape)
        touches = none > 0 if start is None else start.touches
        given = None if start is None else (start.contact[..., 0], start.touches)
        for _ in range(0 if start is None else CLOSINGS):
            if system.contacts == 1:
                q = jax.vmap(lambda *own: _closed(system, *own))(system.rods, q, base, touches)
            else:
                places = places_at(system, base, angles_of(system, q, base), given)
                q = jax.vmap(lambda *own: _closed_together(system, *own))(system.rods, q, places)
        angle = angles_of(system, q, base)
        at = nodes_of(system, base, angle)
        one = system.contacts == 1
        touching = _closest(system, base, angle, touches) if one else places_at(system, base, angle, given)
    count = whiskers * (system.n + system.contact_unknowns) + len(system.free)
    rod = Rod(q, base, angle, at, velocity, carried[:, 2], touching)
    ledger = Ledger(*[jnp.zeros(())] * len(Ledger._fields))
    return Moving(rod, z, drive, jnp.zeros((2, count)), ledger, jnp.asarray(True)), found


def _closest(system: System, base: Array, angle: Array, touches: Bool[Array, " whiskers"]) -> Touching:
    """The closest points of all whiskers, which have one contact at most."""
    assert system.profile is not None
    several, none = len(system.profile.objects) > 1, jnp.zeros(touches.size)

    def nearest(*pose):
        here = posed(system, *pose)
        points = closest(here)
        return *points, gap_at(here, *points), others_distance(here, points[1]) if several else None

    arc, parameter, gap, others = jax.vmap(nearest)(system.rods.length, base, angle)
    return Touching(arc, parameter, gap, none, none, touches, none.astype(int), touches, none + jnp.inf, others)


def misfit(system: System, unit: MotionUnits, start: Start, drive: Float[Array, "3"]) -> Float[Array, ""]:
    """How far a given state is from one of this system: the largest distance in lengths, angle, or energy in EI / L.

    The base must be where the support holds it, and the contact on whisker and object. Of springs between the bases, it
    is the energy by which they are strained too much for the reaction.
    """
    q, given = start.coefficients(system.n), start.base / jnp.stack([unit.length, unit.length, 1.0])
    z = start.free(system, drive, unit)
    base = system.bases(z, drive)
    off = jnp.maximum(jnp.max(jnp.abs(base - given)), jnp.max(start.off))
    if system.network is not None and start.reaction is not None:
        load = load_at(start.reaction / jnp.stack([unit.force, unit.force, unit.moment]), drive[2:], system.free)
        beyond = system.strain(z) - system.network.compliance @ load
        off = jnp.maximum(off, beyond @ system.elastic(beyond) / 2)
    if system.profile is None:
        return jax.lax.stop_gradient(off)

    if system.contacts > 1:
        given = start.contact[..., 0], start.touches
        places = places_at(system, base, angles_of(system, q, base), given)
        missing = jnp.sum(start.touches, axis=1) - jnp.sum(places.touches, axis=1)
        return jax.lax.stop_gradient(jnp.maximum(off, jnp.max(missing)))

    def one(rod, q, base, contact):
        angle = jnp.pi / 2 + base[2] + rod.rest + system.basis.angles @ q
        here = posed(system, rod.length, base, angle)
        _, reach = weights_at(system.basis, contact[0])
        at = base[:2] + rod.length * jnp.stack([reach @ jnp.cos(angle), reach @ jnp.sin(angle)])
        # Shape functions pass the contact at a small distance, and so they pass the object.
        gap = gap_at(here, *closest(here))
        return jnp.abs(gap.distance - gap.normal @ (at - contact[1:] / unit.length))

    apart = jax.vmap(one)(system.rods, q, given, start.contact)
    return jax.lax.stop_gradient(jnp.maximum(off, jnp.max(jnp.where(start.touches, apart, 0.0))))


def _closed(system: System, rod: Rods, q: Array, base: Array, touches: Bool[Array, ""]) -> Array:
    """The shape of a touching whisker, bent by a change of the contact force that closes the gap to first order."""
    angle = jnp.pi / 2 + base[2] + rod.rest + system.basis.angles @ q
    here = posed(system, rod.length, base, angle)
    gap = gap_at(here, *closest(here))
    across = gap.across @ system.basis.angles
    bends = inverse(rod.stiffness) @ across
    # The closest points move with the shape, to second order.
    return jnp.where(touches, first_order(q - bends * gap.distance / (across @ bends)), q)


def _closed_together(system: System, rod: Rods, q: Array, touching: Touching) -> Array:
    """The shape of a whisker, bent by changes of all contact forces that close the gaps to first order."""
    across = touching.gap.across @ system.basis.angles
    bends = inverse(rod.stiffness) @ across.T
    acts = touching.touches
    ease = jnp.where(acts[:, None] & acts, across @ bends, jnp.eye(acts.size))
    force = solve(ease, jnp.where(acts, touching.gap.distance, 0.0)[:, None])[:, 0]
    return first_order(q - bends @ force)
