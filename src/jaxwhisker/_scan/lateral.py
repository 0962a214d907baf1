"""Lateral stability: whether a whisker that is scanned in a plane stays in it.

A displacement out of the plane changes the energy by a quadratic form of the lateral displacement of the base, its tilt
about the axis across the whisker, and the rotation (phi_x, phi_y) of every cross-section. The whisker is stable if this
form is positive where the contact does not move sideways, and if the stiffness k against a sideways motion of the
contact exceeds what the curved object takes away, the contact force times its lateral curvature.

A straight whisker of circular cross-section carries no torque, tapered or not: it stays in the plane of the force and
of its base, so that all of its motions are a rotation about the tangent of its base. In the frame of the base, with the
force (F_x, F_y) of the object, the contact at (rho, h), and the height a = h - rho F_y / F_x at which the line of the
force crosses the axis of the base, the three parts are springs in series:

    1 / k = rho / F_x + 1 / c_z + a^2 / (k_x + F_y a).

For whiskers with intrinsic curvature, the second variation (_rod/second_variation.py) is evaluated on polynomials, by
Gaussian quadrature. Its errors fall exponentially with their degree.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_field
from jaxwhisker._base.linear_algebra import positive_definite, solve
from jaxwhisker._base.program import Program
from jaxwhisker._base.quadrature import gauss, legendre, legendre_integrals
from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.second_variation import BentRod, second_variation
from jaxwhisker._scan.contacts import check_one_contact
from jaxwhisker._scan.result import Result, check_one_scan
from jaxwhisker._scan.scan import scan
from jaxwhisker._scan.springs import at_base
from jaxwhisker._scan.state import State, material, state_of

DEGREE = 16  # of the polynomials for phi_x and phi_y: k is exact to 1e-8
POINTS, WEIGHTS = gauss(2 * DEGREE)
RATES, TURNS = np.array(legendre(POINTS, DEGREE)), np.array(legendre_integrals(POINTS, DEGREE))
HELD = 1e8  # stiffness, relative to the largest one of the whisker, that holds the contact
ITERATIONS = 12  # from two steps of a scan to the exact drive position of a loss, corners included
MISS = 1e-7  # largest excess of curvature there, in 1 / L; that of the last iteration is mostly its square
LIGHT = 1e-6  # force, in EI / L^2, below which whiskers hardly bend: k, a ratio of both, is not known accurately
POISSON_RATIO = 0.3

LateralCurvature = Scalar | Callable[[Any, Any], Any]


class LateralStability(eqx.Module):
    """Lateral stability of the whiskers at the steps of a scan; every field has shape (steps, whiskers).

    Free whiskers, and those that have just touched, are stable: `margin` and `stiffness` are infinite there. Steps that
    failed are NaN.
    """

    margin: Float[Array, "*steps whiskers"]  # force per length: `stiffness` - `softening`; unstable where negative
    stiffness: Float[Array, "*steps whiskers"]  # force per lateral displacement of the contact
    softening: Float[Array, "*steps whiskers"]  # normal contact force times the lateral curvature of the object


class Lateral(eqx.Module):
    """What a plane scan does not say about the lateral motions of its whiskers."""

    curvature: LateralCurvature
    stiffness: Scalar
    tilt_stiffness: Scalar
    torsion_ratio: Scalar


@in_double
def lateral_stability(
    result: Result,
    lateral_curvature: LateralCurvature = 0.0,
    lateral_stiffness: Scalar = np.inf,
    tilt_stiffness: Scalar = np.inf,
    *,
    torsion_ratio: Scalar = 1 / (1 + POISSON_RATIO),
) -> LateralStability:
    """Whether whiskers of circular cross-section stay in the plane of their scan, if nothing guides them.

    A plane result is an equilibrium in space, too, but not always a stable one. A straight whisker past a cylinder or
    any other object that is flat across the plane is stable only while the object pushes it back, which is before the
    vertex. Beyond that, it swings sideways: the second half of such a scan, snap-off included, can only be observed
    with lateral guidance, a flat cross-section or friction.

    Args:
        result: of a scan.
        lateral_curvature: of the object, across the plane of the scan, 1 / length, positive if it is convex there: 0
            for a cylinder, 1 / r for a sphere of radius r. Or a function of the contact point (x, y) that returns it.
        lateral_stiffness: c_z of the spring across the plane that holds each base, force per length; positive.
        tilt_stiffness: k_x of the torsion spring that holds each base against tilting out of the plane, moment per rad;
            positive. The base does not turn about the whisker's axis.
        torsion_ratio: torsional stiffness relative to the bending stiffness, for whiskers with intrinsic curvature;
            positive. Default: that of a circular cross-section with a Poisson's ratio of 0.3.

    Returns:
        LateralStability. With friction, the normal force counts: friction delays the loss, but does not prevent it.

    Raises:
        ValueError: if `result` is not the result of one scan, or an argument is out of its domain; if springs or
            foundations hold the shafts, whose lateral stiffness is not known; if whiskers have a weight or may have
            several contacts.

    Examples:
        >>> scene = jw.Scene(jw.Whisker(), jw.Circle(distance=0.3, radius=1.0), jw.Support())
        >>> result = jw.scan(scene)
        >>> past_a_cylinder, past_a_sphere = (jw.lateral_stability(result, curvature) for curvature in (0.0, 1.0))
    """
    check_one_scan(result)
    check_one_contact("result", result)
    lateral = _checked(result.scene, lateral_curvature, lateral_stiffness, tilt_stiffness, torsion_ratio)
    return _stability_now(jax.tree.map(checks.as_float, result.scene.whiskers), state_of(result), lateral)


@in_double
def lateral_loss(
    result: Result,
    lateral_curvature: LateralCurvature = 0.0,
    lateral_stiffness: Scalar = np.inf,
    tilt_stiffness: Scalar = np.inf,
    *,
    torsion_ratio: Scalar = 1 / (1 + POISSON_RATIO),
) -> Float[Array, " whiskers"]:
    """Drive positions at which whiskers first lose their lateral stability, exact between the steps of the scan.

    The arguments and errors are those of `lateral_stability`. Each whisker of which some step loses its stability costs
    a few further scans.

    Returns:
        Drive positions, in the unit of the control, shape (whiskers,); NaN for whiskers that are stable at all steps: a
        step must lie between the loss and the end of the contact. They have derivatives by everything that the scan and
        the arguments depend on.

    Examples:
        >>> scene = jw.Scene(jw.Whisker(), jw.Circle(distance=0.3, radius=1.0), jw.Support())
        >>> print(f"{float(jw.lateral_loss(jw.scan(scene), lateral_curvature=0.25)[0]):.6f}")
        -0.328758
    """
    check_one_scan(result)
    check_one_contact("result", result)
    lateral = _checked(result.scene, lateral_curvature, lateral_stiffness, tilt_stiffness, torsion_ratio)
    scene, control = jax.tree.map(checks.as_float, result.scene), jnp.asarray(result.control)
    still_scene, still_lateral, still = jax.lax.stop_gradient((scene, lateral, result))
    now = _excess_now(still_scene.whiskers, state_of(still), still_lateral)
    found = []
    for k in range(len(scene.whiskers)):
        lost = (now[:-1, k] >= 0) & (now[1:, k] < 0)
        if not checks.is_traced(lost) and not np.any(lost):
            found.append(jnp.asarray(jnp.nan))
            continue
        first = jnp.argmax(lost)

        def excess(u: Scalar, scene: Scene, lateral: Lateral, first=first, k=k) -> Float[Array, ""]:
            # The drive comes the same way. Steps beyond this one do not matter.
            way = jnp.where(jnp.arange(control.size) > first, u, jax.lax.stop_gradient(control))
            return _excess_now(scene.whiskers, state_of(scan(scene, way)), lateral)[first + 1, k]

        ends = jax.lax.stop_gradient(control)[first], jax.lax.stop_gradient(control)[first + 1]
        miss, values = MISS / still_scene.whiskers[k].length, (now[first, k], now[first + 1, k])
        u, missed = _zero(lambda u: excess(u, still_scene, still_lateral), ends, values, MISS * miss)
        if checks.is_traced((scene, lateral)):
            _, slope = jax.jvp(lambda u: excess(u, still_scene, still_lateral), (u,), (jnp.ones(()),))
            u -= excess(u, scene, lateral) / slope
        found.append(jnp.where(jnp.any(lost) & (jnp.abs(missed) < miss), u, jnp.nan))
    return jnp.stack(found)


def _zero(
    function: Callable[[Scalar], Scalar], ends: tuple[Scalar, Scalar], values: tuple[Scalar, Scalar], enough: Scalar
) -> tuple[Scalar, Scalar]:
    """A zero between two ends by the Illinois method, and the value there: changes of phase make corners.

    A smaller value than `enough` ends the iterations early, outside a jit.
    """

    def step(_, points):
        (a, at_a), (b, at_b) = points
        rise = at_b - at_a
        share = jnp.where(jnp.isfinite(rise) & (rise != 0), at_b / jnp.where(rise == 0, 1.0, rise), 0.5)
        c = b - jnp.where(at_b == 0, 0.0, share) * (b - a)
        at_c = function(c)
        across = (at_c < 0) != (at_b < 0)
        return (jnp.where(across, b, a), jnp.where(across, at_b, at_a / 2)), (c, at_c)

    points = tuple(zip(ends, values, strict=True))
    if checks.is_staged((ends, values)):
        points = jax.lax.fori_loop(0, ITERATIONS, step, points)
    else:
        for k in range(ITERATIONS):
            points = step(k, points)
            if jnp.abs(points[1][1]) < enough:
                break
    return points[1]


def _checked(scene: Scene, curvature, stiffness, tilt_stiffness, torsion_ratio) -> Lateral:
    if scene.gravity is not None:
        checks.fail("result", "that of a scene without gravity", str(scene))
    if scene.support.on_shafts:
        raise ValueError(
            "`result` must be that of a scene without springs or foundations on shafts, whose lateral stiffness is not "
            f"known, got {scene.support}."
        )
    if callable(curvature):
        checks.function("lateral_curvature", curvature, given=2)
    else:
        checks.number("lateral_curvature", curvature)
    checks.number("lateral_stiffness", stiffness, positive=True, finite=False)
    checks.number("tilt_stiffness", tilt_stiffness, positive=True, finite=False)
    checks.number("torsion_ratio", torsion_ratio, positive=True)
    return jax.tree.map(checks.as_float, Lateral(as_field(curvature), stiffness, tilt_stiffness, torsion_ratio))


class Contact(NamedTuple):
    """A whisker in contact, in the plane."""

    base_x: Scalar
    base_y: Scalar
    base_angle: Scalar
    fx: Scalar
    fy: Scalar
    mz: Scalar
    contact_x: Scalar
    contact_y: Scalar
    contact_arc: Scalar


# In place of one that touches nothing, or of a step that failed, whose derivatives must be finite.
DUMMY = dict(zip(Contact._fields, (0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 1.0, 1.0, 1.0), strict=True))


def _stability(whiskers: tuple[Whisker, ...], state: State, lateral: Lateral) -> LateralStability:
    found = []
    for k, whisker in enumerate(whiskers):
        at = jax.tree.map(lambda leaf, k=k: leaf[..., k], state)
        found.append(jax.vmap(partial(_of_one, whisker, lateral))(at))
    return LateralStability(**jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *found))


def _of_one(whisker: Whisker, lateral: Lateral, at: State) -> dict[str, Array]:
    """The fields of a LateralStability of one whisker in one state."""
    light = at.contact_force < LIGHT * whisker.base_stiffness / whisker.length**2
    free, failed = (at.phase == Phase.free) | light, jnp.isnan(at.base_x)
    known = Contact(*(jnp.where(free, dummy, getattr(at, name)) for name, dummy in DUMMY.items()))
    stiffness, held = (_of_straight if whisker.intrinsic_curvature is None else _of_curved)(whisker, known, lateral)
    stiffness = jnp.where(held, stiffness, -jnp.inf)
    curvature = lateral.curvature
    softening = _force(at) * (curvature(known.contact_x, known.contact_y) if callable(curvature) else curvature)
    values = {
        "margin": (jnp.inf, stiffness - softening),
        "stiffness": (jnp.inf, stiffness),
        "softening": (0.0, softening),
    }
    return {name: jnp.where(failed, jnp.nan, jnp.where(free, *both)) for name, both in values.items()}


def _force(at: State) -> Float[Array, "*steps"]:
    """The contact force along the normal."""
    return at.contact_force if at.normal_force is None else at.normal_force


def _in_base_frame(at: Contact) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Contact and force of the object relative to the base, across and along its tangent."""
    cos, sin = jnp.cos(at.base_angle), jnp.sin(at.base_angle)
    x, y = at.contact_x - at.base_x, at.contact_y - at.base_y
    return x * cos + y * sin, y * cos - x * sin, -at.fx * cos - at.fy * sin, at.fx * sin - at.fy * cos


def _of_straight(whisker: Whisker, at: Contact, lateral: Lateral) -> tuple[Scalar, Bool[Array, ""]]:
    """Stiffness against a sideways motion of the contact, and whether the whisker is stable while that is held."""
    del whisker
    rho, h, across, along = _in_base_frame(at)
    moment, yields = h * across - rho * along, 1 / lateral.tilt_stiffness
    # The formula above, as one fraction: the force across vanishes on level faces.
    tilt = across + yields * along * moment
    total = rho + yields * h * moment + tilt / lateral.stiffness
    # Of springs in series, one may be negative if the contact is held, and if the others are softer.
    one = jnp.asarray(tilt * rho < 0)
    both = ~one & jnp.asarray(across * rho < 0)
    return tilt / total, ~both & (~one | jnp.asarray(tilt * total < 0))


def _of_curved(whisker: Whisker, at: Contact, lateral: Lateral) -> tuple[Scalar, Bool[Array, ""]]:
    """The same by the second variation, on polynomials of the arc length."""
    arc, n = at.contact_arc, DEGREE
    start, load = at_base(Pose(at.base_x, at.base_y, at.base_angle), (at.fx, at.fy, at.mz))
    fractions = np.append(0.0, POINTS)
    states = rod.points(start, -arc, load, material(whisker), at=jnp.asarray(fractions), from_base=jnp.zeros_like(arc))
    x, y, cos, sin = (jnp.asarray(values[1:]) for values in states)
    force_x, force_y = -at.fx, -at.fy
    moment = (at.contact_x - x) * force_y - (at.contact_y - y) * force_x
    stiffness, none = jax.vmap(whisker.stiffness_at)(jnp.asarray(arc * POINTS)), jnp.zeros(POINTS.size)
    tangent, force, about = (
        jnp.stack([part + none for part in vector], axis=-1)
        for vector in ((cos, sin, 0.0), (force_x, force_y, 0.0), (0.0, 0.0, moment))
    )
    bent, weights = BentRod(stiffness, lateral.torsion_ratio, tangent, force, about), arc * jnp.asarray(WEIGHTS)
    # A constant, for the tilt of the base, and polynomials that vanish there.
    fields, slopes = jnp.concatenate([none[None] + 1, arc * TURNS]), jnp.concatenate([none[None], RATES])
    # Unknowns, all in one unit of energy: the tilt, and the coefficients of phi_x and phi_y, which vanish at the base.
    energy = whisker.base_stiffness / whisker.length
    softness = jnp.sqrt(energy / lateral.tilt_stiffness)
    tilt = softness * jnp.stack([jnp.cos(at.base_angle), jnp.sin(at.base_angle)])

    def of_unknowns(values: Float[Array, "... n"]) -> Float[Array, "... n-1"]:
        return jnp.concatenate([values[..., :2] @ tilt[:, None], values[..., 2:]], axis=-1)

    form = of_unknowns(of_unknowns(second_variation(bent, fields, slopes, weights, axes=2)).T) / energy
    form = form.at[0, 0].add(jnp.where(softness > 0, 1.0, jnp.max(jnp.abs(form))))
    sideways = of_unknowns(jnp.ravel(jnp.stack([fields @ (weights * sin), -fields @ (weights * cos)], axis=1)))
    compliance = jnp.sum(sideways * solve(form, sideways[:, None])[:, 0]) / energy + 1 / lateral.stiffness
    # The base's displacement is a spring of its own, in series.
    base = jnp.sqrt(energy / lateral.stiffness)
    whole = jnp.zeros((2 * n + 2, 2 * n + 2)).at[:-1, :-1].set(form).at[-1, -1].set(1.0)
    motion = jnp.append(sideways, base)
    holding = HELD * jnp.max(jnp.abs(form)) / jnp.sum(motion**2)
    return 1 / compliance, positive_definite(whole + holding * motion[:, None] * motion)


def _excess(whiskers: tuple[Whisker, ...], state: State, lateral: Lateral) -> Float[Array, "steps whiskers"]:
    """Curvature of the object that whiskers could still bear: unlike the margin, it does not vanish at a touch."""
    force = _force(state)
    return _stability(whiskers, state, lateral).margin / jnp.where(force > 0, force, 1.0)


_stability_now, _excess_now = Program(_stability), Program(_excess)
