"""Shapes of whiskers at steps of a scan: they begin at the base, pass the contact, and have the right length."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import model

EXACT = 1e-8  # of points: the integration outwards and the scan's own integration
ROUNDING = 1e-15  # of points: programs for two lines and for all lines may round differently
CONTROL = np.linspace(0.8, -1.6, 64)  # also that of test_cost.py, for the same programs


@cache
def scanned():
    return jw.scan(model("FB"), CONTROL)


def test_shapes_run_from_the_base_through_the_contact_to_the_tip():
    result = scanned()
    lines = jw.shapes(result, points=200)
    assert lines.x.shape == (CONTROL.size, 1, 200)
    np.testing.assert_allclose(lines.x[..., 0], result.base_x, atol=EXACT)
    np.testing.assert_allclose(lines.y[..., 0], 0.0, atol=EXACT)
    touching = np.asarray(result.phase) != jw.Phase.free
    np.testing.assert_allclose(lines.x[..., -2][touching], result.contact_x[touching], atol=EXACT)
    np.testing.assert_allclose(lines.y[..., -2][touching], result.contact_y[touching], atol=EXACT)
    length = jnp.sum(jnp.hypot(jnp.diff(lines.x), jnp.diff(lines.y)), axis=-1)
    np.testing.assert_allclose(length, 1.0, atol=1e-4)  # chords are shorter than arcs


def test_free_whiskers_are_upright():
    result = scanned()
    lines = jw.shapes(result, points=3)
    free = np.asarray(result.phase)[:, 0] == jw.Phase.free
    assert free.any()
    np.testing.assert_allclose(lines.x[free, 0] - result.base_x[free], 0.0, atol=EXACT)
    np.testing.assert_allclose(lines.y[free, 0, -1], 1.0, atol=EXACT)


def test_positions_select_the_nearest_step():
    result, whole = scanned(), jw.shapes(scanned(), points=8)
    some = jw.shapes(result, [CONTROL[5] + 0.001, CONTROL[40] - 0.001], points=8)
    np.testing.assert_allclose(some.x, whole.x[np.array([5, 40])], atol=ROUNDING)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: jw.shapes(3), "`result` must be the Result of a scan, got 3"),  # pyright: ignore[reportArgumentType, reportCallIssue]
        (lambda r: jw.shapes(r, points=2), "`points` must be an int of at least 3, got 2"),
        (lambda r: jw.shapes(r, 0.5), r"`at` must be a non-empty one-dimensional array .*, got an array of shape \(\)"),  # pyright: ignore[reportArgumentType, reportCallIssue]
        (
            lambda r: jw.shapes(r, [0.0, 0.9]),
            "`at` must be within the drive positions of the scan, from -1.6 to 0.8, got",
        ),
        (lambda r: jw.shapes(r, [np.nan]), "`at` must be .* finite numbers, got nan at index 0"),
    ],
)
def test_wrong_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make(scanned())
