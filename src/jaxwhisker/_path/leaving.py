"""How the path leaves an event: along the path in its new mode, or with a snap.

With friction, an event may also change which contacts slip. Along the path of a mode, contacts that slip must not turn
back, and the lean of those that stick must not grow beyond its limit. Contacts that break this are changed one after
the other until none does; the first of them is changed first, which cannot run in circles if the motion is unique
(Murty, Linear Complementarity, Linear and Nonlinear Programming, 1988, chapter 5).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._equilibrium.contact import FORCE, LEAN
from jaxwhisker._equilibrium.newton import LIGHT, is_light, slip_by_contact, slope_sines, with_slips
from jaxwhisker._equilibrium.point import Point, dot, scale_of
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._path import snap_flow
from jaxwhisker._path.approach import FIRST_STEP, approach_of
from jaxwhisker._path.events import LEAN_NOISE, MARGIN_NOISE, Lead, events_of
from jaxwhisker._path.march_state import MarchState, Task, Trial, slips_on
from jaxwhisker._path.path import NO_EVENT, STOP, EventKind, Node, Status, first_case, is_snap, select

ARRIVAL_MISS = 0.1  # the equilibrium at which a flow ends is nearer than this
SLIP_NOISE = 1e-9  # rate of slip, per length of the path, that rounding may cause
SLIPPED_BACK = 1e-9  # distance that a contact may slip back from the end of a flow to the equilibrium near it


def after_arrive(
    problem: Problem, march: MarchState, trial: Trial, stops: Float[Array, " stops"], last: Int[Array, ""]
):
    """Handle the point of an event in its new mode: leave along the path, or begin a snap."""
    point = trial.solution.point
    stop_kind = march.pending.kind == STOP
    heading = jnp.sign(stops[jnp.minimum(march.goal, last)] - march.point.u)
    turned = stop_kind & (march.goal <= last) & (heading != 0)
    direction = jnp.where(turned, heading, march.direction)
    reversed_ = direction != march.direction
    lead = march.lead
    grows = jnp.sum(lead.z * trial.tangent.z) + jnp.sum(lead.pose * trial.tangent_pose) + lead.u * trial.tangent.u
    sign = jnp.where(grows < 0, -1.0, 1.0) * jnp.where(reversed_, -1.0, 1.0)
    tangent = Point(sign * trial.tangent.z, sign * trial.tangent.u)
    node = march.pending._replace(point=point, leaving=tangent)
    march = march._replace(direction=direction)
    after_snap = is_snap(march.pending.kind)
    # After a snap, and only then, the contact may be on the other side of the vertex.
    at = march._replace(point=point, stuck_at=trial.parameters)
    behind = jnp.where(slope_sines(problem, march.state, at.parameters) < 0, -1.0, 1.0)
    onwards = at._replace(
        task=jnp.asarray(int(Task.advance)),
        pose=trial.solution.newton.pose,
        stance=None if march.stance is None else trial.stance,
        tangent=tangent,
        tangent_pose=sign * trial.tangent_pose,
        bend=jax.tree.map(jnp.zeros_like, tangent),
        step=jnp.asarray(FIRST_STEP),
        unstable_at=jnp.asarray(jnp.inf),
        before_vertex=jnp.where(after_snap, behind, march.before_vertex),
    )
    falls = (march.turn(tangent) <= 0) | ~trial.stable
    moved = Point(point.z - march.point.z, point.u - march.point.u)
    if march.state.friction is not None:
        # The lean of a contact that sticks from its first touch is not known beforehand.
        starts = is_light(march.state, march.point.z)
        moved = moved._replace(z=moved.z.at[:, LEAN].multiply(~starts))
        node = node._replace(travel=node.travel + jnp.where(jnp.any(starts), direction * moved.u, 0.0))
    near = trial.solution.converged & (dot(moved, moved, scale_of(march.point.z)) < ARRIVAL_MISS**2)
    # Newton's method may have violated the mode of the flow, or converged to an equilibrium that the flow cannot reach.
    happens = zip(events_of(problem), trial.there, strict=True)
    changes = [jnp.ravel(margin) for event, margin in happens if not event.continues]
    wrong = jnp.any(jnp.concatenate(changes) < -MARGIN_NOISE)
    back = slips_on(problem, march.state, point.z, moved.z)
    if back is not None:
        wrong |= jnp.any(back < -SLIPPED_BACK)
    early = after_snap & (wrong | falls | ~near)
    flowing = march._replace(
        task=jnp.asarray(int(Task.flow)),
        flow=march.flow._replace(near=march.flow.near / 4),
    )
    over = _is_over(problem, march, trial, last, stop_kind)
    cases = [
        (early, flowing),
        (~near, march.stopped(Status.lost)),
        (over, march.stopped(Status.ok)),
    ]
    write = near & ~early
    if march.tries is not None:
        changed, slip = _changed_slips(problem, march, point, tangent, falls)
        first = march.tries == 0
        retry = with_changed_slips(problem, onwards, node, slip, trial.tangent, rest=False)
        undetermined = march.stopped(Status.undetermined)
        cases += [
            (changed & (march.tries > 4**march.state.phase.size), undetermined),
            (changed, retry),
            ((march.turn(tangent) <= 0) & trial.stable, undetermined),
        ]
        none = jnp.zeros_like(march.state.phase, bool)
        onwards = onwards._replace(tries=jnp.zeros_like(march.tries), rests=none)
        write &= over | first | ~changed
    return first_case(*cases, (falls, to_snap(onwards)), otherwise=onwards), write, node


def _changed_slips(
    problem: Problem, march: MarchState, point: Point, tangent: Point, falls: Bool[Array, ""]
) -> tuple[Bool[Array, ""], Int[Array, " whiskers"]]:
    """Whether a contact breaks a law of friction along the tangent, and the slips after the first one is changed."""
    friction, limit = march.state.friction, problem.friction_angle
    onwards = slips_on(problem, march.state, point.z, tangent.z)
    assert friction is not None and limit is not None and onwards is not None
    assert march.tries is not None and march.rests is not None
    slip, force, leans = friction.slip, point.z[:, FORCE], point.z[:, LEAN]
    # A contact that has just begun may slip either way or, if neither presses on, stick.
    unloaded = (slip != 0) & (force <= LIGHT)
    backwards = (onwards < -SLIP_NOISE) | (march.state.touches & unloaded & falls & (limit > 0))
    sticks = march.state.sticks
    exceeds = (jnp.abs(leans) > limit - SLIP_NOISE) & (jnp.sign(leans) * tangent.z[:, LEAN] > SLIP_NOISE)
    # A contact that sticks from its first touch may have a lean that no friction allows.
    allowed = jnp.abs(leans) < limit + LEAN_NOISE
    exceeds = sticks & ~march.rests & (exceeds | (~allowed & is_light(march.state, march.point.z)))
    can_stick = (~unloaded | (march.tries > 0)) & (limit > 0)
    changed = jnp.where(exceeds, jnp.sign(leans).astype(int), jnp.where(can_stick, 0, -slip))
    wrong = backwards | exceeds
    first = wrong & (jnp.cumsum(wrong) == 1)
    return jnp.any(wrong), jnp.where(first, changed, slip)


def with_changed_slips(
    problem: Problem, march: MarchState, node: Node, slip: Int[Array, " whiskers"], arriving: Point, *, rest: bool
) -> MarchState:
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
    assert state.friction is not None
    if not rest:
        starts = is_light(state, z) & (before.slip != 0)
        known, leans = _first_leans(problem, march, arriving)
        z = z.at[:, LEAN].set(jnp.where(starts & known, leans, z[:, LEAN]))
    fresh = march.tries == 0
    # Slips at an event are changed after the event itself.
    z_before = jnp.where(fresh, node.point.z, march.pending.z_before)
    friction_before = select(fresh, before, earlier)
    differ = state.friction.slip != friction_before.slip
    sticks = differ & (state.friction.slip == 0)
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
    ahead = state.friction.slip[:, None] * slip_by_contact(problem, z, state)
    lead = jnp.where((slip == 0)[:, None], inwards, ahead)
    weights = Lead(jnp.where(changes[:, None], lead, 0.0), jnp.zeros_like(march.pose), jnp.asarray(0.0))
    if rest:
        # A lean does not change at first; all else goes on as before.
        same = jnp.where(changes[:, None], arriving.z.at[:, LEAN].set(0.0), arriving.z)
        weights = weights._replace(z=same, u=arriving.u)
    return march._replace(
        task=jnp.asarray(int(Task.arrive)),
        state=state,
        point=pending.point,
        stuck_at=march.parameters,
        lead=weights,
        pending=pending,
        tries=march.tries + 1,
        rests=changes & (slip == 0) if rest else march.rests,
    )


def _first_leans(problem: Problem, march: MarchState, tangent: Point) -> tuple[Bool[Array, " whiskers"], PerWhisker]:
    """Leans of contacts that stick from their first touch, where neither slip is possible; and whether they are known.

    At vanishing force the equations are linear. The path with a contact that sticks is therefore that combination of
    the paths with slips in both directions in which the contact does not slip. The tangent is that with the present
    slips, and the pending node arrives along that with the slips tried before.
    """
    friction, limit, other = march.state.friction, problem.friction_angle, march.pending.arriving
    assert friction is not None and limit is not None
    by_contact = slip_by_contact(problem, march.point.z, march.state)
    rate, other_rate = (jnp.sum(by_contact * one.z, axis=-1) for one in (tangent, other))
    force, other_force = other_rate * tangent.z[:, FORCE], -rate * other.z[:, FORCE]
    onwards = jnp.where(march.direction * (other_rate * tangent.u - rate * other.u) < 0, -1.0, 1.0)
    across = friction.slip * jnp.sin(limit) * (force - other_force)
    along = jnp.cos(limit) * (force + other_force)
    return onwards * along > 0, jnp.arctan2(onwards * across, onwards * along)


def _is_over(
    problem: Problem, march: MarchState, trial: Trial, last: Int[Array, ""], stop_kind: Bool[Array, ""]
) -> Bool[Array, ""]:
    """Whether the march ends here: at the last stop, or on the way to it after all whiskers have passed the object."""
    last_leg = (march.goal >= last) & (march.direction * problem.onwards > 0) & (march.goal > 0)
    gone = approach_of(problem).is_over(march.state, trial.stance) & last_leg
    return (stop_kind & (march.goal > last)) | gone


def to_snap(march: MarchState) -> MarchState:
    """The state that is about to leave an equilibrium that has lost its stability."""
    return march._replace(
        pending=march.pending._replace(
            z_before=march.point.z,
            arriving=march.tangent,
            before=march.state,
            **({} if march.tries is None else {"stop": march.goal, "corner": jnp.asarray(True)}),
        ),
        task=jnp.asarray(int(Task.kick)),
        flow=snap_flow.start(march.state, march.pose, march.point.z, march.flow.way is not None),
        unstable_at=jnp.asarray(jnp.inf),
    )
