"""Studies of scans in space: the same values as single scans, statuses, summaries, derivatives, channels, stores."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxwhisker as jw

CONTROL = np.linspace(1.2, -1.2, 49)
SAME = 1e-9  # a scan in a batch and alone
MIRRORED = 1e-9  # scans that are mirror images of each other
STEP = 1e-5  # of central differences: their error is of the order of its square
SLOPE = 1e-6  # accuracy of slopes by differences of values that are solved to 1e-12


def build(z, radius=1.0):
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, (0.0, radius + 0.3, z)))


@pytest.fixture(scope="module")
def data():
    return jw.study(build, control=CONTROL, outputs="all", derivatives="z", z=[-0.2, 0.2], radius=[1.0, -1.0, 0.8])


def test_points_are_single_scans(data):
    assert data.point_status.sel(radius=-1.0).values.tolist() == [jw.Status.invalid] * 2
    assert np.isnan(data.fz.sel(radius=-1.0)).all()
    for radius in (1.0, 0.8):
        one, alone = data.sel(z=0.2, radius=radius), jw.scan(build(0.2, radius), CONTROL)
        assert int(one.point_status) == jw.Status.ok and int(one.event_count) == len(alone.events) > 2
        for name in ("fz", "mx", "my", "mz", "base_z", "contact_z", "base_rotation"):
            np.testing.assert_allclose(one[name], getattr(alone, name), rtol=0, atol=SAME, err_msg=name)
        for k, event in enumerate(alone.events):
            before: Any = event.before
            assert int(one.event_kind[k]) == event.kind
            np.testing.assert_allclose(one.event_control[k], event.control, atol=SAME)
            np.testing.assert_allclose(one.before_mx[k], before.mx, atol=SAME)


def test_the_axes_of_variables_have_names_and_units(data):
    assert data.base_rotation.dims == ("z", "radius", "control", "whisker", "component", "director")
    assert data.d_base_rotation_d_z.dims == data.base_rotation.dims
    units = {"fz": "EI/L^2", "my": "EI/L", "contact_z": "L", "event_control": "L", "base_rotation": "1"}
    assert {name: data[name].attrs["units"] for name in units} == units
    assert not {"base_angle", "contact_slope", "slip", "event_energy_before"} & set(data.data_vars)


def test_the_default_control_spans_those_of_the_scans():
    data = jw.study(build, z=[0.2], radius=[0.8, 1.0])
    ends = np.array([jw.scan(build(0.2, radius)).control[jnp.array([0, -1])] for radius in (0.8, 1.0)])
    np.testing.assert_allclose(data.control[0], ends[:, 0].max(), atol=SAME)
    assert -1e-3 <= data.control[-1] - ends[:, 1].min() <= SAME
    assert (data.point_status == jw.Status.ok).all()


def test_summaries_of_mirror_images_are_mirror_images(data):
    peaks = jw.summary(data)
    left, right = (peaks.sel(z=z, radius=1.0, whisker=1) for z in (-0.2, 0.2))
    for name, sign in {"fx": 1, "fy": 1, "fz": -1, "mx": -1, "my": -1, "mz": 1}.items():
        other = f"max_{name}" if sign > 0 else f"min_{name}"
        np.testing.assert_allclose(left[f"max_{name}"], sign * right[other], atol=MIRRORED)
    np.testing.assert_allclose(right.max_fx, -right.min_fx, atol=MIRRORED)
    assert right.max_fz > 0.1 and "snap_work" not in peaks and int(right.snaps) == 0
    np.testing.assert_allclose(right.first_touch, -right.last_contact, atol=MIRRORED)
    touch = data.event_control.sel(z=0.2, radius=1.0)[0]
    np.testing.assert_array_equal(right.first_touch, touch)


def test_a_study_of_summaries_has_their_derivatives(data):
    peaks = jw.study(build, control=CONTROL, summary=True, derivatives="z", z=[0.2])
    expected = jw.summary(data).sel(radius=1.0, z=[0.2])
    assert "fz" not in peaks and "max_fz" in peaks
    for name in ("max_fz", "control_of_max_my", "contact_width", "d_max_fz_d_z", "d_first_touch_d_z"):
        np.testing.assert_allclose(peaks[name], expected[name], atol=SAME, err_msg=name)
    ahead, behind = (jw.study(build, control=CONTROL, summary=True, z=[0.2 + way * STEP]).isel(z=0) for way in (1, -1))
    for name in ("max_fz", "min_mx", "first_touch"):
        slope = (ahead[name] - behind[name]) / (2 * STEP)
        np.testing.assert_allclose(peaks[f"d_{name}_d_z"].isel(z=0), slope, atol=SLOPE, err_msg=name)


def test_channels_are_functions_of_results_in_space(data):
    def channels(result):
        return {"axial": result.own_force[..., 2], "lift": result.spring_length.sum(axis=1) + result.fz[:, 0]}

    found = jw.study(build, control=CONTROL, channels=channels, z=[0.2]).isel(z=0)
    one = data.sel(z=0.2, radius=1.0)
    np.testing.assert_allclose(found.axial, one.fy[:, 0], atol=SAME)  # of an upright clamped whisker
    np.testing.assert_allclose(found.lift, one.fz[:, 0], atol=SAME)


def test_channels_must_not_ask_for_events():
    with pytest.raises(ValueError, match="`channels` must not depend on events"):
        jw.study(build, control=CONTROL, channels=lambda result: {"events": result.events.control}, z=[0.2])


def test_a_store_holds_what_a_study_returns(data, tmp_path):
    path = tmp_path / "study.zarr"
    stored = jw.study(build, control=CONTROL, outputs=["springs", "reactions"], store=path, z=[-0.2, 0.2])
    again = jw.study(build, control=CONTROL, outputs=["springs", "reactions"], store=path, z=[-0.2, 0.2])
    xr.testing.assert_identical(stored.load(), again.load())
    assert list(again.director.values) == ["d1", "d2", "d3"]
    np.testing.assert_allclose(again.base_rotation, data.base_rotation.sel(radius=1.0), atol=SAME)


def test_a_quantity_of_the_plane_is_not_an_output():
    with pytest.raises(ValueError, match="they have no base_angle in space: got 'base_angle'"):
        jw.study(build, control=CONTROL, outputs=["base_angle"], z=[0.2])


def test_a_study_is_drawn_and_exported(data):
    peaks = jw.summary(data.sel(radius=[1.0, 0.8]))
    axes = jw.plot.study(peaks.isel(radius=0), "max_fz")
    assert "$f_z$" in axes[0].get_ylabel()
    table = jw.to_dataframe(data[["fz", "base_rotation"]])
    assert list(table)[2:5] == ["control", "fz_1", "base_rotation_1_x_d1"] and len(table) == 6 * CONTROL.size
