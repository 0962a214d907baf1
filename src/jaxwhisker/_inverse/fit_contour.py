"""Joint fit: a contour of any strictly convex shape, and unknown parameters of the sensor, from all signals at once.

Points that are reconstructed one by one are as noisy as their signals, and weak contacts carry almost no information. A
whole scan carries more, because all its signals come from one contour. This is identification (identify.py) with the
contour's radii of curvature as parameters, and it starts from reconstructed points (reconstruct.py).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._inverse.features import least_scatter
from jaxwhisker._inverse.fit import Fit
from jaxwhisker._inverse.fit_profile import points_and_rates
from jaxwhisker._inverse.identify import identify
from jaxwhisker._inverse.observations import Observations, read_observations
from jaxwhisker._inverse.parameters import check_traceable, read_parameters
from jaxwhisker._inverse.plane import sensor_of
from jaxwhisker._inverse.points import Reconstruction, SpaceReconstruction
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._inverse.recording import check_recording
from jaxwhisker._inverse.statistics import FitStatus
from jaxwhisker._model.contour import Contour, check_slopes
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import AbstractScene, Scene, Sensor
from jaxwhisker._scan.contacts import check_one_contact
from jaxwhisker._scan.quantities import REACTIONS

if TYPE_CHECKING:
    from jaxwhisker._inverse.fit_surface import SurfaceFit
    from jaxwhisker._model.surface import AbstractSurface  # a fit in the plane does without it

GRID = 0.05  # rad, to which outermost knots are rounded: similar contours share compiled code
SURE_SLOPE = 0.05  # rad: largest standard error of slopes over which the first knots are spread
DENSE = 401  # slope angles at which a first contour is integrated
SMOOTH = 0.3  # of the mean radius: standard deviation of second differences of the radii of a first contour
SHARP = 0.4  # outermost radii relative to their neighbours in the second contour to start from
LEAST_RADIUS = 0.1  # of the median radius of a first contour
LEAST_DISTANCE = 0.1  # of the lowest point's height, for a first contour
PREFIX = "radius_"  # prefix of the contour's parameters in the fit


class Band(NamedTuple):
    """Points of a contour, and its uncertainty along the normal."""

    slope: Float[np.ndarray, " slopes"]  # angle, rad
    x: Float[np.ndarray, " slopes"]  # a length
    y: Float[np.ndarray, " slopes"]
    error: Float[np.ndarray, " slopes"]  # standard error along the normal, a length; NaN where it is unknown


@dataclass(frozen=True, eq=False, repr=False)
class ContourFit:
    """A contour fitted to all signals at once, with the unknown parameters of the sensor."""

    profile: Contour
    fit: Fit  # its parameters: the unknown ones of the sensor, `distance`, `position`, and a radius per knot
    sensor: Sensor  # with the fitted parameters

    def band(self, slopes: Any = None) -> Band:
        """The contour at slope angles, rad (default: 101 between its outermost knots), with its standard error.

        Errors follow from the noise and from all fitted parameters; NaN where the signals do not determine the contour.
        """
        knots = self.profile.slopes
        at = np.linspace(knots[0], knots[-1], 101) if slopes is None else np.asarray(slopes, dtype=float)
        x, y, by = points_and_rates(self.profile, at)
        by = by / np.exp(np.r_[0.0, 0.0, self.profile.log_radius])  # with respect to radii, not to their logarithms
        own = slice(-by.shape[1], None)  # the sensor's parameters come first
        values, covariance = np.array(list(self.fit.estimates.values()))[own], self.fit.covariance[own, own]
        error = np.sqrt(np.einsum("si,ij,sj->s", by, np.nan_to_num(covariance), by))
        # Beyond the last contacts a radius is not identifiable, which only matters where the radius moves the contour.
        lost = np.max(np.abs(by * values) * np.isnan(np.diag(covariance)), axis=1)
        return Band(at, x, y, np.where(lost > error, np.nan, error))

    def __str__(self) -> str:
        return str(self.fit)

    __repr__ = __str__


class _ConstantSensor(NamedTuple):
    """A function without parameters that returns a sensor; hashable, because it is a key of the compiled programs."""

    sensor: Sensor  # with floats as leaves

    def __call__(self) -> Sensor:
        return self.sensor


class _ContourScene(NamedTuple):
    """Build the scene of a sensor and a contour; equal instances share compiled code."""

    sensor: Callable[..., Sensor | Scene]
    known: tuple[tuple[str, float], ...]
    unknown: tuple[str, ...]
    slopes: tuple[float, ...]

    def __call__(self, **values) -> Scene:
        return self.sensor_with(values).before(_contour(self.slopes, values))

    def sensor_with(self, values: Mapping[str, Any]) -> Sensor:
        """The sensor with these values of its unknown parameters."""
        return sensor_of(self.sensor(**dict(self.known), **{name: values[name] for name in self.unknown}))


@overload
def fit_contour(
    measured: "SpaceReconstruction | Sequence[SpaceReconstruction]",
    *,
    family: "type[AbstractSurface]",
    normals: bool = True,
) -> "SurfaceFit": ...


@overload
def fit_contour(
    measured: Any,
    sensor: Sensor | Scene | Callable[..., Sensor | Scene],
    *,
    sigma: Any = None,
    parameters: Mapping[str, float] | None = None,
    unknown: Sequence[str] = (),
    knots: int | Sequence[float] = 11,
    guess: AbstractProfile | None = None,
) -> ContourFit: ...


@with_own_settings
def fit_contour(
    measured: Any,
    sensor: Any = None,
    *,
    sigma: Any = None,
    parameters: Mapping[str, float] | None = None,
    unknown: Sequence[str] = (),
    knots: int | Sequence[float] = 11,
    guess: AbstractProfile | None = None,
    family: type | None = None,
    normals: bool = True,
) -> "ContourFit | SurfaceFit":
    """Fit a convex contour to all signals of a scan, together with unknown parameters of the sensor.

    In space, fit a sphere, an ellipsoid, a cylinder or a plane to the points of one or several scans. The residuals of
    a point are its distance from the surface and, with `normals`, the difference between the direction of its force and
    the normal.

    Args:
        measured: signals of one scan, as in `identify`. In space: the result of `reconstruct`, or a list of results of
            scans past the same object. Points with signals below 40 standard deviations of their noise are left out:
            their weights depend on the noise of the same signals, which biases a fit.
        sensor: as in `reconstruct`: a Sensor, a Scene, whose object is ignored, or a function of named parameters.
            This and the following arguments up to `guess` are for contours in the plane.
        sigma: standard deviation of the noise, as in `identify`.
        parameters: arguments of the function by name; initial guesses of the unknown ones.
        unknown: names of the parameters that are fitted.
        knots: number of knots, the slope angles at which a radius of curvature is fitted, or the angles themselves,
            rad. More knots follow finer shapes, but also more of the noise. Fits with equally many share compiled code.
        guess: a profile to start from. Default: one fitted to the reconstructed points.
        family: in space: Sphere, Ellipsoid, Cylinder or Plane.
        normals: in space: whether forces are normal to the object. With friction, they are not.

    Returns:
        A ContourFit; `fit.status` says how the fit ended, as in `identify`. In space, a SurfaceFit.

    Raises:
        ValueError: if an argument is wrong, or `measured` shows too few contacts.
    """
    if _in_space(measured) or (family is not None and sensor is None):
        _check_left_out(
            "in space", sensor=sensor, sigma=sigma, parameters=parameters, unknown=unknown or None, guess=guess
        )
        from jaxwhisker._inverse.fit_surface import fit_surface

        return fit_surface(measured, family, normals)
    _check_left_out("in the plane", family=family)
    values = read_parameters("parameters", parameters) if parameters else {}
    for name in unknown:
        if name not in values:
            raise ValueError(f"`unknown` must name some of `parameters` ({', '.join(values)}), got {name!r}.")
    if isinstance(knots, int):
        checks.count("knots", knots, least=2)
        slopes, count = None, knots
    else:
        slopes, count = check_slopes("knots", knots), len(knots)
    if isinstance(sensor, (Sensor, AbstractScene)):
        sensor = _ConstantSensor(jax.tree.map(float, sensor_of(sensor)))
    checks.arguments("parameters", sensor, list(values), called="sensor")
    known = sensor_of(sensor(**values))
    check_traceable(sensor, values, called="sensor")
    check_one_contact("measured", measured)
    observations = read_observations(measured, sigma, whiskers=len(known.whiskers))
    check_recording(observations, known, len(unknown) + 2 + count)

    points = reconstruct(observations, known, sigma=_scatter(observations) if sigma is None else sigma)
    slopes = _touched_knots(points, count) if slopes is None else slopes
    _check_contacts(count, int(points.clear.sum()))
    fixed = tuple((name, value) for name, value in values.items() if name not in unknown)
    build = _ContourScene(sensor, fixed, tuple(unknown), slopes)
    fits: list[Fit] = []
    for start in _starts(points, slopes, guess):
        first = {name: values[name] for name in unknown} | start
        fits.append(identify(build, first, observations, sigma=sigma, starts=0, near=True))
        if fits[-1].status == FitStatus.ok:
            break
    fit = min(fits, key=lambda fit: (fit.status != FitStatus.ok, np.nan_to_num(fit.chi2, nan=np.inf)))
    return ContourFit(_contour(slopes, fit.estimates), fit, build.sensor_with(fit.estimates))


def _in_space(measured: Any) -> bool:
    """Whether these are results in space, or a list of them."""
    first = measured[0] if isinstance(measured, list | tuple) and measured else measured
    return getattr(first, "in_space", False)


def _check_left_out(where: str, **arguments: Any) -> None:
    for name, value in arguments.items():
        if value is not None:
            checks.fail(name, f"left out {where}", repr(value))


def _contour(slopes: tuple[float, ...], values: Mapping[str, Any]) -> Contour:
    radii = [jnp.asarray(values[f"{PREFIX}{k}"], dtype=float) for k in range(len(slopes))]
    return Contour(values["distance"], jnp.log(jnp.stack(radii)), slopes, values["position"])


def _values_of(x: float, y: float, radii: np.ndarray) -> dict[str, float]:
    """The contour's parameters in the fit, from its vertex and its radii at the knots."""
    return {"distance": y, "position": x} | {f"{PREFIX}{k}": float(radius) for k, radius in enumerate(radii)}


def _scatter(observations: Observations) -> dict[str, float]:
    return dict(zip(REACTIONS, least_scatter(observations).tolist(), strict=True))


def _starts(points: Reconstruction, slopes: tuple[float, ...], guess: AbstractProfile | None) -> list[dict[str, float]]:
    """Parameters of the contours to start from.

    Flanks without a strong contact decide whether a scan ends with a snap, and a fit that starts without the snap gets
    stuck. Sharper flanks give a scan with a snap.
    """
    if guess is not None:
        x, y = map(float, guess.vertex())
        return [_values_of(x, y, np.exp(Contour.like(guess, slopes).log_radius))]
    x, y, radii = _through(points, slopes)
    return [_values_of(x, y, r) for r in (radii, np.r_[SHARP * radii[1], radii[1:-1], SHARP * radii[-2]])]


def _through(points: Reconstruction, slopes: tuple[float, ...]) -> tuple[float, float, np.ndarray]:
    """Fit vertex and radii of a contour to points by linear least squares: radii linear between knots, slopes exact."""
    x, y, slope, error = (np.asarray(v)[points.clear] for v in (points.x, points.y, points.slope, points.normal_error))
    weight = 1 / error if (error > 0).all() else np.ones_like(x)
    fine = np.linspace(min(slopes[0], slope.min(), 0.0), max(slopes[-1], slope.max(), 0.0), DENSE)
    hats = np.array([np.interp(fine, slopes, row) for row in np.eye(len(slopes))])

    def by_radius(direction):
        """Derivatives of the points' positions with respect to the radii, (points, knots)."""
        steps = np.diff(fine) * (hats[:, 1:] * direction[1:] + hats[:, :-1] * direction[:-1]) / 2
        way = np.concatenate([np.zeros((len(slopes), 1)), np.cumsum(steps, axis=1)], axis=1)
        return np.array([np.interp(slope, fine, w) - np.interp(0.0, fine, w) for w in way]).T

    one, zero = np.ones_like(x), np.zeros_like(x)
    # Where points say little, radii follow their neighbours.
    mean = np.hypot(np.ptp(x), np.ptp(y)) / (slopes[-1] - slopes[0])
    bends = np.diff(np.eye(len(slopes)), n=2, axis=0) / (SMOOTH * mean)
    rows = np.concatenate([
        np.column_stack([one, zero, by_radius(np.cos(fine))]) * weight[:, None],
        np.column_stack([zero, one, by_radius(np.sin(fine))]) * weight[:, None],
        np.column_stack([np.zeros((len(bends), 2)), bends]),
    ])  # fmt: skip
    right = np.concatenate([x * weight, y * weight, np.zeros(len(bends))])
    (vertex_x, vertex_y, *radii), *_ = np.linalg.lstsq(rows, right, rcond=None)
    least = LEAST_RADIUS * np.median(np.abs(radii))
    return float(vertex_x), float(max(vertex_y, LEAST_DISTANCE * np.min(y))), np.maximum(radii, least)


def _check_contacts(least: int, count: int) -> None:
    if count < least:
        raise ValueError(f"`measured` must show at least {least} contacts clear of the noise, got {count}.")


def _touched_knots(points: Reconstruction, count: int) -> tuple[float, ...]:
    """Knots spread evenly over the slopes that were touched.

    The slopes of single points are noisy. Those of a first contour, where it is closest to the points, are not.
    """
    slope, error = np.asarray(points.slope), np.asarray(points.standard_error)[..., 2]
    rough = _knots_over(slope[points.clear & ~(error > SURE_SLOPE)], count)
    fine = np.linspace(rough[0], rough[-1], DENSE)
    near_x, near_y, _ = points_and_rates(_contour(rough, _values_of(*_through(points, rough))), fine)
    apart = np.hypot(points.x[points.clear][:, None] - near_x, points.y[points.clear][:, None] - near_y)
    return _knots_over(fine[np.argmin(apart, axis=1)], count)


def _knots_over(slopes: Float[np.ndarray, " points"], count: int) -> tuple[float, ...]:
    _check_contacts(count, slopes.size)
    low, high = np.quantile(slopes, [0.005, 0.995])
    low, high = GRID * np.ceil(low / GRID), GRID * np.floor(high / GRID)  # inwards, because nothing was touched beyond
    if not high > low:
        raise ValueError(f"`measured` must show contacts of different slopes, got {low:.3g} to {high:.3g} rad.")
    return tuple(np.linspace(low, high, count).round(12).tolist())
