"""Functions of the arc length along a whisker, with differentiable parameters."""

from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.leaves import number_or_function
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import AlongRod

AlongWhisker: TypeAlias = AlongRod  # a number, or a function of the arc length from the base
Breaks: TypeAlias = Float[Array, " breaks"] | Float[np.ndarray, " breaks"]


class Table(eqx.Module):
    """Linear interpolation of a table; two rows with the same arc length are a jump.

    Args:
        s: arc lengths from the base, ascending; at least two.
        values: one value per arc length.
    """

    s: Float[Array, " rows"]
    values: Float[Array, " rows"]

    def __call__(self, s: Scalar) -> Float[Array, ""]:
        at, values = jnp.asarray(self.s, dtype=float), jnp.asarray(self.values, dtype=float)
        k = jnp.clip(jnp.sum(s > at), 1, at.size - 1)
        size = at[k] - at[k - 1]
        share = (s - at[k - 1]) / jnp.where(size > 0, size, 1.0)
        return values[k - 1] + share * (values[k] - values[k - 1])


class Polynomial(eqx.Module):
    """A polynomial of s / length, by its coefficients in ascending order."""

    coefficients: Float[Array, " degrees"]
    length: Scalar

    def __call__(self, s: Scalar) -> Float[Array, ""]:
        return jnp.polyval(jnp.asarray(self.coefficients, dtype=float)[::-1], s / self.length)


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


class RoundMass(eqx.Module):
    """Mass per length of a circular cross-section, rho pi d^2 / 4; rho and d may be functions of the arc length."""

    density: AlongWhisker = eqx.field(converter=number_or_function("density"))
    diameter: AlongWhisker = eqx.field(converter=number_or_function("diameter"))

    def __call__(self, s: Scalar) -> Scalar:
        density, diameter = (value(s) if callable(value) else value for value in (self.density, self.diameter))
        return density * (np.pi / 4) * diameter**2
