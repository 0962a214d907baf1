"""The weight of whiskers in space, which bends them everywhere, also beyond their contacts.

As in the plane, the part beyond a contact is a cantilever of its own: it leaves the contact in a known direction, and
its weight is known, but the moment that it exerts there depends on how it bends. Newton's method finds this moment.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.quaternions import cross, plus, third_axis
from jaxwhisker._base.types import Scalar, Triple
from jaxwhisker._equilibrium.weight import grown, mass_between
from jaxwhisker._model.scene import Units
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.foundation import DeadDensity
from jaxwhisker._rod.rod import Along
from jaxwhisker._rod.space import SpaceLoad, SpaceSection, SpaceState
from jaxwhisker._rod.space_line import integrate_under
from jaxwhisker._space.section import space_section

STEPS = 16  # of a whole whisker that hangs


class SpaceWeight(NamedTuple):
    """The weight of a whisker in space, dimensionless; or those of all whiskers, stacked."""

    along: Float[Array, "*batch 3"]  # force per mass per length of the scene
    tip_mass: Float[Array, "*batch"]  # relative to the unit of length

    def seen_in(self, frame: Float[Array, "3 3"]) -> "SpaceWeight":
        """The same along other axes, which are the columns of a matrix."""
        return self._replace(along=jnp.sum(frame * self.along[:, None], axis=0))

    def density(self, section: SpaceSection, share: Scalar = 1.0) -> DeadDensity:
        """Force per length on the whisker."""
        return lambda s: section.mass(s) * (share * self.along)

    def total(self, section: SpaceSection, start: Scalar, length: Scalar) -> Float[Array, "3"]:
        """The weight from an arc length to the tip."""
        return (mass_between(section, start, length) + self.tip_mass) * self.along

    def beyond(
        self, start: SpaceState, s: Scalar, length: Scalar, section: SpaceSection, *, steps: int = STEPS
    ) -> SpaceLoad:
        """The load at a point of the whisker by the weight of the part beyond it, which nothing else holds.

        Args:
            start: state of the rod at this point.
            s: its arc length from the base.
            length: of the whisker.
            section: of the whisker.
            steps: of the rod from this point to the tip.
        """
        start = jax.tree.map(lambda value: jnp.asarray(value, dtype=float), start)
        part = _Overhang(self, start, jnp.asarray(s, dtype=float), jnp.asarray(length, dtype=float), section, steps)
        return part.load(1.0, solution_of(_missed, _turn_of(jax.lax.stop_gradient(part)), part))

    def line(self, start: SpaceState, load: SpaceLoad, s: Along, section: SpaceSection) -> tuple[SpaceState, SpaceLoad]:
        """States of the rod and loads on it at increasing or decreasing arc lengths, from given ones at the first.

        Nothing but its weight acts on this part.
        """
        density = self.density(section)

        def onwards(carry, stop):
            state, load, at = carry
            state, load = integrate_under(state, load, at - stop, section, density, steps=1, from_base=at)
            return (state, load, stop), (state, load)

        start, load, s = jax.tree.map(lambda value: jnp.asarray(value, dtype=float), (start, load, s))
        _, rest = jax.lax.scan(onwards, (start, load, s[0]), s[1:])
        return jax.tree.map(lambda first, others: jnp.append(first, others), (start, load), rest)


class _Overhang(eqx.Module):
    """A part of a whisker that nothing but the rest of the whisker holds."""

    weight: SpaceWeight
    start: SpaceState
    s: Scalar
    length: Scalar
    section: SpaceSection
    steps: int = eqx.field(static=True)

    def load(self, share: Scalar, turn: Float[Array, "3"]) -> SpaceLoad:
        """The load at the start, by a share of the weight, with this moment there."""
        x, y, z = share * self.weight.total(self.section, self.s, self.length)
        return SpaceLoad((x, y, z), plus((turn[0], turn[1], turn[2]), cross(self.start[0], (x, y, z))))

    def missed(self, share: Scalar, turn: Float[Array, "3"]) -> Float[Array, "3"]:
        """The moment that would have to act at the tip."""
        density, rest = self.weight.density(self.section, share), self.s - self.length
        load = self.load(share, turn)
        (r, _), carried = integrate_under(
            self.start, load, rest, self.section, density, steps=self.steps, from_base=self.s
        )
        return jnp.stack(carried.moment_at(r))


def _missed(turn: Float[Array, "3"], part: _Overhang) -> Float[Array, "3"]:
    return part.missed(1.0, turn)


def newton_step(missed: Callable[[Float[Array, "3"]], Float[Array, "3"]], at: Float[Array, "3"]) -> Float[Array, "3"]:
    """The step of Newton's method for three equations."""
    value, slopes = jax.vmap(lambda way: jax.jvp(missed, (at,), (way,)), out_axes=(None, 1))(jnp.eye(3))
    return -solve(slopes, value[:, None])[:, 0]


def _turn_of(part: _Overhang) -> Float[Array, "3"]:
    """The moment at the start of a part that hangs, without derivatives."""

    # As if the part were straight, with its line's weight in its middle.
    weight, rest = part.weight, part.length - part.s
    line = mass_between(part.section, part.s, part.length)
    lever = rest * jnp.cross(jnp.stack(third_axis(part.start[1])), (line / 2 + weight.tip_mass) * weight.along)
    return grown(lambda share, turn: newton_step(lambda turn: part.missed(share, turn), turn), lever)


def weights_in_space(whiskers: tuple[Whisker, ...], gravity: Triple | None, unit: Units) -> SpaceWeight | None:
    """Dimensionless weights of all whiskers; None without gravity."""
    if gravity is None:
        return None
    along = jnp.stack([jnp.asarray(part, dtype=float) for part in gravity]) * unit.length / unit.force
    tips = [jnp.asarray(0.0 if one.tip_mass is None else one.tip_mass, dtype=float) for one in whiskers]
    return SpaceWeight(jnp.broadcast_to(along, (len(whiskers), 3)), jnp.stack(tips) / unit.length)


def weight_of_one(whisker: Whisker, gravity: Triple) -> SpaceWeight:
    """The weight of one whisker in the scene's units."""
    weights = weights_in_space((whisker,), gravity, Units(*[jnp.ones(()) for _ in Units._fields]))
    assert weights is not None
    return jax.tree.map(lambda leaf: leaf[0], weights)


def total_weights(whiskers: tuple[Whisker, ...], gravity: Triple) -> Float[Array, "whiskers 3"]:
    """Weights of all whiskers in the scene's units."""

    def one(whisker: Whisker) -> Float[Array, "3"]:
        section = space_section(whisker, 1.0, 1.0, heavy=True)
        return weight_of_one(whisker, gravity).total(section, jnp.zeros(()), jnp.asarray(whisker.length, dtype=float))

    return jnp.stack([*map(one, whiskers)])
