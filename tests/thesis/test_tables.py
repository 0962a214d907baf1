"""Tables A.1 to A.4 beside the printed values."""

import pytest

from jaxwhisker.thesis.tables import TABLES, table_rows

THESIS_DIGIT = 5.001e-5  # half a unit of the last printed digit
MISPRINTED = ("A.3", "F = 1 at 100 %", "Mz")  # which table A.4 prints correctly


@pytest.mark.parametrize("name", TABLES)
def test_every_printed_digit_is_reproduced(name):
    for load, reaction, _, printed, difference, _ in table_rows(TABLES[name])[1:]:
        if printed != "-":
            assert (abs(float(difference)) < THESIS_DIGIT) == ((name, load, reaction) != MISPRINTED)
