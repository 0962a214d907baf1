"""Settling: how a snap goes on from one step of the flow of the bases to the next, until they come to rest.

With friction, a step of the flow is solved for with given slips, and accepted if they agree with how the contacts move
in it. In a short step the bases follow the pull of the network, which then decides about all slips.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.friction import slipping_from
from jaxwhisker._equilibrium.newton import LIGHT, slip_by_contact, with_slips
from jaxwhisker._equilibrium.point import Contacts, Point, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path import snap_flow
from jaxwhisker._path.events import Lead
from jaxwhisker._path.march_state import MarchState, Task, Trial
from jaxwhisker._path.path import EventKind, Status, first_case
from jaxwhisker._path.snap_flow import ITERATIONS, Flow, branch_known

SLIPPED = 1e-12  # distance that a contact may slip back before it sticks
LEANING = 1e-12  # angle by which a contact that sticks may lean too far
AT_LIMIT = 1e-11  # a contact that sticks begins to slip where its lean is this close to its limit
ASTRAY = 0.5  # relative distance between the guess and the solution of a step that is too long


def after_flow(problem: Problem, march: MarchState, proposed: snap_flow.Flow, trial: Trial):
    """Handle a step of the overdamped bases."""
    solution, at = trial.solution, trial.stance
    flow, state, z = snap_flow.advance(problem, proposed, march.state, march.point.z, solution, at, trial.parameters)
    rested = snap_flow.at_rest(problem, flow, state, march.point.u)
    freed = flow.slipped & state.free
    kind = jnp.where(jnp.any(freed), EventKind.snap_off, EventKind.snap_through)
    none = jnp.zeros_like(z)
    pending = march.pending._replace(
        state=state,
        travel=march.travel,
        kind=kind,
        whiskers=flow.slipped,
    )
    flowing = march._replace(
        task=jnp.where(rested, Task.arrive, Task.flow),
        state=state,
        point=Point(z, march.point.u),
        pose=flow.pose,
        stuck_at=trial.parameters,
        flow=flow,
        pending=pending,
        lead=Lead(none, jnp.zeros_like(flow.pose), march.direction),
    )
    shorter = march._replace(flow=snap_flow.shortened(march.flow))
    cases, converged = [], solution.converged
    if march.state.friction is not None:
        astray = goes_astray(march.state, march.point.z, proposed.guess, solution.point.z)
        # The first step goes along the path at a fixed drive, but frames that move with the drive move along the path.
        converged &= ~(astray & ((march.task != Task.kick) | (not problem.frames_move)))
        # The first step must not leave the object: contacts may be lighter than it is long.
        converged &= (march.task != Task.kick) | ~jnp.any(march.state.touches & (solution.point.z[:, FORCE] < 0))
        found = disagreement(problem, march.flow, march.state, march.point.z, solution.point.z)
        stuck, other = with_slips(problem, march.point.z, march.state, found.slip, march.parameters)
        again = march._replace(
            task=jnp.asarray(int(Task.flow)),
            state=other,
            point=march.point._replace(z=stuck),
            stuck_at=march.parameters,
            flow=repeated(march.flow, found.slip != march.state.friction.slip),
        )
        cut = march._replace(flow=partly(march.flow, found.share))
        exhausted = cut.flow.exhausted & converged & (found.wrong | (found.share < 1))
        cases = [
            (exhausted, march.stopped(Status.unsettled)),
            (converged & found.wrong, again),
            (converged & (found.share < 1), cut),
        ]
    new = first_case(
        *cases,
        (jnp.where(converged, flow.exhausted, shorter.flow.exhausted), march.stopped(Status.unsettled)),
        (~converged, shorter),
        otherwise=flowing,
    )
    return new, jnp.asarray(False), march.pending


class Disagreement(NamedTuple):
    """Contacts whose slips, with which a step was solved for, do not agree with how they move in it."""

    wrong: Bool[Array, ""]  # whether the step must be repeated with other slips
    slip: Int[Array, " whiskers"]  # these slips
    share: Scalar  # of the step, up to which no lean exceeds its limit


def disagreement(problem: Problem, flow: Flow, state: ContactState, previous: Contacts, z: Contacts) -> Disagreement:
    """Compare the motion of contacts in a step with their slips.

    A contact that slips back sticks from the start of the step on; one that sticks slips from where its lean reaches
    the limit. Only the first of several is changed at a time (see leaving.py).
    """
    assert state.friction is not None and problem.friction_angle is not None
    slip, limit = state.friction.slip, problem.friction_angle
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
    assert state.friction is not None
    scale = scale_of(previous)
    # The leans of small forces are not accurate.
    weight = jnp.where(state.friction.slip == 0, jnp.clip(previous[:, FORCE], 0.0, 1.0), 1.0)
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
