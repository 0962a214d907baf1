"""Equilibria with several contacts with their derivatives: at a control, and before and after the events of a path."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.march_state import removed
from jaxwhisker._chain.newton import residuals
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._equilibrium.contact import FORCE, PARAMETER, SLACK, Phase
from jaxwhisker._equilibrium.point import Contacts
from jaxwhisker._path.path import EventKind, Node, is_snap


class KnownOfChain(NamedTuple):
    """What the equations of a point depend on, besides its unknowns."""

    problem: ChainProblem
    u: Scalar  # the control, unless it is an unknown
    state: ChainState


def _at_control(unknowns: Float[Array, " n"], known: KnownOfChain) -> Float[Array, " n"]:
    z = jnp.reshape(unknowns, (-1, 3))
    return jnp.ravel(residuals(known.problem, z, known.u, known.state)[0])


def solved(problem: ChainProblem, z: Contacts, u: Scalar, state: ChainState) -> Contacts:
    """Solved contacts at a control, with their derivatives."""
    still = jax.lax.stop_gradient(z)
    unknowns = solution_of(_at_control, jnp.ravel(still), KnownOfChain(problem, u, state))
    return jnp.reshape(unknowns, z.shape)


class _KnownEventOfChain(NamedTuple):
    at: KnownOfChain
    weight: Contacts  # of the unknowns in a sum that vanishes; if all are zero, the control is known
    origin: Contacts  # the unknowns from which that sum is measured, apart from derivatives
    on_edge: Float[Array, "2 rows"]  # rows whose parameter is at the beginning and at the end of its piece


def _at_event(unknowns: Float[Array, " n"], known: _KnownEventOfChain) -> Float[Array, " n"]:
    problem, u, state = known.at
    z, control = jnp.reshape(unknowns[:-1], (-1, 3)), unknowns[-1]
    residual = residuals(problem, z, control, state)[0]
    by_control = jnp.all(known.weight == 0)
    # The ends of pieces depend on the numbers of the object.
    ends = problem.profile.ends_on(jnp.where(state.touches, state.piece, 0))
    limits = sum(jnp.sum(jnp.where(at > 0, end, 0.0)) for at, end in zip(known.on_edge, ends, strict=True))
    shift = limits - jax.lax.stop_gradient(limits)
    condition = jnp.where(by_control, control - u, jnp.sum(known.weight * (z - known.origin)) - shift)
    return jnp.append(jnp.ravel(residual), condition)


class ChainSide(NamedTuple):
    """An equilibrium before or after an event."""

    z: Contacts
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
    solved_at = _solved_event(problem, at, snaps & ~caused, filled)
    u, after = solved_at.u, _if_filled(node.state, filled)
    rests = solved(problem, jnp.where(filled, node.point.z, 0.0), u, after)
    before = _if_filled(jax.tree.map(lambda a, b: jnp.where(caused, a, b), at.state, node.before), filled)
    z_before = jnp.where(caused, solved_at.after, solved_at.before)
    z_after = jnp.where(snaps, rests, solved_at.after)
    return u, ChainSide(z_before, u, before), ChainSide(z_after, u, after)


def _if_filled(state: ChainState, filled: Array) -> ChainState:
    return state._replace(phase=jnp.where(filled, state.phase, int(Phase.free)))


class _SolvedEvent(NamedTuple):
    u: Scalar
    before: Contacts
    after: Contacts  # but of a snap


def _solved_event(problem: ChainProblem, node: Node, folds: Array, filled: Array) -> _SolvedEvent:
    """The point of an event that is no snap, or of a fold."""
    before, after = (_if_filled(state, filled) for state in (node.before, node.state))
    touch, released, edge = (node.kind == kind for kind in (EventKind.touch, EventKind.release, EventKind.edge))
    # A touch is solved for as the contact that begins, everything else as what it was before.
    state = jax.tree.map(lambda a, b: jnp.where(touch, a, b), after, before)
    column = jnp.where(touch | released, FORCE, jnp.where(edge, PARAMETER, SLACK))
    by_control = ~filled | (node.kind < 0)
    rows = node.whiskers & ~by_control
    weight = jnp.where(rows[:, None], (jnp.arange(3) == column).astype(float), 0.0)
    # At a fold the control is stationary along the path, and a shift along the path does not change its derivatives.
    weight = jnp.where(folds, node.arriving.z, weight)
    u = jax.lax.stop_gradient(node.point.u)
    z = jax.lax.stop_gradient(jnp.where(touch, node.point.z, node.z_before))
    z = jnp.where(filled, z, 0.0)
    low, high = jax.lax.stop_gradient(problem.profile.ends_on(jnp.where(state.touches, state.piece, 0)))
    at_end = jnp.abs(z[:, PARAMETER] - high) < jnp.abs(z[:, PARAMETER] - low)
    on_edge = jnp.stack([rows & edge & ~folds & ~at_end, rows & edge & ~folds & at_end]).astype(float)
    known = _KnownEventOfChain(KnownOfChain(problem, u, state), jax.lax.stop_gradient(weight), z, on_edge)
    unknowns = solution_of(_at_event, jnp.append(jnp.ravel(z), u), known)
    # The equations are singular where stability is lost: derivatives of contacts there need second derivatives.
    here = jnp.where(folds, without_rule(z, problem, folds), jnp.reshape(unknowns[:-1], z.shape))
    z_before = jnp.where(touch, removed(here, state, rows, problem.contacts)[0], here)
    z_before = jnp.where(filled, z_before, 0.0)
    # Apart from a slack of half a turn, which becomes 0, numbers do not change.
    shift = jax.lax.stop_gradient(jnp.where(filled & ~touch & ~released & ~folds, node.point.z - z, 0.0))
    without, _ = removed(here, state, rows & released, problem.contacts)
    return _SolvedEvent(unknowns[-1], z_before, jnp.where(released, without, here + shift))
