"""The nearest points of objects."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._chain.gaps import nearest, outline_of
from several_cases import Wave

NEAR = 1e-9  # of distances from an object
FOOT = 1e-7  # of nearest points, on which distances depend to second order
CIRCLE = jw.Circle(0.5, 0.2, position=0.1)
ELLIPSE = jw.Ellipse(0.3, 0.8, 0.15)
GRAPH = jw.Graph(Wave(0.4, 0.05, 0.25, 0.5))


def off(one, x, y):
    """Distance of a point from an object along the normal at the nearest point."""
    p = nearest(one, outline_of(one, jnp.asarray(0.0), jnp.asarray(0.0), 1.5), x, y)
    at = one.point(p)
    return at.off(x, y), at.along(x, y)


def test_the_nearest_point_of_a_circle():
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False) + 0.1
    for distance in (-0.02, 0.0, 0.02, 0.3):
        x, y = 0.1 + (0.2 + distance) * np.cos(angle), 0.7 + (0.2 + distance) * np.sin(angle)
        away, along = jax.vmap(lambda x, y: off(CIRCLE, x, y))(jnp.asarray(x), jnp.asarray(y))
        np.testing.assert_allclose(away, distance, atol=NEAR)
        np.testing.assert_allclose(along, 0.0, atol=FOOT)


def test_the_foot_of_a_normal_is_the_nearest_point():
    for one, parameters in ((ELLIPSE, np.linspace(-1.2, 1.2, 9)), (GRAPH, np.linspace(-0.9, 0.9, 31))):
        for distance in (-1e-3, 1e-3):

            def found(p, one=one, distance=distance):
                at = one.point(p)
                return off(one, at.x + distance * at.sin, at.y - distance * at.cos)

            away, along = jax.vmap(found)(jnp.asarray(parameters))
            np.testing.assert_allclose(away, distance, atol=NEAR)
            np.testing.assert_allclose(along, 0.0, atol=FOOT)


def test_the_nearest_point_of_short_waves():
    """Shorter than the spacing of the points from which the search starts."""
    one = jw.Graph(Wave(0.4, 0.008, 0.05, 0.3))
    parameters, distance = np.linspace(-0.9, 0.9, 101), 1e-3

    def found(p):
        at = one.point(p)
        return off(one, at.x + distance * at.sin, at.y - distance * at.cos)

    away, along = jax.vmap(found)(jnp.asarray(parameters))
    np.testing.assert_allclose(away, distance, atol=NEAR)
    np.testing.assert_allclose(along, 0.0, atol=FOOT)


def test_points_far_below_waves_are_outside():
    # Between the points from which the search starts, the waves' normal turns so far that Newton's method goes astray.
    one = jw.Graph(Wave(0.327, -0.11, 0.208, 0.688))
    away, _ = jax.vmap(lambda x: off(one, x, jnp.zeros(())))(jnp.linspace(-1.4, 1.4, 561))
    assert float(jnp.min(away)) > 0
