"""Studies, fits and derivatives with respect to parameters of springs and foundations on the shaft."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Stiffening
from scenes import all_ok

CONTROL = np.linspace(0.9, -1.2, 43)
SAME = 1e-9  # relative to the peak: the same scan in a batch
NOISE = 0.005
STEPS = np.array([0.6, 0.2, -0.3, -0.6, -0.9])
DIFFERENCE = 1e-5  # step of central differences, times numbers above 1
BY_DIFFERENCES = 1e-5  # their accuracy relative to the largest derivative by the same parameter
MODES = 1e-9  # forward against reverse


def build(at, distance=0.3):
    springs = jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=at), jw.Spring((0, 1), 40.0, 0.23)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support(springs))


def test_studies_over_the_place_of_a_spring():
    data = jw.study(build, control=CONTROL, at=[0.05, 0.2, 1.5], distance=[0.3], outputs="all")
    assert np.all(data.status.sel(at=1.5) == jw.Status.invalid) and np.all(np.isnan(data.mz.sel(at=1.5)))
    for at in (0.05, 0.2):
        point, result = data.sel(at=at, distance=0.3), jw.scan(build(at), CONTROL)
        assert all_ok(result)
        for name in ("fx", "fy", "mz", "spring_length", "contact_arc"):
            np.testing.assert_allclose(point[name], getattr(result, name), atol=20 * SAME, err_msg=name)
        energy = jw.stored_energy(result.scene, result.events.before, result.events.control)
        np.testing.assert_allclose(point.event_energy_before, energy, atol=20 * SAME)
        assert energy[0] > 0.01


def test_the_place_of_a_spring_is_identified():
    result, rng = jw.scan(build(0.15), CONTROL), np.random.default_rng(2)
    measured = {c: np.asarray(getattr(result, c)) + NOISE * rng.normal(size=(43, 1)) for c in ("fx", "fy", "mz")}
    fit = jw.identify(build, {"at": 0.06, "distance": 0.25}, measured | {"control": CONTROL}, sigma=NOISE)
    assert fit.status == jw.FitStatus.ok, fit.reason
    for name, exact in {"at": 0.15, "distance": 0.3}.items():
        assert abs(fit.estimates[name] - exact) < 4 * fit.standard_error[name] < 0.01


NUMBERS = {"linear": 50.0, "cubic": 900.0, "start": 0.03, "stop": 0.2, "density": 150.0, "rest": 0.19}


def signals(numbers):
    linear, cubic, *tissue = numbers
    spring = jw.Spring((0, 1), Stiffening(linear, cubic), 0.22, axis="axial", at=0.25)  # pyright: ignore
    support = jw.Support((spring,), foundation=jw.Foundation(*tissue))
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.35), support), STEPS)
    return jnp.stack([getattr(result, name)[:, 0] for name in ("fy", "mz", "base_x", "contact_arc", "spring_length")])


@pytest.mark.unchecked
def test_derivatives_by_the_numbers_of_laws_and_foundations():
    at = jnp.array(list(NUMBERS.values()))
    forwards = np.asarray(jax.jacfwd(signals)(at))
    assert np.all(np.isfinite(forwards))
    for k, name in enumerate(NUMBERS):
        step = DIFFERENCE * max(1.0, float(at[k]))
        difference = (signals(at.at[k].add(step)) - signals(at.at[k].add(-step))) / (2 * step)
        largest = np.max(np.abs(forwards[..., k]))
        assert largest > 1e-5, name
        np.testing.assert_allclose(forwards[..., k], difference, atol=BY_DIFFERENCES * largest, err_msg=name)
    np.testing.assert_allclose(jax.jacrev(signals)(at), forwards, atol=MODES * np.max(np.abs(forwards)))
