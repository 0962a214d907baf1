"""Shapes of whole shafts against an independent integration from the base."""

import jax
import jax.numpy as jnp
import numpy as np

import several_laws as laws
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.shaft import cell_of, point_at
from jaxwhisker._chain.stance import bases_of, shafts_of
from jaxwhisker._equilibrium.contact import of_each
from several_cases import CASES
from several_engine import held, problem, reactions_at, with_contacts

SHAPE = 3e-8  # of points: stored contacts have nine decimals
CELL = 1e-6  # of polynomials of degree 5 between two points
BENT = 1e-6  # of curvatures


def line(known, arcs):
    """The stored rod at some arc lengths."""
    case = CASES["wavy"]
    k = case["control"].index(float(known.u))
    state = held(case, float(known.u), reactions_at(case, k), case["contacts"][k])
    order = np.argsort(arcs)
    found = laws.line_of(laws.Rod(), state, np.asarray(arcs)[order])[0]
    return [values[np.argsort(order)] for values in found]


def shafts(problem, u, z, state):
    return shafts_of(problem, u, problem.rest, z, state)


def test_points_lie_on_the_rod():
    for count in (1, 2):
        known = with_contacts(count)
        shaft = jax.tree.map(lambda leaf: leaf[0], jax.jit(shafts)(problem(), *known))
        beyond = np.asarray(shaft.beyond)
        _, x, y, angle, moment = line(known, np.clip(1 - beyond.ravel(), 0.0, 1.0))
        np.testing.assert_allclose(np.ravel(shaft.x), x, atol=SHAPE)
        np.testing.assert_allclose(np.ravel(shaft.y), y, atol=SHAPE)
        np.testing.assert_allclose(np.ravel(shaft.cos), np.cos(angle), atol=10 * SHAPE)
        np.testing.assert_allclose(np.ravel(shaft.curvature), moment, atol=BENT)
        assert np.all(np.diff(beyond.ravel()) >= -1e-12) and beyond[0, 0] == 0
        assert shaft.starts.tolist() == [-1, 0, 0 if count == 2 else -1]


def test_a_cell_lies_between_its_points():
    known = with_contacts(2)

    def middle(problem, u, z, state):
        shaft = jax.tree.map(lambda leaf: leaf[0], shafts(problem, u, z, state))
        cell = cell_of(shaft, jnp.asarray(2), jnp.asarray(5))
        return cell.beyond, cell.length, cell.point(jnp.asarray(0.5)), cell.direction(jnp.asarray(0.5))

    beyond, length, point, direction = jax.jit(middle)(problem(), *known)
    _, x, y, angle, _ = line(known, np.array([1 - float(beyond) - float(length) / 2]))
    np.testing.assert_allclose(point, [x[0], y[0]], atol=CELL)
    np.testing.assert_allclose(direction, -float(length) * np.array([np.cos(angle[0]), np.sin(angle[0])]), atol=CELL)


def test_a_point_by_the_arc_length_beyond_it():
    known = with_contacts(2)

    def point(problem, u, z, state, beyond):
        own = z[None], jax.tree.map(lambda leaf: leaf[None], state), bases_of(problem, u, problem.rest), beyond[None]
        return of_each(problem.bodies(u), point_at, *own)[0]

    for beyond in (0.0, 0.02, 0.3, 0.9):
        found = jax.jit(point)(problem(), *known, jnp.asarray(beyond))
        _, x, y, _, _ = line(known, np.array([1 - beyond]))
        np.testing.assert_allclose(found, [x[0], y[0]], atol=SHAPE)


def test_a_free_shaft_is_straight():
    known = with_contacts(1)
    free = ChainState(jnp.zeros(2, int), jnp.ones(2), jnp.zeros(2, int))
    shaft = jax.jit(shafts)(problem(), known.u, jnp.zeros((2, 3)), free)
    np.testing.assert_allclose(shaft.x, float(known.u), atol=1e-12)
    np.testing.assert_allclose(np.asarray(shaft.y), 1 - np.asarray(shaft.beyond), atol=1e-12)
