"""Former place of `FitStatus`, kept for modules that still import it from here."""

from jaxwhisker._inverse.statistics import FitStatus

__all__ = ["FitStatus"]
