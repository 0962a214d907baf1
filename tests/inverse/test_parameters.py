"""Parameters: transforms and their inverses, bounds, and checks of the user's function."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.linearised import check_used
from jaxwhisker._inverse.parameters import (
    Transforms,
    build_scene,
    check_traceable,
    read_parameters,
    transforms_of,
)
from recordings import TRUTH, fb

X = np.array([55.0, -0.3, 2.0, 0.7, 40.0])
TRANSFORMS = Transforms.of(
    [True, False, True, False, True],
    [1.0, 2.0, 1.0, 3.0, 1.0],
    [(-np.inf, np.inf), (-1.0, np.inf), (0.0, 3.0), (-np.inf, 0.8), (30.0, 90.0)],
)


def test_transforms_are_inverted():
    y = TRANSFORMS.variables(X)
    np.testing.assert_allclose(TRANSFORMS.natural(y, np), X, rtol=1e-14)
    np.testing.assert_allclose(TRANSFORMS.natural(jnp.asarray(y)), X, rtol=1e-14)
    assert TRANSFORMS.bounded.tolist() == [False, True, True, True, True]
    np.testing.assert_allclose(TRANSFORMS.bounds, [(0, np.inf), (-1, np.inf), (0, 3), (-np.inf, 0.8), (30, 90)])


def test_no_variable_leaves_the_bounds():
    for y in (-700.0, -30.0, 0.0, 30.0):
        x = TRANSFORMS.natural(np.full(5, y), np)
        assert np.all(
            (x[1:] >= np.array([-1.0, 0.0, -np.inf, 30.0]) - 1e-9)
            & (x[1:] <= np.array([np.inf, 3.0, 0.8, 90.0]) + 1e-9)
        )


def test_rates_are_derivatives():
    y = TRANSFORMS.variables(X)
    rates = np.diag(jax.jacfwd(TRANSFORMS.natural)(jnp.asarray(y)))
    np.testing.assert_allclose(TRANSFORMS.per_inner(X) * TRANSFORMS.stretch(y), rates, rtol=1e-12)


def test_intervals_are_symmetric_in_log_and_end_at_bounds():
    low, high = np.transpose(TRANSFORMS.interval(X, 0.1 * np.abs(X)))
    assert low[0] * high[0] == pytest.approx(X[0] ** 2) and high[0] / X[0] == pytest.approx(math.exp(0.1959964))
    assert low[1] + high[1] == pytest.approx(2 * X[1])
    assert high[3] == pytest.approx(0.8) and np.isnan(TRANSFORMS.interval(X, np.full(5, np.nan))[0][0])


def test_positive_parameters_are_fitted_in_log():
    def build(c, position):
        return jw.Scene(jw.Whisker(), jw.Parabola(0.3, position=position), jw.Support.fb(c))

    transforms = transforms_of(build, {"c": 60.0, "position": -0.5})
    assert transforms.log.tolist() == [True, False] and transforms.scale[1] == 1.0
    assert not transforms_of(build, {"c": 60.0, "position": 0.0}, kinds={"c": "linear"}).log.any()
    with pytest.raises(ValueError, match=r"`transform` must be linear .*position = -0.5"):
        transforms_of(build, {"c": 60.0, "position": -0.5}, kinds={"position": "log"})


def if_function(c, q):
    return fb(c, q) if c > 3 else fb(3.0, q)


@pytest.mark.parametrize(
    "build",
    [
        if_function,
        lambda c, q: fb(math.exp(c / 20), q),
        lambda c, q: fb(np.interp(c, [0.0, 100.0], [1.0, 90.0]), q),
        lambda c, q: fb(c, float(q)),
    ],
)
def test_functions_that_jax_cannot_trace_are_refused_with_the_remedy(build):
    build_scene("guess", build, TRUTH)  # runs with numbers
    with pytest.raises(ValueError, match=r"`build` must be a function that JAX can trace.*jnp\.where.*jnp\.interp"):
        check_traceable(build, TRUTH)


def test_traceable_functions_pass():
    check_traceable(fb, TRUTH)
    check_traceable(lambda c, q: fb(jnp.where(c > 3, c, 3.0), jnp.exp(q)), TRUTH)
    check_used(fb, TRUTH)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("build", "values", "words"),
    [
        (3.0, TRUTH, "`build` must be a function"),
        (lambda c, q: jw.Whisker(), TRUTH, "`build` must return a Scene"),
        (lambda c: fb(c, 0.3), TRUTH, r"`guess` must name the parameters of `build`, which takes \(c\).*'q'"),
        (lambda c, q, k: fb(c, q), TRUTH, r"`guess` must name the parameters of `build`, which takes \(c, q, k\).*'k'"),
    ],
)
def test_wrong_functions(build, values, words):
    with pytest.raises(ValueError, match=words):
        build_scene("guess", build, values)


@pytest.mark.parametrize(
    ("given", "words"), [(3.0, "got 3.0"), ({}, "got {}"), ({"c": np.inf}, "`c`"), ({"c": "a"}, "`c`")]
)
def test_wrong_values(given, words):
    with pytest.raises(ValueError, match=f"`at` must .*{words}"):
        read_parameters("at", given)
