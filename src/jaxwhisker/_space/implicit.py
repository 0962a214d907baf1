"""Equilibria in space with their derivatives: at a control, and before and after the events of a path."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of, without_rule
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._path.path import STOP, EventKind, Node, Path
from jaxwhisker._space.contact import FORCE, SLACK, UNKNOWNS
from jaxwhisker._space.history import LinkedNodes
from jaxwhisker._space.newton import Phases
from jaxwhisker._space.problem import Contacts, SpaceProblem
from jaxwhisker._space.residuals import residuals
from jaxwhisker._space.slip import SlipMode


class Known(NamedTuple):
    """What the equations of a point depend on, besides its unknowns."""

    problem: SpaceProblem
    u: Scalar  # the control, unless it is an unknown
    phase: Phases
    free: Contacts  # values of free whiskers


def _at_control(unknowns: Float[Array, " n"], known: Known) -> Float[Array, " n"]:
    z = jnp.reshape(unknowns, (-1, UNKNOWNS))
    return jnp.ravel(residuals(known.problem, z, known.u, known.phase, known.free)[0])


def solved(problem: SpaceProblem, z: Contacts, u: Scalar, phase: Phases) -> Contacts:
    """Solved contacts at a control, with their derivatives."""
    still = jax.lax.stop_gradient(z)
    unknowns = solution_of(_at_control, jnp.ravel(still), Known(problem, u, phase, still))
    return jnp.reshape(unknowns, z.shape)


class _KnownEvent(NamedTuple):
    at: Known
    weight: Contacts  # of the unknowns in a sum that vanishes; if all are zero, the control is known
    at_loss: Contacts  # the unknowns at a fold, from which that sum is measured


def _at_event(unknowns: Float[Array, " n"], known: _KnownEvent) -> Float[Array, " n"]:
    problem, u, phase, free = known.at
    z, control = jnp.reshape(unknowns[:-1], (-1, UNKNOWNS)), unknowns[-1]
    residual = residuals(problem, z, control, phase, free)[0]
    by_control = jnp.all(known.weight == 0)
    condition = jnp.where(by_control, control - u, jnp.sum(known.weight * (z - known.at_loss)))
    return jnp.append(jnp.ravel(residual), condition)


def with_turns(path: Path) -> Node:
    """The nodes of a path; with friction, contacts that slip stick where the drive turns."""
    nodes = path.nodes
    if nodes.before.mode is None:
        return nodes
    onwards = jnp.concatenate([nodes.before.mode[1:], nodes.before.mode[-1:]])
    onwards = jnp.where((jnp.arange(nodes.kind.size) < path.count - 1)[:, None], onwards, int(SlipMode.slips))
    stick = (nodes.before.mode == SlipMode.slips) & (onwards == SlipMode.sticks) & (nodes.state.phase != Phase.free)
    stick &= (nodes.kind == STOP)[:, None]
    kind = jnp.where(jnp.any(stick, axis=1), int(EventKind.stick), nodes.kind)
    return nodes._replace(kind=kind, whiskers=nodes.whiskers | stick)


class Side(NamedTuple):
    """An equilibrium before or after an event."""

    z: Contacts
    u: Scalar
    phase: Phases
    slips: Bool[Array, " whiskers"] | None = None


def sides_of_events(
    problem: SpaceProblem, path: Path, links: LinkedNodes | None, at: Int[Array, " events"], filled: Array
) -> tuple[Float[Array, " events"], Side, Side]:
    """Controls of the events at these nodes, and the equilibria before and after; free whiskers without an event."""
    nodes = with_turns(path)

    def one(k, filled):
        if links is not None:
            return _linked_event(nodes, links, k, filled)
        return _event(problem, jax.tree.map(lambda leaf: leaf[k], nodes), filled)

    control, before, after = jax.vmap(one)(at, filled)
    return jnp.asarray(control), before, after


def _linked_event(nodes: Node, links: LinkedNodes, k: Scalar, filled: Array) -> tuple[Scalar, Side, Side]:
    """Control of an event with friction, and the equilibria before and after it."""
    assert nodes.before.mode is not None
    before, after = (jnp.where(filled, phase[k], int(Phase.free)) for phase in (nodes.before.phase, nodes.state.phase))
    modes = (nodes.before.mode[j] == SlipMode.slips for j in (k, jnp.minimum(k + 1, nodes.kind.size - 1)))
    u, contacts = jnp.asarray(links.point.u)[k], (links.stages.z[k, -1], links.point.z[k])
    of_before, of_after = (
        Side(z, u, phase, slips) for z, phase, slips in zip(contacts, (before, after), modes, strict=True)
    )
    return u, of_before, of_after


def _event(problem: SpaceProblem, node: Node, filled: Array) -> tuple[Scalar, Side, Side]:
    """Control of an event, and the equilibria before and after it, with derivatives."""
    touch, concerned = node.kind == EventKind.touch, node.whiskers[:, None]
    released = node.kind == EventKind.release
    phase = jnp.where(touch, node.state.phase, node.before.phase)
    phase = jnp.where(filled, phase, int(Phase.free))
    column = jnp.where(touch | released, FORCE, SLACK)
    known_control = ~filled | (node.kind < 0)
    snaps = filled & ((node.kind == EventKind.snap_through) | (node.kind == EventKind.snap_off))
    branches = filled & (node.kind == EventKind.bifurcation)
    known_control |= branches
    weight = jnp.where(concerned & ~known_control, (jnp.arange(UNKNOWNS) == column).astype(float), 0.0)
    # At a fold the control is stationary along the path, and a shift along the path does not change its derivatives.
    weight = jnp.where(snaps, node.arriving.z, weight)
    u = jax.lax.stop_gradient(node.point.u)
    # A touch is solved for as the contact that begins, everything else as what it was before.
    z = jax.lax.stop_gradient(jnp.where(touch, node.point.z, node.z_before))
    at = Known(problem, u, phase, z)
    known = _KnownEvent(at, jax.lax.stop_gradient(weight), jnp.where(snaps, z, 0.0))
    unknowns = solution_of(_at_event, jnp.append(jnp.ravel(z), u), known)
    # The equations are singular where stability is lost: derivatives of contacts there, and of the control at a
    # bifurcation, would need second derivatives of the rods.
    z = jnp.where(snaps | branches, z, jnp.reshape(unknowns[:-1], z.shape))
    u = jnp.where(branches, u, unknowns[-1])
    z, u = without_rule(z, problem, snaps | branches), without_rule(u, problem, branches)
    before = jnp.where(filled, node.before.phase, int(Phase.free))
    after = jnp.where(filled, node.state.phase, int(Phase.free))
    z_after = jnp.where(snaps, solved(problem, node.point.z, u, after), z)
    return u, Side(z, u, before), Side(z_after, u, after)
