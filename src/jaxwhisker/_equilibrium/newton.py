"""Newton's method for all whiskers on their network of springs.

The unknowns are the contacts z, of shape (whiskers, 3), and the control u. If springs connect the shafts of two
whiskers, their loads are further unknowns, and part of z (couplings.py). In the problem `AlongX` (see problem.py),
each whisker has two equations of its own: its base stays upright and at height 0. They leave one degree of freedom, the
position along the whisker's branch. In `InPlane` a whisker has no equations of its own, and two further degrees of
freedom across the branch. The network couples the whiskers:

    pose = rest + flexibility @ load.

Pose and load of a base are its x coordinate and the force along x in `AlongX`; in `InPlane` they are x, y, angle and
force x, force y, moment. One more equation, the condition, selects a point of the path: a given control, an arc length
ahead, or an event.

A Newton step first eliminates each whisker's own equations (static condensation), and then solves the small dense
system of the network and the condition. This system is regular at folds.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.linear_algebra import block_diagonal, solve, times_block_diagonal
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import (
    FORCE,
    LEAN,
    PARAMETER,
    SLACK,
    BaseEquations,
    LinearisedEquations,
    Phase,
    of_each,
)
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.couplings import Coupled, CouplingRows, as_contacts, loads_in, rows
from jaxwhisker._equilibrium.friction import LIGHT, Friction
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker, Poses
from jaxwhisker._rod.elastica import AbstractRod


def with_dummy_contacts(
    problem: Problem, z: Contacts, phase: Int[Array, " whiskers"]
) -> tuple[Contacts, Int[Array, " whiskers"]]:
    """Replace the contacts and phases of free whiskers by a dummy contact.

    Free whiskers are computed like the others. A contact of zeros would be singular, and its NaN derivatives would
    reach all parameters through a product with zero.
    """
    if problem.attached is not None:
        return z, phase
    parameter = problem.placeholder_parameter
    dummy = jnp.stack([jnp.ones_like(parameter), parameter, -jnp.ones_like(parameter)], axis=1)
    free = phase == Phase.free
    return jnp.where(free[:, None], dummy, z), jnp.where(free, Phase.tip, phase)


def linearise_all(
    problem: Problem, point: Point, state: ContactState, rates: AbstractRod, sequential: bool
) -> LinearisedEquations:
    """The equations of every whisker, linearised."""
    z, phase = with_dummy_contacts(problem, point.z, state.phase)
    linearised = partial(contact.linearise, rates=rates)
    bodies = problem.bodies(point.u, z, state.piece)
    return of_each(bodies, linearised, z, phase, state.side, state.friction, sequential=sequential)


def evaluate(problem: Problem, point: Point, state: ContactState) -> BaseEquations:
    """Values of every whisker's equations; free whiskers must have dummy contacts."""
    bodies = problem.bodies(point.u, point.z, state.piece)
    return of_each(bodies, contact.equations, point.z, state.phase, state.side, state.friction)


def slope_sines(problem: Problem, state: ContactState, parameters: PerWhisker) -> PerWhisker:
    """sin(alpha) of the object at every contact, from the profile's parameters there."""
    return jax.vmap(lambda piece, at: problem.profile.point_on(piece, at).sin)(state.piece, parameters)


def pose_of(base: BaseEquations, axes: int) -> Float[Array, "whiskers axes *of"]:
    """Coordinates of the bases, or their derivatives, stacked."""
    return jnp.stack([base.x, base.y, base.turn][:axes], axis=1)


def load_of(base: BaseEquations, axes: int) -> Float[Array, "whiskers axes *of"]:
    """Loads on the bases, or their derivatives, stacked."""
    return jnp.stack([base.force_x, base.force_y, base.moment][:axes], axis=1)


def slip_by_contact(problem: Problem, z: Contacts, state: ContactState) -> Contacts:
    """Derivatives of the distances slipped along the object, positive towards +x, of contacts that slip."""
    speeds = jax.vmap(lambda piece, p: problem.profile.on(piece).speed(p))(state.piece, z[:, PARAMETER])
    return _widened(jnp.stack([jnp.zeros_like(speeds), speeds, contact.beyond(state.side, state.phase)], axis=1), z)


def _widened(array: Float[Array, "whiskers 3 *more"], like: Contacts) -> Float[Array, "whiskers numbers *more"]:
    """The array with zeros for the loads of springs between two shafts."""
    loads = like.shape[1] - 3
    return jnp.pad(array, [(0, 0), (0, loads)] + [(0, 0)] * (array.ndim - 2)) if loads else array


def contact_parameters(problem: Problem, z: Contacts, state: ContactState) -> PerWhisker:
    """The profile's parameters at all contacts; free whiskers must have dummy contacts if these are differentiated."""
    own = state.piece, z, state.phase, state.side, state.friction
    return jnp.asarray(jax.vmap(lambda piece, *at: contact.parameter(problem.profile.on(piece), *at))(*own))


ROUNDING = 5e-15  # residual, relative to its terms, that rounding may cause


def is_light(state: ContactState, z: Contacts) -> Bool[Array, " whiskers"]:
    """Whether contacts stick whose force is too small for its lean to be known."""
    return state.sticks & (z[:, FORCE] <= LIGHT)


def with_slips(
    problem: Problem, z: Contacts, state: ContactState, slip: Int[Array, " whiskers"], at: PerWhisker
) -> tuple[Contacts, ContactState]:
    """The same contacts, at these parameters, which from here on slip in these directions or stick (0)."""
    assert state.friction is not None and problem.friction_angle is not None
    old, limit = state.friction, problem.friction_angle
    begins = (slip == 0) & (old.slip != 0)
    friction = Friction(
        slip,
        jnp.where(begins, at, old.parameter),
        jnp.where(begins, contact.beyond(z[:, SLACK], state.phase), old.beyond),
    )
    leans = jnp.clip(jnp.where(old.slip == 0, z[:, LEAN], old.slip * limit), -limit, limit)
    light = begins & (z[:, FORCE] <= LIGHT)
    # A first guess: the force that begins to bend a straight whisker acts across it.
    leans = jnp.where(light, state.side * jnp.minimum(z[:, SLACK], 0.0), leans)
    z = z.at[:, FORCE].set(jnp.where(light, LIGHT, z[:, FORCE])).at[:, LEAN].set(jnp.where(slip == 0, leans, at))
    return z, state._replace(friction=friction)


def _beyond_rounding(residual: Array, terms: Array | float) -> Array:
    """A residual of lengths or angles, zero where it is no larger than the rounding errors of its terms.

    A short or nearly straight whisker that sticks is held by an axial force on which its shape hardly depends: rounding
    errors of 1e-16 would change this force by 1e-6, and differently in every Newton step.
    """
    return jnp.where(jnp.abs(residual) > ROUNDING * (1 + jnp.abs(terms)), residual, 0.0)


def _without_rounding(value: BaseEquations, held: Float[Array, "whiskers 2"] | None) -> BaseEquations:
    """The values with bases exactly at the height and angle at which they are held, if only rounding moves them."""
    y, turn = (0.0, 0.0) if held is None else held.T
    y, turn = y + _beyond_rounding(value.y - y, y), turn + _beyond_rounding(value.turn - turn, turn)
    return value._replace(y=y, turn=turn)


class Condensed(NamedTuple):
    """The linearised whiskers after elimination of their own equations.

    The step of a contact is `particular` plus a linear combination of the columns of `basis`: a step along the
    whisker's branch and, in `InPlane`, two steps across it. Free whiskers have no branch: these entries are zero, and
    the steps displace the base directly.
    """

    particular: Contacts
    basis: Float[Array, "whiskers numbers axes"]  # the first column is the branch, on which the base keeps y and angle
    pose: Poses  # after the particular step; meaningless for free whiskers, whose base the network determines
    load: Poses
    pose_by: Float[Array, "whiskers axes axes"]  # derivative with respect to the steps
    load_by: Float[Array, "whiskers axes axes"]
    pose_by_u: Poses | None  # derivative with respect to the control at a fixed contact; None in `AlongX`
    load_by_u: Poses | None
    slope_sin: PerWhisker
    slope_sin_gradient: Contacts
    own: Float[Array, " equations"]  # residuals of the whiskers' own equations
    coupled: Coupled | None = None  # None without springs between two shafts

    @property
    def by_x(self) -> PerWhisker:
        """Rate at which bases move along x when contacts move along their branches."""
        return self.pose_by[:, 0, 0]


class Apart(NamedTuple):
    """Bases that are moved one by one, as in a snap, without the equations of the network and the condition."""

    now: Bool[Array, ""]  # whether they are: a batch does both
    held: Float[Array, "whiskers 2"] | None  # y and angle of the bases; None in `AlongX`


def condense(
    problem: Problem, contacts: Contacts, state: ContactState, linear: LinearisedEquations, apart: Apart | None = None
) -> Condensed:
    """Eliminate each whisker's own equations."""
    axes, z, (value, gradient, by_u, by_loads) = problem.axes, contacts[:, :3], linear
    touching, solved = state.touches, problem.solved(state.phase)
    scale = scale_of(z)
    y, turn = gradient.y * scale, gradient.turn * scale
    normal = jnp.cross(turn, y)
    length = jnp.sqrt(jnp.sum(normal**2, axis=-1, keepdims=True))
    tangent = normal / length
    # The smallest steps that change y but not turn, and turn but not y.
    by_y, by_turn = jnp.cross(tangent, turn), jnp.cross(y, tangent)
    own, columns = (value.y, value.turn), [tangent]
    if axes > 1:
        columns += [by_y / length, by_turn / length]
        # In `InPlane` these are not equations, but where bases are held.
        own = tuple(jnp.zeros_like(actual) for actual in own)
        if apart is not None and apart.held is not None:
            pairs = zip((value.y, value.turn), apart.held.T, strict=True)
            own = tuple(jnp.where(apart.now, actual - held, 0.0) for actual, held in pairs)
    particular = -(own[0][:, None] * by_y + own[1][:, None] * by_turn) / length

    def if_solved(array, otherwise: float | Array = 0.0):
        return jnp.where(jnp.reshape(solved, (-1, *[1] * (array.ndim - 1))), array, otherwise)

    basis = if_solved(jnp.stack(columns, axis=-1) * scale[:, :, None])
    particular = if_solved(particular * scale)
    pose_gradient, load_gradient = pose_of(gradient, axes), load_of(gradient, axes)  # (whiskers, axes, 3)

    def by_steps(gradient):
        return jnp.sum(gradient[..., None] * basis[(slice(None), *[None] * (gradient.ndim - 2))], axis=-2)

    def moved(value, gradient):
        return value + jnp.sum(gradient * particular[(slice(None), *[None] * (gradient.ndim - 2))], axis=-1)

    coupled = None
    if by_loads is not None and by_u is not None:
        coupled = Coupled(
            moved(jnp.asarray(value.places), jnp.asarray(gradient.places)),
            by_steps(jnp.asarray(gradient.places)),
            jnp.asarray(by_u.places),
            jnp.asarray(by_loads.places),
            pose_of(by_loads, axes),
            load_of(by_loads, axes),
        )
    return Condensed(
        _widened(particular, contacts),
        _widened(basis, contacts),
        pose=moved(pose_of(value, axes), pose_gradient),
        load=if_solved(moved(load_of(value, axes), load_gradient)),
        pose_by=if_solved(by_steps(pose_gradient), jnp.eye(axes)),
        load_by=if_solved(by_steps(load_gradient)),
        pose_by_u=None if by_u is None else if_solved(pose_of(by_u, axes)),
        load_by_u=None if by_u is None else if_solved(load_of(by_u, axes)),
        slope_sin=jnp.where(touching, value.slope_sin, 0.0),
        slope_sin_gradient=_widened(jnp.where(touching[:, None], gradient.slope_sin, 0.0), contacts),
        own=jnp.concatenate([if_solved(part) for part in own]),
        coupled=coupled,
    )


class NewtonStep(NamedTuple):
    """A Newton step, and the tangent of the path from the same linear system."""

    step: Point
    tangent: Point  # of the path; condition . tangent = 1
    condensed: Condensed
    residual: Scalar  # largest residual of any equation, before the step
    pose: Poses  # after the step
    load: Poses
    tangent_pose: Poses


def newton_step(
    problem: Problem,
    state: ContactState,
    condition: PathCondition,
    point: Point,
    rates: AbstractRod | None = None,
    sequential: bool = False,
    apart: Apart | None = None,
) -> NewtonStep:
    """Solve the linearised equations of all whiskers, the network and the condition."""
    linear = linearise_all(problem, point, state, problem.rod if rates is None else rates, sequential)
    if state.friction is not None:
        linear = linear._replace(value=_without_rounding(linear.value, None if apart is None else apart.held))
    return solve_coupled(problem, state, condition, point, condense(problem, point.z, state, linear, apart), apart)


def solve_coupled(
    problem: Problem,
    state: ContactState,
    condition: PathCondition,
    point: Point,
    at: Condensed,
    apart: Apart | None = None,
) -> NewtonStep:
    """Solve the linearised equations of the network and the condition for condensed whiskers."""
    solved = problem.solved(state.phase)[:, None]
    coupled = solved if apart is None else solved & ~apart.now
    rest, displacement = problem.rest(point.u), problem.displacement(at.load)
    network = jnp.where(coupled, at.pose - rest - displacement, 0.0)
    if state.friction is not None:
        network = _beyond_rounding(network, jnp.abs(at.pose) + jnp.abs(rest) + jnp.abs(displacement))
    slope_sin = at.slope_sin + jnp.sum(at.slope_sin_gradient * at.particular, axis=-1)
    condition_residual = condition.residual(Point(point.z + at.particular, point.u), slope_sin)
    if apart is not None:
        condition_residual = jnp.where(apart.now, 0.0, condition_residual)
    system, parts = linear_system(problem, state, condition, at, apart), [jnp.ravel(network)]
    loads = load_rows(problem, at)
    if loads is not None and problem.attached is not None and problem.attached.couplings is not None:
        parts.append(jnp.ravel(loads_in(problem.attached.couplings, point.z) - loads.law))
    residuals = jnp.concatenate([*parts, jnp.reshape(condition_residual, 1)])
    last = np.eye(residuals.size)[-1]
    solution = solve(system, jnp.stack([-residuals, last], axis=1))
    step, pose, load = change_along(problem, at, solution[:, 0])
    tangent, tangent_pose, tangent_load = change_along(problem, at, solution[:, 1])
    load = at.load + load
    return NewtonStep(
        step._replace(z=step.z + at.particular),
        tangent,
        at,
        residual=jnp.max(jnp.abs(jnp.concatenate([at.own, residuals]))),
        pose=jnp.where(solved, at.pose + pose, problem.rest(point.u + step.u) + problem.displacement(load)),
        load=load,
        tangent_pose=jnp.where(solved, tangent_pose, problem.rest_rate(tangent.u) + problem.displacement(tangent_load)),
    )


Change = tuple[Point, Poses, Poses]  # of contacts and control, of poses, and of loads


def load_rows(problem: Problem, at: Condensed) -> CouplingRows | None:
    """The equations of the loads of springs between two shafts; None without any."""
    held = problem.attached
    if held is None or held.couplings is None or at.coupled is None:
        return None
    return rows(held.couplings, held.laws, held.held_by, at.coupled)


def change_along(problem: Problem, at: Condensed, steps: Float[Array, " rows"]) -> Change:
    """The changes when whiskers move along and across their branches, and loads of springs and the control change."""
    n, axes = at.load.shape
    own, loads, du = jnp.reshape(steps[: n * axes], (n, axes)), steps[n * axes : -1], steps[-1]
    z, pose, load = _times(at.basis, own), _times(at.pose_by, own), _times(at.load_by, own)
    if at.pose_by_u is not None and at.load_by_u is not None:
        pose, load = pose + at.pose_by_u * du, load + at.load_by_u * du
    if at.coupled is not None and problem.attached is not None and problem.attached.couplings is not None:
        pose, load = pose + _times(at.coupled.pose_by_loads, loads), load + _times(at.coupled.load_by_loads, loads)
        z += as_contacts(problem.attached.couplings, jnp.reshape(loads, (-1, 3)), z)
    return Point(z, du), pose, load


def along_steps(problem: Problem, at: Condensed, weight: Contacts) -> Float[Array, " steps"]:
    """Derivatives of a weighted sum of contacts with respect to the steps and the loads of springs."""
    by_steps = jnp.ravel(jnp.sum(weight[:, :, None] * at.basis, axis=1))
    if problem.attached is None or problem.attached.couplings is None:
        return by_steps
    return jnp.concatenate([by_steps, jnp.ravel(loads_in(problem.attached.couplings, weight))])


def linear_system(
    problem: Problem, state: ContactState, condition: PathCondition, at: Condensed, apart: Apart | None = None
) -> Float[Array, "rows rows"]:
    """Derivatives of the residuals of the network and the condition with respect to the steps and the control.

    Loads of springs between two shafts, and their equations, come between these. Whiskers `apart` keep their
    places along their branches, and the equations of the network and the condition are left out.
    """
    n, axes = at.load.shape
    solved, size = problem.solved(state.phase)[:, None], n * axes
    yields = times_block_diagonal(problem.flexibility.matrix, at.load_by)
    coupling = block_diagonal(at.pose_by) - jnp.where(jnp.repeat(solved, axes, axis=0), yields, 0.0)
    if at.pose_by_u is None or at.load_by_u is None:
        by_control = jnp.where(solved, -1.0, 0.0)
    else:
        by_control = jnp.where(solved, at.pose_by_u - problem.displacement(at.load_by_u), 0.0)
    weight = condition.weight_z + condition.vertex[:, None] * at.slope_sin_gradient
    along = along_steps(problem, at, weight)
    by_control, condition_u = jnp.ravel(by_control), jnp.asarray(condition.weight_u)
    if apart is not None:
        coupling = jnp.where(apart.now, jnp.eye(size), coupling)
        by_control, along = (jnp.where(apart.now, 0.0, value) for value in (by_control, along))
        condition_u = jnp.where(apart.now, 1.0, condition_u)
    loads = load_rows(problem, at)
    if loads is not None and at.coupled is not None:
        yields = jax.vmap(problem.displacement, in_axes=-1, out_axes=-1)(at.coupled.load_by_loads)
        by_loads = at.coupled.pose_by_loads - yields
        if apart is not None:  # such bases stay where they are when loads change
            by_loads = jnp.where(apart.now, at.coupled.pose_by_loads.at[:, 0].set(0.0), by_loads)
        by_loads = jnp.reshape(by_loads, (size, -1))
        coupling = jnp.block([[coupling, by_loads], [loads.by_steps, loads.by_loads]])
        by_control = jnp.concatenate([by_control, loads.by_u])
    return jnp.block([[coupling, by_control[:, None]], [along[None, :], condition_u[None, None]]])


def _times(
    matrices: Float[Array, "whiskers rows columns"], steps: Float[Array, "*whiskers columns"]
) -> Float[Array, "whiskers rows"]:
    return jnp.sum(matrices * jnp.expand_dims(steps, -2), axis=-1)
