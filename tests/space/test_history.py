"""Derivatives of paths with friction: interpolation within a step, and what a path's nodes follow from."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.space import follow_path
from jaxwhisker._space.history import interpolated, linked, measure_of, stages_before
from jaxwhisker._space.slip import radau

ROUNDING = 1e-12
TIP, FREE = (jnp.array([int(phase)]) for phase in (Phase.tip, Phase.free))


def test_within_a_step_contacts_are_on_its_polynomial():
    places, _ = radau(4)

    def z_at(t):
        return jnp.array([[0.1 * k + 0.2 * t - 0.3 * k * t**2 + 0.1 * t**4 for k in range(9)] + [1 - t**3, 0.5 * t]])

    def u_at(t):
        return 0.3 - 0.5 * t - 0.2 * t**2

    start = Point(z_at(0.0), jnp.asarray(u_at(0.0)))
    guessed = start._replace(z=start.z.at[0, 9:].set(7.0))  # of a contact that begins: its traction does not count
    stages = Point(jnp.stack([z_at(t) for t in places]), jnp.asarray(u_at(places)))
    at = jnp.asarray(u_at(0.37))
    np.testing.assert_allclose(interpolated(guessed, stages, FREE, TIP, at), z_at(0.37), atol=ROUNDING)
    np.testing.assert_allclose(interpolated(start, stages, TIP, TIP, at), z_at(0.37), atol=ROUNDING)
    np.testing.assert_allclose(interpolated(start, stages, TIP, FREE, at), start.z)
    # By the control, as by the inverse of u.
    slope = jax.jacfwd(lambda u: interpolated(start, stages, TIP, TIP, u))(at)
    np.testing.assert_allclose(slope, jax.jacfwd(z_at)(0.37) / (-0.5 - 0.4 * 0.37), atol=1e-10)


def test_a_step_begins_with_the_traction_of_its_start():
    places, _ = radau(4)
    start = Point(jnp.zeros((1, 11)).at[0, 9].set(0.3), jnp.asarray(0.0))
    rising = jnp.zeros((4, 1, 11)).at[:, 0, 9].set(0.3 + places**5)  # not a polynomial of the method
    found = interpolated(start, Point(rising, jnp.asarray(places)), TIP, TIP, jnp.asarray(0.0))
    np.testing.assert_allclose(found, start.z, atol=ROUNDING)


def test_a_measure_is_the_way_along_the_tangent():
    start = Point(jnp.zeros((1, 11)).at[0, 0].set(1.0), jnp.asarray(0.5))
    tangent = Point(jnp.zeros((1, 11)).at[0, 0].set(1.2).at[0, 9].set(5.0), jnp.asarray(0.8))
    measure = measure_of(start, tangent)
    step = Point(jnp.zeros((1, 11)).at[0, 0].set(0.4).at[0, 9].set(3.0), jnp.asarray(0.1))
    # Forces are measured in 1 + |f| = 2; tractions do not count.
    assert abs(float(measure.residual(step, jnp.zeros(1))) - (1.2 * 0.4 / 4 + 0.08)) < ROUNDING


def test_nodes_keep_their_values_and_those_of_the_drive_its_derivatives():
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.5)), friction=0.3)
    problem, stops = dimensionless(scene), jnp.array([1.0, 0.3, 0.6])
    path = Program(follow_path)(problem, stops, jnp.asarray(2)).path
    count, nodes = int(path.count), path.nodes
    links = Program(linked)(problem, path, stops)
    np.testing.assert_allclose(links.point.u[:count], nodes.point.u[:count], atol=ROUNDING)
    np.testing.assert_allclose(links.point.z[:count], nodes.point.z[:count], atol=ROUNDING)
    end = jnp.asarray(count - 1)
    np.testing.assert_allclose(links.stages.z[count - 1], stages_before(nodes, end).z)
    turn = int(np.flatnonzero(np.asarray(nodes.point.u[:count]) == 0.3)[0])
    slip = int(np.flatnonzero(np.asarray(nodes.kind[:count]) == EventKind.slip)[0])
    by_turn = Program(lambda stops: jax.jacfwd(lambda stops: linked(problem, path, stops).point.u)(stops))(stops)
    assert float(by_turn[turn, 1]) == 1
    # Where the contact slips again depends on where the drive turned: here nearly by the same distance.
    assert 0.5 < float(by_turn[slip, 1]) < 1.5
