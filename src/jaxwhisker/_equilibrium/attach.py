"""Springs on shafts in the dimensionless problem, and the whiskers that they hold before any contact."""

from collections import Counter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact_state import all_free
from jaxwhisker._equilibrium.couplings import Couplings, End
from jaxwhisker._equilibrium.point import Point, at_control
from jaxwhisker._equilibrium.problem import AT_ORIGIN, Attached, InPlane
from jaxwhisker._equilibrium.shaft_springs import AXIAL, Attachments, Laws, ShaftSprings, Tissue
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._equilibrium.stance import Contacts, Poses
from jaxwhisker._equilibrium.weight import Weight
from jaxwhisker._model.motion import Pose, mounted
from jaxwhisker._model.scene import Units
from jaxwhisker._model.spring import AXES, Spring
from jaxwhisker._model.support import Support
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.walk import in_order

# Shares of the springs' tensions, which grow until they are the given ones. The first shares are small: stiff springs
# bend the whisker early, and from too far away Newton's method finds whiskers that are wound up by a full turn.
SHARES = np.array([0.001, 0.004, 0.015, 0.05, 0.12, 0.25, 0.4, 0.6, 0.8, 1.0])


class _TensionLaw(eqx.Module):
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
    blank: Contacts  # contacts of zeros
    couplings: Couplings | None = None  # springs between two shafts; None without any


def attached(support: Support, section: Any, unit: Units, weight: Weight | None = None) -> OnShafts | None:
    """Dimensionless springs on the shafts of all whiskers, and their weights; None without any of these."""
    springs, laws = support.attached, []
    if not support.on_shafts and weight is None:
        return None
    each: list[list[ShaftSprings]] = [[] for _ in range(support.whiskers)]
    between = []  # springs between two shafts, and the ranks of both ends
    for spring in springs:
        if callable(spring.stiffness):
            turns = spring.axis == "phi"
            laws.append(
                _TensionLaw(spring.stiffness, 1.0 if turns else unit.length, unit.moment if turns else unit.force)
            )
        ends = []
        for whisker, at in spring.ends:
            k = whisker - 1
            own = section[k] if isinstance(section, tuple) else jax.tree.map(lambda leaf, k=k: leaf[k], section)
            mount = support.mounts[k]
            mounted = Pose(mount.x / unit.length, mount.y / unit.length, mount.angle)
            ends.append((k, len(each[k])))
            each[k].append(_dimensionless(spring, at, own, mounted, unit, len(laws)))
        if len(ends) > 1:
            second, rank = ends[1]
            between.append((each[second][rank], *ends))
            for k, rank in ends:
                each[k][rank] = each[k][rank]._replace(share=jnp.zeros(()))
    none = ShaftSprings(*[jnp.zeros((), int if name in ("axis", "law") else float) for name in ShaftSprings._fields])
    tissue = _tissue(support, unit)
    if tissue is not None:
        for k, own in enumerate(each):
            own += [none._replace(at=tissue.start[k]), none._replace(at=tissue.stop[k])]
    room = 1 + max(map(len, each))
    stacked = [jax.tree.map(lambda *leaves: jnp.stack(leaves), *one, *[none] * (room - len(one))) for one in each]
    unsorted = jax.tree.map(lambda *leaves: jnp.stack(leaves), *stacked)

    def sort(own: ShaftSprings) -> tuple[ShaftSprings, Int[Array, " springs"]]:
        order = in_order(own.at)
        return order.spread(0, own), order.ranks[0]

    ordered, ranks = jax.vmap(sort)(unsorted)
    blank = jnp.zeros((support.whiskers, 3 + support.shaft_loads))
    found = OnShafts(Attachments(ordered, tissue, weight=weight), tuple(laws), ranks, blank)
    return found if not between else _coupled(found, between)


def _coupled(springs: OnShafts, between: list[tuple[ShaftSprings, tuple[int, int], tuple[int, int]]]) -> OnShafts:
    """The same with these springs between two shafts, each with whisker and rank of its ends."""
    each, *ends = zip(*between, strict=True)
    taken: Counter[int] = Counter()  # loads in the contacts of each whisker
    starts = []
    for k, _ in ends[1]:
        taken[k] += 1
        starts.append(k * springs.blank.shape[1] + 3 * taken[k])
    columns = np.array(starts)[:, None] + np.arange(3)
    first, second = (
        End(jnp.array([k for k, _ in own]), jnp.stack([springs.ranks[k, rank] for k, rank in own])) for own in ends
    )
    spring = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    return springs._replace(couplings=Couplings(spring, first, second, jnp.asarray(columns)))


def _dimensionless(
    spring: Spring, at: Scalar, section: Section | None, mount: Pose, unit: Units, law: int
) -> ShaftSprings:
    at = jnp.asarray(at, dtype=float) / unit.length
    x, y, angle = on_unloaded(at, section, mount)
    if spring.anchor is not None:
        x, y = (jnp.asarray(part, dtype=float) / unit.length for part in spring.anchor)
    turns, own, axial = spring.axis == "phi", callable(spring.stiffness), spring.axis == "axial"
    rest_length = jnp.asarray(spring.rest_length, dtype=float)
    stiffness = unit.moment if turns else unit.force / unit.length
    return ShaftSprings(
        at,
        x,
        y,
        angle,
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


def on_unloaded(at: Scalar, section: Section | None, base: Pose) -> list[Float[Array, ""]]:
    """Position and angle to the upright of a point of an unloaded whisker whose base has this pose.

    Below the base, at negative arc lengths, the whisker goes on straight.
    """
    x, y, turn = jnp.zeros_like(at), at, jnp.zeros_like(at)
    if section is not None and section.intrinsic_curvature is not None:
        start, nothing = (x, x, x, x + 1.0), rod.Load(None, x, None)
        x, y, cos, sin = rod.integrate(start, -jnp.maximum(at, 0.0), nothing, section, steps=16, from_base=x)
        y, turn = y + jnp.minimum(at, 0.0), jnp.arctan2(-cos, sin)
    cos, sin = jnp.cos(base.angle), jnp.sin(base.angle)
    return [*map(jnp.asarray, (base.x + x * cos - y * sin, base.y + x * sin + y * cos, base.angle + turn))]


class _UnloadedProblem(NamedTuple):
    problem: InPlane
    found: Bool[Array, ""]


def with_unloaded(problem: InPlane, springs: OnShafts, held: Float[Array, "whiskers 3 3"]) -> _UnloadedProblem:
    """The problem with springs on shafts, and whether its unloaded whiskers are in equilibrium.

    Args:
        problem: the problem without these springs.
        springs: the springs.
        held: see `Attached`.
    """
    contact, pose = _solved(*jax.lax.stop_gradient((problem, springs, held)))
    contact, pose = jax.lax.stop_gradient((contact, pose))
    found = jnp.all(jnp.isfinite(contact)) & jnp.all(jnp.isfinite(pose))
    contact, pose = (jnp.where(found, value, 0.0) for value in (contact, pose))
    return _UnloadedProblem(_with_springs(problem, springs, held, contact, pose), found)


def _with_springs(
    problem: InPlane, springs: OnShafts, held: Float[Array, "whiskers 3 3"], contact: Contacts, pose: Poses
) -> InPlane:
    attached = Attached(springs.held_by, springs.laws, held, contact, pose, springs.couplings)
    return eqx.tree_at(lambda p: p.attached, problem, attached, is_leaf=lambda leaf: leaf is None)


def _weakened(springs: OnShafts, share: Scalar, heavy: Scalar) -> OnShafts:
    """The springs with a share of all tensions, and the whiskers with one of their weights."""
    couplings = springs.couplings
    if couplings is not None:
        spring = couplings.spring
        couplings = couplings._replace(spring=spring._replace(share=share * spring.share))
    return springs._replace(held_by=springs.held_by.weakened(share, heavy), couplings=couplings)


def _solved(problem: InPlane, springs: OnShafts, held: Float[Array, "whiskers 3 3"]) -> tuple[Contacts, Poses]:
    """Contacts and coordinates of the unloaded whiskers; NaN if they are not found."""
    u = jnp.asarray(0.0 if problem.ends is None else problem.ends[0])
    state = all_free(problem, jnp.ones_like(problem.length))
    unbent, none = _unbent(problem, u), jnp.zeros_like(problem.rest(u))

    def grown(carry, shares):
        (contact, _, _), (share, heavy) = carry, shares
        problem_then = _with_springs(problem, _weakened(springs, share, heavy), share * held, contact, none)
        solution = solve_point(problem_then, state, at_control(u, contact), Point(contact, u))
        return (solution.point.z, solution.newton.pose, solution.converged), None

    start = springs.blank.at[:, :3].set(unbent), none, jnp.asarray(False)
    shares, heavy = SHARES, np.zeros(SHARES.size)
    if springs.held_by.weight is not None:
        # Weak springs would not hold it.
        shares, heavy = np.append(shares, np.ones(SHARES.size)), np.append(heavy, SHARES)
    (contact, pose, found), _ = jax.lax.scan(grown, start, (shares, heavy))
    return jnp.where(found, contact, jnp.nan), pose - problem.rest(u)


def _unbent(problem: InPlane, u: Scalar) -> Float[Array, "whiskers 3"]:
    """Contacts of free whiskers that no spring bends, with their bases at rest."""
    base, drive = problem.in_scene(u, problem.rest(u)), mounted(problem.drive(u), AT_ORIGIN)
    x, y, cos, sin = (values[:, -1] for values in problem.outline)
    turn_cos, turn_sin = jnp.cos(base.angle), jnp.sin(base.angle)
    right, up = base.x + x * turn_cos - y * turn_sin - drive.x, base.y + x * turn_sin + y * turn_cos - drive.y
    angle = base.angle + jnp.arctan2(-cos, sin) - jnp.arctan2(drive.sin, drive.cos)
    return jnp.stack([right * drive.cos + up * drive.sin, up * drive.cos - right * drive.sin, angle], axis=1)
