"""Fit a profile to points of an object: its shape, and the uncertainty of that shape."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Scalar
from jaxwhisker._inverse.fit_shape import (
    SIGNIFICANCE,
    AbstractShapeFamily,
    AbstractShapeFit,
    Facet,
    ShapePoints,
    fit_shape,
    nearest_quadric,
    supported_points,
)
from jaxwhisker._inverse.points import Reconstruction
from jaxwhisker._model.conic import Circle, Ellipse, Parabola
from jaxwhisker._model.contour import Contour, Spline, spline, tabulate
from jaxwhisker._model.profile import STEEPEST, AbstractProfile, bisect

KNOTS = 8  # of a Contour
HALVINGS, NEWTON_STEPS = 14, 3  # to a point's foot, the point of the profile nearest to it
SURE = 0.1  # rad: knots of a Contour are spread over slopes known better than this

FAMILIES: dict[type, tuple[str, ...]] = {
    Parabola: ("distance", "a", "position"),
    Circle: ("distance", "radius", "position"),
    Ellipse: ("distance", "a", "b", "position"),
}


class ProfileFit(AbstractShapeFit):
    """A profile fitted to points.

    Standard errors follow from the covariances of the points, or, without any, from the scatter of the points about the
    profile. They are NaN where the status is not ok: `implausible` if the covariances do not explain the distances of
    the points from the profile, `undetermined` if the points do not determine all parameters, or `not_converged`.
    """

    profile: AbstractProfile
    slopes: tuple[float, float] = eqx.field(static=True)  # smallest and largest slope angle of the points, rad
    length: float = eqx.field(static=True)  # of the first whisker of a Reconstruction; else 1

    @property
    def _shape(self) -> AbstractProfile:
        return self.profile

    def band(self, slopes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x and y at slope angles (rad), and the first-order standard error across the profile; lengths (slopes,)."""
        x, y, by = points_and_rates(self.profile, slopes)
        return x, y, self._across(by)


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
    like = _ProfileFamily.of(start)
    values = like.values(like.parameters(start))
    if observed.residuals < values.size:
        count = observed.position.shape[0]
        raise ValueError(f"`points` must be enough for {values.size} parameters, got {count} points.")
    fields, feet = fit_shape(like, values, observed)
    return ProfileFit(
        profile=like.profile(fields["estimates"]),
        slopes=(float(np.min(feet)), float(np.max(feet))),
        length=float(points.length) if isinstance(points, Reconstruction) else 1.0,
        **fields,
    )


def points_and_rates(profile: AbstractProfile, slopes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x and y of a profile at slope angles (rad), (slopes,), and the derivatives of its position along its normal.

    The derivatives, (slopes, p), are with respect to the fields in FAMILIES, or distance, position and log_radius of a
    Contour. The normal points outwards.
    """
    like = _ProfileFamily.of(profile)
    points, by = supported_points(like, like.parameters(profile), np.atleast_1d(slopes))
    return points[:, 0], points[:, 1], by


def _read_points(points: Any, significance: float) -> ShapePoints:
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
    columns = np.stack([x, y], axis=1), angle, noise, np.ones_like(x)
    return ShapePoints(*jax.tree.map(lambda values: values[known], columns), has_direction=slope is not None)


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


def _guess(observed: ShapePoints, family: type, knots: int | Sequence[float]) -> AbstractProfile:
    """Fit a parabola or a circle by linear least squares."""
    x, y = np.asarray(observed.position).T
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
    _, (a, b), c = nearest_quadric(np.stack([x - middle, y], axis=1))
    radius = float(np.sqrt(max((a / 2) ** 2 + (b / 2) ** 2 - c, 1e-6 * width**2)))
    distance, position = max(-float(b) / 2 - radius, 0.1 * lowest), float(middle - a / 2)
    return Circle(distance, radius, position) if family is Circle else Ellipse(distance, radius, 1.1 * radius, position)


def _spread_knots(observed: ShapePoints, near: Parabola, count: int) -> np.ndarray:
    """Slope angles spread evenly over those of the points, or over those of a parabola if the points have none."""
    x, slopes = np.asarray(observed.position)[:, 0], np.asarray(observed.direction)
    if not observed.has_direction:
        slopes = np.arctan(2 * near.a * (x - near.position))
    sure = np.ones(slopes.size, bool)
    if observed.covariance is not None:
        variance = np.asarray(observed.covariance)[:, 2, 2]
        sure = variance <= max(SURE, np.sqrt(np.median(variance))) ** 2
    low, high = np.quantile(slopes[sure], [0.01, 0.99])
    return np.linspace(max(low, -1.5), min(high, 1.5), count)


class _ProfileFamily(AbstractShapeFamily):
    """Profiles; fitted are the position, logs of positive fields, and log_radius of a Contour."""

    kind: type = eqx.field(static=True)
    spline: Spline | None  # arrays, not static: one compilation serves all knots of a number

    @classmethod
    def of(cls, profile: AbstractProfile) -> "_ProfileFamily":
        if not isinstance(profile, Contour):
            return cls(FAMILIES[type(profile)], 1.0, type(profile), None)
        radii = (f"log_radius[{k}]" for k in range(len(profile.slopes)))
        return cls(("distance", "position", *radii), 1.0, Contour, spline(profile.slopes))

    @property
    def _logs(self) -> np.ndarray:
        """Of which parameters the logarithm is fitted."""
        return np.array([name != "position" and not name.startswith("log") for name in self.names])

    def parameters(self, profile: AbstractProfile) -> Float[np.ndarray, " p"]:
        """The parameters of a profile, by `names`."""
        radii = profile.log_radius if isinstance(profile, Contour) else ()
        fields = self.names[: len(self.names) - len(radii)]
        return np.array([*(float(getattr(profile, name)) for name in fields), *np.asarray(radii)])

    def values(self, parameters: Any, xp: Any = np) -> Any:
        """The fitted values that belong to parameters."""
        with np.errstate(divide="ignore", invalid="ignore"):  # a fit from there has not converged
            return xp.where(self._logs, xp.log(xp.where(self._logs, parameters, 1.0)), parameters)

    def estimates(self, values):
        with np.errstate(over="ignore"):
            estimates = np.where(self._logs, np.exp(np.where(self._logs, values, 0.0)), values)
        return estimates, np.diag(np.where(self._logs, estimates, 1.0))

    def profile(self, estimates: Mapping[str, float]) -> AbstractProfile:
        """The profile with these parameters."""
        if self.spline is None:
            return self.kind(**{name: jnp.asarray(value) for name, value in estimates.items()})
        distance, position, *radii = estimates.values()
        return Contour(jnp.asarray(distance), np.array(radii), self.spline.knots, jnp.asarray(position))

    def shape(self, values):
        if self.spline is not None:
            return tabulate(self.spline, jnp.exp(values[0]), values[1], values[2:])
        fields = zip(self.names, values, strict=True)
        return self.kind(**{name: v if name == "position" else jnp.exp(v) for name, v in fields})

    def facet(self, shape, position, covariance):
        slope, radius = _foot(shape, position)
        cos, sin, zero = jnp.cos(slope), jnp.sin(slope), jnp.zeros(())
        by = jnp.stack([jnp.stack([-sin, cos, zero]), jnp.stack([-cos / radius, -sin / radius, zero + 1.0])])
        return Facet(radius, jnp.ones((1, 1)), by, bias=zero)

    def residuals(self, shape, position, direction):
        foot, _ = _foot(shape, position)
        at = shape.point(_parameter(shape, jax.lax.stop_gradient(foot)))
        # To first order, the distance does not depend on the position of the foot.
        off = (at.x - position[0]) * at.sin - (at.y - position[1]) * at.cos
        return off, direction - foot, foot

    def supported(self, estimates, direction):
        profile = self.shape(self.values(estimates, jnp))
        at = profile.point(_parameter(jax.lax.stop_gradient(profile), direction))
        return at.x * jnp.sin(direction) - at.y * jnp.cos(direction), jnp.stack([at.x, at.y])


def _parameter(profile: AbstractProfile, slope: Scalar) -> Scalar:
    """The profile's own parameter at a slope angle."""
    if isinstance(profile, Ellipse):
        return jnp.arctan2(jnp.sqrt(profile.a) * jnp.sin(slope), jnp.sqrt(profile.b) * jnp.cos(slope))
    return slope


def _foot(profile: AbstractProfile, position: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Slope at the foot of a point, and the distance of the point from the centre of curvature there."""
    constant = jax.lax.stop_gradient(profile)

    def ahead(profile, slope):
        at = profile.point(_parameter(profile, slope))
        return (at.x - position[0]) * at.cos + (at.y - position[1]) * at.sin

    slope = bisect(lambda slope: ahead(constant, slope) < 0, -STEEPEST, STEEPEST, steps=HALVINGS)
    for step in range(NEWTON_STEPS):
        last = step == NEWTON_STEPS - 1
        off, rate = jax.jvp(lambda slope: ahead(constant, slope), (slope,), (jnp.ones(()),))
        # The last step carries the derivative.
        slope = slope - (ahead(profile, slope) if last else off) / jnp.where(rate > 0, rate, 1.0)
    return slope, rate
