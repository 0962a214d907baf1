"""The whisker: a slender, inextensible, shearless elastic rod, straight or curved when unloaded."""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import number_or_function
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import AlongRod, Section, at_arc

AlongWhisker: TypeAlias = AlongRod  # a number, or a function of the arc length from the base
CHECKED_POINTS = 65  # points at which a function of arc length is checked


class Whisker(eqx.Module):
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

    Raises:
        ValueError: if the length is not a positive finite number, the bending stiffness is not positive and finite, JAX
            cannot trace a function with one number as its argument, or the unloaded whisker turns by a right angle or
            more.

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

    def __check_init__(self):
        checks.number("length", self.length, positive=True)
        if self.intrinsic_curvature is not None and not callable(self.intrinsic_curvature):
            checks.number("intrinsic_curvature", self.intrinsic_curvature)
        if not callable(self.bending_stiffness):
            checks.number("bending_stiffness", self.bending_stiffness, positive=True)
        if self.uniform or checks.is_traced(self):
            return
        with jax.ensure_compile_time_eval():
            stiffness, stiff = map(np.asarray, self._stiffness_samples())
            turn = float(self._largest_turn())
        if not stiff.all():
            k = int(np.argmin(stiff))
            allowed = "positive and finite along the whisker (zero only at the tip)"
            checks.fail("bending_stiffness", allowed, f"{stiffness[k]} at {k / (CHECKED_POINTS - 1):.3g} of its length")
        if not turn < np.pi / 2:
            raise ValueError(
                "`intrinsic_curvature` must turn the unloaded whisker by less than a right angle, got a turn of "
                f"{np.degrees(turn):.4g} degrees: a whisker that curls up would touch in more than one place."
            )

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
        length, (_, stiff) = jnp.asarray(self.length), self._stiffness_samples()
        return jnp.isfinite(length) & (length > 0) & jnp.all(stiff) & (self._largest_turn() < jnp.pi / 2)

    def curvature_at(self, s: Scalar) -> Float[Array, ""]:
        """kappa0 at the arc length s from the base, 1/length, positive counter-clockwise."""
        return at_arc(0.0 if self.intrinsic_curvature is None else self.intrinsic_curvature, s)

    def section(self, length_unit: Scalar, stiffness_unit: Scalar) -> Section:
        """Bending stiffness and intrinsic curvature along the whisker, in these units of length and EI."""
        one = jnp.asarray(1.0)  # an array, because the orientation of each whisker differs in a batch
        return Section(self.bending_stiffness, self.intrinsic_curvature, length_unit, stiffness_unit, one)

    def _largest_turn(self) -> Float[Array, ""]:
        """Largest angle between the unloaded whisker and the upright."""
        if self.intrinsic_curvature is None:
            return jnp.zeros(())
        step = jnp.asarray(self.length, dtype=float) / (CHECKED_POINTS - 1)
        curvature = jax.vmap(self.curvature_at)(step * jnp.arange(CHECKED_POINTS))
        return jnp.max(jnp.abs(jnp.cumsum((curvature[1:] + curvature[:-1]) / 2) * step))

    def _stiffness_samples(self) -> tuple[Float[Array, " points"], Bool[Array, " points"]]:
        """EI at points along the whisker, and whether it is positive, or zero at the tip, and finite."""
        s = jnp.linspace(0.0, 1.0, CHECKED_POINTS if callable(self.bending_stiffness) else 2) * self.length
        values = jax.vmap(self.stiffness_at)(s)
        positive = (values > 0).at[-1].set(values[-1] >= 0)
        return values, positive & jnp.isfinite(values)

    @classmethod
    def from_material(cls, length: Scalar, youngs_modulus: AlongWhisker, diameter: AlongWhisker) -> "Whisker":
        """A whisker of circular cross-section, EI = E pi d^4 / 64.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            diameter: d, m; a positive number, or a function of the arc length from the base.

        Raises:
            ValueError: as for a Whisker.

        Examples:
            >>> whisker = jw.Whisker.from_material(length=0.05, youngs_modulus=3e9, diameter=2e-4)
            >>> print(f"{whisker.bending_stiffness:.3e}")  # N m^2
            2.356e-07
        """
        for name, value in (("youngs_modulus", youngs_modulus), ("diameter", diameter)):
            if not callable(value):
                checks.number(name, value, positive=True)
        section = RoundSection(youngs_modulus, diameter)
        return cls(length, section if callable(youngs_modulus) or callable(diameter) else section(0.0))

    @classmethod
    def conical(
        cls, length: Scalar, youngs_modulus: AlongWhisker, base_diameter: Scalar, tip_diameter: Scalar
    ) -> "Whisker":
        """A whisker whose diameter decreases linearly from base to tip.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            base_diameter: d at the base, m; positive.
            tip_diameter: d at the tip, m; not negative. A pointed tip (0) carries no force: it bends away, and the
                contact is tangential from the start.

        Raises:
            ValueError: as for a Whisker, or if a diameter is negative.

        Examples:
            >>> cone = jw.Whisker.conical(length=0.05, youngs_modulus=3e9, base_diameter=2e-4, tip_diameter=5e-5)
            >>> print(f"{cone.base_stiffness / cone.stiffness_at(0.05):.0f}")  # the ratio of diameters, to the fourth
            256
        """
        checks.number("base_diameter", base_diameter, positive=True)
        checks.number("tip_diameter", tip_diameter, non_negative=True)
        return cls.from_material(length, youngs_modulus, LinearTaper(base_diameter, tip_diameter, length))

    @classmethod
    def rat(
        cls,
        row: str,
        column: int,
        *,
        length: Scalar | None = None,
        youngs_modulus: AlongWhisker = 3e9,
        intrinsic_curvature: AlongWhisker | None = None,
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
        cone = cls.conical(arc * 1e-3, youngs_modulus, base * 1e-3, tip * 1e-3)
        return cls(cone.length, cone.bending_stiffness, intrinsic_curvature)


LAST_COLUMN = {
    "A": 4,
    "B": 4,
    "C": 5,
    "D": 5,
    "E": 5,
}  # last column of each row for which the regression gives a length
LEAST_TIP_RADIUS = 0.0015  # mm


class LinearTaper(eqx.Module):
    """A linear function of the arc length: `base` at 0 and `tip` at `length`."""

    base: Scalar
    tip: Scalar
    length: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.base + (self.tip - self.base) * (s / self.length)


class RoundSection(eqx.Module):
    """Bending stiffness of a circular cross-section, E pi d^4 / 64; E and d may be functions of the arc length."""

    youngs_modulus: AlongWhisker = eqx.field(converter=number_or_function("youngs_modulus"))
    diameter: AlongWhisker = eqx.field(converter=number_or_function("diameter"))

    def __call__(self, s: Scalar) -> Scalar:
        modulus, diameter = (value(s) if callable(value) else value for value in (self.youngs_modulus, self.diameter))
        return modulus * (np.pi / 64) * diameter**4
