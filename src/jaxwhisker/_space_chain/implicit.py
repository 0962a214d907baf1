"""Equilibria in space with several contacts with their derivatives: at a control, and before and after events."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.rows import RowsOfContacts
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import EventKind, Node, is_snap
from jaxwhisker._space.contact import FORCE, SLACK, UNKNOWNS
from jaxwhisker._space.implicit import Known, Side
from jaxwhisker._space.problem import SpaceProblem
from jaxwhisker._space_chain.march_state import removed
from jaxwhisker._space_chain.newton import PhasesOfRows, residuals


def _at_control(unknowns: Float[Array, " n"], known: Known) -> Float[Array, " n"]:
    z = jnp.reshape(unknowns, (-1, UNKNOWNS))
    return jnp.ravel(residuals(known.problem, z, known.u, known.phase, known.free)[0])


def solved(problem: SpaceProblem, z: RowsOfContacts, u: Scalar, phase: PhasesOfRows) -> RowsOfContacts:
    """Solved contacts at a control, with their derivatives."""
    still = jax.lax.stop_gradient(z)
    unknowns = solution_of(_at_control, jnp.ravel(still), Known(problem, u, phase, still))
    return jnp.reshape(unknowns, z.shape)


class _KnownEventOfChainInSpace(NamedTuple):
    at: Known
    weight: RowsOfContacts  # of the unknowns in a sum that vanishes; if all are zero, the control is known
    origin: RowsOfContacts  # the unknowns from which that sum is measured


def _at_event(unknowns: Float[Array, " n"], known: _KnownEventOfChainInSpace) -> Float[Array, " n"]:
    problem, u, phase, free = known.at
    z, control = jnp.reshape(unknowns[:-1], (-1, UNKNOWNS)), unknowns[-1]
    residual = residuals(problem, z, control, phase, free)[0]
    by_control = jnp.all(known.weight == 0)
    condition = jnp.where(by_control, control - u, jnp.sum(known.weight * (z - known.origin)))
    return jnp.append(jnp.ravel(residual), condition)


def sides_of_events(
    problem: SpaceProblem, nodes: Node, at: Int[Array, " events"], filled: Bool[Array, " events"]
) -> tuple[Float[Array, " events"], Side, Side]:
    """Controls of the events at these nodes, and the equilibria before and after; free whiskers without an event."""

    def one(k, filled):
        node, previous = (jax.tree.map(lambda leaf, j=j: leaf[j], nodes) for j in (k, jnp.maximum(k - 1, 0)))
        return _event(problem, node, previous, filled)

    control, before, after = jax.vmap(one)(at, filled)
    return jnp.asarray(control), before, after


def _event(problem: SpaceProblem, node: Node, previous: Node, filled: Array) -> tuple[Scalar, Side, Side]:
    """Control of an event, and the equilibria before and after it, with derivatives."""
    snaps = filled & is_snap(node.kind)
    # A snap at a fold has a point of its own; others follow from the event just before.
    caused = snaps & (previous.kind >= 0) & ~is_snap(previous.kind) & (previous.travel == node.travel)
    at = jax.tree.map(lambda a, b: jnp.where(caused, a, b), previous, node)
    folds = snaps & ~caused
    branches = filled & (node.kind == EventKind.bifurcation)

    def if_filled(phase):
        return jnp.where(filled, phase, int(Phase.free))

    before, after = if_filled(at.before.phase), if_filled(at.state.phase)
    touch, released = at.kind == EventKind.touch, at.kind == EventKind.release
    # A touch is solved for as the contact that begins, everything else as what it was before.
    phase = jnp.where(touch, after, before)
    by_control = ~filled | (at.kind < 0) | branches
    rows = at.whiskers & ~by_control
    column = jnp.where(touch | released, FORCE, SLACK)
    weight = jnp.where(rows[:, None], (jnp.arange(UNKNOWNS) == column).astype(float), 0.0)
    # At a fold the control is stationary along the path, and a shift along the path does not change its derivatives.
    weight = jnp.where(folds, node.arriving.z, weight)
    u = jax.lax.stop_gradient(at.point.u)
    z = jax.lax.stop_gradient(jnp.where(filled, jnp.where(touch, at.point.z, at.z_before), 0.0))
    known = _KnownEventOfChainInSpace(
        Known(problem, u, phase, z), jax.lax.stop_gradient(weight), jnp.where(folds, z, 0.0)
    )
    unknowns = solution_of(_at_event, jnp.append(jnp.ravel(z), u), known)
    # The equations are singular where stability is lost: derivatives of contacts there, and of the control at a
    # bifurcation, would need second derivatives of the rods.
    singular = folds | branches
    here = jnp.where(singular, z, jnp.reshape(unknowns[:-1], z.shape))
    u = jnp.where(branches, u, unknowns[-1])
    here, u = without_rule(here, problem, singular), without_rule(u, problem, branches)
    began = removed(here, phase, rows & touch, problem.contacts)[0]
    gone = removed(here, phase, rows & released, problem.contacts)[0]
    # Apart from contacts that end, numbers do not change.
    z_before, z_after = jnp.where(touch, began, here), jnp.where(released, gone, here)
    z_before = jnp.where(caused, z_after, z_before)
    rests = solved(problem, jnp.where(filled, node.point.z, 0.0), u, if_filled(node.state.phase))
    return (
        u,
        Side(z_before, u, jnp.where(caused, after, before)),
        Side(jnp.where(snaps, rests, z_after), u, if_filled(node.state.phase)),
    )
