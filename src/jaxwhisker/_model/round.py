"""Whiskers from materials: with circular cross-sections, also those of rats, and strips."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.data_files import published
from jaxwhisker._base.leaves import as_text
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.along import (
    AlongWhisker,
    LinearTaper,
    ParabolicShape,
    RoundMass,
    RoundSection,
    check_slender,
)
from jaxwhisker._model.measured import Measured


class Round(Measured):
    """Constructors of whiskers with circular cross-sections, and of strips."""

    @classmethod
    def from_material(
        cls: Any,
        length: Scalar,
        youngs_modulus: AlongWhisker,
        diameter: AlongWhisker,
        *,
        intrinsic_curvature: AlongWhisker | None = None,
        density: AlongWhisker | None = None,
        poisson_ratio: Scalar | None = None,
    ) -> Any:
        """A whisker of circular cross-section, EI = E pi d^4 / 64 and rho A = rho pi d^2 / 4.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            diameter: d, m; a positive number, or a function of the arc length from the base.
            intrinsic_curvature: 1/m, a number or a function, as for any whisker. Default: straight.
            density: rho, kg/m^3; a positive number, or a function of the arc length from the base. Default: unknown.
            poisson_ratio: nu, above -1 and at most 0.5, of which the `torsion_ratio` is 1 / (1 + nu). Only needed in
                space. Default: that of a Whisker.

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
            intrinsic_curvature,
            mass_per_length=mass if mass is None or callable(density) or callable(diameter) else mass(0.0),
            torsion_ratio=_torsion_ratio(poisson_ratio),
        )
        check_slender("diameter", diameter, length)
        return whisker

    @classmethod
    def conical(
        cls: Any,
        length: Scalar,
        youngs_modulus: AlongWhisker,
        base_diameter: Scalar,
        tip_diameter: Scalar,
        *,
        intrinsic_curvature: AlongWhisker | None = None,
        density: AlongWhisker | None = None,
        poisson_ratio: Scalar | None = None,
    ) -> Any:
        """A whisker whose diameter decreases linearly from base to tip.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; a positive number, or a function of the arc length from the base.
            base_diameter: d at the base, m; positive.
            tip_diameter: d at the tip, m; not negative. A pointed tip (0) carries no force: it bends away, and the
                contact is tangential from the start.
            intrinsic_curvature: 1/m, a number or a function, as for any whisker. Default: straight.
            density: rho, kg/m^3; a positive number, or a function of the arc length from the base. Default: unknown.
            poisson_ratio: nu, above -1 and at most 0.5, of which the `torsion_ratio` is 1 / (1 + nu). Only needed in
                space. Default: that of a Whisker.

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
        check_slender("base_diameter", base_diameter, length)
        check_slender("tip_diameter", tip_diameter, length)
        taper = LinearTaper(base_diameter, tip_diameter, length)
        further = {"intrinsic_curvature": intrinsic_curvature, "density": density, "poisson_ratio": poisson_ratio}
        return cls.from_material(length, youngs_modulus, taper, **further)

    @classmethod
    def strip(
        cls: Any,
        length: Scalar,
        youngs_modulus: Scalar,
        width: Scalar,
        thickness: Scalar,
        *,
        intrinsic_curvature: AlongWhisker | None = None,
        density: Scalar | None = None,
        poisson_ratio: Scalar = 0.3,
    ) -> Any:
        """A strip of rectangular cross-section, w by t, for scenes in space: EI = E w t^3 / 12 in the plane.

        Its faces look along x where it stands upright. Against bending towards z it is (w / t)^2 times as stiff, which
        is the `lateral_ratio`. `Mount(roll=)` turns it about its axis.

        Args:
            length: L, m; positive.
            youngs_modulus: E, Pa; positive.
            width: w, along z, m; positive.
            thickness: t, along x, m; positive.
            intrinsic_curvature: 1/m, a number or a function, as for any whisker. Default: straight.
            density: rho, kg/m^3; positive. Default: unknown.
            poisson_ratio: nu, above -1 and at most 0.5, of which the stiffness against torsion follows.

        Raises:
            ValueError: as for a Whisker, or if width or thickness is more than a fifth of the length.

        Examples:
            >>> strip = jw.Whisker.strip(length=0.1, youngs_modulus=2e11, width=2e-3, thickness=2e-4)
            >>> print(f"{strip.bending_stiffness:.2e}, {strip.lateral_ratio:.0f}, {strip.torsion_ratio:.3f}")
            2.67e-04, 100, 1.442

        Source: Timoshenko and Goodier (1970), Theory of Elasticity, section 109, for the torsion of rectangular bars.
        """
        _torsion_ratio(poisson_ratio)  # checks it
        given = {"youngs_modulus": youngs_modulus, "width": width, "thickness": thickness}
        for name, value in (given if density is None else given | {"density": density}).items():
            checks.number(name, value, positive=True)
        check_slender("width", width, length)
        check_slender("thickness", thickness, length)
        return cls(
            length,
            youngs_modulus * width * thickness**3 / 12,
            intrinsic_curvature,
            mass_per_length=None if density is None else density * width * thickness,
            torsion_ratio=2 / (1 + poisson_ratio) * _torsion_of_rectangle(width / thickness),
            lateral_ratio=(width / thickness) ** 2,
        )

    @classmethod
    def rat(
        cls: Any,
        row: str,
        column: int,
        *,
        length: Scalar | None = None,
        youngs_modulus: AlongWhisker = 3e9,
        intrinsic_curvature: AlongWhisker | None = None,
        density: AlongWhisker | None = None,
        poisson_ratio: Scalar | None = None,
        parabola: Scalar | None = None,
    ) -> Any:
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
            poisson_ratio: as for `from_material`.
            parabola: A, 1/m, of an unloaded shape y = A x^2, with x along the root, instead of an intrinsic curvature;
                see ParabolicShape. Rats have values from 6 to 38 per m, the larger ones in shorter whiskers. Default:
                straight.

        Raises:
            ValueError: if the array has no such position, both an intrinsic curvature and a parabola are given, or as
                for a Whisker.

        Examples:
            >>> whisker = jw.Whisker.rat("C", 2)
            >>> print(f"{1e3 * whisker.length:.1f} mm")
            33.2 mm

        Source: Belli, Yang, Bresee and Hartmann (2017), J. Neurophysiol. 117, 1807, regressions over seven studies;
        with the coefficients and the smallest tip radius of the simulator WHISKiT Physics (Zweifel et al. 2021, PNAS
        118, e2011905118), which uses these regressions.
        """
        cone = published("rats")["cone"]
        last_column = cone["last_column"]
        if not isinstance(row, str) or row not in last_column:
            checks.fail("row", f"one of {', '.join(last_column)}", repr(row))
        if not isinstance(column, int) or isinstance(column, bool) or not 0 <= column <= last_column[row]:
            checks.fail("column", f"an int from 0 to {last_column[row]} in row {row}", repr(column))
        if length is not None:
            checks.number("length", length, positive=True)
        terms: dict[str, Any] = {"1": 1, "r": list(last_column).index(row) + 1, "c": column, "cc": column**2}

        def regression(name: str) -> Any:
            return sum(coefficient * terms[term] for term, coefficient in cone[name].items())

        arc = terms["S"] = regression("arc") if length is None else length * 1e3
        base = regression("base_diameter")
        tip = jnp.maximum(base - 2 * regression("slope_of_radius") * arc, 2 * cone["least_tip_radius"])
        if parabola is not None:
            if intrinsic_curvature is not None:
                checks.fail("parabola", "None with an `intrinsic_curvature`", as_text(parabola))
            intrinsic_curvature = ParabolicShape(parabola)
        further = {"intrinsic_curvature": intrinsic_curvature, "density": density, "poisson_ratio": poisson_ratio}
        return cls.conical(arc * 1e-3, youngs_modulus, base * 1e-3, tip * 1e-3, **further)


def _torsion_of_rectangle(slenderness: Scalar) -> Scalar:
    """J of a rectangle w by t divided by w t^3 / 3, at this w / t."""
    odd = np.arange(1, 40, 2)
    # Where it is large, the hyperbolic tangent is 1 to the last digit.
    series = jnp.sum(jnp.tanh(jnp.minimum(odd * np.pi / 2 * slenderness, 20.0)) / odd**5)
    return 1 - 192 / np.pi**5 * series / slenderness


def _torsion_ratio(poisson_ratio: Scalar | None) -> Scalar | None:
    """GJ / EI of a circular cross-section."""
    if poisson_ratio is None:
        return None
    checks.number("poisson_ratio", poisson_ratio)
    if not checks.is_traced(poisson_ratio) and not -1 < float(poisson_ratio) <= 0.5:
        checks.fail("poisson_ratio", "above -1 and at most 0.5", as_text(poisson_ratio))
    return 1 / (1 + poisson_ratio)
