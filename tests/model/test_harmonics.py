"""Surfaces of spherical harmonics: the harmonics themselves, fits to points and meshes, scans, errors."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import jaxwhisker as jw
from jaxwhisker._model.harmonics import _directions, _harmonics

ROUNDING = 1e-11
SCAN = 1e-8  # of forces; the fit is exact to 1e-11, and its curvature to 1e-9
CENTRE = np.array([0.1, 1.2, -0.1])
CONTROL = np.linspace(-1.0, 1.2, 23)


def points_on(axes, count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return CENTRE + np.asarray(axes) * directions / np.linalg.norm(directions, axis=1)[:, None]


def mesh_of(axes, count):
    """A closed mesh, with faces counter-clockwise from outside."""
    directions = _directions(count)
    faces = ConvexHull(directions).simplices
    corners = directions[faces]
    inwards = np.linalg.det(corners) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return CENTRE + directions * axes, faces


def test_harmonics_are_orthonormal_and_complete():
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angles = 2 * np.pi * np.arange(16) / 16
    z, angle = np.repeat(nodes, 16), np.tile(angles, 8)
    flat = np.sqrt(1 - z**2)
    values = _harmonics(6, np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1))
    mean = values.T @ (np.repeat(weights, 16)[:, None] / 32 * values)
    np.testing.assert_allclose(mean, np.eye(49), atol=ROUNDING)
    # Of degree 1: y, z and x.
    one = _harmonics(1, np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(one, [[1, 0, 0.8 * 3**0.5, 0.6 * 3**0.5], [1, 3**0.5, 0, 0]], atol=ROUNDING)


def test_derivatives_of_the_level_are_those_of_its_values():
    coefficients = np.append(0.6, np.random.default_rng(1).normal(size=24) * 0.01)
    form = jw.SphericalHarmonics(coefficients, CENTRE).form()
    x = jnp.asarray(CENTRE) + jnp.array([0.3, -0.5, 0.4])
    out = (x - CENTRE) / jnp.sqrt(jnp.sum((x - CENTRE) ** 2))
    expected = jnp.sqrt(jnp.sum((x - CENTRE) ** 2)) - _harmonics(4, np.asarray(out)[None])[0] @ coefficients
    np.testing.assert_allclose(form.level(x), expected, atol=ROUNDING)
    np.testing.assert_allclose(form.gradient(x), jax.grad(form.level)(x), atol=ROUNDING)
    np.testing.assert_allclose(form.hessian(x), jax.jacfwd(jax.grad(form.level))(x), atol=ROUNDING)


@pytest.mark.parametrize(
    ("axes", "degree", "error"), [((0.5, 0.5, 0.5), 4, 1e-10), ((0.5, 0.4, 0.6), 8, 5e-5), ((0.5, 0.4, 0.6), 12, 2e-6)]
)
def test_an_ellipsoid_is_found_from_points(axes, degree, error):
    found = jw.SphericalHarmonics.from_points(points_on(axes, 1500), degree, inside=CENTRE)
    assert found.error < error and found.largest_error < 8 * error
    others = points_on(axes, 500, seed=1)
    off = jax.vmap(found.off)(jnp.asarray(others))
    assert np.max(np.abs(off)) < 8 * error


def test_the_error_is_that_of_the_points():
    noise = 1e-3
    points = points_on((0.5, 0.5, 0.5), 2000)
    out = (points - CENTRE) / 0.5
    points += noise * np.random.default_rng(3).normal(size=(2000, 1)) * out
    found = jw.SphericalHarmonics.from_points(points, 4, inside=CENTRE)
    assert found.error == pytest.approx(noise * np.sqrt(1 - 25 / 2000), rel=0.05)
    radius = np.asarray(jax.vmap(found.form().distance)(jnp.asarray(_directions(100))))
    assert 0.5 < np.std(radius) / (noise * np.sqrt(25 / 2000)) < 2


@pytest.mark.parametrize("count", [60, 2000])
def test_a_mesh_is_the_surface_through_its_vertices(count):
    vertices, faces = mesh_of(np.array([0.5, 0.4, 0.6]), count)
    found = jw.SphericalHarmonics.from_mesh(vertices, faces, degree=6)
    np.testing.assert_allclose(np.asarray(found.inside), CENTRE, atol=1e-2 if count < 100 else 1e-4)
    off = jax.vmap(found.off)(jnp.asarray(vertices))
    assert np.max(np.abs(off)) < (3e-2 if count < 100 else 2e-3)  # faces of the coarse mesh are inside


def forces(surface, **parts):
    return jw.scan(jw.SpaceScene(jw.Whisker(), surface, motion=jw.LinearDrive((-1.0, 0.0, 0.0)), **parts), CONTROL)


def test_a_scan_of_a_fitted_ball_is_that_of_a_sphere():
    sphere = jw.Sphere(0.5, CENTRE)
    found = jw.SphericalHarmonics.from_points(points_on((0.5,) * 3, 500), 4, inside=CENTRE)
    fitted, exact = forces(found), forces(sphere)
    assert np.all(fitted.status == 0) and np.max(exact.contact_force) > 0.5
    np.testing.assert_allclose(fitted.force, exact.force, atol=SCAN)
    assert [event.kind for event in fitted.events] == [event.kind for event in exact.events]
    turned = forces(found.rotated((0.3, 0.2, -0.5)).moved((0.1, 0.0, 0.0)))
    moved = forces(sphere.moved((0.1, 0.0, 0.0)))
    np.testing.assert_allclose(turned.force, moved.force, atol=SCAN)


def test_derivatives_by_coefficients():
    def fitted(radius):
        return forces(jw.SphericalHarmonics(jnp.zeros(25).at[0].set(radius), CENTRE)).force

    for mode in (jax.jacfwd, jax.jacrev):
        slope = mode(fitted)(0.5)
        expected = jax.jacfwd(lambda radius: forces(jw.Sphere(radius, CENTRE)).force)(0.5)
        np.testing.assert_allclose(slope, expected, atol=10 * SCAN)
    assert np.all(np.isnan(jax.vmap(fitted)(jnp.array([0.5, -0.1]))[1]))


BALL = points_on((0.5,) * 3, 300)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.SphericalHarmonics([-0.5], CENTRE), r"`coefficients` must be positive at first"),
        (lambda: jw.SphericalHarmonics([0.5, 0.1], CENTRE), r"`coefficients` must be \(degree \+ 1\)\^2 numbers"),
        (lambda: jw.SphericalHarmonics([0.5, np.nan, 0.0, 0.0], CENTRE), r"`coefficients`"),
        (lambda: jw.SphericalHarmonics.from_points(BALL, 20), r"`degree` must be an int from 2 to 16, got 20"),
        (lambda: jw.SphericalHarmonics.from_points(BALL[:50], 8), r"`points` must be at least 81"),
        (lambda: jw.SphericalHarmonics.from_points(BALL[:, :2]), r"`points` must be finite numbers of shape \(n, 3\)"),
        (lambda: jw.SphericalHarmonics.from_points(BALL, 4, inside=BALL[0]), r"`inside` must be none of the points"),
        (lambda: jw.SphericalHarmonics.from_points(BALL * [3, 1, 1], 4), r"strictly convex .* least curvature is -"),
        (lambda: jw.SphericalHarmonics.from_mesh(BALL, [[0, 1, 400]]), r"`faces` must be integers from 0 to 299"),
        (
            lambda: jw.SphericalHarmonics.from_mesh(*mesh_of((1, 1, 1), 50)[:1], np.zeros((1, 3), int)),
            r"around a volume",
        ),
    ],
)
def test_wrong_surfaces(make, message):
    with pytest.raises(ValueError, match=message):
        make()
