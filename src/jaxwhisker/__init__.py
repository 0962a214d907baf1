"""jaxwhisker: exact, fast, differentiable scans with artificial tactile whiskers."""

from typing import TYPE_CHECKING

from jaxwhisker._base.suggest import no_attribute
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.along import ParabolicShape, Polynomial, Table
from jaxwhisker._model.conic import Circle, Ellipse, Parabola
from jaxwhisker._model.contour import Contour
from jaxwhisker._model.cut import Cut
from jaxwhisker._model.foundation import Foundation
from jaxwhisker._model.motion import AbstractMotion, Motion, Mount, Rotation, Translation
from jaxwhisker._model.pipe import Pipe
from jaxwhisker._model.polygon import Box, Polygon
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.profiles import Graph, Tilted
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._model.spring import Spring
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting
from jaxwhisker._rod.rod import Splitting
from jaxwhisker._scan.energy import stored_energy
from jaxwhisker._scan.result import Event, Events, Result, SpaceResult
from jaxwhisker._scan.scan import scan
from jaxwhisker._scan.state import SpaceState, State

if TYPE_CHECKING:
    from jaxwhisker._base.columns import read_columns
    from jaxwhisker._dynamics.drive import Sweep, Whisking
    from jaxwhisker._dynamics.modes import Modes, modes
    from jaxwhisker._dynamics.simulate import simulate
    from jaxwhisker._dynamics.simulation import Simulation
    from jaxwhisker._explore import explore
    from jaxwhisker._file.scene_file import load_control, load_scene, save_scene
    from jaxwhisker._inverse.bending import BendingFit
    from jaxwhisker._inverse.design import design
    from jaxwhisker._inverse.fit import Fit
    from jaxwhisker._inverse.fit_contour import ContourFit, fit_contour
    from jaxwhisker._inverse.fit_profile import ProfileFit, fit_profile
    from jaxwhisker._inverse.fit_surface import SurfaceFit
    from jaxwhisker._inverse.identify import identify
    from jaxwhisker._inverse.information import Information, information
    from jaxwhisker._inverse.measurement import Measurement, MeasurementModel
    from jaxwhisker._inverse.points import ContactsReconstruction, PointStatus, Reconstruction, SpaceReconstruction
    from jaxwhisker._inverse.reconstruct import reconstruct
    from jaxwhisker._inverse.statistics import FitStatus
    from jaxwhisker._model.drives import LinearDrive, PoseDrive, RotaryDrive, WhiskDrive
    from jaxwhisker._model.harmonics import SphericalHarmonics
    from jaxwhisker._model.loads import LineLoad, PointForce, PointMoment, SpaceForce, SpaceMoment
    from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Paraboloid, Plane, Sphere
    from jaxwhisker._model.rounded import Capsule, RoundedBox
    from jaxwhisker._model.solids import Extruded, Revolved
    from jaxwhisker._model.space_scene import SpaceScene
    from jaxwhisker._model.torus import Torus
    from jaxwhisker._model.user_surface import Surface
    from jaxwhisker._scan.array import Array
    from jaxwhisker._scan.balance import EnergyBalance, energy_balance
    from jaxwhisker._scan.deflect import Deflection, deflect
    from jaxwhisker._scan.export import to_csv, to_dataframe
    from jaxwhisker._scan.lateral import LateralStability, lateral_loss, lateral_stability
    from jaxwhisker._scan.shapes import Shapes, SpaceShapes, shapes
    from jaxwhisker._scan.strain import Bending, bending, strain
    from jaxwhisker._space.deflect import SpaceDeflection
    from jaxwhisker._study.critical import critical_stiffness
    from jaxwhisker._study.study import study
    from jaxwhisker._study.summary import summary
    from jaxwhisker._study.tactile_image import tactile_image
    from jaxwhisker.film.animate import animate

__all__ = [
    "AbstractMotion",
    "AbstractProfile",
    "AbstractRod",
    "Array",
    "Bending",
    "BendingFit",
    "Box",
    "Capsule",
    "Circle",
    "ClosedForm",
    "ContactsReconstruction",
    "Contour",
    "ContourFit",
    "Cut",
    "Cylinder",
    "Deflection",
    "Ellipse",
    "Ellipsoid",
    "EnergyBalance",
    "Event",
    "EventKind",
    "Events",
    "Extruded",
    "Fit",
    "FitStatus",
    "Foundation",
    "Graph",
    "Information",
    "LateralStability",
    "LineLoad",
    "LinearDrive",
    "Measurement",
    "MeasurementModel",
    "Modes",
    "Motion",
    "Mount",
    "Parabola",
    "ParabolicShape",
    "Paraboloid",
    "Phase",
    "Pipe",
    "Plane",
    "PointForce",
    "PointMoment",
    "PointStatus",
    "Polygon",
    "Polynomial",
    "PoseDrive",
    "ProfileFit",
    "Reconstruction",
    "Result",
    "Revolved",
    "RotaryDrive",
    "Rotation",
    "RoundedBox",
    "Scene",
    "Sensor",
    "Shapes",
    "Shooting",
    "Simulation",
    "SpaceDeflection",
    "SpaceForce",
    "SpaceMoment",
    "SpaceReconstruction",
    "SpaceResult",
    "SpaceScene",
    "SpaceShapes",
    "SpaceState",
    "Sphere",
    "SphericalHarmonics",
    "Splitting",
    "Spring",
    "State",
    "Status",
    "Support",
    "Surface",
    "SurfaceFit",
    "Sweep",
    "Table",
    "Tilted",
    "Torus",
    "Translation",
    "WhiskDrive",
    "Whisker",
    "Whisking",
    "animate",
    "bending",
    "critical_stiffness",
    "deflect",
    "design",
    "energy_balance",
    "explore",
    "fit_contour",
    "fit_profile",
    "identify",
    "information",
    "lateral_loss",
    "lateral_stability",
    "load_control",
    "load_scene",
    "modes",
    "read_columns",
    "reconstruct",
    "save_scene",
    "scan",
    "shapes",
    "simulate",
    "stored_energy",
    "strain",
    "study",
    "summary",
    "tactile_image",
    "to_csv",
    "to_dataframe",
]

__version__ = "0.2.0.dev0"

# Names that are loaded on first use, and their modules.
_LATER = {
    "_base.columns": ("read_columns",),
    "_dynamics.drive": ("Sweep", "Whisking"),
    "_dynamics.modes": ("Modes", "modes"),
    "_dynamics.simulate": ("simulate",),
    "_dynamics.simulation": ("Simulation",),
    "_explore": ("explore",),
    "_file.scene_file": ("load_control", "load_scene", "save_scene"),
    "_inverse.bending": ("BendingFit",),
    "_inverse.design": ("design",),
    "_inverse.fit": ("Fit",),
    "_inverse.fit_contour": ("ContourFit", "fit_contour"),
    "_inverse.fit_profile": ("ProfileFit", "fit_profile"),
    "_inverse.fit_surface": ("SurfaceFit",),
    "_inverse.identify": ("identify",),
    "_inverse.information": ("Information", "information"),
    "_inverse.measurement": ("Measurement", "MeasurementModel"),
    "_inverse.points": ("ContactsReconstruction", "PointStatus", "Reconstruction", "SpaceReconstruction"),
    "_inverse.reconstruct": ("reconstruct",),
    "_inverse.statistics": ("FitStatus",),
    "_model.drives": ("LinearDrive", "PoseDrive", "RotaryDrive", "WhiskDrive"),
    "_model.loads": ("LineLoad", "PointForce", "PointMoment", "SpaceForce", "SpaceMoment"),
    "_model.quadrics": ("Cylinder", "Ellipsoid", "Paraboloid", "Plane", "Sphere"),
    "_model.harmonics": ("SphericalHarmonics",),
    "_model.rounded": ("Capsule", "RoundedBox"),
    "_model.solids": ("Extruded", "Revolved"),
    "_model.space_scene": ("SpaceScene",),
    "_model.torus": ("Torus",),
    "_model.user_surface": ("Surface",),
    "_scan.array": ("Array",),
    "_scan.balance": ("EnergyBalance", "energy_balance"),
    "_scan.deflect": ("Deflection", "deflect"),
    "_scan.export": ("to_csv", "to_dataframe"),
    "_scan.lateral": ("LateralStability", "lateral_loss", "lateral_stability"),
    "_scan.shapes": ("Shapes", "SpaceShapes", "shapes"),
    "_scan.strain": ("Bending", "bending", "strain"),
    "_space.deflect": ("SpaceDeflection",),
    "_study.critical": ("critical_stiffness",),
    "_study.study": ("study",),
    "_study.summary": ("summary",),
    "_study.tactile_image": ("tactile_image",),
    "film.animate": ("animate",),
}
_MODULE_OF = {name: module for module, names in _LATER.items() for name in names}


def __getattr__(name: str):
    import importlib

    # matplotlib is loaded when the first figure is asked for, and what scans do not need on first use.
    if name in ("film", "plot"):
        return importlib.import_module(f"jaxwhisker.{name}")
    if name in _MODULE_OF:
        return getattr(importlib.import_module(f"jaxwhisker.{_MODULE_OF[name]}"), name)
    raise no_attribute(f"module {__name__!r}", name, __dir__())


def __dir__():
    return [*__all__, "plot", *(name for name in globals() if name.startswith("__"))]
