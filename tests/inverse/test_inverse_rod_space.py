"""States of whiskers on bases in space against scipy, and the search for the zero of the moment."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from jaxwhisker._inverse.inverse_rod_space import BaseFrame, BaseTurning, SpaceObservation, nearest_zero
from jaxwhisker._inverse.nearest import PhaseCandidate
from jaxwhisker._space.section import space_section
from random_space import Cone
from space_laws import UPRIGHT, Plain, State, shaft

RODS = 1e-8  # of the length: 24 steps of a cone
EXACT = 1e-14
RATIO, SOFT = 0.7, np.array([0.12, 0.08, 0.1])
DRIVE = Rotation.from_rotvec([0.2, -0.1, 0.3])
CONE = jw.Whisker(bending_stiffness=Cone(0.5), lateral_curvature=0.3, intrinsic_curvature=-0.4, torsion_ratio=RATIO)


def observed(friction, own):
    base = BaseFrame(
        jnp.asarray(DRIVE.as_matrix()), jnp.asarray(UPRIGHT), BaseTurning(jnp.zeros(3), jnp.diag(SOFT)), own
    )
    section = space_section(CONE, 1.0, 1.0)
    one = jnp.ones(())
    return SpaceObservation(section, one, base, jnp.zeros(6), jnp.eye(6), jnp.zeros((1, 6)), one, friction)


@jax.jit
def solved(y, phase):
    """A state whose base has the rotation that its springs allow, and that rotation."""

    def with_turn(turn):
        return observed(True, False).state(jnp.concatenate([y[:3], turn, y[3:]]), phase)

    def newton(_, turn):
        slope = jax.jacfwd(lambda turn: with_turn(turn).conditions)(turn)
        return turn - jnp.linalg.inv(slope) @ with_turn(turn).conditions

    turn = jax.lax.fori_loop(0, 12, newton, jnp.zeros(3))
    return with_turn(turn), turn


@pytest.mark.parametrize(("tip", "y"), [(True, (0.8, 0.7, 0.4, 0.0)), (False, (4.0, 2.0, -0.2, 0.4))])
def test_states_satisfy_the_laws_of_rods_and_springs(tip, y):
    state, turn = solved(jnp.array(y), PhaseCandidate(jnp.asarray(tip), jnp.zeros(())))
    assert np.max(np.abs(state.conditions)) < EXACT and np.linalg.norm(turn) > 0.01
    values, turn = np.array(state.values), np.array(turn)
    contact, arc, force, tangent, base = values[:3], values[3], values[4:7], values[7:10], values[10:].reshape(3, 3)
    np.testing.assert_allclose(arc, 1.0 - y[3], atol=EXACT)
    np.testing.assert_allclose(np.linalg.norm(force), y[0], rtol=EXACT)
    np.testing.assert_allclose(force @ tangent, -y[0] * np.sin(y[2]), atol=1e-12)
    np.testing.assert_allclose(state.reaction, [*-force, *-np.cross(contact, force)], atol=EXACT)
    # The springs, by their energy: the moment does the work theta.K d theta at every turn.
    np.testing.assert_allclose(base, (DRIVE * Rotation.from_rotvec(turn)).as_matrix() @ UPRIGHT, atol=EXACT)
    moment = np.cross(contact, force)
    for spin in np.eye(3):
        ends = [
            (DRIVE.inv() * Rotation.from_rotvec(h * spin) * Rotation.from_matrix(base @ UPRIGHT.T)).as_rotvec()
            for h in (1e-6, -1e-6)
        ]
        work = (turn / SOFT) @ (ends[0] - ends[1]) / 2e-6
        assert moment @ spin == pytest.approx(work, abs=1e-8)
    plain = Plain(
        None,
        lambda u: (np.zeros(3), np.eye(3), UPRIGHT),
        1.0,
        Cone(0.5),
        RATIO,
        curvature=lambda s: np.array([0.3, 0.4, 0.0]),
    )
    at = State(0.0, 1 if tip else 2, -force, -moment, np.zeros(3), base, y[0], arc, contact)
    bent = shaft(plain, at)
    np.testing.assert_allclose(bent.at_contact, contact, atol=RODS)
    np.testing.assert_allclose(bent.directors[:, 2], tangent, atol=RODS)


def test_reactions_in_the_frame_of_the_base():
    y = jnp.array([2.0, 0.5, 0.1, 0.1, -0.2, 0.05, 0.2])
    phase = PhaseCandidate(jnp.asarray(False), jnp.zeros(()))
    scene, own = (observed(True, frame).state(y, phase) for frame in (False, True))
    base = np.asarray(own.values[10:]).reshape(3, 3)
    np.testing.assert_allclose(base @ own.reaction[:3], scene.reaction[:3], atol=EXACT)
    np.testing.assert_allclose(base @ own.reaction[3:], scene.reaction[3:], atol=EXACT)


@pytest.mark.parametrize("own", [False, True])
def test_a_base_turns_as_far_as_its_springs_hold_it(own):
    base = observed(True, own).base
    reaction = jnp.array([0.5, -1.0, 0.3, 2.0, -1.5, 1.0])
    turn = base.turn(reaction)
    assert turn is not None
    moment = -reaction[3:]
    moment = base.directors(turn) @ moment if own else moment
    assert np.linalg.norm(turn) > 0.1
    np.testing.assert_allclose(base.excess(turn, moment), 0.0, atol=EXACT)


def test_the_first_zero_of_a_moment():
    s = np.linspace(0.0, 1.0, 11)
    moment = np.stack([0 * s, (0.34 - s) * (0.85 - s), 0 * s], axis=1)
    place, before = nearest_zero(jnp.asarray(moment))
    assert float(place) == pytest.approx(3.4, abs=0.05) and int(before) == 3  # a chord of a parabola
    missed = moment + np.array([0.001, 0.0, 0.0])
    assert float(nearest_zero(jnp.asarray(missed))[0]) == pytest.approx(3.4, abs=0.05)


def test_the_least_moment_if_none_vanishes():
    s = np.linspace(0.0, 1.0, 11)
    moment = np.stack([1 - 0.5 * s, 0 * s, 0 * s], axis=1)
    assert float(nearest_zero(jnp.asarray(moment))[0]) == pytest.approx(10.0)
    moment[8:] = np.nan  # a thin tip overflows
    assert float(nearest_zero(jnp.asarray(moment))[0]) == pytest.approx(7.0)
