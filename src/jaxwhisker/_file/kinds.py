"""The kinds of tables in a file: the classes of the parts of scenes, and their constructors that have names.

What a table may hold follows from the signatures of these functions and from the types of their arguments.
"""

import inspect
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias, get_args, get_origin

import diffrax
import equinox as eqx
from typing_extensions import TypeAliasType

from jaxwhisker._base.suggest import Suggesting
from jaxwhisker._file.scan_range import WHOLE, ScanRange
from jaxwhisker._model.along import (
    LinearTaper,
    ParabolicShape,
    Polynomial,
    PowerTaper,
    RoundMass,
    RoundSection,
    Table,
)
from jaxwhisker._model.conic import Circle, Ellipse, Parabola
from jaxwhisker._model.contour import Contour
from jaxwhisker._model.cut import Cut
from jaxwhisker._model.drives import LinearDrive, PoseDrive, RotaryDrive, SpaceMotion, WhiskDrive
from jaxwhisker._model.foundation import Foundation
from jaxwhisker._model.harmonics import SphericalHarmonics
from jaxwhisker._model.motion import AbstractMotion, Motion, Mount, Rotation, Translation
from jaxwhisker._model.pipe import Pipe
from jaxwhisker._model.polygon import Box, Polygon
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.profiles import Graph, Tilted
from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Paraboloid, Plane, Sphere
from jaxwhisker._model.rounded import Capsule, RoundedBox
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.solids import Extruded, Revolved
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.spring import Spring
from jaxwhisker._model.support import Support
from jaxwhisker._model.surface import AbstractSurface, Placed
from jaxwhisker._model.torus import Torus
from jaxwhisker._model.user_surface import Surface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting
from jaxwhisker._rod.rod import Splitting

# By the class that an argument asks for: a function of one number, or one of the parts of a scene.
FAMILIES: dict[Any, tuple[type, ...]] = {
    Callable: (Table, Polynomial, ParabolicShape, LinearTaper, RoundSection, RoundMass, PowerTaper),
    Whisker: (Whisker,),
    AbstractProfile: (Parabola, Circle, Ellipse, Graph, Contour, Polygon, Box, Cut, Tilted, Pipe),
    AbstractSurface: (
        Sphere,
        Ellipsoid,
        Cylinder,
        Capsule,
        RoundedBox,
        Torus,
        SphericalHarmonics,
        Plane,
        Paraboloid,
        Extruded,
        Revolved,
        Surface,
        Placed,
    ),
    Support: (Support,),
    Spring: (Spring,),
    Mount: (Mount,),
    Foundation: (Foundation,),
    AbstractMotion: (Translation, Rotation, Motion),
    SpaceMotion: (LinearDrive, RotaryDrive, WhiskDrive, PoseDrive),
    AbstractRod: (Shooting, ClosedForm),
    diffrax.AbstractSolver: (Splitting,),
    ScanRange: (ScanRange,),
}
# Names in files of arguments of scenes, which have one name in the plane and in space.
RENAMED = {"profile": "objects", "surface": "objects", "motion": "drive"}
SCAN = "scan"  # the table that does not belong to the scene
UNKNOWN = Any, inspect.Parameter.empty  # types that say nothing
NONE = "none"  # the text that stands for None


class Argument(NamedTuple):
    """What a key of a table may hold."""

    types: tuple[Any, ...]  # classes, and the origins of generic types, that its annotation names
    default: Any  # `Parameter.empty` if the key is required
    families: tuple[Any, ...]  # of the tables that it may hold

    @property
    def required(self) -> bool:
        """Whether the key must be there."""
        return self.default is inspect.Parameter.empty

    @property
    def is_number(self) -> bool:
        """Whether it holds numbers of any size, not only counts, names or truth values; or their type is unknown."""
        return any(one in (float, *UNKNOWN) or hasattr(one, "dim_str") for one in self.types)

    @property
    def dimensions(self) -> int:
        """The largest depth of the arrays that it may hold."""
        arrays = tuple, list, Sequence, *UNKNOWN
        depths = [len(getattr(one, "dim_str", "").split()) for one in self.types]
        return max(int(any(one in arrays for one in self.types)), *depths)

    @property
    def usual(self) -> "Kind | None":
        """The kind of a table without a `kind`: the only one, or that of the default; None if there is none."""
        made = [kind for kind in self.kinds.values() if kind.is_class]
        return next((kind for kind in made if len(made) == 1 or type(self.default) is kind.makes), None)

    @property
    def kinds(self) -> "dict[str, Kind]":
        """The kinds of tables that it may hold, by name."""
        return {name: kind for family in self.families for name, kind in kinds_of(family).items()}


Arguments: TypeAlias = dict[str, Argument]


class Kind(NamedTuple):
    """A class, or one of its constructors."""

    name: str
    make: Callable[..., Any]
    makes: type

    @property
    def is_class(self) -> bool:
        """Whether it is a class itself."""
        return self.make is self.makes

    @property
    def arguments(self) -> Arguments:
        """Its arguments by name."""
        return arguments_of(self.make)


def kind_name(made: type) -> str:
    """The name of a class in files: that of LinearDrive is linear_drive."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", made.__name__).lower()


@cache
def kinds_of(family: Any) -> dict[str, Kind]:
    """The kinds of a family by name: its classes, and constructors such as `Support.fb`."""
    found = {}
    for made in FAMILIES[family]:
        found[kind_name(made)] = Kind(kind_name(made), made, made)
        if isinstance(made, Suggesting):
            names = [name for name in dir(made) if not name.startswith("_")]
            own = [name for name in names if isinstance(inspect.getattr_static(made, name), classmethod)]
            found |= {name: Kind(name, getattr(made, name), made) for name in own}
    return found


@cache
def arguments_of(make: Any) -> Arguments:
    """The arguments of a class or function by name."""
    fields, found = getattr(make, "__dataclass_fields__", {}), {}
    for name, parameter in inspect.signature(make).parameters.items():
        # A converter hides the type of its field from the signature.
        annotation = fields[name].type if name in fields else parameter.annotation
        types = tuple(_types(annotation))
        families = tuple(family for family in FAMILIES if any(_asks_for(one, family) for one in types))
        found[name] = Argument(types, parameter.default, families)
    return found


@cache
def scene_arguments() -> Arguments:
    """The keys of a scene: the arguments of scenes in the plane and in space."""
    found: Arguments = {}
    makes: tuple[Any, ...] = Scene, SpaceScene
    for make in makes:
        for name, argument in arguments_of(make).items():
            name = RENAMED.get(name, name)
            known = found.get(name, argument)
            families = tuple(dict.fromkeys((*known.families, *argument.families)))
            types = (*known.types, *argument.types, *[tuple] * (name == "objects"))  # a scene makes one of several
            found[name] = known._replace(types=types, families=families)
    return found


def file_arguments() -> Arguments:
    """The keys of a file."""
    return scene_arguments() | {SCAN: Argument((ScanRange,), WHOLE, (ScanRange,))}


def _asks_for(asked: Any, family: Any) -> bool:
    if family is Callable or asked is Callable:
        return asked is family
    return isinstance(asked, type) and issubclass(asked, eqx.Module) and issubclass(family, asked)


def _types(annotation: Any) -> list[Any]:
    """All classes in a type, those of containers included; of a function, `Callable`."""
    if isinstance(annotation, TypeAliasType):
        return _types(annotation.__value__)
    if get_origin(annotation) is Callable:
        return [Callable]
    inner = [one for part in get_args(annotation) for one in _types(part)]
    return [*inner, get_origin(annotation)] if inner else [annotation]
