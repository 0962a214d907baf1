"""Duration and speed of a film."""

from typing import Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._path.path import Status
from jaxwhisker._scan.quantities import UnitSystem
from jaxwhisker.plot.runs import Run, check_one_run, places

REAL = 0.005  # relative difference from real time that is not worth a word


def duration_of_film(
    result: Any, seconds: float | None, speed: float | None, *, default: float, longest: float
) -> float:
    """How long the film of a run takes, without snaps and the last frame.

    Raises:
        ValueError: if `result` is not one run, or `speed` is not one at which its film can be shown.
    """
    check_one_run(result)
    if speed is None:
        return default if seconds is None else seconds
    if not isinstance(result, Simulation):
        checks.fail("speed", "None for the film of a scan, which has no time", repr(speed))
    if seconds is not None:
        checks.fail("speed", "None if `seconds` is given", repr(speed))
    checks.number("speed", speed, positive=True)
    seconds, least = _duration(result) / speed, _duration(result) / longest
    if seconds > longest:
        checks.fail("speed", f"at least {least:.3g} for a film of at most {longest:g} seconds", f"{speed:g}")
    return seconds


def check_begun(result: Run) -> None:
    """Check that a simulation has a first state to show."""
    status = int(np.asarray(result.status)[0])
    if isinstance(result, Simulation) and status != Status.ok:
        checks.fail("result", "a simulation whose first sample is ok", f"the status {Status(status).name}")


def _duration(motion: Simulation) -> float:
    time = places(motion, "time")
    return float(time[-1] - time[0])


def in_words(result: Run, seconds: float, units: str) -> str:
    """The speed of a film in words, if times are in seconds."""
    if not isinstance(result, Simulation) or UnitSystem(result.scene, units).dimensionless:
        return ""
    slower = seconds / _duration(result)
    if not slower > 0 or abs(slower - 1) < REAL:
        return " (real time)" if slower > 0 else ""
    return f" ({max(slower, 1 / slower):.3g} times {'slower' if slower > 1 else 'faster'})"
