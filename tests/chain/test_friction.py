"""Friction of several contacts: rates of slip, leans, and which contacts stick after a snap."""

# pyright: reportArgumentType=false, reportOptionalMemberAccess=false, reportOptionalSubscript=false
# pyright: reportCallIssue=false
from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._chain.changes import changed_contacts
from jaxwhisker._chain.contacts import ChainState, chain_of, held_of, lean_of, parameter_of, slack_of
from jaxwhisker._chain.continuation import ContinuationOfChain
from jaxwhisker._chain.friction import (
    NEAR,
    is_light,
    is_wedged,
    keeps_places,
    landed,
    lean_margin,
    slip_by_contact,
    slip_rates,
    with_slips,
)
from jaxwhisker._chain.landing import loosened
from jaxwhisker._chain.march_state import HIGH
from jaxwhisker._chain.newton import of_whiskers
from jaxwhisker._chain.polygons import corner_signs
from jaxwhisker._equilibrium.contact import of_each
from jaxwhisker._equilibrium.friction import LIGHT, Friction
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.continuation import Limits
from jaxwhisker._scan.chain import problem_now

MU = 0.4
EXACT = 1e-12  # rounding, of the rolling of contacts too
STEP = 1e-6  # of differences
SLOPES = 1e-8  # errors of such differences


@cache
def problem(contacts=2):
    """A whisker before a circle, and a roof with corners."""
    roof = jw.Polygon([(-0.5, 0.9), (-0.4, 0.4), (0.0, 0.6), (0.4, 0.4), (0.5, 0.9)])
    scene = jw.Scene(jw.Whisker(), (jw.Circle(0.5, 0.2, position=-1.5), roof), contacts=contacts, friction=MU)
    return problem_now(jax.tree.map(checks.as_float, scene))


def contacts(phase=(2, 2), piece=(0, 0), side=(1.0, 1.0), slip=(1, -1), places=((0.3, 0.5), (0.2, 0.6))):
    """Two contacts; on the circle unless their pieces are others."""
    friction = Friction(jnp.array(slip), *map(jnp.array, places))
    return ChainState(jnp.array(phase), jnp.array(side), jnp.array(piece), friction)


Z = jnp.array([[1.3, 0.25, 0.2], [0.7, -0.4, 0.6]])  # force, parameter, slack


class ContactNumbers(NamedTuple):
    """Where contacts are."""

    parameter: Array
    slack: Array
    lean: Array


def at(z, state):
    profile = problem().profile
    lean = lean_of(profile, problem().friction_angle, z, state)
    return ContactNumbers(parameter_of(profile, z, state), slack_of(profile, z, state), jnp.asarray(lean))


def test_slipping_contacts_lean_against_their_slip():
    numbers = at(Z, contacts())
    np.testing.assert_allclose(numbers.lean, np.arctan(MU) * np.array([1, -1]), rtol=EXACT)
    np.testing.assert_array_equal(numbers.parameter, Z[:, 1])
    np.testing.assert_array_equal(numbers.slack, Z[:, 2])


def test_a_contact_that_sticks_rolls_by_the_same_distance_on_object_and_whisker():
    # On a circle, the parameter is the slope, and the radius is 0.2.
    state = contacts(slip=(0, -1), side=(-1.0, 1.0))
    numbers = at(Z, state)
    assert float(numbers.lean[0]) == float(Z[0, 1])
    moved = 0.2 * (numbers.parameter[0] - state.friction.parameter[0])
    np.testing.assert_allclose(moved, -(state.friction.beyond[0] - Z[0, 2]), rtol=EXACT)


def test_a_tip_that_sticks_stays_where_it_is():
    numbers = at(Z, contacts(phase=(1, 2), slip=(0, -1), places=((0.3, 0.5), (0.0, 0.6))))
    assert float(numbers.parameter[0]) == 0.3
    assert float(numbers.slack[0]) == float(Z[0, 2])


def test_a_corner_that_sticks_to_the_shaft_fixes_its_slack():
    own = problem()
    start = own.profile.ends_on(jnp.array([3, 3]))[0]
    state = contacts(piece=(3, 3), slip=(0, 1))
    z = Z.at[:, 1].set(start + 0.1)
    held, numbers = held_of(own.profile, state), at(z, state)
    assert bool(held.at_corner[0]) and not bool(held.rolls[0])
    assert float(numbers.slack[0]) == float(state.friction.beyond[0])
    assert float(numbers.lean[0]) == float(z[0, 2]) and float(numbers.parameter[0]) == float(z[0, 1])


def test_a_tip_in_an_inner_corner_neither_slips_nor_sticks():
    own = problem()
    inner = 5  # the corner at the top of the roof; the circle is piece 0
    state = contacts(phase=(1, 2), piece=(inner, 0), slip=(0, 1))
    held = held_of(own.profile, state)
    assert bool(held.pinned[0]) and not bool(held.sticks[0])
    assert float(at(Z, state).lean[0]) == 0
    assert np.isinf(float(slip_rates(own, state, Z, Z)[0]))


@pytest.mark.parametrize("column", [1, 2])
def test_the_distance_slipped_is_that_along_the_object_and_along_the_whisker(column):
    own, state = problem(), contacts(side=(-1.0, 1.0))

    def slipped(z):
        return 0.2 * z[:, 1] + state.side * z[:, 2]

    ahead, behind = (slipped(Z.at[:, column].add(step)) for step in (STEP, -STEP))
    expected = (ahead - behind) / (2 * STEP)
    np.testing.assert_allclose(slip_by_contact(own, Z, state)[:, column], expected, atol=SLOPES)


def test_rates_of_slip_are_those_in_its_direction():
    rates = slip_rates(problem(), contacts(), Z, jnp.zeros_like(Z).at[:, 1].set(1.0))
    np.testing.assert_allclose(rates, [0.2, -0.2], rtol=EXACT)
    light = slip_rates(problem(), contacts(), Z.at[0, 0].set(LIGHT / 2), jnp.zeros_like(Z).at[:, 1].set(1.0))
    assert np.isinf(light[0]) and np.isfinite(light[1])


def test_the_margin_of_a_lean_is_what_is_left_of_the_cone():
    own, state = problem(), contacts(slip=(0, 1))
    z = Z.at[0, 1].set(-0.1)
    margin = lean_margin(own, state, z, at(z, state).lean)
    np.testing.assert_allclose(margin[0], np.arctan(MU) - 0.1, atol=1e-10)
    assert np.isinf(margin[1])
    assert lean_margin(own, state, z, None).size == 0
    assert bool(is_light(own, state, z.at[0, 0].set(0.0))[0])


def test_changed_slips_keep_the_place_and_the_lean():
    own, state = problem(), contacts()
    z, stuck = with_slips(own, Z, Z[:, 1], state, jnp.array([0, -1]))
    np.testing.assert_allclose(at(z, stuck).parameter, Z[:, 1], rtol=EXACT)
    np.testing.assert_allclose(at(z, stuck).lean, at(Z, state).lean, rtol=EXACT)
    again, slipping = with_slips(own, z, at(z, stuck).parameter, stuck, jnp.array([1, -1]))
    np.testing.assert_allclose(again, Z, rtol=EXACT)
    assert slipping.friction.slip.tolist() == [1, -1]


@pytest.mark.parametrize(("share", "slip"), [(0.9, 1), (-0.9, -1), (0.2, 0), (-0.2, 0)])
def test_contacts_at_rest_after_a_snap_slip_if_they_lean_enough(share, slip):
    own, none = problem(), contacts()._replace(friction=None)
    lean = jnp.array([share * np.arctan(MU), 0.0])
    z, state = landed(own, Z, none, lean)
    assert int(state.friction.slip[0]) == slip
    expected = lean[0] if slip == 0 else slip * np.arctan(MU)
    np.testing.assert_allclose(at(z, state).lean[0], expected, rtol=EXACT)


def test_contacts_that_stick_on_keep_their_places():
    before = contacts(slip=(0, 0))
    near = contacts(slip=(0, 0), places=((0.3 + NEAR / 2, 0.5 + 2 * NEAR), (0.21, 0.61)))
    kept = keeps_places(problem(), before, near)
    assert float(kept.friction.parameter[0]) == 0.3 and float(kept.friction.beyond[0]) == 0.2
    assert float(kept.friction.parameter[1]) == float(near.friction.parameter[1])
    slipping = contacts(slip=(1, 0), places=near.friction[1:])
    assert float(keeps_places(problem(), before, slipping).friction.parameter[0]) == float(near.friction.parameter[0])


@pytest.mark.parametrize(
    ("slip", "phase", "force", "wedged"),
    [
        ((0, 0), (2, 2), 1.3, True),
        ((0, 1), (2, 2), 1.3, False),
        ((0, 0), (2, 0), 1.3, False),
        ((0, 0), (2, 2), LIGHT, False),
    ],
    ids=["both", "one", "alone", "just begun"],
)
def test_a_whisker_is_wedged_between_two_contacts_that_stick(slip, phase, force, wedged):
    z = Z.at[0, 0].set(force)
    assert bool(is_wedged(problem(), contacts(slip=slip, phase=phase), z)) == wedged


def test_the_contact_that_leans_most_lets_a_wedged_whisker_loose():
    own, state = problem(), contacts(slip=(0, 0))
    z = Z.at[:, 1].set(jnp.array([0.1, -0.3]))  # the leans
    march = ContinuationOfChain(own).start(jnp.zeros(1), Limits(*[jnp.zeros(())] * 3))
    loose = loosened(own, march.replace(point=march.point._replace(z=z), state=state))
    assert loose.state.friction.slip.tolist() == [0, -1] and int(loose.flow.tries) == 1
    np.testing.assert_allclose(at(loose.point.z, loose.state).lean, [0.1, -np.arctan(MU)], rtol=EXACT)


@pytest.mark.unchecked  # the trial has only the fields that are used
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_tip_that_enters_an_inner_corner_keeps_its_direction_and_its_force(side):
    own = problem()
    corner = int(jnp.argmin(corner_signs(own.profile)))
    state = contacts(phase=(1, 0), piece=(corner - 1, 0), side=(side, 1.0), slip=(1, 1))
    end = own.profile.ends_on(state.piece)[1]
    z = Z.at[0, 1:].set(jnp.array([end[0], -0.4])).at[1].set(0.0)
    march = ContinuationOfChain(own).start(jnp.zeros(1), Limits(*[jnp.zeros(())] * 3)).replace(state=state)
    target = march.target._replace(number=jnp.asarray(HIGH), whiskers=jnp.array([True, False]), limit=end)
    stance = march.stance._replace(parameter=z[:, 1])
    trial = SimpleNamespace(state=state, point=Point(z, jnp.zeros(())), stance=stance)
    after, inside, _ = changed_contacts(own, march.replace(target=target), trial)
    assert inside.piece[0] == corner and inside.friction.slip[0] == 0

    def of(z, state):
        chain = of_each(own.bodies(jnp.zeros(())), chain_of, *of_whiskers(own, (z, state)))
        return jnp.stack([*(leaf[0, 0] for leaf in chain.start), chain.load.force_x[0, 0], chain.load.force_y[0, 0]])

    np.testing.assert_allclose(of(after, inside), of(z, state), atol=EXACT)
