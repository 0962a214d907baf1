"""Duration and speed of films, of runs made by hand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from handmade import SI, handmade_scan
from jaxwhisker._dynamics.simulation import MotionEnergy, TimedEvents
from jaxwhisker._scan.quantities import STATE
from jaxwhisker._scan.state import OPTIONAL
from jaxwhisker.film.pace import check_begun, duration_of_film, in_words

BOUNDS = {"default": 12.0, "longest": 300.0}


def motion(duration=2.0, *, samples=5, failed=0, length=1.0, stiffness=1.0):
    """A simulation from the time 1; the last `failed` samples are lost, and their times are known."""
    zero = jnp.zeros((samples, 1))
    each: dict[str, Any] = {name: zero for name in STATE if name not in OPTIONAL} | {"phase": zero.astype(int)}
    none = jnp.zeros(0)
    time = 1.0 + np.linspace(0.0, duration, samples)
    return jw.Simulation(
        **each,
        time=jnp.asarray(time),
        control=zero[:, 0],
        gap=zero,
        spring_length=zero,
        energy=MotionEnergy(*[zero[:, 0]] * 8),
        curvature=zero[..., None],
        tip_x=zero,
        tip_y=zero,
        status=jnp.where(jnp.arange(samples) < samples - failed, int(jw.Status.ok), int(jw.Status.lost)),
        events=TimedEvents(none.astype(int), none.astype(int), none, none, jnp.asarray(0)),
        scene=jw.Sensor(jw.Whisker(length, stiffness, mass_per_length=1.0), jw.Support.fb(70.0)),
    )


def test_the_duration_is_given_or_follows_from_the_speed():
    scan = handmade_scan()
    assert duration_of_film(scan, None, None, **BOUNDS) == 12.0
    assert duration_of_film(scan, 3.0, None, **BOUNDS) == duration_of_film(motion(), 3.0, None, **BOUNDS) == 3.0
    assert duration_of_film(motion(), None, None, **BOUNDS) == 12.0
    assert duration_of_film(motion(), None, 0.1, **BOUNDS) == pytest.approx(20.0)
    assert duration_of_film(motion(failed=5), None, 4.0, **BOUNDS) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("run", "seconds", "speed", "message"),
    [
        (handmade_scan, None, 1.0, "`speed` must be None for the film of a scan, which has no time, got 1.0"),
        (motion, 2.0, 1.0, "`speed` must be None if `seconds` is given, got 1.0"),
        (motion, None, -1.0, "`speed` must be a positive finite number, got -1.0"),
        (motion, None, 0.006, "`speed` must be at least 0.00667 for a film of at most 300 seconds, got 0.006"),
    ],
)
def test_impossible_speeds_are_named(run, seconds, speed, message):
    with pytest.raises(ValueError, match=message):
        duration_of_film(run(), seconds, speed, **BOUNDS)


def test_a_batch_has_no_duration():
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), motion())
    with pytest.raises(ValueError, match="`result` must be a single simulation"):
        duration_of_film(batch, None, None, **BOUNDS)


def test_a_film_needs_a_first_state():
    check_begun(motion(failed=4))
    check_begun(handmade_scan(failed=2))  # a scan may be lost in between and found again
    with pytest.raises(ValueError, match="`result` must be a simulation whose first sample is ok, got the status lost"):
        check_begun(motion(failed=5))


def test_speeds_in_words_are_those_of_seconds():
    si: dict[str, Any] = {"length": SI[0], "stiffness": SI[1]}
    words = {
        20.0: "10 times slower",
        0.5: "4 times faster",
        2.0: "real time",
        2.009: "real time",
        2.2: "1.1 times slower",
    }
    for seconds, text in words.items():
        assert in_words(motion(**si), seconds, "SI") == f" ({text})"
    assert in_words(motion(**si), 20.0, "auto") == " (10 times slower)"
    # Dimensionless time and controls of scans pass at no speed.
    assert in_words(motion(**si), 20.0, "dimensionless") == in_words(motion(), 20.0, "auto") == ""
    assert in_words(handmade_scan(*SI), 20.0, "SI") == ""
