"""The result of a reconstruction: points of the object, their uncertainty, and what follows from them."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import NamedInt
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.statistics import NORMAL_95

NEAR_VERTEX = 0.2  # largest |tan(slope)| of points from which the vertex is estimated
LEAST_POINTS = 8  # least number of points for a polynomial
SIGNIFICANT = 20.0  # standard deviations: below, errors are not linear in the noise
LARGEST_CONDITION = 1e12  # of a polynomial's normal matrix


class PointStatus(NamedInt):
    """Status of one whisker at one step."""

    ok = 0
    free = 1  # its signals are compatible with no contact
    failed = 2  # no state of the whisker was found near its signals
    missing = 3  # a signal is NaN: its own, or one that the position of its base depends on
    ambiguous = 4  # one contact does not explain its signals, and they do not determine several


class VertexEstimates(NamedTuple):
    """Estimates of the object's lowest point, one per whisker, (whiskers,); NaN for a whisker that never passed it."""

    x: Float[np.ndarray, " whiskers"]
    x_error: Float[np.ndarray, " whiskers"]  # standard errors
    y: Float[np.ndarray, " whiskers"]
    y_error: Float[np.ndarray, " whiskers"]
    radius: Float[np.ndarray, " whiskers"]  # radius of curvature there, a length
    base_x: Float[np.ndarray, " whiskers"]  # x of the base when the whisker is there, where fx crosses zero


class Consistency(NamedTuple):
    """Distances of the points of whiskers 2, 3, ... from the contour of whisker 1."""

    distance: Float[np.ndarray, "steps others"]  # along the outward normal; NaN where it is unknown
    error: Float[np.ndarray, "steps others"]  # standard error of the distance
    chi2: float  # mean square of their ratio: 1 if all whiskers see the same contour; NaN without noise

    def __str__(self) -> str:
        known = np.isfinite(self.distance)
        largest = np.max(np.abs(self.distance[known]), initial=0.0)
        chi2 = "" if np.isnan(self.chi2) else f", reduced chi^2 {self.chi2:.3g}"
        return f"{known.sum()} points compared, at most {largest:.3g} apart{chi2}"


class AbstractReconstruction(eqx.Module):
    """Points of an object at every step and for every whisker, with their uncertainty, in the plane or in space."""

    control: Float[Array, " steps"]
    length: Float[Array, ""]  # of the first whisker
    x: Float[Array, "steps whiskers *contacts"]  # contact: a point of the object
    y: Float[Array, "steps whiskers *contacts"]
    arc: Float[Array, "steps whiskers *contacts"]  # arc length from base to contact
    phase: Int[Array, "steps whiskers *contacts"]  # Phase.free, .tip, .tangential (on the shaft)
    base_x: Float[Array, "steps whiskers"]
    base_y: Float[Array, "steps whiskers"]
    chi2: Float[Array, "steps whiskers"]  # chi-squared of the nearest state
    significance: Float[Array, "steps whiskers"]  # of the signals, in standard deviations of their noise
    status: Int[Array, "steps whiskers"]  # PointStatus
    covariance: eqx.AbstractVar[Float[Array, "steps whiskers *contacts numbers numbers"]]
    _across: eqx.AbstractClassVar[str]  # the direction of `normal_error`, in words

    @property
    @abc.abstractmethod
    def _normal(self) -> Float[Array, "steps whiskers *contacts axes"]:
        """Unit vectors in the direction of `normal_error`."""

    @abc.abstractmethod
    def _findings(self) -> list[str]:
        """Further lines of the summary."""

    @property
    @in_double
    def standard_error(self) -> Float[Array, "steps whiskers *contacts numbers"]:
        """Standard errors of x, y, slope and arc; in space, of x, y, z, arc, force_x, force_y and force_z."""
        return jnp.sqrt(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    @in_double
    def normal_error(self) -> Float[Array, "steps whiskers *contacts"]:
        """Standard error of the position across the contour, in space along the contact force; a length."""
        normal = self._normal
        axes = normal.shape[-1]
        return jnp.sqrt(jnp.einsum("...i,...ij,...j", normal, self.covariance[..., :axes, :axes], normal))

    @property
    def clear(self) -> Bool[np.ndarray, "steps whiskers"]:
        """Which points are clear of the noise: their errors are linear in it."""
        return (np.asarray(self.status) == PointStatus.ok) & ~(np.asarray(self.significance) < SIGNIFICANT)

    def __str__(self) -> str:
        status, phase = np.asarray(self.status), np.asarray(self.phase)
        steps, whiskers = status.shape
        counted = [f"{np.sum(phase == p)} {p.name}" for p in (Phase.tip, Phase.tangential)]
        counted += [f"{np.sum(status == s)} {s.name}" for s in list(PointStatus)[1:] if np.any(status == s)]
        lines = [f"{steps} steps of {whiskers} whisker{'s' * (whiskers > 1)}: {', '.join(counted)}"]
        error = np.asarray(self.normal_error)
        if np.isfinite(error).any():
            lines.append(f"standard error {self._across}: {np.nanmedian(error):.3g} (median)")
        return "\n".join([*lines, *self._findings()])

    __repr__ = __str__


class Reconstruction(AbstractReconstruction):
    """Points of the object at every step and for every whisker, with their uncertainty, in the sensor's units.

    Fields are NaN, and `phase` is Phase.free, where the status is not ok; the pose of the base and the significance are
    also known for whiskers whose signals are not missing. `chi2` has one degree of freedom.

    The result with known objects is a `ContactsReconstruction`.
    """

    slope: Float[Array, "steps whiskers"]  # alpha of the object at the contact, rad
    force: Float[Array, "steps whiskers"]  # f > 0
    base_angle: Float[Array, "steps whiskers"]  # of the whisker there to the upright, rad, counter-clockwise
    covariance: Float[Array, "steps whiskers 4 4"]  # of x, y, slope and arc
    _across = "across the contour"

    @property
    def _normal(self):
        return jnp.stack([jnp.sin(self.slope), -jnp.cos(self.slope)], axis=-1)

    @property
    @in_double
    def band(self) -> tuple[Float[Array, "2 steps whiskers"], Float[Array, "2 steps whiskers"]]:
        """x and y of the two borders of the 95 % band: outside the object, towards the whiskers, and inside it."""
        return bar_ends(self.x, self.y, self.slope, NORMAL_95 * self.normal_error)

    @in_double
    def vertex(self) -> VertexEstimates:
        """Estimate the object's lowest point from the points near it, where the force is vertical.

        There x = x0 + radius t + O(t^2) and y = y0 + radius t^2 / 2 + O(t^3), with t = tan(slope). Two more powers are
        fitted. Points are weighted with their covariances; errors are NaN if these are unknown.
        """
        each = [self._vertex(k) for k in range(self.x.shape[1])]
        return VertexEstimates(*(np.array(values) for values in zip(*each, strict=True)))

    def _vertex(self, k: int) -> tuple[float, ...]:
        x, y, slope, base_x = (np.asarray(v)[:, k] for v in (self.x, self.y, self.slope, self.base_x))
        near = (np.abs(np.tan(slope)) < NEAR_VERTEX) & self.clear[:, k]  # False where it is NaN
        t = np.tan(slope[near])
        if t.size < LEAST_POINTS or not t.min() < 0 < t.max():
            return (np.nan,) * len(VertexEstimates._fields)
        spread = np.asarray(self.covariance)[near, k, :3, :3]
        cubic = np.stack([t**0, t, t**2, t**3], axis=1)
        (_, radius, *_), _ = _weighted_fit(x[near], (1.0, 0.0), 0 * t, cubic, spread)
        by_slope = radius * (1 + t**2)  # dx/dslope
        (x0, radius, *_), x_error = _weighted_fit(x[near], (1.0, 0.0), by_slope, cubic, spread)
        quartic = np.stack([t**0, t**2, t**3, t**4], axis=1)
        (y0, *_), y_error = _weighted_fit(y[near], (0.0, 1.0), by_slope * t, quartic, spread)
        (crossing, *_), _ = _weighted_fit(base_x[near], (1.0, 0.0), by_slope, cubic, spread)
        return x0, x_error, y0, y_error, radius, crossing

    @in_double
    def consistency(self) -> Consistency:
        """Compare the points of every other whisker with the contour of whisker 1.

        Near each point, that contour is a cubic fitted to the nearest points of whisker 1, weighted with their errors.
        The noise of two whiskers at the same point of the object is independent, because they pass it at different
        times.
        """
        distance, error = np.full((2, self.x.shape[0], self.x.shape[1] - 1), np.nan)
        for k in range(distance.shape[1]):
            distance[:, k], error[:, k] = self._against_first(k + 1)
        known = np.isfinite(distance) & (error > 0)
        chi2 = float(np.mean((distance[known] / error[known]) ** 2)) if known.any() else np.nan
        return Consistency(distance, error, chi2)

    def _against_first(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Distance of whisker k's points from the contour of whisker 1, (steps,), and its error."""
        x, y, slope = (np.asarray(v) for v in (self.x, self.y, self.slope))
        covariance = np.asarray(self.covariance)[:, :, :2, :2]
        first, here = (np.flatnonzero(self.clear[:, whisker]) for whisker in (0, k))
        distance, error = np.full((2, x.shape[0]), np.nan)
        if first.size < LEAST_POINTS:
            return distance, error
        from_x, from_y = x[first, 0] - x[here, k, None], y[first, 0] - y[here, k, None]
        nearest = np.argpartition(from_x**2 + from_y**2, LEAST_POINTS - 1, axis=1)[:, :LEAST_POINTS]
        from_x, from_y = (np.take_along_axis(v, nearest, axis=1) for v in (from_x, from_y))
        cos, sin = np.cos(slope[here, k, None]), np.sin(slope[here, k, None])
        along, out = from_x * cos + from_y * sin, from_x * sin - from_y * cos
        normal = np.concatenate([sin, -cos], axis=1)
        variance = np.einsum("hi,hnij,hj->hn", normal, covariance[first, 0][nearest], normal)
        own_variance = np.einsum("hi,hij,hj->h", normal, covariance[here, k], normal)
        weight = np.where(variance > 0, 1 / variance, 1.0)
        size = np.maximum(np.abs(along).max(axis=1, keepdims=True), 1e-300)
        columns = (along / size)[:, :, None] ** np.arange(4)
        products = np.sum(weight[:, :, None, None] * columns[..., :, None] * columns[..., None, :], axis=1)
        between = (along.min(axis=1) < 0) & (along.max(axis=1) > 0)
        between &= np.linalg.cond(products) < LARGEST_CONDITION
        inverse = np.linalg.inv(np.where(between[:, None, None], products, np.eye(4)))
        there = np.sum(inverse[:, 0] * np.sum((weight * out)[:, :, None] * columns, axis=1), axis=1)
        distance[here] = np.where(between, -there, np.nan)
        error[here] = np.where(between, np.sqrt(own_variance + inverse[:, 0, 0]), np.nan)
        return distance, error

    def _findings(self):
        vertex, lines = self.vertex(), []
        for k in np.flatnonzero(np.isfinite(vertex.x)):
            x, y = (_with_error(*pair) for pair in ((vertex.x[k], vertex.x_error[k]), (vertex.y[k], vertex.y_error[k])))
            lines.append(f"whisker {k + 1}: vertex at x = {x}, y = {y}")
        return [*lines, *([str(self.consistency())] * (self.x.shape[1] > 1))]


class ContactsReconstruction(AbstractReconstruction):
    """Contacts of whiskers that touch known objects, at most one of them with something else, in the sensor's units.

    Fields of contacts, from the tip to the base, are NaN, and `phase` is Phase.free, in places that are not used and
    where the status is not ok. `chi2` has three degrees of freedom if all contacts are with known objects, otherwise
    one. Contacts with known objects follow from the pose of the base: where there is no other contact, noise does not
    change them, and their errors are those of the parameters only.
    """

    x: Float[Array, "steps whiskers contacts"]
    y: Float[Array, "steps whiskers contacts"]
    arc: Float[Array, "steps whiskers contacts"]
    phase: Int[Array, "steps whiskers contacts"]
    slope: Float[Array, "steps whiskers contacts"]  # alpha of the object at the contact, rad
    force: Float[Array, "steps whiskers contacts"]  # f >= 0
    object: Int[Array, "steps whiskers contacts"]  # number of the known object, from 1; 0: something else, or unused
    base_angle: Float[Array, "steps whiskers"]  # of the whisker there to the upright, rad, counter-clockwise
    covariance: Float[Array, "steps whiskers contacts 4 4"]  # of x, y, slope and arc
    _across = "across the contours"

    @property
    def _normal(self):
        return jnp.stack([jnp.sin(self.slope), -jnp.cos(self.slope)], axis=-1)

    @in_double
    def unknown(self) -> Reconstruction:
        """The contacts with something unknown, such as `fit_profile` takes; whiskers without one are `free`."""
        here = (self.phase != Phase.free) & (self.object == 0)
        some, at = jnp.any(here, axis=-1), jnp.argmax(here, axis=-1)

        def of(values: Array, otherwise: Any = jnp.nan) -> Array:
            index = jnp.expand_dims(at, tuple(range(2, values.ndim)))
            own = jnp.take_along_axis(values, index, axis=2)[:, :, 0]
            return jnp.where(jnp.expand_dims(some, tuple(range(2, own.ndim))), own, otherwise)

        kept = "control", "length", "base_x", "base_y", "base_angle", "chi2", "significance"
        own = "x", "y", "arc", "slope", "force", "covariance"
        fields: dict[str, Any] = {name: getattr(self, name) for name in kept}
        fields |= {name: of(getattr(self, name)) for name in own} | {"phase": of(self.phase, Phase.free)}
        status = jnp.where((self.status == PointStatus.ok) & ~some, PointStatus.free, self.status)
        return Reconstruction(**fields, status=status)

    def _findings(self):
        number = np.sum(np.asarray(self.phase) != Phase.free, axis=-1)
        counted = [f"{np.sum(number == k)} of {k}" for k in range(1, number.max(initial=0) + 1)]
        elsewhere = np.any((np.asarray(self.phase) != Phase.free) & (np.asarray(self.object) == 0), axis=-1)
        lines = [f"numbers of contacts: {', '.join(counted)}"] if counted else []
        return [*lines, *([f"with something unknown: {elsewhere.sum()}"] if elsewhere.any() else [])]


class SpaceReconstruction(AbstractReconstruction):
    """Points of the object in space at every step and for every whisker, in the scene's frame and units.

    Fields are NaN, and `phase` is Phase.free, where the status is not ok; the pose of the base, the significance, and
    the product of force and moment are also known for whiskers whose signals are not missing.

    `chi2` has as many degrees of freedom as there are channels, less three; less four on the shaft with friction.
    """

    z: Float[Array, "steps whiskers"]
    force_x: Float[Array, "steps whiskers"]  # force of the object on the whisker
    force_y: Float[Array, "steps whiskers"]
    force_z: Float[Array, "steps whiskers"]
    tangent: Float[Array, "steps whiskers 3"]  # direction of the whisker at the contact, towards its tip
    base_z: Float[Array, "steps whiskers"]
    base_rotation: Float[Array, "steps whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    # Cosine of the angle between measured force and moment, which are perpendicular for every contact at a point, and
    # their product in standard deviations of its noise; NaN if not all six channels are measured.
    force_moment: Float[Array, "steps whiskers"]
    force_moment_score: Float[Array, "steps whiskers"]
    covariance: Float[Array, "steps whiskers 7 7"]  # of x, y, z, arc, force_x, force_y, force_z
    in_space, _across = True, "along the force"

    @property
    @in_double
    def point(self) -> Float[Array, "steps whiskers 3"]:
        """The contact point (x, y, z)."""
        return jnp.stack([self.x, self.y, self.z], axis=-1)

    @property
    @in_double
    def force(self) -> Float[Array, "steps whiskers 3"]:
        """Force of the object on the whisker."""
        return jnp.stack([self.force_x, self.force_y, self.force_z], axis=-1)

    @property
    @in_double
    def direction(self) -> Float[Array, "steps whiskers 3"]:
        """Direction of that force: without friction, the outward normal of the object."""
        return self.force / jnp.sqrt(jnp.sum(self.force**2, axis=-1, keepdims=True))

    @property
    def _normal(self):
        return self.direction

    def _findings(self):
        score = np.asarray(self.force_moment_score)[np.asarray(self.status) == PointStatus.ok]
        if not np.isfinite(score).any():
            return []
        return [f"force . moment: {np.sqrt(np.nanmean(score**2)):.3g} standard deviations of its noise (rms)"]


def bar_ends(x, y, slope, reach):
    """x and y of the ends of bars across a contour, (2, ...): the outer ends first."""
    x_out, y_out = jnp.sin(slope) * reach, -jnp.cos(slope) * reach
    return jnp.stack([x + x_out, x - x_out]), jnp.stack([y + y_out, y - y_out])


def perpendicular(
    reaction: Float[Any, "*steps whiskers 6"],
    root: Float[Any, "*steps whiskers 6 roots"],
    missing: Bool[Any, "*steps whiskers"],
    xp: Any = jnp,
) -> tuple[Any, Any]:
    """Cosine of the angle between force and moment, and their product in standard deviations of its noise.

    Args:
        reaction: force and moment of each whisker.
        root: of the covariance of their noise: root @ root.T.
        missing: whiskers without a value, whose results are NaN.
        xp: numpy or jax.numpy.
    """
    force, moment = reaction[..., :3], reaction[..., 3:]
    product = xp.sum(force * moment, axis=-1)
    sizes = xp.sum(force**2, axis=-1) * xp.sum(moment**2, axis=-1)
    by_noise = xp.sum(xp.concatenate([moment, force], axis=-1)[..., None] * root, axis=-2)
    variance = xp.sum(by_noise**2, axis=-1)

    def ratio(square):
        known = ~missing & (square > 0)
        return xp.where(known, product / xp.sqrt(xp.where(known, square, 1.0)), xp.nan)

    return ratio(sizes), ratio(variance)


def _weighted_fit(values, direction, by_slope, columns, spread) -> tuple[np.ndarray, float]:
    """Coefficients of a weighted fit to values along a direction, and the standard error of the first coefficient.

    An error of the slope acts like an error of the values: `by_slope` is the polynomial's derivative with respect to
    the slope.
    """
    noisy = bool(np.isfinite(spread).all() and (spread[:, [0, 1, 2], [0, 1, 2]] > 0).all())
    by = np.column_stack([np.tile(direction, (values.size, 1)), -by_slope])
    variance = np.sum(by[:, :, None] * spread * by[:, None, :], axis=(1, 2)) if noisy else np.ones_like(values)
    columns = columns / np.sqrt(variance)[:, None]
    inverse = np.linalg.inv(columns.T @ columns)
    error = np.sqrt(inverse[0, 0]) if noisy else np.nan
    return inverse @ (columns.T @ (values / np.sqrt(variance))), error


def _with_error(value: float, error: float) -> str:
    return f"{value:.6g}" if np.isnan(error) else f"{value:.6g} +- {error:.2g}"
