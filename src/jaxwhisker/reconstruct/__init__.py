"""Reconstruction: the object from support reactions, point by point, as a shape, or as a contour of any kind."""

from jaxwhisker.reconstruct.fit_contour import ContourFit, fit_contour
from jaxwhisker.reconstruct.fit_profile import ProfileFit, fit_profile
from jaxwhisker.reconstruct.points import PointStatus, Reconstruction
from jaxwhisker.reconstruct.run import reconstruct

__all__ = [
    "ContourFit",
    "PointStatus",
    "ProfileFit",
    "Reconstruction",
    "fit_contour",
    "fit_profile",
    "reconstruct",
]
