"""The scans behind the results: cases of a study, the critical stiffness, peaks of the clamped whisker."""

import dataclasses
import threading

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.aside import Compilers
from jaxwhisker._scan.plane import follow_path_now
from jaxwhisker._scan.scan import prepare_scan
from jaxwhisker._scan.slopes import events_now, solved_states_now
from jaxwhisker.thesis import scans as module
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claims import CLAMPED_CASE, PEAKS, deviation_from_clamped, needed
from jaxwhisker.thesis.scans import Case, Scans, critical_bracket, critical_cases, snap_through, steepest_slope, vary

MAXIMUM = 1e-6  # relative: the expected maxima have six digits
BATCHED = 1e-8  # rounding differs in a batch
SOFT = Case(stiffness=30.0)
CASES = [*(case for figure in FIGURES.values() for case in figure.cases), *needed()]


@pytest.fixture(scope="module")
def scans():
    with Scans([CLAMPED_CASE, SOFT], critical_cases("FB", 0.2)) as kept:
        yield kept


def test_one_whisker_snaps_through_only_below_the_steepest_slope(scans):
    low, high = critical_bracket(scans, critical_cases("FB", 0.2))
    assert low < steepest_slope(0.2).slope < high
    assert snap_through(scans.events(SOFT)) is None


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


def test_events_do_not_need_the_steps_between_the_ends(scans):
    case = critical_cases("FB", 0.2)[0]
    whole = jw.scan(case.scene, dataclasses.replace(case, brief=False).control()).events
    for one, other in zip(scans.events(case), whole, strict=True):
        assert (one.kind, one.whiskers, one.control) == (other.kind, other.whiskers, other.control)


def test_prepared_scans_compile_nothing_more():
    case = Case("FBFB")
    with Compilers() as pool:
        prepare_scan(pool, case.scene, case.control())
    programs = [follow_path_now, solved_states_now, events_now]
    before = [program.compilations for program in programs]
    assert len(jw.scan(case.scene, case.control()).events) > 0
    assert [program.compilations for program in programs] == before and 0 not in before


def test_all_programs_are_requested_before_the_first_study_is_complete(monkeypatch):
    requested, every = [], threading.Event()

    def prepare_scan(pool, scene, control):
        requested.append((scene.support.whiskers, str(scene.profile)))
        if len(requested) == len({case.structure for case in CASES}):
            every.set()

    def study(build, **_):
        assert every.wait(timeout=30), f"only these were requested: {requested}"
        raise RuntimeError("no study")

    monkeypatch.setattr(module, "prepare_scan", prepare_scan)
    monkeypatch.setattr(module, "study", study)
    with Scans(CASES) as scans, pytest.raises(RuntimeError, match="no study"):  # errors in the background surface
        scans(CASES[0])
    assert {kind for kind, _ in requested} == {1, 2, 3}


def test_a_failure_while_cases_are_chosen_surfaces():
    def broken():
        raise RuntimeError("no cases")
        yield

    with Scans([], broken()) as scans, pytest.raises(RuntimeError, match="no cases"):
        scans(SOFT)


def test_cases_differ_in_one_field():
    cases = vary("distance", Case("FBFB"), (0.1, 0.3))
    assert cases == {"$q$ = 0.1": Case("FBFB", distance=0.1), "$q$ = 0.3": Case("FBFB", distance=0.3)}
    assert list(vary("stiffness", values=(30.0, np.inf))) == ["$c$ = 30", r"$c$ = $\infty$"]
    assert Case("FBFB").control()[[0, -1]] == pytest.approx([1.0, -2.2])
