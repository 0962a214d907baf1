"""Equilibria with several contacts with their derivatives: at a control, and before and after the events of a path."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, Places, held_of, parameter_of, slack_of
from jaxwhisker._chain.friction import slip_by_contact
from jaxwhisker._chain.march_state import removed
from jaxwhisker._chain.newton import residuals
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Stops, is_snap


class KnownOfChain(NamedTuple):
    """What the equations of a point depend on, besides its unknowns."""

    problem: ChainProblem
    u: Scalar  # the control, unless it is an unknown
    state: ChainState


def _at_control(unknowns: Float[Array, " n"], known: KnownOfChain) -> Float[Array, " n"]:
    z = jnp.reshape(unknowns, (-1, 3))
    return jnp.ravel(residuals(known.problem, z, known.u, known.state)[0])


def solved(problem: ChainProblem, z: RowsOfContacts, u: Scalar, state: ChainState) -> RowsOfContacts:
    """Solved contacts at a control, with their derivatives."""
    still = jax.lax.stop_gradient(z)
    unknowns = solution_of(_at_control, jnp.ravel(still), KnownOfChain(problem, u, state))
    return jnp.reshape(unknowns, z.shape)


class _KnownEventOfChain(NamedTuple):
    at: KnownOfChain
    weight: RowsOfContacts  # of the unknowns in a sum that vanishes; if all are zero, the control is known
    origin: RowsOfContacts  # the unknowns from which that sum is measured, apart from derivatives
    on_edge: Float[Array, "2 rows"]  # rows whose parameter is at the beginning and at the end of its piece
    leaning: Float[Array, " rows"]  # rows whose lean is at its limit: its sign
    rests: Bool[Array, " rows"]  # rows whose slip comes to rest


def _at_event(unknowns: Float[Array, " n"], known: _KnownEventOfChain) -> Float[Array, " n"]:
    problem, u, state = known.at
    z, control = jnp.reshape(unknowns[:-1], (-1, 3)), unknowns[-1]
    residual = residuals(problem, z, control, state)[0]
    by_control = jnp.all(known.weight == 0)
    # The ends of pieces depend on the numbers of the object.
    ends = problem.profile.ends_on(jnp.where(state.touches, state.piece, 0))
    limits = sum(jnp.sum(jnp.where(at > 0, end, 0.0)) for at, end in zip(known.on_edge, ends, strict=True))
    if problem.friction_angle is not None:
        limits += jnp.sum(known.leaning) * problem.friction_angle
        assert state.friction is not None
        start = state.friction.parameter + state.side * state.friction.beyond
        over = jnp.any(known.on_edge > 0, axis=0) & held_of(problem.profile, state).rolls
        limits -= jnp.sum(jnp.where(over, start, 0.0))
    shift = limits - jax.lax.stop_gradient(limits)
    condition = jnp.where(by_control, control - u, jnp.sum(known.weight * (z - known.origin)) - shift)
    if problem.friction_angle is not None:
        slows = jnp.any(known.rests)
        condition = jnp.where(slows, _slip_rate(problem, z, control, state, known.rests), condition)
    return jnp.append(jnp.ravel(residual), condition)


def _slip_rate(problem: ChainProblem, z: RowsOfContacts, u: Scalar, state: ChainState, rows: Array) -> Float[Array, ""]:
    """Rate of slip of these contacts, by the control; 0 without any."""

    def equations(z, u):
        return jnp.ravel(residuals(problem, z, u, state)[0])

    system = jax.jacfwd(equations)(z, u).reshape(z.size, z.size)
    _, by_control = jax.jvp(lambda u: equations(z, u), (u,), (jnp.ones_like(u),))
    system = jnp.where(jnp.any(rows), system, jnp.eye(z.size))
    rate = -jnp.sum(inverse(system) * by_control, axis=-1).reshape(z.shape)
    return jnp.sum(jnp.where(rows[:, None], slip_by_contact(problem, z, state) * rate, 0.0))


class ChainSide(NamedTuple):
    """An equilibrium before or after an event."""

    z: RowsOfContacts
    u: Scalar
    state: ChainState


def sides_of_events(
    problem: ChainProblem, nodes: Node, at: Int[Array, " events"], filled: Bool[Array, " events"]
) -> tuple[Float[Array, " events"], ChainSide, ChainSide]:
    """Controls of the events at these nodes, and the equilibria before and after; free whiskers without an event."""

    def one(k, filled):
        node, previous = (jax.tree.map(lambda leaf, j=j: leaf[j], nodes) for j in (k, jnp.maximum(k - 1, 0)))
        return _event(problem, node, previous, filled)

    control, before, after = jax.vmap(one)(at, filled)
    return jnp.asarray(control), before, after


def _event(problem: ChainProblem, node: Node, previous: Node, filled: Array) -> tuple[Scalar, ChainSide, ChainSide]:
    """Control of an event, and the equilibria before and after it, with derivatives."""
    snaps = filled & is_snap(node.kind)
    # A snap at a fold has a point of its own; others follow from the event just before.
    caused = snaps & (previous.kind >= 0) & ~is_snap(previous.kind) & (previous.travel == node.travel)
    at = jax.tree.map(lambda a, b: jnp.where(caused, a, b), previous, node)
    known = jnp.asarray(False)
    if problem.friction_angle is not None:
        # The control of the event before is known, with derivatives, and slips change where that event has led.
        changes = snaps | (filled & ((node.kind == EventKind.stick) | (node.kind == EventKind.slip)))
        known = changes & (previous.kind != NO_EVENT) & (previous.travel == node.travel)
        at = node._replace(point=node.point._replace(u=jnp.where(known, previous.point.u, node.point.u)))
    solved_at = _solved_event(problem, at, snaps & ~caused & ~known, filled, known)
    u, after = solved_at.u, _if_filled(node.state, filled)
    rests = solved(problem, jnp.where(filled, node.point.z, 0.0), u, after)
    if problem.friction_angle is not None:
        # The numbers of contacts mean something else where slips change.
        same = (node.kind == EventKind.touch) | (node.kind == EventKind.release) | (node.kind < 0)
        z_after = jnp.where(same, solved_at.after, rests)
        return u, ChainSide(solved_at.before, u, _if_filled(node.before, filled)), ChainSide(z_after, u, after)
    before = _if_filled(jax.tree.map(lambda a, b: jnp.where(caused, a, b), at.state, node.before), filled)
    z_before = jnp.where(caused, solved_at.after, solved_at.before)
    z_after = jnp.where(snaps, rests, solved_at.after)
    return u, ChainSide(z_before, u, before), ChainSide(z_after, u, after)


def after_event(
    problem: ChainProblem, node: Node, previous: Node, known: Any, linked: Bool[Array, ""], stops: Stops
) -> tuple[Scalar, Places]:
    """Control of an event and where contacts stick from there on; see AfterEvent of the memory of scans."""
    new = node.state.places
    assert new is not None and node.corner is not None and node.stop is not None
    begins, ends = node.kind == EventKind.touch, node.kind == EventKind.release
    moved = jax.tree.map(lambda leaf: _moved(leaf, node.whiskers, begins, ends, problem.contacts), known.places)
    previous = previous._replace(point=previous.point._replace(u=jnp.where(linked, known.control, previous.point.u)))
    at = node._replace(state=node.state.stuck_at(moved), before=node.before.stuck_at(known.places))
    u, before, after = _event(problem, at, previous, jnp.asarray(True))
    here = jax.tree.map(lambda a, b: jnp.where(begins | ends, a, b), _places(problem, after), _places(problem, before))
    differs = node.corner & ((new[0] != moved[0]) | (new[1] != moved[1]))

    def place(value, here, moved):
        # In a snap, a contact may also stick later. Its derivatives are then those of where the snap begins.
        return jnp.where(differs, value + here - jax.lax.stop_gradient(here), moved)

    stop = stops[node.stop] / jnp.asarray(problem.unit.control)
    u = jnp.where(node.kind == STOP, node.point.u + stop - jax.lax.stop_gradient(stop), u)
    return u, jax.tree.map(place, new, here, moved)


def _places(problem: ChainProblem, side: ChainSide) -> Places:
    """Where contacts are on the object and on the whisker."""
    z, state = side.z, side.state
    slack = slack_of(problem.profile, z, state)
    return parameter_of(problem.profile, z, state), jnp.where(state.phase == Phase.tangential, slack, 0.0)


def _moved(leaf: Array, rows: Array, begins: Array, ends: Array, contacts: int) -> Array:
    """Values of contacts after one of them has begun or ended, in their new rows."""
    index, row = jnp.arange(rows.size), jnp.argmax(rows)
    same = index // contacts == row // contacts
    later, earlier = begins & same & (index > row), ends & same & (index >= row) & (index % contacts < contacts - 1)
    return leaf[jnp.where(later, index - 1, jnp.where(earlier, index + 1, index))]


def _if_filled(state: ChainState, filled: Array) -> ChainState:
    return state._replace(phase=jnp.where(filled, state.phase, int(Phase.free)))


class _SolvedEvent(NamedTuple):
    u: Scalar
    before: RowsOfContacts
    after: RowsOfContacts  # but of a snap


def _solved_event(problem: ChainProblem, node: Node, folds: Array, filled: Array, known: Array) -> _SolvedEvent:
    """The point of an event that is no snap, or of a fold; or the equilibrium before it, if its control is known."""
    before, after = (_if_filled(state, filled) for state in (node.before, node.state))
    touch, released, edge = (node.kind == kind for kind in (EventKind.touch, EventKind.release, EventKind.edge))
    # A touch is solved for as the contact that begins, everything else as what it was before.
    state = jax.tree.map(lambda a, b: jnp.where(touch, a, b), after, before)
    column = jnp.where(touch | released, FORCE, jnp.where(edge, PARAMETER, SLACK))
    by_control = ~filled | (node.kind < 0) | known
    rows = node.whiskers & ~by_control
    u = jnp.where(known, node.point.u, jax.lax.stop_gradient(node.point.u))
    z = jax.lax.stop_gradient(jnp.where(touch, node.point.z, node.z_before))
    z = jnp.where(filled, z, 0.0)
    columns, size = jnp.full(rows.shape, column), jnp.ones(rows.shape)
    leaning, rests = jnp.zeros(rows.shape), jnp.zeros_like(rows)
    if problem.friction_angle is not None:
        held = held_of(problem.profile, state)
        slips, rests = node.kind == EventKind.slip, rows & (node.kind == EventKind.stick)
        columns = jnp.where(slips, jnp.where(held.at_corner, SLACK, PARAMETER), columns)
        columns = jnp.where(edge & held.rolls, SLACK, columns)
        size = jnp.where(edge & held.rolls, -state.side, size)
        lean = jnp.where(held.at_corner, z[:, SLACK], z[:, PARAMETER])
        leaning = jnp.where(rows & slips & ~folds, jnp.sign(lean), 0.0)
    weight = jnp.where(rows[:, None] & (jnp.arange(3) == columns[:, None]), size[:, None], 0.0)
    # At a fold the control is stationary along the path, and a shift along the path does not change its derivatives.
    weight = jnp.where(folds, node.arriving.z, weight)
    low, high = jax.lax.stop_gradient(problem.profile.ends_on(jnp.where(state.touches, state.piece, 0)))
    parameter = jax.lax.stop_gradient(parameter_of(problem.profile, z, state))
    at_end = jnp.abs(parameter - high) < jnp.abs(parameter - low)
    on_edge = jnp.stack([rows & edge & ~folds & ~at_end, rows & edge & ~folds & at_end]).astype(float)
    at = KnownOfChain(problem, u, state)
    conditions = _KnownEventOfChain(at, jax.lax.stop_gradient(weight), z, on_edge, leaning, rests & ~folds)
    unknowns = solution_of(_at_event, jnp.append(jnp.ravel(z), u), conditions)
    # The equations are singular where stability is lost: derivatives of contacts there need second derivatives.
    here = jnp.where(folds, without_rule(z, problem, folds), jnp.reshape(unknowns[:-1], z.shape))
    z_before = jnp.where(touch, removed(here, state, rows, problem.contacts)[0], here)
    z_before = jnp.where(filled, z_before, 0.0)
    # Apart from a slack of half a turn, which becomes 0, numbers do not change.
    shift = jax.lax.stop_gradient(jnp.where(filled & ~touch & ~released & ~folds, node.point.z - z, 0.0))
    without, _ = removed(here, state, rows & released, problem.contacts)
    return _SolvedEvent(unknowns[-1], z_before, jnp.where(released, without, here + shift))
