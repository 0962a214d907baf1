"""Slips: which contacts slip and which stick, where the path leaves an event and in each step of a snap.

Along the path, contacts that slip must not turn back, and the lean of those that stick must not grow beyond its limit.
Contacts that break this are changed one after the other until none does; the first of them is changed first, which
cannot run in circles if the motion is unique (Murty, Linear Complementarity, Linear and Nonlinear Programming, 1988,
chapter 5).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import slipping_from
from jaxwhisker._equilibrium.newton import LIGHT, is_light, slip_by_contact, with_slips
from jaxwhisker._equilibrium.point import Contacts, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._path.march_state import Task
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, select
from jaxwhisker._plane.events import LEAN_NOISE, RATE_NOISE, Lead
from jaxwhisker._plane.march_state import MarchInPlane
from jaxwhisker._plane.snap_flow import ITERATIONS, Flow, branch_known

SLIPPED = 1e-12  # distance that a contact may slip back before it sticks
LEANING = 1e-12  # angle by which a contact that sticks may lean too far
AT_LIMIT = 1e-11  # a contact that sticks begins to slip where its lean is this close to its limit
ASTRAY = 0.5  # relative distance between the guess and the solution of a step that is too long


def slip_rates(problem: Problem, state: ContactState, z: Contacts, z_rate: Contacts) -> PerWhisker:
    """Rates of slip in the direction of slip, infinite for whiskers that are free or stick."""
    slips = state.touches & (state.slip != 0)
    rates = jnp.sum(slip_by_contact(problem, z, state) * z_rate, axis=-1)
    return jnp.where(slips, state.slip * rates, jnp.inf)


def changed_slips(
    problem: Problem, march: MarchInPlane, point: Point, tangent: Point, falls: Bool[Array, ""]
) -> tuple[Bool[Array, ""], Int[Array, " whiskers"]]:
    """Whether a contact breaks a law of friction along the tangent, and the slips after the first one is changed."""
    limit, onwards = problem.friction_angle, slip_rates(problem, march.state, point.z, tangent.z)
    assert limit is not None and march.tries is not None and march.rests is not None
    slip, force, leans = march.state.slip, point.z[:, FORCE], point.z[:, LEAN]
    # A contact that has just begun may slip either way or, if neither presses on, stick.
    unloaded = (slip != 0) & (force <= LIGHT)
    backwards = (onwards < -RATE_NOISE) | (march.state.touches & unloaded & falls & (limit > 0))
    sticks = march.state.sticks
    exceeds = (jnp.abs(leans) > limit - RATE_NOISE) & (jnp.sign(leans) * tangent.z[:, LEAN] > RATE_NOISE)
    # A contact that sticks from its first touch may have a lean that no friction allows.
    allowed = jnp.abs(leans) < limit + LEAN_NOISE
    exceeds = sticks & ~march.rests & (exceeds | (~allowed & is_light(march.state, march.point.z)))
    can_stick = (~unloaded | (march.tries > 0)) & (limit > 0)
    changed = jnp.where(exceeds, jnp.sign(leans).astype(int), jnp.where(can_stick, 0, -slip))
    wrong = backwards | exceeds
    first = wrong & (jnp.cumsum(wrong) == 1)
    return jnp.any(wrong), jnp.where(first, changed, slip)


def with_changed_slips(
    problem: Problem, march: MarchInPlane, node: Node, slip: Int[Array, " whiskers"], arriving: Point, *, rest: bool
) -> MarchInPlane:
    """The state at a node, before the direction in which the path leaves with these slips is determined.

    Args:
        problem: the problem.
        march: the state of the march, at the node.
        node: the node, with the slips before.
        slip: the new slips.
        arriving: direction of the path before.
        rest: whether the slips that change have come to rest, so that the path goes on without a corner.
    """
    before, earlier = march.state.friction, march.pending.before.friction
    assert before is not None and earlier is not None and march.tries is not None
    z, state = with_slips(problem, node.point.z, march.state, slip, march.parameters)
    if not rest:
        starts = is_light(state, z) & (before.slip != 0)
        known, leans = _first_leans(problem, march, arriving)
        z = z.at[:, LEAN].set(jnp.where(starts & known, leans, z[:, LEAN]))
    fresh = march.tries == 0
    # Slips at an event are changed after the event itself.
    z_before = jnp.where(fresh, node.point.z, march.pending.z_before)
    friction_before = select(fresh, before, earlier)
    differ = state.slip != friction_before.slip
    sticks = differ & (state.slip == 0)
    begins = differ & (friction_before.slip == 0)
    kind = jnp.where(jnp.any(sticks), EventKind.stick, jnp.where(jnp.any(begins), EventKind.slip, NO_EVENT))
    changes = slip != before.slip
    pending = node._replace(
        point=node.point._replace(z=z),
        z_before=z_before,
        arriving=arriving,
        state=node.state._replace(friction=state.friction),
        before=march.state._replace(friction=friction_before),
        kind=kind,
        whiskers=sticks | begins,
        corner=jnp.asarray(True),
    )
    inwards = jnp.zeros_like(z).at[:, LEAN].set(-before.slip.astype(float))
    starts = is_light(state, z)[:, None]
    inwards = jnp.where(starts, jnp.zeros_like(z).at[:, FORCE].set(1.0), inwards)
    ahead = state.slip[:, None] * slip_by_contact(problem, z, state)
    lead = jnp.where((slip == 0)[:, None], inwards, ahead)
    weights = Lead(jnp.where(changes[:, None], lead, 0.0), jnp.zeros_like(march.pose), jnp.asarray(0.0))
    if rest:
        # A lean does not change at first; all else goes on as before.
        same = jnp.where(changes[:, None], arriving.z.at[:, LEAN].set(0.0), arriving.z)
        weights = weights._replace(z=same, u=arriving.u)
    return march.replace(
        task=jnp.asarray(int(Task.arrive)),
        state=state,
        point=pending.point,
        stuck_at=march.parameters,
        lead=weights,
        pending=pending,
        tries=march.tries + 1,
        rests=changes & (slip == 0) if rest else march.rests,
    )


def _first_leans(problem: Problem, march: MarchInPlane, tangent: Point) -> tuple[Bool[Array, " whiskers"], PerWhisker]:
    """Leans of contacts that stick from their first touch, where neither slip is possible; and whether they are known.

    At vanishing force the equations are linear. The path with a contact that sticks is therefore that combination of
    the paths with slips in both directions in which the contact does not slip. The tangent is that with the present
    slips, and the pending node arrives along that with the slips tried before.
    """
    limit, other = problem.friction_angle, march.pending.arriving
    assert limit is not None
    by_contact = slip_by_contact(problem, march.point.z, march.state)
    rate, other_rate = (jnp.sum(by_contact * one.z, axis=-1) for one in (tangent, other))
    force, other_force = other_rate * tangent.z[:, FORCE], -rate * other.z[:, FORCE]
    onwards = jnp.where(march.direction * (other_rate * tangent.u - rate * other.u) < 0, -1.0, 1.0)
    across = march.state.slip * jnp.sin(limit) * (force - other_force)
    along = jnp.cos(limit) * (force + other_force)
    return onwards * along > 0, jnp.arctan2(onwards * across, onwards * along)


class Disagreement(NamedTuple):
    """Contacts whose slips, with which a step was solved for, do not agree with how they move in it."""

    wrong: Bool[Array, ""]  # whether the step must be repeated with other slips
    slip: Int[Array, " whiskers"]  # these slips
    share: Scalar  # of the step, up to which no lean exceeds its limit


def disagreement(problem: Problem, flow: Flow, state: ContactState, previous: Contacts, z: Contacts) -> Disagreement:
    """Compare the motion of contacts in a step of a snap with their slips.

    A contact that slips back sticks from the start of the step on; one that sticks slips from where its lean reaches
    the limit.
    """
    assert problem.friction_angle is not None
    slip, limit = state.slip, problem.friction_angle
    known = state.touches & branch_known(flow) & ~flow.sliding
    # Simpson's rule: a contact that nearly rolls moves much farther along the object than it slips.
    start, middle, end = (slip_by_contact(problem, at, state) for at in (previous, (previous + z) / 2, z))
    slipped = slip * jnp.sum((start + 4 * middle + end) / 6 * (z - previous), axis=-1)
    # A contact that has landed beyond its place goes back to it.
    back = known & (slip != 0) & (slipped < -SLIPPED) & (~flow.landing | (previous[:, FORCE] <= LIGHT))
    way = jnp.sign(z[:, LEAN])
    before, after = way * previous[:, LEAN], way * z[:, LEAN]
    # While a branch is unknown nobody moves, but solving for the first point on it may change a lean.
    leans = known & (slip == 0) & (after > limit + LEANING) & (after > before)
    at_limit = leans & (before > limit - AT_LIMIT)
    wrong = back | at_limit
    # A contact that has just begun may slip either way or, if neither agrees with its motion, stick.
    unloaded = (previous[:, FORCE] <= LIGHT) & (slip == slipping_from(state.side).slip)
    after_back = jnp.where((limit > 0) & ~unloaded, 0, -slip)
    changed = jnp.where(back, after_back, way.astype(int))
    # Half of the tolerance is left for the curvature of the branch.
    share = jnp.where(leans & ~at_limit, (limit - before - AT_LIMIT / 2) / (after - before), 1.0)
    first = wrong & (jnp.cumsum(wrong) == 1)
    return Disagreement(jnp.any(wrong), jnp.where(first, changed, slip), jnp.min(share))


def goes_astray(state: ContactState, previous: Contacts, guess: Contacts, z: Contacts) -> Bool[Array, ""]:
    """Whether a step ends so far from its guess that branches are curved more strongly than it resolves.

    A whisker that just reaches a blunt object passes it within a small part of the usual step.
    """
    scale = scale_of(previous)
    # The leans of small forces are not accurate.
    weight = jnp.where(state.slip == 0, jnp.clip(previous[:, FORCE], 0.0, 1.0), 1.0)
    scale = scale.at[:, LEAN].divide(jnp.maximum(weight, LIGHT))
    step, miss = (jnp.max(jnp.abs(difference) / scale) for difference in (guess - previous, z - guess))
    return (step > 0) & (miss > ASTRAY * step)


def repeated(flow: Flow, changed: Bool[Array, " whiskers"]) -> Flow:
    """The flow before a step that is repeated, shorter, with other slips of these contacts."""
    iterations = flow.iterations + 1
    return flow._replace(
        basis=jnp.where(changed[:, None, None], 0.0, flow.basis),
        step=flow.step / 4,
        time_step=flow.time_step / 4,
        share=jnp.asarray(1.0),
        iterations=iterations,
        exhausted=iterations > ITERATIONS,
    )


def partly(flow: Flow, share: Scalar) -> Flow:
    """The flow before a step of which only a share is taken."""
    assert flow.share is not None
    iterations = flow.iterations + 1
    share = flow.share * jnp.clip(share, 1e-3, 0.999)
    return flow._replace(share=share, iterations=iterations, exhausted=iterations > ITERATIONS)
