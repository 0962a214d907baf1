"""Newton's method: exact states are found from guesses nearby, by control and by arc length; failure is a flag."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_arc_length, at_control, unit
from jaxwhisker._space.newton import newton_step, phase_by_slack, plain, solve_points

REFERENCE = 1e-8  # the reference gives ten digits
PHASE = jnp.array([int(Phase.tip)])
U = jnp.asarray(-0.803317)


@pytest.fixture(scope="module")
def problem():
    return dimensionless(
        jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), motion=jw.LinearDrive((-1, 0, 0)))
    )


def reference():
    """The state at U of the case S1 of the reference, with the offset 0; its angle follows from the other numbers."""
    f, point = 0.4467530757, np.array([0.9497593901, 0.9870190086, 0.0])
    out = point - [0.0, 1.3, 0.0]
    moment = np.cross(point - [0.803317, 0.0, 0.0], f * out)[2]
    # Axial support force in tip contact: H = |M|^2 / 2 + F.t at the base is F.t1 at the tip.
    sine = -(moment**2 / 2 + f * out[1]) / f
    ahead = np.array([-out[1], out[0], 0.0])
    return jnp.array([[f, 0.0, -np.arcsin(sine), *point, *ahead, 0.0, 0.0]])


def solve(problem, condition, guess):
    """Solve for one point without traction."""
    return solve_points(problem, plain(PHASE, condition), jax.tree.map(lambda leaf: leaf[None], guess))


def test_a_guess_nearby_leads_to_the_reference_at_the_same_control(problem):
    z = reference()
    guess = Point(z.at[0, 0].add(0.02).at[0, 3:6].add(0.01).at[0, 2].add(0.03), U)
    found = solve(problem, at_control(U, guess.z), guess)
    assert bool(found.converged)
    np.testing.assert_allclose(found.end.z, z, atol=10 * REFERENCE)
    assert float(newton_step(problem, plain(PHASE, at_control(U, z)), found.points).residual) < 1e-12


def test_a_step_along_the_path_has_its_length(problem):
    start = solve(problem, at_control(U, reference()), Point(reference(), U))
    tangent, _ = unit(start.newton.tangent, start.end.z)
    length = 0.01
    ahead = Point(start.end.z + length * tangent.z, start.end.u + length * tangent.u)
    found = solve(problem, at_arc_length(start.end, tangent, jnp.asarray(length)), ahead)
    assert bool(found.converged)
    # Errors of the prediction are of second order.
    assert 0 < float(jnp.max(jnp.abs(found.end.z - ahead.z))) < 10 * length**2
    back = solve(problem, at_control(found.end.u, ahead.z), ahead)
    np.testing.assert_allclose(back.end.z, found.end.z, atol=1e-9)


def test_several_points_are_solved_at_once_and_a_hopeless_one_is_flagged(problem):
    """At the hopeless control, the base is two lengths away from the object."""
    z, u = jnp.stack([reference()] * 3), jnp.array([U, -4.0, U + 0.001])
    equations = jax.vmap(plain)(jnp.stack([PHASE] * 3), jax.vmap(at_control)(u, z))
    found = solve_points(problem, equations, Point(z[:, None], u[:, None]))
    assert found.converged.tolist() == [True, False, True]
    np.testing.assert_allclose(found.end.z[0], reference(), atol=10 * REFERENCE)


def test_slacks_tell_the_phase_of_touching_whiskers():
    slack = jnp.zeros((4, 11)).at[:, 2].set(jnp.array([0.1, -0.1, 0.1, 0.0]))
    phase = jnp.array([int(p) for p in (Phase.tip, Phase.tangential, Phase.free, Phase.tip)])
    expected = [Phase.tangential, Phase.tip, Phase.free, Phase.tip]
    assert phase_by_slack(slack, phase).tolist() == [int(p) for p in expected]
