"""The whisker: a slender, inextensible, shearless elastic rod, straight or curved when unloaded."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import as_text, number_or_function
from jaxwhisker._base.suggest import Suggesting
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.along import AlongWhisker, Breaks, LinearTaper, RoundMass, RoundSection, as_breaks
from jaxwhisker._model.measured import Measured
from jaxwhisker._rod.rod import Section, at_arc

CHECKED_POINTS = 65  # points at which a function of arc length is checked
SLENDER = 5  # least ratio of length and diameter; real whiskers and wires have 50 and more


class Whisker(Measured, metaclass=Suggesting):
    """A whisker, clamped upright at its base.

    With the default values everything is dimensionless: lengths in L, forces in EI/L^2, moments in EI/L.

    Args:
        length: L, the arc length from base to tip, in any unit of length; positive.
        bending_stiffness: EI, force times length squared: a positive number, or a function of the arc length s in
            [0, L] from the base that is positive and may vanish only at the tip. The function is called with one traced
            number. The parameters of an `equinox.Module` are differentiable; a plain function is constant.
        intrinsic_curvature: kappa0 = d phi / ds of the unloaded whisker, 1/length, positive counter-clockwise (towards
            -x, the default direction of a scan): a number, or a function like that of the bending stiffness. Default: a
            straight whisker, which is faster to compute than one with a curvature of 0.
        mass_per_length: rho A, mass per length: a positive number, which is the same everywhere along the whisker, or a
            function like that of the bending stiffness, which also may vanish only at the tip. For a cone it decreases
            like the square of the diameter; the constructors with a `density` compute it. Masses are needed for
            vibrations and motion; equilibria do not depend on them. Default: unknown.
        tip_mass: mass of a point attached to the tip, not negative. Default: none.
        base_mass: mass of a point that moves with the base, such as a follicle, not negative. It has an effect only
            where springs let the base move along x or y. Default: none.
        base_inertia: rotary inertia of what is attached to the base, about the base, mass times length squared, not
            negative. Default: none.
        breaks: arc lengths from the base at which one of these functions jumps or has a kink: numbers inside (0, L), in
            ascending order. Integration steps and finite elements end there. The functions may have the value of either
            side at a break. Derivatives with respect to a break need the same number in the function. Default: none;
            then a warning says where functions are not resolved.

    Raises:
        ValueError: if the length is not a positive finite number, the bending stiffness or the mass per length is not
            positive and finite, another mass is negative, JAX cannot trace a function with one number as its argument,
            the unloaded whisker turns by a right angle or more, or breaks are not inside the whisker, not in ascending
            order, or given without a function.

    Examples:
        >>> jw.Whisker().uniform
        True
        >>> cone = jw.Whisker(length=0.05, bending_stiffness=lambda s: 2e-6 * (1 - 15.0 * s) ** 4)
        >>> print(f"{cone.stiffness_at(0.04):.2e}")  # N m^2, at 40 mm from the base
        5.12e-08
    """

    length: Scalar = 1.0
    bending_stiffness: AlongWhisker = eqx.field(default=1.0, converter=number_or_function("bending_stiffness"))
    intrinsic_curvature: AlongWhisker | None = eqx.field(
        default=None, converter=number_or_function("intrinsic_curvature")
    )
    mass_per_length: AlongWhisker | None = eqx.field(
        default=None, kw_only=True, converter=number_or_function("mass_per_length")
    )
    tip_mass: Scalar | None = eqx.field(default=None, kw_only=True)
    base_mass: Scalar | None = eqx.field(default=None, kw_only=True)
    base_inertia: Scalar | None = eqx.field(default=None, kw_only=True)
    breaks: Breaks | None = eqx.field(default=None, kw_only=True, converter=as_breaks)

    def __check_init__(self):
        checks.number("length", self.length, positive=True)
        self._check_breaks()
        self._check_masses()
        if self.intrinsic_curvature is not None and not callable(self.intrinsic_curvature):
            checks.number("intrinsic_curvature", self.intrinsic_curvature)
        if not callable(self.bending_stiffness):
            checks.number("bending_stiffness", self.bending_stiffness, positive=True)
        if self.uniform or checks.is_traced(self):
            return
        self._check_along("bending_stiffness", self.bending_stiffness)
        with jax.ensure_compile_time_eval():
            turn = float(self._largest_turn())
        if not turn < np.pi / 2:
            raise ValueError(
                "`intrinsic_curvature` must turn the unloaded whisker by less than a right angle, got a turn of "
                f"{np.degrees(turn):.4g} degrees: a whisker that curls up would touch in more than one place."
            )

    def _check_masses(self) -> None:
        for name in ("tip_mass", "base_mass", "base_inertia"):
            if getattr(self, name) is not None:
                checks.number(name, getattr(self, name), non_negative=True)
        if self.mass_per_length is None:
            return
        if not callable(self.mass_per_length):
            checks.number("mass_per_length", self.mass_per_length, positive=True)
        elif not checks.is_traced((self.length, self.mass_per_length)):
            self._check_along("mass_per_length", self.mass_per_length)

    def _check_breaks(self) -> None:
        if self.breaks is None:
            return
        if not any(map(callable, (self.bending_stiffness, self.intrinsic_curvature, self.mass_per_length))):
            allowed = "absent unless bending stiffness, intrinsic curvature or mass per length is a function"
            checks.fail("breaks", allowed, _text(self.breaks))
        if checks.is_traced((self.breaks, self.length)):
            return
        if not _inside(np.asarray(self.breaks), float(self.length), np):
            checks.fail("breaks", f"in ascending order inside (0, {float(self.length):g})", _text(self.breaks))

    def _check_along(self, name: str, value: AlongWhisker) -> None:
        """Check that a concrete function of arc length is positive and finite."""
        with jax.ensure_compile_time_eval():
            values, positive = map(np.asarray, self._samples(value))
        if not positive.all():
            k = int(np.argmin(positive))
            allowed = "positive and finite along the whisker (zero only at the tip)"
            checks.fail(name, allowed, f"{values[k]} at {k / (CHECKED_POINTS - 1):.3g} of its length")

    @property
    def uniform(self) -> bool:
        """Whether the whisker is straight and its bending stiffness constant."""
        return not callable(self.bending_stiffness) and self.intrinsic_curvature is None

    def stiffness_at(self, s: Scalar) -> Float[Array, ""]:
        """EI at the arc length s from the base, force times length squared."""
        return at_arc(self.bending_stiffness, s)

    @property
    def base_stiffness(self) -> Scalar:
        """EI at the base; that of the first whisker is the unit in which scenes are dimensionless."""
        return self.stiffness_at(jnp.zeros(())) if callable(self.bending_stiffness) else self.bending_stiffness

    def valid(self):
        """Whether traced parameters are in the domain that the constructor checks."""
        length, (_, stiff) = jnp.asarray(self.length), self._samples(self.bending_stiffness)
        if self.breaks is not None:
            stiff &= _inside(jnp.asarray(self.breaks), length, jnp)
        return jnp.isfinite(length) & (length > 0) & jnp.all(stiff) & (self._largest_turn() < jnp.pi / 2)

    def valid_masses(self) -> Bool[Array, ""]:
        """Whether traced masses are in the domains that the constructor checks, with a mass per length."""
        points = (self.tip_mass, self.base_mass, self.base_inertia)
        masses = jnp.stack([jnp.asarray(0.0 if mass is None else mass, dtype=float) for mass in points])
        _, positive = self._samples(0.0 if self.mass_per_length is None else self.mass_per_length)
        return jnp.all(positive) & jnp.all((masses >= 0) & jnp.isfinite(masses))

    @property
    def has_masses(self) -> bool:
        """Whether any mass is given."""
        return any(mass is not None for mass in _masses(self))

    def without_masses(self) -> "Whisker":
        """The whisker without masses, which equilibria do not depend on."""
        kept = None if self.uniform else self.breaks  # the breaks of a uniform whisker are those of its mass
        return eqx.tree_at(_masses_and_breaks, self, (*[None] * 4, kept), is_leaf=lambda leaf: leaf is None)

    def mass_at(self, s: Scalar) -> Float[Array, ""]:
        """rho A at the arc length s from the base, mass per length; zero if it is unknown."""
        return at_arc(0.0 if self.mass_per_length is None else self.mass_per_length, s)

    def curvature_at(self, s: Scalar) -> Float[Array, ""]:
        """kappa0 at the arc length s from the base, 1/length, positive counter-clockwise."""
        return at_arc(0.0 if self.intrinsic_curvature is None else self.intrinsic_curvature, s)

    def section(self, length_unit: Scalar, stiffness_unit: Scalar) -> Section:
        """Bending stiffness and intrinsic curvature along the whisker, in these units of length and EI."""
        one = jnp.asarray(1.0)  # an array, because the orientation of each whisker differs in a batch
        stiffness, curvature, breaks = self.bending_stiffness, self.intrinsic_curvature, self.breaks
        breaks = None if breaks is None else jnp.asarray(breaks)
        return Section(stiffness, curvature, length_unit, stiffness_unit, one, breaks)

    def _largest_turn(self) -> Float[Array, ""]:
        """Largest angle between the unloaded whisker and the upright."""
        if self.intrinsic_curvature is None:
            return jnp.zeros(())
        step = jnp.asarray(self.length, dtype=float) / (CHECKED_POINTS - 1)
        curvature = jax.vmap(self.curvature_at)(step * jnp.arange(CHECKED_POINTS))
        return jnp.max(jnp.abs(jnp.cumsum((curvature[1:] + curvature[:-1]) / 2) * step))

    def _samples(self, value: AlongWhisker) -> tuple[Float[Array, " points"], Bool[Array, " points"]]:
        """A quantity at points along the whisker, and whether it is positive, or zero at the tip, and finite."""
        s = jnp.linspace(0.0, 1.0, CHECKED_POINTS if callable(value) else 2) * self.length
        values = jax.vmap(lambda s: at_arc(value, s))(s)
        positive = (values > 0).at[-1].set(values[-1] >= 0)
        return values, positive & jnp.isfinite(values)

    @classmethod
    def from_material(
        cls,
        length: Scalar,
        youngs_modulus: AlongWhisker,
        diameter: AlongWhisker,
        *,
        density: AlongWhisker | None = None,
    ) -> "Whisker":
        """A whisker of circular cross-section, EI = E pi d^4 / 64 and rho A = rho pi d^2 / 4.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            diameter: d, m; a positive number, or a function of the arc length from the base.
            density: rho, kg/m^3; a positive number, or a function of the arc length from the base. Default: unknown.

        Raises:
            ValueError: as for a Whisker, or if a diameter is more than a fifth of the length.

        Examples:
            >>> whisker = jw.Whisker.from_material(length=0.05, youngs_modulus=3e9, diameter=2e-4)
            >>> print(f"{whisker.bending_stiffness:.3e}")  # N m^2
            2.356e-07
        """
        for name, value in (("youngs_modulus", youngs_modulus), ("diameter", diameter), ("density", density)):
            if value is not None and not callable(value):
                checks.number(name, value, positive=True)
        section = RoundSection(youngs_modulus, diameter)
        mass = None if density is None else RoundMass(density, diameter)
        whisker = cls(
            length,
            section if callable(youngs_modulus) or callable(diameter) else section(0.0),
            mass_per_length=mass if mass is None or callable(density) or callable(diameter) else mass(0.0),
        )
        _check_slender("diameter", diameter, length)
        return whisker

    @classmethod
    def conical(
        cls,
        length: Scalar,
        youngs_modulus: AlongWhisker,
        base_diameter: Scalar,
        tip_diameter: Scalar,
        *,
        density: AlongWhisker | None = None,
    ) -> "Whisker":
        """A whisker whose diameter decreases linearly from base to tip.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            base_diameter: d at the base, m; positive.
            tip_diameter: d at the tip, m; not negative. A pointed tip (0) carries no force: it bends away, and the
                contact is tangential from the start.
            density: rho, kg/m^3; a positive number, or a function of the arc length from the base. Default: unknown.

        Raises:
            ValueError: as for a Whisker, or if a diameter is negative or more than a fifth of the length.

        Examples:
            >>> cone = jw.Whisker.conical(length=0.05, youngs_modulus=3e9, base_diameter=2e-4, tip_diameter=5e-5)
            >>> print(f"{cone.base_stiffness / cone.stiffness_at(0.05):.0f}")  # the ratio of diameters, to the fourth
            256
        """
        checks.number("base_diameter", base_diameter, positive=True)
        checks.number("tip_diameter", tip_diameter, non_negative=True)
        checks.number("length", length, positive=True)
        _check_slender("base_diameter", base_diameter, length)
        _check_slender("tip_diameter", tip_diameter, length)
        taper = LinearTaper(base_diameter, tip_diameter, length)
        return cls.from_material(length, youngs_modulus, taper, density=density)

    @classmethod
    def rat(
        cls,
        row: str,
        column: int,
        *,
        length: Scalar | None = None,
        youngs_modulus: AlongWhisker = 3e9,
        intrinsic_curvature: AlongWhisker | None = None,
        density: AlongWhisker | None = None,
    ) -> "Whisker":
        """The average vibrissa of a rat at one position in the array, in SI units: a cone.

        With r = 1 to 5 for the rows A to E, c for the column, and lengths in millimetres: the arc length is
        S = 43 + 1.8 r - 7.6 c, the diameter at the base is 0.041 + 0.002 S + 0.011 r - 0.0039 c, and the radius
        decreases by 0.0012 + 0.00017 r - 0.000066 c + 0.00011 c^2 per unit of arc length, to no less than 1.5
        micrometres.

        Args:
            row: "A" (uppermost) to "E".
            column: 0 (the Greek arc, at the back) to 5; to 4 in rows A and B.
            length: S, m; positive. Default: the average.
            youngs_modulus: E, Pa. 3 GPa is a common round value; measured values scatter by more than half of it.
            intrinsic_curvature: 1/m, a number or a function, as for any whisker.
            density: rho, kg/m^3, a number or a function. Default: unknown.

        Raises:
            ValueError: if the array has no such position, or as for a Whisker.

        Examples:
            >>> whisker = jw.Whisker.rat("C", 2)
            >>> print(f"{1e3 * whisker.length:.1f} mm")
            33.2 mm

        Source: Belli, Yang, Bresee and Hartmann (2017), J. Neurophysiol. 117, 1807, regressions over seven studies;
        with the coefficients and the smallest tip radius of the simulator WHISKiT Physics (Zweifel et al. 2021, PNAS
        118, e2011905118), which uses these regressions.
        """
        if not isinstance(row, str) or row not in LAST_COLUMN:
            checks.fail("row", f"one of {', '.join(LAST_COLUMN)}", repr(row))
        if not isinstance(column, int) or isinstance(column, bool) or not 0 <= column <= LAST_COLUMN[row]:
            checks.fail("column", f"an int from 0 to {LAST_COLUMN[row]} in row {row}", repr(column))
        if length is not None:
            checks.number("length", length, positive=True)
        r, c = list(LAST_COLUMN).index(row) + 1, column
        arc = 43 + 1.8 * r - 7.6 * c if length is None else length * 1e3
        base = 0.041 + 0.002 * arc + 0.011 * r - 0.0039 * c
        slope = 0.0012 + 0.00017 * r - 0.000066 * c + 0.00011 * c**2
        tip = jnp.maximum(base - 2 * slope * arc, 2 * LEAST_TIP_RADIUS)
        cone = cls.conical(arc * 1e-3, youngs_modulus, base * 1e-3, tip * 1e-3, density=density)
        return cls(cone.length, cone.bending_stiffness, intrinsic_curvature, mass_per_length=cone.mass_per_length)


def _check_slender(name: str, diameter: AlongWhisker, length: Scalar) -> None:
    """Check that a concrete diameter is that of a slender rod, and not in another unit than the length."""
    if checks.is_traced((diameter, length)):
        return
    with jax.ensure_compile_time_eval():
        places = jnp.linspace(0.0, 1.0, CHECKED_POINTS) * length
        thickest = float(jnp.max(jax.vmap(diameter)(places)) if callable(diameter) else diameter)
    if thickest > float(length) / SLENDER:
        allowed = f"at most 1/{SLENDER} of the length {float(length):g}, in the same unit: rods are slender"
        raise ValueError(f"`{name}` must be {allowed}; got {thickest:g}.")


def _masses(whisker: Whisker) -> tuple:
    return whisker.mass_per_length, whisker.tip_mass, whisker.base_mass, whisker.base_inertia


def _masses_and_breaks(whisker: Whisker) -> tuple:
    return *_masses(whisker), whisker.breaks


def _inside(breaks: Any, length: Any, numpy: Any) -> Any:
    """Whether breaks ascend and are inside the whisker."""
    return numpy.all(numpy.diff(breaks) >= 0) & (breaks[0] > 0) & (breaks[-1] < length)


def _text(breaks: Breaks) -> str:
    return "(" + ", ".join(map(as_text, breaks)) + ")"


def with_equal_breaks(whiskers: tuple[Whisker, ...]) -> tuple[Whisker, ...]:
    """Whiskers with equal numbers of breaks, which can be stacked; additional breaks are at the base."""
    own = [jnp.zeros(0) if whisker.breaks is None else jnp.asarray(whisker.breaks) for whisker in whiskers]
    most = max(breaks.size for breaks in own)
    if most == 0:
        return whiskers
    return tuple(
        eqx.tree_at(
            lambda w: w.breaks, whisker, jnp.pad(breaks, (most - breaks.size, 0)), is_leaf=lambda leaf: leaf is None
        )
        for whisker, breaks in zip(whiskers, own, strict=True)
    )


LAST_COLUMN = {
    "A": 4,
    "B": 4,
    "C": 5,
    "D": 5,
    "E": 5,
}  # last column of each row for which the regression gives a length
LEAST_TIP_RADIUS = 0.0015  # mm
