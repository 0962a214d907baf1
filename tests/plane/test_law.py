"""Contact laws: what a march asks about contacts, on states made by hand."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import begun_march, dimensionless
from exact_contacts import scene
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import LIGHT, Friction
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import Status
from jaxwhisker._plane.law import FORCE_ERROR, Coulomb, Law, contact_law
from jaxwhisker._plane.march_state import Proposed, TrialInPlane

SMOOTH = scene(jw.Support.fb(70.0))
FRICTION = 0.3
ROUGH = jw.Scene(jw.Whisker(), jw.Circle(0.2, 0.5), jw.Support.fbfb(70.0), jw.ClosedForm(), friction=FRICTION)
TIP, FREE = int(Phase.tip), int(Phase.free)


def begun(made):
    """The law of a scene, and a march that has just begun; its drive moves towards -x."""
    problem = dimensionless(made)
    return contact_law(problem), begun_march(problem, jnp.array([1.0, -1.0]))


@pytest.fixture(scope="module")
def smooth():
    return begun(SMOOTH)


@pytest.fixture(scope="module")
def rough():
    return begun(ROUGH)


def at_contacts(march, slip=(1, 0), force=(1.0, 1.0), leans=(0.1, 0.1)):
    """A march at tip contacts of two whiskers on the right, of which by default the first one slips."""
    friction = Friction(jnp.array(slip), jnp.zeros(2), jnp.zeros(2))
    z = jnp.stack([jnp.array(force), jnp.array(leans), jnp.array([-0.2, -0.3])], axis=1)
    return march.replace(
        state=ContactState(jnp.array([TIP, TIP]), jnp.ones(2), friction), point=Point(z, jnp.asarray(0.0))
    )


def trial_of(z, u_rate=-1.0, turns=(1.0,), *, guess=None, stable=True, converged=True):
    """What laws see of a trial that ends at these contacts, and at which a flow was to end."""
    flow, guess = SimpleNamespace(guess=z), Point(z, jnp.asarray(0.0)) if guess is None else guess
    tangent = Point(jnp.zeros_like(z), jnp.asarray(u_rate))
    solution = SimpleNamespace(point=Point(z, jnp.asarray(0.0)), converged=jnp.asarray(converged))
    parts = solution, tangent, None, jnp.asarray(stable), jnp.asarray(True), None, None, None, None, jnp.array(turns)
    return TrialInPlane(Proposed(guess, None, flow), *parts)  # pyright: ignore[reportArgumentType]


def test_friction_is_a_law_of_its_own(smooth, rough):
    assert type(smooth[0]) is Law and type(rough[0]) is Coulomb


def test_contacts_without_friction_remember_nothing(smooth):
    law, march = smooth
    assert march.slips_tried is march.rests is march.stuck_at is None
    assert march.pending.stop is march.pending.corner is None
    assert march.unstable_turns.shape == (1,)
    # Only the drive must not turn back.
    np.testing.assert_array_equal(law.turns(march, march.point.z, march.tangent), [1.0])


def test_a_snap_begins_at_the_point_that_has_lost_its_stability(smooth):
    law, march = smooth
    tip = march.state._replace(phase=jnp.array([TIP]))
    at = march.replace(state=tip, point=Point(jnp.array([[2.0, 0.3, -0.1]]), jnp.asarray(0.4)))
    snaps = law.to_snap(at)
    assert snaps.task == Task.kick and snaps.unstable_at == jnp.inf
    np.testing.assert_array_equal(snaps.pending.z_before, at.point.z)
    assert snaps.pending.before is tip and snaps.pending.arriving is at.tangent
    np.testing.assert_array_equal(snaps.flow.pose, at.pose)
    assert not snaps.flow.slipped.any() and snaps.flow.iterations == 0


def test_a_snap_with_friction_remembers_the_next_stop(rough):
    law, march = rough
    pending = law.to_snap(at_contacts(march).replace(goal=jnp.asarray(3))).pending
    assert pending.stop == 3 and pending.corner


def test_slips_must_not_turn_back(rough):
    law, march = rough
    at = at_contacts(march, slip=(-1, 0))
    # The circle's arc length grows by its radius, 0.5, times the parameter.
    tangent = Point(jnp.array([[0.0, 0.2, 0.0], [0.0, 0.2, 0.0]]), jnp.asarray(-1.0))
    np.testing.assert_allclose(law.turns(at, at.point.z, tangent), [1.0, -0.5 * 0.2, np.inf], rtol=1e-12)
    # Contacts with hardly any force do not count.
    light = at_contacts(march, slip=(-1, 0), force=(LIGHT / 2, 1.0))
    rates = [law.rates(light.state, light.point.z, tangent.z, *least) for least in ((), (LIGHT,))]
    np.testing.assert_allclose(rates, [[-0.1, np.inf], [np.inf, np.inf]], rtol=1e-12)


@pytest.mark.parametrize(("error", "near"), [(0.9 * FORCE_ERROR, True), (1.1 * FORCE_ERROR, False)])
def test_forces_of_contacts_that_stick_are_near_their_predictions(rough, error, near):
    law, march = rough
    at = at_contacts(march)
    off = trial_of(at.point.z.at[1, 0].add(error), guess=at.point)
    assert bool(law.accepts(at, off)) == near
    # That of the contact that slips may be far from it.
    assert law.accepts(at, trial_of(at.point.z.at[0, 0].add(error), guess=at.point))


def test_a_stable_path_does_not_turn_back(rough):
    law, march = rough
    at = at_contacts(march)
    assert not law.accepts(at, trial_of(at.point.z, u_rate=0.1))
    assert law.accepts(at, trial_of(at.point.z, u_rate=0.1, stable=False))
    assert law.accepts(at, trial_of(at.point.z, u_rate=-0.1))


@pytest.mark.parametrize(
    ("turns", "rests", "task", "slip"),
    [
        ((0.5, -1e-3, np.inf), (False, False), Task.arrive, [0, 0]),  # slips back: it sticks
        ((0.5, 1e-12, np.inf), (True, False), Task.arrive, [0, 0]),  # known to rest here
        ((1e-12, 0.3, np.inf), (False, False), Task.kick, [1, 0]),  # the drive rests: a fold
        ((-0.1, -0.05, np.inf), (False, False), Task.kick, [1, 0]),  # both have turned back, the drive before
    ],
)
def test_what_comes_to_rest_decides_how_the_path_goes_on(rough, turns, rests, task, slip):
    law, march = rough
    at = at_contacts(march)
    node = march.pending._replace(point=at.point)
    after = law.after_rest(at, trial_of(at.point.z, u_rate=-turns[0], turns=turns), node, jnp.array(rests))
    assert after.task == task and after.state.slip.tolist() == slip


def test_a_snap_follows_the_motion_of_contacts(rough):
    law, march = rough
    at = at_contacts(march).replace(task=jnp.asarray(int(Task.flow)))
    known = march.flow._replace(basis=jnp.ones_like(march.flow.basis), guess=at.point.z)
    at = at.replace(flow=known)

    def judged(change, **more):
        z = at.point.z + jnp.array(change)
        trial = trial_of(z, **more)
        converged, cases = law.judged(at, trial)
        return bool(converged), [(bool(holds), state) for holds, state in cases]

    # A contact that slips as it should moves on.
    converged, cases = judged([[0.0, 0.02, 0.0], [0.0, 0.0, 0.0]])
    assert converged and not any(holds for holds, _ in cases)
    # One that slips back sticks, and the step is repeated with its place remembered.
    converged, cases = judged([[0.0, -0.02, 0.0], [0.0, 0.0, 0.0]])
    (exhausted, _), (wrong, again), (cut, _) = cases
    assert converged and wrong and not exhausted and not cut
    assert again.state.slip.tolist() == [0, 0] and again.flow.step == known.step / 4
    # One that leans too far is followed to where it does.
    converged, cases = judged([[0.0, 0.02, 0.0], [0.0, 0.5, 0.0]])
    (exhausted, _), (wrong, _), (cut, shorter) = cases
    assert converged and cut and not wrong and not exhausted
    share = (np.arctan(FRICTION) - 0.1) / 0.5
    np.testing.assert_allclose(shorter.flow.share, share, rtol=1e-9)
    assert not judged([[0.0, 0.02, 0.0], [0.0, 0.0, 0.0]], converged=False)[0]


def test_without_friction_every_solved_step_counts(smooth):
    law, march = smooth
    z = jnp.array([[1.0, 0.2, -0.1]])
    for converged in (True, False):
        solved, cases = law.judged(march, trial_of(z, converged=converged))
        assert bool(solved) == converged and cases == []
    rest = law.after_rest(march, trial_of(z), march.pending, jnp.zeros(0, bool))
    assert rest.task == Task.kick and rest.status == Status.ok
