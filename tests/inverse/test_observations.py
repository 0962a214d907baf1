"""Observations: every form of data and of noise ends in the same arrays, or in an error that names the argument."""

import gzip

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from jaxwhisker._inverse.observations import Observations, channels_of, read_observations

CONTROL = np.linspace(0.5, -0.5, 6)
FX, MZ = np.arange(12.0).reshape(6, 2), np.arange(6.0) - 2.0


def same(a, b):
    return all(np.array_equal(getattr(a, n), getattr(b, n), equal_nan=True) for n in ("control", "values", "sigma"))


def test_columns_and_arrays_are_the_same():
    arrays = read_observations({"control": CONTROL, "fx": FX, "mz_2": MZ})
    columns = read_observations({"control": CONTROL, "fx_1": FX[:, 0], "fx_2": FX[:, 1], "mz_2": MZ})
    assert same(arrays, columns) and same(arrays, read_observations(arrays))
    np.testing.assert_array_equal(arrays.values[:, :, 0], FX)
    np.testing.assert_array_equal(arrays.values[:, 1, 2], MZ)
    assert np.isnan(arrays.values[:, :, 1]).all() and np.isnan(arrays.values[:, 0, 2]).all()
    assert arrays.names == ["fx_1", "fx_2", "mz_2"] and np.isnan(arrays.sigma).all()
    np.testing.assert_array_equal(arrays.peaks, [11.0, 1.0, 3.0])  # 1 where nothing was measured


def test_other_columns_of_a_scan_are_ignored():
    others = {
        name: MZ for name in ("status", "phase_1", "base_x_1", "contact_force", "spring_1", "event_control", "time")
    }
    assert same(
        read_observations({"control": CONTROL, "fx": FX} | others), read_observations({"control": CONTROL, "fx": FX})
    )


def test_whiskers_may_be_missing_and_infinite_values_are_gaps():
    observed = read_observations({"control": CONTROL, "mz": np.where(MZ > 2, np.inf, MZ)}, whiskers=3)
    assert observed.values.shape == (6, 3, 3) and observed.known.sum() == 5
    assert [c.name for c in observed.channels] == ["mz_1"]
    assert [c.name for c in channels_of(1)] == ["fx", "fy", "mz"]


def test_noise_by_number_by_channel_and_by_step():
    data = {"control": CONTROL, "fx": FX, "mz": FX}
    assert np.all(read_observations(data, 0.5).sigma == 0.5)
    each = read_observations(data, {"fx": np.arange(1.0, 7.0), "mz": 3.0, "mz_2": 4.0}).sigma
    np.testing.assert_array_equal(each[:, 1, 0], np.arange(1.0, 7.0))
    assert np.all(each[:, 0, 2] == 3.0) and np.all(each[:, 1, 2] == 4.0)


def test_parts_of_observations():
    observed = read_observations({"control": CONTROL, "fx": FX}, 0.5)
    assert same(observed.at(slice(0, 2)), Observations(CONTROL[:2], observed.values[:2], observed.sigma[:2]))
    np.testing.assert_array_equal(observed.with_sigma([1.0, 2.0, 3.0]).sigma[4, 1], [1.0, 2.0, 3.0])


def test_a_file_is_read_with_comments_gaps_and_quotes(tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text('# made today\n"control",fx\n0.5,1\n0.4,\n\n0.3,2\n', encoding="utf-8-sig")
    observed = read_observations(path)
    np.testing.assert_array_equal(observed.control, [0.5, 0.4, 0.3])
    np.testing.assert_array_equal(observed.values[:, 0, 0], [1.0, np.nan, 2.0])


FRAME = pd.DataFrame({"control": CONTROL, "fx_1": FX[:, 0] / 3, "mz_2": np.where(MZ > 2, np.nan, MZ)})
TABLE = {name: FRAME[name].to_numpy() for name in FRAME}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize(("name", "encoding"), [("a.csv", "latin-1"), ("a.csv.gz", "utf-8-sig"), ("a.txt", "utf-16")])
def test_files_of_other_programs(tmp_path, separator, decimal, name, encoding):
    path = tmp_path / name
    others = FRAME.assign(Prüfer="Zoë, Kim", temperature=20.5)
    text = "# Kraft in µN\n" + others.to_csv(sep=separator, decimal=decimal)  # with an index
    path.write_bytes(gzip.compress(text.encode(encoding)) if name.endswith("gz") else text.encode(encoding))
    with pytest.warns(UserWarning, match=r"several whiskers\) are ignored: Prüfer, temperature\.$"):
        assert same(read_observations(path), read_observations(TABLE))


def test_full_precision_is_read(tmp_path):
    path = tmp_path / "measured.csv"
    FRAME.assign(fx_1=FRAME.fx_1 * np.pi).to_csv(path, index=False)
    np.testing.assert_array_equal(read_observations(path).values[:, 0, 0], FX[:, 0] / 3 * np.pi)


def test_an_index_may_be_the_control_or_without_a_name():
    indexed = FRAME.set_index("control")
    assert same(read_observations(indexed), read_observations(TABLE))
    assert same(read_observations(FRAME.rename(columns=str).reset_index(names="")), read_observations(TABLE))


def test_other_columns_are_ignored_with_a_warning():
    with pytest.warns(UserWarning, match=r"other than fx, fy, mz .* are ignored: Fx, date\.$"):
        observed = read_observations({"control": CONTROL, "fx": FX, "Fx": FX, "date": ["today"] * 6})
    assert same(observed, read_observations({"control": CONTROL, "fx": FX}))
    with pytest.warns(UserWarning, match=r"other than bend are ignored: volts\.$"):
        read_observations({"control": CONTROL, "bend": MZ, "volts": MZ, "fx": FX}, kinds=("bend",))


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"fx": MZ}, "`control`, got fx"),
        ({"control": np.stack([CONTROL, CONTROL]), "fx": MZ}, r"got shape \(2, 6\)"),
        ({"control": np.where(MZ > 0, np.nan, CONTROL), "fx": MZ}, "3 values that are not finite"),
        ({"control": CONTROL, "fx": MZ[:5]}, "fx for each of the 6 controls"),
        ({"control": CONTROL, "fx_1": FX}, "one column for fx_1"),
        ({"control": CONTROL, "force": MZ}, "at least one of fx, fy, mz, got control, force"),
        ({"control": CONTROL, "fx": ["a"] * 6}, "hold numbers"),
        ({"control": CONTROL, "fx_3": MZ}, "whisker 3"),
        ({"control": CONTROL, "fx_0": MZ}, "whisker 0"),
        ({"control": CONTROL}, "at least one of fx, fy, mz, got control"),
        (None, "got None"),
    ],
)
def test_wrong_data(data, words):
    with pytest.raises(ValueError, match=f"`measured` must .*{words}"):
        read_observations(data, whiskers=2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns of equal length"),
        ("control,fx\n1,2,3\n", "columns of equal length"),
        ("control,fx\n1,a\n", "columns of numbers.*'a' .fx"),
        ("control;fx\n1;0,5\n2;1,5 N\n", "columns of numbers.*'1.5 N' .fx"),
        ("control;fx\n1;2\n3\n", "columns of equal length"),
    ],
)
def test_wrong_files(tmp_path, text, words):
    path = tmp_path / "measured.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"`measured` must be {words}"):
        read_observations(path)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        (-1.0, r"positive and finite, got -1\.0"),
        ({"fx": np.nan}, "positive and finite, got nan"),
        ("a", "hold numbers, got 'a'"),
        ({"fz": 1.0}, "got 'fz'"),
        ({"fx_3": 1.0}, "got 'fx_3'"),
        ({"mz": 1.0}, "got none for fx"),
        ({"fx": np.ones(5)}, r"got shape \(5,\)"),
    ],
)
def test_wrong_noise(sigma, words):
    with pytest.raises(ValueError, match=f"`sigma` must .*{words}"):
        read_observations({"control": CONTROL, "fx": FX}, sigma)


def test_masked_values_are_missing():
    masked = np.ma.array(FX[:, 0], mask=np.arange(6) % 3 == 1)
    read = read_observations({"control": CONTROL, "fx": masked, "mz": MZ})
    assert read.known[:, 0, 0].tolist() == [True, False, True, True, False, True] and read.known[:, 0, 2].all()
    with pytest.raises(ValueError, match="2 values that are not finite"):
        read_observations({"control": np.ma.array(CONTROL, mask=np.arange(6) % 3 == 1), "mz": MZ})


def test_columns_that_occur_twice_are_refused(tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text("control,fx,fy,mz,control,fx,fy,mz\n" + "1,2,3,4,5,6,7,8\n" * 3)
    with pytest.raises(ValueError, match="`measured` must hold each column once, got several of control, fx, fy, mz"):
        read_observations(path)
    frame = pd.DataFrame(np.ones((3, 3)), columns=["control", "mz", "mz"])
    with pytest.raises(ValueError, match="`measured` must hold each column once, got several of mz"):
        read_observations(frame)
    path.write_text("control,mz,other,other\n" + "1,2,3,4\n" * 3)  # nobody reads these
    with pytest.warns(UserWarning, match="ignored: other"):
        assert read_observations(path).values[0, 0, 2] == 2


def test_matrices_of_other_programs_are_columns():
    # As scipy.io.loadmat reads them; a frame of polars has no index.
    for shape in ((-1, 1), (1, -1)):
        matrix = {"__header__": b"MATLAB", "control": CONTROL.reshape(shape), "mz": MZ.reshape(shape)}
        np.testing.assert_array_equal(read_observations(matrix).values[:, 0, 2], MZ)

    class Frame(dict):
        columns = ("control", "mz")

    read = read_observations(Frame(control=CONTROL, mz=MZ))
    np.testing.assert_array_equal(read.values[:, 0, 2], MZ)


def test_a_dataset_along_time_holds_the_control_as_a_variable():
    data = xr.Dataset({"control": ("time", CONTROL), "mz": ("time", MZ)}, coords={"time": np.arange(CONTROL.size)})
    read = read_observations(data)
    np.testing.assert_array_equal(read.control, CONTROL)
    np.testing.assert_array_equal(read.values[:, 0, 2], MZ)
