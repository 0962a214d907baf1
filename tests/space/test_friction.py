"""Friction in space: where contacts stick and slip, settle, and lose their stability."""

import equinox as eqx
import numpy as np

import jaxwhisker as jw
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import across
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.march_state import SETTLED
from random_space import drawn

EXACT = 1e-8  # events are solved for to 1e-10


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
