"""Fit a profile to points of an object: its shape, and the uncertainty of that shape."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._inverse.points import Reconstruction
from jaxwhisker._inverse.statistics import FitStatus, chi_squared, is_plausible, judged
from jaxwhisker._model.conic import Circle, Ellipse, Parabola
from jaxwhisker._model.contour import Contour, Spline, spline, tabulate
from jaxwhisker._model.profile import STEEPEST, AbstractProfile, bisect

KNOTS = 8  # of a Contour
REWEIGHTINGS = 5  # fits in a row; weights depend on the profile, so each fit uses those of the previous one
LEAST_SQUARES_STEPS = 128
RTOL = 1e-7
HALVINGS, NEWTON_STEPS = 14, 3  # to a point's foot, the point of the profile nearest to it
LEAST = 1e-12  # least share of a slope's variance that is independent of the position
SURE = 0.1  # rad: knots of a Contour are spread over slopes known better than this
SIGNIFICANCE = 40.0  # standard deviations: points with weaker signals are left out
OUTLIER = 3.0  # standard deviations from which a point is weighted less (Huber): a few contacts have the wrong phase
PADDED = 256  # points are padded to a multiple of it, so similar numbers of points share a compilation

FAMILIES: dict[type, tuple[str, ...]] = {
    Parabola: ("distance", "a", "position"),
    Circle: ("distance", "radius", "position"),
    Ellipse: ("distance", "a", "b", "position"),
}


class ProfileFit(eqx.Module):
    """A profile fitted to points.

    Standard errors follow from the covariances of the points, or, without any, from the scatter of the points about the
    profile. They are NaN where the status is not ok: `implausible` if the covariances do not explain the distances of
    the points from the profile, `undetermined` if the points do not determine all parameters, or `not_converged`.
    """

    profile: AbstractProfile
    estimates: dict[str, float]
    standard_error: dict[str, float]
    covariance: Float[np.ndarray, "p p"]  # of the estimates, in their order
    chi2: float  # sum of squares of the whitened residuals
    degrees_of_freedom: int = eqx.field(static=True)
    status: FitStatus = eqx.field(static=True)
    slopes: tuple[float, float] = eqx.field(static=True)  # smallest and largest slope angle of the points, rad
    length: float = eqx.field(static=True)  # of the first whisker of a Reconstruction; else 1

    def band(self, slopes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x and y at slope angles (rad), and the first-order standard error across the profile; lengths (slopes,)."""
        x, y, by = points_and_rates(self.profile, slopes)
        error = np.sqrt(np.maximum(np.einsum("ip,pq,iq->i", by, self.covariance, by), 0.0))
        return x, y, np.where(np.isfinite(self.covariance).all(), error, np.nan)

    def __str__(self) -> str:
        lines = [f"{self.profile}: chi^2 = {self.chi2:.4g} with {self.degrees_of_freedom} degrees of freedom"]
        lines += [f"status: {self.status.name}, standard errors are unknown"] * (self.status != FitStatus.ok)
        width = max(map(len, self.estimates))
        for name, value in self.estimates.items():
            error = self.standard_error[name]
            lines.append(f"  {name:<{width}}  {value:< 14.8g}" + f" +- {error:.2g}" * bool(np.isfinite(error)))
        return "\n".join(lines)

    __repr__ = __str__


@with_own_settings
def fit_profile(
    points: Reconstruction | Mapping[str, Any],
    family: type[AbstractProfile],
    *,
    knots: int | Any = KNOTS,
    guess: AbstractProfile | None = None,
    significance: float = SIGNIFICANCE,
) -> ProfileFit:
    """Fit a profile of one family to points, weighted with their errors in position and slope.

    The residuals of a point are its distance from the profile and, if it has a slope, the difference from the slope at
    the nearest point of the profile. Both residuals are linear in the measured values, because the slopes of weak
    contacts have large errors.

    Args:
        points: a Reconstruction, of which all significant points are used; or a mapping with x, y, optionally slope,
            and optionally their covariance (points, 2 or 3, 2 or 3) or sigma, a standard deviation of x and y.
        family: Parabola, Circle, Ellipse or Contour.
        knots: for a Contour: the number of knots, spread evenly over the points' slopes, or their slope angles, rad.
        guess: a profile of the family to start from. Default: one fitted by linear least squares.
        significance: signals of fewer standard deviations of their noise are weak. Weak points of a Reconstruction are
            left out: their weights depend on the noise of the same signals, which biases a fit.

    Returns:
        A ProfileFit, whose status says how the fit ended.

    Raises:
        ValueError: if an argument is wrong, or there are fewer residuals than parameters.
    """
    checks.float64_mode()
    if family not in (*FAMILIES, Contour):
        raise ValueError(f"`family` must be Parabola, Circle, Ellipse or Contour, got {family!r}.")
    if guess is not None and not isinstance(guess, family):
        raise ValueError(f"`guess` must be a {family.__name__}, got {guess!r}.")
    observed = _read_points(points, significance)
    start = guess if guess is not None else _guess(observed, family, knots)
    like = _Family.of(start)
    values = like.values(start)
    degrees = observed.x.size * (2 if observed.has_slope else 1) - values.size
    if degrees < 0:
        raise ValueError(f"`points` must be enough for {values.size} parameters, got {observed.x.size} points.")
    values, residual, gradient, feet = _fitted_values(like, values, observed.padded())
    residual, gradient = np.asarray(residual).ravel(), np.asarray(gradient).reshape(-1, values.size)
    chi2 = chi_squared(residual)
    status, covariance = judged(residual, gradient)
    if observed.covariance is not None and np.isfinite(chi2) and not is_plausible(chi2, degrees):
        status, covariance = FitStatus.implausible, np.full_like(covariance, np.nan)
    if observed.covariance is None:
        covariance = covariance * (chi2 / degrees if degrees else np.nan)
    if isinstance(start, Contour):
        profile = Contour(jnp.exp(values[0]), values[2:], start.slopes, values[1])
    else:
        profile = like.profile(values)
    estimates, rates = map(np.asarray, like.estimates(values))
    covariance = covariance * np.outer(rates, rates)
    return ProfileFit(
        profile=profile,
        estimates=dict(zip(like.names, estimates.tolist(), strict=True)),
        standard_error=dict(zip(like.names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        chi2=chi2,
        degrees_of_freedom=degrees,
        status=status,
        slopes=(float(np.min(feet)), float(np.max(feet))),
        length=float(points.length) if isinstance(points, Reconstruction) else 1.0,
    )


def points_and_rates(profile: AbstractProfile, slopes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x and y of a profile at slope angles (rad), (slopes,), and the derivatives of its position along its normal.

    The derivatives, (slopes, p), are with respect to the fields in FAMILIES, or distance, position and log_radius of a
    Contour. The normal points outwards.
    """
    like = _Family.of(profile)
    slopes = np.atleast_1d(np.asarray(slopes, dtype=float))
    by, x, y = map(np.asarray, _along(like, like.values(profile), jnp.asarray(slopes)))
    return x, y, by


class _Points(eqx.Module):
    """Points of an object."""

    x: Float[Array, " points"] | Float[np.ndarray, " points"]
    y: Float[Array, " points"] | Float[np.ndarray, " points"]
    slope: Float[Array, " points"] | Float[np.ndarray, " points"]  # 0.0 if unknown
    covariance: Float[Array, "points 3 3"] | Float[np.ndarray, "points 3 3"] | None  # of x, y, slope
    weight: Float[Array, " points"] | Float[np.ndarray, " points"]  # 0 for padding
    has_slope: bool = eqx.field(static=True)

    def padded(self) -> "_Points":
        room = [(0, -self.x.size % PADDED)]
        padded = jax.tree.map(lambda v: np.pad(v, room + [(0, 0)] * (v.ndim - 1), mode="edge"), self)
        return eqx.tree_at(lambda points: points.weight, padded, np.pad(self.weight, room))


def _read_points(points: Any, significance: float) -> _Points:
    table = _points_table(points, significance)
    x, y, slope = table["x"], table["y"], table.get("slope")
    for name, values in (("x", x), ("y", y), ("slope", slope)):
        if values is not None and (values.ndim != 1 or values.shape != x.shape):
            raise ValueError(f"`points` must hold arrays of one length, got shape {values.shape} for {name}.")
    noise = _noise_of(table, 2 if slope is None else 3)
    known = np.isfinite(x) & np.isfinite(y) & (slope is None or np.isfinite(slope))
    known &= noise is None or np.isfinite(noise).all(axis=(1, 2))
    if not known.any():
        raise ValueError("`points` must hold finite values, got none.")
    angle = np.zeros_like(x) if slope is None else slope
    columns = jax.tree.map(lambda values: values[known], (x, y, angle, noise, np.ones_like(x)))
    return _Points(*columns, has_slope=slope is not None)


def _points_table(points: Any, significance: float) -> dict[str, Any]:
    if isinstance(points, Reconstruction):
        noise = np.asarray(points.covariance)[..., :3, :3].reshape(-1, 3, 3)
        weak = np.asarray(points.significance) < significance
        table: dict[str, Any] = {n: np.where(weak, np.nan, getattr(points, n)).ravel() for n in ("x", "y", "slope")}
        return table | {"covariance": noise if np.isfinite(noise).all(axis=(1, 2)).any() else None}
    if isinstance(points, Mapping) and {"x", "y"} <= set(points) <= {"x", "y", "slope", "covariance", "sigma"}:
        given = {name: checks.unmasked(value) for name, value in points.items() if value is not None}
        return {name: np.asarray(value, dtype=float) for name, value in given.items()}
    allowed = "a Reconstruction or a mapping with x, y and optionally slope, covariance or sigma"
    checks.instance("points", points, Mapping, allowed)
    checks.fail("points", allowed, sorted(points))


def _noise_of(table: Mapping[str, Any], size: int) -> np.ndarray | None:
    """Covariances of x, y and slope, (points, 3, 3); None if they are unknown."""
    noise, count = table.get("covariance"), table["x"].size
    if noise is None and "sigma" in table:
        sigma = np.broadcast_to(table["sigma"], (count,))
        if not (sigma > 0).all():
            raise ValueError(f"`points` must hold a positive sigma, got {sigma.min()}.")
        noise = sigma[:, None, None] ** 2 * np.diag([1.0, 1.0, 0.0][:size])
    if noise is None:
        return None
    if noise.shape[0] != count or noise.shape[1:] not in ((size, size), (2, 2), (4, 4)):
        raise ValueError(f"`points` must hold a covariance for each, {(count, size, size)}, got shape {noise.shape}.")
    return np.pad(noise, ((0, 0), (0, 3), (0, 3)))[:, :3, :3]


def _guess(observed: _Points, family: type, knots: int | Sequence[float]) -> AbstractProfile:
    """Fit a parabola by linear least squares, or a circle, on which x^2 + y^2 is linear in x and y."""
    x, y = np.asarray(observed.x), np.asarray(observed.y)
    middle, width, lowest = np.mean(x), max(np.ptp(x), 1e-9 * (1 + np.max(np.abs(x)))), float(np.min(y))
    if family in (Parabola, Contour):
        powers = np.stack([((x - middle) / width) ** k for k in (2, 1, 0)], axis=1)
        (bend, tilt, height), *_ = np.linalg.lstsq(powers, y, rcond=None)
        bend = max(bend, 1e-3 * (np.ptp(y) + 1e-300)) / width**2
        distance = max(float(height - (tilt / width) ** 2 / (4 * bend)), 0.1 * lowest)
        parabola = Parabola(distance, float(bend), float(middle - tilt / width / (2 * bend)))
        if family is Parabola:
            return parabola
        return Contour.like(parabola, _spread_knots(observed, parabola, knots) if isinstance(knots, int) else knots)
    columns = np.stack([x - middle, y, np.ones_like(x)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(columns, (x - middle) ** 2 + y**2, rcond=None)
    radius = float(np.sqrt(max(c + (a / 2) ** 2 + (b / 2) ** 2, 1e-6 * width**2)))
    distance, position = max(float(b) / 2 - radius, 0.1 * lowest), float(middle + a / 2)
    return Circle(distance, radius, position) if family is Circle else Ellipse(distance, radius, 1.1 * radius, position)


def _spread_knots(observed: _Points, near: Parabola, count: int) -> np.ndarray:
    """Slope angles spread evenly over those of the points, or over those of a parabola if the points have none."""
    slopes = observed.slope if observed.has_slope else np.arctan(2 * near.a * (observed.x - near.position))
    sure = np.ones(slopes.size, bool)
    if observed.covariance is not None:
        variance = observed.covariance[:, 2, 2]
        sure = variance <= max(SURE, np.sqrt(np.median(variance))) ** 2
    low, high = np.quantile(slopes[sure], [0.01, 0.99])
    return np.linspace(max(low, -1.5), min(high, 1.5), count)


class _Family(eqx.Module):
    """Profiles as functions of the values to fit: position, logs of positive fields, and log_radius of a Contour."""

    kind: type = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    spline: Spline | None  # arrays, not static: one compilation serves all knots of a number

    @classmethod
    def of(cls, profile: AbstractProfile) -> "_Family":
        if not isinstance(profile, Contour):
            return cls(type(profile), FAMILIES[type(profile)], None)
        radii = (f"log_radius[{k}]" for k in range(len(profile.slopes)))
        return cls(Contour, ("distance", "position", *radii), jax.tree.map(jnp.asarray, spline(profile.slopes)))

    def values(self, profile: AbstractProfile) -> Float[Array, " p"]:
        fields = ["distance", "position"] if isinstance(profile, Contour) else self.names
        values = {name: jnp.asarray(getattr(profile, name), dtype=float) for name in fields}
        values = jnp.stack([value if name == "position" else jnp.log(value) for name, value in values.items()])
        return jnp.concatenate([values, profile.log_radius]) if isinstance(profile, Contour) else values

    def profile(self, values: Float[Array, " p"]) -> AbstractProfile:
        if self.spline is not None:
            return tabulate(self.spline, jnp.exp(values[0]), values[1], values[2:])
        fields = zip(self.names, values, strict=True)
        return self.kind(**{name: v if name == "position" else jnp.exp(v) for name, v in fields})

    def estimates(self, values: Float[Array, " p"]) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Values of the fields, and their derivatives with respect to the fitted values."""
        logs = np.array([name != "position" and not name.startswith("log") for name in self.names])
        estimates = jnp.where(logs, jnp.exp(values), values)
        return estimates, jnp.where(logs, estimates, 1.0)


def _parameter(profile: AbstractProfile, slope: Scalar) -> Scalar:
    """The profile's own parameter at a slope angle."""
    if isinstance(profile, Ellipse):
        return jnp.arctan2(jnp.sqrt(profile.a) * jnp.sin(slope), jnp.sqrt(profile.b) * jnp.cos(slope))
    return slope


def _residuals(like: _Family, values, observed: _Points, weights) -> Array:
    """Residuals of every point, whitened by `weights`: its distance from its foot, and the difference of slopes."""
    profile = like.profile(values)
    constant = jax.lax.stop_gradient(profile)

    def one(x, y, slope, weights):
        foot, _ = _foot(profile, constant, x, y)
        at = profile.point(_parameter(profile, jax.lax.stop_gradient(foot)))
        # To first order, the distance does not depend on the position of the foot.
        off = (at.x - x) * at.sin - (at.y - y) * at.cos
        return weights @ jnp.stack([off, slope - foot])

    residuals = jax.vmap(one)(observed.x, observed.y, observed.slope, weights)
    return residuals * observed.weight[:, None]


def _foot(profile, constant, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Slope at the foot of (x, y), and the distance of (x, y) from the centre of curvature there."""

    def ahead(profile, slope):
        at = profile.point(_parameter(profile, slope))
        return (at.x - x) * at.cos + (at.y - y) * at.sin

    slope = bisect(lambda slope: ahead(constant, slope) < 0, -STEEPEST, STEEPEST, steps=HALVINGS)
    for step in range(NEWTON_STEPS):
        last = step == NEWTON_STEPS - 1
        off, rate = jax.jvp(lambda slope: ahead(constant, slope), (slope,), (jnp.ones(()),))
        # The last step carries the derivative.
        slope = slope - (ahead(profile, slope) if last else off) / jnp.where(rate > 0, rate, 1.0)
    return slope, rate


def _weights(like: _Family, values, observed: _Points) -> Float[Array, "points 2 2"]:
    """Lower triangular matrices that whiten the residuals, smaller for outliers (Huber)."""
    profile = like.profile(values)

    def one(x, y, noise):
        slope, radius = _foot(profile, profile, x, y)
        cos, sin, zero = jnp.cos(slope), jnp.sin(slope), jnp.zeros(())
        if noise is None:
            return jnp.stack([jnp.stack([zero + 1.0, zero]), jnp.stack([zero, radius])])
        by = jnp.stack([jnp.stack([-sin, cos, zero]), jnp.stack([-cos / radius, -sin / radius, zero + 1.0])])
        half = jnp.sum(by[:, :, None] * noise, axis=1)
        (a, b), (_, c) = jnp.sum(half[:, None, :] * by, axis=2)
        # The inverse of the Cholesky factor.
        a, b = jnp.sqrt(a), b / jnp.sqrt(a)
        c = jnp.sqrt(jnp.maximum(c - b**2, LEAST * c + 1e-300))
        return jnp.stack([jnp.stack([1 / a, zero]), jnp.stack([-b / (a * c), 1 / c])])

    weights = jax.vmap(one)(observed.x, observed.y, observed.covariance)
    weights = weights if observed.has_slope else weights.at[:, 1].set(0.0)
    if observed.covariance is None:
        return weights
    size = jnp.sqrt(jnp.sum(_residuals(like, values, observed, weights) ** 2, axis=-1))
    share = jnp.sqrt(jnp.minimum(1.0, OUTLIER / jnp.maximum(size, OUTLIER)))
    return weights * share[:, None, None]


@Program
def _fitted_values(like: _Family, values, observed: _Points):
    solver = optx.LevenbergMarquardt(rtol=RTOL, atol=1e-2 * RTOL)

    def fit(_, values):
        solution = optx.least_squares(
            lambda values, weights: _residuals(like, values, observed, weights),
            solver,
            values,
            args=_weights(like, values, observed),
            max_steps=LEAST_SQUARES_STEPS,
            throw=False,
        )
        return solution.value

    values = jax.lax.fori_loop(0, REWEIGHTINGS, fit, values)
    weights = _weights(like, values, observed)
    residual = _residuals(like, values, observed, weights)
    gradient = jax.jacfwd(lambda values: _residuals(like, values, observed, weights))(values)
    profile = like.profile(values)
    feet, _ = jax.vmap(lambda x, y: _foot(profile, profile, x, y))(observed.x, observed.y)
    return values, residual, gradient, feet


@Program
def _along(like: _Family, values, slopes: Float[Array, " slopes"]):
    def across(values):
        profile = like.profile(values)
        at = jax.vmap(lambda slope: profile.point(_parameter(jax.lax.stop_gradient(profile), slope)))(slopes)
        return at.x * jnp.sin(slopes) - at.y * jnp.cos(slopes), (at.x, at.y)

    by, (x, y) = jax.jacfwd(across, has_aux=True)(values)
    return by / like.estimates(values)[1], x, y
