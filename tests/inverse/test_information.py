"""Information: derivatives against differences, and sums over channels and scans."""

from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot

import jaxwhisker as jw
from recordings import CONTROL, NOISE, STEPS, TRUTH, exact, fb

DIFFERENCE = 1e-5  # relative step of central differences, good to 1e-9 of a smooth function
SLOPE = 1e-5  # relative: derivatives against differences of signals that are good to 1e-10


@pytest.fixture(scope="module")
def signals():
    """Information in the signals of one whisker."""
    return jw.information(fb, TRUTH, sigma=NOISE, control=CONTROL)


def test_information_is_that_of_differences(signals):
    control = signals.control
    rates = []
    for name, value in TRUTH.items():
        step = DIFFERENCE * value
        high, low = (exact(fb(**TRUTH | {name: value + s}), control) for s in (step, -step))
        rates.append(np.stack([(high[c] - low[c])[:, 0] / (2 * step) / NOISE[c] for c in NOISE], axis=1))
    expected = np.stack(rates, axis=-1)
    some = np.any(signals.rates != 0, axis=(1, 2))
    # A step beside a snap is left out; differences there would leave the branch.
    some &= np.max(np.abs(np.gradient(expected[:, 2, 0]))) > 0
    scale = np.max(np.abs(signals.rates), axis=(0, 1))
    np.testing.assert_allclose(signals.rates[some] / scale, expected[some] / scale, atol=1e2 * SLOPE)
    assert some.sum() > STEPS // 2


def test_information_adds_up(signals):
    np.testing.assert_allclose(sum(signals.by_channel.values()), signals.matrix, rtol=1e-12)
    alone = signals.of("mz")
    assert alone.channels == ("mz",) and alone.standard_error["c"] > signals.standard_error["c"]
    assert signals.known("q").standard_error["c"] <= signals.standard_error["c"]
    snaps = signals.by_channel["snaps"]
    assert np.linalg.matrix_rank(snaps) == 1  # one snap-off: one combination
    np.testing.assert_allclose(signals.density.sum(axis=0) + np.diag(snaps), np.diag(signals.matrix), rtol=1e-12)
    assert signals.with_events(1e-4).standard_error["c"] < signals.standard_error["c"]
    assert {e.kind.name for e in signals.events} >= {"touch", "vertex", "snap_off"}
    assert "best channel" in str(signals)
    for wrong in (lambda: signals.of("fq"), lambda: signals.known("x"), lambda: signals.known("c", "q")):
        with pytest.raises(ValueError, match="must"):
            wrong()


def test_event_rates_are_those_of_differences(signals):
    (snap,) = [e for e in signals.events if e.kind == jw.EventKind.snap_off]
    for k, (name, value) in enumerate(TRUTH.items()):
        step = DIFFERENCE * value
        at = [
            jw.scan(fb(**TRUTH | {name: value + s}), signals.control).events.of(jw.EventKind.snap_off)[0].control
            for s in (step, -step)
        ]
        assert snap.by_parameter[k] == pytest.approx((at[0] - at[1]) / (2 * step), rel=1e-4)


def test_the_picture_shows_the_share_of_information(signals):
    ax = jw.plot.information(signals)
    curves = {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}
    assert set(curves) == set(TRUTH)
    for k, name in enumerate(signals.names):
        gained = curves[name].get_ydata()
        assert gained[-1] == pytest.approx(1.0) and np.all(np.diff(gained) >= 0)
        np.testing.assert_allclose(np.diff(gained), signals.density[1:, k] / signals.density[:, k].sum(), atol=1e-12)
    pyplot.close("all")


NO_MAPPING: Any = 3.0


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jw.information(fb, TRUTH, sigma=-1.0, control=[0.7, 0.1]), "`sigma`"),
        (lambda: jw.information(fb, TRUTH, sigma=1.0, channels=("fz",), control=[0.7, 0.1]), "`channels`.*'fz'"),
        (lambda: jw.information(fb, TRUTH, sigma={"fx": 1.0}, control=[0.7, 0.1]), "`sigma`.*fy, mz"),
        (lambda: jw.information(fb, TRUTH, sigma=1.0, channels=(), control=[0.7, 0.1]), "`channels`.*empty"),
        (lambda: jw.information(fb, {"c": 1.0}, sigma=1.0), "`at` must name the parameters of `build`"),
        (lambda: jw.information(fb, NO_MAPPING, sigma=1.0), "`at`.*3.0"),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
