"""Pipes: points, slopes, units, where a scan begins, errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-12
PIPE = jw.Pipe(radius=0.65, position=0.1, height=0.4)
PARAMETERS = jnp.linspace(-3.1, 3.1, 40)


def test_points_lie_on_the_circle_and_normals_point_to_its_centre():
    at = jax.vmap(PIPE.point)(PARAMETERS)
    right, up = np.asarray(at.x) - 0.1, np.asarray(at.y) - 0.4
    np.testing.assert_allclose(np.hypot(right, up), 0.65, atol=EXACT)
    np.testing.assert_allclose(at.sin, -right / 0.65, atol=EXACT)  # the normal of an object is (sin, -cos)
    np.testing.assert_allclose(-np.asarray(at.cos), -up / 0.65, atol=EXACT)


def test_points_move_along_the_slope_with_the_speed():
    at, rate = jax.jvp(jax.vmap(PIPE.point), (PARAMETERS,), (jnp.ones_like(PARAMETERS),))
    speed = jax.vmap(PIPE.speed)(PARAMETERS)
    np.testing.assert_allclose(rate.x, speed * at.cos, atol=EXACT)
    np.testing.assert_allclose(rate.y, speed * at.sin, atol=EXACT)


def test_it_is_a_closed_hollow():
    assert PIPE.is_concave and PIPE.closed and not PIPE.has_edges
    low, high = PIPE.span()
    np.testing.assert_allclose(high - low, 2 * np.pi)
    lowest = PIPE.point(jnp.asarray(PIPE.lowest()))
    np.testing.assert_allclose([lowest.x, lowest.y], np.array(PIPE.vertex()), atol=EXACT)
    with pytest.raises(NotImplementedError, match="inside a pipe"):
        PIPE.first_touch(1.0, 1.0)


def test_other_units_scale_points():
    small, here = PIPE.in_unit(10.0).point(jnp.asarray(0.7)), PIPE.point(jnp.asarray(0.7))
    np.testing.assert_allclose([10 * small.x, 10 * small.y, small.cos, small.sin], here, atol=EXACT)


def test_texts():
    assert str(jw.Pipe(0.65)) == "pipe r = 0.65"
    assert str(PIPE) == "pipe r = 0.65, x = 0.1, y = 0.4"


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"radius": 0.0}, "`radius` must be a positive finite number, got 0.0"),
        ({"radius": -1.0}, "`radius` must be a positive finite number, got -1.0"),
        ({"radius": 1.0, "height": np.nan}, "`height` must be a finite number, got nan"),
        ({"radius": 1.0, "position": "left"}, "`position` must be a finite number, got 'left'"),
    ],
)
def test_wrong_numbers_are_rejected(wrong, message):
    with pytest.raises(ValueError, match=message):
        jw.Pipe(**wrong)


def test_a_traced_radius_that_is_not_positive_is_not_valid():
    valid = jax.jit(lambda radius: jw.Pipe(radius).valid())
    assert bool(valid(0.5)) and not bool(valid(-0.5))
