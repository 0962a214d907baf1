"""Design: the best sensor, and wrong arguments."""

from typing import Any

import numpy as np
import pytest

import jaxwhisker as jw
from recordings import CONTROL, NOISE, TRUTH, fb


def test_design_finds_the_best_spring():
    data = jw.design(fb, {"q": 0.27}, sigma=NOISE, control=CONTROL, c=[40.0, TRUTH["c"], 200.0])
    assert data.standard_error.dims == ("c", "parameter")
    alone = jw.information(fb, TRUTH, sigma=NOISE, control=CONTROL).known("c").standard_error["q"]
    np.testing.assert_allclose(data.standard_error.sel(c=TRUTH["c"], parameter="q"), alone, rtol=1e-6)
    best = float(data.c[int(np.argmin(data.relative_error.sel(parameter="q").values))])
    assert data.attrs["best"] == f"c = {best:g}"


NO_MAPPING: Any = 3.0


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jw.design(fb, NO_MAPPING, sigma=1.0, c=[1.0, 2.0]), "`at`.*3.0"),
        (lambda: jw.design(fb, {"q": 0.3}, sigma=1.0, k=[1.0], control=[0.7, 0.1]), "`axes` must name .*'k'"),
        (lambda: jw.design(fb, TRUTH, sigma=1.0), "`axes`"),
        (lambda: jw.design(fb, TRUTH, sigma=1.0, c=[1.0]), "`c`"),
        (lambda: jw.design(fb, {"q": 0.3}, sigma=1.0, c=[50.0, -1.0], control=[0.7, 0.1]), "`stiffness`.*-1.0"),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
