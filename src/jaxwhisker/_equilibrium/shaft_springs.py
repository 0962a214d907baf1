"""Springs and tissue on the shaft of one whisker.

The rod is integrated from the contact, or from the tip of a free whisker, towards the base. Position and direction are
known when the integration gets to a spring, and so is the force of the spring. The load on the rod changes there, but
it stays an affine function of position. Below the base, the whisker continues as a rigid follicle. The loads of springs
to other whiskers are given (see couplings.py).
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple, TypeAlias

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.weight import Weight
from jaxwhisker._model.motion import Frame
from jaxwhisker._model.spring import AXES
from jaxwhisker._rod.elastica import Shooting
from jaxwhisker._rod.foundation import DeadDensity, Density, integrate_on
from jaxwhisker._rod.rod import Load, Material, RodState, Section, integrate
from jaxwhisker._rod.walk import Walk, in_order, pressed
from jaxwhisker._rod.walk import walk as walk_past

AXIAL = len(AXES)  # in addition to the indices into AXES
SHORTEST = 1e-10  # length of an axial spring whose ends meet: it needs a direction

Laws: TypeAlias = tuple[Callable[[Any], Any], ...]  # tension by extension; number 0 is the linear law


class ShaftSprings(NamedTuple):
    """Springs on the shaft of a whisker, from the tip to the base; or those of all whiskers, stacked.

    The last place is at the base or below it.
    """

    at: Float[Array, "*batch springs"]  # arc length from the base; negative below it
    anchor_x: Float[Array, "*batch springs"]  # end on the drive, in the drive's frame
    anchor_y: Float[Array, "*batch springs"]
    anchor_angle: Float[Array, "*batch springs"]
    stiffness: Float[Array, "*batch springs"]
    rest_length: Float[Array, "*batch springs"]
    axis: Int[Array, "*batch springs"]  # index into AXES, or AXIAL
    one_sided: Float[Array, "*batch springs"]  # +1 pulls only, -1 pushes only, 0 both
    law: Int[Array, "*batch springs"]
    share: Float[Array, "*batch springs"]  # of the tension that acts: 1; 0 for places without a spring

    @property
    def above(self) -> "ShaftSprings":
        """The springs above the base; those at the base and below have no share."""
        return self._replace(share=jnp.where(self.at > 0, self.share, 0.0))

    @property
    def below(self) -> "ShaftSprings":
        """The springs at the base and below; those above the base have no share."""
        return self._replace(share=jnp.where(self.at > 0, 0.0, self.share))


class Tissue(NamedTuple):
    """The foundation of a whisker; the unloaded whisker is a straight line in the drive's frame."""

    start: Float[Array, "*batch"]  # arc lengths from the base
    stop: Float[Array, "*batch"]
    stiffness: Float[Array, "*batch"]  # 0 without a foundation
    rest_length: Float[Array, "*batch"]
    x: Float[Array, "*batch"]  # base of the line
    y: Float[Array, "*batch"]
    cos: Float[Array, "*batch"]  # direction across the line
    sin: Float[Array, "*batch"]

    def share(self, s: Scalar) -> Float[Array, ""]:
        """1 on the foundation, 0 elsewhere."""
        return jnp.where((s > self.start) & (s < self.stop), 1.0, 0.0)

    def strain(self, drive: Frame, x: Scalar, y: Scalar, s: Scalar) -> Scalar:
        """Displacement of a point of the rod across the unloaded whisker, beyond the rest length."""
        right, up = x - drive.x, y - drive.y
        across = right * drive.cos + up * drive.sin - self.x + s * self.sin
        along = up * drive.cos - right * drive.sin - self.y - s * self.cos
        return across * self.cos + along * self.sin - self.rest_length

    def density(self, drive: Frame, x: Scalar, y: Scalar, s: Scalar) -> tuple[Scalar, Scalar]:
        """Force on the rod per length, along x and y of the scene."""
        push = -self.stiffness * self.strain(drive, x, y, s)
        across, along = push * self.cos, push * self.sin
        return across * drive.cos - along * drive.sin, across * drive.sin + along * drive.cos

    def energy(self, drive: Frame, x: Scalar, y: Scalar, s: Scalar) -> Scalar:
        """Stored energy per length."""
        return self.share(s) * self.stiffness * self.strain(drive, x, y, s) ** 2 / 2


class Attachments(NamedTuple):
    """What holds the shaft of a whisker. There is a place among the springs at both ends of the foundation."""

    springs: ShaftSprings
    tissue: Tissue | None = None  # None without any foundation
    # Force along x and y and moment on the shaft at each place, in the drive's frame, of springs to other whiskers;
    # None without such springs.
    given: Float[Array, "*batch springs 3"] | None = None
    weight: Weight | None = None  # None without gravity

    def with_places(self, at: Float[Array, " places"]) -> tuple["Attachments", Int[Array, " places"]]:
        """The same with further places without a spring, and the indices of these places."""
        order = in_order(self.springs.at, at)
        springs, given = order.spread(0, (self.springs, self.given))
        return self._replace(springs=springs._replace(at=order.at), given=given), order.ranks[1]

    @property
    def above(self) -> "Attachments":
        """The same without the springs at the base and below: the reaction at the base is that of all of these."""
        given, at = self.given, self.springs.at
        given = None if given is None else jnp.where(at[..., None] > 0, given, 0.0)
        return self._replace(springs=self.springs.above, given=given)

    @property
    def top(self) -> Float[Array, "*batch"]:
        """Arc length from the base to the uppermost spring."""
        return jnp.max(self.springs.at, axis=-1)

    def weakened(self, share: Scalar, heavy: Scalar = 1.0) -> "Attachments":
        """The same with a share of the forces of springs and tissue, and one of the weight."""
        springs = self.springs._replace(share=share * self.springs.share)
        tissue, weight = self.tissue, self.weight
        tissue = None if tissue is None else tissue._replace(stiffness=share * tissue.stiffness)
        return self._replace(springs=springs, tissue=tissue, weight=None if weight is None else weight.weakened(heavy))


def tension_of(spring: ShaftSprings, laws: Laws, length: Scalar) -> Scalar:
    """Tension of a spring of this length."""
    extension = length - spring.rest_length
    each = [lambda: spring.stiffness * extension, *(lambda law=law: jnp.asarray(law(extension)) for law in laws)]
    pull = jax.lax.switch(spring.law, each) if laws else each[0]()
    sign = spring.one_sided
    return spring.share * jnp.where(sign == 0, pull, sign * jnp.maximum(sign * pull, 0.0))


def end_of(spring: ShaftSprings, state: RodState) -> tuple[Scalar, Scalar]:
    """The spring's end on the whisker; at or below the base, for the state of the base."""
    x, y, cos, sin = state
    below = jnp.minimum(spring.at, 0.0)
    return x + below * cos, y + below * sin


def stretched(spring: ShaftSprings, state: RodState, drive: Frame) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Length of a spring, and its derivatives by position (x, y) of its end and by the angle of the whisker there."""
    end = in_drive(spring, state, drive) - anchor_of(spring)
    length, (by_across, by_along, by_turn) = length_of(spring, end, end)
    return length, by_across * drive.cos - by_along * drive.sin, by_across * drive.sin + by_along * drive.cos, by_turn


def in_drive(spring: ShaftSprings, state: RodState, drive: Frame) -> Float[Array, "3"]:
    """Position of a spring's end on the whisker and angle of the whisker there, in the drive's frame."""
    x, y = end_of(spring, state)
    right, up, (_, _, cos, sin) = x - drive.x, y - drive.y, state
    across, along = right * drive.cos + up * drive.sin, up * drive.cos - right * drive.sin
    turn = jnp.arctan2(-cos * drive.cos - sin * drive.sin, sin * drive.cos - cos * drive.sin)
    return jnp.stack([across, along, turn])


def anchor_of(spring: ShaftSprings) -> Float[Array, "3"]:
    """Position and angle from which the position and angle of a spring's end are measured, in the drive's frame."""
    return jnp.stack([spring.anchor_x, spring.anchor_y, spring.anchor_angle])


def length_of(
    spring: ShaftSprings, moved: Float[Array, "3"], apart: Float[Array, "3"]
) -> tuple[Scalar, tuple[Scalar, Scalar, Scalar]]:
    """Length of a spring, and its derivatives by the position and angle of its end.

    Args:
        spring: the spring.
        moved: position and angle of its end relative to those of its other end, as springs along an axis measure them.
        apart: position of its end minus that of its other end.
    """
    distance = jnp.sqrt(apart[0] ** 2 + apart[1] ** 2 + SHORTEST**2)
    on = [spring.axis == k for k in range(AXIAL + 1)]
    by_across = jnp.where(on[AXIAL], apart[0] / distance, on[0])
    by_along = jnp.where(on[AXIAL], apart[1] / distance, on[1])
    return jnp.select(on, [*moved, distance]), (by_across, by_along, jnp.where(on[2], 1.0, 0.0))


def past(
    load: Load,
    spring: ShaftSprings,
    laws: Laws,
    state: RodState,
    drive: Frame,
    sign: float,
    given: Float[Array, "3"] | None = None,
) -> Load:
    """The load on the rod behind a spring, on the way to the base (sign = 1) or away from it (-1)."""
    length, by_x, by_y, by_turn = stretched(spring, state, drive)
    pull = sign * tension_of(spring, laws, length)
    force_x, force_y, turn = -pull * by_x, -pull * by_y, -pull * by_turn
    if given is not None:
        across, along, moment = sign * given
        force_x, force_y = (
            force_x + across * drive.cos - along * drive.sin,
            force_y + across * drive.sin + along * drive.cos,
        )
        turn += moment
    return jax.tree.map(jnp.add, load, pressed(end_of(spring, state), force_x, force_y, turn))


def to_next(
    state: RodState,
    load: Load,
    s: Scalar,
    stop: Scalar,
    material: Material,
    tissue: Tissue | None,
    drive: Frame | None,
    *,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    given: DeadDensity | None = None,
) -> tuple[RodState, Load]:
    """State of the rod and the load on it at arc length `stop`, from those at `s`; no spring is between them.

    The piece of the rod lies on the foundation, or nothing of it does. `given` is a further dead load on it.
    """
    if tissue is None and given is None:
        return integrate(state, s - stop, load, material, steps=steps, solver=solver, from_base=s), load
    acting: list[Density] = []
    if given is not None:
        acting.append(lambda x, y, along: (given(along)[0], given(along)[1]))
    if tissue is not None and drive is not None:
        on = tissue._replace(stiffness=tissue.share((s + stop) / 2) * tissue.stiffness)
        acting.append(partial(on.density, drive))

    def density(x: Scalar, y: Scalar, along: Scalar):
        each_x, each_y = zip(*(one(x, y, along) for one in acting), strict=True)
        return reduce(jnp.add, each_x), reduce(jnp.add, each_y)

    return integrate_on(state, load, s - stop, material, density, steps=steps, from_base=s)


def walk(
    start: RodState,
    load: Load,
    s: Scalar,
    material: Material,
    held: Attachments,
    laws: Laws,
    drive: Frame,
    *,
    steps: int,
    solver: diffrax.AbstractSolver | None = None,
    sign: float = 1.0,
) -> Walk:
    """Follow a rod past all springs.

    Args:
        start: state of the rod where the walk begins, in the scene.
        load: on the rod there.
        s: arc length from the base to that point.
        material: of the rod.
        held: what holds this whisker, with springs in the order in which they are passed.
        laws: of all springs that are not linear.
        drive: frame of the drive.
        steps: number of integration steps from one spring to the next.
        solver: any diffrax solver, for rods without a foundation. Default: see `rod.integrate`.
        sign: 1 on the way to the base, -1 away from it.
    """

    given = None
    if held.weight is not None:
        assert isinstance(material, Section)
        given = held.weight.density(material)

    def onwards(state, load, s, stop):
        ahead = to_next(state, load, s, stop, material, held.tissue, drive, steps=steps, solver=solver, given=given)
        return *ahead, None

    def behind(load, state, place):
        spring, given = place
        return past(load, spring, laws, state, drive, sign, given)

    stops = jnp.maximum(held.springs.at, 0.0)
    return walk_past(onwards, behind, start, load, stops, (held.springs, held.given), s=s)


OfBase: TypeAlias = tuple[RodState, Load, Load, Float[Array, "springs 3"] | None]


def _base(
    start: RodState,
    load: Load,
    arc: Scalar,
    material: Material,
    held: Attachments,
    laws: Laws,
    drive: Frame,
    method: Shooting,
) -> OfBase:
    steps = 2 * method.steps if isinstance(material, Section) else method.steps
    walked = walk(start, load, arc, material, held, laws, drive, steps=steps, solver=method.solver)
    # What the shaft carries at its base: the load in front of the first spring there.
    above = jax.tree.map(lambda leaf: jnp.take(leaf, jnp.sum(held.springs.at > 0), mode="clip"), walked.loads)
    if held.given is None:
        return walked.end, walked.load, above, None
    places = jax.vmap(lambda spring, passed: in_drive(spring, passed, drive))(held.springs, walked.passed)
    return walked.end, walked.load, above, places


@eqx.filter_custom_jvp
def base_of_walk(
    start: RodState,
    load: Load,
    arc: Scalar,
    material: Material,
    held: Attachments,
    laws: Laws,
    drive: Frame,
    method: Shooting,
    for_rates: Shooting,
) -> OfBase:
    """State of the rod at its base, the load on it, that above springs at the base or below, and places, by `method`.

    Places are those of springs, in the drive's frame; None without springs to other whiskers. Derivatives are computed
    by `for_rates`.
    """
    del for_rates
    return _base(start, load, arc, material, held, laws, drive, method)


@base_of_walk.def_jvp
def _(primals, tangents):
    *at, method, for_rates = primals
    rates = partial(_base, method=for_rates)
    end, end_dot = eqx.filter_jvp(rates, tuple(at), tuple(tangents[:7]))
    return end if for_rates == method else base_of_walk(*primals), end_dot
