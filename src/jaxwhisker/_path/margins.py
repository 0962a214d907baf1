"""Margins: distances of contacts from events, and which event comes first within a step.

A margin is positive before its event and negative beyond. Those of one kind of event are an array: of all whiskers, of
all objects and whiskers, or of the drive, with one element.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.interpolation import Cubic
from jaxwhisker._base.types import Scalar

FAR = jnp.inf  # margin of an event that cannot happen

Margins = tuple[Float[Array, "..."], ...]  # in the order of the kinds of events
Ignored = Sequence[Bool[Array, "..."]]  # like margins


class Crossed(NamedTuple):
    """The first margin that is negative at the end of a step."""

    some: Bool[Array, ""]  # whether there is one
    share: Scalar  # of the step, at which it vanishes if margins change linearly
    number: Int[Array, ""]  # of the kind of event
    entry: Int[Array, ""]  # among all margins
    whiskers: Bool[Array, " whiskers"]  # one-hot; all False for the drive


def flat(margins: Margins) -> Float[Array, " margins"]:
    """All margins in one array."""
    return jnp.concatenate([jnp.ravel(margin) for margin in margins])


def first_dip(
    here: Margins, there: Margins, leaving: Margins, arriving: Margins, length: Scalar, noise: float
) -> tuple[Bool[Array, ""], Scalar]:
    """Whether a margin is negative within a step but not at its ends, and the share of the step where to look for it.

    Args:
        here: margins at the start of the step.
        there: margins at its end.
        leaving: rates of the margins along the path at the start.
        arriving: rates at the end, per length of the step as at its start.
        length: of the step.
        noise: accuracy of margins.
    """
    cubic = Cubic(flat(here), flat(there), length * flat(leaving), length * flat(arriving))
    # The margin of an event just passed is zero at the start; rounding must not count as a dip.
    share = cubic.valley()
    dips = (share < 1) & jnp.isfinite(cubic.start) & (cubic.value(share) < -noise)
    return jnp.any(dips), jnp.min(jnp.where(dips, share, 1.0))


def first_crossed(
    here: Margins, there: Margins, noise: float, whiskers: int, of_drive: Sequence[int], ignored: Ignored | None = None
) -> Crossed:
    """The first margin that is crossed between two points of the path.

    Args:
        here: margins at the start of a step.
        there: margins at its end.
        noise: accuracy of margins.
        whiskers: number of whiskers.
        of_drive: numbers of the kinds of events that concern no whisker.
        ignored: margins that do not count.
    """
    now, then = flat(here), flat(there)
    crossed = then < -noise
    if ignored is not None:
        crossed &= ~jnp.concatenate([jnp.ravel(one) for one in ignored])
    # A whisker that was out of reach may touch anywhere within the step.
    share = jnp.where(jnp.isfinite(now), jnp.clip(now / (now - then), 0.0, 1.0), 0.5)
    share = jnp.where(crossed, share, jnp.inf)
    first = jnp.argmin(share)
    number = jnp.asarray(np.repeat(np.arange(len(here)), [margin.size for margin in here]))[first]
    # Margins of touches run over all objects, and over all whiskers for each.
    each = [np.tile(np.eye(whiskers, dtype=bool), (1 + m.size // whiskers, 1))[: m.size] for m in here]
    concerned = np.concatenate([of & (k not in of_drive) for k, of in enumerate(each)])
    return Crossed(jnp.any(crossed), jnp.min(share), number, first, jnp.asarray(concerned)[first])
