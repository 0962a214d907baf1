"""The quadratic forms of one whisker that vibrates about an equilibrium: kinetic energy, potential energy, contact.

With the change of angle delta phi along the whisker, positions change to second order by

    delta r = delta r0 + int n delta phi ds - 1/2 int t delta phi^2 ds,     t, n: tangent and normal of the whisker.

Twice the change of potential energy, to second order, is therefore

    int EI delta phi'^2 ds + int (F . t) delta phi^2 ds + springs - f delta^2 g

with the force F in the whisker, and the contact's force f and second variation of its gap g >= 0. At a contact that is
kept, the first variation of the gap vanishes: n_o . delta r = 0, with the outward normal n_o of the object. Its second
variation, without the part that F contains, is that of the distance to a circle of radius R: for the tip

    delta^2 g = (t_o . delta r)^2 / R,

and for the shaft, along which the contact moves until the distance is least, with a = t . delta r, b = (n_o . n) delta
phi and k = (n_o . n) kappa0,

    delta^2 g = (k a^2 - 2 a b - R b^2) / (1 + R k).

With friction, contacts stick: the tip stays where it is, and a shaft rolls (a = 0). With R to infinity and k = 0, a
shaft on a straight face cannot turn (b = 0). The part beyond the contact then lies on the face, along which it moves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.elements import ORDER, WEIGHTS, Fields, bending, fields, quadratic
from jaxwhisker._dynamics.line import Centreline, Equilibrium
from jaxwhisker._dynamics.object import Bend, bend_of_each
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject
from jaxwhisker._equilibrium.shaft_springs import Laws, ShaftSprings, end_of, stretched, tension_of
from jaxwhisker._model.motion import Frame
from jaxwhisker._rod.rod import Section


class Masses(NamedTuple):
    """Masses of one whisker, dimensionless; or of all whiskers, stacked."""

    along: Float[Array, "*batch elements points"]  # per length
    tip: Float[Array, "*batch"]
    base: Float[Array, "*batch"]
    inertia: Float[Array, "*batch"]  # at the base


class Forms(NamedTuple):
    """Quadratic forms of a whisker; the last three coordinates are x, y and angle of its base, in the scene."""

    mass: Float[Array, "n n"]
    stiffness: Float[Array, "n n"]  # without the support
    below: Float[Array, "3 3"]  # stiffness of springs at the base and below it that do not belong to the network
    constraints: Float[Array, "constraints n"]  # forms that vanish; all zero for a free whisker
    defined: Bool[Array, ""]  # False if an edge touches the tip, from which any vibration would make it slip
    fields: Fields


def forms_of(body: WhiskerAtObject, at: Equilibrium, line: Centreline, masses: Masses) -> Forms:
    """The quadratic forms of one whisker."""
    contact = _contact_of(body, at, line)
    moves = fields(line.lengths, line.cos, line.sin)
    if body.profile.has_edges:
        moves = _at_rest(moves, contact.rests, line.contact)
    over = line.lengths[:, None] * WEIGHTS  # integrates along the whisker
    position, angle, tip = moves.at[:, :, :2], moves.at[:, :, 2], moves.ends[-1]
    mass = quadratic(position, jnp.stack([over * masses.along] * 2, axis=-1))
    mass += masses.tip * tip[:2].T @ tip[:2]
    mass = _at_base(mass, jnp.diag(jnp.stack([masses.base, masses.base, masses.inertia])))
    tension = line.force_x * line.cos + line.force_y * line.sin
    stiffness = quadratic(angle, over * tension)
    stiffness += jnp.pad(bending(line.stiffness), (0, 3))
    below = jnp.zeros((3, 3))
    if body.sprung is not None and line.springs is not None:
        held_by, drive = body.sprung.held_by, body.sprung.drive
        each = jax.vmap(lambda spring, state: _spring_stiffness(spring, body.laws, state, drive))
        stiffness += quadratic_of(moves.ends, each(line.springs, line.ends))
        base = (at.base_x, at.base_y, -jnp.sin(at.base_angle), jnp.cos(at.base_angle))
        below = jnp.sum(
            jax.vmap(lambda spring: _spring_stiffness(spring, body.laws, base, drive))(held_by.springs.below), axis=0
        )
        if held_by.tissue is not None:
            tissue, starts = held_by.tissue, jnp.cumsum(line.lengths) - line.lengths
            cos = tissue.cos * drive.cos - tissue.sin * drive.sin
            sin = tissue.sin * drive.cos + tissue.cos * drive.sin
            held = tissue.stiffness * jax.vmap(tissue.share)(starts + line.lengths / 2)
            stiffness += quadratic(cos * position[:, :, 0] + sin * position[:, :, 1], over * held[:, None])
    bent, constraints = _kept(body, at, contact, moves, line.contact)
    return Forms(mass, stiffness + bent, below, constraints, ~contact.sharp, moves)


def quadratic_of(left: Float[Array, "*batch k n"], weight: Float[Array, "*batch k k"]) -> Float[Array, "n n"]:
    """The quadratic form of coordinates that is given by small matrices."""
    return jnp.einsum("...ki,...kl,...lj->ij", left, weight, left)


def _at_base(form: Float[Array, "n n"], of_base: Float[Array, "3 3"]) -> Float[Array, "n n"]:
    return form.at[-3:, -3:].add(of_base)


def _spring_stiffness(spring: ShaftSprings, laws: Laws, state: tuple, drive: Frame) -> Float[Array, "3 3"]:
    """Derivatives of the spring's forces and moment by the position and angle of its place on the shaft."""
    x, y, cos, sin = state

    def pull(change: Float[Array, "3"]) -> Float[Array, "3"]:
        turn_cos, turn_sin = jnp.cos(change[2]), jnp.sin(change[2])
        moved = x + change[0], y + change[1], cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
        length, by_x, by_y, by_turn = stretched(spring, moved, drive)
        end_x, end_y = end_of(spring, moved)
        lever = (end_x - moved[0]) * by_y - (end_y - moved[1]) * by_x
        return tension_of(spring, laws, length) * jnp.stack([by_x, by_y, by_turn + lever])

    return jax.jacfwd(pull)(jnp.zeros(3))


class _ContactGeometry(NamedTuple):
    free: Bool[Array, ""]
    tip: Bool[Array, ""]
    bend: Bend  # of the object
    same: Scalar  # 1 if the whisker runs along the object with growing x, else -1
    curvature: Scalar  # k
    sharp: Bool[Array, ""]  # an edge touches the tip
    rests: Bool[Array, ""]  # a straight shaft lies on a straight face


def _contact_of(body: WhiskerAtObject, at: Equilibrium, line: Centreline) -> _ContactGeometry:
    free, tip = at.phase == Phase.free, at.phase == Phase.tip
    number = jnp.where(free, 0, 1 if at.contact_object is None else at.contact_object)
    bend = bend_of_each(body.profile, number, (at.contact_x, at.contact_y, at.contact_slope))
    _, _, cos, sin = (values[line.contact] for values in line.ends)
    same = jnp.where(cos * jnp.cos(at.contact_slope) + sin * jnp.sin(at.contact_slope) > 0, 1.0, -1.0)
    curvature = body.section.curvature(at.contact_arc) if isinstance(body.section, Section) else 0.0
    k = -same * curvature
    rests = ~free & ~tip & (bend.turn + bend.speed * k <= 0)
    return _ContactGeometry(free, tip, bend, same, k, tip & (bend.speed <= 0), rests)


def _at_rest(moves: Fields, rests: Bool[Array, ""], contact: Scalar) -> Fields:
    """The fields, without those of the elements beyond the contact if these rest on a straight face."""
    size = moves.ends.shape[-1] - 3
    lies = (jnp.arange(size + 3) // ORDER > contact) & (jnp.arange(size + 3) < size)
    return jax.tree.map(lambda leaf: jnp.where(rests & lies, 0.0, leaf), moves)


def _kept(
    body: WhiskerAtObject, at: Equilibrium, contact: _ContactGeometry, moves: Fields, element: Scalar
) -> tuple[Float[Array, "n n"], Float[Array, "constraints n"]]:
    """Stiffness of the contact, and its constraints."""
    bend, k = contact.bend, contact.curvature
    cos, sin = jnp.cos(at.contact_slope), jnp.sin(at.contact_slope)
    here = jnp.where(contact.tip, moves.ends[-1], moves.ends[element])
    along, across, turn = cos * here[0] + sin * here[1], sin * here[0] - cos * here[1], here[2]
    constraints = [across]
    a, b = contact.same * along, -contact.same * turn
    of_tip = bend.turn / jnp.where(bend.speed > 0, bend.speed, 1.0) * _square(along)
    if body.friction_angle is not None:
        constraints.append(along)
    if body.profile.has_edges:
        constraints.append(jnp.where(contact.rests, turn, 0.0))
    flat = jnp.where(contact.rests | contact.free | contact.tip, 1.0, bend.turn + bend.speed * k)
    of_shaft = (bend.turn * (k * _square(a) - _product(a, b)) - bend.speed * _square(b)) / flat
    gap = jnp.where(contact.tip, of_tip, of_shaft)
    touches = jnp.where(contact.free, 0.0, 1.0)
    return -touches * at.contact_force * gap, touches * jnp.stack(constraints)


def _square(form: Float[Array, " n"]) -> Float[Array, "n n"]:
    return form[:, None] * form


def _product(a: Float[Array, " n"], b: Float[Array, " n"]) -> Float[Array, "n n"]:
    """The quadratic form 2 a b."""
    return a[:, None] * b + b[:, None] * a


class CondensedWhisker(NamedTuple):
    """A whisker whose base is held, and how it follows its base."""

    flexibility: Float[Array, "inner inner"]  # of the coordinates of its elements
    follows: Float[Array, "inner 3"]  # changes of these coordinates with the pose of the base
    held: Float[Array, "3 3"]  # stiffness of the base


def condensed(forms: Forms) -> CondensedWhisker:
    """Condense a whisker to its base, with its contact kept."""
    inner = forms.mass.shape[0] - 3
    own, coupled = forms.stiffness[:inner, :inner], forms.stiffness[:inner, inner:]
    rows = forms.constraints
    unused = jnp.diag(jnp.where(jnp.any(rows != 0, axis=1), 0.0, 1.0))
    saddle = jnp.block([[own, rows[:, :inner].T], [rows[:, :inner], unused]])
    border = jnp.concatenate([coupled, rows[:, inner:]])
    inverted = inverse(saddle)
    follows = -inverted @ border
    held = forms.stiffness[inner:, inner:] + border.T @ follows
    return CondensedWhisker(inverted[:inner, :inner], follows[:inner], (held + held.T) / 2)


def reaction(forms: Forms, mode: Float[Array, " n"], rate: Scalar) -> Float[Array, "3"]:
    """Amplitudes of force and moment of the support on the base, in a mode with this omega^2."""
    inner = mode.size - 3
    push = forms.stiffness @ mode - rate * (forms.mass @ mode)
    rows = forms.constraints
    unused = jnp.diag(jnp.where(jnp.any(rows != 0, axis=1), 0.0, 1.0))
    contact = inverse(rows[:, :inner] @ rows[:, :inner].T + unused) @ (rows[:, :inner] @ push[:inner])
    return push[inner:] - rows[:, inner:].T @ contact
