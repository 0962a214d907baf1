"""Equilibrium of all whiskers on their network of springs: residual, Newton step, stability.

Unknown are the contacts z, (whiskers, 3), and the control u. A whisker's own two equations (height and direction of its
base) leave one degree of freedom, its branch: z + particular + tangent * step. The network couples the branches by

    base_x = u + offset + flexibility @ force_x,

and one more equation, the row, says where on the path the solution is sought: at a given control, an arc length
further, or at an event. What remains to be solved is one (whiskers + 1) square system, regular at folds.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker import contact
from jaxwhisker._types import Scalar
from jaxwhisker.contact import Linear, Phase, of_each
from jaxwhisker.elastica import AbstractRod
from jaxwhisker.linear import positive_definite, solve
from jaxwhisker.scene import Problem

Contacts = Float[Array, "whiskers 3"]
PerWhisker = Float[Array, " whiskers"]


class Row(NamedTuple):
    """The equation that picks a point of the path; a weighted sum, so that each lane of a batch can have its own.

    weight_z . (z - z0) + weight_u (u - u0) + vertex . sin(alpha) + touch . (base_x - touch_x) = 0
    """

    weight_z: Contacts
    z0: Contacts
    weight_u: Scalar
    u0: Scalar
    vertex: PerWhisker
    touch: PerWhisker
    touch_x: PerWhisker


def at_control(u: Scalar, like: Contacts) -> Row:
    """The row that asks for a given control."""
    none = jnp.zeros_like(like)
    return Row(none, none, jnp.asarray(1.0), u, none[:, 0], none[:, 0], none[:, 0])


class Mode(NamedTuple):
    """What stays fixed while one system of equations holds."""

    phase: Int[Array, " whiskers"]
    side: PerWhisker  # +1: whisker comes (came) from the right of the object; -1: from the left
    separate: Bool[Array, ""]  # every whisker on its own branch, at rest in `step`: the network is not asked


class Point(NamedTuple):
    """A point of the path."""

    z: Contacts
    u: Scalar


class Local(NamedTuple):
    """The whiskers' own equations, eliminated. Free whiskers have no branch: zeros, and `by_x` one."""

    particular: Contacts
    tangent: Contacts
    x: PerWhisker  # base position; of free whiskers meaningless, the network decides
    force_x: PerWhisker
    by_x: PerWhisker  # d base_x / d step along the tangent
    by_force: PerWhisker
    slope_sin: PerWhisker
    slope_sin_gradient: Contacts
    height: PerWhisker  # residuals: base height and direction
    direction: PerWhisker


def scale_of(z: Contacts) -> Contacts:
    """Sizes in which changes of a contact are measured."""
    return jnp.ones_like(z).at[:, 0].add(jnp.abs(z[:, 0]))


def harmless(problem: Problem, z: Contacts, phase: Int[Array, " whiskers"]) -> tuple[Contacts, Int[Array, " whiskers"]]:
    """Contacts and phases with some bent whisker in place of every free one.

    A free whisker has no contact, but is computed all the same; zeros would be a singular one, whose NaN derivatives
    reach everybody through a product with zero.
    """
    touch = jax.lax.stop_gradient(problem.touch_right.parameter)
    bent = jnp.stack([jnp.ones_like(touch), jnp.where(jnp.isfinite(touch), touch, 0.0), -jnp.ones_like(touch)], axis=1)
    free = phase == Phase.free
    return jnp.where(free[:, None], bent, z), jnp.where(free, Phase.tip, phase)


def linearised(problem: Problem, z: Contacts, mode: Mode, rates: AbstractRod) -> tuple[Linear, Linear]:
    """Values and gradients of every whisker's equations."""
    at, phase = harmless(problem, z, mode.phase)
    return of_each(problem.bodies, partial(contact.linearise, rates=rates), at, phase, mode.side)


def values(problem: Problem, z: Contacts, phase: Int[Array, " whiskers"], side: PerWhisker) -> Linear:
    """Values of every whisker's equations; contacts and phases have to be `harmless`."""
    return of_each(problem.bodies, contact.equations, z, phase, side)


def local(z: Contacts, mode: Mode, value: Linear, gradient: Linear) -> Local:
    """Eliminate every whisker's own two equations."""
    touching = mode.phase != Phase.free
    scale = scale_of(z)
    y, cos = gradient.y * scale, gradient.cos * scale
    normal = jnp.cross(y, cos)
    length = jnp.sqrt(jnp.sum(normal**2, axis=-1, keepdims=True))
    tangent = normal / length
    # The step of least size that solves both equations; the rest of the freedom is the tangent.
    particular = -(value.y[:, None] * jnp.cross(cos, tangent) + value.cos[:, None] * jnp.cross(tangent, y)) / length

    def of_touching(array, otherwise=0.0):
        return jnp.where(touching[:, None] if array.ndim == 2 else touching, array, otherwise)

    particular, tangent = of_touching(particular * scale), of_touching(tangent * scale)
    return Local(
        particular,
        tangent,
        x=value.x + jnp.sum(gradient.x * particular, axis=-1),
        force_x=of_touching(value.force_x + jnp.sum(gradient.force_x * particular, axis=-1)),
        by_x=of_touching(jnp.sum(gradient.x * tangent, axis=-1), 1.0),
        by_force=of_touching(jnp.sum(gradient.force_x * tangent, axis=-1)),
        slope_sin=of_touching(value.slope_sin),
        slope_sin_gradient=of_touching(gradient.slope_sin),
        height=of_touching(value.y),
        direction=of_touching(value.cos),
    )


def yielding(problem: Problem, force_x: PerWhisker) -> PerWhisker:
    """Displacement of the bases under forces: flexibility @ force_x, nothing for a clamped whisker."""
    if problem.flexibility is None:
        return jnp.zeros_like(force_x)
    return jnp.sum(problem.flexibility.matrix * force_x, axis=-1)


def rest(problem: Problem, u: Scalar) -> PerWhisker:
    """Positions of the unloaded bases."""
    offset = jnp.zeros_like(problem.length) if problem.flexibility is None else problem.flexibility.offset
    return u + offset


class Step(NamedTuple):
    """A Newton step and what the same linear system says about the path."""

    step: Point
    tangent: Point  # of the path; row . tangent = 1
    local: Local
    residual: Scalar  # largest violation of any equation, before the step
    base_x: PerWhisker  # after the step
    force_x: PerWhisker
    base_x_tangent: PerWhisker


def missing(problem: Problem, row: Row, point: Point, slope_sin: PerWhisker, force_x: PerWhisker) -> Scalar:
    """By how much the row's equation misses zero."""
    free_x = rest(problem, point.u) + yielding(problem, force_x)
    along = jnp.sum(row.weight_z * (point.z - row.z0)) + row.weight_u * (point.u - row.u0)
    return along + jnp.sum(row.vertex * slope_sin) + jnp.sum(row.touch * (free_x - row.touch_x))


def newton_step(problem: Problem, mode: Mode, row: Row, point: Point, rates: AbstractRod | None = None) -> Step:
    """Solve the linearised equations of all whiskers, network and row."""
    value, gradient = linearised(problem, point.z, mode, problem.rod if rates is None else rates)
    return coupled(problem, mode, row, point, local(point.z, mode, value, gradient))


def coupled(problem: Problem, mode: Mode, row: Row, point: Point, at: Local) -> Step:
    """Solve the linearised equations of network and row for what the whiskers leave open."""
    touching, n = mode.phase != Phase.free, point.z.shape[0]
    network = jnp.where(touching, at.x - rest(problem, point.u) - yielding(problem, at.force_x), 0.0)
    coupling = jnp.diag(at.by_x)
    slope_sin = at.slope_sin + jnp.sum(at.slope_sin_gradient * at.particular, axis=-1)
    row_value = missing(problem, row, Point(point.z + at.particular, point.u), slope_sin, at.force_x)
    along = jnp.sum((row.weight_z + row.vertex[:, None] * at.slope_sin_gradient) * at.tangent, axis=-1)
    row_u = row.weight_u + jnp.sum(row.touch)
    if problem.flexibility is not None:
        matrix = problem.flexibility.matrix
        coupling = coupling - jnp.where(touching[:, None], matrix * at.by_force, 0.0)
        along += jnp.sum(row.touch[:, None] * matrix, axis=0) * at.by_force
    pull = jnp.where(touching, -1.0, 0.0)
    eye = jnp.eye(n)
    coupling = jnp.where(mode.separate, eye, coupling)
    pull, along = jnp.where(mode.separate, 0.0, pull), jnp.where(mode.separate, 0.0, along)
    row_u, row_value = jnp.where(mode.separate, 1.0, row_u), jnp.where(mode.separate, 0.0, row_value)
    wanted = jnp.where(mode.separate, 0.0, -network)
    system = jnp.block([[coupling, pull[:, None]], [along[None, :], row_u[None, None]]])
    right = jnp.zeros((n + 1, 2)).at[:n, 0].set(wanted).at[n, 0].set(-row_value).at[n, 1].set(1.0)
    solution = solve(system, right)
    (steps, du), (tangents, tu) = (solution[:n, 0], solution[n, 0]), (solution[:n, 1], solution[n, 1])
    step = Point(at.particular + at.tangent * steps[:, None], du)
    tangent = Point(at.tangent * tangents[:, None], tu)
    force_x = at.force_x + at.by_force * steps
    free_x = rest(problem, point.u + du) + yielding(problem, force_x)
    free_x_tangent = tu + yielding(problem, at.by_force * tangents)
    residual = jnp.max(jnp.abs(jnp.concatenate([at.height, at.direction, jnp.where(mode.separate, 0.0, network)])))
    return Step(
        step,
        tangent,
        at,
        residual=jnp.maximum(residual, jnp.abs(row_value)),
        base_x=jnp.where(touching, at.x + at.by_x * steps, free_x),
        force_x=force_x,
        base_x_tangent=jnp.where(touching, at.by_x * tangents, free_x_tangent),
    )


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


def stable(problem: Problem, mode: Mode, at: Local) -> Bool[Array, ""]:
    """Whether every whisker is on the stable part of its clamped branch, and the network holds them there.

    The stiffness K of the network minus the slopes d force_x / d base_x has to be positive definite. With K^-1 = L L^T
    that is 1 - L^T slopes L, which holds for rigid springs too.
    """
    touching = mode.phase != Phase.free
    ahead = mode.side * at.by_x * BRANCH_SIGN
    own = jnp.all(~touching | (ahead > 0))
    if problem.flexibility is None:
        return own
    slope = jnp.where(touching, at.by_force / jnp.where(at.by_x == 0, 1.0, at.by_x), 0.0)
    root = problem.flexibility.root
    n = root.shape[0]
    pull = jnp.sum(root[:, :, None] * slope[:, None, None] * root[:, None, :], axis=0)
    return own & positive_definite(jnp.eye(n) - pull)


BRANCH_SIGN = -1.0  # of d base_x along height x direction on a stable branch touched from the right
