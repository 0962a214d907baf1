"""Snaps that gain energy: with friction, a path ends at a snap to a state of higher energy, which no motion reaches."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import contact, newton
from jaxwhisker._equilibrium.contact import SLACK, of_each
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.newton import with_dummy_contacts
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._path.path import Path, Status, cut, event_room, is_snap

GAIN = 1e-6  # relative gain of energy in a snap that is no rounding
JUST_BEFORE = 1e-9  # distance from the end of a path to the snap that ends it, in nodes


def without_gains(problem: Problem, path: Path) -> Path:
    """The path up to the first snap with friction that gains energy; whiskers that are not uniform are not checked."""
    if problem.friction_angle is None or problem.section is not None or problem.attached is not None:
        return path
    nodes = path.nodes
    room, n = nodes.whiskers.shape
    snaps = is_snap(nodes.kind) & (jnp.arange(room) < path.count)
    index = jnp.nonzero(snaps, size=event_room(n), fill_value=room - 1)[0]
    node = jax.tree.map(lambda leaf: leaf[index], nodes)
    energy = jax.vmap(partial(_energy, problem))
    before = energy(Point(node.z_before, node.point.u), jax.vmap(lambda at: at.before)(node))
    after = energy(node.point, jax.vmap(lambda at: at.state)(node))
    gains = snaps[index] & (after - before > GAIN * (after + before))
    place = index[jnp.argmax(gains)] - JUST_BEFORE
    return cut(path, place, jnp.where(jnp.any(gains), Status.unsettled, Status.ok))


def _energy(problem: Problem, point: Point, state: ContactState) -> Scalar:
    """Elastic energy of uniform whiskers and of springs (see energy.py), dimensionless."""
    touching = state.touches
    z, phase = with_dummy_contacts(problem, point.z, state.phase)
    bodies = problem.bodies(point.u, z, state.piece)
    base = of_each(bodies, contact.base, z, phase, state.side, state.friction)
    s = of_each(bodies, contact.arc, z[:, SLACK], phase)
    density = base.bend**2 / (2 * problem.bending_stiffness) + base.force_x * base.cos + base.force_y * base.sin
    way = base.force_x * (base.contact_x - base.x) + base.force_y * (base.contact_y - base.y)
    load = newton.load_of(of_each(bodies, contact.in_base_frame, base), problem.axes)
    load = jnp.where(touching[:, None], load, 0.0)
    return jnp.sum(jnp.where(touching, density * s - way, 0.0)) + jnp.sum(load * problem.displacement(load)) / 2
