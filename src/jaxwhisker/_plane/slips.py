"""Slips of whiskers with one contact each, where the path leaves an event and in each step of a snap."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import LIGHT, slipping_from
from jaxwhisker._equilibrium.newton import is_light, slip_by_contact, with_slips
from jaxwhisker._equilibrium.point import Contacts, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._path.path import Node
from jaxwhisker._path.slips import LeavingContacts, corrected_slips, first_leans, lead_of, leaving_with
from jaxwhisker._plane.events import Lead
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
    state, limit = march.state, problem.friction_angle
    assert limit is not None and march.slips_tried is not None and march.rests is not None
    contacts = LeavingContacts(
        slip=state.slip,
        force=point.z[:, FORCE],
        lean=point.z[:, LEAN],
        lean_rate=tangent.z[:, LEAN],
        slip_rate=slip_rates(problem, state, point.z, tangent.z),
        sticks=state.sticks,
        slips_either_way=state.touches,
        light=is_light(state, march.point.z),
    )
    return corrected_slips(contacts, limit, falls, march.slips_tried, march.rests)


def with_changed_slips(
    problem: Problem, march: MarchInPlane, node: Node, slip: Int[Array, " whiskers"], arriving: Point, *, rest: bool
) -> MarchInPlane:
    """The state at a node, before the direction in which the path leaves with these slips is determined.

    See `leaving_with` for the arguments.
    """
    before, limit = march.state.friction, problem.friction_angle
    assert before is not None and limit is not None
    z, state = with_slips(problem, node.point.z, march.state, slip, march.parameters)
    light, of_lean = is_light(state, z), jnp.broadcast_to(jnp.arange(3) == LEAN, z.shape)
    if not rest:
        by_contact = slip_by_contact(problem, march.point.z, march.state)
        other = march.pending.arriving
        known, leans = first_leans(by_contact, before.slip, limit, march.direction, arriving, other)
        starts = light & (before.slip != 0) & known
        z = z.at[:, LEAN].set(jnp.where(starts, leans, z[:, LEAN]))
    assert state.friction is not None
    new, changes = leaving_with(march, node, z, state.friction, arriving, rest=rest)
    lead = lead_of(new, changes, before.slip, light, of_lean, slip_by_contact(problem, z, state), rest=rest)
    return new.replace(stuck_at=march.parameters, lead=Lead(lead.z, jnp.zeros_like(march.pose), lead.u))


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
