"""Maps of studies, and tactile images."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import numpy as np
import pytest
import xarray as xr

import jaxwhisker as jw
from jaxwhisker import plot
from jaxwhisker.plot import studies
from pictured import steepness, summarised

OFFSETS, CONTROL = np.array([-0.2, 0.0, 0.2, 0.4]), np.linspace(-1.0, 1.0, 5)


def test_maps_share_a_scale():
    axs = plot.study(summarised(), critical=steepness(summarised()))
    assert [ax.get_legend().get_title().get_text() for ax in axs] == ["whisker 1", "whisker 2"]
    first, second = (ax.collections[0] for ax in axs)
    assert first.get_clim() == second.get_clim()
    assert axs[0].get_xlabel() == "stiffness (EI/L$^{3}$)" and axs[0].get_legend() is not None


def test_scenes_that_are_not_dimensionless_have_si_units():
    data = summarised()
    data.attrs = {"typical_force": 9.6e-3, "typical_length": 0.05}
    for name, units in {"stiffness": "N/m", "distance": "m", "max_mz": "N m"}.items():
        data[name].attrs["units"] = units
    axs = plot.study(data, critical=steepness(data))
    assert axs[0].get_xlabel() == "stiffness (N/m)" and axs[0].get_ylabel() == "distance (mm)"
    np.testing.assert_allclose(axs[0].collections[0].get_clim(), 1e6 * np.array([data.max_mz.min(), data.max_mz.max()]))
    assert axs[0].get_xlim() == pytest.approx((25.0, 95.0)) and axs[0].get_ylim() == pytest.approx((50.0, 350.0))
    stored = plot.study(data, critical=steepness(data), units="stored")
    assert stored[0].get_xlabel() == "stiffness (N/m)"
    assert stored[0].get_ylim() == pytest.approx((0.05, 0.35))


@pytest.mark.parametrize("known", [True, False])
def test_the_critical_curve_has_the_units_of_the_map(known):
    data = summarised()
    critical = steepness(data)
    data.attrs = {"typical_force": 9.6e-3, "typical_length": 0.05}
    for name, units in {"stiffness": "N/m", "distance": "m", "max_mz": "N m"}.items():
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


def made_image(**attributes):
    """An image of two whiskers; fx is known everywhere, my is zero, and one scan fails halfway."""
    rows, columns = np.meshgrid(OFFSETS, CONTROL, indexing="ij")
    dims, units = ("offset", "control", "whisker"), ("N", "N m", "m")
    if not attributes:
        units = "EI/L^2", "EI/L", "L"
    force, moment, length = ({"units": unit} for unit in units)
    fx = np.stack([rows + 2 * columns, columns], axis=-1)
    lowest = np.stack([0.3 + columns**2 * 3, np.full_like(columns, np.nan)], axis=-1)
    data = {"fx": (dims, fx, force), "mz": (dims, -3 * fx, moment), "my": (dims, 1e-13 * fx, moment)}
    data |= {"contact_force": (dims, np.abs(fx), force), "event_count": ("offset", np.ones(4))}
    data |= {"object_height": (dims, lowest, length | {"long_name": "height of the object"})}
    status = np.where((rows == 0.2) & (columns > 0), jw.Status.undetermined, jw.Status.ok)
    data |= {"status": (("offset", "control"), status)}
    coords = {"offset": ("offset", OFFSETS, length), "control": ("control", CONTROL, length), "whisker": [1, 2]}
    return xr.Dataset(data, coords, attributes)


def shown(ax):
    """The numbers of an image, offset by offset."""
    return ax.collections[0].get_array().reshape(OFFSETS.size, CONTROL.size)


def test_images_have_the_drive_to_the_right_and_the_offset_upwards():
    axs = plot.tactile_image(made_image(), ["fx", "mz", "my", "contact_force"])
    assert len(axs) == 5 and axs[0].get_ylabel() == "offset (L)" and axs[4].get_xlabel() == "control (L)"
    assert axs[1].get_aspect() == 1.0
    failed = (OFFSETS == 0.2)[:, None] & (CONTROL > 0)
    np.testing.assert_array_equal(shown(axs[1]).mask, failed)
    np.testing.assert_allclose(shown(axs[1])[~failed], (OFFSETS[:, None] + 2 * CONTROL)[~failed])
    assert axs[1].get_legend().get_texts()[0].get_text() == "status not ok"
    heights = np.minimum(0.3 + 3 * CONTROL**2, 1.3) + 0 * OFFSETS[:, None]
    np.testing.assert_allclose(shown(axs[0]), heights)
    labels = [ax.child_axes[0].get_ylabel() for ax in axs]
    force = "(EI/L$^{2}$)"
    assert labels == ["height of the object (L)", f"$f_x$ {force}", "$m_z$ (EI/L)", "$m_y$ (EI/L)", f"$f$ {force}"]


def test_colours_of_signed_signals_are_symmetric():
    axs = plot.tactile_image(made_image(), ["fx", "mz", "my", "contact_force"])
    limits = [ax.collections[0].get_clim() for ax in axs]
    assert limits[1] == (-2.4, 2.4) and limits[2] == pytest.approx((-7.2, 7.2))
    assert limits[3] == limits[2]  # my is zero but for rounding
    assert limits[4] == (0.0, 2.4)


def test_images_in_si_units():
    length = 0.05
    data = made_image(typical_force=9.6e-3, typical_length=length)
    axs = plot.tactile_image(data, "fx", whisker=1)
    assert axs[0].get_ylabel() == "offset (mm)" and axs[1].child_axes[0].get_ylabel() == "$f_x$ (mN)"
    np.testing.assert_allclose(shown(axs[0]), 1e3 * np.minimum(0.3 + 3 * CONTROL**2, 0.3 + length) + 0 * shown(axs[0]))
    stored = plot.tactile_image(data, "fx", units="stored", axs=axs)
    assert stored[0].get_ylabel() == "offset (m)" and list(stored) == list(axs)


def test_a_whisker_that_passes_no_object_has_an_image():
    axs = plot.tactile_image(made_image().drop_vars("status"), "fx", whisker=2)
    assert np.ma.getmaskarray(shown(axs[0])).all() and axs[1].get_legend() is None
    np.testing.assert_allclose(shown(axs[1]), CONTROL + 0 * OFFSETS[:, None])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"data": summarised()}, "`data` must be a Dataset of jw.tactile_image"),
        ({"names": "fz"}, "`names` must be among fx, mz, my, contact_force, got 'fz'"),
        ({"names": "event_count"}, "`names` must be among"),
        ({"names": []}, "`names` must be among"),
        ({"whisker": 3}, "`whisker` must be a number from 1 to 2, got 3"),
        ({"units": "mm"}, "`units` must be one of auto, stored"),
        ({"names": "fx", "axs": []}, "`axs` must be 2 Axes"),
    ],
)
def test_wrong_images_are_rejected(arguments, words):
    with pytest.raises(ValueError, match=words):
        plot.tactile_image(**{"data": made_image(), "names": "fx"} | arguments)
