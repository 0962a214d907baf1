"""One whisker from its support reaction back to its contact.

The states that a whisker on a base can be in are a family of two parameters, z = (force, beyond), where beyond is the
angle between whisker and object in tip contact or the arc beyond the contact in tangential contact, and >= 0 in both.
Of either the state nearest to the three measured reactions is found, weighted with their noise; the nearer of the two
is the phase. Of a uniform straight upright whisker in tangential contact that asks for mz^2 = 2 EI fy.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.implicit import without_rule
from jaxwhisker._rod import rod
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting, rod_end, uneven_rod_end
from jaxwhisker._rod.rod import Section

UNEVEN_STEPS = 12  # Shooting takes twice as many of rods that are not uniform: 1e-8 of a cone
ITERATIONS = 7  # of Gauss-Newton; 3 without noise
GUESSES = 16  # pieces of the rod, in which the vanishing moment is looked for
SETTLED = 1e-5  # largest last step, relative to the force, and of angle or arc
LARGEST_ANGLE = 3.0  # rad, between whisker and object at the tip
LARGEST_STEP = 0.3  # rad or lengths
START = 0.02  # least arc beyond the contact to start from, of the length: pointed tips bend out of numbers
POINTED = 1e-4  # at which share of the length from a tip without stiffness a contact is looked for at most


class Told(NamedTuple):
    """What the state of a whisker is found from; dimensionless."""

    reaction: Float[Array, "3"]
    weight: Float[Array, "3"]  # 1 / standard deviation
    angle: Scalar  # of the base, without the whisker's own moment
    twist: Scalar  # how the base turns with that moment
    side: Scalar  # 1.0 if the whisker bends to the right of the object, -1.0 to the left
    length: Scalar
    stiffness: Scalar
    section: Section | None


class Contact(NamedTuple):
    """A state of a whisker, seen from its base."""

    x: Scalar
    y: Scalar
    slope: Scalar
    arc: Scalar
    reaction: Float[Array, "3"]
    angle: Scalar  # of the base


def state(z: Float[Array, "2"], tip: Bool[Array, ""], told: Told) -> Contact:
    """The state with that force and angle (tip contact) or arc beyond the contact."""
    force, beyond = z
    angle, arc = jnp.where(tip, beyond, 0.0), told.length - jnp.where(tip, 0.0, beyond)
    method: AbstractRod = ClosedForm() if told.section is None else Shooting(steps=UNEVEN_STEPS)
    if told.section is None:
        end = rod_end(force / told.stiffness, arc, angle, method, method)
    else:
        section = dataclasses.replace(told.section, orientation=told.side)
        end = uneven_rod_end(force, arc, angle, section, method, method)
    x, y, cos, sin = told.side * end[0], end[1], told.side * end[2], end[3]
    turned = told.angle + told.twist * force * x
    up, left = jnp.cos(turned), jnp.sin(turned)
    # The rod's end, turned to where the base points, tells how the object is turned.
    slope_cos, slope_sin = up * sin - left * cos, up * cos + left * sin
    return Contact(
        x=y * slope_sin - x * slope_cos,
        y=-x * slope_sin - y * slope_cos,
        slope=jnp.arctan2(slope_sin, slope_cos),
        arc=arc,
        reaction=jnp.stack([-force * slope_sin, force * slope_cos, -force * x]),
        angle=turned,
    )


def misfit(z, tip, told: Told) -> Float[Array, "3"]:
    return (state(z, tip, told).reaction - told.reaction) * told.weight


def with_gradient(function: Callable, z):
    def twice(z):
        value = function(z)
        return value, value

    gradient, value = jax.jacfwd(twice, has_aux=True)(z)
    return value, gradient


def normal_of(gradient: Float[Array, "3 2"]):
    return jnp.sum(gradient[:, :, None] * gradient[:, None, :], axis=0)


def solve2(matrix: Float[Array, "2 2"], right: Float[Array, "2 *k"]) -> Float[Array, "2 *k"]:
    (a, b), (c, d) = matrix
    first, second = right
    return jnp.stack([d * first - b * second, a * second - c * first]) / (a * d - b * c)


def _downhill(z, tip, told: Told) -> Float[Array, "2"]:
    """What vanishes where the misfit is least."""
    missed, gradient = with_gradient(lambda z: misfit(z, tip, told), z)
    return jnp.sum(gradient * missed[:, None], axis=0)


@eqx.filter_custom_jvp
def _solved(z, tip, told: Told):
    """The z of least misfit, with its derivatives by all that is told."""
    return without_rule(z, (told,))


@_solved.def_jvp
def _(primals, tangents):
    z, tip, told = primals
    here = _solved(z, tip, told)
    curved = jax.jacfwd(lambda z: _downhill(z, tip, told))(here)
    _, change = eqx.filter_jvp(lambda told: _downhill(here, tip, told), (told,), (tangents[2],))
    free = solve2(curved, change)
    # At the border of the phases only the force is left.
    held = jnp.stack([change[0] / curved[0, 0], jnp.zeros_like(change[1])])
    return here, -jnp.where(here[1] > 0, free, held)


def _guess(told: Told):
    """z of tip and of tangential contact, (2, 2): from the base outwards to where the moment vanishes."""
    fx, fy, mz = told.reaction
    angle, none = told.angle - told.twist * mz, jnp.zeros(())
    start = (none, none, -jnp.sin(angle), jnp.cos(angle))
    load, material = rod.Load(-fx, -fy, -mz), told.stiffness if told.section is None else told.section
    x, y, cos, sin = rod.points(start, -told.length, load, material, count=GUESSES + 1, from_base=none)
    bent = -rod.moment(x, y, load) * jnp.where(mz < 0, -1.0, 1.0)
    over = ~(bent > 0)  # thin tips bend out of numbers where the moment does not vanish
    last = jnp.where(jnp.any(over[1:]), jnp.argmax(over[1:]), GUESSES - 1)
    here, there = bent[last], bent[last + 1]
    share = jnp.where(there <= 0, here / jnp.where(there <= 0, here - there, 1.0), 1.0)
    arc = told.length * (last + jnp.clip(share, 0.0, 1.0)) / GUESSES
    end = jnp.where(jnp.isfinite(cos[last + 1]) & (share > 0.5), last + 1, last)
    force = jnp.sqrt(fx**2 + fy**2)
    slope_cos, slope_sin = fy / force, -fx / force
    across, along = sin[end] * slope_cos - cos[end] * slope_sin, cos[end] * slope_cos + sin[end] * slope_sin
    theta = jnp.arctan2(across, told.side * along)
    theta = jnp.clip(theta, 0.0, LARGEST_ANGLE)
    beyond = jnp.clip(told.length - arc, START * told.length, 0.9 * told.length)
    return jnp.stack([jnp.stack([force, theta]), jnp.stack([force, beyond])])


def _fit(start, tip, told: Told):
    """The z of least misfit, chi^2 and whether it was found; no derivatives."""
    largest = jnp.where(tip, LARGEST_ANGLE, 0.999 * told.length)
    pointed = jnp.asarray(False) if told.section is None else ~(told.section.stiffness(told.length) > 0)
    least = jnp.where(pointed & ~tip, POINTED * told.length, 0.0)

    def step(_, carry):
        (force, beyond), *_ = carry
        z = jnp.stack([force, beyond])
        missed, gradient = with_gradient(lambda z: misfit(z, tip, told), z)
        normal, downhill = normal_of(gradient), jnp.sum(gradient * missed[:, None], axis=0)
        _, wanted = solve2(normal, -downhill)
        wanted = jnp.clip(beyond + jnp.clip(wanted, -LARGEST_STEP, LARGEST_STEP), least, largest)
        change = -(downhill[0] + normal[0, 1] * (wanted - beyond)) / normal[0, 0]
        change = jnp.clip(change, -0.7 * force, 2.0 * force)
        size = jnp.maximum(jnp.abs(change) / force, jnp.abs(wanted - beyond))
        return jnp.stack([force + change, wanted]), size

    z, size = jax.lax.fori_loop(0, ITERATIONS, step, (start, jnp.zeros(())))
    return z, jnp.sum(misfit(z, tip, told) ** 2), size < SETTLED


class Found(NamedTuple):
    """The state of a whisker that is nearest to what was measured."""

    z: Float[Array, "2"]
    tip: Bool[Array, ""]
    good: Bool[Array, ""]  # whether there is one
    chi2: Scalar
    gradient: Float[Array, "3 2"]  # of the weighted misfit
    other: Float[Array, "2"]  # the nearest state in the other phase
    doubt: Scalar  # the probability of that


def found(told: Told) -> Found:
    """The nearest state, of either phase."""
    still = jax.lax.stop_gradient(told)
    tips = jnp.array([True, False])
    both, chi2, good = jax.vmap(lambda start, tip: _fit(start, tip, still))(_guess(still), tips)
    good &= jnp.isfinite(chi2) & jnp.all(jnp.isfinite(both), axis=1)
    chi2 = jnp.where(good, chi2, jnp.inf)
    tip = chi2[0] <= chi2[1]
    both = jax.lax.stop_gradient(jnp.where(good[:, None], both, jnp.array([1.0, 0.1])))
    nearest, other = jnp.where(tip, both, both[::-1])
    z = _solved(nearest, tip, told)
    missed, gradient = with_gradient(lambda z: misfit(z, tip, told), z)
    doubt = jnp.where(jnp.all(good), jax.nn.sigmoid((jnp.min(chi2) - jnp.max(chi2)) / 2), 0.0)
    return Found(z, tip, jnp.any(good), jnp.sum(missed**2), gradient, other, doubt)
