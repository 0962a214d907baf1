"""Derivatives of solved points and events: exact ones, central differences, both modes, no silent zeros."""

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxwhisker as jw
from exact_contacts import DISTANCE, branch, contacts, fb_control, fbfb_at
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.implicit import event_control, solved
from jaxwhisker._equilibrium.newton import newton_step
from jaxwhisker._equilibrium.point import PathCondition, Point, at_control
from jaxwhisker._equilibrium.solver import solve_point

MODES = 1e-11  # forward against reverse, relative to the largest
DIFFERENCE = 1e-6  # central differences of solved points, relative to the largest
EXACT = 1e-8  # derivatives of events that are known exactly
FOLD = 1e-6  # ... of a fold, where the state is known to the root of its residual
NO = jnp.asarray(False)


def fbfb(p):
    """FBFB by stiffnesses, rest lengths, distance and curvature of the object, stiffness of whisker 2, and control."""
    c1, c2, l1, l2, q, a, bending, _ = p
    whiskers = (jw.Whisker(), jw.Whisker(1.0, bending))
    return jw.Scene(
        whiskers, jw.Parabola(q, a), jw.Support.fbfb(jnp.stack([c1, c2]), jnp.stack([l1, l2])), jw.ClosedForm()
    )


@pytest.fixture(scope="module")
def at():
    """Parameters of an exact equilibrium, its contacts and mode."""
    stiffness = (70.0, 40.0)
    rest_length = [float(spring.rest_length) for spring in fbfb_at(1.3, 0.6, stiffness).support.springs]
    here = contacts(1.3, 0.6)
    p = jnp.array([*stiffness, *rest_length, DISTANCE, 1.0, 1.0, 0.0])
    return p, jnp.asarray(here.z), ContactState(jnp.asarray(here.phase), jnp.ones(2))


def test_derivatives_of_a_solved_point(at):
    p, z, state = at

    def contact(p):
        u = p[-1]
        return solved(Point(z, jax.lax.stop_gradient(u)), problem_of(fbfb(p)), state, at_control(u, z)).z

    @Program
    def iterated(p):
        return solve_point(problem_of(fbfb(p)), state, at_control(p[-1], z), Point(z, p[-1])).point.z

    @Program
    def both(p):
        value, along = jax.linearize(contact, p)
        back = jax.linear_transpose(along, p)
        return (
            value,
            jax.vmap(along)(jnp.eye(p.size)),
            jax.vmap(lambda w: back(w)[0])(jnp.eye(z.size).reshape(-1, 2, 3)),
        )

    value, forward, reverse = both(p)
    assert np.array_equal(value, z)
    size = np.max(np.abs(forward))
    np.testing.assert_allclose(np.reshape(forward, (p.size, -1)), reverse.T, atol=MODES * size)
    for k in range(p.size):
        step = 1e-5 * max(1.0, abs(float(p[k]))) * jnp.eye(p.size)[k]
        difference = (iterated(p + step) - iterated(p - step)) / (2 * jnp.sum(step))
        np.testing.assert_allclose(forward[k], difference, atol=DIFFERENCE * size)
        assert np.max(np.abs(forward[k])) > 1e-4


def fold_of(stiffness, profile=None):
    """Parameter on the clamped branch, control and force along x where FB with rest length 0 loses stability."""
    clamped = branch() if profile is None else exact.ClampedBranch(profile)

    def excess(p):
        _, _, dx, dforce = clamped.piece(p)(p)
        return float(dforce - stiffness * dx)

    p = float(brentq(excess, 2.0, clamped.fold, xtol=1e-15))  # pyright: ignore[reportArgumentType]
    x, force, _, _ = clamped.piece(p)(p)
    return p, float(x - force / stiffness), float(force)


def change_of(profile):
    """Position of the base and force along x where tip contact turns tangential."""
    clamped = exact.ClampedBranch(profile)
    x, force, _, _ = clamped.piece(clamped.borders[1])(clamped.borders[1])
    return x, force


KINDS = ("tip to tangential", "vertex", "fold")
STIFFNESS = 70.0


@pytest.fixture(scope="module")
def events():
    """Derivatives of the controls of three events by stiffness, rest length and distance, in one program."""
    change, vertex = branch().borders[1], 1.0
    fold, _, _ = fold_of(STIFFNESS)
    points = [contacts(change, tip=True), contacts(vertex), contacts(fold)]
    z = jnp.stack([jnp.asarray(at.z) for at in points])
    z = z.at[0, 0, 2].set(0.0)
    phase = jnp.stack([jnp.asarray(at.phase) for at in points])
    u = jnp.array([fb_control(change, STIFFNESS), fb_control(vertex, STIFFNESS), fb_control(fold, STIFFNESS)])

    def scene(p):
        return jw.Scene(jw.Whisker(), jw.Parabola(p[2]), jw.Support.fb(p[0], p[1]), jw.ClosedForm())

    def control(p, z, u, phase, kind):
        problem, state, point = problem_of(scene(p)), ContactState(phase, jnp.ones(1)), Point(z, u)
        along = newton_step(problem, state, PathCondition(z, z, jnp.asarray(1.0), u, 0.0 * z[:, 0]), point).tangent
        along = jax.lax.stop_gradient(along)
        # The slack is zero, or the slope is; at a fold neither.
        slack = jnp.zeros_like(z).at[:, 2].set(kind == 0)
        condition = PathCondition(slack, 0.0 * z, jnp.asarray(0.0), u, jnp.full(1, kind == 1, float))
        return event_control(point, problem, state, along, condition, kind == 2)

    @Program
    @jax.vmap
    def both(z, u, phase, kind):
        p = jnp.array([STIFFNESS, 0.2, DISTANCE])
        value, along = jax.linearize(lambda p: control(p, z, u, phase, kind), p)
        return value, jax.vmap(along)(jnp.eye(3)), jax.linear_transpose(along, p)(jnp.ones(()))[0]

    value, forward, reverse = both(z, u, phase, jnp.arange(3))
    assert np.array_equal(value, u)
    return forward, reverse, [float(at.force_x[0]) for at in points]


@pytest.mark.parametrize("kind", range(3), ids=KINDS)
def test_derivatives_of_events_agree_in_both_modes(events, kind):
    forward, reverse, _ = events
    np.testing.assert_allclose(forward[kind], reverse[kind], atol=MODES * max(1.0, np.max(np.abs(forward[kind]))))


@pytest.mark.parametrize("kind", range(3), ids=KINDS)
def test_springs_shift_events_by_their_own_stretch(events, kind):
    # u = x0 - rest_length - F_x / c; the contact of the event does not depend on the spring. At a fold it does, but
    # there u is stationary.
    forward, _, forces = events
    tolerance = FOLD if KINDS[kind] == "fold" else EXACT
    np.testing.assert_allclose(forward[kind, :2], [forces[kind] / STIFFNESS**2, -1.0], atol=tolerance)


def test_a_nearer_object_shifts_events(events):
    forward, _, _ = events
    h = 1e-4

    def controls(distance):
        profile = exact.parabola(distance)
        x, force = change_of(profile)
        at_vertex = exact.ClampedBranch(profile).states(1.0).base_x
        return np.array([x - force / STIFFNESS, at_vertex, fold_of(STIFFNESS, profile)[1]])

    difference = (controls(DISTANCE + h) - controls(DISTANCE - h)) / (2 * h)
    assert np.all(np.abs(difference) > 0.1)
    np.testing.assert_allclose(forward[:, 2], difference, atol=1e-5)  # the square of h, times third derivatives
