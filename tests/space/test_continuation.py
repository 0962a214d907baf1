"""The march in space: margins, order of events and nodes, several whiskers, reversals, where a scan ends."""

# pyright: reportArgumentType=false

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import Status
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.contact import FORCE, SLACK, UNKNOWNS
from jaxwhisker._space.continuation import PASSED, TOUCHING
from jaxwhisker._space.free import Nearest
from jaxwhisker._space.friction import continuation_of
from jaxwhisker._space.march_state import AT_STOP, GRIP, LOSS, PHASE, RELEASE, TOUCH
from jaxwhisker._space.stance import SpaceStance

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
EXACT = 1e-8  # events are solved for to 1e-10


def scene(*offsets):
    """Clamped whiskers beside each other, scanned past a sphere."""
    mounts = tuple(jw.Mount(z=z) for z in offsets)
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), jw.Support(mount=mounts), motion=ALONG)


@pytest.fixture(scope="module")
def path():
    """The path of one whisker there and back."""
    stops = np.array([-1.2, 1.2, -1.2])
    return follow_path_now(problem_now(scene(0.2)), stops, np.asarray(2)).path


def test_nodes_are_equilibria_with_a_push_in_the_order_of_travel(path):
    count = int(path.count)
    assert int(path.status) == Status.ok
    assert np.all(np.diff(np.asarray(path.nodes.travel)[:count]) >= -EXACT)
    assert np.all(np.asarray(path.nodes.point.z)[:count, :, FORCE] >= -EXACT)
    assert np.all(np.isfinite(np.asarray(path.nodes.point.z)[:count]))


def test_events_come_in_the_same_places_on_the_way_back(path):
    kind = np.asarray(path.nodes.kind)[: int(path.count)]
    u = np.asarray(path.nodes.point.u)[: int(path.count)][kind >= 0]
    assert kind[kind >= 0].tolist() == 2 * [jw.EventKind.touch, 1, 3, jw.EventKind.release]
    np.testing.assert_allclose(u[4:], u[3::-1], atol=EXACT)
    np.testing.assert_allclose(u[:4], -u[3::-1], atol=EXACT)  # the sphere is symmetric


def test_clamped_whiskers_beside_each_other_do_not_know_of_each_other():
    control = np.linspace(-1.1, 0.5, 17)
    both = jw.scan(scene(0.2, -0.35), control)
    for k, offset in enumerate((0.2, -0.35)):
        one = jw.scan(scene(offset), control)
        np.testing.assert_allclose(both.force[:, k], one.force[:, 0], atol=EXACT)
        np.testing.assert_allclose(both.contact_arc[:, k], one.contact_arc[:, 0], atol=EXACT)
        found = [(event.kind, event.control) for event in both.events if event.whiskers == (k + 1,)]
        assert [kind for kind, _ in found] == [event.kind for event in one.events]
        np.testing.assert_allclose([u for _, u in found], [event.control for event in one.events], atol=EXACT)


def test_a_scan_may_begin_in_contact():
    whole, inside = jw.scan(scene(0.2), np.linspace(-1.2, 0.4, 9)), jw.scan(scene(0.2), np.array([0.0, 0.4]))
    np.testing.assert_allclose(inside.force, np.asarray(whole.force)[[6, 8]], atol=EXACT)
    assert jnp.all(inside.contact_force > 1)


def test_paths_have_room_for_every_whisker_and_every_leg_of_the_drive():
    """Two coupled whiskers that go there and back need more than twice the nodes of one whisker."""
    springs = tuple(jw.Spring(ends, 70.0, 0.1) for ends in ((0, 1), (1, 2)))
    support = jw.Support((*springs, jw.Spring((0, 1), 40.0, axis="z"), jw.Spring((1, 2), 30.0, axis="z")))
    two = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), support))
    one = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2))))
    assert continuation_of(two).capacity(3) > 2 * continuation_of(one).capacity(2)


FREE, TIP, TANGENTIAL = (int(phase) for phase in (Phase.free, Phase.tip, Phase.tangential))


def margins(phase, force=0.0, slack=0.0, distance=1.0, grip=None, onwards=0.5):
    """Margins of one whisker, by kind; the drive is 0.25 before its stop, and moves on at this rate."""
    z = jnp.zeros((1, UNKNOWNS)).at[0, FORCE].set(force).at[0, SLACK].set(slack)
    nearest, good = Nearest(jnp.array([distance]), z, jnp.array([TIP])), jnp.asarray(True)
    one, grip = jnp.asarray(1.0), None if grip is None else jnp.array([grip])
    stance = SpaceStance(jnp.array([phase == FREE]), nearest, jnp.array([distance]), one, good, one, good, grip, good)
    point, tangent = Point(z, jnp.asarray(-0.25)), Point(z, jnp.asarray(onwards))
    march = SimpleNamespace(phase=jnp.array([phase]), direction=1.0, drive_rate=lambda tangent: tangent.u)
    problem = SimpleNamespace(friction=None if grip is None else 0.3)
    at = SimpleNamespace(point=point, tangent=tangent, stance=stance)
    return [float(margin[0]) for margin in continuation_of(problem).margins(march, at, jnp.asarray(0.0))]


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_free_whiskers_may_only_touch():
    found = margins(FREE, distance=0.3)
    assert (
        found[TOUCH] == 0.3 + TOUCHING
        and np.isinf(found[RELEASE])
        and np.isinf(found[PHASE])
        and found[AT_STOP] == 0.25
    )


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_contacts_end_without_force_and_change_their_phase_without_slack():
    tip, shaft = margins(TIP, force=2.0, slack=-0.1), margins(TANGENTIAL, force=2.0, slack=0.3)
    assert tip[RELEASE] == shaft[RELEASE] == 2.0
    assert tip[PHASE] == 0.1 and shaft[PHASE] == 0.3
    assert np.isinf(tip[TOUCH]) and np.isinf(shaft[TOUCH])


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_only_contacts_with_friction_may_stick_or_slip():
    assert len(margins(TIP)) == 4
    assert margins(TIP, grip=0.2)[GRIP] == 0.2


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_with_friction_stability_is_lost_where_the_drive_turns():
    assert margins(TIP, grip=0.2, onwards=0.1)[LOSS] == 0.1
    assert np.isinf(margins(FREE, grip=0.2, onwards=-0.1)[LOSS])


@pytest.mark.unchecked  # stand-ins have only the fields that are used
def test_a_stop_in_the_same_step_as_a_touch_is_not_overlooked():
    """Margins of a contact that begins vanish where it does; that of the drive does not."""
    touches = jnp.array([True])
    march = SimpleNamespace(target=SimpleNamespace(number=jnp.asarray(TOUCH), whiskers=touches))
    for friction in (None, 0.3):
        mechanics = continuation_of(SimpleNamespace(friction=friction))
        solved = mechanics.solved_margins(march, touches, jnp.asarray(0.1))
        assert not solved[AT_STOP].any()
        assert all(own.all() for kind, own in enumerate(solved) if kind != AT_STOP)


def test_a_default_scan_ends_shortly_after_the_release():
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))
    result = jw.scan(scene)
    (release,) = result.events.of(jw.EventKind.release)
    assert 0 < float(result.control[-1]) - release.control < PASSED
