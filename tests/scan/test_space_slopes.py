"""Tangent rules of a scan in space: the tangents of JAX, and the scenes that are left to it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan import space_slopes
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.space_scan import follow_path_now, linked_now, problem_now, solved_states_now
from jaxwhisker._scan.space_signals import events
from jaxwhisker._scan.space_slopes import event_tangents, linked_tangents, state_tangents
from jaxwhisker._scan.space_steps import states
from jaxwhisker._space.history import linked

EXACT = 1e-10  # of the largest tangent, which is 1e2 near the snap-off
CONTROL = np.linspace(1.0, -0.9, 12)
SURFACE = jw.Sphere(1.0, (0.0, 1.3, -0.2))
SPRINGS = jw.Support.follicle(x=70.0, y=80.0, z=90.0, phi_x=3.0, phi_y=4.0, phi=5.0)
KINDS = {
    "straight": jw.Scene(jw.Whisker(), SURFACE),
    "curved on springs": jw.Scene(jw.Whisker(intrinsic_curvature=0.3, lateral_curvature=0.1), SURFACE, SPRINGS),
    "with friction": jw.Scene(jw.Whisker(), SURFACE, friction=0.3),
}


def solved(scene):
    """The problem, path, nodes with friction, and solutions of a scene, and the stops of its drive."""
    problem, (route, _) = problem_now(scene), route_through(CONTROL)
    path = follow_path_now(problem, route.stops, np.asarray(route.last)).path
    links = None if problem.friction is None else linked_now(problem, path, route.stops)
    *_, found = solved_states_now(problem, path, np.asarray(route.control), np.asarray(route.travel), links)
    return problem, path, links, found, jnp.asarray(route.stops)


def random_like(tree, rng):
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=jnp.shape(leaf))), tree)


def by_jax(function, numbers, dots):
    """Tangents of the real values of a function."""

    def smooth(numbers):
        return eqx.filter(function(numbers), eqx.is_inexact_array)

    return jax.jit(lambda dots: jax.jvp(smooth, (numbers,), (dots,))[1])(dots)


def agree(found, expected):
    """Compare trees; what has no tangent is None."""
    every = jax.tree.leaves(expected)
    assert len(jax.tree.leaves(found)) == len(every) > 0
    for own, other in zip(jax.tree.leaves(found), every, strict=True):
        np.testing.assert_allclose(own, other, atol=EXACT * (1 + np.nanmax(np.abs(other), initial=0.0)))


@pytest.mark.parametrize("kind", KINDS)
def test_tangents_are_those_of_jax(kind, monkeypatch):
    problem, path, links, solutions, stops = solved(KINDS[kind])
    numbers, control, rng = problem.numbers(), jnp.asarray(CONTROL), np.random.default_rng(0)
    dots, links_dot, control_dot, stops_dot = random_like((numbers, links, control, stops), rng)
    nothing = jax.tree.map(lambda leaf: None if eqx.is_inexact_array(leaf) else leaf, problem)
    problem_dot = eqx.combine(dots, jax.tree.map(lambda _: None, nothing))

    def of_states(everything):
        numbers, control, links = everything
        return states(eqx.combine(numbers, problem), control, solutions, path, links)

    def of_events(everything):
        numbers, links = everything
        return events(eqx.combine(numbers, problem), path, links)

    def of_nodes(everything):
        numbers, stops = everything
        return linked(eqx.combine(numbers, problem), path, stops)

    args, args_dot = (problem, path, control, None, links), (problem_dot, None, control_dot, None, links_dot)
    *found, none = state_tangents(args, args_dot, (solutions,))
    assert not jax.tree.leaves(none)
    expected = by_jax(of_states, (numbers, control, links), (dots, control_dot, links_dot))
    agree(tuple(found), expected)
    monkeypatch.setattr(space_slopes, "MOST_NUMBERS", 0)
    *found, none = state_tangents(args, args_dot, (solutions,))
    assert not jax.tree.leaves(none)
    agree(tuple(found), expected)
    monkeypatch.undo()
    found = event_tangents((problem, path, links), (problem_dot, None, links_dot), None)
    agree(found, by_jax(of_events, (numbers, links), (dots, links_dot)))
    if links is not None:
        found = linked_tangents((problem, path, stops), (problem_dot, None, stops_dot), None)
        agree(found, by_jax(of_nodes, (numbers, stops), (dots, stops_dot)))


def test_scenes_of_many_numbers_are_left_to_jax():
    mounts = tuple(jw.Mount(x=0.2 * k) for k in range(8))
    many = problem_now(jw.Scene(jw.Whisker(), SURFACE, jw.Support(mount=mounts)))
    assert event_tangents((many, None, None), (many, None, None), None) is NotImplemented
    assert linked_tangents((many, None, None), (many, None, None), None) is NotImplemented
