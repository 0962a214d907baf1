"""The weight of a whisker, which bends it everywhere, also beyond the contact.

The part beyond a contact is a cantilever of its own: it leaves the contact in a known direction, and its weight is
known, but the moment that it exerts there depends on how it bends. This moment is found by Newton's method.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.scene import Units
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.foundation import Density, integrate_on
from jaxwhisker._rod.rod import Along, Load, RodState, RodStates, Section, moment
from jaxwhisker._rod.walk import pressed

Gravity = tuple[Scalar, Scalar]  # acceleration along x and y

POINTS, WEIGHTS = gauss(8)  # on each piece of a whisker between breaks; exact for round cones
NEWTON_STEPS = 12  # at most; three suffice unless the whisker hangs far over
ACCURACY = 1e-9  # of the last step for the moment, dimensionless; convergence is quadratic
NO_LOAD = pressed((0.0, 0.0), 0.0, 0.0)


class Weight(NamedTuple):
    """The weight of a whisker, dimensionless; or those of all whiskers, stacked."""

    x: Float[Array, "*batch"]  # force per mass per length of the scene
    y: Float[Array, "*batch"]
    tip_mass: Float[Array, "*batch"]  # relative to the unit of length

    def weakened(self, share: Scalar) -> "Weight":
        """The same with this share of the gravity."""
        return self._replace(x=share * self.x, y=share * self.y)

    def density(self, section: Section) -> Density:
        """Force per length on the whisker."""

        def density(x: Scalar, y: Scalar, s: Scalar) -> tuple[Scalar, Scalar]:
            del x, y
            mass = section.mass(s)
            return mass * self.x, mass * self.y

        return density

    def at_tip(self, tip: RodState) -> Load:
        """The load of the mass at the tip."""
        return pressed(tip[:2], self.tip_mass * self.x, self.tip_mass * self.y)

    def between(self, section: Section, start: Scalar, stop: Scalar) -> tuple[Scalar, Scalar]:
        """Weight of the whisker without its tip mass between two arc lengths from the base."""
        ends = jnp.stack([start, stop])
        if section.breaks is not None:
            breaks = jnp.clip(section.breaks / section.length_unit, start, stop)
            ends = jnp.sort(jnp.concatenate([ends, breaks]))
        s = ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS
        mass = jnp.sum(jnp.diff(ends)[:, None] * WEIGHTS * jax.vmap(jax.vmap(section.mass))(s))
        return mass * self.x, mass * self.y

    def beyond(self, start: RodState, s: Scalar, length: Scalar, section: Section, *, steps: int) -> Load:
        """The load at a point of the whisker by the weight of the part beyond it, which nothing else holds.

        Args:
            start: state of the rod at this point.
            s: its arc length from the base.
            length: of the whisker.
            section: of the whisker.
            steps: of the rod from this point to the tip.
        """
        start = jax.tree.map(lambda value: jnp.asarray(value, dtype=float), start)
        line_x, line_y = self.between(section, s, length)
        force_x, force_y = line_x + self.tip_mass * self.x, line_y + self.tip_mass * self.y
        x, y, cos, sin = start
        length_beyond = length - s

        def load(about_start: Scalar) -> Load:
            return pressed((x, y), force_x, force_y, about_start)

        def missed(about_start: Scalar) -> Scalar:
            """The moment that would have to act at the tip."""
            end, carried = integrate_on(
                start, load(about_start), -length_beyond, section, self.density(section), steps=steps, from_base=s
            )
            return jnp.asarray(moment(end[0], end[1], carried))

        def solve(missed, guess):
            def newton(carry):
                turn, _, count = carry
                value, slope = jax.jvp(missed, (turn,), (jnp.ones_like(turn),))
                return turn - value / slope, jnp.abs(value / slope), count + 1

            def searching(carry):
                return (carry[1] > ACCURACY) & (carry[2] < NEWTON_STEPS)

            turn, size, _ = jax.lax.while_loop(searching, newton, (guess, jnp.full_like(guess, jnp.inf), 0))
            return jnp.where(size > ACCURACY, jnp.nan, turn)

        # As if the part beyond were straight, with its line's weight in its middle.
        lever = length_beyond * (line_y * cos - line_x * sin) / 2
        lever += length_beyond * self.tip_mass * (self.y * cos - self.x * sin)
        turn = jax.lax.custom_root(missed, jax.lax.stop_gradient(lever), solve, lambda slope, value: value / slope(1.0))
        return load(turn)

    def line(self, start: RodState, load: Load, s: Along, section: Section) -> tuple[RodStates, Load]:
        """States of the rod and loads on it at arc lengths that increase from that of `start`, where the load is this.

        Nothing but its weight acts on this part.
        """
        density = self.density(section)

        def onwards(carry, stop):
            state, load, at = carry
            state, load = integrate_on(state, load, at - stop, section, density, steps=1, from_base=at)
            return (state, load, stop), (state, load)

        start, load, s = jax.tree.map(lambda value: jnp.asarray(value, dtype=float), (start, load, s))
        _, rest = jax.lax.scan(onwards, (start, load, s[0]), s[1:])
        return jax.tree.map(lambda first, others: jnp.append(first, others), (start, load), rest)


def weights_of(whiskers: tuple[Whisker, ...], gravity: Gravity | None, unit: Units) -> Weight | None:
    """Dimensionless weights of all whiskers; None without gravity."""
    if gravity is None:
        return None
    x, y = (jnp.full(len(whiskers), part) * unit.length / unit.force for part in gravity)
    tips = [jnp.asarray(0.0 if one.tip_mass is None else one.tip_mass, dtype=float) for one in whiskers]
    return Weight(x, y, jnp.stack(tips) / unit.length)


def valid_gravity(gravity: Gravity | None) -> Bool[Array, ""]:
    """Whether a traced gravity is finite."""
    return jnp.asarray(True) if gravity is None else jnp.all(jnp.isfinite(jnp.stack([*map(jnp.asarray, gravity)])))
