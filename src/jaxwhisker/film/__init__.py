"""Films of scans."""

from jaxwhisker.film.animate import Film, animate

__all__ = ["Film", "animate"]
