"""The weight of a whisker, which bends it everywhere, also beyond the contact.

The part beyond a contact is a cantilever of its own: it leaves the contact in a known direction, and its weight is
known, but the moment that it exerts there depends on how it bends. This moment is found by Newton's method.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.quadrature import gauss
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.scene import Units
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.foundation import DeadDensity, Density, integrate_on
from jaxwhisker._rod.rod import Along, Load, RodState, RodStates, Section, moment
from jaxwhisker._rod.walk import pressed

if TYPE_CHECKING:
    from jaxwhisker._rod.space import SpaceSection  # which the plane does not load

Gravity = tuple[Scalar, Scalar]  # acceleration along x and y

POINTS, WEIGHTS = gauss(8)  # on each piece of a whisker between breaks; exact for round cones
ACCURACY = 1e-9  # of the last step for the moment, dimensionless; convergence is quadratic
NEWTON_STEPS = 6  # with one share of the weight; three suffice for all of it unless the whisker hangs far over
MOST_STEPS = 120  # in all


def _on_rod(dead: DeadDensity) -> Density:
    return lambda x, y, s: (dead(s)[0], dead(s)[1])


Moment = Float[Array, "*axes"]  # a number in the plane, three in space


class _Growing(NamedTuple):
    """A moment that is solved for with growing shares of the weight."""

    share: Scalar  # for which it is known
    turn: Moment  # the moment with this share
    aim: Scalar  # the next share
    guess: Moment  # the moment with that
    steps: Array  # of Newton's method, with that share
    total: Array  # of them, with all shares

    def aimed(self, share: Scalar, turn: Moment, aim: Scalar, guess: Moment) -> "_Growing":
        return _Growing(share, turn, aim, guess, jnp.zeros_like(self.steps), self.total)


def grown(newton_step: Callable[[Scalar, Moment], Moment], lever: Moment) -> Moment:
    """The moment with which nothing is missed; first with the whole weight, and if need be with shares that grow.

    Args:
        newton_step: the step of Newton's method from a moment with a share of the weight.
        lever: a guess with the whole weight.
    """

    def newton(at: _Growing) -> _Growing:
        step = newton_step(at.aim, at.guess)
        size = jnp.max(jnp.abs(step))
        at = at._replace(guess=at.guess + step, steps=at.steps + 1, total=at.total + 1)
        ahead = jnp.minimum(3 * at.aim - 2 * at.share, 1.0)  # twice as far
        further = at.aimed(at.aim, at.guess, ahead, at.guess * ahead / at.aim)
        half = (at.share + at.aim) / 2
        known = jnp.where(at.share > 0, at.turn / jnp.where(at.share > 0, at.share, 1.0), lever)
        back = at.aimed(at.share, at.turn, half, known * half)
        tried = (at.steps >= NEWTON_STEPS) | ~jnp.isfinite(size)
        return jax.tree.map(
            lambda further, back, at: jnp.where(size < ACCURACY, further, jnp.where(tried, back, at)), further, back, at
        )

    def searching(at: _Growing) -> Array:
        return (at.share < 1) & (at.total < MOST_STEPS)

    start = _Growing(jnp.zeros(()), jnp.zeros_like(lever), jnp.ones(()), lever, jnp.asarray(0), jnp.asarray(0))
    found = jax.lax.while_loop(searching, newton, start)
    return jnp.where(found.share < 1, jnp.nan, found.turn)


def mass_between(section: "Section | SpaceSection", start: Scalar, stop: Scalar) -> Float[Array, ""]:
    """Mass between two arc lengths from the base, without that at the tip, relative to the unit of length."""
    ends = jnp.stack([start, stop])
    if section.breaks is not None:
        breaks = jnp.clip(section.breaks / section.length_unit, start, stop)
        ends = jnp.sort(jnp.concatenate([ends, breaks]))
    s = ends[:-1, None] + jnp.diff(ends)[:, None] * POINTS
    return jnp.sum(jnp.diff(ends)[:, None] * WEIGHTS * jax.vmap(jax.vmap(section.mass))(s))


class Weight(NamedTuple):
    """The weight of a whisker, dimensionless; or those of all whiskers, stacked."""

    x: Float[Array, "*batch"]  # force per mass per length of the scene
    y: Float[Array, "*batch"]
    tip_mass: Float[Array, "*batch"]  # relative to the unit of length

    def weakened(self, share: Scalar) -> "Weight":
        """The same with this share of the gravity."""
        return self._replace(x=share * self.x, y=share * self.y)

    def density(self, section: Section) -> DeadDensity:
        """Force per length on the whisker."""
        along = jnp.stack([self.x, self.y, jnp.zeros_like(self.x)])
        return lambda s: section.mass(s) * along

    def between(self, section: Section, start: Scalar, stop: Scalar) -> tuple[Scalar, Scalar]:
        """Force of the weight between two arc lengths from the base, without that of the mass at the tip."""
        mass = mass_between(section, start, stop)
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
        tip_x, tip_y = self.tip_mass * self.x, self.tip_mass * self.y
        (x, y, cos, sin), rest = start, length - s

        def load(share: Scalar, about_start: Scalar) -> Load:
            return pressed((x, y), share * (line_x + tip_x), share * (line_y + tip_y), about_start)

        def missed(share: Scalar, about_start: Scalar) -> Scalar:
            """The moment that would have to act at the tip, with a share of the weight."""
            pushed = _on_rod(self.weakened(share).density(section))
            end, carried = integrate_on(
                start, load(share, about_start), -rest, section, pushed, steps=steps, from_base=s
            )
            return jnp.asarray(moment(end[0], end[1], carried))

        def newton_step(share: Scalar, turn: Moment) -> Moment:
            value, slope = jax.jvp(lambda turn: missed(share, turn), (turn,), (jnp.ones_like(turn),))
            return -value / slope

        # As if the part beyond were straight, with its line's weight in its middle.
        lever = rest * ((line_y / 2 + tip_y) * cos - (line_x / 2 + tip_x) * sin)
        one = jnp.ones_like(lever)
        turn = jax.lax.custom_root(
            lambda turn: missed(one, turn),
            jax.lax.stop_gradient(lever),
            lambda _, lever: grown(newton_step, lever),
            lambda slope, value: value / slope(one),
        )
        return load(one, turn)

    def line(self, start: RodState, load: Load, s: Along, section: Section) -> tuple[RodStates, Load]:
        """States of the rod and loads on it at arc lengths that increase from that of `start`, where the load is this.

        Nothing but its weight acts on this part.
        """
        density = _on_rod(self.density(section))

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
