"""Deflection of a whisker with springs or a foundation on its shaft, under given loads.

The forces of the springs depend on where the whisker is. The rod is therefore integrated from its tip, whose pose has
three unknowns, past all loads and springs to the base. The pose of the base and the load there are related by the
springs between the base and the drive, which gives three equations.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.attach import SHARES, attached
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.implicit import without_rule
from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws, ShaftSprings, past, stretched, to_next
from jaxwhisker._model.loads import PointForce, PointMoment
from jaxwhisker._model.motion import Frame
from jaxwhisker._model.scene import Units
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section
from jaxwhisker._scan.applied_loads import Loads, sorted_loads, with_load

NEWTON_STEPS = 20  # at most, for each increase of the loads
CONVERGED = 1e-10  # last Newton step
DRIVE = Frame(0.0, 0.0, 1.0, 0.0)  # pyright: ignore[reportArgumentType] (arrays would start JAX at import)


class HeldEquations(eqx.Module):
    """The dimensionless equations of one whisker, its loads, and what holds its shaft."""

    loads: Loads
    section: Section | None  # None for a uniform whisker
    rest: Float[Array, "3"]  # pose (x, y, angle to the upright) of the unloaded base
    compliance: Float[Array, "3"]  # of the base to forces and moment; zero for a clamp
    held: Float[Array, "3"]  # stiffness that is part of the compliance, but not of the support
    held_by: Attachments
    laws: Laws


class _Place(NamedTuple):
    """A place on the whisker: a spring, a load, or neither; the other fields are zero there."""

    spring: ShaftSprings
    load: Loads


class Held(NamedTuple):
    """A whisker in equilibrium, dimensionless, with its shape as in `deflect`."""

    load: Float[Array, "3"]  # forces and moment that the shaft carries at its base
    pose: Float[Array, "3"]  # of the base
    lengths: Float[Array, " springs"]  # of springs on the shaft, from the tip to the base
    states: rod.RodStates  # at the points of the shape, from the base to the tip
    s: rod.Along
    moment: rod.Along


def held_equations(
    whisker: Whisker, loads: tuple[PointForce | PointMoment, ...], support: Support
) -> tuple[HeldEquations, Int[Array, " springs"]]:
    """The equations, and the places of the support's springs on the shaft among `Held.lengths`."""
    length, stiffness = whisker.length, whisker.base_stiffness
    unit = Units(*(jnp.asarray(u, dtype=float) for u in (length, stiffness / length**2, stiffness / length, length)))
    hold = support.hold(unit.force / unit.length, unit.moment)
    springs, flexibility = attached(support, sections((whisker,), length, stiffness), unit), support.flexibility(hold)
    assert springs is not None and flexibility is not None
    framed, mount = flexibility.in_frames(jnp.zeros(1), unit.length, unit.force), support.mounts[0]
    held_by, ranks = jax.tree.map(lambda leaf: leaf[0], (springs.held_by, springs.ranks))
    equations = HeldEquations(
        sorted_loads(whisker, loads),
        None if whisker.uniform else whisker.section(length, stiffness),
        jnp.array([mount.x / length, mount.y / length, mount.angle], dtype=float) + framed.offset,
        jnp.diagonal(framed.matrix),
        hold[0] / jnp.stack([unit.force / unit.length, unit.force / unit.length, unit.moment]),
        held_by,
        springs.laws,
    )
    return equations, ranks


def _walk(
    equations: HeldEquations, tip: Float[Array, "3"], share: Scalar, factor: Scalar, grids: list[rod.Along], steps: int
):
    """From the tip to the base, with a share of the springs and `factor` times the loads.

    Args:
        equations: see HeldEquations.
        tip: its position and angle to +x.
        share: of the springs' tensions.
        factor: of the loads.
        grids: arc lengths of further points beyond the outermost load, and between each load and the next one.
        steps: of the rod between two places.

    Returns:
        State and load at the end of the walk; states and loads at the points, in order, and at the springs.
    """
    loads, held_by = equations.loads, equations.held_by.weakened(share)
    arcs = [jnp.append(grid, at) for grid, at in zip(grids, loads.position, strict=False)]
    at = jnp.concatenate([*arcs, grids[-1]])
    number, room = at.size, at.size + held_by.springs.at.size
    loaded = np.cumsum([grid.size + 1 for grid in grids[:-1]]) - 1
    # Springs come last where places coincide: what the shaft carries at its base excludes those at the base and below.
    none = jax.tree.map(lambda leaf: jnp.zeros(number, leaf.dtype), held_by.springs)._replace(at=at)
    springs = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), none, held_by.springs)
    every = _Place(springs, jax.tree.map(lambda leaf: jnp.zeros(room).at[loaded].set(leaf), loads))
    order = springs.order
    rank = jnp.argsort(order)

    def piece(carry, place):
        state, load, s = carry
        stop = jnp.maximum(place.spring.at, 0.0)
        state, load = to_next(state, load, s, stop, equations.section, held_by.tissue, DRIVE, steps=steps)
        here = tuple(map(jnp.asarray, state)), load
        load = past(load, place.spring, equations.laws, state, DRIVE, 1.0)
        return (state, with_load(load, place.load, state, factor), stop), here

    start = (tip[0], tip[1], jnp.cos(tip[2]), jnp.sin(tip[2])), rod.Load(*[jnp.zeros(())] * 3), jnp.ones(())
    (end, load, _), passed = jax.lax.scan(piece, start, jax.tree.map(lambda leaf: leaf[order], every))
    kinds = np.setdiff1d(np.arange(number), loaded), np.arange(number, room)
    points, sprung = (jax.tree.map(lambda leaf, kind=kind: leaf[rank[kind]], passed) for kind in kinds)
    return (end, load), points, sprung


def _misfit(
    equations: HeldEquations, tip: Float[Array, "3"], share: Scalar = 1.0, factor: Scalar = 1.0, *, steps: int
) -> Float[Array, "3"]:
    """Pose of the rod's end minus that of the base under the load there."""
    grids = [jnp.zeros(0)] * (equations.loads.position.size + 1)
    ((x, y, cos, sin), load), _, _ = _walk(equations, tip, share, factor, grids, steps)
    pose, total = jnp.stack([x, y, jnp.arctan2(-cos, sin)]), _about(x, y, load)
    total = total + share * equations.held * (pose - equations.rest)
    return pose - equations.rest - equations.compliance * total


def _about(x: Scalar, y: Scalar, load: rod.Load) -> Float[Array, "3"]:
    """Forces and the moment about a point."""
    return jnp.stack([*map(jnp.asarray, (load.force_x, load.force_y, rod.moment(x, y, load)))])


@eqx.filter_custom_jvp
def differentiable(tip: Float[Array, "3"], equations: HeldEquations, steps: int) -> Float[Array, "3"]:
    """The solved pose of the tip with its derivatives by the implicit function theorem (see implicit.py)."""
    del steps
    return without_rule(tip, equations)


@differentiable.def_jvp
def _(primals, tangents):
    tip, equations, steps = primals
    here = differentiable(tip, equations, steps)
    slope = jax.jacfwd(lambda tip: _misfit(equations, tip, steps=steps))(here)
    _, change = eqx.filter_jvp(lambda equations: _misfit(equations, here, steps=steps), (equations,), (tangents[1],))
    # With the inverse, the change enters linearly and JAX can transpose this.
    return here, -jnp.sum(solve(slope, jnp.eye(3)) * change, axis=-1)


def unbent_tip(equations: HeldEquations) -> Float[Array, "3"]:
    """The tip of the whisker without springs and loads."""
    zero, (x, y, angle) = jnp.zeros(()), equations.rest
    start, nothing = (x, y, -jnp.sin(angle), jnp.cos(angle)), rod.Load(None, zero, None)
    x, y, cos, sin = rod.integrate(start, -(zero + 1.0), nothing, equations.section, steps=16, from_base=zero)
    return jnp.stack([x, y, jnp.arctan2(sin, cos)])


def solved_tip(equations: HeldEquations, load_steps: int, steps: int) -> Float[Array, "3"]:
    """The tip on the branch of solutions that begins without springs and loads; first the springs grow, then loads."""

    def increase(carry, shares):
        tip, change = carry

        def newton(carry):
            tip, _, count = carry

            def twice(tip):
                value = _misfit(equations, tip, *shares, steps=steps)
                return value, value

            slope, value = jax.jacfwd(twice, has_aux=True)(tip)
            step = -solve(slope, value[:, None])[:, 0]
            return tip + step, jnp.max(jnp.abs(step)), count + 1

        def searching(carry):
            _, size, count = carry
            return (size > CONVERGED) & (count < NEWTON_STEPS)

        start = tip + change, jnp.asarray(jnp.inf), jnp.asarray(0)
        found, _, _ = jax.lax.while_loop(searching, newton, start)
        return (found, found - tip), None

    factors = jnp.linspace(0.0, 1.0, load_steps + 1)[1:]
    shares = jnp.concatenate([SHARES, jnp.ones(load_steps)]), jnp.concatenate([jnp.zeros(len(SHARES)), factors])
    (tip, _), _ = jax.lax.scan(increase, (unbent_tip(equations), jnp.zeros(3)), shares)
    return tip


def errors(equations: HeldEquations, tip: Float[Array, "3"], steps: int) -> tuple[Array, Array]:
    """Residuals with the given number of steps of the rod, and with twice as many."""
    return _misfit(equations, tip, steps=steps), _misfit(equations, tip, steps=2 * steps)


def held_state(equations: HeldEquations, tip: Float[Array, "3"], points: int, steps: int) -> Held:
    """The state with this tip, and the whisker's shape at `points` points on each stretch."""
    position = equations.loads.position
    base_only = [jnp.zeros(0)] * position.size + [jnp.zeros(1)]
    _, (base, carried), (states, _) = _walk(equations, tip, 1.0, 1.0, base_only, steps)
    x, y, cos, sin = (leaf[0] for leaf in base)
    springs = equations.held_by.springs
    lengths = jax.vmap(lambda spring, state: jnp.asarray(stretched(spring, state, DRIVE)[0]))(springs, states)
    ends = jnp.concatenate([jnp.ones(1), position, jnp.zeros(1)])
    # Rounding must not exchange points and loads, also on a stretch without length.
    share = jnp.linspace(0.0, 1.0, points)
    grids = [(a + (b - a) * share).at[-1].set(b) for a, b in itertools.pairwise(ends)]
    _, (line, load), _ = _walk(equations, tip, 1.0, 1.0, grids, -(-steps // (points - 1)))
    # The outermost load is the last point beyond it and the first one below it.
    line, load, s = jax.tree.map(lambda leaf: jnp.delete(leaf, points - 1)[::-1], (line, load, jnp.concatenate(grids)))
    load_at_base = _about(x, y, jax.tree.map(lambda leaf: leaf[0], carried))
    pose = jnp.stack([x, y, jnp.arctan2(-cos, sin)])
    moment = jnp.asarray(rod.moment(line[0], line[1], load))
    return Held(load_at_base, pose, lengths, line, s, moment)
