"""The scene: whiskers, object, support and motion. All conventions (frame, signs, units) are defined here.

Frame: x along the scan, y up. The base of whisker i is at (x_i, 0), clamped along +y. The object lies above its
profile, whose vertex is at height q (the object distance). The drive position u decreases during a scan. Without load,
base i rests at u plus the rest lengths of the springs between the drive and the base: the drive leads, and the whiskers
trail.

Contact force: f >= 0, on the whisker: f (sin psi, -cos psi). Without friction it acts along the object's outward
normal, psi = alpha. With the friction coefficient mu it leans against the slip: psi = alpha - slip * arctan(mu), with
slip = +1 if the whisker slips along the object towards +x, and -1 if towards -x.
Support reaction: force and moment of the support on the whisker at its base:

    fx = -f sin(psi),   fy = +f cos(psi),   mz = -EI kappa(0)   (counter-clockwise positive).

Internally everything is dimensionless in the length L and the bending stiffness EI of the first whisker: forces in
EI/L^2, moments in EI/L, spring stiffnesses in EI/L^3.

Where the drive turns (motion.py), springs act along the axes of its frame; all results refer to the scene's frame.
"""

import dataclasses
from typing import Any, NamedTuple, dataclass_transform

import equinox as eqx
import jax.numpy as jnp

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, name_of
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.assembly import (
    MOST_CONTACTS,
    AbstractScene,
    check_weights,
    check_whiskers,
    each_whisker,
    gravity_text,
    in_row,
    motion_text,
    support_text,
    whisker_text,
)
from jaxwhisker._model.motion import AbstractMotion, Translation
from jaxwhisker._model.objects import as_one
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting

DETECTABLE = ("second_contact", "crossing")


def _as_names(value: Any) -> Any:
    """A tuple of names, in one order, so that equal sets share programs; other values stay as they are."""
    names = (value,) if isinstance(value, str) else value
    try:
        known = set(names) <= set(DETECTABLE)
    except TypeError:
        return value
    return tuple(name for name in DETECTABLE if name in names) if known else value


@dataclass_transform(field_specifiers=(dataclasses.field, eqx.field))  # as that of equinox, for type checkers
class _OfObject(type(eqx.Module)):
    """The type of scenes, whose kind depends on the object."""

    def __call__(cls, *args: Any, **kwargs: Any):
        kwargs |= {"surface": kwargs.pop("profile")} if _in_space(kwargs.get("profile")) else {}
        if _in_space(kwargs.get("surface")) or any(map(_in_space, args)):
            from jaxwhisker._model.space_scene import SpaceScene

            if (detect := kwargs.pop("detect", None)) is not None:
                checks.fail("detect", "None in space", repr(detect))
            return SpaceScene(*args, **kwargs)
        return super().__call__(*args, **kwargs)


def _in_space(value: Any) -> bool:
    some = value if isinstance(value, list | tuple) else (value,)
    return any(getattr(one, "is_surface", False) for one in some)


class Scene(AbstractScene, metaclass=_OfObject):
    """Whiskers on a support, scanned past an object.

    With a surface (`Sphere`, ...) in place of the profile, it is a scene in space: a `SpaceScene`.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        profile: the object, or a tuple of objects, which may be of different kinds.
        support: springs between the drive and the bases. Default: clamped.
        rod: how rods are computed: `Shooting()`, or `ClosedForm()`, which is faster and exact to rounding but limited
            to uniform straight whiskers.
        motion: motion of the drive: Translation(), Rotation(), or a user-defined Motion.
        friction: Coulomb friction coefficient mu between whiskers and object, not negative. Default: no friction.
        detect: contacts that are not modelled, at which a scan ends with the status of this name: "second_contact" (a
            whisker meets an object in a second place), "crossing" (two whiskers cross, if they lie in one plane), or a
            tuple of these; () detects nothing. Default: "second_contact". A scene in which no contact of this kind
            can occur, such as that of a straight whisker before one object, needs no search.
        contacts: largest number of contacts of one whisker, at most 8. With more than 1, whiskers may touch several
            objects at once, and concave ones, and one object in several places; contact fields of results then have a
            last axis of contacts, from the tip to the base. Scans then take several times as long. Not available
            with springs on shafts, gravity, crossings and `ClosedForm()`, and for `Cut` and tilted polygons.
        gravity: acceleration along x and y, whose weight of each whisker's `mass_per_length` and `tip_mass` bends it
            everywhere, before any contact and beyond it: (0.0, -9.81) for whiskers in SI units that stand upright. fx,
            fy and mz then balance the weight, too. The drive moves along a straight line without turning. Such scans
            take ten times as long and more. Default: no weight.

    Raises:
        ValueError: if an argument has the wrong type or value, the numbers of whiskers and bases differ, or `rod`
            cannot compute the whiskers.

    Examples:
        >>> jw.Scene(jw.Whisker(), jw.Parabola(distance=0.2), jw.Support.fbfbr(stiffness=70.0))
        FBFBR: 2 whiskers, 3 springs, parabola q = 0.2
    """

    whisker: Whisker | tuple[Whisker, ...]
    profile: AbstractProfile = eqx.field(converter=as_one)
    support: Support = Support()
    rod: AbstractRod = Shooting()
    motion: AbstractMotion = Translation()
    friction: Scalar | None = None
    detect: str | tuple[str, ...] | None = eqx.field(static=True, default=None, converter=_as_names)
    contacts: int = eqx.field(static=True, default=1)
    gravity: tuple[Scalar, Scalar] | None = None

    def __post_init__(self):
        self.support = in_row(self.whisker, self.support)

    def __check_init__(self):
        allowed = "a Parabola, Circle, Ellipse, Graph, Contour, Polygon, Box, Cut or Tilted, or a tuple of these"
        checks.instance("profile", self.profile, AbstractProfile, allowed)
        _check_sensor(self.whisker, self.support, self.motion, self.friction)
        if self.friction is not None and self.profile.has_edges and self.contacts == 1:
            raise ValueError(
                "`friction` must be None for an object with edges, or `contacts` at least 2, which models how contacts "
                f"slip over edges, got friction {as_text(self.friction)} and {self.profile}."
            )
        checks.instance("rod", self.rod, AbstractRod, "Shooting() or ClosedForm()")
        if isinstance(self.rod, ClosedForm) and not all(w.uniform for w in self.whiskers):
            checks.fail("rod", "Shooting() for whiskers that are curved or not uniform", "ClosedForm()")
        if self.support.on_shafts and not isinstance(self.rod, Shooting):
            allowed = "Shooting() for springs on shafts, which change the load along the whisker"
            checks.fail("rod", allowed, f"{type(self.rod).__name__}()")
        self._check_gravity()
        known = isinstance(self.detect, tuple) and all(name in DETECTABLE for name in self.detect)
        if self.detect is not None and not known:
            allowed = f"{' or '.join(map(repr, DETECTABLE))}, or a tuple of these"
            checks.fail("detect", allowed, repr(self.detect))
        checks.count("contacts", self.contacts)
        if self.contacts > 1:
            self._check_several()
        elif self.profile.is_concave:
            checks.fail("contacts", "at least 2 for a hollow object, or one with inner corners", "1")

    def _check_gravity(self):
        """Check that whiskers have weights if there is gravity, and that all other parts of the scene take them."""
        if self.gravity is None:
            return
        checks.pair("gravity", self.gravity)
        check_weights(self.whiskers, self.rod)
        if not isinstance(self.motion, Translation):
            checks.fail("motion", "a Translation for whiskers with a weight", str(self.motion))

    def _check_several(self):
        """Check that all parts of a scene with several contacts of one whisker are modelled."""
        if self.contacts > MOST_CONTACTS:
            checks.fail("contacts", f"at most {MOST_CONTACTS}", repr(self.contacts))
        unknown = (
            (self.support.on_shafts, "support", "without springs or foundations on shafts for several contacts"),
            (not isinstance(self.rod, Shooting), "rod", "Shooting() for several contacts"),
            (self.gravity is not None, "gravity", "None for several contacts"),
            (
                not all(one.has_corners or not one.has_edges for one in self.profile.objects),
                "profile",
                "of smooth objects, polygons and boxes",
            ),
            ("crossing" in (self.detect or ()), "detect", 'without "crossing" for several contacts'),
        )
        for is_there, name, allowed in unknown:
            if is_there:
                value = getattr(self, name)
                checks.fail(name, allowed, repr(value) if name in ("detect", "gravity") else str(value))

    @property
    def objects(self) -> tuple[AbstractProfile, ...]:
        """The objects, in the order in which results number them."""
        return self.profile.objects

    @property
    def detects(self) -> tuple[str, ...]:
        """The contacts that are not modelled, at which a scan ends."""
        return ("second_contact",) if self.detect is None else tuple(self.detect)

    def __str__(self) -> str:
        rods = "" if self.rod == Shooting() else f", {self.rod}"
        detect = ", detects " * bool(self.detect) + " and ".join(self.detect or ()).replace("_", " ")
        friction = "" if self.friction is None else f", friction {as_text(self.friction)}"
        whisker, motion = whisker_text(self.whiskers[0]), motion_text(self.motion)
        contacts = f", up to {self.contacts} contacts" if self.contacts > 1 else ""
        gravity = gravity_text(self.gravity)
        parts = f"{self.profile}{whisker}{friction}{gravity}{rods}{motion}{detect}{contacts}"
        return f"{support_text(self.support)}, {parts}"

    __repr__ = __str__


class Sensor(eqx.Module):
    """Whiskers on a support: a Scene without its object.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        support: springs between the drive and the bases. Default: clamped.
        motion: motion of the drive: Translation(), Rotation(), or a user-defined Motion.
        friction: Coulomb friction coefficient mu between whiskers and objects, not negative. Default: no friction.

    Raises:
        ValueError: if an argument has the wrong type or value, or the numbers of whiskers and bases differ.

    Examples:
        >>> sensor = jw.Sensor(jw.Whisker(), jw.Support.fb(stiffness=70.0))
        >>> sensor.before(jw.Circle(distance=0.3, radius=0.5))
        FB: 1 whisker, 1 spring, circle q = 0.3, r = 0.5
    """

    whisker: Whisker | tuple[Whisker, ...]
    support: Support = Support()
    motion: AbstractMotion = Translation()
    friction: Scalar | None = None
    gravity = None  # sensors do not know the weight of their whiskers

    def __post_init__(self):
        self.support = in_row(self.whisker, self.support)

    def __check_init__(self):
        _check_sensor(self.whisker, self.support, self.motion, self.friction)

    @classmethod
    def of(cls, scene: Scene) -> "Sensor":
        """The sensor of a scene."""
        checks.instance("scene", scene, Scene, "a Scene")
        if scene.gravity is not None:
            checks.fail("scene", "without gravity", str(scene))
        return cls(scene.whisker, scene.support, scene.motion, scene.friction)

    def before(self, profile: AbstractProfile, contacts: int = 1) -> Scene:
        """The scene in which this sensor scans an object, with rods computed by `Shooting()`.

        Args:
            profile: the object, or a tuple of objects.
            contacts: largest number of contacts of one whisker, as in `Scene`.
        """
        known = {"motion": self.motion, "friction": self.friction, "contacts": contacts}
        return Scene(self.whisker, profile, self.support, **known)

    @property
    def whiskers(self) -> tuple[Whisker, ...]:
        """One Whisker per base."""
        return each_whisker(self.whisker, self.support)

    def __str__(self) -> str:
        return f"{support_text(self.support)}, no object{whisker_text(self.whiskers[0])}{motion_text(self.motion)}"

    __repr__ = __str__


def _check_sensor(whisker: Any, support: Any, motion: Any, friction: Any) -> None:
    whiskers = check_whiskers(whisker, support)
    checks.instance("motion", motion, AbstractMotion, "a Translation, Rotation or Motion")
    if friction is not None:
        checks.number("friction", friction, non_negative=True)
    check_in_plane(whiskers, support)
    for name, number, place in support.attachments():
        length = whiskers[number - 1].length
        if not checks.is_traced((place, length)) and not float(place) < float(length):
            checks.fail(name, f"less than the whisker's length {length}", place)
    tissue = any(one is not None for one in support.foundations)
    if tissue and any(w.intrinsic_curvature is not None for w in whiskers):
        checks.fail("whisker", "straight on a Foundation", "one with an intrinsic curvature")


def check_in_plane(whiskers: tuple[Whisker, ...], support: Support) -> None:
    """Check that whiskers and their support do not leave the plane.

    Raises:
        ValueError: if they need an object in space; it names the argument.
    """
    for name in ("lateral_ratio", "lateral_curvature", "twist"):
        value = next((own for whisker in whiskers if (own := getattr(whisker, name)) is not None), None)
        if value is not None:
            text = f"{name_of(value)}(s)" if callable(value) else as_text(value)
            checks.fail(name, "None in the plane: others need an object in space", text)
    support.check_in_plane()


class Units(NamedTuple):
    """Units of the dimensionless problem, expressed in the scene's own units."""

    length: Scalar
    force: Scalar
    moment: Scalar
    control: Scalar


def units(scene: AbstractScene | Sensor) -> Units:
    """Units in which the scene's problem is dimensionless."""
    return units_of(scene.whiskers[0], scene.motion)


def units_of(first: Whisker, motion: Any) -> Units:
    """L, EI/L^2, EI/L and the unit of control, with EI at the base of the first whisker."""
    length, stiffness = first.length, first.base_stiffness
    return Units(length, stiffness / length**2, stiffness / length, motion.unit(length))


def time_unit(first: Whisker) -> Scalar:
    """T = L^2 sqrt(rho A / EI) of the first whisker, which has a mass, with EI and rho A at its base."""
    return first.length**2 * jnp.sqrt(first.mass_at(jnp.zeros(())) / first.base_stiffness)


def objects_of(scene: Scene | Sensor) -> tuple[AbstractProfile, ...]:
    """The objects of a scene; none of a sensor."""
    return scene.objects if isinstance(scene, Scene) else ()


def moves_along_x(scene: Any) -> bool:
    """Whether a single axis suffices: bases stay upright at height 0, move along x only, and hold all springs."""
    along_x = isinstance(scene.motion, Translation) and scene.support.axes in ((), ("x",))
    bent = scene.support.on_shafts or scene.gravity is not None
    return along_x and scene.support.mount is None and not bent
