"""Moving whiskers on their support, dimensionless: masses, stiffness and springs, poses of bases, positions of nodes.

Units: the length L, bending stiffness EI and mass per length rho A of the first whisker at its base; times are in
L^2 sqrt(rho A / EI). Coordinates of a whisker are n coefficients of its curvature (see legendre.py), and those of the
displacements of its base relative to the drive that springs leave free, in the frame of the drive. Rods are
inextensible, and the rotary inertia of their cross-sections is neglected.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.held import SprungShafts, held_of
from jaxwhisker._dynamics.legendre import Basis, basis
from jaxwhisker._dynamics.outline import outline
from jaxwhisker._equilibrium.shaft_springs import Laws
from jaxwhisker._model.motion import AbstractMotion, Pose, pose_of
from jaxwhisker._model.network import along_all_axes
from jaxwhisker._model.objects import Objects
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, Sensor, time_unit, units_of
from jaxwhisker._model.spring import AXES
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker


class Rods(NamedTuple):
    """All whiskers, stacked."""

    length: Float[Array, " whiskers"]
    rest: Float[Array, "whiskers points"]  # angle of the unloaded whisker to its base
    stiffness: Float[Array, "whiskers n n"]
    mass: Float[Array, "whiskers nodes"]
    inertia: Float[Array, " whiskers"]  # at the base
    first: Float[Array, "whiskers points"]  # mass times reach, summed over the nodes
    second: Float[Array, "whiskers points points"]  # mass times the product of two reaches, likewise
    held: SprungShafts | None = None  # springs on the shafts; None without any


class Network(NamedTuple):
    """Springs between the drive and the free coordinates of the bases; displacement = offset + compliance @ load."""

    compliance: Float[Array, "free free"]
    offset: Float[Array, "whiskers 3"]
    damping: Float[Array, "free free"]  # force per velocity
    # Stiffness of springs that the compliance contains, but that do not exist: see `Support.flexibility`. Their forces
    # are taken off again. None without springs on shafts.
    hold: Float[Array, " free"] | None = None


class Damping(eqx.Module):
    """Damping, in the scene's units or dimensionless."""

    mass: Scalar  # rate
    stiffness: Scalar  # time constant
    base: tuple[Scalar, Scalar, Scalar]  # of the bases, in the frames of their mounts


class System(eqx.Module):
    """Everything that moves, dimensionless."""

    rods: Rods
    mount: Pose  # of every whisker on the drive
    network: Network | None  # None if all bases are clamped to the drive
    profile: AbstractProfile | None
    friction: Scalar | None
    mass_damping: Scalar
    stiffness_damping: Scalar
    laws: Laws  # of springs on shafts that are not linear
    free: tuple[int, ...] = eqx.field(static=True)  # free coordinates out of x, y, angle of base 1, then of base 2
    n: int = eqx.field(static=True)  # shape functions per whisker
    contacts: int = eqx.field(static=True, default=1)  # of each whisker, at most

    @property
    def basis(self) -> Basis:
        """Shape functions and quadrature."""
        return basis(self.n)

    def displacement(self, z: Float[Array, " free"]) -> Float[Array, "whiskers 3"]:
        """Displacements of all bases relative to the drive, in its frame."""
        if self.network is None:
            return jnp.zeros((self.rods.length.shape[0], 3))
        return jnp.ravel(self.network.offset).at[jnp.array(self.free)].set(z).reshape(-1, 3)

    def bases(self, z: Float[Array, " free"], drive: Float[Array, "3"]) -> Float[Array, "whiskers 3"]:
        """Poses of all bases in the scene: x, y, and angle to the upright."""
        d = self.displacement(z)
        cos, sin = jnp.cos(drive[2]), jnp.sin(drive[2])
        x, y = self.mount.x + d[:, 0], self.mount.y + d[:, 1]
        at = (drive[0] + cos * x - sin * y, drive[1] + sin * x + cos * y, drive[2] + self.mount.angle + d[:, 2])
        return jnp.stack(at, axis=-1)

    def strain(self, z: Float[Array, " free"]) -> Float[Array, " free"]:
        """Free displacements of the bases from where the springs are at rest."""
        return z - self.at_rest

    def elastic(self, strain: Float[Array, " free"]) -> Float[Array, " free"]:
        """Elastic forces of the springs."""
        assert self.network is not None
        force = inverse(self.network.compliance) @ strain
        return force if self.network.hold is None else force - self.network.hold * strain

    @property
    def is_free(self) -> Bool[Array, "whiskers 3"]:
        """Which coordinates of the bases are free."""
        whiskers = self.rods.length.shape[0]
        return jnp.zeros(3 * whiskers, bool).at[jnp.array(self.free, int)].set(True).reshape(whiskers, 3)

    @property
    def contact_unknowns(self) -> int:
        """Number of unknowns of all contacts of a whisker: arc length, parameter, normal force and drag of each."""
        return 0 if self.profile is None else self.contacts * (3 if self.friction is None else 4)

    # Where whiskers may have several contacts, what belongs to contacts has an axis for them; otherwise it has none.

    def by_contact(self, unknowns: Float[Array, "*batch contact"]) -> Array:
        """The unknowns of contacts, with an axis for these if there may be several."""
        return unknowns if self.contacts == 1 else unknowns.reshape(*unknowns.shape[:-1], self.contacts, -1)

    def over_contacts(self, of_whiskers: Array) -> Array:
        """What is known of whiskers, with an axis for contacts if there may be several."""
        return of_whiskers if self.contacts == 1 else of_whiskers[:, None]

    @property
    def contact_shape(self) -> tuple[int, ...]:
        """Shape of what is known of all contacts."""
        whiskers = self.rods.length.shape[0]
        return (whiskers,) if self.contacts == 1 else (whiskers, self.contacts)

    @property
    def may_wedge(self) -> bool:
        """Whether friction has to know of inner corners."""
        several = self.contacts > 1 and self.friction is not None
        return several and self.profile is not None and self.profile.has_edges

    @property
    def at_rest(self) -> Float[Array, " free"]:
        """Free coordinates of the bases where the springs are at rest."""
        if self.network is None:
            return jnp.zeros(0)
        return jnp.ravel(self.network.offset)[jnp.array(self.free)]


class MotionUnits(NamedTuple):
    """Units of the dimensionless problem, expressed in the scene's own units."""

    length: Scalar
    force: Scalar
    moment: Scalar
    time: Scalar

    @property
    def energy(self) -> Scalar:
        """That of energies is that of moments."""
        return self.moment


def motion_units(scene: Scene | Sensor) -> MotionUnits:
    """Units in which a scene with masses is dimensionless."""
    first = scene.whiskers[0]
    unit = units_of(first, scene.motion)
    return MotionUnits(unit.length, unit.force, unit.moment, time_unit(first))


def system_of(scene: Scene | Sensor, damping: Damping, n: int) -> System:
    """The dimensionless system of a scene or sensor, with n shape functions per whisker."""
    unit, shapes = motion_units(scene), basis(n)
    rods = [_rod(whisker, unit, shapes) for whisker in scene.whiskers]
    mounts = zip(*((m.x, m.y, m.angle) for m in scene.support.mounts), strict=True)
    x, y, angle = (jnp.stack([jnp.asarray(v, dtype=float) for v in vs]) for vs in mounts)
    free = free_coordinates(scene.support)
    held, laws = held_of(scene, shapes)
    return System(
        rods=jax.tree.map(lambda *leaves: jnp.stack(leaves), *rods)._replace(held=held),
        mount=Pose(x / unit.length, y / unit.length, angle),
        network=_network(scene.support, damping.base, angle, unit, free) if free else None,
        profile=_outline(scene, unit) if isinstance(scene, Scene) else None,
        friction=scene.friction if isinstance(scene, Scene) else None,
        mass_damping=damping.mass * unit.time,
        stiffness_damping=damping.stiffness / unit.time,
        laws=laws,
        free=free,
        n=n,
        contacts=scene.contacts if isinstance(scene, Scene) else 1,
    )


def _outline(scene: Scene, unit: MotionUnits) -> AbstractProfile:
    # Candidates for several contacts are looked for on separate objects, also if there is only one.
    profile = scene.profile if scene.contacts == 1 else Objects(scene.profile.objects)
    return outline(profile.in_unit(unit.length))


def _rod(whisker: Whisker, unit: MotionUnits, shapes: Basis) -> Rods:
    stiffness_unit, mass_unit = unit.moment * unit.length, unit.force * unit.time**2 / unit.length
    length = jnp.asarray(whisker.length, dtype=float)
    s = length * shapes.points
    stiffness = jax.vmap(whisker.stiffness_at)(s) / stiffness_unit
    own = length / unit.length
    along = own * shapes.weights * jax.vmap(whisker.mass_at)(s) * unit.length / mass_unit
    base, tip, inertia = (
        jnp.asarray(0.0 if value is None else value, dtype=float)
        for value in (whisker.base_mass, whisker.tip_mass, whisker.base_inertia)
    )
    # The interpolating polynomials of the Gauss points integrate the intrinsic curvature.
    rest = length * shapes.reach[1:-1] @ jax.vmap(whisker.curvature_at)(s)
    mass = jnp.concatenate([(base / mass_unit)[None], along, (tip / mass_unit)[None]])
    return Rods(
        own,
        rest,
        jnp.asarray(shapes.curvatures.T @ ((shapes.weights * stiffness)[:, None] * shapes.curvatures) / own),
        mass,
        inertia / (mass_unit * unit.length**2),
        jnp.asarray(mass @ shapes.reach),
        jnp.asarray((mass[:, None] * shapes.reach).T @ shapes.reach),
    )


def free_coordinates(support: Support) -> tuple[int, ...]:
    """Indices of the coordinates of the bases that springs leave free: x, y, angle of base 1, then of base 2."""
    freed = ((base, k) for k, axis in enumerate(AXES) for base in support.freed(axis))
    return tuple(sorted(len(AXES) * (base - 1) + k for base, k in freed))


def _network(
    support: Support,
    damping: tuple[Scalar, Scalar, Scalar],
    angle: Float[Array, " whiskers"],
    unit: MotionUnits,
    free: tuple[int, ...],
) -> Network:
    hold = support.hold(unit.force / unit.length, unit.moment) if support.on_shafts else None
    flexibility = support.flexibility(hold)
    if support.axes == ("x",):
        flexibility = along_all_axes({"x": flexibility})
    lengths, loads = (
        jnp.tile(jnp.array(each, dtype=float), support.whiskers)
        for each in ((unit.length, unit.length, 1.0), (unit.force, unit.force, unit.moment))
    )
    cos, sin, zero = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)
    turn = jnp.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1.0], axis=-1).reshape(-1, 3, 3)
    own = turn @ jnp.diag(jnp.stack([jnp.asarray(value, dtype=float) for value in damping])) @ turn.swapaxes(1, 2)
    rows, index = jax.scipy.linalg.block_diag(*own), jnp.array(free)
    rate = rows * lengths / loads[:, None] / unit.time
    return Network(
        (flexibility.matrix * loads / lengths[:, None])[jnp.ix_(index, index)],
        (flexibility.offset / lengths).reshape(-1, 3),
        rate[jnp.ix_(index, index)],
        None if hold is None else (jnp.ravel(hold) * lengths / loads)[index],
    )


def drive_pose(motion: AbstractMotion, control: Scalar, unit: MotionUnits) -> Float[Array, "3"]:
    """Pose of the drive at a control, in the scene's units: x, y and angle, dimensionless."""
    x, y, angle = pose_of(motion, control)
    return jnp.stack([x / unit.length, y / unit.length, angle])
