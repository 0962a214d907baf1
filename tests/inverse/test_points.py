"""What follows from points: the vertex, and whether whiskers agree on one contour."""

import numpy as np

import jaxwhisker as jw
from contacts import noisy, sensor, signals
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._model.scene import Sensor

BIAS = 4.0  # standard errors
CROSSING = 3e-4  # of the base: a cubic through some steps


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
