"""Depths of shafts inside objects, against geometry."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._dynamics.gap import Posed
from jaxwhisker._dynamics.inside import deepest
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.outline import outline
from jaxwhisker._model.objects import as_one

N = 4
POINTS = basis(N).points
EXACT = 1e-7  # of the depth: error of the cubics in the cells


def straight(profile, x, lean=0.0):
    return Posed(basis(N), profile, jnp.ones(()), jnp.array([x, 0.0]), jnp.pi / 2 + lean + jnp.zeros(POINTS.size))


def test_a_shaft_that_leans_over_a_corner_is_as_deep_as_where_both_faces_are_as_near():
    """A whisker that is closest to the flank of a box leans over the lower corner (0.4, 0.5)."""
    lean, profile = 0.3, jw.Box(0.5, 0.8, 0.5)

    @eqx.filter_jit
    def leaning(profile, insides, parameters):
        at = jax.vmap(profile.point)(parameters)
        flank = parameters[jnp.argmin(jnp.hypot(at.x - 0.4, at.y - 0.8))]
        base = 0.4 - 0.5 * jnp.tan(lean) - insides / jnp.cos(lean)
        return jax.vmap(lambda x: deepest(straight(profile, x, -lean), flank))(base)

    insides = np.array([0.003, 0.02])
    depths = leaning(profile, jnp.array([*insides, -0.003, -0.02]), jnp.linspace(*profile.ends(), 4001))
    np.testing.assert_allclose(depths[:2], -insides / (np.sin(lean) + np.cos(lean)), atol=EXACT)
    assert depths[2:].tolist() == [np.inf, np.inf]


def test_a_shaft_through_a_circle_is_as_deep_as_its_line_is_close_to_the_centre():
    circle, lean = jw.Circle(0.3, 0.2), 0.2
    inside = np.array([0.05, 1e-3, 1e-5, -0.01, np.nan])  # the third is less than is accepted
    x = (0.2 - inside) / np.cos(lean) + 0.5 * np.tan(lean)
    parameter = jnp.asarray(np.pi / 2 + lean)
    depth = jax.jit(jax.vmap(lambda x: deepest(straight(circle, x, lean), parameter)))(jnp.asarray(x))
    np.testing.assert_allclose(depth[:2], -inside[:2], atol=EXACT)
    assert not np.any(np.isfinite(depth[2:]))


def test_only_the_object_with_the_closest_point_counts():
    profile = outline(as_one((jw.Circle(0.3, 0.2), jw.Circle(0.3, 0.2, 1.0))).in_unit(1.0))
    within = straight(profile, 0.9)  # inside the second one
    on_first, on_second = (jnp.pi * (1 + share) + number * (2 * jnp.pi + 10) for number, share in ((0, 0.1), (1, -0.5)))
    depths = jax.jit(jax.vmap(lambda parameter: deepest(within, parameter)))(jnp.array([on_first, on_second]))
    np.testing.assert_allclose(depths, [np.inf, -0.1], atol=EXACT)
