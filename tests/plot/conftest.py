"""Scans that the figures of several modules show, and rules for all of them."""

import pytest
from matplotlib import pyplot, rcParams

import jaxwhisker as jw
from pictured import ANGLES, CONTROL, LENGTH, STIFFNESS, coupled, past_ball, swept, turning


@pytest.fixture(scope="session")
def in_space():
    """A scan in space, in SI units."""
    return past_ball()


@pytest.fixture(scope="session")
def motion():
    """A simulation: touches, bounces, slides along the object and is released."""
    return swept()


@pytest.fixture(scope="session")
def result():
    return jw.scan(coupled(), CONTROL)


@pytest.fixture(scope="session")
def turned():
    return jw.scan(turning(), ANGLES)


@pytest.fixture(scope="session")
def result_in_si():
    """The same scan as `result`, in SI units."""
    return jw.scan(coupled(LENGTH, STIFFNESS), CONTROL * LENGTH)


@pytest.fixture(autouse=True)
def _no_side_effects(monkeypatch):
    """No figure opens a window or changes matplotlib's settings."""

    def never(*_, **__):
        raise AssertionError("a figure opened a window")

    monkeypatch.setattr(pyplot, "show", never)
    before = dict(rcParams)
    yield
    assert dict(rcParams) == before
    pyplot.close("all")
