"""The object of a scene in space as a polyhedron."""

# pyright: reportOptionalMemberAccess=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.surfaces import as_one_surface
from jaxwhisker.plot.body import NEAR, SUNK, body_of

ON_SURFACE = 1e-9  # a length: bisection, on surfaces of the size 1
FLAT = 3e-3  # relative: a polyhedron with 4800 faces is smaller than a sphere by 0.0023, if they are alike
LOW, HIGH = np.array([-0.8, 0.0, -0.1]), np.array([0.8, 1.0, 0.1])
FORWARD, BESIDE = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def near_whiskers(surface):
    return body_of(surface.in_unit(1.0), LOW, HIGH)


def volume(body):
    first, second, third = np.moveaxis(body.points[body.faces] - body.points.mean(axis=0), 1, 0)
    return np.abs(np.sum(first * np.cross(second, third), axis=1)).sum() / 6


@pytest.fixture(scope="module")
def sphere():
    return near_whiskers(jw.Sphere(1.0, (0.1, 1.3, -0.5)))


def test_a_sphere_is_whole(sphere):
    np.testing.assert_allclose(np.linalg.norm(sphere.points - [0.1, 1.3, -0.5], axis=1), 1.0, atol=ON_SURFACE)
    assert volume(sphere) == pytest.approx(4 / 3 * np.pi, rel=FLAT)
    assert not sphere.cut.any() and not sphere.sharp.any()
    assert np.sum(sphere.smooth * sphere.normals, axis=1).min() > 0.99


def test_a_sphere_hides_what_is_behind_it(sphere):
    points = np.array([(0.1, 1.3, -2.0), (0.1, 1.3, 1.0), (0.1, 2.31, -2.0), (0.1, 2.28, -2.0), (0.1, 1.3, -0.5)])
    np.testing.assert_array_equal(sphere.hides(points, FORWARD), [True, False, False, True, True])
    np.testing.assert_array_equal(sphere.hides(points, -FORWARD), [False, True, False, False, True])
    # A whisker that touches the near side stays visible.
    touching = np.array([[0.1, 1.3, 0.5 - SUNK / 2]])
    assert not sphere.hides(touching, FORWARD)[0] and sphere.hides(touching, -FORWARD)[0]


def test_the_outline_of_a_sphere_is_its_great_circle(sphere):
    ends = sphere.points[sphere.outline(FORWARD)]
    across = np.linalg.norm(ends[..., :2] - [0.1, 1.3], axis=-1)
    assert across.min() > 1 - FLAT and across.max() < 1 + ON_SURFACE
    assert np.linalg.norm(np.diff(ends[..., :2], axis=1), axis=2).sum() == pytest.approx(2 * np.pi, rel=FLAT)


def test_other_units_scale_a_body(sphere):
    scaled = sphere.scaled(20.0)
    np.testing.assert_allclose(scaled.points, 20.0 * sphere.points)
    points = np.array([(0.1, 2.31, -2.0), (0.1, 2.28, -2.0)])
    np.testing.assert_array_equal(scaled.hides(20.0 * points, FORWARD), [False, True])


def test_a_cylinder_is_cut_off_near_the_whiskers():
    body = near_whiskers(jw.Cylinder(0.5, (0.2, 1.0, 7.0)))
    np.testing.assert_allclose([body.points[:, 2].min(), body.points[:, 2].max()], [-0.1 - NEAR, 0.1 + NEAR])
    across = np.hypot(body.points[:, 0] - 0.2, body.points[:, 1] - 1.0)
    assert across.max() == pytest.approx(0.5, abs=ON_SURFACE)
    ends = body.normals[body.cut]
    np.testing.assert_allclose(np.abs(ends), np.broadcast_to(FORWARD, ends.shape), atol=ON_SURFACE)
    assert volume(body) == pytest.approx(np.pi * 0.25 * 2 * (0.1 + NEAR), rel=FLAT)
    # From the side, a rectangle; along the axis, only the end that faces the eye.
    assert set(np.sign(body.points[body.edges[body.sharp]][..., 2]).ravel()) == {-1.0, 1.0}
    assert (body.points[body.outline(FORWARD)][..., 2] > 0).mean() > 0.5


def around_core(edges, radius):
    """Volume of all points at most one radius from a box (Steiner)."""
    a, b, c = edges
    faces = 2 * (a * b + b * c + c * a)
    return a * b * c + faces * radius + np.pi * (a + b + c) * radius**2 + 4 / 3 * np.pi * radius**3


@pytest.mark.parametrize(
    ("surface", "edges", "radius"),
    [
        (jw.Capsule(0.2, (0.1, 1.0, -0.5), (0.1, 1.0, 0.5)), (0.0, 0.0, 1.0), 0.2),
        (jw.RoundedBox((0.8, 0.5, 0.6), 0.1, (0.0, 1.0, 0.1)), (0.6, 0.3, 0.4), 0.1),
    ],
)
def test_capsules_and_boxes_are_whole(surface, edges, radius):
    body = near_whiskers(surface)
    assert volume(body) == pytest.approx(around_core(edges, radius), rel=4 * FLAT)
    assert not body.cut.any()


def test_a_plane_bounds_what_is_behind_it():
    wall = jw.Plane((-0.5, 0.0, 0.0), (1.0, -0.5, 0.0))
    body = near_whiskers(wall)
    off = (body.points - [-0.5, 0.0, 0.0]) @ [1.0, -0.5, 0.0] / np.hypot(1.0, 0.5)
    assert off.max() < ON_SURFACE and np.sum(off > -ON_SURFACE) > 50
    assert body.points[:, 0].min() == pytest.approx(LOW[0] - NEAR) and body.cut.any() and not body.cut.all()


def test_an_open_profile_is_a_block_with_sharp_corners():
    body = near_whiskers(jw.Extruded(jw.Parabola(0.2)))
    top = 1.0 + NEAR
    half = np.sqrt(top - 0.2)
    corners = np.array([(sign * half, top, z) for sign in (-1, 1) for z in (-0.1 - NEAR, 0.1 + NEAR)])
    for corner in corners:
        assert np.linalg.norm(body.points - corner, axis=1).min() < ON_SURFACE
    x, y, _ = body.points.T
    assert np.all(y >= 0.2 + x**2 - ON_SURFACE)


def test_a_large_object_is_cut_off_on_all_sides():
    body = near_whiskers(jw.Sphere(500.0, (0.0, 500.3, 0.0)))
    np.testing.assert_allclose(body.points.max(axis=0), HIGH + NEAR)
    np.testing.assert_allclose(body.points.min(axis=0)[[0, 2]], (LOW - NEAR)[[0, 2]])
    assert body.points[:, 1].min() == pytest.approx(0.3, abs=1e-3)


def test_the_vertices_of_a_user_defined_surface_lie_on_it():
    centre = jnp.array([0.0, 1.2, 0.0])
    body = near_whiskers(jw.Surface(lambda x: jnp.sum((x - centre) ** 4) - 1, inside=(0.0, 1.2, 0.0)))
    np.testing.assert_allclose(np.sum((body.points - np.asarray(centre)) ** 4, axis=1), 1.0, atol=10 * ON_SURFACE)


def test_an_object_far_from_the_whiskers_is_not_drawn():
    assert near_whiskers(jw.Sphere(0.1, (0.0, 30.0, 0.0))) is None


def test_a_ring_hides_what_is_behind_its_tube():
    torus = jw.Torus(0.5, 0.15, (0.1, 0.8, 0.0), (0.2, 0.1, 1.0))
    body, towards = near_whiskers(torus), np.array([0.3, 0.2, 1.0]) / np.sqrt(1.13)
    points = np.array([0.1, 0.8, 0.0]) + np.random.default_rng(0).uniform(-0.8, 0.8, (2000, 3))
    away = np.asarray(
        jax.vmap(jax.vmap(torus.off))(jnp.asarray(points[:, None] + np.arange(0, 2, 0.01)[:, None] * towards))
    )
    hidden, least = body.hides(points, towards), away.min(axis=1)
    clear = np.abs(least) > 0.012  # of the polyhedron, the thin layer, and the spacing of places along the rays
    np.testing.assert_array_equal(hidden[clear], least[clear] < 0)
    assert 300 < np.sum(hidden & clear) < 1700
    along = np.array([0.2, 0.1, 1.0]) / np.sqrt(1.05)
    ends = body.points[body.outline(along)] - [0.1, 0.8, 0.0]
    radii = np.linalg.norm(ends - (ends @ along)[..., None] * along, axis=-1)
    np.testing.assert_allclose(np.where(radii > 0.5, 0.65, 0.35), radii, rtol=2 * FLAT)
    lengths = np.linalg.norm(np.diff(ends, axis=1), axis=2).sum()
    assert lengths == pytest.approx(2 * np.pi * (0.65 + 0.35), rel=FLAT)
    assert near_whiskers(torus.moved((30.0, 0.0, 0.0))) is None


def test_several_objects_are_parts_of_one_body():
    """A small ball behind a large one, as seen along x, and one beside them."""
    balls = jw.Sphere(0.3, (0.0, 0.0, 0.0)), jw.Sphere(0.1, (-1.0, 0.0, 0.0)), jw.Sphere(0.1, (0.0, 1.0, 0.0))
    far = jw.Sphere(0.1, (0.0, 0.0, 50.0))
    body = body_of(as_one_surface((*balls, far)), np.full(3, -1.0), np.full(3, 1.0))
    assert body is not None and list(body.parts) == [0, 1, 2]
    towards = np.array([1.0, 0.0, 0.0])
    alone = [body_of(one, np.full(3, -1.0), np.full(3, 1.0)) for one in balls]
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (4000, 3))
    each = [one.hides(points, towards) for one in alone if one is not None]
    np.testing.assert_array_equal(body.hides(points, towards), np.any(each, axis=0))
    assert all(hidden.any() for hidden in each)
    outlines = [len(one.outline(towards)) for one in alone if one is not None]
    assert len(body.outline(towards)) == outlines[0] + outlines[2]  # that of the ball behind is hidden
    assert len(body.outline(-towards)) == sum(len(one.outline(-towards)) for one in alone if one is not None)
