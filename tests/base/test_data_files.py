"""Numbers from publications: all rows and columns of rats are there."""

import numpy as np

from jaxwhisker._base.data_files import published

ROWS = ["A", "B", "C", "D", "E"]


def test_tables_of_rats_have_all_rows_and_columns():
    rats = published("rats")
    array, last = rats["array"], rats["cone"]["last_column"]
    assert list(last) == list(array["protraction"]) == list(array["rows"]) == ROWS
    for row in ROWS:
        assert len(array["protraction"][row]) == last[row] + 1
        assert set(array["rows"][row]) == {"elevation", "elevation_rate", "roll_rate"}
    unknown = [(row, k) for row in ROWS for k, angle in enumerate(array["protraction"][row]) if np.isnan(angle)]
    assert unknown == [("E", 0)]


def test_a_file_is_read_once():
    assert published("rats") is published("rats")
