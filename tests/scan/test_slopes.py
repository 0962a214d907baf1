"""Tangent rules of a scan: the tangents of JAX, in the plane and in space, and the scenes that are left to it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.slopes import along_each
from jaxwhisker._scan.events import events
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.slopes import event_tangents, memory_tangents, solved_states_now, state_tangents
from jaxwhisker._scan.space import Space
from jaxwhisker._scan.steps import states

EXACT = 1e-10  # of the largest tangent, which is 1e2 near the snap-off
CONTROL = np.linspace(1.0, -0.9, 12)
STEPS = 3
SURFACE = jw.Sphere(1.0, (0.0, 1.3, -0.2))
SPRINGS = jw.Support.follicle(x=70.0, y=80.0, z=90.0, phi_x=3.0, phi_y=4.0, phi=5.0)
BEFORE, FB = jw.Parabola(0.2), jw.Support.fb(70.0, 0.2)
KINDS = {
    "in the plane": jw.Scene(jw.Whisker(), BEFORE, FB),
    "in the plane with friction": jw.Scene(jw.Whisker(), BEFORE, FB, friction=0.3),
    "straight": jw.Scene(jw.Whisker(), SURFACE),
    "curved on springs": jw.Scene(jw.Whisker(intrinsic_curvature=0.3, lateral_curvature=0.1), SURFACE, SPRINGS),
    "with friction": jw.Scene(jw.Whisker(), SURFACE, friction=0.3),
}


def solved(scene):
    """The mechanics, problem, path, memory and solutions of a scene, and the stops of its drive."""
    mechanics, (route, _) = mechanics_of(scene), route_through(CONTROL)
    problem = dimensionless(scene)
    path = mechanics.follow(problem, route.stops, np.asarray(route.last)).path
    memory = mechanics.memory(problem, path, route.stops)
    *_, found = solved_states_now(mechanics, problem, path, np.asarray(route.control), np.asarray(route.travel), memory)
    return mechanics, problem, path, memory, found, jnp.asarray(route.stops)


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
    mechanics, problem, path, memory, solutions, stops = solved(KINDS[kind])
    numbers, control, rng = problem.numbers(), jnp.asarray(CONTROL), np.random.default_rng(0)
    dots, memory_dot, control_dot, stops_dot = random_like((numbers, memory, control, stops), rng)
    nothing = jax.tree.map(lambda leaf: None if eqx.is_inexact_array(leaf) else leaf, problem)
    problem_dot = eqx.combine(dots, jax.tree.map(lambda _: None, nothing))

    def of_states(everything):
        numbers, control, memory = everything
        remembered = mechanics.remembered(memory, path, solutions)
        return states(mechanics, eqx.combine(numbers, problem), control, solutions, remembered)

    def of_events(everything):
        numbers, memory = everything
        return events(mechanics, eqx.combine(numbers, problem), path, memory)

    def of_nodes(everything):
        numbers, stops = everything
        return mechanics.remember(eqx.combine(numbers, problem), path, stops)

    args = mechanics, problem, path, control, None, memory
    args_dot = None, problem_dot, None, control_dot, None, memory_dot
    *found, none = state_tangents(args, args_dot, (solutions,))
    assert not jax.tree.leaves(none)
    expected = by_jax(of_states, (numbers, control, memory), (dots, control_dot, memory_dot))
    agree(tuple(found), expected)
    monkeypatch.setattr(mechanics, "most_numbers", 0)
    *found, none = state_tangents(args, args_dot, (solutions,))
    assert not jax.tree.leaves(none)
    agree(tuple(found), expected)
    monkeypatch.undo()
    found = event_tangents((mechanics, problem, path, memory), (None, problem_dot, None, memory_dot), None)
    if mechanics is Space or memory is None:
        agree(found, by_jax(of_events, (numbers, memory), (dots, memory_dot)))
    else:
        assert found is NotImplemented
    if memory is not None:
        found = memory_tangents((mechanics, problem, path, stops), (None, problem_dot, None, stops_dot), None)
        agree(found, by_jax(of_nodes, (numbers, stops), (dots, stops_dot)))


def test_scenes_of_many_numbers_are_left_to_jax():
    mounts = tuple(jw.Mount(x=0.2 * k) for k in range(8))
    many = dimensionless(jw.Scene(jw.Whisker(), SURFACE, jw.Support(mount=mounts)))
    assert event_tangents((Space, many, None, None), (None, many, None, None), None) is NotImplemented
    assert memory_tangents((Space, many, None, None), (None, many, None, None), None) is NotImplemented


def test_tangents_of_a_step_depend_on_shared_numbers_and_its_own():
    rng = np.random.default_rng(0)
    slopes = {"a": jnp.asarray(rng.normal(size=(STEPS, 2, 6))), "none": None}
    shared = [jnp.asarray(rng.normal(size=(1, 2))), jnp.asarray(0.7)]
    own = [jnp.asarray(rng.normal(size=(STEPS, 2))), jnp.asarray(rng.normal(size=STEPS))]
    found = along_each(slopes, shared, own)["a"]
    for k in range(STEPS):
        direction = np.concatenate([np.ravel(shared[0]), [0.7], own[0][k], [own[1][k]]])
        np.testing.assert_allclose(found[k], slopes["a"][k] @ direction, atol=EXACT)
    np.testing.assert_allclose(along_each({"a": slopes["a"][..., 3:]}, [], own)["a"].shape, (STEPS, 2))


def test_a_step_does_not_see_tangents_that_it_does_not_depend_on():
    """After a snap with friction, contacts at rest have none, but a whisker that has come free since has."""
    slopes = {"a": jnp.array([[[2.0, 0.0]], [[2.0, 3.0]]])}
    found = along_each(slopes, [jnp.asarray(0.5)], [jnp.full(2, jnp.nan)])["a"]
    np.testing.assert_array_equal(found, [[1.0], [jnp.nan]])
