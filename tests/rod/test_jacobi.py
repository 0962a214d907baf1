"""Jacobi's functions against mpmath, and the rod's closed form built of them against everything else."""

from functools import partial

import closed_form
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._rod.jacobi import jacobi

mp.mp.dps = closed_form.DIGITS
ROUNDING = 1e-14
RATES = 1e-13  # of derivatives, which are sums of larger terms
SECOND_RATES = 1e-12
SCAN = 1e-12  # of a scan's states, relative to the largest: rounding through Newton's method
SCAN_RATES = 1e-11  # ... of their derivatives by parameters
SHOOTING = 1e-8  # of the other method, with its default steps, relative to the peak of a scan
EVENTS = 1e-8  # in the position of events


def exact(w, m):
    """sn(u)/u, cn(u), dn(u), eps(u)/u at w = u^2 of either sign."""
    w, m = mp.mpf(w), mp.mpf(m)
    u = mp.sqrt(w)
    sn, cn, dn = (mp.ellipfun(name, u, m=m) for name in ("sn", "cn", "dn"))
    epsilon = mp.quad(lambda t: mp.ellipfun("dn", t * u, m=m) ** 2, mp.linspace(0, 1, 5))
    return [mp.re(v) for v in (sn / u, cn, dn, epsilon)]


ARGUMENTS = [(1e-12, 0.5), (1e-3, 0.3), (0.7, 0.0), (1.9, 0.5), (6.8, 0.5), (6.8, 0.05), (16.0, 0.4), (100.0, 0.5)]


@pytest.mark.parametrize(("w", "m"), [*ARGUMENTS, (-1e-6, 0.5), (-0.5, 0.2)])
def test_values(w, m):
    np.testing.assert_allclose(jacobi(w, m), np.array(exact(w, m), float), atol=ROUNDING)


def test_nothing_happens_where_the_argument_vanishes():
    np.testing.assert_array_equal(jacobi(0.0, 0.3), np.ones(4))
    by_w = np.array(jax.jacfwd(jacobi)(jnp.asarray(0.0), 0.3))
    # sn(u)/u = 1 - (1 + m) w/6, cn = 1 - w/2, dn = 1 - m w/2, eps(u)/u = 1 - m w/3.
    np.testing.assert_allclose(by_w, [-1.3 / 6, -0.5, -0.15, -0.1], atol=ROUNDING)


@pytest.mark.parametrize(("w", "m"), [(0.01, 0.4), (1.9, 0.5), (6.8, 0.2)])
def test_derivatives(w, m):
    at = jnp.asarray(w), jnp.asarray(m)
    h = mp.mpf(10) ** -12
    first, second = (jax.jit(f)(*at) for f in (jax.jacrev(jacobi, (0, 1)), jax.hessian(jacobi, (0, 1))))

    def difference(k, at):
        step = [h * (i == k) for i in (0, 1)]
        ahead, behind = (exact(at[0] + s * step[0], at[1] + s * step[1]) for s in (1, -1))
        return [(x - y) / (2 * h) for x, y in zip(ahead, behind, strict=True)]

    at = mp.mpf(w), mp.mpf(m)
    for k in (0, 1):
        np.testing.assert_allclose([f[k] for f in first], np.array(difference(k, at), float), atol=RATES)
        ahead, behind = (difference(0, [v + s * h * (i == k) for i, v in enumerate(at)]) for s in (1, -1))
        curved = np.array([(x - y) / (2 * h) for x, y in zip(ahead, behind, strict=True)], float)
        np.testing.assert_allclose([f[0][k] for f in second], curved, atol=SECOND_RATES)


STATE = ("fx", "fy", "mz", "base_x", "contact_force", "contact_slope", "contact_arc", "contact_x", "contact_y")
VALUES = jnp.array([80.0, 0.2, 0.25, 1.1, 1.2, 0.9])  # closed_form.PARAMETERS but for the control
CONTROL = jnp.array([0.5, 0.1, -0.5, -0.8, -1.2, -1.45])  # tip, tangential on both sides of the vertex, tip


def scene(p, rod):
    stiffness, rest_length, distance, a, length, bending_stiffness = p
    support = jw.Support.fb(stiffness, rest_length)
    return jw.Scene(jw.Whisker(length, bending_stiffness), jw.Parabola(distance, a), support, rod)


def exact_state(tip, guess, values):
    """The fields of a state, with forty digits."""
    return np.array([closed_form.state(tip, guess, *values)[name] for name in STATE])


def test_scans_and_their_derivatives_are_exact():
    def states(p):
        result = jw.scan(scene(p, jw.ClosedForm()), CONTROL)
        found = jnp.stack([getattr(result, name)[:, 0] for name in STATE], axis=-1)
        return found, (found, result.phase, result.status)

    by_p, (ours, phase, status) = jax.jit(jax.jacfwd(states, has_aux=True))(VALUES)
    assert np.all(status == jw.Status.ok)
    assert len(np.unique(phase)) == 2
    h = mp.mpf(10) ** -12
    for step, u in enumerate(CONTROL):
        slope, force = (ours[step, STATE.index(name)] for name in ("contact_slope", "contact_force"))
        tip = bool(phase[step, 0] == jw.Phase.tip)
        guess = (mp.mpf(float(slope)),)
        if tip:
            guess = (*guess, closed_form.modulus(guess[0], float(force) * 1.2**2 / 0.9, 1))

        state = partial(exact_state, tip, guess)
        at = [mp.mpf(float(v)) for v in (u, *VALUES)]
        np.testing.assert_allclose(ours[step], state(at).astype(float), rtol=SCAN, atol=SCAN)
        rates = []
        for k in range(VALUES.size):
            ahead, behind = (state([v + sign * h * (i == k + 1) for i, v in enumerate(at)]) for sign in (1, -1))
            rates.append(((ahead - behind) / (2 * h)).astype(float))
        # By the length, which does not matter in tangential contact, they vanish: compared with what moves most.
        rates = np.stack(rates, axis=-1)
        largest = np.max(np.abs(rates), axis=1, keepdims=True)
        assert np.max(np.abs(by_p[step] - rates) / largest) < SCAN_RATES


SCENES = 256


def test_both_methods_agree_on_random_scenes():
    rng = np.random.default_rng(5)
    parameters = jnp.asarray(
        np.stack(
            [
                10 ** rng.uniform(0.5, 4, SCENES),
                rng.uniform(0, 0.3, SCENES),
                rng.uniform(0.1, 0.9, SCENES),
                10 ** rng.uniform(-1, 1, SCENES),
                10 ** rng.uniform(-1, 1, SCENES),
                10 ** rng.uniform(-3, 3, SCENES),
            ],
            axis=-1,
        )
    )
    length, unit = parameters[:, 4], parameters[:, 5]
    # Drawn for a whisker of unit length and stiffness.
    parameters = parameters.at[:, 0].multiply(unit / length**3).at[:, 1:3].multiply(length[:, None])
    parameters = parameters.at[:, 3].divide(length)

    def scan(p, rod):
        return jw.scan(scene(p, rod), p[4] * jnp.linspace(1.5, -3.0, 100))

    def all_scans(parameters):
        return [jax.vmap(lambda p, rod=rod: scan(p, rod))(parameters) for rod in (jw.Shooting(), jw.ClosedForm())]

    one, other = jax.jit(all_scans)(parameters)
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_array_equal(one.events.kind, other.events.kind)
    assert np.mean(one.status == jw.Status.ok) > 0.99
    known = np.isfinite(one.events.control)
    np.testing.assert_allclose(
        np.asarray(one.events.control / length[:, None])[known],
        np.asarray(other.events.control / length[:, None])[known],
        atol=EVENTS,
    )
    for name in ("fx", "fy", "mz"):
        a, b = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        peak = np.nanmax(np.abs(b), axis=(1, 2), keepdims=True)
        assert np.nanmax(np.abs(a - b) / peak) < SHOOTING


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: jw.Shooting(steps=0), "`steps` must be a positive int, but is 0"),
        (lambda: jw.Shooting(steps=True), "`steps` must be a positive int, but is True"),
        (lambda: jw.Shooting(solver="Tsit5"), "`solver` must be a solver of diffrax, but is 'Tsit5'"),  # pyright: ignore[reportArgumentType]
        (lambda: jw.ClosedForm(newton_tolerance=2.0), r"`newton_tolerance` must be a float in \(0, 1\), but is 2.0"),
        (lambda: jw.ClosedForm(newton_steps=0), "`newton_steps` must be a positive int, but is 0"),
        (lambda: scene(VALUES, "exact"), r"`rod` must be Shooting\(\) or ClosedForm\(\), but is 'exact'"),
    ],
)
def test_bad_methods(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_a_scene_says_how_its_rods_are_computed():
    assert str(scene(VALUES, jw.ClosedForm())).endswith(", closed form")
    assert str(scene(VALUES, jw.Shooting(steps=12))).endswith(", shooting, 12 steps")
    assert str(scene(VALUES, jw.Shooting())).endswith("EI = 0.9")
