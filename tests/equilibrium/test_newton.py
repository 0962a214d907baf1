"""Newton's method on the network: exact equilibria, convergence, tangents, failures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from engine import dimensionless
from exact_contacts import contacts, fbfb_at
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import newton
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import Apart, newton_step, with_dummy_contacts
from jaxwhisker._equilibrium.point import Point, at_arc_length, at_control, scale_of
from jaxwhisker._equilibrium.solver import solve_point

EXACT = 1e-9  # of solved contacts, in their scale: the accepted point is one step better than the tested one
RESIDUAL = 1e-11  # of exact contacts: their moduli are found by bisection
DIFFERENCE = 1e-6  # relative, of central differences of solved contacts
STIFFNESS = (70.0, 40.0)
# Parameters of both whiskers on the clamped branch: just after touch, every phase, both sides of the vertex.
PAIRS: list[tuple[float, float]] = [(0.3, 1e-7), (0.6, 0.1), (1.3, 0.9), (2.6, 0.4), (2.5, 1.0)]


def state_of(at):
    return ContactState(jnp.asarray(at.phase), jnp.ones(2))


solve, step = Program(solve_point), Program(newton_step)


def strong(tree):
    """The tree without weak types, of which each combination would be compiled for itself."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, leaf.dtype), tree)


def solved_at_control(problem, state, z, u, apart=None):
    """The solution at a control, from a guess."""
    return solve(problem, state, *strong((at_control(u, z), Point(z, u))), apart)


def step_at_control(problem, state, z, u):
    """A Newton step from here, towards control 0."""
    return step(problem, state, *strong((at_control(jnp.asarray(0.0), z), Point(z, u))))


@pytest.fixture(scope="module")
def typical():
    """Problem, exact contacts and mode of an equilibrium at control 0."""
    at = contacts(1.3, 0.4)
    return dimensionless(fbfb_at(1.3, 0.4, STIFFNESS)), at, state_of(at)


@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_exact_equilibria_are_found(pair):
    at = contacts(*pair)
    state, z = state_of(at), jnp.asarray(at.z)
    problem = dimensionless(fbfb_at(pair[0], pair[1], STIFFNESS))
    off = 1e-3 * scale_of(z) * np.random.default_rng(0).uniform(-1, 1, z.shape)
    solution = solved_at_control(problem, state, z + off, jnp.asarray(0.0))
    assert solution.converged and solution.iterations <= 5
    assert solution.point.u == 0.0
    assert np.max(np.abs(solution.point.z - z) / scale_of(z)) < EXACT
    np.testing.assert_allclose(solution.newton.pose[:, 0], at.base_x, atol=EXACT)
    np.testing.assert_allclose(solution.newton.load[:, 0], at.force_x, atol=EXACT * 20)  # forces up to 20


def test_convergence_is_quadratic(typical):
    problem, at, state = typical
    z = jnp.asarray(at.z)
    direction = scale_of(z) * jnp.array([[0.3, -0.2, 0.1], [-0.2, 0.1, 0.3]])
    assert step_at_control(problem, state, z, jnp.asarray(0.0)).residual < RESIDUAL

    def miss(size):
        change = step_at_control(problem, state, z + size * direction, jnp.asarray(0.01 * size)).step
        assert change.u == -0.01 * size  # the row is linear: one step fulfils it
        return np.max(np.abs(size * direction + change.z) / scale_of(z))

    misses = [miss(size) for size in (0.04, 0.02, 0.01)]
    ratios = np.array(misses[:-1]) / misses[1:]
    np.testing.assert_allclose(ratios, 4.0, rtol=0.1)  # 2 for a slope that is wrong


def test_the_tangent_is_the_derivative_of_the_path(typical):
    problem, at, state = typical
    z, h = jnp.asarray(at.z), 1e-4
    newton = step_at_control(problem, state, z, jnp.asarray(0.0))
    ahead, behind = (solved_at_control(problem, state, z, jnp.asarray(u)) for u in (h, -h))
    assert abs(newton.tangent.u - 1.0) < RESIDUAL  # the row, applied to it, is 1
    slope = (ahead.point.z - behind.point.z) / (2 * h)
    np.testing.assert_allclose(newton.tangent.z, slope, rtol=DIFFERENCE, atol=DIFFERENCE)
    pose = (ahead.newton.pose - behind.newton.pose) / (2 * h)
    np.testing.assert_allclose(newton.tangent_pose, pose, rtol=DIFFERENCE, atol=DIFFERENCE)
    # Along its own branch, a base moves by `by_x` while the contact moves by the first column of the basis.
    along = np.sum(newton.condensed.basis[:, :, 0] * newton.tangent.z, axis=1)
    square = np.sum(newton.condensed.basis[:, :, 0] ** 2, axis=1)
    np.testing.assert_allclose(newton.condensed.by_x * along / square, newton.tangent_pose[:, 0], rtol=RESIDUAL)


def test_an_arc_length_ahead(typical):
    problem, at, state = typical
    z, distance = jnp.asarray(at.z), 0.05
    here = Point(z, jnp.asarray(0.0))
    tangent = step_at_control(problem, state, z, here.u).tangent
    condition = at_arc_length(here, tangent, distance)
    solution = solve(problem, state, *strong((condition, here)))
    assert solution.converged
    chord = solution.point.z - z
    scale = scale_of(z)
    projected = np.sum(chord * tangent.z / scale**2) + solution.point.u * tangent.u
    length = np.sum((tangent.z / scale) ** 2) + tangent.u**2
    assert abs(projected - distance * length) < EXACT
    # It is an equilibrium at its own control.
    again = solved_at_control(problem, state, solution.point.z, solution.point.u)
    np.testing.assert_allclose(again.point.z, solution.point.z, atol=EXACT * 20)


def test_the_base_of_a_free_whisker_follows_the_others():
    alone = contacts(1.3)
    problem = dimensionless(fbfb_at(1.3, 0.4, STIFFNESS))
    state = ContactState(jnp.array([int(alone.phase[0]), int(Phase.free)]), jnp.ones(2))
    z = jnp.asarray(np.concatenate([alone.z, np.zeros((1, 3))]))
    first, second = np.ravel(problem.offset)
    u = alone.base_x[0] - alone.force_x[0] / STIFFNESS[0] - first
    solution = solved_at_control(problem, state, z + 1e-3, jnp.asarray(u))
    assert solution.converged
    np.testing.assert_allclose(solution.point.z[0], alone.z[0], atol=EXACT * 20)
    base_x = [alone.base_x[0], u + second + alone.force_x[0] / STIFFNESS[0]]
    np.testing.assert_allclose(solution.newton.pose[:, 0], base_x, atol=EXACT)
    assert np.all(solution.newton.load[1] == 0)


def test_separate_whiskers_do_not_feel_the_network(typical):
    problem, at, state = typical
    off = jnp.array([[0.01, 0.02, -0.01], [0.02, -0.01, 0.01]])
    apart = Apart(jnp.asarray(True), None)
    z, elsewhere = jnp.asarray(at.z) + off, jnp.asarray(3.0)
    solution = solved_at_control(problem, state, z, elsewhere, apart)
    assert solution.converged and solution.point.u == elsewhere
    # Both stand upright at height 0 again, next to where they were on their branches.
    again = step_at_control(problem, state, solution.point.z, elsewhere)
    assert np.max(np.abs(again.condensed.own)) < EXACT
    assert np.max(np.abs(solution.point.z - z)) < 0.1


def test_failure_is_a_flag_and_neighbours_do_not_notice(typical):
    problem, at, state = typical
    z = jnp.asarray(at.z)
    # Far beyond the fold there is no such equilibrium, and NaN is no control.
    controls = jnp.array([0.0, -6.0, jnp.nan, 1e-3])
    batch = Program(lambda u: jax.vmap(lambda u: solve_point(problem, state, at_control(u, z), Point(z, u)))(u))(
        controls
    )
    assert batch.converged.tolist() == [True, False, False, True]
    for lane in (0, 3):
        alone = solved_at_control(problem, state, z, controls[lane])
        np.testing.assert_allclose(batch.point.z[lane], alone.point.z, atol=RESIDUAL * 20)
        assert np.all(np.isfinite(batch.newton.load[lane]))


def test_dummy_contacts_keep_derivatives_finite(typical):
    problem, at, _ = typical
    free = jnp.array([int(Phase.free), int(at.phase[1])])
    z = jnp.asarray(at.z).at[0].set(0.0)
    dummies, phase = with_dummy_contacts(problem, z, free)
    assert phase.tolist() == [Phase.tip, at.phase[1]]
    assert np.all(dummies[1] == z[1]) and dummies[0, 0] > 0 and dummies[0, 2] < 0

    @Program
    def gradient(problem):
        def height(profile):
            before = problem.__class__(**{**vars(problem), "profile": profile})
            contact, phase = with_dummy_contacts(before, z, free)
            state = ContactState(phase, jnp.ones(2))
            return newton.evaluate(before, Point(contact, jnp.asarray(0.0)), state).y[1]

        return eqx.filter_grad(height)(problem.profile)

    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(gradient(problem)))
