"""Maps of studies."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
import pytest

from jaxwhisker import plot
from jaxwhisker.plot import studies
from pictured import steepness, summarised


def test_maps_share_a_scale():
    axs = plot.study(summarised(), critical=steepness(summarised()))
    assert [ax.get_legend().get_title().get_text() for ax in axs] == ["whisker 1", "whisker 2"]
    first, second = (ax.collections[0] for ax in axs)
    assert first.get_clim() == second.get_clim()
    assert axs[0].get_xlabel() == "stiffness (EI/L$^{3}$)" and axs[0].get_legend() is not None


def test_scenes_that_are_not_dimensionless_have_si_units():
    data = summarised()
    data.attrs = {"typical_force": 9.6e-3, "typical_length": 0.05}
    for name, units in {"stiffness": "force/length", "distance": "length", "max_mz": "force length"}.items():
        data[name].attrs["units"] = units
    axs = plot.study(data, critical=steepness(data))
    assert axs[0].get_xlabel() == "stiffness (N/m)" and axs[0].get_ylabel() == "distance (mm)"
    np.testing.assert_allclose(axs[0].collections[0].get_clim(), 1e6 * np.array([data.max_mz.min(), data.max_mz.max()]))
    assert axs[0].get_xlim() == pytest.approx((25.0, 95.0)) and axs[0].get_ylim() == pytest.approx((50.0, 350.0))
    stored = plot.study(data, critical=steepness(data), units="stored")
    assert stored[0].get_xlabel() == "stiffness (force/length)"
    assert stored[0].get_ylim() == pytest.approx((0.05, 0.35))


@pytest.mark.parametrize("known", [True, False])
def test_the_critical_curve_has_the_units_of_the_map(known):
    data = summarised()
    critical = steepness(data)
    data.attrs = {"typical_force": 9.6e-3, "typical_length": 0.05}
    for name, units in {"stiffness": "force/length", "distance": "length", "max_mz": "force length"}.items():
        data[name].attrs["units"] = units
        if name in critical.coords:
            critical[name].attrs = dict(data[name].attrs) if known else {}
    curve = plot.study(data, critical=critical)[0].collections[1].get_paths()[0].vertices
    # q = 100 to 300 mm, where the curve is c = 8.64 / q up to interpolation in a coarse grid
    assert 100 <= curve[:, 1].min() < curve[:, 1].max() <= 300
    np.testing.assert_allclose(curve[:, 0] * curve[:, 1], 8640.0, rtol=0.1)


def test_the_critical_stiffness_is_interpolated():
    critical = steepness(summarised()).isel(distance=1)
    (at,) = studies._crossings(critical.stiffness.values, critical.values)
    assert at == pytest.approx(43.2)
    assert studies._crossings(np.array([0.0, 1.0]), np.array([2.0, 0.5])) == []
