"""Former place of `design`, kept for modules that still import it from here."""

from jaxwhisker._inverse.information import design

__all__ = ["design"]
