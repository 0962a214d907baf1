"""Intermediate states of a snap.

The march only stores the states before and after a snap. Here the overdamped flow of the bases (snap_flow.py) is
computed again, from the node of the path at which stability was lost. All states in which no whisker slips are stored.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import FORCE
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.newton import Apart, contact_parameters, newton_step
from jaxwhisker._equilibrium.point import Contacts, PathCondition, Point, at_control, dot, scale_of, unit
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._equilibrium.stance import Poses
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Node, select
from jaxwhisker._plane import snap_flow
from jaxwhisker._scan.detect import kinds_of
from jaxwhisker._scan.plane import path_through, problem_now
from jaxwhisker._scan.result import Result
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.signals import signals
from jaxwhisker._scan.state import State

MOST_STATES = 1024  # states stored per flow; snaps of the march take a few hundred steps


class _Kept(NamedTuple):
    """Contacts and bases in a state of the flow."""

    z: Contacts
    state: ContactState
    pose: Poses


class _Going(NamedTuple):
    flow: snap_flow.Flow
    state: ContactState
    z: Contacts
    begun: Bool[Array, ""]
    over: Bool[Array, ""]
    kept: _Kept  # (MOST_STATES, ...)
    count: Int[Array, ""]


def flows(result: Result, numbers: Sequence[int]) -> list[State]:
    """States (states, whiskers) of the flow of each of these events of a scan, without the first and the last ones.

    If a whisker swings free or to the far side while its base stands still, it does so between two of these states.
    """
    if not numbers:
        return []
    scene = jax.tree.map(checks.as_float, result.scene)
    route, problem = route_of(np.asarray(result.control)), problem_now(scene)
    path = path_through(problem, kinds_of(scene), jnp.asarray(route.stops), jnp.asarray(route.last)).path
    kind, travel = np.asarray(path.nodes.kind), np.asarray(path.nodes.travel)
    passed = np.arange(kind.size) < int(path.count)
    nodes = np.flatnonzero((kind >= 0) & passed & (np.cumsum(passed & (travel >= 0)) > 0))
    found = []
    for node in nodes[list(numbers)]:
        states, count = _flow_now(scene, jax.tree.map(lambda leaf, k=node - 1: leaf[k], path.nodes))
        found.append(jax.tree.map(lambda leaf, n=int(count): np.asarray(leaf)[:n], states))
    return found


def _flow(scene: Scene, before: Node) -> tuple[State, Int[Array, ""]]:
    """States of the flow that begins at a node of the path, padded, and their number."""
    dimensionless, u = problem_of(scene), before.point.u
    still = before.state
    tangent, tangent_pose, pose = _leaving(dimensionless, still, before)

    def step(at: _Going) -> _Going:
        kicked = snap_flow.kick(at.flow, before.point, tangent, tangent_pose)
        flow = select(at.begun, snap_flow.propose(dimensionless, at.flow, at.state, Point(at.z, u)), kicked)
        apart = Apart(jnp.asarray(True), dimensionless.across(flow.pose))
        solution = solve_point(dimensionless, at.state, at_control(u, flow.guess), Point(flow.guess, u), apart)
        pose = jnp.where(dimensionless.solved(at.state.phase)[:, None], solution.newton.pose, flow.pose)
        stance = dimensionless.stance(u, pose, solution.point.z)
        parameters = contact_parameters(dimensionless, solution.point.z, at.state)
        flow, state, z = snap_flow.advance(dimensionless, flow, at.state, at.z, solution, stance, parameters)
        rested = snap_flow.at_rest(dimensionless, flow, state, u)
        keep = ~jnp.any(flow.sliding | flow.landing)
        now = _Kept(z, state, flow.pose)
        index = jnp.where(keep, at.count, MOST_STATES)
        kept = jax.tree.map(lambda all, one: all.at[index].set(one, mode="drop"), at.kept, now)
        onwards = _Going(flow, state, z, jnp.asarray(True), rested | flow.exhausted, kept, at.count + keep)
        shorter = snap_flow.shortened(at.flow)
        return select(solution.converged, onwards, at._replace(flow=shorter, over=shorter.exhausted))

    first = _Kept(before.point.z, still, pose)
    room = jax.tree.map(lambda leaf: jnp.zeros((MOST_STATES, *leaf.shape), leaf.dtype), first)
    no = jnp.asarray(False)
    flow = snap_flow.start(still, pose, before.point.z, dimensionless.profile.has_edges)
    start = _Going(flow, still, before.point.z, no, no, room, jnp.asarray(0))
    end = jax.lax.while_loop(lambda at: ~at.over & (at.count < MOST_STATES), step, start)
    return jax.vmap(lambda kept: _state_in_scene(dimensionless, u, kept))(end.kept), end.count


def _leaving(problem: Problem, state: ContactState, before: Node) -> tuple[Point, Poses, Poses]:
    """Tangent of the path at a node, for contacts and for bases, and the poses of the bases."""
    point, leaving = before.point, before.leaving
    scale, none = scale_of(point.z), jnp.zeros_like(point.z[:, FORCE])
    here = newton_step(problem, state, PathCondition(leaving.z / scale**2, point.z, leaving.u, point.u, none), point)
    tangent, length = unit(here.tangent, point.z)
    sign = jnp.where(dot(leaving, tangent, scale) < 0, -1.0, 1.0)
    return Point(sign * tangent.z, sign * tangent.u), sign / length * here.tangent_pose, here.pose


def _state_in_scene(problem: Problem, u: Scalar, kept: _Kept) -> State:
    """State in the scene's units; bases of free whiskers have the pose of the flow."""
    state, *_ = signals(problem, kept.z, u, kept.state)
    here, free = problem.in_scene(u, kept.pose), ~problem.solved(kept.state.phase)
    return dataclasses.replace(
        state,
        base_x=jnp.where(free, here.x * problem.unit.length, state.base_x),
        base_y=jnp.where(free, here.y * problem.unit.length, state.base_y),
        base_angle=jnp.where(free, here.angle, state.base_angle),
    )


_flow_now = Program(_flow)
