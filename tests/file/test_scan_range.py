"""Positions of the drive that a file asks for."""

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._file import scan_range
from jaxwhisker._file.scan_range import ScanRange
from jaxwhisker._scan.route import STEP
from jaxwhisker._scan.scan import default_control

SCENE = jw.Scene(jw.Whisker(2.0), jw.Circle(0.3, 0.5), rod=jw.ClosedForm())


def test_positions_are_as_far_apart_as_asked_for():
    np.testing.assert_array_equal(ScanRange(0.5, -0.5, 21).control(SCENE), np.linspace(0.5, -0.5, 21))
    np.testing.assert_array_equal(ScanRange(positions=(0.5, 0.1, 0.2)).control(SCENE), [0.5, 0.1, 0.2])
    usual = ScanRange(0.5, -0.5).control(SCENE)
    assert usual is not None
    np.testing.assert_allclose(np.diff(usual), -STEP * 2.0)
    assert ScanRange(units="SI").control(SCENE) is None


def test_missing_ends_are_those_of_a_scan(monkeypatch):
    whole = default_control(SCENE)
    monkeypatch.setattr(scan_range, "default_control", lambda scene: whole)
    assert ScanRange(start=0.5).ends(SCENE) == (0.5, whole[-1])
    assert ScanRange(stop=0.5).ends(SCENE, further=1.0) == (whole[0], 0.5)
    assert ScanRange().ends(SCENE, further=1.0) == (whole[0], whole[-1] - 1.0)  # towards -x
    control = ScanRange(steps=5).control(SCENE)
    assert control is not None and control.size == 5 and tuple(control[[0, -1]]) == (whole[0], whole[-1])


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"start": np.nan}, ["`start`", "nan"]),
        ({"stop": "far"}, ["`stop`", "'far'"]),
        ({"steps": 1}, ["`steps`", "at least 2"]),
        ({"steps": 10.0}, ["`steps`", "10.0"]),
        ({"positions": (0.1, np.inf)}, ["`positions`", "inf at index 1"]),
        ({"positions": (0.1, 0.2), "start": 0.3}, ["`positions`", "`start`"]),
        ({"units": "inch"}, ["`units`", "inch", "dimensionless"]),
    ],
)
def test_wrong_values_are_refused(values, words):
    with pytest.raises(ValueError) as caught:
        ScanRange(**values)
    assert [word for word in words if word not in str(caught.value)] == []
