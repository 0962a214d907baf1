"""Tori: distances, curvatures, balls and planes before points, places, units, derivatives, errors."""

# pyright: reportArgumentType=false
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from jaxwhisker._model.torus import Ring, Torus

EXACT = 1e-13  # sums of a few numbers of size 1
SEARCHED = 1e-12  # a minimum that is searched for: the square of the error of its place
DIFFERENCES = 1e-7  # central differences: the square of the step, times third derivatives of order 100
STEP = 1e-5

RADIUS, TUBE, CENTRE, AXIS = 0.7, 0.2, np.array([0.1, 1.2, -0.3]), np.array([0.3, 1.0, -0.2])
TORUS = Torus(RADIUS, TUBE, tuple(CENTRE), tuple(AXIS))
UP = AXIS / np.linalg.norm(AXIS)
OUT = np.cross(UP, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(UP, [0.0, 0.0, 1.0]))
AROUND = np.cross(UP, OUT)
TURN, SHIFT = (0.3, 0.2, -0.4), (0.2, -0.1, 0.4)


def on_circle(turn):
    return CENTRE + RADIUS * (np.cos(turn) * OUT + np.sin(turn) * AROUND)


def on_torus(turn, angle, distance=TUBE):
    """The point above the circle at an angle from its plane."""
    out = (on_circle(turn) - CENTRE) / RADIUS
    return on_circle(turn) + distance * (np.cos(angle) * out + np.sin(angle) * UP)


def scattered(count, spread=1.5):
    return CENTRE + np.random.default_rng(0).uniform(-spread, spread, (count, 3))


@eqx.filter_jit
def everything(surface, x):
    return surface.off(x), surface.normal(x), surface.curvature(x)


def test_the_level_is_the_distance_from_the_surface():
    for x in scattered(20):
        turns = np.linspace(0.0, 2 * np.pi, 73)
        nearest = turns[np.argmin([np.linalg.norm(x - on_circle(turn)) for turn in turns])]
        found: Any = minimize_scalar(
            lambda turn, x=x: np.linalg.norm(x - on_circle(turn)),
            bounds=(nearest - 0.1, nearest + 0.1),
            method="bounded",
            options={"xatol": 1e-9},
        )
        off, normal, _ = everything(TORUS, jnp.asarray(x))
        np.testing.assert_allclose(off, found.fun - TUBE, atol=SEARCHED)
        np.testing.assert_allclose(x - (off + TUBE) * normal, on_circle(found.x), atol=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi / 2, 2.5, np.pi])
def test_principal_curvatures_change_their_sign_at_the_top(angle):
    turn = 0.4
    _, normal, curvature = everything(TORUS, jnp.asarray(on_torus(turn, angle)))
    around = np.cos(turn) * AROUND - np.sin(turn) * OUT
    meridian = np.cross(around, normal)
    np.testing.assert_allclose(meridian @ curvature @ meridian, 1 / TUBE, rtol=EXACT)
    wide = np.cos(angle) / (RADIUS + TUBE * np.cos(angle))
    np.testing.assert_allclose(around @ curvature @ around, wide, atol=10 * EXACT)
    np.testing.assert_allclose(curvature @ normal, 0.0, atol=10 * EXACT)


def test_balls_and_planes_before_points_are_free_of_the_ring():
    turns, angles = np.random.default_rng(1).uniform(0, 2 * np.pi, (2, 3000))
    surface = np.stack([on_torus(turn, angle) for turn, angle in zip(turns, angles, strict=True)])
    points = scattered(2000, 0.9)
    radii, ways = map(np.asarray, jax.vmap(TORUS.ball_before)(jnp.asarray(points)))
    nearest = np.min(np.linalg.norm(points[:, None] - surface, axis=2), axis=1)
    outside = radii > 0
    assert np.all(radii[outside] < nearest[outside] + EXACT)
    distances, normals = map(np.asarray, jax.vmap(TORUS.plane_before)(jnp.asarray(points)))
    for each in (ways, normals):
        np.testing.assert_allclose(np.linalg.norm(each, axis=1), 1.0, atol=EXACT)
    before = distances > 0
    ahead = np.einsum("pi,spi->sp", normals, surface[:, None] - points) + distances
    assert np.max(ahead[:, before]) < EXACT
    # In the hole, and above and below it within one tube radius, there is a ball, but no plane.
    away, rise = np.linalg.norm(np.cross(points - CENTRE, UP), axis=1), np.abs((points - CENTRE) @ UP)
    np.testing.assert_array_equal(before | ((away < RADIUS) & (rise < TUBE)) | ~outside, True)
    assert np.sum(outside & ~before) > 20


def test_points_without_a_nearest_one_have_finite_values():
    for x, off in ((CENTRE, RADIUS - TUBE), (CENTRE + 0.3 * UP, np.hypot(RADIUS, 0.3) - TUBE), (on_circle(0.7), -TUBE)):
        found = everything(TORUS, jnp.asarray(x))
        assert all(np.isfinite(value).all() for value in found)
        np.testing.assert_allclose(found[0], off, atol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(found[1]), 1.0, atol=1e-6)
    distance, normal = TORUS.plane_before(jnp.asarray(CENTRE))
    np.testing.assert_allclose(distance, -TUBE, atol=EXACT)
    np.testing.assert_allclose(normal, UP, atol=EXACT)


def test_a_placed_torus_in_another_unit_is_a_ring():
    about = np.array([0.1, 0.2, 0.3])
    turn, x = Rotation.from_rotvec(TURN).as_matrix(), CENTRE + np.array([0.5, 0.26, 0.1])
    placed = TORUS.rotated(TURN, about=tuple(about)).moved(SHIFT)
    after = jnp.asarray(about + turn @ (x - about) + np.array(SHIFT))
    scaled = placed.in_unit(2.5)
    assert isinstance(scaled, Ring) and scaled.valid() and not placed.is_convex and not scaled.is_convex
    off, normal, curvature = everything(TORUS, jnp.asarray(x))
    moved = off, turn @ normal, turn @ curvature @ turn.T
    in_unit = moved[0] / 2.5, moved[1], moved[2] * 2.5
    for surface, at, expected in ((placed, after, moved), (scaled, after / 2.5, in_unit)):
        for one, other in zip(everything(surface, at), expected, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)
        for one, other in zip(surface.ball_before(at), expected, strict=False):
            np.testing.assert_allclose(one, other, atol=1e-12)
    np.testing.assert_allclose(scaled.thickness(), TUBE / 2.5, rtol=EXACT)
    np.testing.assert_allclose(TORUS.rotated(TURN).interior_point(), CENTRE, atol=EXACT)
    assert not TORUS.in_unit(1.0).is_convex


@pytest.mark.parametrize("angle", [0.3, 2.9])
def test_derivatives_with_respect_to_points_and_parameters(angle):
    @jax.jit
    def scaled(numbers, x):
        surface = Torus(numbers[0], numbers[1], tuple(numbers[2:5]), tuple(numbers[5:])).in_unit(1.7)
        return surface.level(x / 1.7), surface.normal(x / 1.7), TUBE * surface.curvature(x / 1.7)

    numbers, x = jnp.asarray([RADIUS, TUBE, *CENTRE, *AXIS]), jnp.asarray(on_torus(0.7, angle, 0.21))
    check_grads(scaled, (numbers, x), 1, ("fwd", "rev"), eps=STEP, atol=DIFFERENCES, rtol=DIFFERENCES)
    surface = TORUS.in_unit(1.0)
    np.testing.assert_allclose(surface.gradient(x), jax.grad(surface.level)(x), atol=EXACT)
    np.testing.assert_allclose(surface.hessian(x), jax.hessian(surface.level)(x), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Torus(0.4, 0.4, (0.0, 1.0, 0.0)), r"`tube_radius` must be less than `radius` \(0.4\), got 0.4"),
        (lambda: Torus(0.4, 0.0, (0.0, 1.0, 0.0)), "`tube_radius` must be a positive finite number, got 0.0"),
        (lambda: Torus(-0.4, 0.1, (0.0, 1.0, 0.0)), "`radius` must be a positive finite number, got -0.4"),
        (lambda: Torus(0.4, 0.1, (0.0, np.nan, 0.0)), r"`centre\[1\]` must be a finite number, got nan"),
        (lambda: Torus(0.4, 0.1, (0.0, 1.0, 0.0), (0, 0, 0)), "`axis` must be a vector other than zero"),
    ],
)
def test_errors(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_traced_parameters_out_of_range_are_invalid():
    valid = jax.jit(lambda tube: Torus(0.4, tube, (0.0, 1.0, 0.0)).valid())
    assert valid(0.1) and not valid(0.5) and not valid(-0.1)
