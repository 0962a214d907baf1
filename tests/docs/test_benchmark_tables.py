"""Benchmark results are stored with rounded numbers and read back."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))

import common  # noqa: E402

ROWS = [{"model": "FB", "steps": 1600, "time, s": 0.123456789012}, {"model": "FBFB", "curve": [[1 / 3, 2.0]]}]


def test_results_are_read_as_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(common, "RESULTS", tmp_path / "results")
    common.write("example", ROWS)
    assert "| FB | 1,600 | 0.123 |" in capsys.readouterr().out
    stored = common.read("example")
    assert stored["environment"].keys() == common.environment().keys()
    assert stored["rows"] == [
        {"model": "FB", "steps": 1600, "time, s": 0.12345679, "curve": None},
        {"model": "FBFB", "steps": None, "time, s": None, "curve": [[0.33333333, 2.0]]},
    ]


def test_a_table_has_no_empty_columns():
    assert common.table([{"a": 1, "b": None}, {"a": 2e-5}]) == "| a |\n| --- |\n| 1 |\n| 2e-05 |"


@pytest.mark.parametrize("path", sorted(common.RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_a_results_file_has_one_row_per_line(path):
    text = path.read_text("utf-8")
    stored = json.loads(text)
    assert common.serialised(stored["environment"], common.read(path.stem)["rows"]) == text
    assert len(text.splitlines()) == len(stored["rows"]) + 4
