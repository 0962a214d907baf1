"""How contacts move: Radau's method, the laws of sticking, slipping and flowing, and what follows at corners."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._space.contact import FORCE, POINT, SLACK, TRACTION, Traction
from jaxwhisker._space.slip import (
    ContactMotion,
    SlipMode,
    SlipState,
    SpaceContactState,
    _law,
    as_felt,
    defect_of,
    ends_of_step,
    first_traction,
    following,
    grip_of,
    laws,
    mode_after,
    mode_at_corner,
    next_guess,
    radau,
    speeds,
    stages_of,
    without_traction,
)

ROUNDING = 1e-12
BALL = jw.Sphere(1.0, (0.0, 0.0, 0.0))
FLAT = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]  # a contact on top of the ball: point and direction
SLIPS, STICKS = (jnp.array([int(mode)]) for mode in (SlipMode.slips, SlipMode.sticks))
TIP, SHAFT = (jnp.array([int(phase)]) for phase in (Phase.tip, Phase.tangential))


def contact(force=1.0, slack=-0.1, point=(0.0, 1.0, 0.0), ahead=(1.0, 0.0, 0.0), traction=(0.0, 0.0)):
    return jnp.array([[force, 0.0, slack, *point, *ahead, *traction]])


def state(begins=False):
    return SlipState(jnp.asarray(0), jnp.asarray(False), jnp.array([begins]), jnp.asarray(0))


def test_radau_has_its_published_coefficients():
    """Hairer and Wanner, Solving ordinary differential equations II, section IV.5: two and three stages."""
    places, rates = radau(2)
    np.testing.assert_allclose(places, [1 / 3, 1], atol=ROUNDING)
    # The inverse of the table (5/12, -1/12; 3/4, 1/4).
    np.testing.assert_allclose(rates[1:], [[1.5, 0.5], [-4.5, 2.5]], atol=ROUNDING)
    places, _ = radau(3)
    np.testing.assert_allclose(places, [(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1], atol=ROUNDING)


def test_polynomials_have_their_rates_at_all_places():
    places, rates = radau(5)
    polynomial = np.polynomial.Polynomial([0.0, 0.3, -1.0, 2.0, 0.7, -0.4])
    at = np.append(0.0, places)
    np.testing.assert_allclose(rates @ polynomial(places), polynomial.deriv()(at), atol=1e-11)


def test_a_scene_without_friction_needs_one_stage():
    scene = jw.SpaceScene(jw.Whisker(), BALL)
    assert stages_of(dimensionless(scene)) == 1
    assert stages_of(dimensionless(jw.SpaceScene(jw.Whisker(), BALL, friction=0.2))) > 1


def flowing(friction, moves, traction, force=2.0, time=0.5):
    motion = ContactMotion(contact(), Traction(friction, jnp.asarray(True)), jnp.asarray(time))
    mode = None if friction is None else SLIPS[0]
    given = None if friction is None else jnp.zeros(2)
    return _law(motion, mode, given, jnp.asarray(moves), jnp.asarray(traction), jnp.asarray(force))


def test_a_flow_is_viscous_and_stops_inside_the_cone_of_friction():
    np.testing.assert_allclose(flowing(None, [-0.3, 0.1], [0.6, -0.2]), 0, atol=ROUNDING)
    np.testing.assert_allclose(flowing(jnp.asarray(0.4), [0.0, 0.0], [0.3, -0.6]), 0, atol=ROUNDING)
    # The limit is 0.8. Of the traction (3, -4), the excess is 4.2 / 5 of it.
    moves = -0.5 * 4.2 / 5 * np.array([3.0, -4.0])
    np.testing.assert_allclose(flowing(jnp.asarray(0.4), moves, [3.0, -4.0]), 0, atol=ROUNDING)


def test_a_contact_slips_against_its_traction_and_a_sticking_one_rolls():
    start, end = contact(slack=0.3), contact(slack=0.1, point=(0.2, 1.0, 0.0))
    given = jnp.zeros((1, 2))

    def law(z, mode):
        found, moved = laws(BALL, z[None], start, SHAFT[None], mode, given)
        return found[0, 0], moved[0, 0]

    # The contact point moves ahead as far as the contact moves along the shaft: it rolls.
    residual, moved = law(end, STICKS)
    np.testing.assert_allclose([*residual, *moved], 0, atol=0.02)  # the frame has turned by 0.2
    across = contact(slack=0.3, point=(0.0, 1.0, 0.01))
    for traction, fits in ((1.0, True), (-1.0, True), (0.6, False)):
        residual, moved = law(across.at[0, 10].set(traction), SLIPS)
        assert bool(jnp.all(jnp.abs(residual) < ROUNDING)) == fits
    assert abs(float(jnp.sum(moved**2)) ** 0.5 - 0.01) < 1e-5


def test_a_contact_that_follows_has_given_places_and_tractions():
    z = contact(traction=(0.6, -0.8))
    motion = following(z, jnp.asarray(0.3), SLIPS)
    assert motion.follows is not None
    for mode in (SLIPS, STICKS):
        residual, _ = laws(BALL, z[None], z, TIP[None], mode, z[:, TRACTION], motion.follows)
        np.testing.assert_allclose(residual, 0, atol=ROUNDING)


def test_speeds_are_those_of_the_material():
    rate = jnp.zeros((1, 11)).at[0, POINT].set(jnp.array([0.3, 0.0, -0.2])).at[0, SLACK].set(0.5)
    # Across is the normal times the direction: y times x is -z.
    np.testing.assert_allclose(speeds(BALL, contact(), TIP, rate), [[0.3, 0.2]], atol=ROUNDING)
    np.testing.assert_allclose(speeds(BALL, contact(slack=0.1), SHAFT, rate), [[0.8, 0.2]], atol=ROUNDING)


def test_grip_is_the_speed_of_slip_or_what_friction_holds_besides():
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), BALL, friction=0.2))
    z = contact(traction=(-0.6, 0.0))
    ahead = Point(jnp.zeros((1, 11)).at[0, POINT].set(jnp.array([0.5, 0.0, 0.0])), jnp.asarray(1.0))
    here = Point(z, jnp.asarray(0.0))
    assert float(grip_of(problem, SLIPS, TIP, here, ahead)[0]) == pytest.approx(0.3)
    assert float(grip_of(problem, STICKS, TIP, here, ahead)[0]) == pytest.approx(0.32)
    assert np.isinf(grip_of(problem, SLIPS, jnp.array([int(Phase.free)]), here, ahead)[0])


def test_small_friction_is_felt_less():
    change = Point(jnp.ones((1, 11)), jnp.asarray(1.0))
    for force, weight in ((10.0, 1.0), (0.1, 0.5), (0.0, 0.0), (-1.0, 0.0)):
        felt = as_felt(jnp.asarray(0.5), contact(force=force), change)
        np.testing.assert_allclose(felt.z[0, TRACTION], weight)
        assert np.all(felt.z[0, :9] == 1)
    assert np.all(without_traction(change).z[0, TRACTION] == 0)


def test_a_tip_that_does_not_move_slips_down_first():
    velocity = jnp.array([[0.0, 0.0], [0.3, -0.4]])
    np.testing.assert_allclose(first_traction(velocity), [[1.0, 0.0], [-0.6, 0.8]], atol=ROUNDING)


def test_guesses_turn_to_both_sides_and_end_with_sticking():
    slip, mode, traction, angles = state(begins=True), SLIPS, jnp.array([[1.0, 0.0]]), []
    for _ in range(3):
        slip, mode, traction = next_guess(slip, mode, traction)
        angles.append(float(jnp.arctan2(traction[0, 1], traction[0, 0])))
    np.testing.assert_allclose(angles, [np.pi / 3, -np.pi / 3, 0.0], atol=ROUNDING)
    assert int(mode[0]) == SlipMode.sticks
    slip, mode, _ = next_guess(slip, mode, traction)
    assert int(mode[0]) == SlipMode.slips
    assert int(slip.guess) == 0


def test_where_the_drive_turns_all_stick_and_a_new_contact_slips():
    no, yes = jnp.array([False]), jnp.array([True])
    for mode, grips, turns, touches, then in (
        (SLIPS, no, True, no, SlipMode.sticks),
        (SLIPS, yes, False, no, SlipMode.sticks),
        (STICKS, yes, False, no, SlipMode.slips),
        (STICKS, no, False, yes, SlipMode.slips),
    ):
        assert int(mode_after(mode, grips, jnp.asarray(turns), touches)[0]) == then


def test_at_a_corner_contacts_do_not_slip_with_their_traction():
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), BALL, friction=0.2))
    here = Point(contact(traction=(1.0, 0.0)), jnp.asarray(0.0))
    rate = jnp.zeros((1, 11)).at[0, POINT].set(jnp.array([0.5, 0.0, 0.0])).at[0, TRACTION].set(jnp.array([0.4, 0.0]))
    for sign, mode, after in ((1, SLIPS, SlipMode.sticks), (-1, SLIPS, SlipMode.slips)):
        now, ahead = SpaceContactState(TIP, mode), Point(sign * rate, jnp.asarray(1.0))
        new, _ = mode_at_corner(problem, now, jnp.array([False]), here, ahead)
        assert int(new[0]) == after
    for sign, after in ((1, SlipMode.slips), (-1, SlipMode.sticks)):
        now, ahead = SpaceContactState(TIP, STICKS), Point(sign * rate, jnp.asarray(1.0))
        new, _ = mode_at_corner(problem, now, jnp.array([False]), here, ahead)
        assert int(new[0]) == after


def test_a_step_begins_and_ends_in_the_direction_of_its_polynomial():
    places, _ = radau(3)
    path = [lambda t, k=k: 0.1 * (k + 1) * t - 0.05 * k * t**2 for k in range(11)]
    z = jnp.array([[[f(t) for f in path]] for t in places])
    points = Point(z, jnp.asarray(0.7 * places))
    start = Point(jnp.zeros((1, 11)), jnp.asarray(0.0))
    first, last = ends_of_step(state(), start, points)
    np.testing.assert_allclose(first.z[0], [jax.grad(f)(0.0) for f in path], atol=ROUNDING)
    np.testing.assert_allclose(last.z[0], [jax.grad(f)(1.0) for f in path], atol=ROUNDING)
    assert float(last.u) == pytest.approx(0.7)
    # The polynomial begins along its own tangent.
    length = jnp.sqrt(jnp.sum(first.z[0, :9] ** 2) + first.u**2)
    tangent = jax.tree.map(lambda leaf: leaf / length, first)
    assert float(defect_of(jnp.asarray(1.0), state(), start, tangent, points)) < ROUNDING
    other = Point(tangent.z.at[0, FORCE].add(0.1), tangent.u)
    assert float(defect_of(jnp.asarray(1.0), state(), start, other, points)) > 1e-3
