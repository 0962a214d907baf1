"""Which contacts may explain the signals of a whisker before known objects, and where to look for them.

The measured reaction determines the shaft from the base to its first contact. Its place and force are tried on a grid.
From there the shaft is integrated outwards. The outer contact is at the tip, or on the shaft where its moment first
vanishes. Scores say how well a place on the grid satisfies the laws of contact: the moment vanishes at the outer
contact, where the force is perpendicular to the shaft unless it is at the tip, and contacts with known objects touch
them. The best places of each hypothesis are guesses for its fits.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.gaps import nearest, outline_of
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject, material_of
from jaxwhisker._inverse.inverse_rod import LARGEST_ANGLE, START, zero_of
from jaxwhisker._model.motion import Pose
from jaxwhisker._model.objects import Objects
from jaxwhisker._rod import rod
from jaxwhisker._scan.springs import at_base

PLACES = 40  # along the shaft, at which the inner contact is tried
# Its forces: relative to the measured one, and the force beyond, across the shaft, relative to it.
INNER, BEYOND = np.geomspace(0.02, 0.5, 6), np.geomspace(0.01, 5.0, 13)
OUTER = 12  # steps from there to the tip
BEST = 6  # places of each hypothesis from which it is fitted
NO_FORCE = 1e-9  # EI/L^2: has no direction
# What counts as one in a score; twice the spacing of the grid and what follows from it.
GAP, ANGLE, LEVER = 0.05, 0.25, 0.05  # lengths, rad, moment per force


class Hypothesis(NamedTuple):
    """Contacts that may explain the signals of a whisker, and a guess for their numbers."""

    y: Float[Array, "*fits n"]  # contacts, three numbers of each, and the place of the spot
    state: ChainState  # fields (*fits, contacts)
    fixed: Bool[Array, "*fits n"]  # numbers that are not fitted
    unknown: Bool[Array, "*fits"]  # whether one of them is with something unknown


class Shares(NamedTuple):
    """Forces of inner contacts, as shares of the whole force and of its part across the shaft."""

    of_whole: Float[np.ndarray, " forces"]
    of_across: Float[np.ndarray, " forces"]


SHARES = Shares(np.concatenate([INNER, -BEYOND[::-1], BEYOND]), np.repeat([0.0, 1.0], [INNER.size, 2 * BEYOND.size]))


class AtObjects(NamedTuple):
    """How a point of a shaft with a force there would touch the nearest known object."""

    score: Scalar
    number: Int[Array, ""]
    parameter: Scalar
    normal: Float[Array, "2"]


class ShaftContact(NamedTuple):
    """A contact at a place of the shaft."""

    at: Float[Array, "2"]
    direction: Float[Array, "2"]  # of the shaft towards the tip
    beyond: Scalar  # arc length of the whisker beyond it
    force: Float[Array, "2"]
    object: AtObjects


class Outer(NamedTuple):
    """An outermost contact, and how well it satisfies the laws of contact."""

    place: ShaftContact
    score: Scalar


class Lane(NamedTuple):
    """A place on the grid: the inner contact, and the outer one that follows from it."""

    inner: ShaftContact
    shaft: Outer
    tip: Outer


def guesses_of(body: WhiskerAtObject, base: Pose, reaction: Float[Array, "3"]) -> Hypothesis:
    """All hypotheses about a whisker with this base and this reaction; fields (fits, ...)."""
    touch, material = _toucher(body, base), material_of(body)
    start, load = at_base(base, tuple(reaction))
    assert load.force_x is not None and load.moment is not None
    fx, fy, about = (jnp.asarray(part) for part in (load.force_x, load.force_y, load.moment))
    whole = jnp.hypot(fx, fy)

    def outer_of(start: rod.RodState, s: Scalar, load: rod.Load) -> tuple[Outer, Outer]:
        """The outermost contact of a shaft with this load from a point outwards, on the shaft and at the tip."""
        arc = body.length - s
        states = rod.points(start, -arc, load, material, count=OUTER + 1, from_base=s)
        bent = jnp.asarray(rod.moment(*states[:2], load))
        last, share = zero_of(bent * jnp.where(bent[0] < 0, -1.0, 1.0))
        share = jnp.clip(share, 0.0, 1.0)
        crossed = jnp.any(bent[1:] * bent[0] <= 0)
        force = jnp.stack([jnp.asarray(load.force_x), jnp.asarray(load.force_y)])
        size = jnp.maximum(jnp.hypot(*force), NO_FORCE)

        def at(state: Any, beyond: Scalar, left: Scalar) -> tuple[ShaftContact, Scalar, Scalar]:
            x, y, cos, sin = state
            here, direction = jnp.stack([x, y]), jnp.stack([cos, sin]) / jnp.hypot(cos, sin)
            lean = jnp.sum(force * direction) / size / ANGLE
            return (
                ShaftContact(here, direction, beyond, force, touch(here, force / size)),
                lean,
                (left / size / LEVER) ** 2,
            )

        crossing = [values[last] + share * (values[last + 1] - values[last]) for values in states]
        left = jnp.where(crossed, 0.0, bent[-1])
        on_shaft, lean, lever = at(crossing, arc * (1 - (last + share) / OUTER), left)
        shaft = Outer(on_shaft, lever + lean**2)
        at_tip, lean, lever = at([values[-1] for values in states], jnp.zeros(()), bent[-1])
        return shaft, Outer(at_tip, lever + jnp.maximum(lean, 0.0) ** 2)

    zero = jnp.zeros(())
    shaft, tip = (outer.place for outer in outer_of(start, zero, load))
    x, y, cos, sin = rod.points(start, -body.length, load, material, count=PLACES + 1, from_base=zero)
    inner_s = body.length * jnp.asarray(np.arange(1, PLACES) / PLACES)
    states = tuple(values[1:-1] for values in (x, y, cos, sin))

    def lane(at, s, side, share) -> Lane:
        x, y, cos, sin = at
        normal = side * jnp.stack([sin, -cos])
        across = fx * normal[0] + fy * normal[1]
        size = whole * share.of_whole + across * share.of_across
        force = size * normal
        rest = rod.Load(fx - force[0], fy - force[1], about - x * force[1] + y * force[0])
        here = jnp.stack([x, y])
        inner = ShaftContact(here, jnp.stack([cos, sin]), body.length - s, force, touch(here, normal))
        pushes = jnp.where(size > 0, 0.0, jnp.inf)
        return Lane(inner, *(outer._replace(score=outer.score + pushes) for outer in outer_of(at, s, rest)))

    over_force = jax.vmap(lane, in_axes=(None, None, None, 0))
    over_place = jax.vmap(over_force, in_axes=(0, 0, None, None))
    over_side = jax.vmap(over_place, in_axes=(None, None, 0, None))
    lanes = over_side(states, inner_s, jnp.array([1.0, -1.0]), SHARES)
    one = [
        *(_alone(body, place, known=True, phase=phase) for phase, place in ((TIP, tip), (SHAFT, shaft))),
        *(
            _alone(body, place, known=False, phase=phase)
            for phase, place in ((TIP, tip), (SHAFT, shaft), (BORDER, tip))
        ),
    ]
    hypotheses = [jax.tree.map(lambda *leaves: jnp.stack(leaves), *one)]
    for known in ((True, True), (False, True), (True, False)):  # the outer and the inner contact
        for phase in (TIP, SHAFT) if all(known) else (TIP, SHAFT, BORDER):
            outer = lanes.shaft if phase == SHAFT else lanes.tip
            wanted = [place for place, is_known in zip((outer.place, lanes.inner), known, strict=True) if is_known]
            score = jnp.asarray(outer.score) + sum(jnp.asarray(place.object.score) for place in wanted)
            best = _best((outer.place, lanes.inner), score)
            made = jax.vmap(lambda outer, inner, known=known, phase=phase: _both(body, outer, inner, known, phase))
            hypotheses.append(made(*best))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *hypotheses)


def _toucher(body: WhiskerAtObject, base: Pose) -> Callable[[Array, Array], AtObjects]:
    """How a point with a force in this direction would touch the known objects."""
    profile = body.profile
    assert isinstance(profile, Objects)
    outlines = [outline_of(one, base.x, base.y, 1.5 * body.length) for one in profile.objects]

    def touch(at: Float[Array, "2"], normal: Float[Array, "2"]) -> AtObjects:
        each = []
        for number, (one, outline) in enumerate(zip(profile.objects, outlines, strict=True)):
            parameter = nearest(one, outline, *at)
            there = one.point(parameter)
            gap, turn = there.off(*at), jnp.sum((there.normal - normal) ** 2)
            score = (gap / GAP) ** 2 + turn / ANGLE**2
            each.append(AtObjects(score, jnp.asarray(number), jnp.asarray(parameter), there.normal))
        each = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
        return jax.tree.map(lambda leaf: leaf[jnp.argmin(each.score)], each)

    return touch


def _best(
    places: tuple[ShaftContact, ShaftContact], score: Float[Array, "sides places forces"]
) -> tuple[ShaftContact, ShaftContact]:
    """The best places on the grid that are better than their neighbours."""
    score = jnp.where(jnp.isfinite(score), score, jnp.inf)
    wide = jnp.pad(score, ((0, 0), (1, 1), (1, 1)), constant_values=jnp.inf)
    _, rows, columns = score.shape
    around = [wide[:, i : i + rows, j : j + columns] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    least = jnp.min(jnp.stack(around), axis=0)
    _, chosen = jax.lax.top_k(-jnp.ravel(jnp.where(score <= least, score, jnp.inf)), BEST)
    return jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *leaf.shape[3:]))[chosen], places)


TIP, SHAFT, BORDER = range(3)  # where the outermost contact is; at the tip with the tip along the object


class _Row(NamedTuple):
    numbers: Float[Array, "3"]
    phase: Any
    side: Scalar
    piece: Any


def _row(body: WhiskerAtObject, place: ShaftContact, known: bool, phase: int) -> _Row:
    """The numbers of a contact, and how it touches."""
    assert isinstance(body.profile, Objects)
    size = jnp.hypot(*place.force)
    normal = place.object.normal if known else place.force / jnp.maximum(size, NO_FORCE)
    along = -place.direction[0] * normal[1] + place.direction[1] * normal[0]
    into = -jnp.sum(place.direction * normal)
    angle = jnp.clip(jnp.arctan2(into, jnp.abs(along)), 0.0, LARGEST_ANGLE)
    slack = (-angle, jnp.clip(place.beyond, START * body.length, (1 - START) * body.length), jnp.zeros(()))[phase]
    parameter = place.object.parameter if known else jnp.arctan2(normal[0], -normal[1])
    piece = place.object.number if known else jnp.asarray(len(body.profile.objects))
    phase = Phase.tangential if phase == SHAFT else Phase.tip
    side = jnp.where(along < 0, -1.0, 1.0)
    return _Row(jnp.stack([size, parameter, slack]), jnp.asarray(int(phase)), side, piece)


def _alone(body: WhiskerAtObject, place: ShaftContact, *, known: bool, phase: int) -> Hypothesis:
    """One contact."""
    zero = jnp.asarray(0)
    unused = _Row(jnp.zeros(3), jnp.asarray(int(Phase.free)), jnp.ones(()), zero)
    spot = jnp.zeros(2) if known else place.at
    return _hypothesis((_row(body, place, known, phase), unused), spot, not known, phase)


def _both(
    body: WhiskerAtObject, outer: ShaftContact, inner: ShaftContact, known: tuple[bool, bool], phase: int
) -> Hypothesis:
    """Two contacts."""
    rows = _row(body, outer, known[0], phase), _row(body, inner, known[1], SHAFT)
    spot = jnp.zeros(2) if all(known) else inner.at if known[0] else outer.at
    return _hypothesis(rows, spot, not all(known), phase)


def _hypothesis(rows: tuple[_Row, _Row], spot: Array, has_spot: bool, phase: int) -> Hypothesis:
    numbers, phases, sides, pieces = (jnp.stack(values) for values in zip(*rows, strict=True))
    fixed = np.zeros(8, bool)
    fixed[6:] = not has_spot
    fixed[2] = phase == BORDER
    state = ChainState(phases, sides, pieces)
    return Hypothesis(jnp.append(jnp.ravel(numbers), spot), state, jnp.asarray(fixed), jnp.asarray(has_spot))
