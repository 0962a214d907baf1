"""Contours and unknown parameters from all signals at once."""

import exact
import numpy as np
import pytest
from matplotlib import pyplot

import jaxwhisker as jw

NOISE = 0.01  # of a channel's peak
LIKELY = 4.0  # standard errors: one in 16,000 values is further off
MEAN = 2e-3  # of the length: what the contour's error is allowed to be in the mean
SPRINGS = ({"between": (0, 1), "stiffness": 70.0, "rest_length": 0.2},)
CONTROL = np.linspace(0.7, -1.25, 256)


def sensor(c):
    return jw.Sensor(jw.Whisker(), jw.Support.fb(c))


@pytest.fixture(scope="module")
def noisy():
    """Signals of a circle, which is of no family that is fitted here, with noise; and its standard deviations."""
    states = exact.exact_scan(exact.circle(0.3, 0.5), SPRINGS, CONTROL).states
    rng = np.random.default_rng(3)
    sigma = {name: NOISE * float(np.abs(getattr(states, name)).max()) for name in ("fx", "fy", "mz")}
    values = {name: getattr(states, name) + s * rng.standard_normal(states.fx.shape) for name, s in sigma.items()}
    return {"control": CONTROL} | values, sigma


@pytest.fixture(scope="module")
def fit(noisy):
    """With a stiffness that is not known."""
    data, sigma = noisy
    return jw.fit_contour(data, sensor, sigma=sigma, parameters={"c": 100.0}, unknown=("c",), knots=6)


def test_contour_and_stiffness_are_within_their_errors(fit):
    assert fit.fit.status == jw.FitStatus.ok
    assert abs(fit.fit.estimates["c"] - 70.0) < LIKELY * fit.fit.standard_error["c"]
    assert fit.fit.standard_error["c"] < 5.0
    assert float(1 / fit.sensor.support.springs[0].softness) == pytest.approx(fit.fit.estimates["c"])
    band = fit.band()
    # The distance from a circle of radius 0.5 about (0, 0.8).
    off = 0.5 - np.hypot(band.x, band.y - 0.8)
    assert np.mean(np.abs(off)) < MEAN
    assert np.all(np.abs(off) < LIKELY * band.error) and np.ptp(band.slope) > 1.0
    x, y = fit.band([0.2]).x[0], fit.band([0.2]).y[0]
    point = fit.profile.point(0.2)
    np.testing.assert_allclose((x, y), (point.x, point.y), rtol=1e-12)


def test_the_band_is_drawn(fit):
    ax = jw.plot.contour(fit, profile=jw.Circle(0.3, 0.5))
    drawn, circle = ax.get_lines()
    np.testing.assert_allclose(drawn.get_xydata(), np.column_stack(fit.band()[1:3]))
    np.testing.assert_allclose(np.hypot(circle.get_xdata(), circle.get_ydata() - 0.8), 0.5)
    (filled,) = ax.patches
    assert filled.get_xy()[:, 1].min() < fit.band().y.min()
    pyplot.close("all")


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"unknown": ("k",)}, "`unknown`.*'k'"),
        ({"knots": 1}, "`knots`.*1"),
        ({"knots": (0.3, 0.1)}, "`knots`.*0.1"),
        ({"sensor": lambda c: 3.0}, "`sensor`.*3.0"),
        ({"measured": {"control": CONTROL, **dict.fromkeys(("fx", "fy", "mz"), np.zeros(CONTROL.size))}}, "`measured`"),
    ],
)
def test_wrong_arguments(noisy, arguments, words):
    data, sigma = noisy
    given = {"measured": data, "sensor": sensor, "sigma": sigma, "parameters": {"c": 100.0}} | arguments
    with pytest.raises(ValueError, match=words):
        jw.fit_contour(**given)
