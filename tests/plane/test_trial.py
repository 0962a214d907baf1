"""Trials: events and dips within a step on margins that are known everywhere; how a solution is judged."""

# pyright: reportArgumentType=false

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begin, begun_march, dimensionless
from exact_contacts import contacts, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import newton_step, slope_sines
from jaxwhisker._equilibrium.point import Point, at_control, scale_of
from jaxwhisker._equilibrium.solver import Solution
from jaxwhisker._equilibrium.stance import Stance
from jaxwhisker._plane.events import AT_STOP, PHASE, RELEASE, TOUCH, VERTEX
from jaxwhisker._plane.march_state import Proposed, TrialInPlane
from jaxwhisker._plane.trial import _direction_of_parabola, dip, evaluate_trial, first_violated

ROUNDING = 1e-12
FB = scene(jw.Support.fb(70.0))
FBFB = scene(jw.Support.fbfb(70.0))

STANCE = Stance(jnp.zeros(2), None, None)  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def two():
    """Problem and state of two whiskers: the first in tip contact, the second free."""
    problem = dimensionless(FBFB)
    march = begun_march(problem, jnp.array([1.0, -1.0]))
    state = march.state._replace(phase=jnp.array([int(Phase.tip), int(Phase.free)]))
    return problem, march.replace(state=state, step=jnp.asarray(0.1))


def margins(touch=np.inf, release=1.0, phase=1.0, vertex=1.0, stop=1.0):
    """Margins of both whiskers: a touch of the second one, all else of the first one."""
    release, phase, vertex = (jnp.array([value, np.inf]) for value in (release, phase, vertex))
    return jnp.array([np.inf, touch]), release, phase, vertex, jnp.array([stop])


def trial(problem, here, there, tangent=None, tangent_pose=None):
    stance = problem.stance(0.0, jnp.array([[0.5], [0.7]]))
    yes, side = jnp.asarray(True), jnp.ones(2)
    solution = SimpleNamespace(point=Point(jnp.zeros((2, 3)), jnp.asarray(0.0)))
    return TrialInPlane(None, solution, tangent, tangent_pose, yes, yes, here, there, stance, side, jnp.ones(1))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("there", "kind", "whisker", "share"),
    [
        ({"touch": -0.5}, TOUCH, [False, True], 0.5),  # out of reach before: anywhere within the step
        ({"release": -1.0}, RELEASE, [True, False], 0.5),
        ({"phase": -3.0}, PHASE, [True, False], 0.25),
        ({"vertex": -0.25}, VERTEX, [True, False], 0.8),
        ({"stop": -1.0, "release": -0.5}, AT_STOP, [False, False], 0.5),
        ({"stop": -1.0, "release": -3.0}, RELEASE, [True, False], 0.25),
    ],
)
def test_the_first_event_within_a_step(two, there, kind, whisker, share):
    problem, march = two
    found, target = first_violated(problem, march, trial(problem, margins(), margins(**there)), jnp.asarray(0.1))
    assert found and target.number == kind
    if kind != AT_STOP:  # which concerns no whisker
        assert target.whiskers.tolist() == whisker
    np.testing.assert_allclose(target.distance, share * 0.1, rtol=ROUNDING)


def test_margins_of_rounding_are_no_events(two):
    problem, march = two
    found, _ = first_violated(problem, march, trial(problem, margins(), margins(release=-1e-13)), jnp.asarray(0.1))
    assert not found


@pytest.mark.parametrize(("lowest", "dips"), [(-0.01, True), (0.01, False)])
def test_a_margin_that_dips_below_zero_within_a_step(two, lowest, dips):
    # The release margin is the parabola 4 (1 - lowest) (t - 1/2)^2 + lowest, over the share t of the step.
    problem, march = two
    slope = -4 * (1 - lowest) / 0.1
    still = jnp.zeros((2, 1))

    def along(slope):
        return Point(jnp.zeros((2, 3)).at[0, 0].set(slope), jnp.asarray(-1.0))

    march = march.replace(tangent=along(slope), tangent_pose=still)
    found, share = dip(problem, march, trial(problem, margins(), margins(), along(-slope), still), jnp.asarray(0.1))
    assert bool(found) == dips
    if dips:
        np.testing.assert_allclose(share, 0.5, rtol=ROUNDING)


def test_the_direction_at_the_end_of_a_parabola(two):
    _, march = two
    # z = z0 + s d + s^2 b / 2 of the touching whisker, with d of unit length in the scale of z0 and b across it.
    z0, d, b = march.point.z, jnp.array([0.6, 0.0, 0.0]), jnp.array([0.0, 1.4, -0.3])
    distance, along = 0.3, march.tangent._replace(z=jnp.zeros((2, 3)).at[0].set(d), u=jnp.asarray(-0.8))
    march = march.replace(tangent=along, tangent_pose=jnp.array([[-0.5], [-0.7]]))
    end = Point(z0.at[0].add(distance * d + distance**2 / 2 * b), march.point.u - 0.8 * distance)
    pose = march.pose + distance * jnp.array([[-0.4], [-0.6]])

    class Newton:
        pass

    newton = Newton()
    newton.pose = pose  # pyright: ignore[reportAttributeAccessIssue]
    solution = Solution(end, newton, jnp.asarray(True), jnp.asarray(1))  # pyright: ignore[reportArgumentType]
    tangent, tangent_pose = _direction_of_parabola(march, solution, march.state.phase == Phase.free, STANCE)
    np.testing.assert_allclose(tangent.z[0], d + distance * b, atol=ROUNDING)
    np.testing.assert_allclose(tangent.u, -0.8, rtol=ROUNDING)
    np.testing.assert_allclose(tangent_pose[:, 0], [-0.3, -0.5], atol=ROUNDING)
    # A chord of no length has no direction: that of the path is kept.
    none = solution._replace(point=march.point)
    tangent, _ = _direction_of_parabola(march, none, march.state.phase == Phase.free, STANCE)
    np.testing.assert_allclose(tangent.z, along.z, atol=ROUNDING)


def test_a_trial_is_judged_by_its_solution():
    stiffness, p = 70.0, 0.6
    at, problem = contacts(p), dimensionless(FB)
    z, u = jnp.asarray(at.z), jnp.asarray(at.base_x[0] - 0.2 - at.force_x[0] / stiffness)
    state = ContactState(jnp.asarray(at.phase), jnp.ones(1))

    @Program
    def judged(problem, z, u, sign):
        newton = newton_step(problem, state, at_control(u, z), Point(z, u))
        march = begin(problem, jnp.array([1.0, -1.0]))
        ahead = Point(sign * newton.tangent.z, sign * newton.tangent.u)
        march = march.replace(state=state, point=Point(z, u + 0.01), tangent=ahead, pose=newton.pose + 0.01)
        solution = Solution(Point(z, u), newton, jnp.asarray(True), jnp.asarray(1))
        proposed = Proposed(solution.point, None, march.flow)
        trial = evaluate_trial(problem, march, proposed, solution, u - 0.25, newton.pose)
        return trial, slope_sines(problem, state, z[:, 1])

    results = {sign: judged(problem, z, u, jnp.asarray(sign)) for sign in (1.0, -1.0)}
    for sign, (trial, sines) in results.items():
        # The tangent has unit length, and goes on in the direction of the state's.
        length = np.sum((trial.tangent.z / scale_of(z)) ** 2) + trial.tangent.u**2
        np.testing.assert_allclose(length, 1.0, rtol=ROUNDING)
        assert np.sign(trial.tangent.u) == sign
        assert trial.stable and trial.sound
        np.testing.assert_allclose(sines, np.sin(at.z[:, 1]), rtol=ROUNDING)
        np.testing.assert_allclose(trial.there[VERTEX], np.sin(at.z[:, 1]), rtol=ROUNDING)
        np.testing.assert_allclose([trial.there[AT_STOP][0], trial.here[AT_STOP][0]], [0.25, 0.26], rtol=ROUNDING)
        np.testing.assert_allclose(trial.there[RELEASE], at.z[:, 0], rtol=ROUNDING)
        np.testing.assert_allclose(trial.stance.x, at.base_x, atol=1e-9)
