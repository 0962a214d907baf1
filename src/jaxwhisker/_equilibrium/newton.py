"""Equilibrium of all whiskers on their network of springs: residual, Newton step, stability.

Unknown are the contacts z, (whiskers, 3), and the control u. A whisker whose base stays upright at its height has two
equations of its own, which leave one degree of freedom, its branch; the network couples the branches by

    pose = rest + flexibility @ load,

pose and load being those of the base along x. Where bases yield in y and angle, too, or the drive does not just move
along x, they are x, y and angle, and x, y and moment, seen in the frame in which the base would be without any load
(motion.py); a whisker then has three degrees of freedom: along its branch, and the two across it. One more equation,
the row, says where on the path the solution is sought: at a given control, an arc length further, or at an event. What
remains to be solved is one square system, regular at folds.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import positive_definite, solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import Linear, Phase, of_each
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._rod.elastica import AbstractRod

Contacts = Float[Array, "whiskers 3"]
PerWhisker = Float[Array, " whiskers"]
Poses = Float[Array, "whiskers axes"]


class Row(NamedTuple):
    """The equation that picks a point of the path; a weighted sum, so that each lane of a batch can have its own.

    weight_z . (z - z0) + weight_u (u - u0) + vertex . sin(alpha) = 0
    """

    weight_z: Contacts
    z0: Contacts
    weight_u: Scalar
    u0: Scalar
    vertex: PerWhisker


def at_control(u: Scalar, like: Contacts) -> Row:
    """The row that asks for a given control."""
    none = jnp.zeros_like(like)
    return Row(none, none, jnp.asarray(1.0), u, none[:, 0])


class Mode(NamedTuple):
    """What stays fixed while one system of equations holds."""

    phase: Int[Array, " whiskers"]
    side: PerWhisker  # +1: whisker comes (came) from the right of the object; -1: from the left
    separate: Bool[Array, ""]  # every whisker on its own branch, at rest along it: the network is not asked
    held: Float[Array, "whiskers 2"] | None = None  # then: the poses across it, where there is more than x


class Point(NamedTuple):
    """A point of the path."""

    z: Contacts
    u: Scalar


class Local(NamedTuple):
    """The whiskers' own equations, eliminated: what steps along and across their branches do.

    Free whiskers have no branch: zeros, and a pose that moves with the step.
    """

    particular: Contacts
    basis: Float[Array, "whiskers 3 axes"]  # first: the branch, along which y and angle of the base stay
    pose: Poses  # of free whiskers meaningless, the network decides
    load: Poses
    pose_by: Float[Array, "whiskers axes axes"]  # by the steps
    load_by: Float[Array, "whiskers axes axes"]
    pose_by_u: Poses | None  # by the control, at the same contact; None if it just goes with it
    load_by_u: Poses | None
    slope_sin: PerWhisker
    slope_sin_gradient: Contacts
    own: Float[Array, " equations"]  # residuals of the whiskers' own equations

    @property
    def tangent(self) -> Contacts:
        """Directions of the branches."""
        return self.basis[:, :, 0]

    @property
    def by_x(self) -> PerWhisker:
        """How bases move along their branches."""
        return self.pose_by[:, 0, 0]


def scale_of(z: Contacts) -> Contacts:
    """Sizes in which changes of a contact are measured."""
    return jnp.ones_like(z).at[:, 0].add(jnp.abs(z[:, 0]))


def dot(a: Point, b: Point, scale: Contacts) -> Scalar:
    """Inner product of two directions, contacts measured in `scale`."""
    return jnp.sum(a.z * b.z / scale**2) + a.u * b.u


def along(start: Point, direction: Point, distance: Scalar, bend: Point | None = None) -> Point:
    """The point a distance away, on a straight line or on a parabola."""
    half = 0.0 if bend is None else distance**2 / 2
    bend = direction if bend is None else bend
    return Point(start.z + distance * direction.z + half * bend.z, start.u + distance * direction.u + half * bend.u)


def unit(direction: Point, z: Contacts) -> tuple[Point, Scalar]:
    """The direction with unit length in the scale of z, and its length."""
    scale = scale_of(z)
    length = jnp.sqrt(dot(direction, direction, scale))
    return Point(direction.z / length, direction.u / length), length


def harmless(problem: Problem, z: Contacts, phase: Int[Array, " whiskers"]) -> tuple[Contacts, Int[Array, " whiskers"]]:
    """Contacts and phases with some bent whisker in place of every free one.

    A free whisker has no contact, but is computed all the same; zeros would be a singular one, whose NaN derivatives
    reach everybody through a product with zero.
    """
    touch = jax.lax.stop_gradient(problem.touch_right.parameter)
    bent = jnp.stack([jnp.ones_like(touch), jnp.where(jnp.isfinite(touch), touch, 0.0), -jnp.ones_like(touch)], axis=1)
    free = phase == Phase.free
    return jnp.where(free[:, None], bent, z), jnp.where(free, Phase.tip, phase)


def linearised(problem: Problem, point: Point, mode: Mode, rates: AbstractRod) -> tuple[Linear, Linear, Linear | None]:
    """Values, gradients by the contacts and derivatives by the control of every whisker's equations."""
    at, phase = harmless(problem, point.z, mode.phase)
    return of_each(problem.bodies(point.u), partial(contact.linearise, rates=rates), at, phase, mode.side)


def values(problem: Problem, point: Point, phase: Int[Array, " whiskers"], side: PerWhisker) -> Linear:
    """Values of every whisker's equations; contacts and phases have to be `harmless`."""
    return of_each(problem.bodies(point.u), contact.equations, point.z, phase, side)


def pose_of(seen: Linear, axes: int) -> Float[Array, "whiskers axes *of"]:
    """Poses of the bases, or their derivatives, stacked."""
    return jnp.stack([seen.x, seen.y, seen.turn][:axes], axis=1)


def load_of(seen: Linear, axes: int) -> Float[Array, "whiskers axes *of"]:
    """Loads on the bases, or their derivatives, stacked."""
    return jnp.stack([seen.force_x, seen.force_y, seen.moment][:axes], axis=1)


def local(problem: Problem, z: Contacts, mode: Mode, value: Linear, gradient: Linear, by_u: Linear | None) -> Local:
    """Eliminate what every whisker's own equations say of it."""
    axes = problem.axes
    touching = mode.phase != Phase.free
    scale = scale_of(z)
    y, turn = gradient.y * scale, gradient.turn * scale
    normal = jnp.cross(turn, y)
    length = jnp.sqrt(jnp.sum(normal**2, axis=-1, keepdims=True))
    tangent = normal / length
    # Steps of least size that change y and turn, and only one of them; the rest of the freedom is the tangent.
    by_y, by_turn = jnp.cross(tangent, turn), jnp.cross(y, tangent)
    own, columns = (value.y, value.turn), [tangent]
    if axes > 1:
        columns += [by_y / length, by_turn / length]
        held = jnp.zeros((2, 1)) if mode.held is None else mode.held.T
        own = tuple(jnp.where(mode.separate, has - wants, 0.0) for has, wants in zip(own, held, strict=True))
    particular = -(own[0][:, None] * by_y + own[1][:, None] * by_turn) / length

    def of_touching(array, otherwise: float | Array = 0.0):
        return jnp.where(jnp.reshape(touching, (-1, *[1] * (array.ndim - 1))), array, otherwise)

    basis = of_touching(jnp.stack(columns, axis=-1) * scale[:, :, None])
    particular = of_touching(particular * scale)
    pose_gradient, load_gradient = pose_of(gradient, axes), load_of(gradient, axes)  # (whiskers, axes, 3)

    def by_steps(gradient):
        return jnp.sum(gradient[:, :, :, None] * basis[:, None, :, :], axis=2)

    def moved(value, gradient):
        return value + jnp.sum(gradient * particular[:, None, :], axis=2)

    return Local(
        particular,
        basis,
        pose=moved(pose_of(value, axes), pose_gradient),
        load=of_touching(moved(load_of(value, axes), load_gradient)),
        pose_by=of_touching(by_steps(pose_gradient), jnp.eye(axes)),
        load_by=of_touching(by_steps(load_gradient)),
        pose_by_u=None if by_u is None else of_touching(pose_of(by_u, axes)),
        load_by_u=None if by_u is None else of_touching(load_of(by_u, axes)),
        slope_sin=of_touching(value.slope_sin),
        slope_sin_gradient=of_touching(gradient.slope_sin),
        own=jnp.concatenate([of_touching(part) for part in own]),
    )


def yielding(problem: Problem, load: Poses) -> Poses:
    """Displacement of the bases under loads: flexibility @ load, nothing for a clamped whisker."""
    if problem.flexibility is None:
        return jnp.zeros_like(load)
    return jnp.reshape(jnp.sum(problem.flexibility.matrix * jnp.ravel(load), axis=-1), load.shape)


def rest(problem: Problem, u: Scalar) -> Poses:
    """Poses of the unloaded bases: along x in the scene, or all three in their frames."""
    none = jnp.zeros((problem.length.shape[0], problem.axes))
    offset = none if problem.flexibility is None else jnp.reshape(problem.flexibility.offset, none.shape)
    return u + offset if problem.axes == 1 else offset


class Step(NamedTuple):
    """A Newton step and what the same linear system says about the path."""

    step: Point
    tangent: Point  # of the path; row . tangent = 1
    local: Local
    residual: Scalar  # largest violation of any equation, before the step
    pose: Poses  # after the step
    load: Poses
    tangent_pose: Poses


def missing(row: Row, point: Point, slope_sin: PerWhisker) -> Scalar:
    """By how much the row's equation misses zero."""
    along = jnp.sum(row.weight_z * (point.z - row.z0)) + row.weight_u * (point.u - row.u0)
    return along + jnp.sum(row.vertex * slope_sin)


def newton_step(problem: Problem, mode: Mode, row: Row, point: Point, rates: AbstractRod | None = None) -> Step:
    """Solve the linearised equations of all whiskers, network and row."""
    linear = linearised(problem, point, mode, problem.rod if rates is None else rates)
    return coupled(problem, mode, row, point, local(problem, point.z, mode, *linear))


def coupled(problem: Problem, mode: Mode, row: Row, point: Point, at: Local) -> Step:
    """Solve the linearised equations of network and row for what the whiskers leave open."""
    n, axes = at.load.shape
    touching, size = (mode.phase != Phase.free)[:, None], n * axes
    network = jnp.where(touching, at.pose - rest(problem, point.u) - yielding(problem, at.load), 0.0)
    slope_sin = at.slope_sin + jnp.sum(at.slope_sin_gradient * at.particular, axis=-1)
    missed = missing(row, Point(point.z + at.particular, point.u), slope_sin)
    # How poses move away from where the network wants them: with the steps, and with the control.
    coupling = at.pose_by[:, 0, 0, None] * jnp.eye(n) if axes == 1 else _blocks(at.pose_by)
    if problem.flexibility is not None:
        yields = by_blocks(problem.flexibility.matrix, at.load_by)
        coupling = coupling - jnp.where(jnp.repeat(touching, axes, axis=0), yields, 0.0)
    if at.pose_by_u is None or at.load_by_u is None:
        pull = jnp.where(touching, -1.0, 0.0)
    else:
        pull = jnp.where(touching, at.pose_by_u - yielding(problem, at.load_by_u), 0.0)
    weight = row.weight_z + row.vertex[:, None] * at.slope_sin_gradient
    along = jnp.ravel(jnp.sum(weight[:, :, None] * at.basis, axis=1))
    # Separate whiskers stay where they are along their branches: the network is not asked, and the row neither.
    apart = mode.separate
    coupling = jnp.where(apart, jnp.eye(size), coupling)
    pull, along, network = (jnp.where(apart, 0.0, jnp.ravel(value)) for value in (pull, along, network))
    row_u, missed = jnp.where(apart, 1.0, row.weight_u), jnp.where(apart, 0.0, missed)
    system = jnp.block([[coupling, pull[:, None]], [along[None, :], row_u[None, None]]])
    right = jnp.zeros((size + 1, 2)).at[:size, 0].set(-network).at[size, 0].set(-missed).at[size, 1].set(1.0)
    solution = solve(system, right)

    def moved(column):
        """Contacts, control, poses and loads, as they move with the whiskers' steps and the control."""
        steps, du = jnp.reshape(column[:size], (n, axes)), column[size]
        pose, load = _times(at.pose_by, steps), _times(at.load_by, steps)
        if at.pose_by_u is not None and at.load_by_u is not None:
            pose, load = pose + at.pose_by_u * du, load + at.load_by_u * du
        return Point(_times(at.basis, steps), du), pose, load

    step, pose, load = moved(solution[:, 0])
    tangent, tangent_pose, tangent_load = moved(solution[:, 1])
    load = at.load + load
    drawn = tangent.u if axes == 1 else 0.0
    return Step(
        step._replace(z=step.z + at.particular),
        tangent,
        at,
        residual=jnp.max(jnp.abs(jnp.concatenate([at.own, network, missed[None]]))),
        pose=jnp.where(touching, at.pose + pose, rest(problem, point.u + step.u) + yielding(problem, load)),
        load=load,
        tangent_pose=jnp.where(touching, tangent_pose, drawn + yielding(problem, tangent_load)),
    )


def _times(matrices: Float[Array, "whiskers rows axes"], steps: Poses) -> Float[Array, "whiskers rows"]:
    return jnp.sum(matrices * steps[:, None, :], axis=-1)


def _blocks(blocks: Float[Array, "whiskers axes axes"]) -> Float[Array, "rows rows"]:
    """The matrix with these blocks on its diagonal."""
    n, axes, _ = blocks.shape
    return jnp.reshape(jnp.eye(n)[:, None, :, None] * blocks[:, :, None, :], (n * axes, n * axes))


def by_blocks(matrix: Float[Array, "rows rows"], blocks: Float[Array, "whiskers axes axes"]):
    """A matrix times the one with these blocks on its diagonal."""
    n, axes, _ = blocks.shape
    if axes == 1:
        return matrix * blocks[:, 0, 0]
    return jnp.reshape(jnp.sum(jnp.reshape(matrix, (-1, n, axes, 1)) * blocks, axis=2), matrix.shape)


class _NewtonState(NamedTuple):
    step_size: Scalar
    number: Int[Array, ""]


class StructuredNewton(optx.AbstractRootFinder):
    """Newton's method for a function that brings its own Newton step along as auxiliary output.

    A stock Newton would push 3 * whiskers tangents through whiskers rods and solve a dense system. Here a whisker sees
    its own three only. The accepted point is one step better than the one that was tested, so that a tolerance of 1e-6
    gives an error near 1e-12.
    """

    rtol: float
    atol: float
    norm: Any = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        del fn, y, args, options, f_struct, aux_struct, tags
        return _NewtonState(jnp.asarray(jnp.inf), jnp.asarray(0))

    def step(self, fn, y, args, options, state, tags):
        del options, tags
        _, newton = fn(y, args)
        new = jax.tree.map(jnp.add, y, newton.step)
        size = jnp.max(jnp.abs(newton.step.z) / scale_of(y.z))
        return new, _NewtonState(jnp.maximum(size, jnp.abs(newton.step.u)), state.number + 1), newton

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        return state.step_size < self.atol, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, dict(step_size=state.step_size)


class Solution(NamedTuple):
    """A solved point; `newton` is the last linearisation, taken one step before it."""

    point: Point
    newton: Step
    converged: Bool[Array, ""]
    iterations: Int[Array, ""]


def find(problem: Problem, mode: Mode, row: Row, guess: Point) -> Solution:
    """Solve the equations of one point, starting from `guess`. Failure is a flag, never an exception."""

    # Derivatives are attached to the solution (implicit.py), not to how it was found.
    problem, row, guess = jax.lax.stop_gradient((problem, row, guess))

    def equations(point, args):
        problem, mode, row = args
        newton = newton_step(problem, mode, row, point)
        return newton.residual, newton

    solution = optx.root_find(
        equations,
        StructuredNewton(rtol=0.0, atol=problem.rod.newton_tolerance),
        guess,
        args=(problem, mode, row),
        has_aux=True,
        max_steps=problem.rod.newton_steps,
        throw=False,
    )
    finite = jnp.all(jnp.isfinite(solution.value.z)) & jnp.isfinite(solution.value.u)
    converged = (solution.result == optx.RESULTS.successful) & finite
    return Solution(solution.value, solution.aux, converged, solution.stats["num_steps"])


def slopes(mode: Mode, at: Local) -> Float[Array, "whiskers axes axes"]:
    """How the load on a touching base changes with its pose, d load / d pose; symmetric, as the load has an energy."""
    by_x = jnp.where(at.by_x == 0, 1.0, at.by_x)[:, None]
    along = at.load_by[:, :, 0] / by_x
    columns = [along]
    columns += [at.load_by[:, :, k] - along * at.pose_by[:, :1, k] for k in range(1, at.load.shape[-1])]
    return jnp.where((mode.phase != Phase.free)[:, None, None], jnp.stack(columns, axis=-1), 0.0)


def definite(problem: Problem, slope: Float[Array, "whiskers axes axes"]) -> Bool[Array, ""]:
    """Whether the network holds whiskers with these slopes: its stiffness minus the slopes is positive definite.

    With the flexibility L L^T that is 1 - L^T slopes L, which holds for rigid springs too.
    """
    if problem.flexibility is None:
        return jnp.asarray(True)
    root = problem.flexibility.root
    pull = jnp.sum(root[:, :, None] * by_blocks(root.T, slope).T[:, None, :], axis=0)
    return positive_definite(jnp.eye(root.shape[0]) - pull)


def held(mode: Mode, by_x: PerWhisker) -> Bool[Array, " whiskers"]:
    """Whether whiskers are on the stable part of their clamped branch.

    Along it a whisker's base moves as it did from first touch on; between two folds it moves back.
    """
    return mode.side * by_x * BRANCH_SIGN > 0


def stable(problem: Problem, mode: Mode, at: Local) -> Bool[Array, ""]:
    """Whether every whisker is on the stable part of its clamped branch, and the network holds them there."""
    own = jnp.all((mode.phase == Phase.free) | held(mode, at.by_x))
    return own & definite(problem, slopes(mode, at)) if problem.flexibility is not None else own


BRANCH_SIGN = -1.0  # of d base_x along angle x height on a stable branch touched from the right
