"""A path with friction ends at a snap that gains energy."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import FORCE
from jaxwhisker._path.path import Status, is_snap
from jaxwhisker._plane.gains import without_gains
from jaxwhisker._scan.plane import follow_path_now
from jaxwhisker._scan.route import across
from scenes import model

SOFT = 10.0  # a whisker on this spring snaps past the vertex
cut_now = Program(without_gains)


@pytest.fixture(scope="module")
def followed():
    """A problem with friction, its path, and the index of the first snap."""
    scene = model("FB", SOFT)
    problem = dimensionless(jw.Scene(scene.whisker, scene.profile, scene.support, friction=0.2))
    path = follow_path_now(problem, *map(np.asarray, across())).path
    assert int(path.status) == Status.ok
    return problem, path, int(np.argmax(is_snap(path.nodes.kind)))


def test_a_path_that_loses_energy_stays_as_it_is(followed):
    problem, path, snap = followed
    assert 0 < snap < int(path.count)
    for kept, given in zip(*map(jax.tree.leaves, (cut_now(problem, path), path)), strict=True):
        np.testing.assert_array_equal(kept, given)


@pytest.mark.parametrize(("share", "cut"), [(0.9, False), (1.1, True)])
def test_a_path_ends_at_a_snap_to_a_higher_energy(followed, share, cut):
    # After the snap, the whisker bears this share of the force that it bore before, in the same contact.
    problem, path, snap = followed
    nodes = path.nodes
    z = nodes.point.z.at[snap].set(nodes.z_before[snap].at[:, FORCE].multiply(share))
    state = jax.tree.map(lambda after, before: after.at[snap].set(before[snap]), nodes.state, nodes.before)
    found = cut_now(problem, path._replace(nodes=nodes._replace(point=nodes.point._replace(z=z), state=state)))
    assert int(found.status) == (Status.unsettled if cut else Status.ok)
    assert int(found.count) == (snap if cut else path.count)


@pytest.mark.unchecked  # the path is not used
def test_whiskers_without_friction_are_not_checked():
    problem = dimensionless(model("FB", SOFT))
    assert cut_now.function(problem, "any path") == "any path"
