"""The steps of a scan: exact states between nodes that are given by hand, and reasons for failure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import contacts, scene
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Point, scale_of
from jaxwhisker._path.path import NO_EVENT, Node, Path
from jaxwhisker._scan.plane import InThePlane
from jaxwhisker._scan.steps import interpolate, solved_states

EXACT = 1e-9  # relative: solved from whatever is near
CUBIC = 1e-12  # between two nodes of a cubic
STIFFNESS, REST = 70.0, 0.2
ROOM = 6  # nodes of a path
FIRST = 0.5  # control at which travel begins

PROBLEM = dimensionless(scene(jw.Support.fb(STIFFNESS, REST)))
interpolated = Program(interpolate)


@Program
def solved_steps(problem, path, control, travel):
    return solved_states(InThePlane, problem, path, control, travel)[:2]


def controls_of(at, stiffness=STIFFNESS):
    return at.base_x - REST - at.force_x / stiffness


def path_through(p, bend=1.0, status=jw.Status.ok, stiffness=STIFFNESS):
    """A path whose nodes are exact; the tangents are chords to a contact further on, `bend` times as steep."""
    here, ahead = contacts(*p), contacts(*(np.array(p) + 1e-4))
    count, room = len(p), ((0, ROOM - len(p)), (0, 0), (0, 0))
    z, u = here.z[:, None, :], controls_of(here, stiffness)
    scale = np.asarray(jax.vmap(scale_of)(jnp.asarray(z)))
    dz, du = bend * (ahead.z[:, None, :] - z), controls_of(ahead, stiffness) - u
    length = np.sqrt(np.sum((dz / scale) ** 2, axis=(1, 2)) + du**2)
    leaving = Point(
        jnp.asarray(np.pad(dz / length[:, None, None], room)), jnp.asarray(np.pad(du / length, (0, ROOM - count)))
    )
    phase = jnp.asarray(np.pad(here.phase[:, None], room[:2]))
    state, none = ContactState(phase, jnp.ones((ROOM, 1))), jnp.zeros((ROOM, 1), bool)
    control = jnp.asarray(np.pad(u, (0, ROOM - count)))
    point = Point(jnp.asarray(np.pad(z, room)), control)
    travel, kind = FIRST - control, jnp.full(ROOM, NO_EVENT)
    nodes = Node(point, point.z, leaving, leaving, state, state, travel, kind, none)
    return Path(nodes, jnp.asarray(count), jnp.asarray(int(status)))


def scanned(path, p, problem=PROBLEM):
    """State and status at these parameters of the clamped branch."""
    at = contacts(*p)
    u = jnp.asarray(controls_of(at))
    state, status = solved_steps(problem, path, u, FIRST - u)
    return at, state, [jw.Status(int(s)).name for s in status]


NODES = (0.8, 0.9, 1.0, 1.1)  # of tangential contact, on both sides of the vertex
BETWEEN = (0.8, 0.85, 0.97, 1.0, 1.06)


@pytest.mark.parametrize("bend", [1.0, 0.8], ids=["good tangents", "poor tangents"])
def test_states_are_exact_whatever_the_interpolation(bend):
    at, state, status = scanned(path_through(NODES, bend), BETWEEN)
    assert set(status) == {"ok"}
    for value, expected in [
        (state.base_x, at.base_x),
        (state.fx, -at.force_x),
        (state.mz, at.mz),
        (state.contact_force, at.z[:, 0]),
        (state.contact_slope, at.z[:, 1]),
        (state.contact_arc, 1 - at.z[:, 2]),
    ]:
        np.testing.assert_allclose(value[:, 0], expected, rtol=EXACT, atol=EXACT)
    assert np.all(state.phase == jw.Phase.tangential)
    assert np.all(state.base_y == 0) and np.all(state.base_angle == 0)


def test_travel_selects_the_node_before_a_step():
    # The last node is reached after a travel of 5, and leads into tip contact.
    out, back = contacts(0.7), contacts(0.1)
    path = path_through((0.4, 0.7, 1.0, 1.3))
    at = path.nodes.point
    path = path._replace(
        nodes=path.nodes._replace(
            point=Point(at.z.at[3].set(jnp.asarray(back.z)), jnp.asarray(at.u).at[3].set(controls_of(back)[0])),
            z_before=at.z.at[3].set(jnp.asarray(back.z)),
            state=path.nodes.state._replace(phase=path.nodes.state.phase.at[3].set(int(back.phase[0]))),
            travel=path.nodes.travel.at[3].set(5.0),
        )
    )
    u = jnp.asarray(np.array([controls_of(out)[0], controls_of(back)[0]] * 2 + [controls_of(out)[0]]))
    state, status = solved_steps(PROBLEM, path, u, jnp.array([FIRST - u[0], 5.0, FIRST - u[0], 6.0, FIRST - u[0]]))
    assert np.all(status == jw.Status.ok)
    expected = [out.z[0, 0], back.z[0, 0]] * 2 + [out.z[0, 0]]
    np.testing.assert_allclose(state.contact_force[:, 0], expected, rtol=EXACT)
    assert state.phase[:, 0].tolist() == [2, 1, 2, 1, 2]


def test_beyond_the_end_of_a_path_the_reason_for_its_end_counts():
    p = (0.85, 0.97, 1.06, 1.1, 1.11)
    for reason in (jw.Status.lost, jw.Status.not_convex):
        at, state, status = scanned(path_through(NODES, status=reason), p)
        assert status == ["ok"] * 4 + [reason.name]
        assert np.all(np.isfinite(state.fx[:4])) and np.isnan(state.fx[4, 0]) and np.isnan(state.base_x[4, 0])
        assert state.phase[4, 0] == jw.Phase.free
        np.testing.assert_allclose(state.mz[:4, 0], at.mz[:4], rtol=EXACT)
    # A path that ended well goes on in its last mode.
    *_, status = scanned(path_through(NODES), p)
    assert set(status) == {"ok"}
    # No node at all.
    empty = path_through(NODES, status=jw.Status.too_long)._replace(count=jnp.asarray(0))
    *_, status = scanned(empty, p)
    assert set(status) == {"too_long"}


def test_an_invalid_problem_has_no_steps():
    invalid = eqx.tree_at(lambda problem: problem.valid, PROBLEM, jnp.asarray(False))
    _, state, status = scanned(path_through(NODES), BETWEEN, invalid)
    assert set(status) == {"invalid"} and np.all(np.isnan(state.mz))


def test_a_solution_far_from_the_interpolation_is_inexact():
    path = path_through(NODES)
    z = path.nodes.point.z
    wrong = path._replace(
        nodes=path.nodes._replace(
            point=path.nodes.point._replace(z=z.at[:, :, 1].add(0.3)), z_before=z.at[:, :, 1].add(0.3)
        )
    )
    _, state, status = scanned(wrong, BETWEEN)
    assert set(status) == {"inexact"} and np.all(np.isnan(state.fx))


def test_an_equilibrium_between_two_folds_is_unstable():
    # Before the vertex, a soft spring is weaker than the slope of the contact force: there the drive moves back.
    soft = 15.0
    problem = dimensionless(scene(jw.Support.fb(soft, REST)))
    path, at = path_through((0.8, 0.83, 0.86, 0.89), stiffness=soft), contacts(0.81, 0.82, 0.84, 0.85, 0.88)
    u, nodes = jnp.asarray(controls_of(at, soft)), jnp.asarray(path.nodes.point.u)
    first = nodes[0]
    assert np.all(u > first)
    path = path._replace(nodes=path.nodes._replace(travel=nodes - first))
    state, status = solved_steps(problem, path, u, u - first)
    assert np.all(status == jw.Status.unstable)
    assert np.all(np.isnan(state.fx)) and np.all(state.phase == jw.Phase.free)


def test_a_cubic_path_is_interpolated_exactly():
    # z and u by arc length s: the straight line along the first direction, and a cubic across it.
    along, across = np.array([0.0, 0.8, 0.0, -0.6]), np.array([0.1, 0.6, -0.3, 0.8])
    start, end = np.array([0.0, 0.4, -0.2, 0.5]), 0.5

    def curve(s):
        return start + s * along + (0.3 * s**2 - 0.2 * s**3) * across

    def points(*rows):
        padded = jnp.asarray(np.array([*rows, *[rows[-1]] * (ROOM - len(rows))]))
        return Point(padded[:, None, :3], padded[:, 3])

    there = along + (0.6 * end - 0.6 * end**2) * across
    directions = points(along, there / np.linalg.norm(there))
    here = points(start, curve(end))
    path = path_through(NODES)
    nodes = path.nodes._replace(point=here, z_before=here.z, arriving=directions, leaving=directions)
    path = path._replace(nodes=nodes, count=jnp.asarray(2))
    for s in (0.0, 0.1, 0.37, 0.5):
        found = interpolated(path, jnp.asarray(0), jnp.asarray(curve(s)[3]))
        np.testing.assert_allclose([*found.z[0], found.u], curve(s), atol=CUBIC)
    # Behind its last node, a path stays there.
    found = interpolated(path, jnp.asarray(1), jnp.asarray(-3.0))
    np.testing.assert_allclose([*found.z[0], found.u], [*curve(end)[:3], -3.0], atol=CUBIC)
