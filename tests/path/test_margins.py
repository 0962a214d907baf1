"""Margins: which event comes first within a step, and margins that vanish twice within it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._path.margins import FAR, first_crossed, first_dip

NOISE = 1e-12
ROUNDING = 1e-12
DRIVE = 1  # the second kind of margin concerns the drive


def crossed(there, here=((1.0, 1.0), (1.0,), (1.0, FAR)), ignored=None):
    """The first margin of two whiskers that is crossed; the second kind is that of the drive."""
    here, there = (tuple(map(jnp.array, margins)) for margins in (here, there))
    return first_crossed(here, there, NOISE, 2, (DRIVE,), ignored)


@pytest.mark.parametrize(
    ("there", "number", "whiskers", "share"),
    [
        (((-1.0, 1.0), (1.0,), (1.0, FAR)), 0, [True, False], 0.5),
        (((1.0, -3.0), (1.0,), (-1.0, FAR)), 0, [False, True], 0.25),
        (((1.0, 1.0), (-4.0,), (-1.0, FAR)), 1, [False, False], 0.2),
        (((1.0, 1.0), (1.0,), (1.0, -2.0)), 2, [False, True], 0.5),  # out of reach before: anywhere within the step
    ],
)
def test_margins_vanish_where_they_would_if_they_were_linear(there, number, whiskers, share):
    found = crossed(there)
    assert found.some and found.number == number and found.whiskers.tolist() == whiskers
    np.testing.assert_allclose(found.share, share, rtol=ROUNDING)


def test_margins_that_are_ignored_or_vanish_by_rounding_are_not_crossed():
    there = (1.0, -NOISE / 2), (1.0,), (-1.0, FAR)
    assert crossed(there).number == 2
    ignored = [jnp.zeros(2, bool), jnp.zeros(1, bool), jnp.ones(2, bool)]
    assert not crossed(there, ignored=ignored).some


@pytest.mark.parametrize(("lowest", "dips"), [(-1e-3, True), (1e-3, False)])
def test_a_margin_may_vanish_twice_within_a_step(lowest, dips):
    """The cubic that falls to its least value after a third of the step."""

    def margin(s):
        return lowest + (s - 1 / 3) ** 2 * (1 + s)

    def rate(s):
        return 2 * (s - 1 / 3) * (1 + s) + (s - 1 / 3) ** 2

    length = 0.1
    here, there = ((jnp.array([margin(s), FAR]),) for s in (0.0, 1.0))
    leaving, arriving = ((jnp.array([rate(s) / length, 0.0]),) for s in (0.0, 1.0))
    found, share = first_dip(here, there, leaving, arriving, jnp.asarray(length), NOISE)
    assert bool(found) == dips
    np.testing.assert_allclose(share, 1 / 3 if dips else 1.0, rtol=1e-9)
