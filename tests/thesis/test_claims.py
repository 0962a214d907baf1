"""Claims: which cases they need, and what they compare; docs/thesis.md has the results."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker.thesis import claims
from jaxwhisker.thesis.claims import Claim, cell, measure_all, monotone
from jaxwhisker.thesis.scans import Scans

PAGE = (Path(__file__).parents[2] / "docs" / "thesis.md").read_text("utf-8")


class Peaks(Scans):
    """Stands for scans whose summaries follow simple rules: maxima fall with the distance, positions with c."""

    def __init__(self):
        super().__init__()

    def summary(self, case, whisker, *names):
        return [self._variable(case, name) for name in names]

    def _variable(self, case, name):
        sign = -1.0 if name == "min_fx" else 1.0
        if name.startswith(("min", "max")):
            return sign / case.distance
        return 1 / case.stiffness - case.distance if name == "last_contact" else -1 / case.stiffness

    def events(self, case) -> Any:
        return case


def test_the_page_has_every_claim_with_its_numbers():
    headings = re.findall(r"^### (\d+)\. ", PAGE, re.MULTILINE)
    assert headings == [str(k + 1) for k in range(len(claims.CLAIMS))]
    assert PAGE.count("<summary>Numbers</summary>") == len(claims.CLAIMS)


def test_the_claims_need_every_model():
    assert {case.model for case in claims.needed()} == {"FB", "FBFB", "FBFBR", "FBFBFBR"}


def test_softer_springs_shift_the_maxima(monkeypatch):
    claim = claims.softer_springs(Peaks())
    assert claim.holds == "yes" and "moves the other way" in " ".join(claim.result.split())
    assert claim.statement == "Softer springs shift the maxima towards -x" and claim.figures == "6.2, 6.11, 6.19"
    assert claim.explanation.startswith("Before the vertex the object pushes")
    monkeypatch.setattr(Peaks, "_variable", lambda self, case, name: 0.0)
    claim = claims.softer_springs(Peaks())
    assert claim.holds == "no" and claim.result == "The claim holds for 0 of 20 comparisons."


def test_the_distance_changes_the_maxima(monkeypatch):
    monkeypatch.setattr(claims, "snap_through", lambda case: None)
    claim = claims.changed_by_distance(Peaks())
    assert claim.holds == "in part"  # positions of this stand-in move the wrong way
    assert claim.rows[1] == ["FB", "0.1", "1", "-10.0000", "10.0000", "10.0000", "-0.0857", "-"]


def test_the_short_result_is_the_first_sentence():
    def in_short(result):
        return Claim("A statement", "6.1", "yes", result, "", []).in_short()

    assert in_short("The claim holds: all\n  peaks fall by 0.5. There is more.") == "all peaks fall by 0.5"
    assert in_short("The claim holds for one whisker.") == "for one whisker"
    assert in_short("Another result.") == "Another result"


def test_measures_become_rows():
    rows, measured = measure_all("stiffness", lambda case, whisker: [whisker, math.nan])
    assert rows[6] == ["FBFB", "30", "1", "1.0000", "-"] and rows[17] == ["FBFB", "inf", "2", "2.0000", "-"]
    assert [name for name, _ in measured] == ["FB", "FBFB", "FBFB", "FBFBR", "FBFBR"]
    np.testing.assert_array_equal(measured[2][1][:, 0], [2.0] * 6)


def test_small_helpers():
    assert monotone([1.0, 2.0, 3.0], 1.0) and not monotone([1.0, 1.0], 1.0) and monotone([2.0, 1.0], -1.0)
    assert (cell(math.nan), cell(-1e-9, 2)) == ("-", "0.00")
