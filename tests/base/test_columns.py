"""Columns of files as spreadsheets, NumPy and laboratory programs write them."""

import gzip

import numpy as np
import pytest

from jaxwhisker._base.columns import cells_of, read_columns

CONTROL, FX = np.array([0.1, 0.2, 0.3]), np.array([1.5, np.nan, -2.0])
LABVIEW = "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\nX_Value\tForce\tComment\n"
TEXTS = {
    "comma": "control,fx\n0.1,1.5\n0.2,\n0.3,-2\n",
    "semicolon and decimal comma": "control; fx\n0,1; 1,5\n0,2; NA\n0,3; -2,0\n",
    "tabs, comments and units": "# of a drive\ncontrol\tfx\nmm\tN\n0.1\t1.5\n0.2\tnan\n0.3\t-2e0\n",
    "spaces": "control fx\n0.1  1.5\n0.2 nan\n0.3 -2\n",
}


def written(tmp_path, text):
    path = tmp_path / "sweep.txt"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("kind", TEXTS)
def test_columns_of_any_separator(tmp_path, kind):
    found = read_columns(written(tmp_path, TEXTS[kind]))
    assert list(found) == ["control", "fx"]
    np.testing.assert_array_equal([found["control"], found["fx"]], [CONTROL, FX])


@pytest.mark.parametrize("delimiter", [" ", ",", ";"])
def test_numpy_writes_names_behind_a_sign(tmp_path, delimiter):
    path = tmp_path / "saved.txt"
    header = delimiter.join(["control", "fx"])
    np.savetxt(path, np.stack([CONTROL, FX], axis=1), delimiter=delimiter, header=header)
    found = read_columns(path)
    np.testing.assert_array_equal([found["control"], found["fx"]], [CONTROL, FX])


def test_a_preamble_is_skipped_and_columns_are_renamed(tmp_path):
    path = written(tmp_path, LABVIEW + "0.1\t1.5\tstart\n0.2\t\n0.3\t-2\n")
    found = read_columns(path, columns={"control": "X_Value", "fx": "Force"}, skip=4)
    assert list(found) == ["control", "fx"]
    np.testing.assert_array_equal([found["control"], found["fx"]], [CONTROL, FX])


def test_columns_of_text_are_left_out_unless_they_are_asked_for(tmp_path):
    path = written(tmp_path, "name,a\nfirst,1\nsecond,2\n")
    assert list(read_columns(path)) == ["a"]
    with pytest.raises(ValueError, match=r"`path` must be columns of numbers .*'first' \(name\)"):
        read_columns(path, columns={"fx": "name"})


def test_compressed_files(tmp_path):
    path = tmp_path / "sweep.csv.gz"
    path.write_bytes(gzip.compress(TEXTS["comma"].encode()))
    np.testing.assert_array_equal(read_columns(path)["control"], CONTROL)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("control,fx,control,fx\n1,2,3,4\n", {}, "`path` must hold each column once, got several of control, fx"),
        ("a,b\n1,2\n3\n", {}, "`path` must be columns of equal length"),
        ("a,b\n1,2,3\n", {}, "`path` must be columns of equal length"),
        ("a,b\n1,2\n", {"columns": {"fx": "c"}}, "`columns` must be among the columns of the file, a, b, got c"),
        ("a,b\n1,2\n", {"columns": ["a"]}, "`columns` must be a mapping"),
        ("a,b\n1,2\n", {"skip": -1}, "`skip` must be"),
        ("a,b\n1,2\n", {"skip": 2}, "`path` must be columns of equal length"),
    ],
)
def test_wrong_files(tmp_path, text, options, words):
    with pytest.raises(ValueError, match=words):
        read_columns(written(tmp_path, text), **options)


def test_a_first_row_without_values_is_no_line_of_units(tmp_path):
    found = read_columns(written(tmp_path, "control,fx\nNA,\n0.1,1.5\n"))
    np.testing.assert_array_equal(found["control"], [np.nan, 0.1])


def test_columns_that_nobody_wants_may_occur_twice(tmp_path):
    path = written(tmp_path, "control,x,x\n1,2,3\n")
    assert cells_of("measured", path, {"control"}.__contains__)["control"] == ("1",)


def test_files_that_are_none(tmp_path):
    with pytest.raises(ValueError, match=r"`path` must be the path of a CSV file, got .*, which is a directory"):
        read_columns(tmp_path)
    with pytest.raises(ValueError, match=r"which does not exist"):
        read_columns(tmp_path / "none.csv")
