"""The march: order of events and nodes, several whiskers, reversals."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import across
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.contact import FORCE
from jaxwhisker._space.march import capacity_of
from jaxwhisker._space.march_state import SETTLED
from random_space import drawn

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


def rough(seed):
    """A random curved whisker with friction."""
    rng = np.random.default_rng([11, seed])
    smooth, friction = drawn("curved clamped linear", rng).scene, float(rng.uniform(0.05, 0.6))
    return problem_now(eqx.tree_at(lambda scene: scene.friction, smooth, friction, is_leaf=lambda x: x is None))


def test_with_friction_a_snap_begins_exactly_where_the_drive_would_turn():
    """A curved whisker whose slip loses its stability; found by steps that approach the loss, it was not."""
    stops, last = across()
    path = follow_path_now(rough(7), stops, np.asarray(last)).path
    assert int(path.status) == Status.ok
    snaps = np.flatnonzero(np.asarray(path.nodes.kind)[: int(path.count)] == jw.EventKind.snap_through)
    assert snaps.size > 0
    assert np.all(np.abs(np.asarray(path.nodes.arriving.u)[snaps - 1]) < EXACT)


def test_contacts_that_can_neither_stick_nor_slip_settle_at_a_node_of_their_own():
    """Where the drive turns. States of the step before do not lie on the way to where the contact rests."""
    stops = np.array([-0.5184741588406334, 0.27161288730834443, -0.5184741588406334])
    path = follow_path_now(rough(21), stops, np.asarray(2)).path
    assert int(path.status) == Status.ok
    rests = np.flatnonzero(np.asarray(path.nodes.kind)[: int(path.count)] == SETTLED)
    assert rests.size > 0
    np.testing.assert_array_equal(path.nodes.z_before[rests], path.nodes.point.z[rests - 1])


def test_paths_have_room_for_every_whisker_and_every_leg_of_the_drive():
    """Two coupled whiskers that go there and back need more than twice the nodes of one whisker."""
    springs = tuple(jw.Spring(ends, 70.0, 0.1) for ends in ((0, 1), (1, 2)))
    support = jw.Support((*springs, jw.Spring((0, 1), 40.0, axis="z"), jw.Spring((1, 2), 30.0, axis="z")))
    two = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), support))
    one = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2))))
    assert capacity_of(two, 3) > 2 * capacity_of(one, 2)
