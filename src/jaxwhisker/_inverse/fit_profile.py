"""Fit a profile to points of an object: what shape it has, and how exactly that is known."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Scalar
from jaxwhisker._inverse.fit_status import FitStatus, plausible
from jaxwhisker._inverse.points import Reconstruction
from jaxwhisker._model.contour import Contour, Spline, spline, tabulate
from jaxwhisker._model.profile import STEEPEST, AbstractProfile
from jaxwhisker._model.profiles import Circle, Ellipse, Parabola

KNOTS = 8  # of a Contour
REWEIGHTINGS = 5  # weights depend on the profile: they are those of the last one
MAX_STEPS = 128
RTOL = 1e-7
SETTLED = 0.1  # a further step of Gauss-Newton is at most this share of the standard errors,
EXACTLY = 1e-8  # or this, of logs of lengths
HALVINGS, NEWTON_STEPS = 14, 3  # to a point's foot on the profile
LEAST = 1e-12  # share of a slope's variance that is not position's
SURE = 0.1  # rad: knots of a Contour are spread over slopes that are known better
SIGNIFICANCE = 40.0  # standard deviations
OUTLIER = 3.0  # standard deviations from which on a point counts less, by Huber's rule: few contacts are of wrong phase
WORST_CONDITION = 1e13  # of the scaled normal matrix: beyond, the points do not tell all parameters

FAMILIES: dict[type, tuple[str, ...]] = {
    Parabola: ("distance", "a", "position"),
    Circle: ("distance", "radius", "position"),
    Ellipse: ("distance", "a", "b", "position"),
}


_COMPILED: Any = {"compiler_options": COMPILER_OPTIONS}


class ProfileFit(eqx.Module):
    """A profile fitted to points.

    Standard errors are those of the points' covariances; without any, of their scatter about the profile. They are NaN
    where the status is not ok: `implausible` where covariances do not explain how far the points are from the profile.
    """

    profile: AbstractProfile
    estimates: dict[str, float]
    standard_error: dict[str, float]
    covariance: Float[np.ndarray, "p p"]  # of the estimates, in their order
    chi2: float  # sum of squares of the weighted residuals
    degrees_of_freedom: int = eqx.field(static=True)
    status: FitStatus = eqx.field(static=True)

    def band(self, slopes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x and y of the profile at slope angles, and the standard error across it, to first order; each (slopes,)."""
        slopes = np.atleast_1d(np.asarray(slopes, dtype=float))
        like = _Family.of(self.profile)
        by, x, y = map(np.asarray, _along(like, like.values(self.profile), jnp.asarray(slopes)))
        error = np.sqrt(np.maximum(np.einsum("ip,pq,iq->i", by, self.covariance, by), 0.0))
        return np.asarray(x), np.asarray(y), np.where(np.isfinite(self.covariance).all(), error, np.nan)

    def __str__(self) -> str:
        lines = [f"{self.profile}: chi^2 {self.chi2:.4g} of {self.degrees_of_freedom} degrees of freedom"]
        lines += [f"status: {self.status.name}, standard errors are not known"] * (self.status != FitStatus.ok)
        width = max(map(len, self.estimates))
        for name, value in self.estimates.items():
            lines.append(f"  {name:<{width}}  {value:< 14.8g} +- {self.standard_error[name]:.2g}")
        return "\n".join(lines)

    __repr__ = __str__


class _Points(eqx.Module):
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    slope: Float[Array, " points"]  # 0.0 if unknown
    covariance: Float[Array, "points 3 3"] | None  # of x, y, slope
    weight: Float[Array, " points"]  # 0.0 of those that only fill up
    has_slope: bool = eqx.field(static=True)


def fit_profile(
    points: Reconstruction | Mapping[str, Any],
    family: type[AbstractProfile],
    *,
    knots: int | Any = KNOTS,
    guess: AbstractProfile | None = None,
    significance: float = SIGNIFICANCE,
) -> ProfileFit:
    """The profile of a family that lies nearest to points, weighted with the errors in position and slope.

    Residuals of a point are its distance from the profile and, if it has a slope, what that exceeds the slope of the
    nearest point of the profile by: linear in what was measured, as errors of weak contacts' slopes are not small.

    Args:
        points: a Reconstruction, of which all points are taken that are significant; or a mapping with x, y,
            perhaps slope, and perhaps their covariance (points, 2 or 3, 2 or 3) or sigma, a standard deviation of x
            and y.
        family: Parabola, Circle, Ellipse or Contour.
        knots: of a Contour: how many, evenly spread over the slopes of the points, or the knots themselves, rad.
        guess: a profile of the family to start from.
        significance: of a Reconstruction, points whose signals are fewer standard deviations of noise are left out:
            their weights follow their noise, which pulls a fit to one side.

    Raises:
        ValueError: if an argument is not of that kind, or there are fewer points than parameters.
    """
    checks.float64_mode()
    if family not in (*FAMILIES, Contour):
        raise ValueError(f"`family` must be Parabola, Circle, Ellipse or Contour, but is {family!r}.")
    if guess is not None and not isinstance(guess, family):
        raise ValueError(f"`guess` must be a {family.__name__}, but is {guess!r}.")
    known = _points_of(points, significance)
    start = guess if guess is not None else _guess(known, family, knots)
    like = _Family.of(start)
    values = like.values(start)
    count = int(np.sum(np.asarray(known.weight) > 0))
    free = count * (2 if known.has_slope else 1) - values.size
    if free < 0:
        raise ValueError(f"`points` must be enough for {values.size} parameters, but are {count}.")
    values, residual, gradient = _fitted(like, values, known)
    residual, gradient = np.asarray(residual).ravel(), np.asarray(gradient).reshape(-1, values.size)
    chi2 = float(np.sum(residual**2))
    status, covariance = _ended(residual, gradient)
    if known.covariance is not None and np.isfinite(chi2) and not plausible(chi2, free):
        status, covariance = FitStatus.implausible, np.full_like(covariance, np.nan)
    if known.covariance is None:
        covariance = covariance * (chi2 / free if free else np.nan)
    estimates, rates = map(np.asarray, like.estimates(values))
    covariance = covariance * np.outer(rates, rates)
    errors = np.sqrt(np.diag(covariance))
    return ProfileFit(
        profile=_profile(start, values),
        estimates=dict(zip(like.names, map(float, estimates), strict=True)),
        standard_error=dict(zip(like.names, map(float, errors), strict=True)),
        covariance=covariance,
        chi2=chi2,
        degrees_of_freedom=free,
        status=status,
    )


def _ended(residual: np.ndarray, gradient: np.ndarray) -> tuple[FitStatus, np.ndarray]:
    """How the fit ended, and the covariance of what was fitted; NaN if badly."""
    unknown = np.full((gradient.shape[1],) * 2, np.nan)
    size = np.linalg.norm(gradient, axis=0)
    if not (np.isfinite(residual).all() and np.isfinite(size).all()):
        return FitStatus.not_converged, unknown
    scaled = gradient / np.where(size > 0, size, 1.0)
    if not ((size > 0).all() and np.linalg.cond(scaled.T @ scaled) < WORST_CONDITION):
        return FitStatus.undetermined, unknown
    covariance = np.linalg.inv(scaled.T @ scaled) / np.outer(size, size)
    further = np.abs(covariance @ (gradient.T @ residual))
    if not ((further < SETTLED * np.sqrt(np.diag(covariance))) | (further < EXACTLY)).all():
        return FitStatus.not_converged, unknown
    return FitStatus.ok, covariance


def _profile(start: AbstractProfile, values: Float[Array, " p"]) -> AbstractProfile:
    if isinstance(start, Contour):
        return Contour(jnp.exp(values[0]), values[2:], start.slopes, values[1])
    return _Family.of(start).profile(values)


def _points_of(points: Any, significance: float) -> _Points:
    if isinstance(points, Reconstruction):
        noise = np.asarray(points.covariance)[..., :3, :3].reshape(-1, 3, 3)
        clear = ~(np.asarray(points.significance) < significance)
        table: dict[str, Any] = {
            name: np.where(clear, getattr(points, name), np.nan).ravel() for name in ("x", "y", "slope")
        }
        known = np.isfinite(noise).all(axis=(1, 2))
        table["covariance"] = noise if known.any() else None
    elif isinstance(points, Mapping) and {"x", "y"} <= set(points) <= {"x", "y", "slope", "covariance", "sigma"}:
        table = {name: np.asarray(value, dtype=float) for name, value in points.items() if value is not None}
    else:
        raise ValueError(
            f"`points` must be a Reconstruction or a mapping with x, y and perhaps slope, covariance or sigma, but is "
            f"{sorted(points) if isinstance(points, Mapping) else repr(points)}."
        )
    x, y, slope = table["x"], table["y"], table.get("slope")
    for name, values in (("x", x), ("y", y), ("slope", slope)):
        if values is not None and (values.ndim != 1 or values.shape != x.shape):
            raise ValueError(f"`points` must hold one-dimensional arrays of one length, but {name} is {values.shape}.")
    size = 2 if slope is None else 3
    noise = table.get("covariance")
    if noise is None and "sigma" in table:
        sigma = np.broadcast_to(table["sigma"], x.shape)
        if not (sigma > 0).all():
            raise ValueError(f"`points` must hold a positive sigma, but its least is {sigma.min()}.")
        noise = sigma[:, None, None] ** 2 * np.diag([1.0, 1.0, 0.0][:size])
    if noise is not None:
        if noise.shape[0] != x.size or noise.shape[1:] not in ((size, size), (2, 2), (4, 4)):
            raise ValueError(
                f"`points` must hold a covariance for each, {(x.size, size, size)}, but it is {noise.shape}."
            )
        noise = np.pad(noise, ((0, 0), (0, 3), (0, 3)))[:, :3, :3]
    known = np.isfinite(x) & np.isfinite(y) & (slope is None or np.isfinite(slope))
    known &= noise is None or np.isfinite(noise).all(axis=(1, 2))
    if not known.any():
        raise ValueError("`points` must hold points, but none is known.")
    # Lengths are rounded up, so that most are compiled for already.
    at = np.concatenate([np.flatnonzero(known), np.full(-known.sum() % 256, np.flatnonzero(known)[0])])
    weight = jnp.asarray((np.arange(at.size) < known.sum()).astype(float))
    angle = np.zeros_like(x) if slope is None else slope
    x, y, angle = (jnp.asarray(values[at]) for values in (x, y, angle))
    return _Points(x, y, angle, None if noise is None else jnp.asarray(noise[at]), weight, slope is not None)


def _guess(known: _Points, family: type, knots: Any) -> AbstractProfile:
    own = np.asarray(known.weight) > 0
    x, y = np.asarray(known.x)[own], np.asarray(known.y)[own]
    middle, width = np.mean(x), max(np.ptp(x), 1e-9 * (1 + np.max(np.abs(x))))
    spread = np.stack([((x - middle) / width) ** k for k in (2, 1, 0)], axis=1)
    (bend, tilt, height), *_ = np.linalg.lstsq(spread, y, rcond=None)
    bend = max(bend, 1e-3 * (np.ptp(y) + 1e-300)) / width**2
    position, lowest = middle - tilt / width / (2 * bend), np.min(y)
    distance = max(float(height - (tilt / width) ** 2 / (4 * bend)), 0.1 * float(lowest))
    parabola = Parabola(distance, float(bend), float(position))
    if family is Parabola:
        return parabola
    # The circle for which x^2 + y^2 is nearest to linear in x and y.
    columns = np.stack([x - middle, y, np.ones_like(x)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(columns, (x - middle) ** 2 + y**2, rcond=None)
    radius = float(np.sqrt(max(c + (a / 2) ** 2 + (b / 2) ** 2, 1e-6 * width**2)))
    distance = max(float(b) / 2 - radius, 0.1 * float(lowest))
    if family is Circle:
        return Circle(distance, radius, float(middle + a / 2))
    if family is Ellipse:
        return Ellipse(distance, radius, 1.1 * radius, float(middle + a / 2))
    if isinstance(knots, int):
        slopes = np.asarray(known.slope)[own] if known.has_slope else np.arctan(2 * bend * (x - position))
        sure = np.ones(slopes.size, bool)
        if known.covariance is not None:
            sure = (
                np.asarray(known.covariance)[own, 2, 2] <= max(SURE, np.sqrt(np.median(known.covariance[:, 2, 2]))) ** 2
            )
        low, high = np.quantile(slopes[sure], [0.01, 0.99])
        knots = np.linspace(max(low, -1.5), min(high, 1.5), knots)
    return Contour.like(parabola, knots)


class _Family(eqx.Module):
    """Profiles with parameters to fit: position, the logs of positive fields, and log_radius of a Contour."""

    kind: type = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    spline: Spline | None  # an array, so that other knots need no other code

    @classmethod
    def of(cls, profile: AbstractProfile) -> "_Family":
        if not isinstance(profile, Contour):
            return cls(type(profile), FAMILIES[type(profile)], None)
        radii = (f"log_radius[{k}]" for k in range(len(profile.slopes)))
        maps = jax.tree.map(jnp.asarray, spline(profile.slopes))
        return cls(Contour, ("distance", "position", *radii), maps)

    def values(self, profile: AbstractProfile) -> Float[Array, " p"]:
        plain = ["distance", "position"] if isinstance(profile, Contour) else self.names
        values = [jnp.asarray(getattr(profile, name), dtype=float) for name in plain]
        values = [value if name == "position" else jnp.log(value) for name, value in zip(plain, values, strict=True)]
        return jnp.concatenate([jnp.stack(values), *([profile.log_radius] if isinstance(profile, Contour) else [])])

    def profile(self, values: Float[Array, " p"]) -> AbstractProfile:
        if self.spline is not None:
            return tabulate(self.spline, jnp.exp(values[0]), values[1], values[2:])
        fields = zip(self.names, values, strict=True)
        return self.kind(**{name: v if name == "position" else jnp.exp(v) for name, v in fields})

    def estimates(self, values: Float[Array, " p"]) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Values of the fields, and their derivatives by what was fitted."""
        logs = np.array([name != "position" and not name.startswith("log") for name in self.names])
        estimates = jnp.where(logs, jnp.exp(values), values)
        return estimates, jnp.where(logs, estimates, 1.0)


def _parameter(profile: AbstractProfile, slope: Scalar) -> Scalar:
    """The profile's own parameter at a slope angle."""
    if isinstance(profile, Ellipse):
        return jnp.arctan2(jnp.sqrt(profile.a) * jnp.sin(slope), jnp.sqrt(profile.b) * jnp.cos(slope))
    return slope


def _residuals(like: "_Family", values, known: _Points, weights) -> Array:
    """Of every point, whitened by `weights`: distance from the profile and slope's excess over that of the foot."""
    profile = like.profile(values)
    still = jax.lax.stop_gradient(profile)

    def one(x, y, slope, weights):
        foot, _ = _foot(profile, still, x, y)
        at = profile.point(_parameter(profile, jax.lax.stop_gradient(foot)))
        # The distance does not depend on where exactly the foot is, to first order.
        off = (at.x - x) * at.sin - (at.y - y) * at.cos
        return weights @ jnp.stack([off, slope - foot])

    found = jax.vmap(one)(known.x, known.y, known.slope, weights)
    return found * known.weight[:, None]


def _foot(profile, still, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Slope at the profile's point nearest to (x, y), and the radius of curvature there."""

    def ahead(profile, slope):
        at = profile.point(_parameter(profile, slope))
        return (at.x - x) * at.cos + (at.y - y) * at.sin

    def narrower(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        before = ahead(still, middle) < 0
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, HALVINGS, narrower, (jnp.asarray(-STEEPEST), jnp.asarray(STEEPEST)))
    slope = (low + high) / 2
    for step in range(NEWTON_STEPS):
        last = step == NEWTON_STEPS - 1
        off, rate = jax.jvp(lambda slope: ahead(still, slope), (slope,), (jnp.ones(()),))
        # The last step carries the derivative.
        slope = slope - (ahead(profile, slope) if last else off) / jnp.where(rate > 0, rate, 1.0)
    return slope, rate


def _weights(like: "_Family", values, known: _Points) -> Float[Array, "points 2 2"]:
    """What whitens the residuals: lower triangular matrices."""
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

    weights = jax.vmap(one)(known.x, known.y, known.covariance)
    return weights if known.has_slope else weights.at[:, 1].set(0.0)


def _robust(like: "_Family", values, known: _Points) -> Float[Array, "points 2 2"]:
    """Weights, smaller for points that lie farther off than their errors allow: Huber's."""
    weights = _weights(like, values, known)
    if known.covariance is None:
        return weights
    size = jnp.sqrt(jnp.sum(_residuals(like, values, known, weights) ** 2, axis=-1))
    share = jnp.sqrt(jnp.minimum(1.0, OUTLIER / jnp.maximum(size, OUTLIER)))
    return weights * share[:, None, None]


@eqx.filter_jit(**_COMPILED)
def _fitted(like: _Family, values, known: _Points):
    solver = optx.LevenbergMarquardt(rtol=RTOL, atol=1e-2 * RTOL)

    def again(_, values):
        weights = _robust(like, values, known)
        solution = optx.least_squares(
            lambda values, weights: _residuals(like, values, known, weights),
            solver,
            values,
            args=weights,
            max_steps=MAX_STEPS,
            throw=False,
        )
        return solution.value

    values = jax.lax.fori_loop(0, REWEIGHTINGS, again, values)
    weights = _robust(like, values, known)
    residual = _residuals(like, values, known, weights)
    gradient = jax.jacfwd(lambda values: _residuals(like, values, known, weights))(values)
    return values, residual, gradient


@eqx.filter_jit(**_COMPILED)
def _along(like: _Family, values, slopes: Float[Array, " slopes"]):
    def across(values):
        profile = like.profile(values)
        at = jax.vmap(lambda slope: profile.point(_parameter(jax.lax.stop_gradient(profile), slope)))(slopes)
        return at.x * jnp.sin(slopes) - at.y * jnp.cos(slopes), (at.x, at.y)

    by, (x, y) = jax.jacfwd(across, has_aux=True)(values)
    return by / like.estimates(values)[1], x, y
