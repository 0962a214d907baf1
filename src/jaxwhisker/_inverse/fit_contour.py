"""The joint fit: a contour of any strictly convex shape, and what is not known of the sensor, from all signals at once.

Points that are reconstructed one by one are as noisy as their signals, and weak contacts tell next to nothing. A whole
scan tells more: it has to be the scan of one contour. That is identification (identify) with the contour's radii of
curvature for parameters; points (reconstruct) are where it starts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._inverse.fit import Fit
from jaxwhisker._inverse.fit_status import FitStatus
from jaxwhisker._inverse.identify import identify
from jaxwhisker._inverse.measured import measured_of
from jaxwhisker._inverse.points import Reconstruction
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._model.contour import Contour
from jaxwhisker._model.profile import STEEPEST, AbstractProfile
from jaxwhisker._model.scene import Scene, Sensor

GRID = 0.05  # rad, to which outermost knots are rounded: alike contours need no other code
SURE = 0.05  # rad: standard error of slopes between which there are knots
FINE = 401  # slopes between which points are integrated for a start
SMOOTH = 0.3  # of the mean radius: second difference of radii, a standard deviation, for a start
SHARP = 0.4  # of the radii beside them: outermost ones, for another start
LEAST = 0.1  # of the median radius, and of the lowest point, for a start
OWN = "radius_"  # names of the contour's parameters among those of the fit


class Band(NamedTuple):
    """Points of a contour, and how exactly it is known across."""

    slope: Float[np.ndarray, " slopes"]
    x: Float[np.ndarray, " slopes"]
    y: Float[np.ndarray, " slopes"]
    error: Float[np.ndarray, " slopes"]  # standard error along the normal, a length; NaN where it is not known


@dataclass(frozen=True, eq=False, repr=False)
class ContourFit:
    """A contour fitted to all signals at once, with what was unknown of the sensor."""

    profile: Contour
    fit: Fit  # its parameters are the unknown ones, `distance`, `position`, and a radius of curvature per knot
    sensor: Sensor  # with the fitted parameters

    def band(self, slopes: Any = None) -> Band:
        """The contour at slope angles (default: 101 between its outermost knots), with its standard error.

        Errors come from the noise and from whatever was fitted along; NaN where the data do not tell.
        """
        knots = self.profile.slopes
        at = np.linspace(knots[0], knots[-1], 101) if slopes is None else np.asarray(slopes, dtype=float)
        own = [name for name in self.fit.names if name in ("distance", "position") or name.startswith(OWN)]
        pick = [self.fit.names.index(name) for name in own]
        values = jnp.array([self.fit.estimates[name] for name in own])
        x, y, by = _across(knots, values, jnp.asarray(at))
        covariance, by = self.fit.covariance[np.ix_(pick, pick)], np.asarray(by)
        error = np.sqrt(np.einsum("si,ij,sj->s", by, np.nan_to_num(covariance), by))
        # A radius that the data do not tell, beyond the last contacts, matters where it moves the contour.
        untold = np.isnan(np.diag(covariance))
        lost = np.max(np.abs(by * np.asarray(values)) * untold, axis=1)
        return Band(at, np.asarray(x), np.asarray(y), np.where(lost > error, np.nan, error))

    def __str__(self) -> str:
        return str(self.fit)

    __repr__ = __str__


class _Known(NamedTuple):
    """A sensor of which nothing is sought."""

    leaves: tuple
    structure: Any

    def __call__(self) -> Sensor:
        return jax.tree.unflatten(self.structure, self.leaves)


class _Before(NamedTuple):
    """Builds the scene of a sensor and a contour; equal ones share what was compiled."""

    sensor: Callable[..., Sensor | Scene]
    known: tuple[tuple[str, float], ...]
    slopes: tuple[float, ...]

    def __call__(self, distance, position, **values) -> Scene:
        radii = [values.pop(f"{OWN}{k}") for k in range(len(self.slopes))]
        contour = _contour(self.slopes, distance, position, radii)
        return _sensor(self.sensor(**dict(self.known), **values)).before(contour)


def fit_contour(
    measured: Any,
    sensor: Sensor | Scene | Callable[..., Sensor | Scene],
    *,
    sigma: Any = None,
    parameters: Mapping[str, float] | None = None,
    unknown: Sequence[str] = (),
    knots: int | Sequence[float] = 11,
    guess: AbstractProfile | None = None,
) -> ContourFit:
    """Find the contour whose scan the signals are, together with unknown parameters of the sensor.

    Args:
        measured: as of `identify`.
        sensor: as of `reconstruct`: a Sensor, or a function of named parameters.
        sigma: standard deviation of the noise, as of `identify`.
        parameters: of the function, with their values; of the unknown ones first guesses.
        unknown: names of those that are fitted, too.
        knots: at how many slope angles there is a radius of curvature; more follow finer shapes, and more noise. Or
            these angles, rad: fits of equal ones share what was compiled.
        guess: a profile to start from. Default: one fitted to the reconstructed points.

    Raises:
        ValueError: if an argument is not of that kind.
    """
    values = {str(name): float(value) for name, value in (parameters or {}).items()}
    for name in unknown:
        if name not in values:
            raise ValueError(f"`unknown` must name some of `parameters` ({', '.join(values)}), but one is {name!r}.")
    if isinstance(knots, bool) or (isinstance(knots, int) and knots < 2):
        raise ValueError(f"`knots` must be an int of at least 2, or slope angles, but is {knots!r}.")
    make = sensor if not isinstance(sensor, (Sensor, Scene)) else _fixed(_sensor(sensor))
    known = _sensor(make(**values))
    noise = sigma
    if sigma is None:
        data = measured_of(measured, None, whiskers=len(known.whiskers))
        noise = _noise(data)
    points = reconstruct(measured, known, sigma=noise)
    if isinstance(knots, int):
        # Slopes of single points are noisy; where they lie along a first contour is not.
        rough = _knots(_sure(points), knots)
        slopes = _knots(_along(points, rough, *_through(points, rough)), knots)
    else:
        slopes = _given(points, knots)
    if guess is None:
        x, y, radii = _through(points, slopes)
        starts = [(x, y, radii), (x, y, np.r_[SHARP * radii[1], radii[1:-1], SHARP * radii[-2]])]
    else:
        start = guess if isinstance(guess, Contour) and guess.slopes == slopes else Contour.like(guess, slopes)
        starts = [(*start.vertex(), np.exp(np.asarray(start.log_radius)))]
    build = _Before(make, tuple((n, v) for n, v in values.items() if n not in unknown), slopes)
    found: list[Fit] = []
    for x, y, radii in starts:
        first = {name: values[name] for name in unknown} | {"distance": float(y), "position": float(x)}
        first |= {f"{OWN}{k}": float(radius) for k, radius in enumerate(radii)}
        found.append(identify(build, first, measured, sigma=sigma, starts=0, near=True))
        # Flanks at which no contact was strong decide whether a scan ends with a snap; without it a fit is stuck. Of
        # sharper ones there is one.
        if found[-1].status == FitStatus.ok:
            break
    fit = min(found, key=lambda fit: (fit.status != FitStatus.ok, np.nan_to_num(fit.chi2, nan=np.inf)))
    radii = [fit.estimates[f"{OWN}{k}"] for k in range(len(slopes))]
    profile = _contour(slopes, fit.estimates["distance"], fit.estimates["position"], radii)
    fitted = make(**{**values, **{name: fit.estimates[name] for name in unknown}})
    return ContourFit(profile, fit, _sensor(fitted))


def _contour(slopes: tuple[float, ...], distance, position, radii) -> Contour:
    return Contour(distance, jnp.log(jnp.stack([jnp.asarray(r, dtype=float) for r in radii])), slopes, position)


def _sensor(found: Sensor | Scene) -> Sensor:
    if not isinstance(found, (Sensor, Scene)):
        raise ValueError(f"`sensor` must be a Sensor, or a function that returns one, but is {found!r}.")
    return Sensor.of(found) if isinstance(found, Scene) else found


def _fixed(sensor: Sensor) -> _Known:
    leaves, structure = jax.tree.flatten(sensor)
    return _Known(tuple(float(leaf) for leaf in leaves), structure)


def _noise(data: Any) -> dict[str, float]:
    from jaxwhisker._inverse.features import noise_of, peaks

    rough = np.maximum(noise_of(data), 1e-9 * peaks(data))
    return dict(zip(("fx", "fy", "mz"), rough.tolist(), strict=True))


def _through(points: Reconstruction, slopes: tuple[float, ...]) -> tuple[float, float, np.ndarray]:
    """Vertex and radii of a contour near points, by linear least squares: radii linear between knots, slopes exact."""
    x, y, slope, error = (np.asarray(v)[points.clear] for v in (points.x, points.y, points.slope, points.normal_error))
    weight = 1 / error if (error > 0).all() else np.ones_like(x)
    fine = np.linspace(min(slopes[0], slope.min(), 0.0), max(slopes[-1], slope.max(), 0.0), FINE)
    hats = np.array([np.interp(fine, slopes, row) for row in np.eye(len(slopes))])

    def along(direction):
        """What the radius at each knot moves the points by."""
        steps = np.diff(fine) * (hats[:, 1:] * direction[1:] + hats[:, :-1] * direction[:-1]) / 2
        way = np.concatenate([np.zeros((len(slopes), 1)), np.cumsum(steps, axis=1)], axis=1)
        return np.array([np.interp(slope, fine, w) - np.interp(0.0, fine, w) for w in way]).T

    one, none = np.ones_like(x), np.zeros_like(x)
    # Where points tell little radii go on as they do beside.
    usual = np.hypot(np.ptp(x), np.ptp(y)) / (slopes[-1] - slopes[0])
    bends = np.diff(np.eye(len(slopes)), n=2, axis=0) / (SMOOTH * usual)
    rows = np.concatenate([
        np.column_stack([one, none, along(np.cos(fine))]) * weight[:, None],
        np.column_stack([none, one, along(np.sin(fine))]) * weight[:, None],
        np.column_stack([np.zeros((len(bends), 2)), bends]),
    ])  # fmt: skip
    found, *_ = np.linalg.lstsq(rows, np.concatenate([x * weight, y * weight, np.zeros(len(bends))]), rcond=None)
    middle = np.median(np.abs(found[2:]))
    return found[0], max(found[1], LEAST * float(np.min(y))), np.maximum(found[2:], LEAST * middle)


def _along(points: Reconstruction, slopes: tuple[float, ...], x, y, radii) -> Float[np.ndarray, " points"]:
    """Slopes of a contour where it is closest to each point."""
    fine = np.linspace(slopes[0], slopes[-1], FINE)
    near_x, near_y, _ = _across(slopes, jnp.array([y, x, *radii]), jnp.asarray(fine))
    apart = np.hypot(points.x[points.clear][:, None] - near_x, points.y[points.clear][:, None] - near_y)
    return fine[np.argmin(apart, axis=1)]


def _given(points: Reconstruction, knots: Sequence[float]) -> tuple[float, ...]:
    slopes = np.asarray(knots, dtype=float)
    if slopes.ndim != 1 or slopes.size < 2 or not (np.diff(slopes) > 0).all() or np.abs(slopes).max() > STEEPEST:
        raise ValueError(f"`knots` must be strictly increasing slope angles, less than right angles, but is {knots!r}.")
    if points.clear.sum() < slopes.size:
        raise ValueError(
            f"`measured` must show at least {slopes.size} contacts clear of the noise, but shows {points.clear.sum()}."
        )
    return tuple(slopes.tolist())


def _sure(points: Reconstruction) -> Float[np.ndarray, " points"]:
    """Slopes that are known well."""
    slope, error = np.asarray(points.slope), np.asarray(points.standard_error)[..., 2]
    return slope[points.clear & ~(error > SURE)]


def _knots(slopes: Float[np.ndarray, " points"], count: int) -> tuple[float, ...]:
    if slopes.size < count:
        raise ValueError(f"`measured` must show at least {count} contacts clear of the noise, but shows {slopes.size}.")
    low, high = np.quantile(slopes, [0.005, 0.995])
    low, high = GRID * np.ceil(low / GRID), GRID * np.floor(high / GRID)  # inwards: beyond, nothing was touched
    if not high > low:
        raise ValueError(f"`measured` must show contacts of different slopes, but shows {low:.3g} to {high:.3g} rad.")
    return tuple(np.linspace(low, high, count).round(12).tolist())


@eqx.filter_jit
def _across(slopes: tuple[float, ...], values, at):
    def position(values):
        found = jax.vmap(_contour(slopes, values[0], values[1], list(values[2:])).tabulated().point)(at)
        return found.x * jnp.sin(at) - found.y * jnp.cos(at), (found.x, found.y)

    by, (x, y) = jax.jacfwd(position, has_aux=True)(values)
    return x, y, by
