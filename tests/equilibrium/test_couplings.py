"""Springs between two shafts: loads from their energy, and the linearised equations against differences."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import couplings
from jaxwhisker._equilibrium.couplings import Coupled, Couplings, End
from jaxwhisker._equilibrium.shaft_springs import AXIAL, Attachments, ShaftSprings

ROUNDING = 1e-13
DIFFERENCE = 1e-8  # of central differences with this step
STEP = 1e-6

WHISKERS, PLACES = 3, 4
STIFFNESS, REST = np.array([3.0, 5.0, 0.7, 2.0]), np.array([0.2, -0.1, 0.3, 0.9])
AXES = np.array([0, 1, 2, AXIAL])
FIRST = End(jnp.array([0, 0, 1, 0]), jnp.array([1, 2, 0, 3]))
SECOND = End(jnp.array([1, 1, 2, 2]), jnp.array([2, 1, 1, 3]))
RANDOM = np.random.default_rng(11)
ANCHORS = RANDOM.uniform(-0.5, 0.5, (3, WHISKERS, PLACES))
AT = RANDOM.uniform(-0.5, 1.5, (WHISKERS, PLACES, 3))


def springs(shape, stiffness: Any = 0.0, rest: Any = 0.0, axis: Any = 0, anchors: Any = (0.0, 0.0, 0.0)):
    """Springs that are linear and pull and push."""
    numbers = (0.0, *anchors, stiffness, rest, axis, 0.0, 0, 1.0)
    filled = (jnp.asarray(np.broadcast_to(number, shape)) for number in numbers)
    return ShaftSprings(*filled)


# Three loads in the contacts of the whisker at the second end; the last whisker has those of two springs.
COLUMNS = jnp.asarray(np.array([12, 15, 21, 24])[:, None] + np.arange(3))
COUPLINGS = Couplings(springs(4, STIFFNESS, REST, AXES), FIRST, SECOND, COLUMNS)
HELD_BY = Attachments(springs((WHISKERS, PLACES), anchors=ANCHORS))

law = Program(lambda places: couplings.law_of(COUPLINGS, (), HELD_BY, places))


def lengths(places):
    """Lengths of the springs: coordinates from the anchors, or the distance of the ends."""
    (first, second), anchors = (FIRST, SECOND), np.moveaxis(ANCHORS, 0, -1)
    apart = places[second.whisker, second.place] - places[first.whisker, first.place]
    rest = anchors[second.whisker, second.place] - anchors[first.whisker, first.place]
    return np.append(np.diagonal(apart - rest), np.hypot(*apart[3, :2]))


def energy(places):
    return np.sum(STIFFNESS * (lengths(places) - REST) ** 2) / 2


def test_springs_are_as_long_as_their_ends_are_apart():
    found = Program(lambda places: couplings.length_between(COUPLINGS, HELD_BY, places))(jnp.asarray(AT))
    np.testing.assert_allclose(found, lengths(AT), atol=ROUNDING)


def test_loads_are_slopes_of_the_energy():
    found = law(jnp.asarray(AT)).load
    for k in range(4):
        for end, sign in ((SECOND, -1.0), (FIRST, 1.0)):
            expected = []
            for axis in range(3):
                moved = np.zeros_like(AT)
                moved[end.whisker[k], end.place[k], axis] = STEP
                expected.append(sign * (energy(AT + moved) - energy(AT - moved)) / (2 * STEP))
            np.testing.assert_allclose(found[k], expected, atol=DIFFERENCE)


@Program
def sorted_out(z):
    """Loads in contacts, the same as contacts, at the places of all whiskers, by incidence, and of one whisker."""
    loads = couplings.loads_in(COUPLINGS, z)
    back, given = couplings.as_contacts(COUPLINGS, loads, z), couplings.given_by(COUPLINGS, z, HELD_BY)
    incidence = couplings.incidence_of(COUPLINGS, HELD_BY)
    return loads, back, given, incidence, couplings.moved(incidence[1], jnp.ravel(loads))


def test_loads_and_their_places_in_the_contacts():
    # Contacts of 9 numbers: force, parameter, slack, and the loads of up to two springs.
    z = RANDOM.normal(size=(WHISKERS, 9))
    loads, back, given, incidence, moved = sorted_out(jnp.asarray(z))
    np.testing.assert_array_equal(loads, [z[1, 3:6], z[1, 6:9], z[2, 3:6], z[2, 6:9]])
    np.testing.assert_array_equal(back, z * np.outer([0, 1, 1], np.arange(9) > 2))
    expected = np.zeros((WHISKERS, PLACES, 3))
    for load, whisker, place, other, there in zip(loads, *SECOND, *FIRST, strict=True):
        expected[whisker, place] += load
        expected[other, there] -= load
    np.testing.assert_array_equal(given, expected)
    np.testing.assert_allclose(np.einsum("wps,sk->wpk", incidence, loads), expected, atol=ROUNDING)
    np.testing.assert_allclose(moved, expected[1], atol=ROUNDING)


@pytest.fixture(scope="module")
def coupled():
    """Whiskers whose places depend on steps, control and loads."""
    axes, loads = 2, 12

    def random(*shape):
        return jnp.asarray(RANDOM.normal(size=shape))

    by_loads = random(WHISKERS, PLACES, 3, loads)
    none = jnp.zeros((WHISKERS, axes, loads))
    by_steps, by_u = random(WHISKERS, PLACES, 3, axes), random(WHISKERS, PLACES, 3)
    return Coupled(jnp.asarray(AT), by_steps, by_u, by_loads, none, none)


def test_rows_are_the_derivatives_of_load_minus_law(coupled):
    found = Program(lambda at: couplings.rows(COUPLINGS, (), HELD_BY, at))(coupled)
    np.testing.assert_allclose(found.law, law(coupled.places).load, atol=ROUNDING)

    def residual(steps, loads, u):
        places = coupled.places + np.einsum("wpka,wa->wpk", coupled.places_by, steps)
        places = places + np.einsum("wpkl,l->wpk", coupled.places_by_loads, loads) + u * coupled.places_by_u
        return loads - np.ravel(law(jnp.asarray(places)).load)

    at = np.zeros((WHISKERS, 2)), np.zeros(12), np.zeros(())
    for number, expected in enumerate((found.by_steps, found.by_loads, found.by_u)):
        size = at[number].size
        slopes = []
        for k in range(size):
            ends = []
            for step in (STEP, -STEP):
                moved = [np.array(part) for part in at]
                moved[number].reshape(-1)[k] = step
                ends.append(residual(*moved))
            slopes.append((ends[0] - ends[1]) / (2 * STEP))
        np.testing.assert_allclose(np.reshape(expected, (12, size)), np.array(slopes).T, atol=10 * DIFFERENCE)


def test_a_spring_whose_place_is_unknown_fails_alone():
    places = jnp.asarray(AT).at[FIRST.whisker[0], FIRST.place[0]].set(jnp.nan)
    finite = jax.tree.map(lambda leaf: np.isfinite(leaf).reshape(4, -1).all(axis=1).tolist(), law(places))
    assert finite.load == [False, True, True, True] and finite.by_second[1:] == [True] * 3
