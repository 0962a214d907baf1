"""The whisker: a slender, inextensible, shearless elastic rod, straight or curved when unloaded."""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.functions import as_field
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import AlongRod, Section, at_arc

AlongWhisker: TypeAlias = AlongRod  # a number, or a function of the arc length from the base
LOOKED_AT = 65  # points at which a function of arc length is looked at


class Whisker(eqx.Module):
    """A whisker, clamped upright.

    Args:
        length: L, the arc length from base to tip, in your unit of length; positive.
        bending_stiffness: EI, force times length squared: a positive number, or a function of the arc length s in
            [0, L] from the base, positive but at the tip, where it may vanish. An `equinox.Module` keeps its parameters
            differentiable; a plain function is taken as it is. It is called with one s at a time, traced.
        intrinsic_curvature: kappa0 = d phi / ds of the unloaded whisker, 1/length, counter-clockwise positive (towards
            -x, where a scan goes): a number or such a function. None for a straight whisker, which costs less.

    Raises:
        ValueError: if the length is not a positive finite number, the bending stiffness is not positive and finite, or
            the unloaded whisker curls round: turns by a right angle or more, so that it does not rise to its tip.

    With the defaults everything is dimensionless: lengths in L, forces in EI/L^2, moments in EI/L.
    """

    length: Scalar = 1.0
    bending_stiffness: AlongWhisker = eqx.field(default=1.0, converter=as_field)
    intrinsic_curvature: AlongWhisker | None = eqx.field(default=None, converter=as_field)

    def __check_init__(self):
        checks.number("length", self.length, positive=True)
        if self.intrinsic_curvature is not None and not callable(self.intrinsic_curvature):
            checks.number("intrinsic_curvature", self.intrinsic_curvature)
        if not callable(self.bending_stiffness):
            checks.number("bending_stiffness", self.bending_stiffness, positive=True)
        elif not checks.is_traced(self):
            with jax.ensure_compile_time_eval():
                values = np.asarray(self._stiffness_looked_at())
            bad = ~(np.isfinite(values) & (values > 0))
            bad[-1] &= values[-1] != 0
            if bad.any():
                k = int(np.argmax(bad))
                raise ValueError(
                    "`bending_stiffness` must be positive and finite along the whisker (zero at the tip at most), but "
                    f"is {values[k]} at {k / (LOOKED_AT - 1):.3g} of its length."
                )
        if not checks.is_traced(self):
            with jax.ensure_compile_time_eval():
                turn = float(self._largest_turn())
            if not turn < np.pi / 2:
                raise ValueError(
                    "`intrinsic_curvature` must turn the unloaded whisker by less than a right angle, but it turns by "
                    f"{np.degrees(turn):.4g} degrees: a whisker that curls round touches in more than one place."
                )

    @property
    def uniform(self) -> bool:
        """Whether the whisker is straight and its bending stiffness a number."""
        return not callable(self.bending_stiffness) and self.intrinsic_curvature is None

    def stiffness_at(self, s: Scalar) -> Float[Array, ""]:
        """EI at an arc length from the base."""
        return at_arc(self.bending_stiffness, s)

    @property
    def base_stiffness(self) -> Scalar:
        """EI at the base, by which a scene is made dimensionless."""
        return self.stiffness_at(jnp.zeros(())) if callable(self.bending_stiffness) else self.bending_stiffness

    def valid(self):
        """Whether traced parameters lie where the constructor would have let them."""
        length, values = jnp.asarray(self.length), self._stiffness_looked_at()
        inside = jnp.all((values[:-1] > 0) & jnp.isfinite(values[:-1])) & (values[-1] >= 0) & jnp.isfinite(values[-1])
        return jnp.isfinite(length) & (length > 0) & inside & (self._largest_turn() < jnp.pi / 2)

    def curvature_at(self, s: Scalar) -> Float[Array, ""]:
        """kappa0 at an arc length from the base."""
        return at_arc(0.0 if self.intrinsic_curvature is None else self.intrinsic_curvature, s)

    def section(self, length_unit: Scalar, stiffness_unit: Scalar) -> Section:
        """Bending stiffness and intrinsic curvature along the whisker, in these units of length and EI."""
        one = jnp.asarray(1.0)  # an array, since the orientation of each whisker differs in a batch
        return Section(self.bending_stiffness, self.intrinsic_curvature, length_unit, stiffness_unit, one)

    def _largest_turn(self) -> Float[Array, ""]:
        """The largest angle of the unloaded whisker to the upright."""
        if self.intrinsic_curvature is None:
            return jnp.zeros(())
        step = jnp.asarray(self.length, dtype=float) / (LOOKED_AT - 1)
        curvature = jax.vmap(self.curvature_at)(step * jnp.arange(LOOKED_AT))
        return jnp.max(jnp.abs(jnp.cumsum((curvature[1:] + curvature[:-1]) / 2) * step))

    def _stiffness_looked_at(self) -> Float[Array, " points"]:
        if not callable(self.bending_stiffness):
            return jnp.broadcast_to(jnp.asarray(self.bending_stiffness, dtype=float), 2)
        return jax.vmap(self.stiffness_at)(jnp.linspace(0.0, 1.0, LOOKED_AT) * self.length)

    @classmethod
    def from_material(cls, length: Scalar, youngs_modulus: AlongWhisker, diameter: AlongWhisker) -> "Whisker":
        """A whisker of circular section, EI = E pi d^4 / 64.

        Args:
            length: L, m.
            youngs_modulus: E, Pa: a number, or a function of the arc length from the base.
            diameter: d, m: a number, or a function of the arc length from the base.

        Raises:
            ValueError: as for a Whisker; a number has to be positive.
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
        """A whisker whose diameter falls linearly from base to tip.

        Args:
            length: L, m.
            youngs_modulus: E, Pa: a number, or a function of the arc length from the base.
            base_diameter: d at the base, m; positive.
            tip_diameter: d at the tip, m; 0 for a point, which carries no force: it bends away, and the contact is
                tangential at once.

        Raises:
            ValueError: as for `from_material`; if a diameter is negative.
        """
        checks.number("base_diameter", base_diameter, positive=True)
        checks.number("tip_diameter", tip_diameter)
        if not checks.is_traced(tip_diameter) and float(tip_diameter) < 0:
            raise ValueError(f"`tip_diameter` must be at least 0, but is {float(tip_diameter)}.")
        return cls.from_material(length, youngs_modulus, Linear(base_diameter, tip_diameter, length))

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
        """The average vibrissa of a rat at a place of its array, in SI units: a cone.

        With r = 1 to 5 for the rows A to E and c for the column, in millimetres: arc length S = 43 + 1.8 r - 7.6 c,
        diameter at the base 0.041 + 0.002 S + 0.011 r - 0.0039 c; the radius falls by 0.0012 + 0.00017 r - 0.000066 c +
        0.00011 c^2 per length, down to 1.5 micrometres at least.

        Args:
            row: "A", the uppermost, to "E".
            column: 0, the Greek arc at the back, to 5.
            length: S, m, instead of the average one.
            youngs_modulus: E, Pa; 3 GPa is a usual round value, measured ones scatter by more than its half.
            intrinsic_curvature: 1/m, number or function, as of any whisker.

        Raises:
            ValueError: if there is no such place in the array.

        Source: Belli, Yang, Bresee and Hartmann (2017), J. Neurophysiol. 117, 1807, regressions over seven studies;
        with the coefficients and the least tip of the simulator WHISKiT Physics (Zweifel et al. 2021, PNAS 118,
        e2011905118), which takes its whiskers from there.
        """
        if row not in ROWS:
            raise ValueError(f"`row` must be one of {', '.join(ROWS)}, but is {row!r}.")
        if not isinstance(column, int) or not 0 <= column <= COLUMNS[row]:
            raise ValueError(f"`column` must be an int from 0 to {COLUMNS[row]} in row {row}, but is {column!r}.")
        if length is not None:
            checks.number("length", length, positive=True)
        r, c = ROWS.index(row) + 1, column
        arc = 43 + 1.8 * r - 7.6 * c if length is None else length * 1e3
        base = 0.041 + 0.002 * arc + 0.011 * r - 0.0039 * c
        slope = 0.0012 + 0.00017 * r - 0.000066 * c + 0.00011 * c**2
        tip = jnp.maximum(base - 2 * slope * arc, 2 * LEAST_TIP_RADIUS)
        cone = cls.conical(arc * 1e-3, youngs_modulus, base * 1e-3, tip * 1e-3)
        return cls(cone.length, cone.bending_stiffness, intrinsic_curvature)


ROWS = "ABCDE"
COLUMNS = {"A": 4, "B": 4, "C": 5, "D": 5, "E": 5}  # up to which the regression gives a length
LEAST_TIP_RADIUS = 0.0015  # mm


class Linear(eqx.Module):
    """A straight line over the arc length: from `base` at 0 to `tip` at `length`."""

    base: Scalar
    tip: Scalar
    length: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.base + (self.tip - self.base) * (s / self.length)


class RoundSection(eqx.Module):
    """Bending stiffness of a circular section, E pi d^4 / 64; both may be functions of the arc length."""

    youngs_modulus: AlongWhisker = eqx.field(converter=as_field)
    diameter: AlongWhisker = eqx.field(converter=as_field)

    def __call__(self, s: Scalar) -> Scalar:
        modulus, diameter = (value(s) if callable(value) else value for value in (self.youngs_modulus, self.diameter))
        return modulus * (np.pi / 64) * diameter**4
