"""The rod in space, with intrinsic curvature and torsion, integrated from a loaded point back to its base.

The rotation R = [d1 d2 d3] turns the axes into the directions of the rod's cross-section, d3 being the tangent. With
the bending stiffness B = EI, B1 about d1 (B, but for a strip), the torsional stiffness C, and force F and moment M0
about the origin at the start,

    dr/ds = d3,  dR/ds = R k^,  k = kappa0 + (m.d1 / B1, m.d2 / B, m.d3 / C),  m = M0 + F x r.

As in the plane, two flows alternate, and both are exact: a shift along the tangent, during which m.d3 is constant and
the rod twists by (1/C - 1/B) m.d3, and a rotation exp(h m / B) R exp(h kappa0) at constant moment. A strip has a third
one, on both sides of the rotation: a bend by (1/B1 - 1/B) m.d1, during which m.d1 is constant.

A change of the state is the change of r and the vector w of a rotation by which R changes: dR = w^ R. The flows change
it linearly: several changes along with the state take a quarter of the time of general forward derivatives.
"""

import dataclasses
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base.quaternions import (
    NONE,
    Pivot,
    Quaternion,
    Vector,
    change_after,
    cross,
    dot,
    first_axis,
    inverse_rotation,
    pivot,
    plus,
    product,
    small_rotation,
    third_axis,
    times,
    total,
    turned,
)
from jaxwhisker._base.types import Scalar
from jaxwhisker._rod.rod import METHODS, Along, AlongRod, Section, at_arc, one_sided, step_ends, with_breaks

SpaceState: TypeAlias = tuple[Vector, Quaternion]  # position r, rotation R
Change: TypeAlias = tuple[Vector, Vector]  # of r, and a rotation vector


class SpaceSection(eqx.Module):
    """Stiffness and intrinsic curvature along a rod in space, in given units of length and EI."""

    bending_stiffness: AlongRod  # EI in every direction, in the scene's units
    torsion_ratio: Scalar | None = None  # torsional stiffness divided by EI; None or the number 1: both are equal
    # About d1, d2 and the tangent (twist), in the scene's units, 1/length; None if absent. A curvature about d2 bends
    # the rod towards d1.
    curvature: tuple[AlongRod | None, AlongRod | None, AlongRod | None] = NONE
    length_unit: Scalar = 1.0  # in the scene's units
    stiffness_unit: Scalar = 1.0  # of EI, in the scene's units
    breaks: Along | None = None  # arc lengths at which a function jumps or has a kink, in the scene's units
    lateral_ratio: Scalar | None = None  # stiffness against bending about d1 divided by EI; None: they are equal
    mass_per_length: AlongRod | None = None  # in the scene's units; None if its weight does not matter

    @property
    def uniform(self) -> bool:
        """Whether stiffness, curvature and mass are numbers."""
        return not any(map(callable, (self.bending_stiffness, *self.curvature, self.mass_per_length)))

    @property
    def excess(self) -> Scalar | None:
        """Torsional compliance minus that of bending, relative to the latter; None if it is known to be zero."""
        ratio = self.torsion_ratio
        return None if ratio is None or (isinstance(ratio, int | float) and ratio == 1) else 1 / ratio - 1

    @property
    def lateral_excess(self) -> Scalar | None:
        """Compliance of bending about d1 minus that about d2, relative to the latter; None if they are equal."""
        return None if self.lateral_ratio is None else 1 / self.lateral_ratio - 1

    @property
    def in_plane(self) -> Section | None:
        """Section of a rod in the plane that takes the same steps; None if these are equidistant."""
        if self.uniform:
            return None
        return Section(self.bending_stiffness, None, self.length_unit, self.stiffness_unit, breaks=self.breaks)

    def compliance(self, s: Scalar) -> Float[Array, ""]:
        """1/EI at the arc length s from the base; 0 at a point without stiffness, which carries no moment."""
        stiffness = at_arc(self.bending_stiffness, s * self.length_unit) / self.stiffness_unit
        stiff = stiffness > 0
        return jnp.where(stiff, 1 / jnp.where(stiff, stiffness, 1.0), 0.0)

    def mass(self, s: Scalar) -> Float[Array, ""]:
        """Mass per length at the arc length s from the base, in the scene's units."""
        return at_arc(0.0 if self.mass_per_length is None else self.mass_per_length, s * self.length_unit)

    def intrinsic(self, s: Scalar) -> Vector:
        """Intrinsic curvatures and twist at the arc length s from the base."""
        unit = self.length_unit
        k1, k2, k3 = (None if value is None else at_arc(value, s * unit) * unit for value in self.curvature)
        return k1, k2, k3


class SpaceLoad(eqx.Module):
    """Load on the rod at and beyond the start of the integration: force, and moment about the origin."""

    force: Vector
    moment: Vector = NONE

    def moment_at(self, r: Vector) -> Vector:
        """The internal moment M0 + F x r at a position."""
        return plus(cross(self.force, r), self.moment)


class _SpaceRod(eqx.Module):
    arc: Scalar
    load: SpaceLoad
    section: SpaceSection
    from_base: Scalar


def _divided(shifts: list[float], rotations: list[float]) -> tuple[list[float], list[float]]:
    """Parts of the shifts before and after each rotation that belong to it.

    With its rotations divided likewise, a splitting is a composition of steps of first order and their adjoints, and
    has the same order for more than two flows: the twist of a shift may depend on the stiffness at its ends.
    """
    before, after = [], []
    for shift, rotation in zip(shifts, rotations, strict=False):
        before.append(shift - (after[-1] if after else 0.0))
        after.append(rotation - before[-1])
    return before, after


class _SplittingStage(eqx.Module):
    """A shift and a rotation, as what changes of the state need of them."""

    length: Scalar  # of the shift, negative towards the base
    twist: Scalar | None  # angle by m.d3
    r: Vector  # after the shift
    tangent: Vector
    bend: Scalar | None = None  # angle by m
    rotation: Pivot | None = None
    sides: tuple[tuple[Scalar, Vector], ...] = ()  # angles by m.d1 before and after the rotation, and d1

    def change(self, change: Change, load: SpaceLoad, load_change: SpaceLoad) -> Change:
        """The change after this stage, from that before it and that of the load."""
        r, w = change
        turn = cross(w, self.tangent)
        r = plus(r, times(self.length, turn))
        moment = plus(cross(load.force, r), load_change.moment_at(self.r))

        def bent(w: Vector, angle: Scalar, axis: Vector) -> Vector:
            """The rotation after one about an axis of the rod, by the moment about it."""
            about = total(dot(moment, axis), dot(load.moment_at(self.r), cross(w, axis)))
            return plus(w, times(angle * about, axis))

        if self.twist is not None:
            w = bent(w, self.twist, self.tangent)
        if self.sides:
            w = bent(w, *self.sides[0])
        if self.rotation is not None:
            w = change_after(self.rotation, w, times(self.bend, moment))
        return r, bent(w, *self.sides[1]) if self.sides else w


def _step(
    state: SpaceState, change: Change | None, ends: tuple, rod: _SpaceRod, load_change: SpaceLoad | None
) -> tuple[SpaceState, Change | None]:
    """The state after a step, and its changes, if there are any, along a leading axis."""
    (t0, t1, between), load, section = ends, rod.load, rod.section
    h = (t0 - t1) * rod.arc
    excess, lateral = section.excess, section.lateral_excess
    # The order conditions of the method with 11 rotations hold for uniform rods of two flows only.
    shifts, rotations = METHODS[11 if section.uniform and excess is None and lateral is None else 10]

    def shifted(state: SpaceState, fraction: Scalar, twist: Scalar | None) -> tuple[SpaceState, _SplittingStage]:
        r, q = state
        stage = _SplittingStage(fraction * h, twist, plus(r, times(fraction * h, third_axis(q))), third_axis(q))
        if twist is not None:
            q = product(q, small_rotation((None, None, twist * dot(load.moment_at(stage.r), stage.tangent))))
        return (stage.r, q), stage

    def through(stage: _SplittingStage, change: Change | None) -> Change | None:
        if change is None:
            return None
        return jax.vmap(lambda change, load_change: stage.change(change, load, load_change))(change, load_change)

    def advance(carry, fractions):
        state, due, change = carry
        shift, rotation, passed, before, after = fractions
        s = rod.from_base - (t0 + passed * (t1 - t0)) * rod.arc  # arc length advances with the position
        s = s if between is None else one_sided(s, *between)
        compliance, twist = section.compliance(s), None
        if excess is not None:
            twist, due = due + before * h * excess * compliance, after * h * excess * compliance
        (r, q), stage = shifted(state, shift, twist)
        bend, moment = rotation * h * compliance, load.moment_at(r)
        by = pivot(times(bend, moment))

        def sideways(q: Quaternion, part: Scalar) -> tuple[Quaternion, tuple]:
            angle, axis = part * h * lateral * compliance, first_axis(q)
            return product(q, small_rotation((angle * dot(moment, axis), None, None))), ((angle, axis),)

        q, first = (q, ()) if lateral is None else sideways(q, before)
        q = product(product(by.q, q), small_rotation(times(rotation * h, section.intrinsic(s))))
        q, last = (q, ()) if lateral is None else sideways(q, after)
        stage = dataclasses.replace(stage, bend=bend, rotation=by, sides=(*first, *last))
        return ((r, q), due, through(stage, change)), None

    fractions = shifts[:-1], rotations, np.cumsum(shifts)[:-1], *_divided(shifts, rotations)
    due = None if excess is None else jnp.zeros_like(h)
    (state, due, change), _ = jax.lax.scan(advance, (state, due, change), tuple(map(jnp.asarray, fractions)))
    state, last = shifted(state, shifts[-1], due)
    return state, through(last, change)


def _march(
    start: SpaceState,
    rod: _SpaceRod,
    at: Float[Array, " times"],
    *,
    keep: bool = False,
    changes: tuple[Change, SpaceLoad] | None = None,
) -> tuple[SpaceState, Change | None, SpaceState | None]:
    """The last state; its changes due to those of the start and the load; the states at all times, if kept."""
    at, place, between = with_breaks(at, rod.arc, rod.section.in_plane, rod.from_base)

    first, load_change = (None, None) if changes is None else changes

    def step(carry, ends):
        state, change = _step(carry[0], carry[1], ends, rod, load_change)
        return (state, change), state if keep else None

    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), start)
    (end, change), states = jax.lax.scan(step, (start, first), (at[:-1], at[1:], between))
    if keep:
        states = jax.tree.map(jnp.append, start, states)
        states = states if place is None else jax.tree.map(lambda leaf: leaf[place], states)
    return end, change, states


def integrate(
    start: SpaceState, arc: Scalar, load: SpaceLoad, section: SpaceSection, *, steps: int, from_base: Scalar
) -> SpaceState:
    """State of the rod at an arc length `arc` from `start` towards the base.

    Args:
        start: position and rotation at the loaded point, without absent parts.
        arc: arc length between the loaded point and the end; negative to integrate away from the base.
        load: load at the loaded point and beyond.
        section: stiffness and intrinsic curvature.
        steps: number of steps, which are shorter where a rod that is not uniform is thinner.
        from_base: arc length from the base to the loaded point.
    """
    at = step_ends(arc, section.in_plane, steps=steps, from_base=from_base)
    return _march(start, _SpaceRod(arc, load, section, from_base), at)[0]


def with_changes(
    start: SpaceState,
    changes: tuple[Change, SpaceLoad],
    arc: Scalar,
    load: SpaceLoad,
    section: SpaceSection,
    *,
    steps: int,
    from_base: Scalar,
) -> tuple[SpaceState, Change]:
    """The state that `integrate` returns and its changes, from several changes of the start and of the load."""
    at = step_ends(arc, section.in_plane, steps=steps, from_base=from_base)
    end, change, _ = _march(start, _SpaceRod(arc, load, section, from_base), at, changes=changes)
    assert change is not None
    return end, change


def points(
    start: SpaceState, arc: Scalar, load: SpaceLoad, section: SpaceSection, *, at: Along, from_base: Scalar
) -> SpaceState:
    """States at the fractions `at` of an arc towards the base, which begin with 0; see `integrate`."""
    states = _march(start, _SpaceRod(arc, load, section, from_base), at, keep=True)[2]
    assert states is not None
    return states


def curvature(state: SpaceState, load: SpaceLoad, section: SpaceSection, s: Scalar) -> Vector:
    """Curvatures about d1 and d2 and twist, at the arc length s from the base."""
    r, q = state
    k1, k2, k3 = times(section.compliance(s), turned(inverse_rotation(q), load.moment_at(r)))
    if section.excess is not None:
        k3 = k3 * (1 + section.excess)
    if section.lateral_ratio is not None:
        k1 = k1 / section.lateral_ratio
    return plus((k1, k2, k3), section.intrinsic(s))
