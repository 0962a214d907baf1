"""A spot: an object without size, which is touched with any slope."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._inverse.spot import Spot, with_spot
from jaxwhisker._model.objects import Objects

ROUNDING = 1e-15


def test_a_spot_is_a_circle_without_radius():
    at, circle = Spot(0.3, 0.7), jw.Circle(0.7 - 1e-12, 1e-12, position=0.3)
    for slope in (-1.2, 0.0, 0.4):
        here, there = at.point(slope), circle.point(jnp.asarray(slope))
        np.testing.assert_allclose([here.x, here.y], [there.x, there.y], atol=1e-11)
        np.testing.assert_allclose([here.cos, here.sin], [there.cos, there.sin], atol=ROUNDING)
    assert at.vertex() == (0.3, 0.7) and str(at) == "something unknown"
    half = at.in_unit(2.0)
    assert (half.x, half.y) == (0.15, 0.35)


def test_a_spot_follows_the_known_objects():
    known = Objects((jw.Circle(0.5, 0.2), jw.Parabola(0.9))).in_unit(1.0)
    more = with_spot(known, 0.3, 0.7)
    there = more.point_on(jnp.asarray(2), jnp.asarray(0.4))
    np.testing.assert_allclose([there.x, there.y, there.sin], [0.3, 0.7, np.sin(0.4)], atol=ROUNDING)
    first, same = more.point_on(jnp.asarray(0), jnp.asarray(0.4)), known.point_on(jnp.asarray(0), jnp.asarray(0.4))
    assert first == same
