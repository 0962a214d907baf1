"""Functions of whiskers and springs that tests share: modules with fields, as a lambda is a new shape every time."""

import equinox as eqx
import jax
import jax.numpy as jnp


class Step(eqx.Module):
    """One value below a break, another one above."""

    at: jax.Array | float
    below: jax.Array | float
    above: jax.Array | float

    def __call__(self, s):
        return jnp.where(s < self.at, self.below, self.above)


class Linear(eqx.Module):
    """A linear function of arc length."""

    start: float
    growth: float

    def __call__(self, s):
        return self.start + self.growth * s


class Stiffening(eqx.Module):
    """The tension of a spring that becomes stiffer as it is stretched."""

    linear: float
    cubic: float

    def __call__(self, extension):
        return self.linear * extension + self.cubic * extension**3
