"""What follows from points: vertex and agreement of whiskers; in space vectors, their errors, and the summary."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from contacts import noisy, sensor, signals
from jaxwhisker._inverse.points import SpaceReconstruction
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._model.scene import Sensor

BIAS = 4.0  # standard errors
CROSSING = 3e-4  # of the base: a cubic through some steps
ROUNDING = 1e-14
MATRIX = np.random.default_rng(0).standard_normal((7, 7))


def test_the_vertex_and_whether_whiskers_agree():
    exactly = reconstruct(signals("FBFBR")[1], sensor("FBFBR"))
    assert np.max(np.abs(exactly.vertex().x)) < 1e-6 and np.max(np.abs(exactly.vertex().y - 0.2)) < 1e-6
    np.testing.assert_allclose(exactly.vertex().base_x, -0.3338507, atol=CROSSING)
    measured, sigma = noisy("FBFBR", 1)
    points = reconstruct(measured, sensor("FBFBR"), sigma=sigma)
    vertex = points.vertex()
    assert np.all(np.abs(vertex.x) < BIAS * vertex.x_error) and np.all(np.abs(vertex.y - 0.2) < BIAS * vertex.y_error)
    assert np.all(vertex.y_error < 1e-3)
    assert 0.5 < points.consistency().chi2 < 1.5
    # A wrong rest length tears the two contours apart.
    shifted = Sensor(jw.Whisker(), jw.Support.fbfbr(70.0, [0.2, 0.23, 0.43]))
    assert reconstruct(measured, shifted, sigma=sigma).consistency().chi2 > 3.0


def made(**fields):
    """Two steps of one whisker, the second of which is free."""
    force = {"force_x": 0.0, "force_y": -3.0, "force_z": 4.0}
    values = {"x": 1.0, "y": 2.0, "z": 3.0, "arc": 0.5, **force}
    where = {f"base_{axis}": 0.0 for axis in "xyz"} | {"chi2": 2.0, "significance": 30.0}
    scalars = values | where | {"force_moment": 0.1, "force_moment_score": 2.0}
    arrays = {name: jnp.array([[value], [np.nan]]) for name, value in scalars.items()}
    arrays |= {"phase": jnp.array([[2], [0]]), "status": jnp.array([[0], [1]]), "control": jnp.arange(2.0)}
    arrays |= {"tangent": jnp.zeros((2, 1, 3)), "base_rotation": jnp.zeros((2, 1, 3, 3)), "length": jnp.asarray(1.0)}
    covariance = jnp.broadcast_to(jnp.asarray(MATRIX @ MATRIX.T), (2, 1, 7, 7))
    return SpaceReconstruction(**arrays | {"covariance": covariance} | fields)  # pyright: ignore[reportArgumentType]


def test_vectors_and_their_errors():
    points, direction = made(), np.array([0.0, -0.6, 0.8])
    np.testing.assert_array_equal(points.point[0, 0], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(points.force[0, 0], [0.0, -3.0, 4.0])
    np.testing.assert_allclose(points.direction[0, 0], direction, atol=ROUNDING)
    np.testing.assert_allclose(points.standard_error[0, 0], np.linalg.norm(MATRIX, axis=1), rtol=ROUNDING)
    expected = np.linalg.norm(direction @ MATRIX[:3])
    assert float(points.normal_error[0, 0]) == pytest.approx(expected, rel=ROUNDING)


def test_clear_points_exceed_the_noise():
    assert made().clear.tolist() == [[True], [False]]
    assert not made(significance=jnp.full((2, 1), 19.0)).clear.any()
    assert made(significance=jnp.full((2, 1), np.nan)).clear[0, 0]  # of exact signals


def test_the_summary():
    text = str(made())
    assert text.startswith("2 steps of 1 whisker: 0 tip, 1 tangential, 1 free\n")
    assert "force . moment: 2 standard deviations of its noise (rms)" in text
    exact = made(covariance=jnp.full((2, 1, 7, 7), np.nan), force_moment_score=jnp.full((2, 1), np.nan))
    assert "\n" not in str(exact) and repr(exact) == str(exact)


@pytest.mark.unchecked
def test_planar_functions_refuse_points_in_space():
    with pytest.raises(ValueError, match=r"`points` must .* in the plane"):
        jw.fit_profile(made(), jw.Circle)  # pyright: ignore[reportArgumentType]
