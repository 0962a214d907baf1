"""Derivatives of scans, compared with closed forms, with finite differences, and between forward and reverse mode."""

from functools import cache
from operator import itemgetter

import closed_form
import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import jaxwhisker as jw

EXACT = 1e-9  # closed forms, relative to the largest derivative: the rod's error times the power in which it enters
MODES = 1e-10  # forward and reverse mode: the same sums in a different order
SYMMETRIC = 1e-9  # second derivatives in both orders, forward over reverse, with rods that are exact to EXACT
DIFFERENCES = 1e-6  # central differences lose half of the digits
SNAP_STATE = 1e-5  # ... and half of the digits of the place of a fold along the path
DIFFERENCE = 1e-5  # step of central differences, relative to parameters of order one
NEAR_A_FOLD = 1e-6  # the same where third derivatives are large: a step of the control is 1e-3 from a snap-off

STATE = ("base_x", "fx", "fy", "mz", "contact_force", "contact_slope", "contact_arc", "contact_x", "contact_y")
AT = {"stiffness": 80.0, "rest_length": 0.2, "distance": 0.25, "a": 1.1, "length": 1.2, "bending_stiffness": 0.9}
P = jnp.array(list(AT.values()))
SPRINGS = {"FB": 1, "FBFBR": 3, "FBFBFBR": 5}  # FBFB: with the rigid spring
# The phases are: free, tip, tangential before and after the vertex, tip, close to the snap-off, free.
CONTROL = jnp.array([0.95, 0.5, 0.1, -0.5, -0.8, -1.2, -1.45, -1.52, -1.7, -1.95])


def observed(name, p, control):
    """All outputs of a scan: signals of every step, and position and states before and after every event."""
    stiffness, rest_length, distance, a, length, bending_stiffness = p
    springs = [stiffness * (1 + 0.2 * k) for k in range(SPRINGS[name])]
    support = jw.Support.named(name, springs[0] if len(springs) == 1 else springs, rest_length)
    result = jw.scan(jw.Scene(jw.Whisker(length, bending_stiffness), jw.Parabola(distance, a), support), control)
    steps = jnp.stack([getattr(result, field) for field in STATE], axis=-1)
    e = result.events
    states = [jnp.stack([getattr(s, field) for field in STATE], axis=-1) for s in (e.before, e.after)]
    return steps, result.spring_length, e.control, *states


@cache
def derived(name):
    """Function: values, forward Jacobians by parameters and by control, and a weighted reverse pass; some weights."""

    def all_of(p, control, weights):
        value, along = jax.linearize(lambda p, control: observed(name, p, control), p, control)
        columns = jax.vmap(along, out_axes=-1)
        by_p = columns(jnp.eye(p.size), jnp.zeros((p.size, control.size)))
        by_control = columns(jnp.zeros((control.size, p.size)), jnp.eye(control.size))
        forward = jax.tree.map(lambda *both: both, by_p, by_control)
        return value, forward, jax.linear_transpose(along, p, control)(weights)

    shapes = jax.eval_shape(lambda p, control: observed(name, p, control), P, CONTROL)
    rng = np.random.default_rng(1)
    weights = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), shapes)
    here = cache(lambda: all_of(P, CONTROL, weights))

    def at(p=None, control=CONTROL, by=weights):
        return here() if p is None and by is weights else all_of(P if p is None else p, jnp.asarray(control), by)

    return at, weights


@pytest.fixture(scope="module")
def fb():
    return derived("FB")[0]


def closed(phase, near):
    tip = phase == jw.Phase.tip
    slope, force = float(near[STATE.index("contact_slope")]), float(near[STATE.index("contact_force")])
    guess = (slope,)
    if tip:
        guess = (slope, closed_form.modulus(mp.mpf(slope), force * AT["length"] ** 2 / AT["bending_stiffness"], 1))
    return lambda values: itemgetter(*STATE)(closed_form.state(tip, guess, *values))


@pytest.mark.parametrize("step", [1, 2, 4, 6])
def test_derivatives_agree_with_closed_forms_in_both_phases(fb, step):
    (steps, *_), ((by_p, by_control), *_), _ = fb()
    phase = jw.Phase.tip if step in (1, 6) else jw.Phase.tangential
    state = closed(phase, steps[step, 0])
    at = [mp.mpf(float(v)) for v in (CONTROL[step], *P)]
    np.testing.assert_allclose(steps[step, 0], np.array(state(at), float), rtol=EXACT)
    h = mp.mpf(10) ** -12
    exact = []
    for k in range(len(at)):
        ahead, behind = (state([v + sign * h * (i == k) for i, v in enumerate(at)]) for sign in (1, -1))
        exact.append([float((x - y) / (2 * h)) for x, y in zip(ahead, behind, strict=True)])
    ours = np.concatenate([np.asarray(by_control)[step, 0, :, step, None], np.asarray(by_p)[step, 0]], axis=1)
    for field, row in enumerate(np.array(exact).T):
        np.testing.assert_allclose(ours[field], row, atol=EXACT * np.max(np.abs(row)), rtol=EXACT, err_msg=STATE[field])
    # The signals of a step depend on its own drive position only.
    assert np.all(np.delete(np.asarray(by_control)[step], step, axis=-1) == 0)


def test_derivatives_of_the_snap_off_agree_with_the_closed_form(fb):
    at = (80.0, 0.2, 0.25, 1.1)
    (_, _, positions, before, _), (_, _, (by_p, _), *_), _ = fb(jnp.array([*at, 1.0, 1.0]))
    last = int(np.sum(np.isfinite(positions))) - 1
    force, slope = (float(before[last, 0, STATE.index(name)]) for name in ("contact_force", "contact_slope"))
    guess = (slope, closed_form.modulus(mp.mpf(slope), force, 1))
    at = [mp.mpf(v) for v in at]
    assert abs(float(closed_form.snap_off(guess, *at)) - positions[last]) < EXACT
    h = mp.mpf(10) ** -8
    for k, ours in enumerate(by_p[last, : len(at)]):
        ahead, behind = (
            closed_form.snap_off(guess, *[v + sign * h * (i == k) for i, v in enumerate(at)]) for sign in (1, -1)
        )
        # u is stationary along the path there, the state is not.
        assert abs(ours - float((ahead - behind) / (2 * h))) < 10 * EXACT


def test_derivatives_agree_with_finite_differences(fb):
    jacobian = [by_p for by_p, _ in fb()[1]]
    tolerances = (DIFFERENCES, DIFFERENCES, DIFFERENCES, SNAP_STATE, DIFFERENCES)
    for k in range(P.size):
        step = DIFFERENCE * jnp.eye(P.size)[k] * jnp.maximum(P, 1.0)
        ahead, behind = fb(P + step)[0], fb(P - step)[0]
        largest = []
        for a, b, j, tolerance in zip(ahead, behind, jacobian, tolerances, strict=True):
            difference = np.asarray(a - b) / float(2 * step[k])
            ours = np.where(np.isfinite(difference), np.asarray(j)[..., k], 0.0)
            difference = np.where(np.isfinite(difference), difference, 0.0)
            largest.append(np.max(np.abs(difference)))
            np.testing.assert_allclose(ours, difference, atol=tolerance * max(1.0, largest[-1]), err_msg=list(AT)[k])
        assert max(largest) > 1e-3  # not a comparison of zeros


def test_reverse_mode_agrees_with_forward_mode(fb):
    _, weights = derived("FB")
    _, forward, reverse = fb()
    for along in (0, 1):
        pairs = zip(weights, [columns[along] for columns in forward], strict=True)
        expected = np.sum([np.tensordot(w, np.asarray(j), axes=w.ndim) for w, j in pairs], axis=0)
        assert np.all(expected[: P.size] != 0)
        np.testing.assert_allclose(reverse[along], expected, rtol=MODES, atol=MODES * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", ["FBFBFBR"])
def test_derivatives_of_networks_agree_with_differences_in_both_modes(name):
    # Signals and positions of all events, along two directions in parameter space.
    def signals(p):
        steps, spring_length, positions, _, _ = observed(name, p, CONTROL)
        return steps[:-3], spring_length, positions

    def all_of(p, direction, weights):
        value, along = jax.linearize(signals, p)
        return value, along(direction), jax.linear_transpose(along, p)(weights)[0]

    rng = np.random.default_rng(2)
    weights = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), jax.eval_shape(signals, P))
    for direction in rng.normal(size=(2, P.size)):
        _, forward, reverse = all_of(P, direction, weights)
        ahead, behind = (all_of(P + sign * NEAR_A_FOLD * direction, direction, weights)[0] for sign in (1, -1))
        for a, b, ours in zip(ahead, behind, forward, strict=True):
            difference = np.asarray(a - b) / (2 * NEAR_A_FOLD)
            known = np.isfinite(difference)
            scale = np.max(np.abs(difference[known]))
            assert scale > 0.01
            np.testing.assert_allclose(ours[known], difference[known], atol=DIFFERENCES * scale)
        expected = sum(np.sum(np.asarray(w * v)) for w, v in zip(weights, forward, strict=True))
        np.testing.assert_allclose(np.sum(reverse * direction), expected, rtol=MODES)


def test_near_a_fold_derivatives_of_signals_grow_and_that_of_the_event_does_not(fb):
    # d(fx)/d(stiffness) grows as the inverse square root of the distance to the fold. The fold itself moves smoothly.
    positions = fb()[0][2]
    last = int(np.sum(np.isfinite(positions))) - 1
    near = positions[last] + np.array([1e-6, 1e-8])
    _, ((by_p, _), _, (event_by_p, _), *_), _ = fb(P, np.concatenate([CONTROL[:7], near, CONTROL[-1:]]))
    by_stiffness = by_p[7:9, 0, STATE.index("fx"), 0]
    assert abs(by_stiffness[1]) > 1.0
    assert abs(by_stiffness[1] / by_stiffness[0] - 10.0) < 0.1  # sqrt(1e-6 / 1e-8), up to the next order
    assert abs(event_by_p[last, 0]) < 0.01


def test_derivatives_at_an_event_are_those_of_the_phase_that_begins(fb):
    # The control keeps its ends. The path and its events are therefore the same.
    corners = np.asarray(fb()[0][2])[:4]
    control = np.sort(np.concatenate([corners, corners - 1e-7, CONTROL[:1], CONTROL[-1:]]))[::-1]
    _, ((by_p, _), *_), _ = fb(P, control)
    at, behind = by_p[1:-1:2, 0], by_p[2:-1:2, 0]
    assert np.all(np.isfinite(by_p))
    np.testing.assert_allclose(at, behind, atol=1e-5 * np.max(np.abs(by_p)))
    assert abs(at[0, STATE.index("fx"), 0]) < 1e-12  # the force at first touch is zero for every stiffness
    assert at[0, STATE.index("fx"), 2] > 0.1  # a lower object is touched earlier


@pytest.mark.parametrize("distance", [1.1, 1.5])
def test_without_contact_only_the_base_position_has_derivatives(fb, distance):
    # The object at 1.1 is not touched yet, the one at 1.5 is out of reach.
    value, forward, (by_p, by_control) = fb(P.at[2].set(distance), np.full(CONTROL.size, 0.9))
    assert np.all(value[0][..., 1:] == 0) and np.all(np.isnan(value[2]))
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(forward))
    assert np.all(forward[0][0][..., 1:, :] == 0) and np.all(forward[2][0] == 0)
    np.testing.assert_allclose(np.delete(by_p, 1), 0, atol=1e-12)  # all but the rest length; rounding of the units
    assert np.all(by_control != 0)  # the base moves with the drive


def total(stiffness, distance, bending_stiffness):
    """Sum over the lanes without a failed step, which share a bending stiffness; number of ok steps of each lane."""

    def one(c, q):
        result = jw.scan(jw.Scene(jw.Whisker(1.0, bending_stiffness), jw.Parabola(q), jw.Support.fb(c)), CONTROL)
        return jnp.nanmean(result.mz) + jnp.nansum(result.events.control), jnp.sum(result.status == jw.Status.ok)

    values, ok = jax.vmap(one)(stiffness, distance)
    return jnp.sum(jnp.where(ok == CONTROL.size, values, 0.0)), ok


def test_failed_lanes_have_zero_derivatives_and_do_not_affect_other_lanes():
    gradient = jax.value_and_grad(total, argnums=(0, 1, 2), has_aux=True)
    stiffness, distance = jnp.array([70.0, 50.0, 90.0, 60.0]), jnp.array([0.2, 0.3, 0.25, 0.35])
    (_, ok), (by_c, by_q, shared) = gradient(stiffness, distance, 1.0)
    assert np.all(ok == CONTROL.size) and np.all(by_c != 0) and np.all(by_q != 0)
    # A NaN, and a value outside its domain. At a distance of 1e-9 the path may be lost, but gradients are finite.
    bad_c, bad_q = stiffness.at[1].set(jnp.nan), distance.at[2].set(-0.3).at[3].set(1e-9)
    (value, ok), (bad_by_c, bad_by_q, by_bending) = gradient(bad_c, bad_q, 1.0)
    assert np.isfinite(value) and np.isfinite(by_bending)
    assert ok[0] == CONTROL.size and ok[1] == ok[2] == 0
    assert np.all(np.isfinite(bad_by_c)) and np.all(np.isfinite(bad_by_q))
    assert np.all(bad_by_c[1:3] == 0) and np.all(bad_by_q[1:3] == 0)
    assert bad_by_c[0] == by_c[0] and bad_by_q[0] == by_q[0]
    # The derivative by a shared parameter is the sum over the good lanes.
    first = jnp.arange(4) == 0
    (_, ok), (_, _, alone) = gradient(stiffness, jnp.where(first, distance, -1.0), 1.0)
    (_, others), (_, _, rest) = gradient(jnp.where(first, jnp.nan, stiffness), distance, 1.0)
    assert np.array_equal(ok == CONTROL.size, first) and np.array_equal(others == CONTROL.size, ~first)
    assert alone != 0 and rest != 0
    np.testing.assert_allclose(alone + rest, shared, rtol=MODES)


def test_a_rigid_spring_has_a_derivative_by_its_compliance():
    def signals(compliances, distance):
        pair = ((0, 1), (1, 2))
        springs = [jw.Spring(e, compliance=s, rest_length=0.2) for e, s in zip(pair, compliances, strict=True)]
        result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support(tuple(springs))), CONTROL)
        return result.fx, result.events.control[:8]

    def both(*at):
        value = signals(*at)
        return value, value

    derived = jax.jacfwd(both, argnums=(0, 1), has_aux=True)

    def value(*at):
        return derived(*at)[1]

    rigid = jnp.array([1 / 80.0, 0.0])
    ahead, behind = value(rigid + jnp.array([0.0, 2e-6]), 0.25), value(rigid + jnp.array([0.0, 1e-6]), 0.25)
    at = value(rigid, 0.25)
    for field, (by_compliance, by_distance) in enumerate(derived(rigid, 0.25)[0]):
        # A compliance cannot be negative; hence one-sided differences of second order.
        difference = (4 * behind[field] - ahead[field] - 3 * at[field]) / 2e-6
        assert np.max(np.abs(by_compliance[..., 1])) > 0.1
        np.testing.assert_allclose(by_compliance[..., 1], difference, rtol=1e-4, atol=1e-3)
        assert np.all(np.isfinite(by_distance))

    def by_stiffness(c):
        springs = (jw.Spring((0, 1), 80.0, 0.2), jw.Spring((1, 2), c, 0.2))
        return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.25), jw.Support(springs)), CONTROL).fx

    assert np.all(jax.jacfwd(by_stiffness)(jnp.inf) == 0)


class Bowl(eqx.Module):
    """y = height + depth x^2, which ends at a wall."""

    height: float | jax.Array
    depth: float | jax.Array
    wall: float | jax.Array

    def __call__(self, x):
        return jnp.where(jnp.abs(x) < self.wall, self.height + self.depth * x**2, jnp.nan)


def by_graph(p, wall, weights):
    def weighted(p):
        stiffness, rest_length, distance, a, length, bending_stiffness = p
        support = jw.Support.fb(stiffness, rest_length)
        scene = jw.Scene(jw.Whisker(length, bending_stiffness), jw.Graph(Bowl(distance, a, wall)), support)
        return jnp.sum(weights * jw.scan(scene, CONTROL).fy)

    return jax.value_and_grad(weighted)(p)


@jax.jit
def curved(p, direction, weights):
    """Gradient of a weighted sum of signals and positions of events, and the Hessian times a direction."""

    def weighted(p):
        steps, _, at, *_ = observed("FB", p, CONTROL)
        return sum(jnp.sum(w * jnp.where(w == 0, 0.0, x)) for w, x in zip(weights, (steps, at), strict=True))

    return jax.jvp(jax.grad(weighted), (p,), (direction,))


def test_second_derivatives_are_symmetric_and_agree_with_differences(fb):
    _, every = derived("FB")
    count = int(np.sum(np.isfinite(fb()[0][2])))
    weights = every[0], jnp.where(jnp.arange(every[2].size) < count, every[2], 0.0)
    axes = jnp.eye(P.size)
    gradient = curved(P, axes[0], weights)[0]
    hessian = np.stack([curved(P, axis, weights)[1] for axis in axes], axis=1)
    # Inside this jit, the whole scan is one program; outside, it consists of shared ones.
    zeros = [jnp.zeros_like(w) for w in every]
    outside = fb(by=(weights[0], zeros[1], weights[1], *zeros[3:]))[2][0]
    np.testing.assert_allclose(gradient, outside, atol=MODES * np.max(np.abs(outside)))
    slopes = [[curved(P + sign * DIFFERENCE * axes[k], axes[k], weights)[0] for sign in (1, -1)] for k in range(P.size)]
    expected = np.array([(up - down) / (2 * DIFFERENCE) for up, down in slopes])
    np.testing.assert_allclose(hessian, expected, atol=DIFFERENCES * np.max(np.abs(expected)))
    np.testing.assert_allclose(hessian, hessian.T, atol=SYMMETRIC * np.max(np.abs(expected)))


@pytest.mark.parametrize("wall", [10.0, 0.95])
def test_a_user_defined_profile_has_the_derivatives_of_the_parabola(fb, wall):
    # The nearer wall is just outside the point of first touch.
    _, weights = derived("FB")
    inner = jnp.zeros_like(weights[0]).at[2:7, :, STATE.index("fy")].set(1.0)
    value, _, (expected, _) = fb(by=(inner, *jax.tree.map(jnp.zeros_like, weights[1:])))
    mean, ours = by_graph(P, wall, inner[..., STATE.index("fy")])
    np.testing.assert_allclose(mean, np.sum(value[0][2:7, :, STATE.index("fy")]), rtol=1e-8)
    np.testing.assert_allclose(ours, expected, atol=1e-8 * np.max(np.abs(expected)))
