"""The dimensionless problem of a scene in space: what programs are compiled for.

Lengths are in the length L of the first whisker, forces in EI/L^2 and moments in EI/L, with EI its bending stiffness at
the base. Bases have six coordinates in the frame of the drive: a displacement and a rotation vector relative to their
mounts. Clamped bases have no flexibility, straight round whiskers no torsion, and most scenes no gravity: what is
absent costs nothing. Whiskers with a weight hang while they are free, and their bases carry it.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import safe_placeholder
from jaxwhisker._base.rotation import matrix_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.dimensionless import sections, stacked_or_each
from jaxwhisker._model.drives import Placement, SpaceMotion, mount_in_space, placement_of
from jaxwhisker._model.motion import AbstractMotion
from jaxwhisker._model.scene import Units, units_of
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.whisker import with_equal_breaks
from jaxwhisker._rod.elastica import AbstractRod
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, points
from jaxwhisker._space.contact import SpaceWhisker
from jaxwhisker._space.free import INTERVALS, SpaceOutline
from jaxwhisker._space.hanging import Hanging, hung
from jaxwhisker._space.section import space_section
from jaxwhisker._space.weight import SpaceWeight, weights_in_space

LEAST_FRICTION = 1e-12  # is added to the coefficient: without any, the direction in which a contact slips is unknown
THINNEST = 5e-7  # half thickness of an object, in lengths: of thinner ones, a touch is not resolved

PerWhisker = Float[Array, " whiskers"]
Contacts = Float[Array, "whiskers 11"]


class Springs(NamedTuple):
    """Flexibility of the bases, and their displacement by the rest lengths of the springs."""

    matrix: Float[Array, "all all"]
    offset: Float[Array, "whiskers rows"]


class SpaceProblem(eqx.Module):
    """A dimensionless scene in space. Whiskers are stacked along the first axis."""

    length: PerWhisker
    bending_stiffness: PerWhisker  # at the base
    section: Section | SpaceSection | tuple[Section | SpaceSection, ...] | None
    surface: AbstractSurface
    rod: AbstractRod
    motion: SpaceMotion | AbstractMotion
    mount: Placement  # fields (whiskers, ...)
    springs: Springs | None  # None: clamped
    outline: SpaceOutline  # of free whiskers, fields (whiskers, ...)
    weight: SpaceWeight | None  # of whiskers, fields (whiskers, ...); None without gravity
    hanging: Float[Array, "whiskers 6"] | None  # loads of free whiskers along the coordinates of their bases
    friction: Scalar | None  # the coefficient mu; None without friction
    onwards: Int[Array, ""]  # +1 if the control increases during a scan, else -1
    ends: tuple[Float[Array, ""], Float[Array, ""]] | None
    valid: Bool[Array, ""]
    unit: Units
    contacts: int = eqx.field(static=True)  # the largest number of contacts of a whisker

    def numbers(self) -> "SpaceProblem":
        """The numbers that equilibria depend on, and None for everything else."""
        numbers = eqx.filter(self, eqx.is_inexact_array)
        return eqx.tree_at(lambda tree: tree.outline, numbers, replace_fn=lambda _: None)  # of free whiskers

    def drive(self, u: Scalar) -> Placement:
        """The frame of the drive at a control."""
        position, rotation = placement_of(self.motion, u * self.unit.control)
        return Placement(position / self.unit.length, rotation)

    @property
    def rolls(self) -> bool:
        """Whether the roll of whiskers is an unknown: see `SpaceScene`."""
        one = self.section[0] if isinstance(self.section, tuple) else self.section
        return isinstance(one, SpaceSection)

    @property
    def may_touch_twice(self) -> bool:
        """Whether whiskers may touch twice: if they are curved, heavy or held, or objects are not one convex body."""
        every = self.section if isinstance(self.section, tuple) else (self.section,)
        curved = any(isinstance(one, SpaceSection) and one.curvature[:2] != (None, None) for one in every)
        curved |= self.weight is not None
        return curved or self.friction is not None or not self.surface.is_convex

    @property
    def rows(self) -> int:
        """Number of equations for the base of a whisker."""
        return 6 if self.rolls else 5

    def displacement(self, load: Float[Array, "whiskers rows"]) -> Float[Array, "whiskers rows"]:
        """Displacement of sprung bases under loads."""
        assert self.springs is not None
        return jnp.reshape(jnp.sum(self.springs.matrix * jnp.ravel(load), axis=-1), load.shape)

    @property
    def on_free(self) -> Float[Array, "whiskers 6"] | float:
        """Loads of free whiskers along the coordinates of their bases: none but their weight."""
        return 0.0 if self.hanging is None else self.hanging

    @property
    def rest(self) -> Float[Array, "whiskers rows"]:
        """Displacement of sprung bases while all whiskers are free."""
        assert self.springs is not None
        if self.hanging is None:
            return self.springs.offset
        return self.springs.offset + self.displacement(self.hanging)


def of_each(problem: SpaceProblem, function: Callable, *args):
    """Apply a function of one whisker's body to every whisker; each gets its own row of the arguments."""
    section = problem.section
    bare = SpaceWhisker(problem.length, problem.bending_stiffness, None, problem.mount, problem.weight)
    if not isinstance(section, tuple):
        return jax.vmap(function)(bare._replace(section=section), *args)
    # Whiskers of different kinds cannot be batched.
    rows = [jax.tree.map(lambda leaf, k=k: leaf[k], (bare, args)) for k in range(len(section))]
    each = [function(body._replace(section=own), *rest) for (body, rest), own in zip(rows, section, strict=True)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def outlines_in_space(length: PerWhisker, section) -> SpaceOutline:
    """Shapes of unloaded whiskers."""
    places = np.linspace(0.0, 1.0, INTERVALS + 1)

    def one(length, section):
        if not isinstance(section, SpaceSection):
            position = (length * places)[:, None] * np.array([0.0, 0.0, 1.0])
            return SpaceOutline(position, jnp.broadcast_to(jnp.eye(3), (places.size, 3, 3)))
        zero = jnp.zeros(())
        start = (zero, zero, zero), (zero + 1, zero, zero, zero)
        r, q = points(start, -length, SpaceLoad((zero, zero, zero)), section, at=jnp.asarray(places), from_base=zero)
        return SpaceOutline(jnp.stack(r, axis=-1), jax.vmap(matrix_of)(jnp.stack(q, axis=-1)))

    if isinstance(section, tuple):
        each = [one(length[k], own) for k, own in enumerate(section)]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    return jax.lax.stop_gradient(jax.vmap(one)(length, section))


def problem_in_space(scene: SpaceScene) -> SpaceProblem:
    """The dimensionless problem of a scene in space, differentiable with respect to all numbers of the scene."""
    valid = scene.valid()
    scene = safe_placeholder(scene, valid)
    whiskers, heavy = scene.whiskers, scene.gravity is not None
    unit = jax.tree.map(checks.as_float, units_of(whiskers[0], scene.motion))
    length = jnp.stack([jnp.asarray(w.length, dtype=float) for w in whiskers]) / unit.length
    stiffness = jnp.stack([jnp.asarray(w.base_stiffness, dtype=float) for w in whiskers])
    stiffness_unit = unit.moment * unit.length
    if scene.rolls:
        alike = with_equal_breaks(jax.tree.map(checks.as_float, whiskers))
        section = stacked_or_each(
            [space_section(whisker, unit.length, stiffness_unit, heavy=heavy) for whisker in alike]
        )
    else:
        section = sections(whiskers, unit.length, stiffness_unit)
    mounts = [mount_in_space(mount) for mount in scene.support.mounts]
    position, rotation = (jnp.stack(parts) for parts in zip(*mounts, strict=True))
    springs = None
    if scene.support.springs:
        whole, n = scene.support.flexibility_in_space().in_space(unit.length, unit.force), len(whiskers)
        keep = np.arange(6 * n).reshape(n, 6)[:, : 6 if scene.rolls else 5].ravel()
        springs = Springs(whole.matrix[np.ix_(keep, keep)], whole.offset[keep].reshape(n, -1))
        valid &= whole.consistent
    surface = scene.surface.in_unit(unit.length)
    valid &= surface.thickness() > THINNEST
    ends = scene.motion.ends
    outline = outlines_in_space(length, section)
    problem = SpaceProblem(
        length=length,
        bending_stiffness=stiffness / stiffness_unit,
        section=section,
        surface=surface,
        rod=scene.rod,
        motion=scene.motion,
        mount=Placement(position / unit.length, rotation),
        springs=springs,
        outline=outline,
        weight=weights_in_space(whiskers, scene.gravity, unit),
        hanging=None,
        friction=None if scene.friction is None else jnp.asarray(scene.friction, dtype=float) + LEAST_FRICTION,
        onwards=jnp.asarray(scene.motion.onwards),
        ends=None if ends is None else tuple(jnp.asarray(end, dtype=float) / unit.control for end in ends),
        valid=valid,
        unit=unit,
        contacts=scene.contacts,
    )
    return _with_hanging(problem, any(axis.startswith("phi") for axis in scene.support.axes)) if heavy else problem


def _with_hanging(problem: SpaceProblem, tilts: bool) -> SpaceProblem:
    """The problem of whiskers with a weight, which hang; not valid if an upright one buckles.

    `tilts` tells whether torsion springs hold bases; they do not connect whiskers.
    """
    n, places = problem.length.size, jnp.linspace(0.0, 1.0, INTERVALS + 1)
    rest, compliance = jnp.zeros((n, 3)), None
    if problem.springs is not None and tilts:
        rest, matrix = problem.springs.offset[:, 3:], jnp.diagonal(problem.springs.matrix)
        compliance = jnp.reshape(matrix, (n, 6))[:, 3:]

    def one(body, rest, compliance):
        assert body.weight is not None and isinstance(body.section, SpaceSection)
        free = Hanging(body.weight, body.length, body.section, body.mount.rotation, compliance, rest)
        found = hung(free, places)
        return SpaceOutline(found.position, found.rotation), found.load, found.stable

    outline, hanging, stable = of_each(problem, one, rest, compliance)
    good = stable & jnp.all(jnp.isfinite(hanging), axis=1)
    outline = jax.tree.map(
        lambda bent, straight: jnp.where(jnp.reshape(good, (-1, *[1] * (bent.ndim - 1))), bent, straight),
        jax.lax.stop_gradient(outline),
        problem.outline,
    )
    hanging = jnp.where(good[:, None], hanging, 0.0)
    return dataclasses.replace(problem, outline=outline, hanging=hanging, valid=problem.valid & jnp.all(good))
