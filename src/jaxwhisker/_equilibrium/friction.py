"""Coulomb friction: the slip of a contact along the object, and the direction of its force.

With the friction coefficient mu = tan(rho), the contact force leans away from the normal, against the slip, by at most
rho. Its direction is (sin psi, -cos psi) with psi = alpha - lean, where the lean is

    slip * rho    while the whisker slips along the object towards +x (slip = +1) or -x (slip = -1),
    unknown       in [-rho, rho] while it sticks (slip = 0).

The arc length along the object minus side times that along the whisker changes by the distance slipped. While a contact
sticks, it is constant: the tip stays at a fixed point of the object, and a tangential contact rolls. The unknown lean
then takes the place of the profile's parameter among the unknowns of the contact.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.profile import AbstractProfile


class Friction(NamedTuple):
    """Slip of each whisker's contact, and where it began to stick."""

    slip: Int[Array, "*batch"]  # direction of slip: +1 towards +x, -1 towards -x, 0 if it sticks; never 0 if free
    parameter: Float[Array, "*batch"]  # of the profile where the contact began to stick
    beyond: Float[Array, "*batch"]  # arc length of the whisker beyond the contact, there


def slipping_from(side: Float[Array, "*batch"]) -> Friction:
    """The friction of contacts that have just begun: pressed on, whiskers slip towards the vertex of the object."""
    # A straight whisker has no rate of slip at first touch. Other slips follow from their rates (slips.py).
    none = jnp.zeros_like(side)
    return Friction(jnp.where(side > 0, -1, 1), none, none)


def newly_slipping(
    friction: Friction | None, which: Bool[Array, "*batch"], side: Float[Array, "*batch"]
) -> Friction | None:
    """The friction after the contacts of these whiskers have begun or ended."""
    if friction is None:
        return None
    return friction._replace(slip=jnp.where(which, slipping_from(side).slip, friction.slip))


LIGHT = 1e-6  # EI/L^2: smallest force of a contact that sticks: the lean of no force is unknown
CELLS = 16  # of the quadrature of the arc length's derivatives by the object's numbers
_AT, _WEIGHTS = gauss(3)
POINTS, WEIGHTS = ((np.arange(CELLS)[:, None] + _AT) / CELLS).ravel(), np.tile(_WEIGHTS / CELLS, CELLS)
_COARSE, _FINE = gauss(8), gauss(12)  # rules for the arc length of a stretch, which agree where they are exact
PLACES = np.concatenate([_COARSE[0], _FINE[0], [1.0]])
ARC = np.concatenate([np.zeros(8), _FINE[1], [0.0]])
DIFFERENCE = np.concatenate([_COARSE[1], -_FINE[1], [0.0]])
SAME = 1e-9  # relative difference of both rules; the error of the finer one is about its power 3/2
NEAR = 1e-8  # of the arc length and the parameter: a step of Newton's method that is the last one
ROUNDING = 1e-15  # of arc lengths
ITERATIONS = 8  # of Newton's method, after which a shorter stretch is tried: a sharp end of the object may be near
SHORTEST_SHARE = 1e-9  # of the distance; if no longer stretch has been followed, the object is not smooth


@eqx.filter_custom_jvp
def rolled(profile: AbstractProfile, start: Scalar, distance: Scalar) -> Float[Array, ""]:
    """The parameter at an arc length from another parameter. A distance of zero costs nothing, also in a batch."""

    def iteration(carry):
        at, share, begin, end, count = carry
        there = jnp.minimum(at + share, 1.0)
        speeds = jnp.asarray(jax.vmap(profile.speed)(begin + PLACES * (end - begin)))
        arc = (there - at) * distance
        missing = arc - (end - begin) * jnp.sum(ARC * speeds)
        error = (end - begin) * jnp.sum(DIFFERENCE * speeds)
        correction = missing / speeds[-1]
        solved = (jnp.abs(missing) < NEAR * jnp.abs(arc) + ROUNDING) & (jnp.abs(correction) < NEAR)
        good = solved & (jnp.abs(error) < SAME * jnp.abs(arc) + ROUNDING)
        fails = ~good & (solved | ~jnp.isfinite(correction) | (count == ITERATIONS))
        end = jnp.where(fails, begin, end + correction)
        return (
            jnp.where(good, there, at),
            jnp.where(good, 2 * share, jnp.where(fails, share / 2, share)),
            jnp.where(good, end, begin),
            end,
            jnp.where(good | fails, 0, count + 1),
        )

    def goes_on(carry):
        at, share, *_ = carry
        return (at < 1) & (share > SHORTEST_SHARE)

    at, start = jnp.where(distance == 0, 1.0, 0.0), jnp.asarray(start, dtype=float)
    begins = at, jnp.asarray(1.0), start, start, jnp.asarray(0)
    at, _, stop, _, _ = jax.lax.while_loop(goes_on, iteration, begins)
    return jnp.where(at < 1, jnp.nan, stop)


@rolled.def_jvp
def _(primals, tangents):
    profile, start, distance = primals
    profile_dot, start_dot, distance_dot = tangents
    stop = rolled(profile, start, distance)

    def length(profile):
        """Arc length from start to stop; only its derivative by the numbers of the profile is used."""
        speeds = jax.vmap(lambda share: profile.speed(start + share * (stop - start)))(POINTS)
        return (stop - start) * jnp.sum(WEIGHTS * speeds)

    longer = eqx.filter_jvp(length, (profile,), (profile_dot,))[1]
    rate = sum(dot for dot in (distance_dot, None if longer is None else -longer) if dot is not None)
    if start_dot is not None:
        rate += profile.speed(start) * start_dot
    return stop, jnp.zeros_like(stop) + rate / profile.speed(stop)


def contact_parameter(
    profile: AbstractProfile, known: Scalar, beyond: Scalar, side: Scalar, friction: Friction
) -> Float[Array, ""]:
    """The profile's parameter at a contact.

    Args:
        profile: the object.
        known: the contact's second unknown: the parameter, or the lean if the contact sticks.
        beyond: arc length of the whisker beyond the contact.
        side: side from which the whisker approached.
        friction: of this contact.
    """
    sticks = friction.slip == 0
    rolling = rolled(profile, friction.parameter, jnp.where(sticks, side * (friction.beyond - beyond), 0.0))
    return jnp.where(sticks, rolling, known)


def lean(
    known: Float[Array, "*batch"], friction: Friction | None, friction_angle: Scalar | None
) -> Float[Array, "*batch"] | None:
    """Angle from the object's normal to the contact force; None without friction."""
    if friction is None or friction_angle is None:
        return None
    return jnp.where(friction.slip == 0, known, friction.slip * friction_angle)
