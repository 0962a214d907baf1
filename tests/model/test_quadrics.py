"""Spheres, ellipsoids, cylinders, paraboloids and planes: exact normals and curvatures, derivatives, errors."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Paraboloid, Plane, Sphere
from jaxwhisker._model.surface import as_point

EXACT = 1e-13  # sums of a few numbers of size 1
DIFFERENCES = 1e-7  # central differences: the square of the step, times third derivatives of order 100
STEP = 1e-5

SPHERE = Sphere(0.9, (0.1, 1.3, -0.2))
ELLIPSOID = Ellipsoid((1.2, 0.7, 0.5), (0.1, 1.1, -0.2))
CYLINDER = Cylinder(0.9, (0.0, 1.2, 0.1), (0.5, 0.1, 0.8))
PARABOLOID = Paraboloid(0.2, 2.0, 0.5)
PLANE = Plane((-0.5, 0.3, 0.1), (2.0, -1.0, 2.0))


def principal_curvatures(surface, x):
    """Normal curvatures along the principal directions, in ascending order."""
    normal = np.asarray(surface.normal(x))
    tangents = np.linalg.svd(normal[None])[2][1:]
    return np.linalg.eigvalsh(tangents @ np.asarray(surface.curvature(x)) @ tangents.T)


@pytest.mark.parametrize("direction", [[0.6, -0.64, 0.48], [0.0, 1.0, 0.0]])
def test_a_sphere_has_radial_normals_and_its_radius_of_curvature(direction):
    x = as_point(SPHERE.centre) + 0.9 * jnp.array(direction)
    assert abs(SPHERE.level(x)) < EXACT
    np.testing.assert_allclose(SPHERE.normal(x), direction, atol=EXACT)
    np.testing.assert_allclose(principal_curvatures(SPHERE, x), 1 / 0.9, atol=EXACT)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [1, -1])
def test_poles_of_an_ellipsoid_have_the_curvatures_of_its_sections(axis, side):
    sizes = np.array(ELLIPSOID.half_axes)
    direction = side * np.eye(3)[axis]
    x = jnp.asarray(np.array(ELLIPSOID.centre) + sizes * direction)
    assert abs(ELLIPSOID.level(x)) < EXACT
    np.testing.assert_allclose(ELLIPSOID.normal(x), direction, atol=EXACT)
    expected = np.sort(sizes[axis] / np.delete(sizes, axis) ** 2)
    np.testing.assert_allclose(principal_curvatures(ELLIPSOID, x), expected, rtol=EXACT)


def test_the_gaussian_curvature_of_an_ellipsoid_anywhere():
    a, b, c = ELLIPSOID.half_axes
    d = np.array([a, b, c]) * [0.48, -0.6, 0.64]
    support = 1 / np.sqrt(np.sum((d / np.array([a, b, c]) ** 2) ** 2))  # distance of the centre from the tangent plane
    found = principal_curvatures(ELLIPSOID, jnp.asarray(np.array(ELLIPSOID.centre) + d))
    np.testing.assert_allclose(np.prod(found), support**4 / (a * b * c) ** 2, rtol=1e-12)


def test_a_cylinder_is_straight_along_its_axis_and_round_across():
    axis = np.array(CYLINDER.axis) / np.linalg.norm(CYLINDER.axis)
    across = np.cross(axis, [0.0, 0.6, -0.8])
    across /= np.linalg.norm(across)
    x = jnp.asarray(np.array(CYLINDER.point) + 3.0 * axis + 0.9 * across)
    assert abs(CYLINDER.level(x)) < EXACT
    np.testing.assert_allclose(CYLINDER.normal(x), across, atol=EXACT)
    np.testing.assert_allclose(CYLINDER.curvature(x) @ axis, 0.0, atol=EXACT)
    np.testing.assert_allclose(principal_curvatures(CYLINDER, x), [0.0, 1 / 0.9], atol=EXACT)


def test_a_paraboloid_is_the_graph_of_its_equation():
    vertex = jnp.array([0.0, 0.2, 0.0])
    np.testing.assert_allclose(PARABOLOID.normal(vertex), [0.0, -1.0, 0.0], atol=EXACT)
    np.testing.assert_allclose(PARABOLOID.curvature(vertex), np.diag([4.0, 0.0, 1.0]), atol=EXACT)
    x, z = 0.3, -0.7
    at = jnp.array([x, 0.2 + 2.0 * x**2 + 0.5 * z**2, z])
    assert abs(PARABOLOID.level(at)) < EXACT
    expected = np.array([4.0 * x, -1.0, z])
    np.testing.assert_allclose(PARABOLOID.normal(at), expected / np.linalg.norm(expected), atol=EXACT)
    np.testing.assert_array_equal(Paraboloid(0.2, 3.0).curvature(vertex), Paraboloid(0.2, 3.0, 3.0).curvature(vertex))


def test_a_plane_is_flat_and_has_one_normal():
    normal = np.array([2.0, -1.0, 2.0]) / 3
    for along in ([1.0, 2.0, 0.0], [0.0, 2.0, 1.0]):
        x = jnp.asarray(np.array(PLANE.point) + np.array(along) + 0.3 * normal)
        np.testing.assert_allclose(PLANE.off(x), 0.3, atol=EXACT)
        np.testing.assert_allclose(PLANE.normal(x), normal, atol=EXACT)
        np.testing.assert_array_equal(PLANE.curvature(x), 0.0)
        distance, out = PLANE.plane_before(x)
        np.testing.assert_allclose([distance, *out], [0.3, *normal], atol=EXACT)
    assert PLANE.off(jnp.asarray(np.array(PLANE.point) - 0.2 * normal)) < 0 and np.isinf(PLANE.thickness())


def test_a_plane_turns_about_its_point():
    turned = PLANE.rotated((0.0, 0.5, 0.0)).in_unit(2.0)
    np.testing.assert_allclose(turned.off(jnp.asarray(PLANE.point) / 2), 0.0, atol=EXACT)
    np.testing.assert_allclose(turned.normal(jnp.zeros(3)) @ PLANE.normal(jnp.zeros(3)), (8 * np.cos(0.5) + 1) / 9)


MAKERS = {
    "sphere": (lambda p: Sphere(p[0], tuple(p[1:4])), [0.9, 0.1, 1.3, -0.2]),
    "ellipsoid": (lambda p: Ellipsoid(tuple(p[:3]), tuple(p[3:])), [1.2, 0.7, 0.5, 0.1, 1.1, -0.2]),
    "cylinder": (lambda p: Cylinder(p[0], tuple(p[1:4]), tuple(p[4:])), [0.9, 0.0, 1.2, 0.1, 0.5, 0.1, 0.8]),
    "paraboloid": (lambda p: Paraboloid(p[0], p[1], p[2]), [0.2, 2.0, 0.5]),
    "plane": (lambda p: Plane(tuple(p[:3]), tuple(p[3:])), [-0.5, 0.3, 0.1, 2.0, -1.0, 2.0]),
}


@pytest.mark.parametrize(("make", "numbers"), MAKERS.values(), ids=MAKERS)
def test_derivatives_with_respect_to_points_and_parameters(make, numbers):
    numbers = jnp.asarray(numbers)
    x = make(numbers).interior_point() + jnp.array([0.4, -0.8, 0.5])

    @jax.jit
    def scaled(numbers, x):
        surface = make(numbers).in_unit(1.7)
        return surface.level(x / 1.7), surface.normal(x / 1.7), surface.curvature(x / 1.7)

    check_grads(scaled, (numbers, x), order=1, modes=("fwd", "rev"), eps=STEP, atol=DIFFERENCES, rtol=DIFFERENCES)


def test_traced_parameters_out_of_their_domain_are_invalid():
    nan, inf = np.nan, np.inf
    sphere = jax.jit(lambda r, y: Sphere(r, (0.0, y, 0.0)).valid())
    assert sphere(1.0, 2.0)
    assert not sphere(-1.0, 2.0) and not sphere(nan, 2.0) and not sphere(1.0, inf)
    ellipsoid = jax.jit(lambda a: Ellipsoid((1.0, 1.0, a), (0.0, 2.0, 0.0)).valid())
    assert ellipsoid(0.5) and not ellipsoid(0.0)
    cylinder = jax.jit(lambda r, z: Cylinder(r, (0.0, 2.0, 0.0), (0.0, 0.0, z)).valid())
    assert cylinder(1.0, -0.1) and not cylinder(1.0, 0.0) and not cylinder(-1.0, 1.0)
    paraboloid = jax.jit(lambda a, b: Paraboloid(-0.2, a, b).valid())
    assert paraboloid(1.0, 2.0) and not paraboloid(-1.0, 2.0) and not paraboloid(1.0, -2.0)
    plane = jax.jit(lambda x, z: Plane((x, 1.0, 0.0), (0.0, 0.0, z)).valid())
    assert plane(1.0, -0.1) and not plane(1.0, 0.0) and not plane(np.nan, 1.0)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(0.0, (0.0, 1.0, 0.0)), "`radius` must be a positive finite number, got 0.0."),
        (lambda: Sphere(1.0, (0.0, 1.0)), "`centre` must be a tuple of three numbers, got (0.0, 1.0)."),
        (lambda: Sphere(1.0, 3.0), "`centre` must be a tuple of three numbers, got 3.0."),
        (
            lambda: Ellipsoid((1.0, -1.0, 1.0), (0.0, 1.0, 0.0)),
            "`half_axes[1]` must be a positive finite number, got -1.0.",
        ),
        (lambda: Ellipsoid((1.0, 1.0, 1.0), (0.0, np.nan, 0.0)), "`centre[1]` must be a finite number, got nan."),
        (lambda: Cylinder(-0.9, (0.0, 1.0, 0.0)), "`radius` must be a positive finite number, got -0.9."),
        (lambda: Cylinder(0.9, (0.0, np.inf, 0.0)), "`point[1]` must be a finite number, got inf."),
        (lambda: Cylinder(0.9, (0.0, 1.0, 0.0), "z"), "`axis` must be a tuple of three numbers, got 'z'."),
        (
            lambda: Cylinder(0.9, (0.0, 1.0, 0.0), (0, 0.0, 0)),
            "`axis` must be a vector other than zero, got (0, 0.0, 0).",
        ),
        (lambda: Paraboloid(np.nan), "`distance` must be a finite number, got nan."),
        (lambda: Paraboloid(0.2, 0.0), "`a` must be a positive finite number, got 0.0."),
        (lambda: Plane((0.0, np.inf, 0.0), (1, 0, 0)), "`point[1]` must be a finite number, got inf."),
        (lambda: Plane((0, 0, 0), 1.0), "`outward` must be a tuple of three numbers, got 1.0."),
        (lambda: Plane((0, 0, 0), (0, 0.0, 0)), "`outward` must be a vector other than zero, got (0, 0.0, 0)."),
        (lambda: Paraboloid(0.2, 1.0, -2.0), "`b` must be a positive finite number, got -2.0."),
    ],
)
def test_errors_name_the_argument(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


def test_text():
    assert str(SPHERE) == "sphere r = 0.9, centre (0.1, 1.3, -0.2)"
    assert str(ELLIPSOID) == "ellipsoid a = 1.2, b = 0.7, c = 0.5, centre (0.1, 1.1, -0.2)"
    assert str(CYLINDER) == "cylinder r = 0.9, through (0, 1.2, 0.1) along (0.5, 0.1, 0.8)"
    assert str(Paraboloid(0.2)) == "paraboloid q = 0.2"
    assert str(PLANE) == "plane through (-0.5, 0.3, 0.1), facing (2, -1, 2)"
    assert str(PARABOLOID) == "paraboloid q = 0.2, a = 2, b = 0.5"
    seen = []
    jax.jit(lambda r: seen.append(str(Sphere(r, (0.0, 1.0, r)))) or r)(1.0)
    assert seen == ["sphere r = ?, centre (0, 1, ?)"]


def test_points_and_vectors_may_be_lists_and_arrays():
    expected = Cylinder(0.9, (0.0, 1.5, 0.0), (0.0, 0.0, 1.0))
    for kind in (list, np.array, jnp.array):
        assert str(Cylinder(0.9, kind([0.0, 1.5, 0.0]), kind([0.0, 0.0, 1.0]))) == str(expected)
    assert str(Sphere(0.9, [0.0, 1.5, 0.0]).moved(np.ones(3))) == str(
        Sphere(0.9, (0.0, 1.5, 0.0)).moved((1.0, 1.0, 1.0))
    )
