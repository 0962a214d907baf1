"""Whiskers from measurements: tables of a section along the whisker, and digitised shapes."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._model.along import AlongWhisker, Polynomial, RoundMass, RoundSection, Table, check_slender

FIT_STEPS = 12  # of Levenberg-Marquardt, each with derivatives by differences
MOST_DEGREE = 5  # of the curvature of a digitised shape
LEAST_CHANCE = 1e-3  # of the residuals of a shape that is accepted, if the error is that of the points
INTEGRAL_DEGREE = 48  # of Chebyshev polynomials of a shape: exact to rounding where it turns by less than pi
FEET_STEPS = 4  # of Newton's method for the nearest points of a shape
OUTSIDE = 0.1  # of the length: how far the nearest points may lie beyond the ends of the chord

Column = Any  # a number, or an array with one value per row


class Measured(eqx.Module):
    """Constructors of whiskers from measurements."""

    @classmethod
    def from_table(
        cls: Any,
        s: Any,
        *,
        youngs_modulus: Column | None = None,
        diameter: Column | None = None,
        density: Column | None = None,
        bending_stiffness: Column | None = None,
        intrinsic_curvature: Column | None = None,
        mass_per_length: Column | None = None,
    ) -> Any:
        """A whisker from a table of its section, with linear interpolation between rows.

        Each column is an array with one value per row, or a number that is the same everywhere. The rows are the
        whisker's `breaks`, so that integration steps end at them; each row costs one step.

        Args:
            s: arc lengths of the rows: from 0 at the base to L at the tip, ascending. Two rows inside the whisker with
                the same arc length are a jump.
            youngs_modulus: E of a circular cross-section, Pa.
            diameter: d of a circular cross-section, m; zero only at the tip.
            density: rho, kg/m^3, with a diameter. Default: unknown.
            bending_stiffness: EI, instead of a modulus and a diameter; zero only at the tip.
            intrinsic_curvature: kappa0, 1/length. Default: straight.
            mass_per_length: rho A, instead of a density.

        Raises:
            ValueError: if the arc lengths do not begin at 0 or do not ascend, a column has the wrong number of rows or
                is not positive, a diameter is more than a fifth of the length, or if neither a bending stiffness nor a
                modulus with a diameter is given, or both.

        Examples:
            >>> whisker = jw.Whisker.from_table([0.0, 0.01, 0.02], youngs_modulus=3e9, diameter=[2e-4, 1.5e-4, 5e-5])
            >>> print(f"{whisker.stiffness_at(0.015) / whisker.base_stiffness:.4f}")  # 0.1 mm of 0.2 mm, to the fourth
            0.0625
        """
        rows = _rows(s)
        given = {
            "youngs_modulus": youngs_modulus,
            "diameter": diameter,
            "density": density,
            "bending_stiffness": bending_stiffness,
            "intrinsic_curvature": intrinsic_curvature,
            "mass_per_length": mass_per_length,
        }
        column = {name: _column(name, value, rows) for name, value in given.items() if value is not None}
        round_, own = {"youngs_modulus", "diameter"} <= column.keys(), "bending_stiffness" in column
        if round_ == own or ({"youngs_modulus", "diameter"} & column.keys() and own):
            checks.fail("bending_stiffness", "given, or both `youngs_modulus` and `diameter`", sorted(column))
        if "density" in column and ("mass_per_length" in column or not round_):
            checks.fail("density", "given with a `diameter` and without `mass_per_length`", sorted(column))
        stiffness = column["bending_stiffness"] if own else RoundSection(column["youngs_modulus"], column["diameter"])
        mass = (
            RoundMass(column["density"], column["diameter"]) if "density" in column else column.get("mass_per_length")
        )
        if "diameter" in column:
            check_slender("diameter", column["diameter"], rows[-1])
        curvature = column.get("intrinsic_curvature")
        functions = any(isinstance(value, Table) for value in column.values())
        breaks = rows[1:-1] if functions and rows.shape[0] > 2 else None
        return cls(rows[-1], _simple(stiffness), curvature, mass_per_length=_simple(mass), breaks=breaks)

    @classmethod
    def from_points(
        cls: Any,
        x: Any,
        y: Any,
        error: float,
        *,
        bending_stiffness: AlongWhisker = 1.0,
        mass_per_length: AlongWhisker | None = None,
    ) -> Any:
        """A whisker whose unloaded shape was digitised.

        The intrinsic curvature is the polynomial of arc length with the lowest degree that reproduces the points within
        their error: none for a straight whisker, a constant for a circular arc, a linear function for an Euler spiral.
        The polynomial is fitted to the distances of the points from the shape. Where the shape lies and how it is
        turned does not matter.

        Args:
            x: coordinates of at least three points of the whisker in order from the base to the tip, lengths.
            y: the other coordinates, upwards where x runs to the right; in pictures, rows often run downwards.
            error: standard deviation of each coordinate, a length; positive.
            bending_stiffness: EI, as for any whisker. The length of the whisker is known after the fit: for a cone,
                construct the whisker from `length` and `intrinsic_curvature` of the result.
            mass_per_length: rho A, as for any whisker.

        Raises:
            ValueError: if arguments are not arrays of equal length, no polynomial of a degree up to 5 reproduces the
                points, or as for a Whisker.

        Examples:
            >>> angle = np.linspace(0.0, 0.6, 30)  # of a circular arc with radius 0.05
            >>> x, y = 0.05 * (np.cos(angle) - 1), 0.05 * np.sin(angle)
            >>> whisker = jw.Whisker.from_points(x, y, error=1e-5)
            >>> print(f"{whisker.length:.4f}, {whisker.intrinsic_curvature:.3f}")
            0.0300, 20.000
        """
        checks.vector("x", x)
        checks.vector("y", y)
        checks.number("error", error, positive=True)
        if np.shape(x) != np.shape(y) or np.size(x) < 3:
            checks.fail("y", "an array of the length of `x`, at least 3", f"{np.size(y)} and {np.size(x)} values")
        points = np.stack([np.asarray(x, dtype=float), np.asarray(y, dtype=float)], axis=1)
        length, curvature = _fitted(points, float(error))
        return cls(length, bending_stiffness, curvature, mass_per_length=mass_per_length)


def _rows(s: Any) -> Any:
    checks.vector("s", s)
    if checks.is_traced(s):
        return s
    s = np.asarray(s, dtype=float)
    if s.size < 2 or s[0] != 0 or np.any(np.diff(s) < 0) or s[-1] == s[-2] or s[1] == 0:
        checks.fail("s", "two or more arc lengths that ascend from 0", s.tolist())
    return s


def _column(name: str, value: Any, rows: Any) -> Any:
    """A number or a Table."""
    positive = name != "intrinsic_curvature"
    if np.ndim(value) == 0:
        checks.number(name, value, positive=positive)
        return value
    checks.vector(name, value)
    value = value if checks.is_traced(value) else np.asarray(value, dtype=float)
    if value.shape != rows.shape:
        checks.fail(name, f"one number per row ({rows.shape[0]})", f"{value.shape[0]} numbers")
    if positive and not checks.is_traced(value) and not (np.all(value[:-1] > 0) and value[-1] >= 0):
        checks.fail(name, "positive in all rows (zero only at the tip)", value.tolist())
    return Table(rows, value)


def _simple(value: Any) -> Any:
    """The number of a uniform section, or the value as it is."""
    parts = tuple(vars(value).values()) if isinstance(value, RoundSection | RoundMass) else (value,)
    return value(0.0) if isinstance(value, RoundSection | RoundMass) and not any(map(callable, parts)) else value


def _fitted(points: np.ndarray, error: float) -> tuple[float, Any]:
    """Length and intrinsic curvature of the smoothest shape that passes the points within their error."""
    from scipy.optimize import least_squares  # scipy is loaded with the first digitised whisker
    from scipy.special import chdtrc, chdtri

    steps = np.hypot(*np.diff(points, axis=0).T)
    chord, along = points[-1] - points[0], np.concatenate([[0.0], np.cumsum(steps)])
    scale = along[-1]
    start = np.array([0.0, np.arctan2(chord[1], chord[0])])
    places, along = (points - points[0]) / scale, along / scale
    found, least = None, np.inf
    for degree in range(-1, MOST_DEGREE + 1):
        start = start if degree < 0 else np.append(start, 0.0)
        free = places.shape[0] - start.size
        if free < 1:
            break
        # From the shape with one coefficient less, a few iterations are enough; rounding would decide further ones.
        most = FIT_STEPS * (start.size + 1)
        solved = least_squares(
            lambda p: _distances(p, places, along)[0], start, method="lm", xtol=1e-12, ftol=1e-12, max_nfev=most
        )
        start = solved.x
        off, feet = _distances(start, places, along)
        chi2 = np.sum((off * scale / error) ** 2)
        # By chance, one coefficient more explains as much as this in one of a thousand shapes.
        if found is not None and least - chi2 < chdtri(1, LEAST_CHANCE):
            break
        if found is not None or chdtrc(free, chi2) >= LEAST_CHANCE:
            found, least = _curvature(start[2:], feet[0], feet[-1], scale), chi2
    if found is not None:
        return found
    rms = scale * np.sqrt(np.mean(off**2))
    checks.fail("error", f"at least the distances of the points from a smooth shape (about {rms:.2g})", error)


def _distances(parameters: np.ndarray, places: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of points from a shape, and the arc lengths of their nearest points on it.

    The parameters are the distance of its beginning from the first point, the angle there, and the coefficients of the
    curvature.
    """
    from numpy.polynomial import Chebyshev

    aside, first, *curvature = parameters
    x, y = -aside * np.sin(first), aside * np.cos(first)
    powers = np.array(curvature) / np.arange(1, len(curvature) + 1)

    def angle(s):
        return first + s * np.polynomial.polynomial.polyval(s, powers) if powers.size else first + 0 * s

    domain = [-OUTSIDE, 1 + OUTSIDE]
    to_x, to_y = (
        Chebyshev.interpolate(lambda s, f=f: f(angle(s)), INTEGRAL_DEGREE, domain).integ(lbnd=0.0)
        for f in (np.cos, np.sin)
    )
    feet = along
    for _ in range(FEET_STEPS):
        off_x, off_y = places[:, 0] - x - to_x(feet), places[:, 1] - y - to_y(feet)
        feet = np.clip(feet + off_x * np.cos(angle(feet)) + off_y * np.sin(angle(feet)), -OUTSIDE, 1 + OUTSIDE)
    off_x, off_y = places[:, 0] - x - to_x(feet), places[:, 1] - y - to_y(feet)
    return off_y * np.cos(angle(feet)) - off_x * np.sin(angle(feet)), feet


def _curvature(powers: np.ndarray, first: float, last: float, scale: float) -> tuple[float, Any]:
    """Length, and curvature as a function of the arc length from the first point: None, a number or a Polynomial."""
    length = float((last - first) * scale)
    if powers.size < 2:
        return length, float(powers[0]) / scale if powers.size else None
    own = np.polynomial.Polynomial(powers)(np.polynomial.Polynomial([first, last - first]))
    return length, Polynomial(np.asarray(own.coef, dtype=float) / scale, length)
