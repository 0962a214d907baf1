"""Functions of the arc length along a whisker, with differentiable parameters."""

from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import number_or_function
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import AlongRod

AlongWhisker: TypeAlias = AlongRod  # a number, or a function of the arc length from the base
Breaks: TypeAlias = Float[Array, " breaks"] | Float[np.ndarray, " breaks"]
CHECKED_POINTS = 65  # points at which a function of arc length is checked
SLENDER = 5  # least ratio of length and diameter; real whiskers and wires have 50 and more
HALLEY_STEPS = 3  # for the arc length of a parabola: exact to rounding for slopes up to 3


class Table(eqx.Module):
    """Linear interpolation of values along a whisker, for the arguments that may be functions of arc length.

    A whisker needs the rows as its `breaks`; `Whisker.from_table` passes them. Beyond the ends, the first and the last
    line continue. Differentiable with respect to all numbers.

    Args:
        s: arc lengths from the base, shape (rows,), ascending; at least two. Two rows with the same arc length are a
            jump.
        values: one value per row, shape (rows,).

    Raises:
        ValueError: if an argument is not such an array.

    Examples:
        >>> diameter = jw.Table([0.0, 0.01, 0.02], [2e-4, 1.5e-4, 5e-5])
        >>> print(f"{diameter(0.015):.1e}")
        1.0e-04
    """

    s: Float[Array, " rows"] = eqx.field(converter=lambda values: as_vector("s", values))
    values: Float[Array, " rows"] = eqx.field(converter=lambda values: as_vector("values", values))

    def __check_init__(self):
        if self.s.shape != self.values.shape or self.s.shape[0] < 2:
            checks.fail("values", f"two or more numbers, one per row ({self.s.shape[0]})", f"{self.values.shape[0]}")
        if not checks.is_traced(self.s) and np.any(np.diff(np.asarray(self.s)) < 0):
            checks.fail("s", "in ascending order", np.asarray(self.s).tolist())

    def __call__(self, s: Scalar) -> Float[Array, ""]:
        k = jnp.clip(jnp.sum(s > self.s), 1, self.s.shape[0] - 1)
        (first, last), (start, stop) = (
            (values[k - 1], values[k]) for values in map(jnp.asarray, (self.s, self.values))
        )
        size = last - first
        return start + (stop - start) * ((s - first) / jnp.where(size > 0, size, 1.0))


class Polynomial(eqx.Module):
    """A polynomial of s / length, for the arguments that may be functions of arc length.

    Args:
        coefficients: shape (degree + 1,), in ascending order: the first one is the value at the base.
        length: a length; positive. With that of the whisker, the sum of the coefficients is the value at the tip.

    Raises:
        ValueError: if an argument is not a number or such an array.

    Examples:
        >>> spiral = jw.Whisker(0.04, 2.4e-8, jw.Polynomial([10.0, 12.0], length=0.04))
        >>> print(f"{spiral.curvature_at(0.04):.1f}")
        22.0
    """

    coefficients: Float[Array, " degrees"] = eqx.field(converter=lambda values: as_vector("coefficients", values))
    length: Scalar

    def __check_init__(self):
        checks.number("length", self.length, positive=True)

    def __call__(self, s: Scalar) -> Float[Array, ""]:
        return jnp.polyval(jnp.asarray(self.coefficients)[::-1], s / self.length)


class ParabolicShape(eqx.Module):
    """Intrinsic curvature of a whisker whose unloaded shape is the parabola y = A x^2.

    x runs along the root of the whisker, with its base at 0; y is to the left of it, towards -x of an upright whisker.
    The curvature is exact to rounding where the parabola has turned by less than 70 degrees.

    Args:
        coefficient: A, 1/length; negative to the other side.

    Raises:
        ValueError: if the coefficient is not a finite number.

    Examples:
        >>> whisker = jw.Whisker.rat("C", 2, parabola=12.0)  # 1/m
        >>> print(f"{whisker.curvature_at(0.0):.1f}, {whisker.curvature_at(0.03):.1f}")  # 2 A at the base
        24.0, 13.7
    """

    coefficient: Scalar

    def __check_init__(self):
        checks.number("coefficient", self.coefficient)

    def __call__(self, s: Scalar) -> Scalar:
        # With the slope 2 A x = sinh(w / 2), the arc length s satisfies sinh(w) + w = 8 A s.
        arc = 8 * jnp.asarray(self.coefficient, dtype=float) * s
        w = 4 * jnp.sinh(jnp.arcsinh(3 / 8 * arc) / 3)  # solves the equation to third order
        for _ in range(HALLEY_STEPS):
            power = jnp.exp(w)  # exponential functions take most of the time of rods with this shape: one for each step
            sinh, slope = (power - 1 / power) / 2, (power + 1 / power) / 2 + 1
            missed = sinh + w - arc
            change = -2 * missed * slope / (2 * slope**2 - missed * sinh)
            w, power = w + change, power * (1 + change * (1 + change / 2 * (1 + change / 3)))
        square = (power + 1 / power + 2) / 4  # of cosh(w / 2)
        return 2 * self.coefficient / (square * jnp.sqrt(square))


def as_breaks(value: Any) -> Breaks | None:
    """Breaks as one array; None without any."""
    return None if value is None or (isinstance(value, tuple | list) and not value) else as_vector("breaks", value)


def as_vector(name: str, value: Any) -> Any:
    """A vector of floats, which is a NumPy array unless it is traced."""
    if isinstance(value, tuple | list) and checks.is_traced(value):
        value = jnp.stack([jnp.asarray(part, dtype=float) for part in value])
    checks.vector(name, value)
    return value if checks.is_traced(value) else np.asarray(value, dtype=float)


class LinearTaper(eqx.Module):
    """A linear function of the arc length: `base` at 0 and `tip` at `length`."""

    base: Scalar
    tip: Scalar
    length: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.base + (self.tip - self.base) * (s / self.length)


class PowerTaper(eqx.Module):
    """Bending stiffness of a cone: its diameter falls linearly from the base by a share `taper` at the tip."""

    base_stiffness: Scalar
    taper: Scalar
    length: Scalar

    def __call__(self, s: Scalar) -> Scalar:
        return self.base_stiffness * (1 - self.taper * (s / self.length)) ** 4


class RoundSection(eqx.Module):
    """Bending stiffness of a circular cross-section, E pi d^4 / 64; E and d may be functions of the arc length."""

    youngs_modulus: AlongWhisker = eqx.field(converter=number_or_function("youngs_modulus"))
    diameter: AlongWhisker = eqx.field(converter=number_or_function("diameter"))

    @property
    def tapers(self) -> bool:
        """Whether the diameter is known to decrease linearly, and the modulus is a number."""
        taper = self.diameter
        if callable(self.youngs_modulus) or not isinstance(taper, LinearTaper):
            return False
        return not checks.is_traced((taper.base, taper.tip)) and float(taper.tip) <= float(taper.base)

    def __call__(self, s: Scalar) -> Scalar:
        modulus, diameter = (value(s) if callable(value) else value for value in (self.youngs_modulus, self.diameter))
        return modulus * (np.pi / 64) * diameter**4


class RoundMass(eqx.Module):
    """Mass per length of a circular cross-section, rho pi d^2 / 4; rho and d may be functions of the arc length."""

    density: AlongWhisker = eqx.field(converter=number_or_function("density"))
    diameter: AlongWhisker = eqx.field(converter=number_or_function("diameter"))

    def __call__(self, s: Scalar) -> Scalar:
        density, diameter = (value(s) if callable(value) else value for value in (self.density, self.diameter))
        return density * (np.pi / 4) * diameter**2


def _largest(value: Callable[[Scalar], Scalar], length: Scalar) -> Float[Array, ""]:
    return jnp.max(jax.vmap(value)(jnp.linspace(0.0, 1.0, CHECKED_POINTS) * length))


_largest_now = Program(_largest)


def check_slender(name: str, diameter: AlongWhisker, length: Scalar) -> None:
    """Check that a concrete diameter is that of a slender rod, and not in another unit than the length."""
    if checks.is_traced((diameter, length)):
        return
    with jax.ensure_compile_time_eval():
        given = jax.tree.map(checks.as_float, (diameter, length))
        thickest = float(_largest_now(*given) if callable(diameter) else diameter)
    if thickest > float(length) / SLENDER:
        allowed = f"at most 1/{SLENDER} of the length {float(length):g}, in the same unit: rods are slender"
        raise ValueError(f"`{name}` must be {allowed}; got {thickest:g}.")
