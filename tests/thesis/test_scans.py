"""The scans behind the results: cases of a study, the critical stiffness, peaks of the clamped whisker."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker.thesis.claims import CLAMPED_CASE, PEAKS, deviation_from_clamped
from jaxwhisker.thesis.scans import Case, Scans, critical_bracket, critical_cases, snap_through, steepest_slope, vary

MAXIMUM = 1e-6  # relative: the expected maxima have six digits
BATCHED = 1e-8  # rounding differs in a batch
SOFT = Case(stiffness=30.0)


@pytest.fixture(scope="module")
def scans():
    with Scans([CLAMPED_CASE, SOFT, *critical_cases("FB", 0.2)]) as kept:
        yield kept


def test_one_whisker_snaps_through_only_below_the_steepest_slope(scans):
    low, high = critical_bracket(scans, critical_cases("FB", 0.2))
    assert low < steepest_slope(0.2).slope < high
    assert snap_through(scans(SOFT)) is None


@pytest.mark.parametrize(("name", "expected"), [("min_fx", -7.40235), ("max_fy", 20.89341), ("max_mz", 6.46427)])
def test_peaks_are_those_of_the_clamped_whisker(scans, name, expected):
    assert name in PEAKS
    for case in (CLAMPED_CASE, SOFT):
        (peak,) = scans.summary(case, 1, name)
        assert abs(peak / expected - 1) < MAXIMUM
    assert deviation_from_clamped(scans, scans.summary(SOFT, 1, *PEAKS)) < MAXIMUM


def test_a_case_of_a_study_is_the_result_of_its_scan(scans):
    in_study, alone = scans(SOFT), jw.scan(scans(SOFT).scene, SOFT.control())
    for one, other in zip(jax.tree.leaves(in_study), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=BATCHED)


def test_cases_differ_in_one_field():
    cases = vary("distance", Case("FBFB"), (0.1, 0.3))
    assert cases == {"$q$ = 0.1": Case("FBFB", distance=0.1), "$q$ = 0.3": Case("FBFB", distance=0.3)}
    assert list(vary("stiffness", values=(30.0, np.inf))) == ["$c$ = 30", r"$c$ = $\infty$"]
    assert Case("FBFB").control()[[0, -1]] == pytest.approx([1.0, -2.2])
