"""Identification: parameters of scenes from measured signals, how well they are known, and what could be known."""

from jaxwhisker.identify.design import design
from jaxwhisker.identify.fit import Fit
from jaxwhisker.identify.information import Information, information
from jaxwhisker.identify.run import identify

__all__ = ["Fit", "Information", "design", "identify", "information"]
