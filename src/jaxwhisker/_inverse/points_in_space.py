"""The result of a reconstruction in space: points of the object and their uncertainty."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.settings import in_double
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.points import SIGNIFICANT, PointStatus


class SpaceStep(eqx.Module):
    """Contacts of the whiskers in the scene's frame and units.

    Fields are NaN, and `phase` is Phase.free, where the status is not ok; the pose of the base, the significance, and
    the product of force and moment are also known for whiskers whose signals are not missing.
    """

    x: Float[Array, "*steps whiskers"]  # contact: a point of the object
    y: Float[Array, "*steps whiskers"]
    z: Float[Array, "*steps whiskers"]
    arc: Float[Array, "*steps whiskers"]  # arc length from base to contact
    force_x: Float[Array, "*steps whiskers"]  # force of the object on the whisker
    force_y: Float[Array, "*steps whiskers"]
    force_z: Float[Array, "*steps whiskers"]
    tangent: Float[Array, "*steps whiskers 3"]  # direction of the whisker at the contact, towards its tip
    phase: Int[Array, "*steps whiskers"]  # Phase.free, .tip, .tangential (on the shaft)
    base_x: Float[Array, "*steps whiskers"]
    base_y: Float[Array, "*steps whiskers"]
    base_z: Float[Array, "*steps whiskers"]
    base_rotation: Float[Array, "*steps whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    chi2: Float[Array, "*steps whiskers"]  # chi-squared of the nearest state: see SpaceReconstruction
    significance: Float[Array, "*steps whiskers"]  # of the signals, in standard deviations of their noise
    # Cosine of the angle between measured force and moment, which are perpendicular for every contact at a point, and
    # their product in standard deviations of its noise; NaN if not all six channels are measured.
    force_moment: Float[Array, "*steps whiskers"]
    force_moment_score: Float[Array, "*steps whiskers"]
    status: Int[Array, "*steps whiskers"]  # PointStatus
    covariance: Float[Array, "*steps whiskers 7 7"]  # of x, y, z, arc, force_x, force_y, force_z


class SpaceReconstruction(SpaceStep):
    """Points of the object in space at every step and for every whisker, with their uncertainty.

    Errors are of first order in the noise of all reactions at a step, and in the errors of the sensor's parameters if
    their covariance was given. Where both phases are possible, the difference between them is added. Errors are NaN if
    neither the noise nor that covariance is known.

    `chi2` has as many degrees of freedom as there are channels, less three; less four on the shaft with friction.
    """

    control: Float[Array, " steps"]
    length: Float[Array, ""]  # of the first whisker
    in_space = True

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
    @in_double
    def standard_error(self) -> Float[Array, "steps whiskers 7"]:
        """Standard errors of x, y, z, arc, force_x, force_y and force_z."""
        return jnp.sqrt(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    @in_double
    def normal_error(self) -> Float[Array, "steps whiskers"]:
        """Standard error of the position along the contact force, a length."""
        return jnp.sqrt(jnp.einsum("...i,...ij,...j", self.direction, self.covariance[..., :3, :3], self.direction))

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
            lines.append(f"standard error along the force: {np.nanmedian(error):.3g} (median)")
        score = np.asarray(self.force_moment_score)[status == PointStatus.ok]
        if np.isfinite(score).any():
            lines.append(f"force . moment: {np.sqrt(np.nanmean(score**2)):.3g} standard deviations of its noise (rms)")
        return "\n".join(lines)

    __repr__ = __str__


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
