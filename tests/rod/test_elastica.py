"""Both ways to compute rods: against each other and, in scans, against elliptic integrals to forty digits."""

from functools import partial
from operator import itemgetter

import closed_form
import diffrax
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._rod.elastica import ClosedForm, Shooting, rod_end

END = 1e-9  # documented error of integrated rods
SLOPE = 1e-8  # of derivatives of integrated rods
SCAN = 1e-12  # of a scan's states, relative to the largest: rounding, amplified by Newton's method
SCAN_RATES = 1e-11  # of their derivatives by parameters
SHOOTING = 1e-8  # of integrated rods with the default number of steps, relative to the peak of a scan
EVENTS = 1e-8  # of the positions of events


@pytest.mark.parametrize(("bend", "arc", "angle"), [(3.0, 0.8, 0.4), (6.5, 1.0, 0.0), (0.0, 0.7, 0.3)])
def test_both_methods_give_the_same_end(bend, arc, angle):
    at = jnp.array([bend, arc, angle])
    exact, integrated = ClosedForm().end(*at), Shooting().end(*at)
    np.testing.assert_allclose(integrated, exact, atol=END)
    assert abs(jnp.hypot(exact[2], exact[3]) - 1) < 1e-14


def test_derivatives_may_use_another_method():
    at = jnp.array([3.0, 0.8, 0.4])

    def end(method, for_rates):
        return lambda z: rod_end(*z, method, for_rates)

    coarse, fine = Shooting(steps=1), Shooting(steps=16)
    np.testing.assert_array_equal(end(coarse, fine)(at), end(coarse, coarse)(at))
    exact = jax.jacfwd(end(ClosedForm(), ClosedForm()))(at)
    np.testing.assert_allclose(jax.jacfwd(end(coarse, fine))(at), exact, atol=SLOPE)
    assert np.max(np.abs(jax.jacfwd(end(coarse, coarse))(at) - exact)) > 10 * SLOPE
    assert Shooting(steps=8).for_rates().steps == 12


@pytest.mark.parametrize(("solver", "steps"), [(diffrax.Dopri8(), 12), (diffrax.Tsit5(), 60)])
def test_stock_solvers_have_derivatives_in_both_modes(solver, steps):
    at = jnp.array([3.0, 0.8, 0.4])

    def end(method):
        return lambda z: rod_end(*z, method, method)

    exact = jax.jacfwd(end(ClosedForm()))(at)
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(end(Shooting(steps, solver)))(at), exact, atol=SLOPE)


STATE = ("fx", "fy", "mz", "base_x", "contact_force", "contact_slope", "contact_arc", "contact_x", "contact_y")
VALUES = jnp.array([80.0, 0.2, 0.25, 1.1, 1.2, 0.9])  # closed_form.PARAMETERS without the control
CONTROL = jnp.array([0.5, 0.1, -0.5, -0.8, -1.2, -1.45])  # tip, tangential on both sides of the vertex, tip


def scene(p, rod):
    stiffness, rest_length, distance, a, length, bending_stiffness = p
    support = jw.Support.fb(stiffness, rest_length)
    return jw.Scene(jw.Whisker(length, bending_stiffness), jw.Parabola(distance, a), support, rod)


def exact_state(tip, guess, values):
    """The fields of a state to forty digits."""
    return np.array(itemgetter(*STATE)(closed_form.state(tip, guess, *values)))


def test_scans_and_their_derivatives_are_exact():
    def states(p):
        result = jw.scan(scene(p, jw.ClosedForm()), CONTROL)
        values = jnp.stack([getattr(result, name)[:, 0] for name in STATE], axis=-1)
        return values, (values, result.phase, result.status)

    by_p, (ours, phase, status) = jax.jacfwd(states, has_aux=True)(VALUES)
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
        # Derivatives by the length vanish in tangential contact: errors are relative to the largest derivative.
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
    # The parameters are drawn for a whisker of unit length and stiffness.
    parameters = parameters.at[:, 0].multiply(unit / length**3).at[:, 1:3].multiply(length[:, None])
    parameters = parameters.at[:, 3].divide(length)

    def scan(p, rod):
        return jw.scan(scene(p, rod), p[4] * jnp.linspace(1.5, -3.0, 100))

    one, other = (jax.vmap(lambda p, rod=rod: scan(p, rod))(parameters) for rod in (jw.Shooting(), jw.ClosedForm()))
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
    ("make", "message"),
    [
        (lambda: jw.Shooting(steps=0), "`steps` must be a positive int, got 0"),
        (lambda: jw.Shooting(steps=True), "`steps` must be a positive int, got True"),
        (lambda: jw.Shooting(solver="Tsit5"), "`solver` must be a solver of diffrax, got 'Tsit5'"),  # pyright: ignore[reportArgumentType]
        (lambda: jw.ClosedForm(newton_tolerance=2.0), r"`newton_tolerance` must be a float in \(0, 1\), got 2.0"),
        (lambda: jw.ClosedForm(newton_steps=0), "`newton_steps` must be a positive int, got 0"),
        (lambda: scene(VALUES, "exact"), r"`rod` must be Shooting\(\) or ClosedForm\(\), got 'exact'"),
    ],
)
def test_wrong_methods(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_scene_prints_how_its_rods_are_computed():
    assert str(scene(VALUES, jw.ClosedForm())).endswith(", closed form")
    assert str(scene(VALUES, jw.Shooting(steps=12))).endswith(", shooting, 12 steps")
    assert str(scene(VALUES, jw.Shooting())).endswith("EI = 0.9")
