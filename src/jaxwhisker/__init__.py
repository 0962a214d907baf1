"""jaxwhisker: exact, fast, differentiable scans with artificial tactile whiskers."""

from jaxwhisker.contact import Phase
from jaxwhisker.contour import Contour
from jaxwhisker.deflect import Deflection, PointForce, PointMoment, deflect
from jaxwhisker.elastica import AbstractRod, ClosedForm, Shooting
from jaxwhisker.energy import stored_energy
from jaxwhisker.explore import explore
from jaxwhisker.export import to_csv, to_dataframe
from jaxwhisker.film import animate
from jaxwhisker.fit_status import FitStatus
from jaxwhisker.identify import Fit, Information, design, identify, information
from jaxwhisker.motion import AbstractMotion, Motion, Rotation, Translation
from jaxwhisker.path import EventKind, Status
from jaxwhisker.profile import AbstractProfile, Circle, Ellipse, Graph, Parabola
from jaxwhisker.reconstruct import (
    ContourFit,
    PointStatus,
    ProfileFit,
    Reconstruction,
    fit_contour,
    fit_profile,
    reconstruct,
)
from jaxwhisker.result import Event, Events, Result, State
from jaxwhisker.rod import Splitting
from jaxwhisker.scan import scan
from jaxwhisker.scene import Scene
from jaxwhisker.sensor import Sensor
from jaxwhisker.shape import Shapes, shapes
from jaxwhisker.spring import Spring
from jaxwhisker.study import study, summary
from jaxwhisker.support import Mount, Support
from jaxwhisker.tilted import Tilted
from jaxwhisker.whisker import Whisker

__all__ = [
    "AbstractMotion",
    "AbstractProfile",
    "AbstractRod",
    "Circle",
    "ClosedForm",
    "Contour",
    "ContourFit",
    "Deflection",
    "Ellipse",
    "Event",
    "EventKind",
    "Events",
    "Fit",
    "FitStatus",
    "Graph",
    "Information",
    "Motion",
    "Mount",
    "Parabola",
    "Phase",
    "PointForce",
    "PointMoment",
    "PointStatus",
    "ProfileFit",
    "Reconstruction",
    "Result",
    "Rotation",
    "Scene",
    "Sensor",
    "Shapes",
    "Shooting",
    "Splitting",
    "Spring",
    "State",
    "Status",
    "Support",
    "Tilted",
    "Translation",
    "Whisker",
    "animate",
    "deflect",
    "design",
    "explore",
    "fit_contour",
    "fit_profile",
    "identify",
    "information",
    "reconstruct",
    "scan",
    "shapes",
    "stored_energy",
    "study",
    "summary",
    "to_csv",
    "to_dataframe",
]

__version__ = "0.1.0"


def __getattr__(name: str):
    # matplotlib is loaded when the first figure is asked for.
    if name == "plot":
        import importlib

        return importlib.import_module("jaxwhisker.plot")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
