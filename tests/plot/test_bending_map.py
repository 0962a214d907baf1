"""Maps of strain and stress: their largest value, its place and its unit."""

# pyright: reportOptionalSubscript=false, reportIndexIssue=false, reportCallIssue=false, reportArgumentType=false

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker import plot
from pictured import LENGTH, failed, there_and_back

RADIUS, MODULUS = 0.01, 70e9
ROUNDED = 5e-3  # relative, of three digits


def largest(result, radius, whisker):
    """The largest strain at the base, which is that of a clamped whisker."""
    return radius * np.nanmax(np.abs(np.asarray(result.mz)[:, whisker - 1]))


def test_the_largest_strain_is_marked(result):
    ax = plot.strain(result, RADIUS, whisker=2)
    drawn, (mark,) = ax.collections[0].get_array(), ax.get_lines()
    assert float(mark.get_ydata()[0]) == 0.0  # at the base
    step = int(np.argmin(np.abs(np.asarray(result.control) - mark.get_xdata()[0])))
    assert RADIUS * abs(float(result.mz[step, 1])) == pytest.approx(largest(result, RADIUS, 2))
    assert np.nanmax(drawn) == pytest.approx(largest(result, RADIUS, 2))
    words = ax.get_title().split(": ")
    assert words[0] == "largest strain" and float(words[1]) == pytest.approx(largest(result, RADIUS, 2), rel=ROUNDED)


def test_stress_in_si_units(result_in_si):
    stress = plot.strain(result_in_si, RADIUS * LENGTH, modulus=MODULUS)
    name, number, unit = stress.get_title().replace(": ", " ").rsplit(" ", 2)
    stiffness = float(result_in_si.scene.whiskers[0].bending_stiffness)
    exact = MODULUS * largest(result_in_si, RADIUS * LENGTH, 1) / stiffness
    size = {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9}[unit]
    assert name == "largest stress" and float(number) * size == pytest.approx(exact, rel=ROUNDED)
    assert stress.get_xlabel() == "$u$ (mm)" and stress.get_ylabel() == "$s$ (mm)"


def test_a_taper_reversals_and_failed_steps(result):
    taper = plot.strain(result, lambda s: RADIUS * (1 - 0.5 * s)).collections[0].get_array()
    even = plot.strain(result, RADIUS).collections[0].get_array()
    np.testing.assert_allclose(taper[0], even[0])
    np.testing.assert_allclose(taper[48], 0.75 * even[48])  # in the middle
    both = there_and_back(result)
    assert plot.strain(both, RADIUS).get_xlabel().startswith("travel of the drive")
    holes = plot.strain(failed(result, slice(60, 90)), RADIUS).collections[0].get_array()
    assert np.ma.getmaskarray(np.ma.masked_invalid(holes))[:, 60:90].all()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": 0.0}, "`radius` must be a positive"),
        ({"radius": "thin"}, "`radius` must be a positive finite number, got 'thin'"),
        ({"radius": lambda s: 0.01 - 0.02 * s}, "`radius` must be positive, or zero"),
        ({"radius": RADIUS, "modulus": -1.0}, "`modulus` must be a positive"),
        ({"radius": RADIUS, "whisker": 3}, "`whisker` must be one of the 2 whiskers"),
    ],
)
def test_errors(result, options, message):
    with pytest.raises(ValueError, match=message):
        plot.strain(result, **options)


def test_strain_in_space():
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, 0.2))
    scanned = jw.scan(
        jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), motion=drive), np.linspace(0.8, -0.8, 20)
    )
    drawn = plot.strain(scanned, RADIUS).collections[0].get_array()
    moment = np.hypot(*np.moveaxis(np.asarray(scanned.own_moment)[:, 0, :2], -1, 0))
    np.testing.assert_allclose(drawn[0], RADIUS * moment, atol=1e-12)
