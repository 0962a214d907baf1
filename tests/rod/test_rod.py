"""The rod against its closed form: Jacobi's elliptic functions seen from the contact (Steigenberger 2013)."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ellipeinc, ellipj, ellipkinc

from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import Body, Phase
from jaxwhisker._model.profiles import Parabola
from jaxwhisker._rod import rod
from jaxwhisker._rod.elastica import ClosedForm, Shooting, rod_end

STEPS = Shooting().steps
CLOSED_FORM = 1e-9  # what is promised of position, direction and curvature, for every bend that a scan meets
ORDER_STEPS = {4: (8, 16), 6: (2, 4)}  # steps at which the order shows, above rounding
SLOPE = 1e-8  # of derivatives: central differences of the closed form lose half the digits


def closed_form(force, angle, arc):
    """Base relative to the contact, in the contact's frame: x, y, theta; and the curvature at the base."""
    k = np.sin((np.pi / 2 - angle) / 2)
    m, root = k**2, np.sqrt(force)
    quarter, whole_e = ellipkinc(np.pi / 2, m), ellipeinc(np.pi / 2, m)
    sn, cn, _, amplitude = ellipj(quarter - root * arc, m)
    d_f, d_e = root * arc, whole_e - ellipeinc(amplitude, m)
    along, up = 2 * k * cn / root, (2 * d_e - d_f) / root
    return -along, -up, np.pi / 2 - 2 * np.arcsin(k * sn), -2 * root * k * cn


@jax.jit
def integrated(force, angle, arc):
    start = (jnp.zeros(()), jnp.zeros(()), jnp.cos(angle), jnp.sin(angle))
    load = rod.Load(jnp.zeros(()), -force, jnp.zeros(()))
    x, y, cos, sin = rod.integrate(start, arc, load, 1.0, steps=STEPS, solver=rod.Splitting())
    return x, y, jnp.arctan2(sin, cos), rod.moment(x, y, load)


# sqrt(f) s1 stays below 2.6 in every equilibrium of a scan: f grows as the arc shrinks.
bends = st.tuples(st.floats(0.05, 2.6), st.floats(0.05, 1.0), st.one_of(st.just(0.0), st.floats(0.0, 1.2)))


@given(bends)
def test_shape_arc_and_curvature(bend):
    sigma, arc, angle = bend
    force = (sigma / arc) ** 2
    got, exact = np.array(integrated(force, angle, arc)), np.array(closed_form(force, angle, arc))
    sizes = np.array([1.0, 1.0, 1.0, max(1.0, abs(exact[3]))])
    turns = np.array([0.0, 0.0, 2 * np.pi * np.round((got[2] - exact[2]) / (2 * np.pi)), 0.0])
    assert np.max(np.abs(got - turns - exact) / sizes) < CLOSED_FORM


@given(bends, st.floats(-1.0, 1.0))
def test_pose_and_reaction_in_the_scene(bend, slope):
    sigma, arc, angle = bend
    force = (sigma / arc) ** 2
    profile = Parabola(0.3, 0.7)
    tip = angle > 0
    length = arc if tip else 1.5
    body = Body(jnp.asarray(length), jnp.asarray(1.0), profile, Shooting())
    slack = -angle if tip else length - arc
    base = posed(body, jnp.array([force, slope, slack]), jnp.asarray(int(Phase.tip if tip else Phase.tangential)))
    x, y, theta, curvature = closed_form(force, angle, arc)
    cos, sin = np.cos(slope), np.sin(slope)
    at_x, at_y = np.tan(slope) / (2 * 0.7), 0.3 + np.tan(slope) ** 2 / (4 * 0.7)
    assert abs(base.x - (at_x + x * cos - y * sin)) < CLOSED_FORM
    assert abs(base.y - (at_y + x * sin + y * cos)) < CLOSED_FORM
    assert abs(base.cos - np.cos(theta + slope)) < CLOSED_FORM
    assert abs(base.sin - np.sin(theta + slope)) < CLOSED_FORM
    assert abs(base.bend - curvature) < CLOSED_FORM * max(1, abs(curvature))
    assert abs(base.force_x - force * sin) < CLOSED_FORM * force
    assert abs(base.force_y + force * cos) < CLOSED_FORM * force


posed = jax.jit(lambda body, z, phase: contact.base(body, z, phase, 1.0))


@pytest.mark.parametrize(("stages", "order"), [(6, 4), (10, 6), (11, 6)])
def test_the_splitting_is_of_its_order(stages, order):
    x, y, theta, _ = closed_form(4.0, 0.3, 1.0)
    solver, errors = rod.Splitting(stages), []
    assert solver.order(diffrax.ODETerm(lambda t, y, args: y)) == order
    for steps in ORDER_STEPS[order]:
        start = (jnp.zeros(()), jnp.zeros(()), jnp.cos(0.3), jnp.sin(0.3))
        load = rod.Load(jnp.zeros(()), jnp.asarray(-4.0), jnp.zeros(()))
        end = rod.integrate(start, 1.0, load, 1.0, steps=steps, solver=solver)
        errors.append(np.max(np.abs(np.array(end) - [x, y, np.cos(theta), np.sin(theta)])))
    assert order - 0.5 < np.log2(errors[0] / errors[1]) < order + 1.5


def test_another_number_of_stages_is_refused():
    with pytest.raises(ValueError, match="`stages` must be 6, 10 or 11, but is 7"):
        rod.Splitting(stages=7)


def test_a_stock_solver_takes_the_same_rod():
    start = (jnp.zeros(()), jnp.zeros(()), jnp.ones(()), jnp.zeros(()))
    load = rod.Load(jnp.zeros(()), jnp.asarray(-3.0), jnp.zeros(()))
    ours = rod.integrate(start, 1.0, load, 1.0, steps=STEPS, solver=rod.Splitting())
    stock = rod.integrate(start, 1.0, load, 1.0, steps=40, solver=diffrax.Dopri8())
    np.testing.assert_allclose(np.array(ours), np.array(stock), atol=CLOSED_FORM)


def test_derivatives_agree_in_both_modes_and_with_the_closed_form():
    at = (3.0, 0.4, 1.0)

    def height(force, angle, arc):
        return integrated(force, angle, arc)[1]

    forward = np.array(jax.jacfwd(height, argnums=(0, 1, 2))(*at))
    reverse = np.array(jax.jacrev(height, argnums=(0, 1, 2))(*at))
    np.testing.assert_allclose(forward, reverse, rtol=1e-12)
    step = 1e-5
    for i, slope in enumerate(forward):
        near = [np.array(at), np.array(at)]
        near[0][i] -= step
        near[1][i] += step
        exact = (closed_form(*near[1])[1] - closed_form(*near[0])[1]) / (2 * step)
        assert abs(slope - exact) < SLOPE


def test_points_run_from_start_to_end():
    start = (jnp.zeros(()), jnp.zeros(()), jnp.ones(()), jnp.zeros(()))
    load = rod.Load(jnp.zeros(()), jnp.asarray(-3.0), jnp.zeros(()))
    states = rod.points(start, 1.0, load, 1.0, count=9)
    end = rod.integrate(start, 1.0, load, 1.0, steps=8, solver=rod.Splitting())
    np.testing.assert_allclose([s[0] for s in states], [0, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose([s[-1] for s in states], np.array(end), atol=1e-15)


@pytest.mark.parametrize(("solver", "steps"), [(diffrax.Dopri8(), 12), (diffrax.Tsit5(), 60)])
def test_stock_solvers_have_derivatives_in_both_modes(solver, steps):
    at = jnp.array([3.0, 0.8, 0.4])

    def end(method):
        return lambda z: rod_end(*z, method, method)

    exact = jax.jacfwd(end(ClosedForm()))(at)
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(end(Shooting(steps, solver)))(at), exact, atol=SLOPE)
