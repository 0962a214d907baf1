"""Drive positions of the scan of a scene in a file."""

import equinox as eqx
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.scene import units
from jaxwhisker._scan.quantities import check_units
from jaxwhisker._scan.route import default_positions
from jaxwhisker._scan.scan import default_control


class ScanRange(eqx.Module):
    """The table `scan`: drive positions of a scan, and the units in which its tables and pictures show it.

    Args:
        start: first position. Default: just before the first touch.
        stop: last position. Default: just after the last whisker is free.
        steps: number of positions at equal distances, at least 2.
        positions: all positions, instead of start, stop and steps.
        units: "auto", "SI" or "dimensionless".
    """

    start: Scalar | None = None
    stop: Scalar | None = None
    steps: int | None = None
    positions: tuple[Scalar, ...] | None = None
    units: str = "auto"

    def __check_init__(self):
        ends = {name: getattr(self, name) for name in ("start", "stop", "steps")}
        for name in ("start", "stop"):
            if ends[name] is not None:
                checks.number(name, ends[name])
        if self.steps is not None:
            checks.count("steps", self.steps, least=2)
        if self.positions is not None:
            checks.vector("positions", self.positions)
            for name, value in ends.items():
                if value is not None:
                    checks.fail("positions", f"absent if `{name}` is given", f"{len(self.positions)} numbers")
        check_units(self.units)

    @property
    def is_default(self) -> bool:
        """Whether the positions are those of `scan(scene)`."""
        return self.start is None and self.stop is None and self.steps is None and self.positions is None

    def ends(self, scene: AbstractScene, further: float = 0.0) -> tuple[float, float]:
        """The first and the last position; by default those of `scan(scene)`, or so much further."""
        start, stop = self.start, self.stop
        if start is None or stop is None:
            first, *_, last = default_control(scene)
            start = first if start is None else start
            stop = last + scene.motion.onwards * further if stop is None else stop
        return float(start), float(stop)

    def control(self, scene: AbstractScene) -> np.ndarray | None:
        """The positions for a scene; None for those of `scan(scene)`."""
        if self.is_default:
            return None
        if self.positions is not None:
            return np.asarray(self.positions, dtype=float)
        start, stop = self.ends(scene)
        return default_positions(start, stop, units(scene)) if self.steps is None else spaced(start, stop, self.steps)


def spaced(start: float, stop: float, steps: int) -> np.ndarray:
    """Positions at equal distances."""
    return np.linspace(start, stop, steps)


WHOLE = ScanRange()
