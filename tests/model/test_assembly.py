"""Whiskers on a support: numbers that must agree, and texts."""

import pytest

import jaxwhisker as jw
from jaxwhisker._model.assembly import check_whiskers, each_whisker, in_row, motion_text, support_text, whisker_text

TWO = jw.Support((jw.Spring((0, 1), 70.0), jw.Spring((1, 2), 50.0)))


def test_one_whisker_serves_all_bases():
    whisker = jw.Whisker()
    assert check_whiskers(whisker, TWO) == (whisker, whisker) == each_whisker(whisker, TWO)


def test_one_whisker_per_base_keeps_its_place():
    first, second = jw.Whisker(), jw.Whisker(length=2.0)
    assert each_whisker((first, second), TWO) == (first, second)


@pytest.mark.parametrize(("whisker", "support"), [((), TWO), ("hair", TWO), (jw.Whisker(), "springs")])
def test_wrong_types_are_errors(whisker, support):
    with pytest.raises(ValueError, match=r"`(whisker|support)` must be"):
        check_whiskers(whisker, support)


def test_another_number_of_whiskers_is_an_error():
    with pytest.raises(
        ValueError, match=r"`whisker` must be one Whisker or one per base \(2 in FBFB\), got a tuple of 1"
    ):
        check_whiskers((jw.Whisker(),), TWO)


def test_default_rest_lengths_follow_from_the_first_whisker():
    springs = in_row(jw.Whisker(length=2.0), jw.Support.fb(70.0)).springs
    assert float(springs[0].rest_length) == 0.4
    assert in_row("hair", TWO) is TWO


def test_texts_leave_out_defaults():
    assert support_text(TWO) == "FBFB: 2 whiskers, 2 springs"
    assert whisker_text(jw.Whisker()) == motion_text(jw.Translation()) == ""
    assert whisker_text(jw.Whisker(length=2.0, intrinsic_curvature=0.1)) == ", L = 2, kappa0 = 0.1"
    assert motion_text(jw.LinearDrive((0.0, 0.0, 1.0))).startswith(", translation along")
