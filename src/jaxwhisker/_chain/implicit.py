"""Equilibria with several contacts with their derivatives: at a control, and before and after the events of a path."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.newton import residuals
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase
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


class _KnownEvent(NamedTuple):
    at: KnownOfChain
    weight: Contacts  # of the unknowns in a sum that vanishes; if all are zero, the control is known
    origin: Contacts  # the unknowns from which that sum is measured


def _at_event(unknowns: Float[Array, " n"], known: _KnownEvent) -> Float[Array, " n"]:
    problem, u, state = known.at
    z, control = jnp.reshape(unknowns[:-1], (-1, 3)), unknowns[-1]
    residual = residuals(problem, z, control, state)[0]
    by_control = jnp.all(known.weight == 0)
    condition = jnp.where(by_control, control - u, jnp.sum(known.weight * (z - known.origin)))
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
        return _event(problem, jax.tree.map(lambda leaf: leaf[k], nodes), filled)

    control, before, after = jax.vmap(one)(at, filled)
    return jnp.asarray(control), before, after


def _event(problem: ChainProblem, node: Node, filled: Array) -> tuple[Scalar, ChainSide, ChainSide]:
    """Control of an event, and the equilibria before and after it, with derivatives."""

    def if_filled(state: ChainState) -> ChainState:
        return state._replace(phase=jnp.where(filled, state.phase, int(Phase.free)))

    before, after = if_filled(node.before), if_filled(node.state)
    touch, released, snaps = node.kind == EventKind.touch, node.kind == EventKind.release, filled & is_snap(node.kind)
    # A touch is solved for as the contact that begins, everything else as what it was before.
    state = jax.tree.map(lambda a, b: jnp.where(touch, a, b), after, before)
    column = jnp.where(touch | released, FORCE, SLACK)
    by_control = ~filled | (node.kind < 0)
    weight = jnp.where(node.whiskers[:, None] & ~by_control, (jnp.arange(3) == column).astype(float), 0.0)
    # At a fold the control is stationary along the path, and a shift along the path does not change its derivatives.
    weight = jnp.where(snaps, node.arriving.z, weight)
    u = jax.lax.stop_gradient(node.point.u)
    z = jax.lax.stop_gradient(jnp.where(touch, node.point.z, node.z_before))
    z = jnp.where(filled, z, 0.0)
    known = _KnownEvent(KnownOfChain(problem, u, state), jax.lax.stop_gradient(weight), jnp.where(snaps, z, 0.0))
    unknowns = solution_of(_at_event, jnp.append(jnp.ravel(z), u), known)
    # The equations are singular where stability is lost: derivatives of contacts there need second derivatives.
    solved_z, u = jnp.reshape(unknowns[:-1], z.shape), unknowns[-1]
    here = jnp.where(snaps, without_rule(z, problem, snaps), solved_z)
    z_before = jnp.where(touch, _without_new(problem, node, here), here)
    z_before = jnp.where(filled, z_before, 0.0)
    rests = solved(problem, jnp.where(filled, node.point.z, 0.0), u, after)
    # Events other than touches, releases and snaps do not change the numbers, but that a slack of half a turn becomes 0.
    shift = jax.lax.stop_gradient(jnp.where(filled, node.point.z, 0.0) - z)
    z_after = jnp.where(touch, here, jnp.where(snaps | released, rests, here + jnp.where(touch, 0.0, shift)))
    return u, ChainSide(z_before, u, before), ChainSide(z_after, u, after)


def _without_new(problem: ChainProblem, node: Node, z: Contacts) -> Contacts:
    """The contacts without the one that begins at a node."""
    contacts, index, row = problem.contacts, jnp.arange(z.shape[0]), jnp.argmax(node.whiskers)
    moves = (index >= row) & (index // contacts == row // contacts)
    at_end = moves & (index % contacts == contacts - 1)
    return jnp.where(at_end[:, None], 0.0, z[jnp.where(moves & ~at_end, index + 1, index)])
