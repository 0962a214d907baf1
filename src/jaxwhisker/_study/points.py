"""What became of a study's points, in words."""

from collections import Counter
from collections.abc import Callable

import numpy as np

from jaxwhisker._path.path import Status
from jaxwhisker._study.parameters import Parameters

ASKED = 1000  # bad points whose reason is asked for at most


class Points:
    """Counts points as their blocks are computed."""

    def __init__(self, build: Callable, parameters: Parameters):
        self._build, self._parameters = build, parameters
        self._failed: dict[int, int] = {}  # status by number of the point
        self.total, self.seen = int(np.prod(parameters.shape)), 0

    def add(self, numbers: np.ndarray, worst: np.ndarray) -> None:
        """Take note of points and the first status of each that is not ok."""
        self.seen += worst.size
        bad = worst != Status.ok
        self._failed |= dict(zip(numbers[bad].tolist(), worst[bad].tolist(), strict=True))

    @property
    def all_ok(self) -> bool:
        """Whether every step of every point is ok."""
        return not self._failed

    def words(self) -> str:
        """How many points are ok, and what is wrong with how many others."""
        reasons = Counter(
            self._reason(n, status, k < ASKED) for k, (n, status) in enumerate(sorted(self._failed.items()))
        )
        parts = [f"{count:,}: {reason}" for reason, count in sorted(reasons.items(), key=lambda item: (-item[1], item))]
        return "; ".join([f"{self.total - len(self._failed):,} of {self.total:,} ok", *parts])

    def _reason(self, number: int, status: int, ask: bool) -> str:
        if status == Status.invalid and ask:
            try:
                self._build(**self._parameters.one(number))
            except ValueError as error:
                # Without the value, which differs from point to point.
                return str(error).split(", got")[0]
        return Status(status).name
