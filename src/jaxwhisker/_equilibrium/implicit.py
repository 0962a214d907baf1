"""Derivatives of solved points by the implicit function theorem; they do not depend on the solver's iterations."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import without_rule
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, BaseEquations, LinearisedEquations
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.couplings import Places, as_contacts, law_of, loads_in
from jaxwhisker._equilibrium.friction import Friction
from jaxwhisker._equilibrium.newton import (
    Condensed,
    along_steps,
    change_along,
    condense,
    contact_parameters,
    evaluate,
    linear_system,
    slip_by_contact,
    slope_sines,
    with_dummy_contacts,
)
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, at_control, scale_of
from jaxwhisker._equilibrium.problem import Problem


@eqx.filter_custom_jvp
def solved(point: Point, problem: Problem, state: ContactState, condition: PathCondition) -> Point:
    """The solution of the equations, with its derivatives by problem, condition and the places where contacts stick.

    The derivative is minus the inverse Jacobian times the derivative of the equations, which is the derivative of a
    Newton step that starts at the solution.
    """
    return without_rule(point, (problem, state.friction, condition))


@solved.def_jvp
def _(primals, tangents):
    point, problem, state, condition = primals
    _, problem_dot, mode_dot, condition_dot = tangents
    here = solved(point, problem, state, condition)
    known, known_dot = (problem, state.friction), (problem_dot, mode_dot.friction)
    return here, _implicit_step(here, known, state, condition, known_dot, condition_dot).drift


Known = tuple[Problem, Friction | None]  # the numbers that equilibria depend on


def _linear(function, *at):
    """Value of a function and its differential, which takes tangents (None for zero). The function is traced once."""
    some, rest = eqx.partition(at, eqx.is_inexact_array)
    value, push = jax.linearize(lambda some: function(*eqx.combine(some, rest)), some)

    return value, lambda *tangents: push(_dense(some, tangents))


def _dense(tree, dots):
    """Tangents of a tree's real values, with zeros where they are None."""
    some = eqx.filter(tree, eqx.is_inexact_array)
    return jax.tree.map(
        lambda x, dot: x if x is None else jnp.zeros_like(x) if dot is None else dot,
        some,
        dots,
        is_leaf=lambda leaf: leaf is None,
    )


def _no_tangents(tree):
    return jax.tree.map(lambda _: None, tree)


def _tangent(function, at, dot):
    """Tangent of a function's value; 0 if all tangents `dot` are None."""
    found = eqx.filter_jvp(function, (at,), (dot,))[1]
    return 0.0 if found is None else found


class _ImplicitStep(NamedTuple):
    """The linearised equations at a solution."""

    at: Condensed
    linear: LinearisedEquations
    drift: Point  # tangent of the solution for given tangents of problem and condition
    tangent: Point  # of the path
    inverse: Float[Array, "rows rows"]  # of the linear system


def _implicit_step(
    here: Point, known: Known, state: ContactState, condition: PathCondition, known_dot, condition_dot
) -> _ImplicitStep:
    """Solve the linearised equations at a solution for tangents of the numbers and the condition (None for zero)."""
    problem, problem_dot = known[0], known_dot[0]
    z, phase = with_dummy_contacts(problem, here.z, state.phase)

    def values(known: Known, z: Contacts, u: Scalar) -> BaseEquations:
        return evaluate(known[0], Point(z, u), state._replace(phase=phase, friction=known[1]))

    value, differential = _linear(values, known, z, here.u)

    def by(z_dot: Callable[[Array], Contacts], directions: Array) -> BaseEquations:
        columns = jax.vmap(lambda e: differential(_no_tangents(known), z_dot(e), None))(directions)
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), columns)

    # A whisker's equations depend on its own contact only: three directions serve all whiskers.
    gradient = by(lambda e: jnp.broadcast_to(e, z.shape), jnp.eye(3, z.shape[1]))
    by_u = differential(_no_tangents(known), None, jnp.ones_like(here.u)) if problem.frames_move else None
    by_loads, couplings = None, None if problem.attached is None else problem.attached.couplings
    if couplings is not None:
        each = jnp.eye(couplings.columns.size).reshape(-1, *couplings.columns.shape)
        by_loads = by(lambda loads: as_contacts(couplings, loads, z), each)
    linear = LinearisedEquations(value, gradient, by_u, by_loads)
    at = condense(problem, here.z, state, linear)
    # Residuals are linear in the values, and so are their tangents in those of the values.
    dot = condense(problem, here.z, state, linear._replace(value=differential(known_dot, None, None)))
    yielding_dot = _tangent(lambda problem: problem.rest(here.u) + problem.displacement(at.load), problem, problem_dot)
    solves = problem.solved(state.phase)[:, None]
    network_dot = jnp.where(solves, dot.pose - yielding_dot - problem.displacement(dot.load), 0.0)
    condition_dot = (
        jnp.zeros(())
        if condition_dot is None
        else _tangent(lambda condition: condition.residual(here, at.slope_sin), condition, condition_dot)
    )
    slope_sin_dot = dot.slope_sin + jnp.sum(dot.slope_sin_gradient * dot.particular, axis=-1)
    condition_dot += jnp.sum(condition.weight_z * dot.particular) + jnp.sum(condition.vertex * slope_sin_dot)
    # The inverse does not depend on tangents, in which everything else is linear.
    system = linear_system(problem, state, condition, at)
    inverse = solve(system, jnp.eye(system.shape[0]))
    parts = [jnp.ravel(network_dot)]
    if at.coupled is not None and dot.coupled is not None:
        given, given_dot = (problem, at.coupled.places), (problem_dot, dot.coupled.places)
        parts.append(jnp.asarray(_tangent(partial(_loads_residual, here.z), given, given_dot)))
    residual_dot = jnp.concatenate([*parts, jnp.reshape(jnp.asarray(condition_dot), 1)])
    drift, _, _ = change_along(problem, at, -jnp.sum(inverse * residual_dot, axis=1))
    tangent, _, _ = change_along(problem, at, inverse[:, -1])
    return _ImplicitStep(at, linear, drift._replace(z=drift.z + dot.particular), tangent, inverse)


def _loads_residual(z: Contacts, given: tuple[Problem, Places]) -> Float[Array, " loads"]:
    """Residuals of the loads of springs between two shafts."""
    problem, places = given
    held = problem.attached
    assert held is not None and held.couplings is not None
    law = law_of(held.couplings, held.laws, held.held_by, places)
    return jnp.ravel(loads_in(held.couplings, z) - law.load)


class Turning(NamedTuple):
    """What turns back along the path at a point: the control, at a fold, or the slip of a contact that will stick."""

    control: Bool[Array, ""]
    slip: Bool[Array, " whiskers"] | None = None  # None without friction

    @property
    def any(self) -> Bool[Array, ""]:
        """Whether anything turns back."""
        return self.control if self.slip is None else self.control | jnp.any(self.slip)


def _singularity(
    here: Point, state: ContactState, linear: _ImplicitStep, turning: Turning, problem: Problem
) -> Callable[[Point, Known], Array]:
    """A function of a point and the numbers that vanishes at the turning point `here` and nearby, to first order.

    At a turning point, the Jacobian M of the equations and of the quantity that turns has a null vector t, the path's
    tangent, and a left null vector w. To first order, a change of w M t does not depend on the changes of w and t.
    """
    solves = problem.solved(state.phase)[:, None]
    left = linear.inverse[-1, :-1]

    def slip(z: Contacts, problem: Problem, z_rate: Contacts) -> Scalar:
        z, _ = with_dummy_contacts(problem, z, state.phase)
        assert turning.slip is not None
        return jnp.sum(jnp.where(turning.slip[:, None], slip_by_contact(problem, z, state) * z_rate, 0.0))

    by_z = None
    if turning.slip is not None:
        by_z = jax.grad(slip, argnums=2)(here.z, problem, jnp.zeros_like(here.z))
        by_steps = jnp.append(along_steps(problem, linear.at, by_z), 0.0)
        by_network = -jnp.sum(by_steps[:, None] * linear.inverse, axis=0)[:-1]
        left = jnp.where(jnp.any(turning.slip), by_network, left)
    size = linear.at.pose.size
    left, left_loads = jnp.reshape(left[:size], linear.at.pose.shape), left[size:]

    def function(point: Point, known: Known):
        problem, friction = known

        def equations(z):
            contacts, phase = with_dummy_contacts(problem, z, state.phase)
            value = evaluate(problem, Point(contacts, point.u), state._replace(phase=phase, friction=friction))
            at = condense(problem, here.z, state, linear.linear._replace(value=value))
            network = at.pose - problem.rest(point.u) - problem.displacement(at.load)
            pull = jnp.sum(jnp.where(solves, left * network, 0.0))
            if at.coupled is not None:
                pull += jnp.sum(left_loads * _loads_residual(z, (problem, at.coupled.places)))
            return pull if by_z is None else pull + jnp.sum(by_z * at.particular)

        rate = jax.jvp(equations, (point.z,), (linear.tangent.z,))[1]
        return rate if turning.slip is None else rate + slip(point.z, problem, linear.tangent.z)

    return function


# An event is a point of a path that satisfies a condition or, at a turning point, where control or slip turns back.
# The equations are solved in a plane transverse to the path's direction `along`, where they are regular at folds too.
# The distance that the event then moves along the path follows from the event's own equation. At a turning point this
# is that a rate vanishes, whose derivative needs second derivatives of the whiskers. At a fold the control does not
# change along the path, so its own derivative needs none.


@eqx.filter_custom_jvp
def event_control(
    point: Point, problem: Problem, state: ContactState, along: Point, condition: PathCondition, fold: Bool[Array, ""]
) -> Scalar:
    """The control of an event, with its derivatives; not of one where a contact begins to stick."""
    del along, fold
    return without_rule(point, (problem, state.friction, condition)).u


@event_control.def_jvp
def _(primals, tangents):
    point, problem, state, along, condition, fold = primals
    _, problem_dot, mode_dot, _, condition_dot, _ = tangents
    here = event_points(Sides(point, None), problem, Sides(state, None), along, condition, Turning(fold)).before
    known, known_dot = (problem, state.friction), (problem_dot, mode_dot.friction)
    linear = _implicit_step(here, known, state, _across(here, along), known_dot, None)
    moved = _distance_to_condition(here, state, linear, ~fold, known, condition, known_dot, condition_dot)
    return here.u, linear.drift.u + moved * linear.tangent.u


class Sides(NamedTuple):
    """What holds before and after an event."""

    before: Any
    after: Any


@eqx.filter_custom_jvp
def event_points(
    points: Sides, problem: Problem, states: Sides, along: Point, condition: PathCondition, turning: Turning
) -> Sides:
    """The points before and after an event, which have the same control, with their derivatives; after may be None."""
    del along, turning
    frictions = [state.friction for state in states if state is not None]
    return without_rule(points, (problem, frictions, condition))


@event_points.def_jvp
def _(primals, tangents):
    points, problem, states, along, condition, turning = primals
    _, problem_dot, modes_dot, _, condition_dot, _ = tangents
    points = event_points(points, problem, states, along, condition, turning)
    here, state, after = points.before, states.before, points.after
    sides, modes_dot = [(here, state, _across(here, along))], [*modes_dot]
    if after is not None:
        sides.append((after, states.after, at_control(after.u, after.z)))
    dots = [_dense(side[1].friction, dot.friction) for side, dot in zip(sides, modes_dot, strict=False)]
    # With both sides in one batch, the whiskers' equations are differentiated only once.
    steps = jax.vmap(
        lambda at, dot: _implicit_step(at[0], (problem, at[1].friction), at[1], at[2], (problem_dot, dot), None)
    )(*(jax.tree.map(lambda *leaves: jnp.stack(leaves), *each) for each in (sides, dots)))
    linear = [jax.tree.map(lambda leaf, k=k: leaf[k], steps) for k in range(len(sides))]
    at, drift = linear[0], linear[0].drift
    known, known_dot = (problem, state.friction), (problem_dot, dots[0])
    by_condition = _distance_to_condition(here, state, at, ~turning.any, known, condition, known_dot, condition_dot)
    vanishing = _singularity(here, state, at, turning, problem)
    by_turn = _distance(vanishing, here, at, turning.any, (known,), (known_dot,))
    slips = 0.0 if turning.slip is None else jnp.any(turning.slip)
    u_dot = drift.u + (by_condition + slips * by_turn) * at.tangent.u
    before_dot = Point(drift.z + (by_condition + by_turn) * at.tangent.z, u_dot)
    if after is None:
        return points, Sides(before_dot, None)
    return points, Sides(before_dot, Point(linear[1].drift.z + linear[1].tangent.z * u_dot, u_dot))


def _across(here: Point, along: Point) -> PathCondition:
    """The condition of a plane through a point of the path, transverse to the path."""
    weight = jax.lax.stop_gradient(Point(along.z / scale_of(here.z) ** 2, along.u))  # any such plane would do
    return PathCondition(weight.z, here.z, weight.u, here.u, jnp.zeros_like(here.z[:, FORCE]))


def _distance(vanishing: Callable, here: Point, linear: _ImplicitStep, holds: Bool[Array, ""], known, known_dot):
    """Distance by which an event moves along the path to keep `vanishing` zero; 0 unless `holds`."""
    _, rate = _linear(vanishing, here, *known)
    by_drift, by_tangent = rate(linear.drift, *known_dot), rate(linear.tangent, *_no_tangents(known))
    return jnp.where(holds, -by_drift / jnp.where(holds, by_tangent, 1.0), 0.0)


def _distance_to_condition(
    here: Point,
    state: ContactState,
    linear: _ImplicitStep,
    holds: Bool[Array, ""],
    known: Known,
    condition: PathCondition,
    *dots,
):
    """Distance by which an event moves along the path to satisfy its condition."""

    def residual(point: Point, known: Known, condition: PathCondition):
        at_contact, _ = with_dummy_contacts(known[0], point.z, state.phase)
        touching = state._replace(friction=known[1])
        slopes = slope_sines(known[0], touching, contact_parameters(known[0], at_contact, touching))
        return condition.residual(point, jnp.where(state.touches, slopes, 0.0))

    return _distance(residual, here, linear, holds, (known, condition), dots)
