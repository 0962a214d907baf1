"""Vibrations of all whiskers about an equilibrium: the network of bases couples them.

A base moves by d = C F under the force F of its whisker, with the flexibility C of the support. With the stiffness D of
the base of a whisker whose inner coordinates follow, the bases have the flexibility (1 + C D)^-1 C. A rigid support,
C = 0, and springs of any stiffness need no special treatment.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.types import Scalar
from jaxwhisker._dynamics.eigen import slowest
from jaxwhisker._dynamics.elements import interpolated, node_arcs
from jaxwhisker._dynamics.forms import CondensedWhisker, Forms, Masses, condensed, forms_of, quadratic_of, reaction
from jaxwhisker._dynamics.line import DeadLoads, ElementEnds, Equilibrium, ends_of, line_of
from jaxwhisker._equilibrium.contact import of_each
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._model.whisker import Whisker, with_equal_breaks

NOISE = 1e-9  # of the flexibilities of modes: a negative one beyond it means that the equilibrium is not stable


class Vibration(NamedTuple):
    """The slowest modes, dimensionless; those of a mass per length of 1 at the base of the first whisker."""

    omega: Float[Array, " count"]
    fx: Float[Array, "count whiskers"]  # amplitudes of the reactions
    fy: Float[Array, "count whiskers"]
    mz: Float[Array, "count whiskers"]
    base: Float[Array, "count whiskers 3"]  # amplitudes of the bases, in their frames
    shape: Float[Array, "count whiskers points 2"]
    stable: Bool[Array, ""]


def mass_unit(whiskers: tuple[Whisker, ...]) -> Float[Array, ""]:
    """Unit of mass per length: that of the first whisker at its base."""
    return whiskers[0].mass_at(jnp.zeros(()))


def vibration(
    problem: Problem,
    whiskers: tuple[Whisker, ...],
    at: Equilibrium,
    u: Scalar,
    loads: DeadLoads | None,
    count: int,
    points: int,
) -> Vibration:
    """The slowest modes about one equilibrium, which is given in dimensionless form.

    Args:
        problem: the problem of the scene.
        whiskers: the scene's whiskers, for their masses.
        at: the equilibrium of all whiskers.
        u: the control.
        loads: loads besides those of the scene.
        count: number of modes.
        points: number of points of the shapes, equidistant along each whisker.
    """
    bodies = problem.bodies(u, problem.unloaded(u)[0])
    ends = of_each(bodies, ends_of, at, loads, _breaks(problem, whiskers))
    masses = _masses(problem, whiskers, jax.vmap(lambda arcs: node_arcs(arcs)[1])(ends.arcs))
    forms = of_each(bodies, _forms, at, ends, loads, masses)
    each = jax.vmap(condensed)(forms)
    axes = _axes(problem, u)
    mass, flexibility = _assembled(problem, forms, each, axes)
    mu, mode, least = slowest(flexibility, mass, count)
    stable = jnp.all(forms.defined) & jnp.isfinite(least) & (least > -NOISE * mu[0])
    mu = jnp.where(stable, mu, 1.0)
    own, base = jax.vmap(lambda mode: _by_whisker(mode, axes))(mode)
    react = jax.vmap(jax.vmap(reaction, in_axes=(0, 0, None)), in_axes=(None, 0, 0))(forms, own, 1 / mu)
    # The largest moment of a mode is positive.
    largest = jnp.take_along_axis(react[..., 2], jnp.argmax(jnp.abs(react[..., 2]), axis=1, keepdims=True), axis=1)
    sign = jnp.where(largest < 0, -1.0, 1.0)[:, :, None]
    shape = jax.vmap(lambda own: jax.vmap(_shape, in_axes=(0, 0, 0, None))(forms, own, ends.arcs, points))(own)
    fx, fy, mz = jnp.moveaxis(sign * react, -1, 0)
    return Vibration(mu**-0.5, fx, fy, mz, sign * base, sign[..., None] * shape, stable)


def _masses(problem: Problem, whiskers: tuple[Whisker, ...], arcs: Float[Array, "whiskers elements points"]) -> Masses:
    unit, per_length = problem.unit.length, mass_unit(whiskers)
    rows = []
    for whisker, own in zip(whiskers, arcs, strict=True):
        along = jax.vmap(jax.vmap(whisker.mass_at))(own * unit) / per_length
        extra = (whisker.tip_mass, whisker.base_mass, whisker.base_inertia)
        tip, base, inertia = (jnp.asarray(0.0 if value is None else value, dtype=float) for value in extra)
        point = per_length * unit
        rows.append(Masses(along, tip / point, base / point, inertia / (point * unit**2)))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)


def _breaks(problem: Problem, whiskers: tuple[Whisker, ...]) -> Float[Array, "whiskers breaks"] | None:
    """Breaks of all whiskers, also those of their masses; None without any."""
    each = [whisker.breaks for whisker in with_equal_breaks(whiskers)]
    return None if each[0] is None else jnp.stack([jnp.asarray(own) for own in each]) / problem.unit.length


def _forms(body, at: Equilibrium, ends: ElementEnds, loads: DeadLoads | None, masses: Masses) -> Forms:
    return forms_of(body, at, line_of(body, at, ends, loads), masses)


def _axes(problem: Problem, u: Scalar) -> Float[Array, "whiskers 3 axes"]:
    """Pose of each base in the scene per coordinate of the network."""
    if problem.axes == 1:
        return jnp.zeros((problem.length.size, 3, 1)).at[:, 0].set(1.0)
    frame, _ = problem.frames(u)
    assert frame is not None
    zero = jnp.zeros_like(frame.cos)
    rows = [[frame.cos, -frame.sin, zero], [frame.sin, frame.cos, zero], [zero, zero, zero + 1.0]]
    return jnp.moveaxis(jnp.array(rows), -1, 0)


def _assembled(
    problem: Problem, forms: Forms, each: CondensedWhisker, axes: Float[Array, "whiskers 3 axes"]
) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
    """Mass and flexibility: inner coordinates of all whiskers, then the coordinates of all bases."""
    inner = each.flexibility.shape[1]

    def mass_with(mass, axes):
        return mass[:inner, :inner], mass[:inner, inner:] @ axes, quadratic_of(axes, mass[inner:, inner:])

    own, coupled, of_base = (_diagonal(blocks) for blocks in jax.vmap(mass_with)(forms.mass, axes))
    mass = jnp.block([[own, coupled], [coupled.T, of_base]])
    flexible = _diagonal(each.flexibility)
    held = jax.vmap(quadratic_of)(axes, each.held + forms.below)
    if problem.attached is not None:
        held -= problem.attached.held
    matrix, stiff = problem.flexibility.matrix, _diagonal(held)
    bases = inverse(jnp.eye(stiff.shape[0]) + matrix @ stiff) @ matrix
    follows = jnp.concatenate([_diagonal(each.follows @ axes), jnp.eye(stiff.shape[0])])
    total = follows @ bases @ follows.T
    total += jnp.pad(flexible, (0, stiff.shape[0]))
    return mass, (total + total.T) / 2


def _diagonal(blocks: Float[Array, "whiskers rows columns"]) -> Float[Array, "n m"]:
    return block_diag(*blocks)


def _by_whisker(
    mode: Float[Array, " n"], axes: Float[Array, "whiskers 3 axes"]
) -> tuple[Float[Array, "whiskers k"], Float[Array, "whiskers axes"]]:
    """Coordinates of each whisker, with the pose of its base in the scene, and coordinates of the bases."""
    whiskers, _, free = axes.shape
    inner, base = jnp.split(mode, [mode.size - whiskers * free])
    base = jnp.reshape(base, (whiskers, free))
    pose = jnp.sum(axes * base[:, None, :], axis=-1)
    return jnp.concatenate([jnp.reshape(inner, (whiskers, -1)), pose], axis=1), base


def _shape(forms: Forms, mode: Float[Array, " n"], ends: Float[Array, " elements"], points: int) -> Array:
    """Displacement of equidistant points of one whisker in a mode."""
    moved = forms.fields.at[:, :, :2] @ mode
    return interpolated(moved, ends, jnp.linspace(0.0, 1.0, points) * ends[-1])
