"""The equilibrium of one whisker under given loads, on a support that may also hold its shaft.

The rod is integrated from its top past all loads and springs to the base. The top is the tip, or the outermost load if
the whisker beyond it is free. The pose of the base and the load there are related by the springs between the base and
the drive. If something holds the shaft, its forces depend on where the whisker is: the pose of the top has three
unknowns. Otherwise the direction of the whisker at the top is the only unknown, and the angle of the base is the only
equation (Steigenberger 2013).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.attach import attached, on_unloaded
from jaxwhisker._equilibrium.dimensionless import sections
from jaxwhisker._equilibrium.line_loads import ScaledLineLoad, density_of, ends_of_lines, lines_of
from jaxwhisker._equilibrium.shaft_springs import Attachments, Laws, past, stretched, to_next
from jaxwhisker._model.motion import Frame, Pose
from jaxwhisker._model.scene import Units
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._path.deflection import LEAST_LOAD, ROD_STEPS, AbstractLoadedRod, AtBase, Shares, Unknowns
from jaxwhisker._rod import rod
from jaxwhisker._rod.rod import Section
from jaxwhisker._rod.walk import NO_POINTS, in_order, stretches, walk
from jaxwhisker._scan.applied_loads import Given, Loads, sorted_loads, with_load

CHECKED = np.linspace(0.0, 1.0, 17)[1:]  # points on each stretch between loads at which stability is checked
DRIVE = Frame(0.0, 0.0, 1.0, 0.0)  # pyright: ignore[reportArgumentType] (arrays would start JAX at import)


class LoadedRod(AbstractLoadedRod):
    """The dimensionless equations of one whisker, its loads and its support."""

    loads: Loads
    lines: tuple[ScaledLineLoad, ...]
    section: Section | None  # None for a uniform whisker
    rest: Float[Array, "3"]  # pose (x, y, angle to the upright) of the unloaded base
    compliance: Float[Array, "3"]  # of the base to forces and moment; zero for a clamp
    held: Float[Array, "3"]  # stiffness that is part of the compliance, but not of the support
    held_by: Attachments | None  # what holds the shaft
    laws: Laws
    ranks: Int[Array, " springs"]  # places of the support's springs on the shaft among those from the tip to the base

    @property
    def free_beyond(self) -> bool:
        """Whether nothing acts on the whisker beyond the outermost load."""
        return self.held_by is None and not self.lines

    @property
    def top(self) -> Float[Array, ""]:
        """Arc length from the base to the top."""
        return self.loads.position[0] if self.free_beyond else jnp.ones(())

    @property
    def uniform(self) -> bool:
        """Whether the rod is the same everywhere."""
        return self.section is None

    @property
    def stages(self) -> int:
        """Springs on the shaft, if there are any, grow before the loads do."""
        return 1 if self.held_by is None else 2

    @property
    def sizes(self) -> list[Scalar]:
        """Sizes of the springs, if there are any, and of the loads."""
        return [self.load] if self.held_by is None else [jnp.ones(()), self.load]

    @property
    def load(self) -> Float[Array, ""]:
        """Size of all loads together, positive."""
        size = jnp.sum(jnp.abs(self.loads.force) + jnp.abs(self.loads.moment)) + LEAST_LOAD
        return size + sum(line.size for line in self.lines)

    @property
    def unbent(self) -> Unknowns:
        """The unknowns without springs and loads."""
        x, y, angle = on_unloaded(self.top, self.section, Pose(*self.rest))
        pose = [x, y, angle + np.pi / 2]
        return jnp.stack(pose[2:] if self.held_by is None else pose)

    def at_base(self, unknowns: Unknowns, shares: Shares) -> AtBase:
        """The end of the rod, with shares of the springs, if there are any, and the loads."""
        end, _, _ = _walk(self, unknowns, shares, NO_POINTS, ROD_STEPS)
        return _at_base(self, end, shares)

    def refined(self, unknowns: Unknowns, shares: Shares) -> tuple[AtBase, Bool[Array, ""]]:
        """The end of a rod with twice as many steps, and whether the equilibrium is stable.

        The poses along the rod change with the unknowns. An equilibrium under dead loads is stable if the determinant
        of this change is positive everywhere, and that of the equations at the base as well: each zero of the
        determinant adds an unstable mode to the part of the whisker beyond it, clamped there (Jacobi's condition).
        """

        def walked(top):
            end, (_, states, _), _ = _walk(self, top, shares, CHECKED, -(-2 * ROD_STEPS // CHECKED.size))
            fine, along = _at_base(self, end, shares), _pose(states)
            return (along if self.held_by is not None else along[:, 2:], fine.missed), fine

        (along, slope), fine = jax.jacfwd(walked, has_aux=True)(unknowns)
        return fine, jnp.all(jnp.linalg.det(along) > 0) & (jnp.linalg.det(slope) > 0)


class Bent(NamedTuple):
    """A whisker in equilibrium, dimensionless, with its shape as in `deflect`."""

    load: Float[Array, "3"]  # forces and moment that the shaft carries at its base
    pose: Float[Array, "3"]  # of the base
    lengths: Float[Array, " springs"]  # of springs on the shaft, from the tip to the base
    states: rod.RodStates  # at the points of the shape, from the base to the tip
    s: rod.Along
    moment: rod.Along


def loaded_rod(whisker: Whisker, loads: Given, support: Support) -> LoadedRod:
    """The equations of a whisker, its loads and its support."""
    length, stiffness = whisker.length, whisker.base_stiffness
    unit = Units(*(jnp.asarray(u, dtype=float) for u in (length, stiffness / length**2, stiffness / length, length)))
    springs = attached(support, sections((whisker,), length, stiffness), unit)
    hold = None if springs is None else support.hold(unit.force / unit.length, unit.moment)
    flexibility, mount = support.flexibility(hold), support.mounts[0]
    framed = flexibility.in_frames(jnp.zeros(1), unit.length, unit.force)
    rest = jnp.array([mount.x / length, mount.y / length, mount.angle], dtype=float) + framed.offset
    held, held_by, ranks = jnp.zeros(3), None, jnp.zeros(0, int)
    if springs is not None:
        assert hold is not None
        held = hold[0] / jnp.stack([unit.force / unit.length, unit.force / unit.length, unit.moment])
        held_by, ranks = jax.tree.map(lambda leaf: leaf[0], (springs.held_by, springs.ranks))
    section = None if whisker.uniform else whisker.section(length, stiffness)
    given, lines = sorted_loads(whisker, loads), lines_of(whisker, loads)
    laws = () if springs is None else springs.laws
    return LoadedRod(given, lines, section, rest, jnp.diagonal(framed.matrix), held, held_by, laws, ranks)


def _start(top: Unknowns) -> rod.RodState:
    """State of the rod at the top; its position is the origin unless it is one of the unknowns."""
    *position, angle = top
    x, y = position or (jnp.zeros(()), jnp.zeros(()))
    return x, y, jnp.cos(angle), jnp.sin(angle)


def _walk(
    rods: LoadedRod,
    top: Unknowns,
    shares: Shares,
    points: Float[np.ndarray, " points"],
    steps: int,
):
    """From the top to the base, with shares of the springs, if there are any, and the loads.

    Args:
        rods: see LoadedRod.
        top: the unknowns: see there.
        shares: of the springs' tensions and of the loads.
        points: on each stretch between loads: see `stretches`.
        steps: of the rod between two places.

    Returns:
        State and load at the end of the walk; arc lengths, states and loads at the points; states and loads at springs.
    """
    factor = shares[-1]
    held_by = None if rods.held_by is None else rods.held_by.weakened(shares[0])
    tissue, springs = (None, None) if held_by is None else (held_by.tissue, held_by.springs)
    at, loaded, inside, _ = stretches(rods.loads.position, points, beyond=not rods.free_beyond)
    # Of places that coincide, springs come last: what the shaft carries at its base excludes those there and below.
    order = in_order(at, ends_of_lines(rods.lines), jnp.zeros(0) if springs is None else springs.at)
    loads = jax.tree.map(lambda leaf: jnp.zeros(at.size).at[loaded].set(leaf), rods.loads)

    def onwards(state, load, s, stop):
        given = density_of(rods.lines, s, stop, factor)
        return *to_next(state, load, s, stop, rods.section, tissue, DRIVE, steps=steps, given=given), None

    def behind(load, state, place):
        load_there, spring = place
        if spring is not None:
            load = past(load, spring, rods.laws, state, DRIVE, 1.0)
        return with_load(load, load_there, state, factor)

    places = order.spread(0, loads), order.spread(2, springs)
    nothing = rod.Load(*[jnp.zeros(())] * 3)
    walked = walk(onwards, behind, _start(top), nothing, jnp.maximum(order.at, 0.0), places)

    def passed(rank):
        return jax.tree.map(lambda leaf: leaf[rank - 1], (walked.passed, walked.loads))  # nothing is the first place

    at_points = at[inside], *passed(order.ranks[0][inside])
    return (walked.end, walked.load), at_points, passed(order.ranks[2])


def _about(x: Scalar, y: Scalar, load: rod.Load) -> Float[Array, "3"]:
    """Forces and the moment about a point."""
    return jnp.stack([*map(jnp.asarray, (load.force_x, load.force_y, rod.moment(x, y, load)))])


def _pose(state: rod.RodState | rod.RodStates) -> Float[Array, "*batch 3"]:
    x, y, cos, sin = state
    return jnp.stack([*map(jnp.asarray, (x, y, jnp.arctan2(-cos, sin)))], axis=-1)


def _at_base(rods: LoadedRod, end: tuple[rod.RodState, rod.Load], shares: Shares) -> AtBase:
    """Pose of the rod's end minus that of the base under the load there, as far as it must vanish; and the former."""
    state, load = end
    pose, total = _pose(state), _about(state[0], state[1], load)
    if rods.held_by is None:
        return AtBase((pose - rods.rest - rods.compliance * total)[2:], pose)
    total = total + shares[0] * rods.held * (pose - rods.rest)
    return AtBase(pose - rods.rest - rods.compliance * total, pose)


def bent(rods: LoadedRod, top: Unknowns, points: int) -> Bent:
    """The equilibrium with these unknowns, and its shape at `points` points on each stretch between loads."""
    steps = -(-ROD_STEPS // (points - 1))
    _, (s, line, load), (passed, _) = _walk(rods, top, jnp.ones(rods.stages), np.linspace(0.0, 1.0, points), steps)
    if rods.free_beyond:
        nothing = rod.Load(*[jnp.zeros(())] * 3)
        # A straight line needs two points.
        count, beyond = 2 if rods.section is None else points, 1 - rods.top
        free = rod.points(_start(top), -beyond, nothing, rods.section, count=count, from_base=rods.top)
        line = jax.tree.map(lambda first, rest: jnp.concatenate([first[:0:-1], rest]), free, line)
        load = jax.tree.map(lambda leaf: jnp.pad(leaf, (count - 1, 0)), load)
        s = jnp.concatenate([(rods.top + beyond * jnp.linspace(0.0, 1.0, count))[:0:-1], s])
    else:
        # The outermost load is the last point beyond it and the first one below it.
        line, load, s = jax.tree.map(lambda leaf: jnp.delete(leaf, points - 1), (line, load, s))
    moment = jnp.asarray(rod.moment(line[0], line[1], load))
    (x, y, cos, sin), carried = jax.tree.map(lambda leaf: leaf[-1], (line, load))
    on_base, pose = _about(x, y, carried), _pose((x, y, cos, sin))
    lengths = jnp.zeros(0)
    if rods.held_by is None:
        pose = rods.rest + rods.compliance * on_base
        line = (line[0] - x + pose[0], line[1] - y + pose[1], *line[2:])
    else:
        springs = rods.held_by.springs
        lengths = jax.vmap(lambda spring, state: jnp.asarray(stretched(spring, state, DRIVE)[0]))(springs, passed)
    line, s, moment = jax.tree.map(lambda leaf: leaf[::-1], (line, s, moment))
    return Bent(on_base, pose, lengths, line, s, moment)
