"""Outlines of several objects: each object keeps its own points, and parameters of different ones are apart."""

from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.outline import APART, ObjectChain, number_of, objects_at, outline, samples
from jaxwhisker._model.objects import as_one

CORNERS = np.array([(1.6, 0.6), (1.8, 0.4), (2.0, 0.35), (2.3, 0.5)])
POLYGON: Any = jw.Polygon(CORNERS)
EACH = jw.Circle(0.3, 0.2), POLYGON, jw.Parabola(0.5, 1.0, 4.0)
CHAIN: Any = outline(as_one(EACH).in_unit(1.0))
EXACT = 1e-12


def own(k, share):
    """A parameter of an object, at this share of the way from its first to its last point."""
    first, last = (float(end) for end in EACH[k].span())
    return first + share * (last - first)


def test_a_single_object_is_its_own_outline():
    circle = EACH[0]
    assert outline(circle) is circle
    ((alone, parameter, is_own),) = objects_at(circle, jnp.asarray(0.3))
    assert alone is circle and parameter == 0.3 and is_own
    np.testing.assert_allclose(samples(circle, 3), [-np.pi, 0.0, np.pi])  # all around: whiskers reach behind it
    assert number_of(circle, jnp.zeros(4)).tolist() == [0, 0, 0, 0]


def test_parameters_of_objects_lie_one_after_the_other():
    assert isinstance(CHAIN, ObjectChain)
    spans = [[float(end + shift) for end in one.span()] for one, shift in zip(EACH, CHAIN.shift, strict=True)]
    assert spans[0][0] == 0.0 and CHAIN.ends() == (spans[0][0], spans[-1][1])
    for before, after in pairwise(spans):
        np.testing.assert_allclose(after[0] - before[1], APART, atol=EXACT)
    count = 5
    parameters = samples(CHAIN, count)
    expected = [np.linspace(first, last, count) for first, last in spans]
    np.testing.assert_allclose(parameters, np.concatenate(expected), atol=EXACT)
    assert number_of(CHAIN, parameters).tolist() == np.repeat(range(3), count).tolist()
    # A step of an iteration beyond an end is still one of the same object.
    assert number_of(CHAIN, jnp.ravel(jnp.asarray(spans)) + jnp.array([-1.0, 1.0] * 3)).tolist() == [0, 0, 1, 1, 2, 2]


def test_points_and_their_derivatives_are_those_of_the_object():
    shares = [0.3, 0.55, 0.9]
    at = [(k, own(k, share), CHAIN.shift[k]) for k in range(3) for share in shares]
    parameters = jnp.array([parameter + shift for _, parameter, shift in at])

    @jax.jit
    def chained(parameters):
        forward = jax.jacfwd(lambda p: jnp.stack(CHAIN.point(p)))
        return jax.vmap(lambda p: (jnp.stack(CHAIN.point(p)), forward(p), CHAIN.piece_at(p)))(parameters)

    @jax.jit
    def alone():
        each = [jax.jvp(lambda p, k=k: jnp.stack(EACH[k].point(p)), (p,), (jnp.ones(()),)) for k, p, _ in at]
        return [jnp.stack(values) for values in zip(*each, strict=True)]

    points, rates, pieces = chained(parameters)
    expected = alone()
    np.testing.assert_allclose(points, expected[0], atol=EXACT)
    np.testing.assert_allclose(rates, expected[1], atol=EXACT)
    # Edges have even numbers, and a smooth object is an arc.
    assert np.all(pieces[:3] == 1) and np.all(pieces[6:] == 1)
    assert pieces[3:6].tolist() == [int(POLYGON.piece_at(jnp.asarray(own(1, share)))) for share in shares]
    assert CHAIN.has_edges and not outline(as_one((EACH[0], EACH[2])).in_unit(1.0)).has_edges


def test_each_object_and_its_own_parameter():
    for k in range(3):
        objects = objects_at(CHAIN, jnp.asarray(own(k, 0.4) + CHAIN.shift[k]))
        assert [one is each for (one, _, _), each in zip(objects, CHAIN.each, strict=True)] == [True] * 3
        assert [bool(is_own) for _, _, is_own in objects] == [n == k for n in range(3)]
        # The parameters of the others mean nothing, but are on them.
        expected = [own(n, 0.4) if n == k else one.lowest() for n, one in enumerate(EACH)]
        found = np.array([float(parameter) for _, parameter, _ in objects])
        np.testing.assert_allclose(found, np.array(expected, float), atol=EXACT)


def test_objects_that_the_parameter_is_not_on_have_no_derivatives():
    def height(distances, parameter):
        both = as_one((jw.Circle(distances[0], 0.2), jw.Circle(distances[1], 0.2, 2.0)))
        return outline(both.in_unit(1.0)).point(parameter).y

    slopes = jax.jit(jax.vmap(jax.jacrev(height), in_axes=(None, 0)))
    by = slopes(jnp.array([0.3, 0.4]), jnp.array([np.pi + 0.2, 3 * np.pi + APART + 0.2]))
    np.testing.assert_allclose(by, np.eye(2), atol=EXACT)
