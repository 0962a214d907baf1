"""Springs on shafts in the dimensionless problem, and the whiskers that they hold before any contact."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.friction import slipping_from
from jaxwhisker._equilibrium.newton import solve_point
from jaxwhisker._equilibrium.point import Mode, Point, at_control
from jaxwhisker._equilibrium.problem import NOWHERE, Attached, InPlane, Poses
from jaxwhisker._equilibrium.shaft_springs import AXIAL, Attachments, Laws, ShaftSprings, Tissue
from jaxwhisker._model.motion import Pose, mounted
from jaxwhisker._model.scene import Units
from jaxwhisker._model.spring import AXES, Spring
from jaxwhisker._model.support import Support
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section

SHARES = np.linspace(0.0, 1.0, 9)[1:]  # of the springs' tensions, which grow until they are the given ones


class _Law(eqx.Module):
    """A user-defined law of tension in the dimensionless problem."""

    law: Any
    length: Scalar  # unit of the extension
    tension: Scalar  # unit of the tension

    def __call__(self, extension: Scalar) -> Scalar:
        return self.law(extension * self.length) / self.tension


class OnShafts(NamedTuple):
    """The springs on the shafts of all whiskers."""

    held_by: Attachments  # fields (whiskers, springs) and (whiskers,)
    laws: Laws
    ranks: Int[Array, "whiskers springs"]  # places of the springs in the order of the support


def attached(support: Support, section: Any, unit: Units) -> OnShafts | None:
    """Dimensionless springs on the shafts of all whiskers; None without such springs."""
    springs, laws = support.attached, []
    if not support.on_shafts:
        return None
    each: list[list[ShaftSprings]] = [[] for _ in range(support.whiskers)]
    for spring in springs:
        if callable(spring.stiffness):
            turns = spring.axis == "phi"
            laws.append(_Law(spring.stiffness, 1.0 if turns else unit.length, unit.moment if turns else unit.force))
        k = spring.between[1] - 1
        own = section[k] if isinstance(section, tuple) else jax.tree.map(lambda leaf, k=k: leaf[k], section)
        mount = support.mounts[k]
        mounted = Pose(mount.x / unit.length, mount.y / unit.length, mount.angle)
        each[k].append(_dimensionless(spring, own, mounted, unit, len(laws)))
    none = ShaftSprings(*[jnp.zeros((), int if name in ("axis", "law") else float) for name in ShaftSprings._fields])
    tissue = _tissue(support, unit)
    if tissue is not None:
        for k, own in enumerate(each):
            own += [none._replace(at=tissue.start[k]), none._replace(at=tissue.stop[k])]
    room = 1 + max(map(len, each))
    stacked = [jax.tree.map(lambda *leaves: jnp.stack(leaves), *one, *[none] * (room - len(one))) for one in each]
    unsorted = jax.tree.map(lambda *leaves: jnp.stack(leaves), *stacked)
    ordered, _ = jax.vmap(lambda own: own.with_places(jnp.zeros(0)))(unsorted)
    ranks = jax.vmap(lambda own: jnp.argsort(own.order))(unsorted)
    return OnShafts(Attachments(ordered, tissue), tuple(laws), ranks)


def _dimensionless(spring: Spring, section: Section | None, mount: Pose, unit: Units, law: int) -> ShaftSprings:
    at = jnp.asarray(0.0 if spring.at is None else spring.at, dtype=float) / unit.length
    x, y, angle = _on_unloaded(at, section)
    cos, sin = jnp.cos(mount.angle), jnp.sin(mount.angle)
    x, y = mount.x + x * cos - y * sin, mount.y + x * sin + y * cos
    if spring.anchor is not None:
        x, y = (jnp.asarray(part, dtype=float) / unit.length for part in spring.anchor)
    turns, own, axial = spring.axis == "phi", callable(spring.stiffness), spring.axis == "axial"
    rest_length = jnp.asarray(spring.rest_length, dtype=float)
    stiffness = unit.moment if turns else unit.force / unit.length
    return ShaftSprings(
        at,
        x,
        y,
        jnp.asarray(mount.angle + angle),
        jnp.zeros(()) if own else 1 / (spring.softness * stiffness),
        (jnp.abs(rest_length) if axial else rest_length) / (1.0 if turns else unit.length),
        jnp.asarray(AXIAL if axial else AXES.index(spring.axis), dtype=int),
        jnp.asarray({"tension": 1.0, "compression": -1.0, None: 0.0}[spring.one_sided], dtype=float),
        jnp.asarray(law if own else 0, dtype=int),
        jnp.ones(()),
    )


def _tissue(support: Support, unit: Units) -> Tissue | None:
    """Dimensionless foundations of all whiskers; None without any."""
    if all(one is None for one in support.foundations):
        return None
    rows = []
    for mount, own in zip(support.mounts, support.foundations, strict=True):
        lengths = (0.0, 0.0, 0.0) if own is None else (own.start, own.stop, own.rest_length)
        start, stop, rest, x, y = (jnp.asarray(v, dtype=float) / unit.length for v in (*lengths, mount.x, mount.y))
        stiffness = jnp.asarray(0.0 if own is None else own.stiffness, dtype=float) / (unit.force / unit.length**2)
        angle = jnp.asarray(mount.angle, dtype=float)
        rows.append(Tissue(start, stop, stiffness, rest, x, y, jnp.cos(angle), jnp.sin(angle)))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)


def _on_unloaded(at: Scalar, section: Section | None) -> tuple[Scalar, Scalar, Scalar]:
    """Position and angle to the upright of a point of an unloaded whisker whose base is upright at the origin."""
    zero = jnp.zeros_like(at)
    if section is None or section.intrinsic_curvature is None:
        return zero, at, zero
    start, nothing = (zero, zero, zero, zero + 1.0), rod.Load(None, zero, None)
    above = jnp.maximum(at, 0.0)
    x, y, cos, sin = rod.integrate(start, -above, nothing, section, steps=16, from_base=zero)
    return x, y + jnp.minimum(at, 0.0), jnp.arctan2(-cos, sin)


class _Unloaded(NamedTuple):
    problem: InPlane
    found: Bool[Array, ""]


def with_unloaded(problem: InPlane, held_by: Attachments, laws: Laws, held: Float[Array, "whiskers 3 3"]) -> _Unloaded:
    """The problem with springs on shafts, and whether its unloaded whiskers are in equilibrium.

    Args:
        problem: the problem without these springs.
        held_by: see `Attached`.
        laws: see `Attached`.
        held: see `Attached`.
    """
    still = jax.lax.stop_gradient((problem, held_by, laws, held))

    def with_springs(problem, held_by, laws, held, contact, pose) -> InPlane:
        attached = Attached(held_by, laws, held, contact, pose)
        return eqx.tree_at(lambda p: p.attached, problem, attached, is_leaf=lambda leaf: leaf is None)

    contact, pose = _found(*still, with_springs)
    contact, pose = jax.lax.stop_gradient((contact, pose))
    found = jnp.all(jnp.isfinite(contact)) & jnp.all(jnp.isfinite(pose))
    contact, pose = (jnp.where(found, value, 0.0) for value in (contact, pose))
    return _Unloaded(with_springs(problem, held_by, laws, held, contact, pose), found)


def _found(problem, held_by, laws, held, with_springs) -> tuple[Float[Array, "whiskers 3"], Poses]:
    """Contacts and coordinates of the unloaded whiskers; NaN if they are not found."""
    ends = problem.motion.ends
    u = jnp.asarray(0.0 if ends is None else ends[0] / problem.unit.control, dtype=float)
    side = jnp.ones_like(problem.length)
    friction = None if problem.friction_angle is None else slipping_from(side)
    mode = Mode(jnp.zeros(side.size, int), side, jnp.asarray(False), friction=friction)
    unbent, none = _unbent(problem, u), jnp.zeros_like(problem.rest(u))

    def grown(carry, share):
        contact, _, _ = carry
        part = held_by.weakened(share)
        problem_then = with_springs(problem, part, laws, share * held, contact, none)
        solution = solve_point(problem_then, mode, at_control(u, contact), Point(contact, u))
        return (solution.point.z, solution.newton.pose, solution.converged), None

    start = unbent, none, jnp.asarray(False)
    (contact, pose, found), _ = jax.lax.scan(grown, start, SHARES)
    return jnp.where(found, contact, jnp.nan), pose - problem.rest(u)


def _unbent(problem: InPlane, u: Scalar) -> Float[Array, "whiskers 3"]:
    """Contacts of free whiskers that no spring bends, with their bases at rest."""
    base, drive = problem.in_scene(u, problem.rest(u)), mounted(problem.drive(u), NOWHERE)
    x, y, cos, sin = (values[:, -1] for values in problem.outline)
    turn_cos, turn_sin = jnp.cos(base.angle), jnp.sin(base.angle)
    right, up = base.x + x * turn_cos - y * turn_sin - drive.x, base.y + x * turn_sin + y * turn_cos - drive.y
    angle = base.angle + jnp.arctan2(-cos, sin) - jnp.arctan2(drive.sin, drive.cos)
    return jnp.stack([right * drive.cos + up * drive.sin, up * drive.cos - right * drive.sin, angle], axis=1)
