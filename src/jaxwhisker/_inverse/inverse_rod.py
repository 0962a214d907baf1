"""Inverse problem of one whisker: compute its contact from its support reaction.

The states of a whisker on a base are a family with two parameters, z = (force, beyond). `beyond` is the angle between
whisker and object in tip contact, or the arc beyond the contact in tangential contact; it is >= 0 in both. In each
phase, Gauss-Newton finds the state nearest to the three measured reactions, weighted with their noise. The nearer of
the two states decides the phase. For a uniform straight upright whisker, tangential contact requires mz^2 = 2 EI fy.
With friction, the contact force leans from the object's normal by a known angle, against the slip.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod import rod
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting, rod_end, uneven_rod_end
from jaxwhisker._rod.rod import Section

UNEVEN_STEPS = 12  # Shooting doubles it for rods that are not uniform: an error of 1e-8 for a cone
GAUSS_NEWTON_STEPS = 7  # of Gauss-Newton; 3 without noise
GUESSES = 16  # pieces of the rod that are searched for the zero of the moment
LAST_STEP = 1e-5  # largest last step of a converged iteration, relative for the force, absolute for angle or arc
LARGEST_ANGLE = 3.0  # rad, between whisker and object at the tip
LARGEST_STEP = 0.3  # rad or lengths
START = 0.02  # of the length: least initial arc beyond the contact, because pointed tips overflow
POINTED = 1e-4  # of the length: least distance of a contact from a tip without stiffness


REACTION = slice(4, 7)  # among the values of a state


class Observation(NamedTuple):
    """What the state of a whisker is estimated from; dimensionless."""

    reaction: Float[Array, "3"]
    weight: Float[Array, "3"]  # 1 / standard deviation
    angle: Scalar  # of the base, without the effect of the whisker's own moment
    twist: Scalar  # rotation of the base per moment on it
    side: Scalar  # 1.0 if the object bends the whisker towards +x (mz >= 0), -1.0 towards -x
    length: Scalar
    stiffness: Scalar
    section: Section | None
    lean: Scalar | None = None  # of the contact force: slope of the object minus angle of the force; None: no friction


class Estimate(NamedTuple):
    """The state of a whisker nearest to the observation."""

    z: Float[Array, "2"]
    tip: Bool[Array, ""]
    ok: Bool[Array, ""]  # whether the iteration converged in at least one phase
    chi2: Scalar
    gradient: Float[Array, "3 2"]  # of the whitened residuals
    other: Float[Array, "2"]  # the nearest state in the other phase
    doubt: Scalar  # probability of the other phase


def state(z: Float[Array, "2"], tip: Bool[Array, ""], observed: Observation) -> Float[Array, "8"]:
    """The state with this force and angle (tip contact) or arc beyond the contact (tangential contact).

    Contact point relative to the base, slope of the object there (rad), arc length from base to contact, reaction
    fx, fy, mz, and angle of the base to the upright (rad, counter-clockwise); dimensionless.
    """
    force, beyond = z
    angle, arc = jnp.where(tip, beyond, 0.0) + _turn(observed), observed.length - jnp.where(tip, 0.0, beyond)
    method: AbstractRod = ClosedForm() if observed.section is None else Shooting(steps=UNEVEN_STEPS)
    if observed.section is None:
        end = rod_end(force / observed.stiffness, arc, angle, method, method)
    else:
        section = dataclasses.replace(observed.section, orientation=observed.side)
        end = uneven_rod_end(force, arc, angle, section, method, method)
    x, y, cos, sin = observed.side * end[0], end[1], observed.side * end[2], end[3]
    base_angle = observed.angle + observed.twist * force * x
    up, left = jnp.cos(base_angle), jnp.sin(base_angle)
    # The rod is computed in the frame of the contact force; the direction of its base gives the angle of the force.
    force_cos, force_sin = up * sin - left * cos, up * cos + left * sin
    slope = jnp.arctan2(force_sin, force_cos) + (0.0 if observed.lean is None else observed.lean)
    where = [y * force_sin - x * force_cos, -x * force_sin - y * force_cos, slope, arc]
    reaction = [-force * force_sin, force * force_cos, -force * x]
    return jnp.stack([*where, *reaction, base_angle])


def _turn(observed: Observation) -> Scalar:
    """Angle from the frame of the contact force to that of the object, as the rod is bent."""
    return jnp.zeros(()) if observed.lean is None else observed.side * observed.lean


def nearest_state(observed: Observation) -> Estimate:
    """The state nearest to the observation, in the likelier phase."""
    constant = jax.lax.stop_gradient(observed)
    tips = jnp.array([True, False])
    both, chi2, ok = jax.vmap(lambda start, tip: _fit(start, tip, constant))(_guesses(constant), tips)
    ok &= jnp.isfinite(chi2) & jnp.all(jnp.isfinite(both), axis=1)
    chi2 = jnp.where(ok, chi2, jnp.inf)
    tip = chi2[0] <= chi2[1]
    both = jax.lax.stop_gradient(jnp.where(ok[:, None], both, jnp.array([1.0, 0.1])))
    nearest, other = jnp.where(tip, both, both[::-1])
    z = solution_of(_stationarity, nearest, (tip, observed))
    residual, gradient = value_and_jacobian(lambda z: _whitened(z, tip, observed), z)
    doubt = jnp.where(jnp.all(ok), jax.nn.sigmoid((jnp.min(chi2) - jnp.max(chi2)) / 2), 0.0)
    return Estimate(z, tip, jnp.any(ok), jnp.sum(residual**2), gradient, other, doubt)


class LocatedContact(NamedTuple):
    """The contact of a whisker relative to its base, and its derivatives."""

    values: Float[Array, "*whiskers 8"]  # see `state`
    by_z_angle: Float[Array, "*whiskers 8 3"]  # with respect to z and the angle of the base
    follows: Float[Array, "*whiskers 2 4"]  # of z with respect to the reaction and the angle of the base
    ambiguous: Float[Array, "*whiskers 4 4"]  # covariance that the other phase adds
    near: Estimate


def locate(section: Section | None, lean: Scalar | None, *fields) -> LocatedContact:
    """Locate the contact of one whisker from the other fields of its Observation."""
    observed = Observation(*fields, section, lean)  # pyright: ignore[reportCallIssue]
    near = nearest_state(observed)

    def at(z_angle: Float[Array, "3"], tip: Any = near.tip):
        return state(z_angle[:2], tip, observed._replace(angle=z_angle[2]))

    values, by_z_angle = value_and_jacobian(at, jnp.append(near.z, observed.angle))
    apart = jnp.where(near.doubt > 0, at(jnp.append(near.other, observed.angle), ~near.tip) - values, 0.0)[:4]
    ambiguous = near.doubt * apart[:, None] * apart
    # The Gauss-Newton approximation is exact to first order in the noise.
    by_observed = jnp.concatenate(
        [-jnp.diag(observed.weight), by_z_angle[REACTION, 2:] * observed.weight[:, None]], axis=1
    )
    by_observed = jnp.sum(near.gradient[:, :, None] * by_observed[:, None, :], axis=0)
    follows = -solve2(normal_matrix(near.gradient), by_observed)
    return LocatedContact(values, by_z_angle, follows, ambiguous, near)


def each_whisker(section: Any, function: Callable, *args):
    """Apply a function of section and arguments to every whisker."""
    if not isinstance(section, tuple):
        return jax.vmap(function, in_axes=(None if section is None else 0, *[0] * len(args)))(section, *args)
    each = [function(own, *jax.tree.map(lambda leaf, k=k: leaf[k], args)) for k, own in enumerate(section)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def value_and_jacobian(function: Callable, z):
    """The value of a function and its derivative, in forward mode."""

    def twice(z):
        value = function(z)
        return value, value

    gradient, value = jax.jacfwd(twice, has_aux=True)(z)
    return value, gradient


def normal_matrix(gradient: Float[Array, "3 2"]) -> Float[Array, "2 2"]:
    """The transposed gradient times the gradient."""
    return jnp.sum(gradient[:, :, None] * gradient[:, None, :], axis=0)


def solve2(matrix: Float[Array, "2 2"], right: Float[Array, "2 *k"]) -> Float[Array, "2 *k"]:
    """Solution of two linear equations, in a form that JAX can transpose."""
    (a, b), (c, d) = matrix
    first, second = right
    return jnp.stack([d * first - b * second, a * second - c * first]) / (a * d - b * c)


def _whitened(z, tip, observed: Observation) -> Float[Array, "3"]:
    """Residuals of the three reactions over their noise."""
    return (state(z, tip, observed)[REACTION] - observed.reaction) * observed.weight


def _stationarity(z, known: tuple[Bool[Array, ""], Observation]) -> Float[Array, "2"]:
    """Half the derivative of chi-squared, which vanishes at the nearest state."""
    tip, observed = known
    residual, gradient = value_and_jacobian(lambda z: _whitened(z, tip, observed), z)
    downhill = jnp.sum(gradient * residual[:, None], axis=0)
    # At the border between the phases only the force is free.
    return jnp.where(z[1] > 0, downhill, downhill.at[1].set(z[1]))


def _guesses(observed: Observation):
    """z of tip and of tangential contact, (2, 2): integrate from the base to the zero of the moment."""
    fx, fy, mz = observed.reaction
    angle, zero = observed.angle - observed.twist * mz, jnp.zeros(())
    start = (zero, zero, -jnp.sin(angle), jnp.cos(angle))
    load = rod.Load(-fx, -fy, -mz)
    material = observed.stiffness if observed.section is None else observed.section
    x, y, cos, sin = rod.points(start, -observed.length, load, material, count=GUESSES + 1, from_base=zero)
    moment = -rod.moment(x, y, load) * jnp.where(mz < 0, -1.0, 1.0)
    passed = ~(moment > 0)  # True for NaN: thin tips overflow where the moment does not vanish
    last = jnp.where(jnp.any(passed[1:]), jnp.argmax(passed[1:]), GUESSES - 1)
    here, there = moment[last], moment[last + 1]
    share = jnp.where(there <= 0, here / jnp.where(there <= 0, here - there, 1.0), 1.0)
    arc = observed.length * (last + jnp.clip(share, 0.0, 1.0)) / GUESSES
    end = jnp.where(jnp.isfinite(cos[last + 1]) & (share > 0.5), last + 1, last)
    force = jnp.sqrt(fx**2 + fy**2)
    slope_cos, slope_sin = fy / force, -fx / force
    across, along = sin[end] * slope_cos - cos[end] * slope_sin, cos[end] * slope_cos + sin[end] * slope_sin
    theta = jnp.clip(jnp.arctan2(across, observed.side * along) - _turn(observed), 0.0, LARGEST_ANGLE)
    beyond = jnp.clip(observed.length - arc, START * observed.length, 0.9 * observed.length)
    return jnp.stack([jnp.stack([force, theta]), jnp.stack([force, beyond])])


def _fit(start, tip, observed: Observation):
    """The z of least chi-squared in one phase, chi-squared, and whether the iteration converged; no derivatives."""
    largest = jnp.where(tip, LARGEST_ANGLE, 0.999 * observed.length)
    pointed = jnp.asarray(False) if observed.section is None else ~(observed.section.stiffness(observed.length) > 0)
    least = jnp.where(pointed & ~tip, POINTED * observed.length, 0.0)

    def step(_, carry):
        force, beyond = carry[0]
        residual, gradient = value_and_jacobian(lambda z: _whitened(z, tip, observed), carry[0])
        normal, downhill = normal_matrix(gradient), jnp.sum(gradient * residual[:, None], axis=0)
        _, increment = solve2(normal, -downhill)
        bounded = jnp.clip(beyond + jnp.clip(increment, -LARGEST_STEP, LARGEST_STEP), least, largest)
        change = -(downhill[0] + normal[0, 1] * (bounded - beyond)) / normal[0, 0]
        change = jnp.clip(change, -0.7 * force, 2.0 * force)
        size = jnp.maximum(jnp.abs(change) / force, jnp.abs(bounded - beyond))
        return jnp.stack([force + change, bounded]), size

    z, size = jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, step, (start, jnp.zeros(())))
    return z, jnp.sum(_whitened(z, tip, observed) ** 2), size < LAST_STEP
