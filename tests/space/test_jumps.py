"""What whiskers meet on the way of a jump."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._scan.space import follow_path_now, problem_now
from jaxwhisker._space.jumps import _ways, distances, met_on_the_way

ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
ROD = jw.Cylinder(0.2, (0.0, 0.8, 0.0), (0.0, 0.3, 1.0))
MET = 2e-6  # lengths: what is met is 1e-6 deep
RESAMPLED = 1e-5  # lengths: tangents are interpolated between points of the shaft
INEXTENSIBLE = 1e-3  # lengths: shapes on the way are sums of 32 steps


def problem(x, z, radius=0.01):
    peg = jw.Cylinder(radius, (x, 0.8, z), (0.0, 0.3, 1.0))
    return problem_now(jw.SpaceScene(jw.Whisker(), (ROD, peg), motion=ALONG))


def bent():
    """The control and the contact before the whisker snaps off the rod, with a peg behind it."""
    path = follow_path_now(problem(3.0, 0.0), np.array([-0.3, 0.43]), np.asarray(1)).path
    last = int(path.count) - 1
    return jnp.asarray(path.nodes.point.u[last]), path.nodes.point.z[last], path.nodes.state.phase[last]


FREE = jnp.array([int(Phase.free)])
met = jax.jit(met_on_the_way)
ways = jax.jit(_ways)


@pytest.mark.parametrize(
    ("x", "z", "some"), [(-0.3, 0.1, True), (-0.3, -0.5, True), (-0.3, 2.0, False), (0.5, 0.1, False)]
)
def test_pegs_in_the_way_are_met_first_where_the_shaft_comes_to_them(x, z, some):
    u, contact, phase = bent()
    own = problem(x, z)
    found = met(own, u, (contact, phase), (contact, FREE), jnp.asarray(True))
    assert bool(found.some[0]) == some
    if some:  # on the side from which the whisker comes
        point = found.contact[0, 3:6]
        off = own.surface.of_each(lambda one: one.off(point))
        assert abs(off[1]) < MET and off[0] > 0 and own.surface.gradient(point)[0] > 0
        assert 0 < found.contact[0, 0] < contact[0, 0]


def test_nothing_is_met_without_a_jump_nor_the_object_that_is_left():
    u, contact, phase = bent()
    own = problem(-0.3, 0.1)
    assert not met(own, u, (contact, phase), (contact, FREE), jnp.asarray(False)).some[0]
    only_left = problem(5.0, 0.0)
    assert not met(only_left, u, (contact, phase), (contact, FREE), jnp.asarray(True)).some[0]


def test_shapes_on_the_way_begin_and_end_as_they_should_and_do_not_stretch():
    u, contact, phase = bent()
    own = problem(-0.3, 0.1)
    way = jax.tree.map(lambda leaf: leaf[0], ways(own, u, (contact, phase), (contact, FREE)))
    assert way.touched.tolist() == [True, False] and not np.any(way.lands)
    np.testing.assert_allclose(way.at(jnp.asarray(0.0)).position, way.before.position, atol=RESAMPLED)
    np.testing.assert_allclose(way.at(jnp.asarray(1.0)).position, way.after.position, atol=RESAMPLED)
    np.testing.assert_allclose(distances(own.surface, way.before)[0], 0.0, atol=1e-5)
    middle = way.at(jnp.asarray(0.5)).position
    np.testing.assert_allclose(np.linalg.norm(np.diff(middle, axis=0), axis=1), 1 / 32, atol=INEXTENSIBLE)
