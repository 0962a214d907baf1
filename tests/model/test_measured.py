"""Whiskers from tables and from digitised shapes: values between rows, jumps, shapes with errors, wrong arguments."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._explore.code import code_of
from jaxwhisker._rod.resolution import bending_error

EXACT = 1e-12
FITTED = 1e-7  # relative to the length, of shapes without errors: chords are shorter than arcs in the first guess only
ROWS = np.linspace(0.0, 0.02, 50)
DIAMETER = 2e-4 * (1 - 30 * ROWS + 0.02 * np.sin(ROWS * 700))


def test_a_table_is_linear_between_rows():
    whisker = jw.Whisker.from_table(ROWS, youngs_modulus=3e9, diameter=DIAMETER, density=1300.0)
    between = jnp.linspace(0.0, 0.02, 173)
    diameter = np.interp(between, ROWS, DIAMETER)
    stiffness, mass = (jax.vmap(at)(between) for at in (whisker.stiffness_at, whisker.mass_at))
    np.testing.assert_allclose(stiffness, 3e9 * np.pi / 64 * diameter**4, rtol=EXACT)
    np.testing.assert_allclose(mass, 1300 * np.pi / 4 * diameter**2, rtol=EXACT)
    np.testing.assert_array_equal(whisker.breaks, ROWS[1:-1])
    assert whisker.length == 0.02


def test_columns_may_be_numbers():
    uniform = jw.Whisker.from_table([0.0, 1.0, 2.0], youngs_modulus=64e4 / np.pi, diameter=0.1, density=400 / np.pi)
    assert uniform.uniform and uniform.breaks is None
    assert uniform.stiffness_at(0.3) == pytest.approx(1.0) and uniform.mass_per_length == pytest.approx(1.0)
    curved = jw.Whisker.from_table([0.0, 1.0, 2.0], bending_stiffness=2.0, intrinsic_curvature=[0.1, 0.2, 0.4])
    assert curved.curvature_at(1.5) == pytest.approx(0.3) and curved.stiffness_at(1.5) == 2.0


def test_rows_at_the_same_place_are_a_jump():
    whisker = jw.Whisker.from_table([0.0, 0.5, 0.5, 1.0], bending_stiffness=[1.0, 0.8, 0.2, 0.1])
    at = [float(whisker.stiffness_at(s)) for s in (0.25, 0.5 - 1e-14, 0.5 + 1e-14, 0.75)]
    np.testing.assert_allclose(at, [0.9, 0.8, 0.2, 0.15], rtol=EXACT)
    assert error_of(whisker) < 1e-8


def error_of(whisker):
    return bending_error(jnp.ones(()), whisker.section(whisker.length, whisker.base_stiffness), 16)


def test_tables_are_resolved():
    whisker = jw.Whisker.from_table(ROWS, youngs_modulus=3e9, diameter=DIAMETER)
    plain = jw.Whisker(0.02, whisker.bending_stiffness)
    assert error_of(whisker) < 1e-8
    assert error_of(plain) > 1e-6


def test_tables_are_differentiable():
    def stiffness(diameter, s):
        whisker = jw.Whisker.from_table(s, youngs_modulus=64 / jnp.pi, diameter=diameter)
        return whisker.stiffness_at(0.25)

    rows, diameter = jnp.array([0.0, 0.5, 1.0]), jnp.array([1.0, 0.6, 0.2])
    by_diameter, by_rows = jax.grad(stiffness, argnums=(0, 1))(diameter, rows)
    np.testing.assert_allclose(by_diameter, 4 * 0.8**3 * np.array([0.5, 0.5, 0.0]), atol=EXACT)
    # d = d0 + (d1 - d0) s / s1
    np.testing.assert_allclose(by_rows[1], 4 * 0.8**3 * 0.4 * 0.25 / 0.5**2, atol=EXACT)


def test_code_of_a_table_runs():
    scene = jw.Scene(jw.Whisker.from_table(ROWS[::10], youngs_modulus=3e9, diameter=DIAMETER[::10]), jw.Parabola(0.004))
    known: dict = {}
    exec(code_of(scene), known)
    again = known["scene"].whisker
    np.testing.assert_array_equal(again.breaks, ROWS[::10][1:-1])
    assert again.stiffness_at(0.011) == scene.whiskers[0].stiffness_at(0.011)


def points_of(curvature, count=60, *, turn=0.4, error=0.0):
    """Points of a shape of length 1 whose curvature is a polynomial, turned and moved, with errors."""
    fine = np.linspace(0.0, 1.0, 20 * (count - 1) + 1)
    angle = np.polynomial.Polynomial(curvature).integ()(fine) + turn
    middle = (angle[1:] + angle[:-1]) / 2
    x, y = (np.append(0.0, np.cumsum(part * np.diff(fine))) for part in (np.cos(middle), np.sin(middle)))
    noise = error * np.random.default_rng(2).normal(size=(2, count))
    return 3.0 + x[::20] + noise[0], -1.0 + y[::20] + noise[1]


def test_shapes_without_errors():
    straight = jw.Whisker.from_points(*points_of([0.0]), error=1e-6)
    assert straight.intrinsic_curvature is None and straight.length == pytest.approx(1.0, abs=FITTED)
    arc = jw.Whisker.from_points(*points_of([0.7]), error=1e-5)
    assert arc.intrinsic_curvature == pytest.approx(0.7, rel=1e-5) and arc.length == pytest.approx(1.0, abs=FITTED)
    spiral = jw.Whisker.from_points(*points_of([0.3, -0.8]), error=1e-5, bending_stiffness=2.0)
    assert spiral.intrinsic_curvature.coefficients.size == 2 and spiral.stiffness_at(0.1) == 2.0
    np.testing.assert_allclose([spiral.curvature_at(s) for s in (0.0, 1.0)], [0.3, -0.5], atol=1e-4)


@pytest.mark.parametrize("curvature", [[0.0], [0.7], [0.3, 0.8], [0.3, 0.8, -1.5]])
def test_shapes_with_errors(curvature):
    error = 1e-4
    x, y = points_of(curvature, error=error)
    whisker = jw.Whisker.from_points(x, y, error)
    assert whisker.length == pytest.approx(1.0, abs=5 * error)
    # The lowest degree that suffices, and angles within what the errors allow.
    given = whisker.intrinsic_curvature
    degree = -1 if given is None else 0 if not callable(given) else given.coefficients.size - 1
    assert degree == (len(curvature) - 1 if any(curvature) else -1)
    s = np.linspace(0.0, 1.0, 33)
    off = np.array([float(whisker.curvature_at(v)) for v in s]) - np.polynomial.Polynomial(curvature)(s)
    assert abs(np.mean(off)) < 20 * error


def test_shapes_within_their_errors_are_accepted():
    # One in a thousand is refused; a limit two standard deviations from the mean refused one in eleven.
    for seed in range(60):
        rng = np.random.default_rng(seed)
        s, curvature, error = np.linspace(0.0, 1.0, 20), rng.uniform(-1.2, 1.2), 10 ** rng.uniform(-4.0, -2.5)
        x, y = np.sin(curvature * s) / curvature, (1 - np.cos(curvature * s)) / curvature
        noise = error * rng.standard_normal((2, s.size))
        assert jw.Whisker.from_points(x + noise[0], y + noise[1], error).length == pytest.approx(1.0, abs=5 * error)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: jw.Whisker.from_table([0.1, 1.0], bending_stiffness=[1.0, 0.5]),
            "`s` must be two or more arc lengths",
        ),
        (lambda: jw.Whisker.from_table([0.0, 1.0, 1.0], bending_stiffness=1.0), "`s` must be two or more arc lengths"),
        (
            lambda: jw.Whisker.from_table([0.0, 1.0], bending_stiffness=[1.0, 0.5, 0.2]),
            r"`bending_stiffness` must be one number per row \(2\), got 3 numbers",
        ),
        (
            lambda: jw.Whisker.from_table([0.0, 0.5, 1.0], youngs_modulus=1.0, diameter=[1.0, 0.0, 0.2]),
            "`diameter` must be positive in all rows",
        ),
        (lambda: jw.Whisker.from_table([0.0, 1.0], diameter=[1.0, 0.5]), "`bending_stiffness` must be given, or both"),
        (
            lambda: jw.Whisker.from_table([0.0, 1.0], diameter=1.0, youngs_modulus=1.0, bending_stiffness=1.0),
            "`bending_stiffness` must be given, or both",
        ),
        (
            lambda: jw.Whisker.from_table([0.0, 1.0], bending_stiffness=[1.0, 0.5], density=1.0),
            "`density` must be given with a `diameter`",
        ),
        (
            lambda: jw.Whisker.from_table([0.0, 0.03], youngs_modulus=3e9, diameter=[0.1, 0.05]),
            "`diameter` must be at most 1/5 of the length 0.03, in the same unit",
        ),
        (
            lambda: jw.Whisker.from_table(
                [0.0, 0.01, 0.03],
                youngs_modulus=3e9,
                diameter=np.ma.masked_greater([2e-4, 9.0, 1e-4], 1.0),
            ),
            "`diameter` must be a non-empty one-dimensional array of finite numbers, got nan at index 1",
        ),
        (lambda: jw.Whisker.from_points([0.0, 1.0, 2.0], [0.0, 1.0], 0.1), "`y` must be an array of the length of `x`"),
        (
            lambda: jw.Whisker.from_points(np.ma.masked_equal([0.0, 1.0, 2.0], 1.0), [0.0, 1.0, 2.0], 0.1),
            "`x` must be .* got nan at index 1",
        ),
        (lambda: jw.Whisker.from_points([0.0, 1.0], [0.0, 1.0], 0.1), "`y` must be an array of the length of `x`"),
        (lambda: jw.Whisker.from_points([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], 0.0), "`error` must be a positive"),
        (
            lambda: jw.Whisker.from_points(*points_of([0.3, 0.8], error=0.01), 1e-4),
            "`error` must be at least the distances of the points from a smooth shape",
        ),
    ],
)
def test_errors_name_the_argument(make, message):
    with pytest.raises(ValueError, match=message):
        make()
