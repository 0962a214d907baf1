"""Drives against the formulas of their docstrings, and sampled drives against the functions that were sampled."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.drive import drive_of

EXACT = 1e-13  # of formulas
T = 0.5, 2.0  # during a sweep and after it


@eqx.filter_jit
def control(drive, times):
    """Control and speed."""
    return jax.vmap(lambda t: jax.jvp(drive, (t,), (jnp.ones(()),)))(times)


def test_whisking_is_a_sine_with_its_phase_and_offset():
    t = np.array([0.0, 0.2, 1.7])
    value, speed = control(jw.Whisking(amplitude=0.3, frequency=0.8, offset=-0.1, phase=0.5), jnp.asarray(t))
    angle = 2 * np.pi * 0.8 * t + 0.5
    np.testing.assert_allclose(value, -0.1 + 0.3 * np.sin(angle), atol=EXACT)
    np.testing.assert_allclose(speed, 0.3 * 2 * np.pi * 0.8 * np.cos(angle), atol=EXACT)


@pytest.mark.parametrize("way", [1, -1])
def test_a_sweep_stops_where_it_shall(way):
    value, speed = control(jw.Sweep(0.1, 0.1 + way * 0.4, 0.5), jnp.array([0.0, 0.2, 0.79, 0.81, 5.0]))
    np.testing.assert_allclose(value, 0.1 + way * np.array([0.0, 0.1, 0.395, 0.4, 0.4]), atol=EXACT)
    np.testing.assert_allclose(speed, way * np.array([0.5, 0.5, 0.5, 0.0, 0.0]), atol=EXACT)
    slopes = jax.jit(jax.jacrev(lambda at: jnp.stack([jw.Sweep(0.1, 0.1 + at[0], at[1])(t) for t in T])))
    np.testing.assert_allclose(slopes(jnp.array([way * 0.4, 0.5])), [(0.0, way * 0.5), (1.0, 0.0)], atol=EXACT)


def test_a_sweep_without_way_rests():
    value, speed = control(jw.Sweep(0.2, 0.2, 0.5), jnp.array([0.0, 1.0]))
    assert value.tolist() == [0.2, 0.2] and speed.tolist() == [0.0, 0.0]


def test_samples_of_a_line_are_a_line_up_to_its_ends():
    t = np.array([0.0, 0.1, 1.23, 2.0])
    value, speed = control(drive_of(np.linspace(0.7, -0.5, 5), 2.0), jnp.asarray(t))
    np.testing.assert_allclose(value, 0.7 - 0.6 * t, atol=EXACT)
    np.testing.assert_allclose(speed, -0.6, atol=EXACT)


def test_samples_of_a_parabola_are_that_parabola_between_inner_samples():
    at, duration = np.linspace(0.0, 3.0, 7), 3.0
    t = np.array([0.5, 0.6, 1.25, 2.0, 2.4])  # the first and the last interval lack a neighbour
    value, speed = control(drive_of(1 - at + at**2, duration), jnp.append(t, jnp.array([0.0, 3.0])))
    np.testing.assert_allclose(value, np.append(1 - t + t**2, [1.0, 7.0]), atol=EXACT)
    np.testing.assert_allclose(speed[:-2], -1 + 2 * t, atol=EXACT)
    # By the samples, the control is linear: its weights sum to 1.
    weights = np.asarray(jax.jit(jax.grad(lambda values: drive_of(values, duration)(0.6)))(jnp.asarray(at)))
    np.testing.assert_allclose([weights.sum(), weights @ at], [1.0, 0.6], atol=EXACT)


def test_a_number_is_a_drive_that_rests():
    value, speed = control(drive_of(0.3, 2.0), jnp.array([0.0, 0.7, 2.0]))
    assert value.tolist() == [0.3, 0.3, 0.3] and speed.tolist() == [0.0, 0.0, 0.0]


def test_a_function_is_its_own_drive():
    whisking = jw.Whisking(0.1, 1.0)
    assert drive_of(whisking, 2.0) is whisking
    assert drive_of(lambda t: 3 * t, 2.0)(0.5) == 1.5


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Sweep(0.1, 0.5, 0.0), "`speed` must be a positive finite number, got 0.0"),
        (lambda: jw.Sweep(0.1, np.nan, 1.0), "`stop` must be a finite number, got nan"),
        (lambda: jw.Whisking(0.1, 0.0), "`frequency` must be a positive finite number, got 0.0"),
        (lambda: jw.Whisking(0.1, 1.0, phase=np.inf), "`phase` must be a finite number, got inf"),
        (lambda: drive_of(np.array([0.8]), 1.0), "`drive` must be a function of time, a number, or at least two"),
        (lambda: drive_of(np.nan, 1.0), "`drive` must be a finite number, got nan"),
        (lambda: drive_of(np.ones((2, 2)), 1.0), "`drive`"),
    ],
)
def test_wrong_numbers_are_errors(make, message):
    with pytest.raises(ValueError, match=message):
        make()
