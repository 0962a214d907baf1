"""The scene in space: whiskers, a surface, springs and a drive.

Frame: x along the scan, y up, z = x cross y; the object is above. A whisker on the default mount stands at the origin
of the drive's frame and points along +y; the axes of its body are d1 = x, d2 = -z and d3 = y, its tangent. Springs act
along the axes of the drive's frame.

Without friction, the contact force is f n, with f >= 0 and the outward normal n of the object. With the friction
coefficient mu, a contact slips with the force f (n - mu v/|v|), v the velocity of the whisker's material point there.
The support exerts the reaction (fx, fy, fz) on the whisker, and the moment (mx, my, mz) about its displaced base; all
in the frame of the scene. With gravity, they balance the weight, too.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._model.assembly import (
    MOST_CONTACTS,
    AbstractScene,
    check_weights,
    check_whiskers,
    gravity_text,
    in_row,
    motion_text,
    support_text,
    whisker_text,
)
from jaxwhisker._model.drives import SpaceMotion
from jaxwhisker._model.motion import AbstractMotion, AbstractTranslation, Translation
from jaxwhisker._model.support import Support
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._model.surfaces import as_one_surface
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod, ClosedForm, Shooting


class SpaceScene(AbstractScene):
    """Whiskers on a support, scanned past a surface in space.

    `jw.Scene` with a surface in place of a profile makes one.

    Args:
        whisker: one Whisker for all bases, or a tuple with one per base.
        surface: the object: a Sphere, Ellipsoid, Cylinder, Capsule, RoundedBox, Torus, Plane, Paraboloid, Extruded,
            Revolved or Surface; or a tuple of objects, which must be apart from each other and are touched one after
            the other.
        support: springs between the drive and the bases. Default: clamped.
        rod: how rods are computed.
        motion: motion of the drive: a LinearDrive, RotaryDrive, WhiskDrive or PoseDrive, or one in the plane.
        friction: Coulomb friction coefficient mu between whiskers and object, not negative. Default: no friction.
        contacts: largest number of contacts of one whisker, at most 8. With more than 1, whiskers may touch several
            objects at once, and one object in several places; contact fields of results then have a last axis of
            contacts, from the tip to the base. Scans then take several times as long. Not available with friction,
            gravity and `ClosedForm()`.
        gravity: acceleration along x, y and z, whose weight of each whisker's `mass_per_length` and `tip_mass` bends it
            everywhere, before any contact and beyond it: (0.0, -9.81, 0.0) for whiskers in SI units that stand upright.
            The reactions then balance the weight, too. The drive moves along a straight line without turning, and
            torsion springs do not connect whiskers. Such scans take ten times as long and more. Default: no weight.

    Raises:
        ValueError: if an argument has the wrong type or value, the numbers of whiskers and bases differ, the support
            has springs that are only available in the plane, or `rod` cannot compute the whiskers.

    Examples:
        >>> jw.Scene(jw.Whisker(), jw.Sphere(radius=1.0, centre=(0.0, 1.3, 0.2)))
        clamped: 1 whisker, sphere r = 1, centre (0, 1.3, 0.2)
    """

    whisker: Whisker | tuple[Whisker, ...]
    surface: AbstractSurface = eqx.field(converter=as_one_surface)
    support: Support = Support()
    rod: AbstractRod = Shooting()
    motion: SpaceMotion | AbstractMotion = Translation()
    friction: Scalar | None = None
    contacts: int = eqx.field(static=True, default=1)
    gravity: Triple | None = eqx.field(default=None, converter=checks.as_tuple)
    in_space = True

    def __post_init__(self):
        self.support = in_row(self.whisker, self.support)

    def __check_init__(self):
        allowed = (
            "a Sphere, Ellipsoid, Cylinder, Capsule, RoundedBox, Torus, Plane, Paraboloid, Extruded, Revolved or "
            "Surface, or a tuple of these"
        )
        checks.instance("surface", self.surface, AbstractSurface, allowed)
        kinds = "a LinearDrive, RotaryDrive, WhiskDrive or PoseDrive, or a motion in the plane"
        checks.instance("motion", self.motion, (SpaceMotion, AbstractMotion), kinds)
        check_whiskers(self.whisker, self.support)
        self.support.check_in_space()
        if self.friction is not None:
            checks.number("friction", self.friction, non_negative=True)
        checks.instance("rod", self.rod, AbstractRod, "Shooting() or ClosedForm()")
        checks.count("contacts", self.contacts)
        self._check_gravity()
        if self.contacts > 1:
            self._check_several()
        elif isinstance(self.rod, ClosedForm) and (self.rolls or not all(w.uniform for w in self.whiskers)):
            checks.fail(
                "rod", "Shooting() for whiskers that are curved, not uniform or on torsion springs", "ClosedForm()"
            )

    def _check_gravity(self):
        """Check that whiskers have weights if there is gravity, and that all other parts of the scene take them."""
        if self.gravity is None:
            return
        checks.triple("gravity", self.gravity)
        if self.contacts > 1:
            checks.fail("gravity", "None for several contacts", repr(self.gravity))
        check_weights(self.whiskers, self.rod)
        if not isinstance(self.motion, AbstractTranslation):
            checks.fail("motion", "a LinearDrive or a Translation for whiskers with a weight", str(self.motion))
        for spring in self.support.springs:
            if 0 not in spring.between and spring.axis.startswith("phi"):
                allowed = "without torsion springs that connect whiskers with a weight"
                checks.fail("support", allowed, f"one between {spring.between}")

    def _check_several(self):
        """Check that all parts of a scene with several contacts of one whisker are modelled."""
        if self.contacts > MOST_CONTACTS:
            checks.fail("contacts", f"at most {MOST_CONTACTS}", repr(self.contacts))
        if self.friction is not None:
            checks.fail("friction", "None for several contacts in space", as_text(self.friction))
        if not isinstance(self.rod, Shooting):
            checks.fail("rod", "Shooting() for several contacts", str(self.rod))

    @property
    def objects(self) -> tuple[AbstractSurface, ...]:
        """The objects, in the order in which results number them."""
        return self.surface.objects

    @property
    def rolls(self) -> bool:
        """Whether rods have a roll: whiskers are curved or heavy, their bases may turn, or have several contacts."""
        curved = any(w.needs_space or w.intrinsic_curvature is not None for w in self.whiskers)
        curved |= self.contacts > 1 or self.gravity is not None
        return curved or any(axis.startswith("phi") for axis in self.support.axes)

    def valid(self) -> Bool[Array, ""]:
        """Whether traced parameters are in the domains that the constructors check."""
        valid = self.surface.valid() & self.support.valid() & self.motion.valid()
        if self.friction is not None:
            valid &= (self.friction >= 0) & jnp.isfinite(self.friction)
        if self.gravity is not None:
            heavy = [whisker.valid_masses() for whisker in self.whiskers]
            valid &= checks.all_finite(self.gravity) & jnp.all(jnp.stack(heavy))
        return valid & jnp.all(jnp.stack([whisker.valid() for whisker in self.whiskers]))

    def __str__(self) -> str:
        rods = "" if self.rod == Shooting() else f", {self.rod}"
        whisker, motion = whisker_text(self.whiskers[0]), motion_text(self.motion)
        friction = "" if self.friction is None else f", friction {as_text(self.friction)}"
        contacts = f", up to {self.contacts} contacts" if self.contacts > 1 else ""
        gravity = gravity_text(self.gravity)
        return f"{support_text(self.support)}, {self.surface}{whisker}{friction}{gravity}{rods}{motion}{contacts}"

    __repr__ = __str__
