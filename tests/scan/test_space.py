"""Steps of a scan in space: between the nodes of the path, at its events, and beyond its end; their signals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.slopes import solved_states_now
from jaxwhisker._scan.space import Space, follow_path_now, problem_now
from jaxwhisker._scan.steps import interpolate

PREDICTED = 1e-3  # by the path between its nodes
EXACT = 1e-10
SOLVED = 1e-8  # reactions of solved steps
CENTRE = 0.0, 1.3, 0.2
STOPS = np.array([1.0, -0.9])


@pytest.fixture(scope="module")
def result():
    """A scan of a clamped whisker past a sphere."""
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, CENTRE), motion=jw.LinearDrive((-1.0, 0.0, 0.0)))
    return jw.scan(scene, np.linspace(-1.2, 1.2, 49))


def problem_and_path():
    problem = problem_now(jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, -0.2))))
    route, _ = route_through(STOPS)
    return problem, follow_path_now(problem, route.stops, np.asarray(route.last)).path


def solve(problem, path, control):
    control = np.asarray(control, dtype=float)
    return solved_states_now(Space, problem, path, control, STOPS[0] - control, None)[-1]


def test_the_path_predicts_the_contacts_between_its_nodes():
    problem, path = problem_and_path()
    touching = np.flatnonzero(np.asarray(path.nodes.state.phase)[: int(path.count) - 1, 0] != Phase.free)
    u = np.asarray(path.nodes.point.u)
    middle = (u[touching] + u[touching + 1]) / 2
    at = jax.vmap(lambda index, u: interpolate(path, index, u))(jnp.asarray(touching), jnp.asarray(middle))
    found = solve(problem, path, middle)
    assert np.all(found.status == Status.ok)
    assert touching.size > 10
    np.testing.assert_allclose(at.z, found.z, atol=PREDICTED)
    # At a node, it is the node.
    here = interpolate(path, jnp.asarray(touching[5]), jnp.asarray(u[touching[5]]))
    np.testing.assert_allclose(here.z, path.nodes.point.z[touching[5]], atol=EXACT)


def test_a_step_at_an_event_belongs_to_the_phase_that_begins():
    problem, path = problem_and_path()
    touch = int(np.flatnonzero(np.asarray(path.nodes.kind)[: int(path.count)] == jw.EventKind.touch)[0])
    u = float(path.nodes.point.u[touch])
    found = solve(problem, path, [u + 1e-9, u, u - 1e-9])
    assert list(found.state[:, 0]) == [Phase.free, Phase.tip, Phase.tip]


def test_steps_beyond_the_end_of_a_path_have_its_status():
    problem, path = problem_and_path()
    cut = path._replace(count=jnp.asarray(12), status=jnp.asarray(int(Status.lost)))
    u = np.asarray(path.nodes.point.u)
    found = solve(problem, cut, [u[10], u[11] - 0.01])
    assert list(found.status) == [Status.ok, Status.lost]
    assert found.state[1, 0] == Phase.free


def test_reactions_balance_the_contact_force_at_the_contact(result):
    point = np.stack([result.contact_x, result.contact_y, result.contact_z], axis=-1)
    base = np.stack([result.base_x, result.base_y, result.base_z], axis=-1)
    touching = np.asarray(result.phase) > 0
    out = (point - CENTRE)[touching]
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1.0, atol=SOLVED)
    push = np.asarray(result.contact_force)[touching][:, None] * out
    np.testing.assert_allclose(np.asarray(result.force)[touching], -push, atol=SOLVED)
    np.testing.assert_allclose(
        np.asarray(result.moment)[touching], -np.cross((point - base)[touching], push), atol=SOLVED
    )
    assert np.all(np.asarray(result.force)[~touching] == 0)


def test_in_the_frame_of_the_whisker_a_straight_one_has_no_twisting_moment(result):
    np.testing.assert_allclose(np.asarray(result.own_moment)[..., 2], 0.0, atol=SOLVED)
    np.testing.assert_allclose(
        np.sum(np.asarray(result.own_force) ** 2, axis=-1), np.sum(np.asarray(result.force) ** 2, axis=-1), atol=SOLVED
    )
