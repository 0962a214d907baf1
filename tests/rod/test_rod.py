"""Integrated rods against their closed form by elliptic integrals (Steigenberger 2013)."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ellipeinc, ellipj, ellipkinc

from functions import Linear
from jaxwhisker._equilibrium import contact
from jaxwhisker._equilibrium.contact import Phase, WhiskerAtObject
from jaxwhisker._model.conic import Parabola
from jaxwhisker._rod import rod
from jaxwhisker._rod.elastica import Shooting

STEPS = Shooting().steps
CLOSED_FORM = 1e-9  # documented error of position, direction and curvature for all bends that occur in scans
ORDER_STEPS = {4: (8, 16), 6: (2, 4)}  # numbers of steps whose errors are above rounding
SLOPE = 1e-8  # of derivatives: central differences lose half the digits


def closed_form(force, angle, arc):
    """Base in the frame of the contact: x, y, theta; and the curvature at the base."""
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


# sqrt(f) s1 stays below 2.6 in every equilibrium of a scan: f increases as the arc decreases.
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
    body = WhiskerAtObject(jnp.asarray(length), jnp.asarray(1.0), profile, Shooting())
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
def test_order_of_the_splittings(stages, order):
    x, y, theta, _ = closed_form(4.0, 0.3, 1.0)
    solver, errors = rod.Splitting(stages), []
    assert solver.order(diffrax.ODETerm(lambda t, y, args: y)) == order
    for steps in ORDER_STEPS[order]:
        start = (jnp.zeros(()), jnp.zeros(()), jnp.cos(0.3), jnp.sin(0.3))
        load = rod.Load(jnp.zeros(()), jnp.asarray(-4.0), jnp.zeros(()))
        end = rod.integrate(start, 1.0, load, 1.0, steps=steps, solver=solver)
        errors.append(np.max(np.abs(np.array(end) - [x, y, np.cos(theta), np.sin(theta)])))
    assert order - 0.5 < np.log2(errors[0] / errors[1]) < order + 1.5


def test_another_number_of_stages_is_an_error():
    with pytest.raises(ValueError, match="`stages` must be 6, 10 or 11, got 7"):
        rod.Splitting(stages=7)


def test_a_stock_solver_computes_the_same_rod():
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


def test_a_section_without_change_is_a_uniform_rod():
    start = (jnp.zeros(()), jnp.zeros(()), jnp.ones(()), jnp.zeros(()))
    load = rod.Load(jnp.zeros(()), jnp.asarray(-3.0), jnp.zeros(()))
    section = rod.Section(Linear(2.0, 0.0), Linear(0.0, 0.0), 1.0, 2.0)
    sectioned = rod.integrate(start, 0.9, load, section, steps=2 * STEPS, from_base=jnp.asarray(0.9))
    uniform = rod.integrate(start, 0.9, load, steps=STEPS)
    np.testing.assert_allclose(np.array(sectioned), np.array(uniform), atol=CLOSED_FORM)


def test_an_unloaded_rod_keeps_its_intrinsic_curvature():
    # An Euler spiral, from the base outwards: the angle is the integral of the curvature.
    start = (jnp.zeros(()), jnp.zeros(()), jnp.ones(()), jnp.zeros(()))
    nothing = rod.Load(None, jnp.zeros(()), None)
    section = rod.Section(1.0, Linear(0.3, 0.5), 2.0, 1.0)  # arc lengths in units of 2
    _, _, cos, sin = rod.integrate(start, -1.0, nothing, section, steps=2 * STEPS, from_base=jnp.asarray(0.0))
    assert abs(jnp.arctan2(sin, cos) - (0.3 * 2 + 0.5 * 2**2 / 2)) < CLOSED_FORM


def test_the_moment_is_affine_in_position():
    load = rod.Load(jnp.asarray(2.0), jnp.asarray(3.0), jnp.asarray(5.0))
    assert rod.moment(jnp.asarray(7.0), jnp.asarray(11.0), load) == 5.0 - 7.0 * 3.0 + 11.0 * 2.0
    assert rod.moment(jnp.asarray(7.0), jnp.asarray(11.0), rod.Load(None, jnp.asarray(3.0), None)) == -21.0


def test_a_point_without_stiffness_carries_no_moment():
    section = rod.Section(Linear(1.0, -1.0), Linear(0.2, 0.0), 1.0, 1.0)
    assert section.total_curvature(jnp.asarray(3.0), jnp.asarray(1.0)) == 0.2
    assert section.total_curvature(jnp.asarray(3.0), jnp.asarray(0.5)) == 6.2
