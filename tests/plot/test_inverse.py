"""Figures of fits, information and contours."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import plot
from pictured import LENGTH, STIFFNESS, coupled, some_fit, some_information, some_points


@pytest.mark.unchecked  # the made-up fit only has the fields that are drawn
def test_a_fit_in_si_units_has_prefixes(result_in_si):
    fit = some_fit(result_in_si)
    axs = plot.fit(fit)
    assert [ax.get_ylabel() for ax in axs[::2]] == ["$f_x$ (mN)", "$f_y$ (mN)", "$m_z$ (mN mm)"]
    dots, line, *_ = axs[4].get_lines()
    np.testing.assert_allclose(dots.get_ydata(), 1e6 * fit.measured.values[:, 0, 2])
    np.testing.assert_allclose(line.get_ydata(), 1e6 * fit.signals[:, 0, 2])
    np.testing.assert_allclose(line.get_xdata(), 1e3 * np.asarray(result_in_si.control))
    assert [ax.get_xlabel() for ax in axs] == [""] * 4 + ["$u$ (mm)"] * 2
    assert plot.fit(fit, units="dimensionless")[4].get_ylabel() == r"$m_z\,L/EI$"


@pytest.mark.unchecked
def test_a_fit_has_residuals_beside_its_signals(result):
    fit = some_fit(result)
    axs = plot.fit(fit)
    for c, ax in enumerate(axs[1::2]):
        for k, line in enumerate(ax.get_lines()):
            np.testing.assert_array_equal(line.get_ydata(), fit.residuals[:, k, c])
            assert line.get_color() == plot.COLOURS[k]
        (band,) = ax.collections  # the noise has the standard deviation 1
        heights = band.get_paths()[0].vertices[:, 1]
        np.testing.assert_allclose([heights.min(), heights.max()], [-1.959964, 1.959964], rtol=1e-6)


@pytest.mark.unchecked
def test_the_control_increases_to_the_right(result):
    for ax in (plot.information(some_information()), *plot.fit(some_fit(result))):
        left, right = ax.get_xlim()
        assert left < right
    ax = plot.information(some_information())
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["c", "q", "vertex"]
    for line in ax.get_lines()[:2]:
        share = np.asarray(line.get_ydata())
        assert np.all(np.diff(share) >= 0) and share[-1] == pytest.approx(1.0)


def test_information_and_contours_have_si_units():
    scene = coupled(LENGTH, STIFFNESS)
    ax = plot.information(some_information(scene))
    assert ax.get_xlabel() == "$u$ (mm)"
    np.testing.assert_allclose(ax.get_lines()[0].get_xdata(), 1e3 * some_information().control)
    assert plot.information(some_information(scene), units="dimensionless").get_xlabel() == "$u/L$"
    points = some_points(LENGTH)
    ax, other = plot.contour(points), plot.contour(points, units="dimensionless")
    assert (ax.get_xlabel(), ax.get_ylabel(), other.get_xlabel()) == ("$x$ (mm)", "$y$ (mm)", "$x/L$")
    (dots,), (scaled,) = ([x for x in a.get_lines() if x.get_label() == "whisker 1"] for a in (ax, other))
    clear = points.clear[:, 0]
    np.testing.assert_allclose(dots.get_xdata(), 1e3 * np.asarray(points.x)[clear, 0])
    np.testing.assert_allclose(scaled.get_ydata(), np.asarray(points.y)[clear, 0] / LENGTH)


def test_only_points_clear_of_noise_are_drawn():
    ax = plot.contour(some_points(), profile=jw.Parabola(0.2))
    (dots,) = [line for line in ax.get_lines() if line.get_label() == "whisker 1"]
    assert np.size(dots.get_xdata()) == 32
    bars = [np.asarray(line.get_xydata()) for line in ax.get_lines() if np.size(line.get_xdata()) == 2]
    # 95 % of a normal distribution with standard deviation 0.02, across the contour.
    np.testing.assert_allclose([np.hypot(*(bar[1] - bar[0])) for bar in bars], 2 * 1.959964 * 0.02, rtol=1e-6)
    assert len(bars) == 32


def test_a_fitted_profile_has_a_band():
    fit = jw.fit_profile(some_points(), jw.Parabola)
    ax = plot.contour(fit, profile=jw.Parabola(0.2))
    fitted, true = ax.get_lines()
    x, y = np.asarray(fitted.get_xydata()).T
    np.testing.assert_allclose(y, 0.2 + x**2, atol=1e-9)
    # The points lie at -0.8 to 0.8, and the last one is lost in noise.
    np.testing.assert_allclose([x.min(), x.max()], [-0.8, 0.75], atol=1e-6)
    np.testing.assert_allclose(np.asarray(true.get_xdata())[[0, -1]], [x.min(), x.max()], atol=0.02)
    assert fitted.get_label() == "fitted, 95 % band" and ax.get_xlabel() == "$x/L$"
    (band,) = ax.patches
    middle = band.get_xy()[np.abs(band.get_xy()[:, 0]) < 5e-3, 1]
    (_, _, error) = fit.band([0.0])
    np.testing.assert_allclose(np.ptp(middle), 2 * 1.959964 * error[0], rtol=0.02)


def test_a_fitted_profile_has_the_units_of_its_points():
    fit = jw.fit_profile(some_points(LENGTH), jw.Parabola)
    assert plot.contour(fit).get_xlabel() == "$x$ (mm)"
    assert plot.contour(fit, units="dimensionless").get_xlabel() == "$x/L$"
