"""Former place of the observations, kept for modules that still import them from here."""

from jaxwhisker._inverse.observations import Observations as Measured
from jaxwhisker._inverse.observations import read_observations as measured_of
from jaxwhisker._scan.quantities import REACTIONS as CHANNELS

__all__ = ["CHANNELS", "Measured", "measured_of"]
