"""The likelihood of a fit: its profile, its density and its variables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.fit import _crossing
from recordings import NOISE, TRUTH, exact, fb, noisy

SHARE = 0.02  # relative: intervals by least squares and by the likelihood profile, where the misfit is a parabola
NEWTON = 1e-2  # standard errors: largest Newton step at the estimate


@pytest.fixture(scope="module")
def fit():
    return jw.identify(fb, TRUTH, noisy(exact(fb(**TRUTH)), 1), sigma=NOISE)


def test_degrees_of_freedom_are_the_compared_values_less_those_fitted(fit):
    compared = np.isfinite(fit.residuals).sum()
    assert 0 < compared <= fit.residuals.size and fit.degrees == compared - len(fit.names)


def test_profile_gives_the_interval_where_the_misfit_is_a_parabola(fit):
    profile = fit.profile("q", points=9)
    np.testing.assert_allclose(profile.interval, fit.interval["q"], rtol=SHARE * fit.standard_error["q"] * 10)
    assert profile.misfit[4] == np.min(profile.misfit)
    assert np.all(np.diff(profile.misfit[:5]) < 0) and np.all(np.diff(profile.misfit[4:]) > 0)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "words"), [({"name": "k"}, "`name`.*'k'"), ({"name": "q", "points": 2}, "`points`.*2")]
)
def test_wrong_arguments_of_a_profile(fit, arguments, words):
    with pytest.raises(ValueError, match=words):
        fit.profile(**arguments)


def test_crossing_of_a_parabola_and_of_one_that_does_not_rise():
    values = np.linspace(-3.0, 3.0, 13)
    assert _crossing(values, values**2, 1) == pytest.approx(1.959964)
    assert _crossing(values, values**2, -1) == pytest.approx(-1.959964)
    assert _crossing(values, 0.1 * values**2, 1) == np.inf


def test_log_density_has_its_maximum_at_the_estimate(fit):
    gradient = jax.jit(jax.grad(fit.log_density))(jnp.asarray(fit.variables))
    errors = np.array([fit.standard_error[n] / fit.estimates[n] for n in fit.names])
    assert np.max(np.abs(np.asarray(gradient)) * errors) < NEWTON
    parameters = fit.parameters(fit.variables)
    assert {n: float(v) for n, v in parameters.items()} == pytest.approx(fit.estimates)
