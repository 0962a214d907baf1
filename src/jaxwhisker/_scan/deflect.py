"""Deflection of one whisker under given loads: forces and moments at points along it, and forces per length."""

from typing import TYPE_CHECKING, Any, TypeGuard, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.line_loads import weight_of
from jaxwhisker._model.loads import LineLoad, PointForce, PointMoment, SpaceForce, SpaceMoment
from jaxwhisker._model.scene import check_in_plane
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.deflection import ROD_STEPS, AbstractLoadCase, deflected
from jaxwhisker._scan.applied_loads import Given
from jaxwhisker._scan.loaded_rod import LoadedRod, bent, loaded_rod
from jaxwhisker._scan.resolution import warn_of_whisker

if TYPE_CHECKING:
    from jaxwhisker._space.deflect import SpaceDeflection

CLAMP = Support.clamped()


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
    status: Int[Array, ""]  # Status.ok, .unstable, .inexact or .invalid
    whisker: Whisker
    loads: Given  # with the weight, if `gravity` is given
    support: Support


class PlaneLoadCase(AbstractLoadCase):
    """A whisker in the plane, its loads and its support."""

    whisker: Whisker
    loads: Given
    support: Support

    def equations(self) -> LoadedRod:
        """The equations."""
        return loaded_rod(self.whisker, self.loads, self.support)

    def valid(self, rods: LoadedRod) -> Bool[Array, ""]:
        """Whether all numbers are in their domains."""
        valid = self.whisker.valid() & self.support.valid() & checks.all_finite(rods.loads)
        valid &= jnp.all((rods.loads.position > 0) & (rods.loads.position <= 1))
        for line in rods.lines:
            valid &= line.inside
        for _, _, place in self.support.attachments():
            valid &= jnp.asarray(place) < self.whisker.length
        return valid

    def values(self, rods: LoadedRod, unknowns: Array, points: int) -> dict[str, Array]:
        """Fields of a Deflection."""
        found = bent(rods, unknowns, points)
        length, stiffness = map(jnp.asarray, (self.whisker.length, self.whisker.base_stiffness))
        fx, fy, mz = -found.load
        base_x, base_y, base_angle = found.pose
        x, y, cos, sin = found.states
        section = rods.section
        curvature = found.moment if section is None else jax.vmap(section.total_curvature)(found.moment, found.s)
        lengths = found.lengths[rods.ranks]
        return {
            "fx": fx * stiffness / length**2,
            "fy": fy * stiffness / length**2,
            "mz": mz * stiffness / length,
            "base_x": base_x * length,
            "base_y": base_y * length,
            "base_angle": base_angle,
            "s": found.s * length,
            "x": x * length,
            "y": y * length,
            "angle": jnp.unwrap(jnp.arctan2(sin, cos)),
            "curvature": curvature / length,
            "spring_length": _spring_lengths(self.whisker, self.support, found.pose, lengths),
        }


@overload
def deflect(
    whisker: Whisker,
    *loads: PointForce | PointMoment | LineLoad,
    support: Support = CLAMP,
    gravity: tuple[Scalar, Scalar] | None = None,
    points: int = 101,
) -> Deflection: ...
@overload
def deflect(
    whisker: Whisker,
    *loads: PointForce | PointMoment | LineLoad | SpaceForce | SpaceMoment,
    gravity: tuple[Scalar, Scalar] | tuple[Scalar, Scalar, Scalar] | None = None,
    points: int = 101,
) -> "SpaceDeflection": ...
@with_own_settings
def deflect(
    whisker: Whisker,
    *loads: PointForce | PointMoment | LineLoad | SpaceForce | SpaceMoment,
    support: Support = CLAMP,
    gravity: tuple[Scalar, Scalar] | tuple[Scalar, Scalar, Scalar] | None = None,
    points: int = 101,
) -> Any:
    """Reaction and shape of a whisker under given loads, clamped at (0, 0) along +y or on a support.

    All loads are increased together from zero, and the solution is the one that begins at rest.

    Args:
        whisker: the whisker.
        *loads: any number of PointForce, PointMoment and LineLoad, in any order; at least one without `gravity`. Their
            directions refer to the upright whisker at rest, also if it is mounted at an angle; a dead load keeps its
            direction. A clamped whisker bends in space if one load is a SpaceForce, a SpaceMoment or a LineLoad with a
            component along z, or if it is curved or twisted in space.
        support: support of one whisker, with the drive at (0, 0). Default: a clamp. Springs on the shaft grow from zero
            before the loads do. fx, fy and mz are then what the shaft carries at its base, as in a scan.
        gravity: acceleration along x and y, and z in space, whose weight of the whisker's `mass_per_length` and
            `tip_mass` is added to the loads: (0.0, -9.81) for a whisker in SI units that stands upright. The weight of
            the `base_mass` does not load the whisker and is left out. Default: no weight.
        points: number of points on each stretch between point loads, and between a load and the base; at least 2.

    Returns:
        A Deflection, or a SpaceDeflection of a whisker that bends in space. Its values are NaN with status `unstable`
        if the whisker loses its stability before the full load is reached: it would snap, or buckle to either side.
        Moments in space and followers have no potential: in the plane, stability is lost where another equilibrium
        begins, and in space where a disturbance grows that a damping in proportion to the stiffness resists, without
        inertia. The values are NaN with status `inexact` if the load is too large for the steps of the rod (beyond a
        few hundred EI/L^2) or no equilibrium is found, and with status `invalid` if a traced parameter is outside its
        domain or a traced load or spring is beyond the tip.

    Warns:
        UserWarning: if the steps of the rod do not resolve a concrete function of arc length; see `Whisker(breaks=)`.

    Raises:
        ValueError: if an argument has the wrong type, there is no load, a load or a spring lies beyond the tip, the
            support is for several whiskers, `gravity` is given for a whisker without a `mass_per_length`, `points` is
            less than 2, or JAX is in float32 mode.

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
    kinds = PointForce | PointMoment | LineLoad | SpaceForce | SpaceMoment
    if not all(isinstance(load, kinds) for load in loads) or not (loads or gravity):
        checks.fail(
            "loads", "one or more of PointForce, PointMoment, LineLoad, SpaceForce and SpaceMoment", repr(loads)
        )
    if not isinstance(support, Support) or support.whiskers != 1:
        checks.fail("support", "a Support of one whisker", repr(support))
    checks.count("points", points, least=2)
    support = support.in_row(whisker.length)
    for name, _, place in support.attachments():
        if not checks.is_traced((place, whisker)) and float(place) >= float(whisker.length):
            checks.fail(name, f"less than the length {whisker.length}", place)
    if support.foundations[0] is not None and whisker.intrinsic_curvature is not None:
        checks.fail("whisker", "straight on a Foundation", "one with an intrinsic curvature")
    for load in loads:
        name = "stop" if isinstance(load, LineLoad) else "position"
        place = getattr(load, name)
        if place is not None and not checks.is_traced((place, whisker)) and float(place) > float(whisker.length):
            checks.fail(name, f"at most the length {whisker.length}", place)
        start = load.start if isinstance(load, LineLoad) else 0.0
        if not checks.is_traced((start, whisker)) and float(start) >= float(whisker.length):
            checks.fail("start", f"less than the length {whisker.length}", start)
    if gravity is not None:
        (checks.triple if isinstance(gravity, tuple) and len(gravity) == 3 else checks.pair)("gravity", gravity)
        if whisker.mass_per_length is None:
            checks.fail("mass_per_length", "given for a whisker with a weight", "None")
    given: Given = tuple(load for load in loads if _is_in_plane(load))
    if whisker.needs_space or len(given) < len(loads) or (gravity is not None and len(gravity) == 3):
        from jaxwhisker._space.deflect import deflect_in_space

        warn_of_whisker(whisker, ROD_STEPS)
        return deflect_in_space(whisker, loads, support, gravity, points)
    check_in_plane((whisker,), support)
    if gravity is not None:
        given = (*given, *weight_of(whisker, gravity))
    warn_of_whisker(whisker, ROD_STEPS)
    whisker, given, support = jax.tree.map(checks.as_float, (whisker, given, support))
    values = deflected(PlaneLoadCase(whisker.without_masses(), given, support), points)
    return Deflection(**values, whisker=whisker, loads=given, support=support)


def _is_in_plane(load: Any) -> TypeGuard[PointForce | PointMoment | LineLoad]:
    return not isinstance(load, SpaceForce | SpaceMoment) and (not isinstance(load, LineLoad) or load.z is None)


def _spring_lengths(
    whisker: Whisker, support: Support, pose: Float[Array, "3"], on_shaft: Float[Array, " attached"]
) -> Float[Array, " springs"]:
    """Lengths of all springs, from the dimensionless pose of the base and lengths of those on the shaft."""
    mount, (x, y, angle) = support.mounts[0], pose
    moved = [x * whisker.length - mount.x, y * whisker.length - mount.y, angle - mount.angle]
    network, own = iter(support.spring_length(jnp.stack(moved)[None])), iter(on_shaft)
    lengths = []
    for spring in support.springs:
        scale = 1.0 if spring.axis == "phi" else whisker.length
        lengths.append(next(network) if spring.linear else next(own) * scale)
    return jnp.array(lengths, dtype=float)
