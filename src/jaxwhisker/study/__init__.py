"""Studies: many scans over named parameters, in one labelled Dataset."""

from jaxwhisker.study.run import study
from jaxwhisker.study.summaries import summary

__all__ = ["study", "summary"]
