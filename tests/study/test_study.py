"""Studies: every point equals a single scan, whatever the blocks; bad points and bad arguments."""

import importlib
import math
import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from jax.core import Tracer

import jaxwhisker as jw
from jaxwhisker._base.program import compilations
from jaxwhisker._scan.state import OPTIONAL
from jaxwhisker._study.compute import Kernel
from jaxwhisker._study.study import SUMMARISED
from jaxwhisker._study.summary import summary_without

CONTROL = np.linspace(0.8, -1.6, 61)
STIFFNESS = np.array([70.0, -1.0, 40.0, np.nan, 200.0])  # two of them are invalid
DISTANCE = np.array([0.2, 0.3, 1.5])  # the last out of reach
ROUNDING = 1e-9  # two solutions of Newton's method, relative to the peak of about 20
SLOPE = 1e-6  # of central differences with STRETCH, relative to the largest slope
STRETCH = 1e-3
SUMMARY_SLOPE = 1e-6  # of the same: differences of peaks of about 20 are accurate to 1e-12 / STRETCH and STRETCH^2


def build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness))


@pytest.fixture(scope="module")
def data():
    return jw.study(build, control=CONTROL, stiffness=STIFFNESS, distance=DISTANCE, outputs="all")


class TestPoints:
    def test_every_point_is_a_scan(self, data):
        for stiffness in (70.0, 40.0, 200.0):
            for distance in DISTANCE[:2]:
                point = data.sel(stiffness=stiffness, distance=distance)
                result = jw.scan(build(stiffness, distance), CONTROL)
                for name in ("status", "phase"):
                    np.testing.assert_array_equal(point[name], getattr(result, name))
                for name in ("fx", "fy", "mz", "base_x", "spring_length", "contact_arc", "contact_x"):
                    np.testing.assert_allclose(point[name], getattr(result, name), atol=20 * ROUNDING, err_msg=name)
                count = int(point.event_count)
                assert count == len(result.events) > 0
                np.testing.assert_array_equal(point.event_kind[:count], result.events.kind[:count])
                np.testing.assert_array_equal(point.event_kind[count:], -1)
                np.testing.assert_allclose(point.event_control, result.events.control, atol=ROUNDING)
                np.testing.assert_allclose(point.after_mz, result.events.after.mz, atol=20 * ROUNDING)
                energy = jw.stored_energy(result.scene, result.events.before)
                np.testing.assert_allclose(point.event_energy_before, energy, atol=20 * ROUNDING)

    def test_a_bad_point_is_nan_and_has_a_status(self, data):
        bad = data.isel(stiffness=[1, 3])
        assert bool((bad.status == jw.Status.invalid).all())
        assert bool(np.isnan(bad.mz).all())
        assert bool((bad.event_kind == -1).all())

    def test_out_of_reach_is_no_error(self, data):
        free = data.sel(distance=1.5).isel(stiffness=[0, 2, 4])
        assert bool((free.status == jw.Status.ok).all())
        assert bool((free.mz == 0).all())

    def test_the_points_are_counted(self, data):
        words = "9 of 15 ok; 6 invalid (stiffness = -1, distance = 0.2: `stiffness` must be"
        assert data.attrs["points"].startswith(words)
        counts = {jw.Status.ok: 9, jw.Status.invalid: 6}
        assert {status: int((data.point_status == status).sum()) for status in counts} == counts

    def test_events_that_are_not_stored_are_counted(self, data, monkeypatch, capsys):
        assert "omitted_events" not in data.attrs
        computed = Kernel.__call__

        def many(self, values):
            found = computed(self, values)
            return found | {"event_count": np.where(found["event_count"] > 3, 99, found["event_count"])}

        monkeypatch.setattr(Kernel, "__call__", many)
        axes: dict[str, Any] = {"stiffness": STIFFNESS[:3], "distance": DISTANCE}
        crowded = jw.study(build, control=CONTROL, **axes)
        room = crowded.sizes["event"]
        words = f"4 of 9 points have more than the {room} events stored, up to 99"
        assert crowded.attrs["omitted_events"] == words
        assert words in capsys.readouterr().err

    def test_rows_of_a_table(self, data):
        # As many as in a block of the axes: the compiled function has the same shape.
        columns = {"distance": [0.3, 0.2, 0.2, 0.3, 0.3, 0.2], "stiffness": [40.0, 70.0, 40.0, -1.0, 70.0, 200.0]}
        table = jw.study(build, control=CONTROL, points=pd.DataFrame(columns), outputs="all")
        assert table.fx.dims == ("point", "control", "whisker")
        for k, (distance, stiffness) in enumerate(zip(*columns.values(), strict=True)):
            row = table.isel(point=k)
            assert (float(row.distance), float(row.stiffness)) == (distance, stiffness)
            np.testing.assert_allclose(row.mz, data.mz.sel(stiffness=stiffness, distance=distance), atol=20 * ROUNDING)

    def test_a_second_study_compiles_nothing(self, data):
        def other(stiffness, distance):
            return build(2.0 * stiffness, distance)

        axes: dict[str, Any] = {"stiffness": np.linspace(50.0, 90.0, 7), "distance": DISTANCE}
        jw.study(build, control=CONTROL, outputs="all", stiffness=[40.0], distance=DISTANCE)
        before = compilations()
        jw.study(other, control=CONTROL, outputs="all", **axes)
        assert before == compilations()

    def test_summary_is_that_of_the_signals(self, data):
        axes: dict[str, Any] = {"stiffness": STIFFNESS, "distance": DISTANCE}
        brief = jw.study(build, control=CONTROL, outputs="all", summary=True, **axes)
        assert "mz" not in brief and "event_control" in brief
        whole = jw.summary(data)
        for name in whole.data_vars:
            np.testing.assert_allclose(brief[name], whole[name], atol=20 * ROUNDING, err_msg=name)
            assert brief[name].dims == whole[name].dims
            assert brief[name].attrs == whole[name].attrs


class TestDerivatives:
    def test_are_central_differences(self):
        stiffness = 70.0 + STRETCH * np.array([-1.0, 0.0, 1.0, np.nan])
        found = jw.study(
            lambda stiffness: build(stiffness, 0.2),
            control=CONTROL[:40],  # before it snaps off
            stiffness=stiffness,
            outputs=("mz", "base_x", "events"),
            derivatives="stiffness",
        )
        names = ("mz", "base_x", "event_control", "event_energy_after")
        for name in names:
            low, _, high, _ = found[name].values
            slope, central = found[f"d_{name}_d_stiffness"].values[1], (high - low) / (2 * STRETCH)
            np.testing.assert_allclose(slope, central, atol=SLOPE * np.nanmax(np.abs(slope)), err_msg=name)
            assert np.isnan(found[f"d_{name}_d_stiffness"].values[3]).all(), name
            assert np.nanmax(np.abs(slope)) > 0, name
        assert found.d_mz_d_stiffness.attrs["units"] == "L^2"
        assert "d_status_d_stiffness" not in found

    def test_those_of_a_summary_are_central_differences(self):
        options: dict[str, Any] = {
            "control": CONTROL,
            "stiffness": 70.0 + STRETCH * np.array([-1.0, 0.0, 1.0, np.nan]),
            "distance": [0.2],
            "derivatives": "stiffness",
        }
        brief = jw.study(build, summary=True, **options)
        steps = jw.study(build, outputs=SUMMARISED, **options)
        whole = jw.summary(steps)
        real = [name for name, quantity in summary_without(OPTIONAL).items() if quantity.dtype == "float64"]
        for name in ("control_of_max_mz", "last_contact", "contact_width", "half_width_mz", "snap_work"):
            assert abs(brief[f"d_{name}_d_stiffness"].values[1]).max() > 100 * SUMMARY_SLOPE, name
        for name in real:
            low, _, high, _ = brief[name].values
            slope, central = brief[f"d_{name}_d_stiffness"].values[1], (high - low) / (2 * STRETCH)
            np.testing.assert_allclose(slope, central, atol=SUMMARY_SLOPE, rtol=SUMMARY_SLOPE, err_msg=name)
            xr.testing.assert_allclose(brief[f"d_{name}_d_stiffness"], whole[f"d_{name}_d_stiffness"], rtol=ROUNDING)
            assert np.isnan(brief[f"d_{name}_d_stiffness"].values[3]).all(), name
        assert brief.d_max_mz_d_stiffness.attrs == whole.d_max_mz_d_stiffness.attrs
        assert brief.d_last_contact_d_stiffness.attrs == whole.d_last_contact_d_stiffness.attrs
        assert brief.d_max_mz_d_stiffness.attrs["units"] == "L^2"
        assert "d_snaps_d_stiffness" not in brief and "d_mz_d_stiffness" not in brief


def _sensor(result):
    """Three signals of a sensor: a scaled moment, and the base's position twice."""
    return {"volts": 3.0 * result.mz[:, 0], "way": jnp.concatenate([result.base_x, -result.base_x], axis=1)}


class TestChannels:
    def test_are_what_the_function_computes(self, data):
        axes: dict[str, Any] = {"stiffness": STIFFNESS, "distance": DISTANCE}
        sensed = jw.study(build, control=CONTROL, outputs="all", channels=_sensor, summary=True, **axes)
        np.testing.assert_array_equal(sensed.volts, 3.0 * data.mz.isel(whisker=0))
        np.testing.assert_array_equal(sensed.way_1, data.base_x.isel(whisker=0))
        np.testing.assert_array_equal(sensed.way_2, -sensed.way_1)
        assert sensed.volts.dims == ("stiffness", "distance", "control")
        assert sensed.volts.attrs == {"long_name": "volts"}  # nothing is known about its unit
        assert "mz" not in sensed and "max_mz" in sensed

    def test_have_derivatives(self):
        options: dict[str, Any] = {"control": CONTROL[:40], "stiffness": [70.0], "distance": [0.2]}
        found = jw.study(build, outputs="mz", channels=_sensor, derivatives="stiffness", **options)
        np.testing.assert_allclose(found.d_volts_d_stiffness, 3.0 * found.d_mz_d_stiffness.isel(whisker=0))
        assert np.abs(found.d_volts_d_stiffness).max() > 0

    def test_belong_to_the_store(self, tmp_path):
        options: dict[str, Any] = {"control": CONTROL[:5], "stiffness": [70.0], "distance": [0.2], "outputs": ()}

        def stored(channels):
            return jw.study(build, channels=channels, store=tmp_path / "study.zarr", **options)

        first = stored(lambda result: {"volts": result.mz[:, 0]}).volts.values
        np.testing.assert_array_equal(stored(lambda r: {"volts": r.mz[:, 0]}).volts, first)
        with pytest.raises(ValueError, match="its `channels` other signals"):
            stored(lambda result: {"volts": 2.0 * result.mz[:, 0]})
        with pytest.raises(ValueError, match="its variables lack current and also contain volts"):
            stored(lambda result: {"current": result.mz[:, 0]})


class TestLabels:
    def test_everything_has_units_and_a_long_name(self, data):
        for name in data.variables:
            assert data[name].attrs.get("units") and data[name].attrs.get("long_name"), name
        assert data.mz.attrs["units"] == "EI/L" and data.stiffness.attrs["units"] == "EI/L^3"
        assert data.status.attrs["flag_meanings"].split()[1:3] == ["ok", "invalid"]
        assert list(data.status.attrs["flag_values"])[:3] == [-1, 0, 1]
        assert data.between.values.tolist() == ["0-1"]
        for name in ("title", "scene", "signs", "jaxwhisker_version", "jax_version", "python_version", "date"):
            assert data.attrs[name], name

    @pytest.mark.parametrize("engine", ["netcdf4", "h5netcdf"])
    def test_netcdf_round_trip(self, data, engine, tmp_path):
        data.to_netcdf(tmp_path / "study.nc", engine=engine)
        xr.testing.assert_identical(xr.load_dataset(tmp_path / "study.nc", engine=engine), data)

    @pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")
    def test_zarr_round_trip(self, data, tmp_path):
        data.to_zarr(tmp_path / "study.zarr")
        xr.testing.assert_identical(xr.load_dataset(tmp_path / "study.zarr", engine="zarr"), data)


def _branches(stiffness, distance):
    return build(stiffness, distance if distance > 0.2 else 0.2)


def _grows(stiffness, distance):
    return build(stiffness, distance) if stiffness == 70.0 else jw.Scene(jw.Whisker(), jw.Parabola(distance))


def _other_object(stiffness, distance):
    known = not isinstance(stiffness, Tracer)
    profile = jw.Circle(distance, 1.0) if known and stiffness > 50 else jw.Parabola(distance)
    return jw.Scene(jw.Whisker(), profile, jw.Support.fb(stiffness))


def _other_ends(stiffness, distance):
    known = not isinstance(stiffness, Tracer)
    ends = ((0, 2), (0, 1)) if known and stiffness > 50 else ((0, 1), (0, 2))
    support = jw.Support(tuple(jw.Spring(between, stiffness) for between in ends))
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), support)


def _interpolates(stiffness, distance):
    return build(np.interp(stiffness, [0.0, 100.0], [0.0, 100.0]), distance)


def _calls_math(stiffness, distance):
    return build(math.sqrt(stiffness), distance)


def _looks_up(stiffness, distance):
    return build({40.0: 1.0, 70.0: 2.0}[stiffness], distance)


def _misspelt(stiffness, distance):
    return build(stiffness, distanse)  # pyright: ignore[reportUndefinedVariable]


def _bad_constant(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(-1.0))


def _positional(stiffness, /, distance):
    return build(stiffness, distance)


def _memory(memory):
    return build(memory, 0.2)


AXES: dict[str, Any] = {"stiffness": [40.0, 70.0], "distance": [0.2, 0.3]}


class TestErrors:
    @pytest.mark.unchecked
    @pytest.mark.parametrize(
        ("call", "words"),
        [
            (dict(build=3), "`build` must be a function"),
            (
                dict(radius=[1.0]),
                r"parameters of `build\(stiffness, distance\)`, got .*: got an unexpected keyword argument 'radius'",
            ),
            (dict(distance=None), "`distance` must be a non-empty one-dimensional array of numbers, got None"),
            (dict(distance=["a"]), r"`distance` must be .* array of numbers, got \['a'\]"),
            (dict(distance=0.2), r"`distance` must be .* one-dimensional .*, got an array of shape \(\)"),
            (dict(distance=[[0.2]]), r"`distance` must be .* one-dimensional .*, got an array of shape \(1, 1\)"),
            (dict(distance=[]), r"`distance` must be a non-empty .*, got an array of shape \(0,\)"),
            (dict(points={"stiffness": [1.0]}), "`points` must be left out .*stiffness, distance"),
            (dict(outputs=("fx", "force")), "`outputs` must be names among reactions.* got 'force'"),
            (dict(derivatives="radius"), "`derivatives` must be among stiffness, distance, got 'radius'"),
            (dict(control=[]), "`control` must be a non-empty"),
            (dict(control=[0.0, np.nan]), "`control` must be"),
            (dict(channels=3), "`channels` must be a function of the result of a scan, got 3"),
            (dict(channels=lambda result: {}), "`channels` must return a mapping from names to arrays"),
            (
                dict(channels=lambda result: {"a": result.fx[0]}),
                r"of shape \(steps,\) or \(steps, n\), got \(1,\) for a",
            ),
            (dict(channels=lambda result: {"mz": result.mz}), "name of a variable of the Dataset, got `mz`"),
            (dict(channels=lambda result: {"distance": result.mz}), "name of an axis must not be .* got `distance`"),
            (dict(channels=lambda result, gain: {"a": result.mz}), "of the result alone, got further arguments gain"),
            (dict(channels=lambda result: {"a": result.events.control}), "`channels` must not depend on events"),
            (dict(channels=lambda result: {"a": float(result.mz[0, 0])}), "`channels` must be a function that JAX can"),
            (dict(summary="fx"), "`summary` must be True or False, got 'fx'"),
            (dict(memory=-1.0), "`memory` must be a positive number"),
            (dict(client=3), "`client` must be a dask.distributed.Client, got 3"),
            (dict(store=3), "`store` must be the path of a folder, got 3"),
            (dict(store="s3://bucket/study"), "`store` must be the path of a folder"),
            (dict(store="/nowhere/at/all/study.zarr"), "/nowhere/at/all is missing"),
            (dict(build=lambda stiffness, distance: 3), "`build` must return a Scene, got 3"),
            (dict(build=_branches), "`build` must not depend on the value .* on `distance`:"),
            (dict(build=_grows), "on `stiffness`:"),
            (dict(build=_interpolates), "`build` must not depend .* on `stiffness`:.* jnp.interp"),
            (dict(build=_calls_math), "`build` must not depend .* on `stiffness`:.* jnp.exp"),
            (dict(build=_looks_up), "`build` must be traceable by JAX, got TypeError"),
            (dict(build=_misspelt), "`build` must return a Scene, got NameError .*'distanse'"),
            (dict(build=_bad_constant), "`stiffness` must be"),
            (dict(build=_other_object), "`scene.profile` differs"),
            (dict(build=_other_ends), r"`scene.support.springs\[0\].between` differs"),
            (dict(build=_positional), "positional.only"),
        ],
        ids=lambda value: None if isinstance(value, str) else "-".join(value),
    )
    def test_are_raised_before_anything_is_computed(self, call, words, monkeypatch):
        monkeypatch.setattr(importlib.import_module("jaxwhisker._study.study"), "Kernel", None)
        arguments = {"build": build, "control": CONTROL} | AXES | call
        with pytest.raises(ValueError, match=words):
            jw.study(**arguments)

    def test_a_missing_axis(self):
        with pytest.raises(
            ValueError,
            match=r"parameters of `build\(stiffness, distance\)`, got stiffness: missing a required .*'distance'",
        ):
            jw.study(build, stiffness=[70.0])
        with pytest.raises(ValueError, match="`axes` must contain the values of at least one"):
            jw.study(build)

    def test_a_parameter_named_like_an_option(self):
        with pytest.raises(ValueError, match=r"`build` must not have a parameter .* option of `study`, got `memory`"):
            jw.study(_memory, control=CONTROL, other=[1.0])

    def test_an_axis_named_like_a_variable(self):
        with pytest.raises(ValueError, match=r"name of an axis must not be .* got `whisker`"):
            jw.study(lambda whisker: build(whisker, 0.2), whisker=[70.0])

    @pytest.mark.unchecked
    @pytest.mark.parametrize(
        ("points", "words"),
        [
            ({"stiffness": [1.0, 2.0], "distance": [0.2]}, "columns of equal length.*'stiffness': 2, 'distance': 1"),
            ({"stiffness": [1.0]}, "missing a required .*'distance'"),
            ([1.0, 2.0], "`points` must be a table"),
        ],
    )
    def test_a_bad_table(self, points, words):
        with pytest.raises(ValueError, match=words):
            jw.study(build, points=points)

    def test_a_control_too_long(self, monkeypatch):
        monkeypatch.setattr(importlib.import_module("jaxwhisker._study.compute"), "MOST_POSITIONS", 100)
        with pytest.raises(
            ValueError, match=r"`control` must be given .* 100 positions.* stiffness = 50, distance = 0.1"
        ):
            jw.study(build, points={"stiffness": [50.0, 200.0, 70.0], "distance": [0.1, 0.4, 0.2]})

    @pytest.mark.parametrize("package", ["xarray", "tqdm"])
    def test_a_missing_package(self, package, monkeypatch):
        monkeypatch.setitem(importlib.import_module("sys").modules, package, None)
        with pytest.raises(ImportError, match=re.escape(f"`study` needs {package}: pip install jaxwhisker[study]")):
            jw.study(build, **AXES)
