"""Curvature of objects at contacts, against the closed forms of parabolas, circles and ellipses, and at edges."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.object import bend_at, bend_of_each
from jaxwhisker._model.objects import as_one

EXACT = 1e-10  # of radii and their first two derivatives: the parameter is found to rounding
SLOPES = jnp.array([-1.2, 0.0, 0.4, 1.3])


def radius(bend):
    return bend.speed / bend.turn


def test_radii_of_curvature_and_their_derivatives_along_a_parabola():
    def along(slope):
        x = jnp.tan(slope) / 1.4
        return radius(bend_at(jw.Parabola(0.3, 0.7), x, 0.3 + 0.7 * x**2, slope))

    def closed(slope):
        return 1 / (1.4 * jnp.cos(slope) ** 3)

    def both(function):
        def rates(slope):
            return jax.jvp(jax.value_and_grad(function), (slope,), (jnp.ones(()),))

        return jax.jit(jax.vmap(rates))(SLOPES)

    for got, expected in zip(jax.tree.leaves(both(along)), jax.tree.leaves(both(closed)), strict=True):
        np.testing.assert_allclose(got, expected, rtol=EXACT, atol=EXACT)


def test_radii_of_curvature_of_an_ellipse():
    a, b = 0.8, 0.3
    t = np.arctan2(a * np.tan(SLOPES), b)
    x, y = 0.1 + a * np.sin(t), 0.2 + b - b * np.cos(t)
    at = jax.jit(jax.vmap(lambda *contact: radius(bend_at(jw.Ellipse(0.2, a, b, 0.1), *contact))))
    expected = np.hypot(a * np.cos(t), b * np.sin(t)) ** 3 / (a * b)
    np.testing.assert_allclose(at(x, y, SLOPES), expected, rtol=EXACT)


def test_edges_turn_without_leading_anywhere_and_faces_do_not_turn():
    polygon = jw.Polygon(np.array([(-0.4, 0.5), (-0.2, 0.3), (0.0, 0.25), (0.4, 0.45)]))
    x, y, slope = jnp.array([[0.0, 0.25, 0.1], [0.1, 0.3, np.arctan(0.5)]]).T
    bend = jax.jit(jax.vmap(lambda *contact: bend_at(polygon, *contact)))(x, y, slope)
    assert abs(bend.speed[0]) < EXACT and bend.turn[0] > 0.1
    assert bend.speed[1] > 0.1 and abs(bend.turn[1]) < EXACT


def test_the_object_that_is_touched_counts_and_a_free_whisker_has_a_finite_bend():
    circles = [jw.Circle(0.3, 0.2), jw.Circle(0.4, 0.5, 2.0)]
    every, slope = as_one(tuple(circles)).in_unit(1.0), 0.3
    x = [each.position + each.radius * np.sin(slope) for each in circles]
    y = [each.distance + each.radius * (1 - np.cos(slope)) for each in circles]
    contacts = jnp.array([*x, 0.0, 0.0]), jnp.array([*y, np.nan, np.nan]), jnp.full(4, slope)
    each = jax.jit(jax.vmap(lambda number, *contact: radius(bend_of_each(every, number, contact))))
    radii = each(jnp.array([1, 2, 0, 1]), *contacts)
    np.testing.assert_allclose(radii[:2], [0.2, 0.5], rtol=EXACT)
    assert np.isfinite(radii[2]) and np.isnan(radii[3])
