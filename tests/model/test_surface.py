"""Surfaces: derivatives of the level, placements, units, costs; quadrics and others."""

# pyright: reportArgumentType=false
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Paraboloid, Sphere
from jaxwhisker._model.surface import AbstractSurface, Placed, Quadric, triple_text
from operations import operations, traced

EXACT = 1e-13  # sums of a few numbers of size 1
DIFFERENCES = 1e-7  # central differences: the square of the step, times third derivatives of order 100
STEP = 1e-5
FEW = 60  # operations on whole arrays

SPHERE = Sphere(0.9, (0.1, 1.3, -0.2))
ELLIPSOID = Ellipsoid((1.2, 0.7, 0.5), (0.1, 1.1, -0.2))
CYLINDER = Cylinder(0.9, (0.0, 1.2, 0.1), (0.5, 0.1, 0.8))
PARABOLOID = Paraboloid(0.2, 2.0, 0.5)
TURN, SHIFT = (0.3, 0.2, -0.4), (0.2, -0.1, 0.4)
SURFACES = {
    "sphere": SPHERE,
    "ellipsoid": ELLIPSOID,
    "cylinder": CYLINDER,
    "paraboloid": PARABOLOID,
    "turned ellipsoid": ELLIPSOID.rotated(TURN),
    "turned and moved paraboloid": PARABOLOID.rotated(TURN, about=(0.1, 0.2, 0.3)).moved(SHIFT),
}
each_surface = pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)


class Egg(AbstractSurface):
    """A surface of which only the level is known: that of a placed ellipsoid."""

    ellipsoid: AbstractSurface

    def level(self, x):
        return jnp.expm1(self.ellipsoid.level(x))

    def in_unit(self, length):
        raise NotImplementedError

    def interior_point(self):
        return self.ellipsoid.interior_point()

    def _positive(self):
        return []

    def __str__(self):
        return "egg"


class Shell(AbstractSurface):
    """A quartic surface."""

    size: float = 1.0

    def level(self, x):
        return jnp.sum((x / self.size) ** 4 + jnp.array([0.1, 0.2, 0.3]) * x / self.size) - 1

    def in_unit(self, length):
        return Shell(self.size / length)

    def interior_point(self):
        return jnp.array([0.1, -0.1, 0.2]) * self.size

    def _positive(self):
        return [self.size]

    def __str__(self):
        return "shell"


def near(surface):
    """A point close to the surface, in no special direction from the inside."""
    start = surface.interior_point() + jnp.array([0.3, -0.6, 0.4])
    for _ in range(4):
        start = start - surface.off(start) * surface.normal(start)
    return start + jnp.array([0.02, -0.05, 0.03])


@each_surface
def test_the_level_rises_outwards_and_is_negative_inside(surface):
    x = near(surface)
    assert surface.level(surface.interior_point()) < 0 < surface.level(x + surface.normal(x))
    distance = 1e-5
    on = x - surface.off(x) * surface.normal(x)
    on = on - surface.off(on) * surface.normal(on)
    on = on - surface.off(on) * surface.normal(on)
    # The next term of the distance is its square times half the curvature, which is at most 5.
    np.testing.assert_allclose(surface.off(on + distance * surface.normal(on)), distance, atol=5 * distance**2)


@each_surface
def test_normals_and_curvatures_are_the_derivatives_of_the_level(surface):
    x = near(surface)
    gradient, hessian = jax.grad(surface.level)(x), jax.hessian(surface.level)(x)
    size = jnp.linalg.norm(gradient)
    np.testing.assert_allclose(surface.normal(x), gradient / size, atol=EXACT)
    np.testing.assert_allclose(surface.curvature(x), hessian / size, atol=EXACT)
    np.testing.assert_allclose(surface.off(x), surface.level(x) / size, atol=EXACT)


@each_surface
def test_another_unit_scales_lengths_and_gives_a_quadric(surface):
    x, length = near(surface), 2.5
    scaled = surface.in_unit(length)
    assert isinstance(scaled, Quadric) and str(scaled) == "quadric" and scaled.valid()
    for surface_now in (scaled, scaled.in_unit(0.5).in_unit(2.0)):
        np.testing.assert_allclose(surface_now.off(x / length), surface.off(x) / length, atol=EXACT)
        np.testing.assert_allclose(surface_now.normal(x / length), surface.normal(x), atol=EXACT)
        np.testing.assert_allclose(surface_now.curvature(x / length), surface.curvature(x) * length, rtol=1e-12)
        np.testing.assert_allclose(surface_now.interior_point(), surface.interior_point() / length, atol=EXACT)


@pytest.mark.parametrize("original", [ELLIPSOID, PARABOLOID, Egg(ELLIPSOID)], ids=str)
def test_a_placed_surface_moves_with_its_points(original):
    about = np.array([0.1, 0.2, 0.3])
    turn = Rotation.from_rotvec(TURN).as_matrix()
    placed = original.rotated(TURN, about=tuple(about)).moved(SHIFT)
    before = near(original)
    after = jnp.asarray(about + turn @ (np.asarray(before) - about) + np.array(SHIFT))
    np.testing.assert_allclose(placed.level(after), original.level(before), atol=EXACT)
    np.testing.assert_allclose(placed.normal(after), turn @ original.normal(before), atol=EXACT)
    np.testing.assert_allclose(placed.curvature(after), turn @ original.curvature(before) @ turn.T, rtol=1e-12)
    inside = about + turn @ (np.asarray(original.interior_point()) - about) + np.array(SHIFT)
    np.testing.assert_allclose(placed.interior_point(), inside, atol=EXACT)


def test_by_default_a_surface_turns_about_its_centre():
    turned = ELLIPSOID.rotated((0.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(turned.interior_point(), np.array(ELLIPSOID.centre), atol=EXACT)
    matrix = turned.hessian(near(ELLIPSOID))
    np.testing.assert_allclose(matrix, np.diag([1 / 0.7, 0.7 / 1.44, 2.8]), atol=EXACT)


def test_placed_surfaces_that_are_no_quadrics_scale_too():
    placed = Placed(Shell(), by=SHIFT, rotation=TURN, about=(0.1, 0.2, 0.3))
    centred = Placed(Shell(), rotation=TURN)
    x = jnp.array([0.4, 0.5, -0.3])
    for surface in (placed, centred):
        scaled = surface.in_unit(2.0)
        assert not isinstance(scaled, Quadric)
        np.testing.assert_allclose(scaled.off(x / 2), surface.off(x) / 2, atol=EXACT)
        np.testing.assert_allclose(scaled.interior_point(), surface.interior_point() / 2, atol=EXACT)


PLACES = {
    "placed": (
        lambda p: ELLIPSOID.rotated(tuple(p[:3]), tuple(p[3:6])).moved(tuple(p[6:])),
        [0.3, 0.2, -0.4, 0.1, 0.2, 0.3, 0.2, -0.1, 0.4],
    ),
    "without rotation": (lambda p: ELLIPSOID.rotated(tuple(p)), [0.0, 0.0, 0.0]),
    "no quadric": (lambda p: Shell().rotated(tuple(p[:3]), tuple(p[3:6])).moved(tuple(p[6:])), [0.2] * 9),
}


@pytest.mark.parametrize(("make", "numbers"), PLACES.values(), ids=PLACES)
def test_derivatives_with_respect_to_points_and_places(make, numbers):
    numbers = jnp.asarray(numbers)
    x = near(make(numbers))
    scaled = jax.jit(lambda p, x: _everything(make(p).in_unit(1.7), x / 1.7))
    check_grads(scaled, (numbers, x), order=1, modes=("fwd", "rev"), eps=STEP, atol=DIFFERENCES, rtol=DIFFERENCES)


def _everything(surface, x):
    return surface.level(x), surface.normal(x), surface.curvature(x), surface.off(x)


@each_surface
def test_a_batch_equals_a_loop(surface):
    points = near(surface) + 0.1 * jnp.eye(3)
    batch = jax.jit(jax.vmap(lambda x: _everything(surface, x)))(points)
    for k in range(3):
        for one, other in zip(batch, _everything(surface, points[k]), strict=True):
            np.testing.assert_allclose(one[k], other, atol=EXACT)


@each_surface
def test_in_the_unit_of_a_problem_a_surface_costs_few_operations(surface):
    scaled = surface.in_unit(1.0)
    assert operations(traced(lambda x: _everything(scaled, x), near(surface))) < FEW


def test_traced_places_that_are_not_finite_are_invalid():
    placed = jax.jit(lambda by, turn: SPHERE.moved((by, 0.0, 0.0)).rotated((turn, 0.0, 0.0)).valid())
    assert placed(1.0, 0.0) and not placed(np.nan, 0.0) and not placed(1.0, np.inf)
    assert not jax.jit(lambda r: Sphere(r, (0.0, 2.0, 0.0)).moved((r, r, r)).valid())(-1.0)
    assert not jax.jit(lambda r: Sphere(r, (0.0, 2.0, 0.0)).in_unit(1.0).valid())(-1.0)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SPHERE.moved((1.0, 2.0)), "`by` must be a tuple of three numbers, got (1.0, 2.0)."),
        (lambda: SPHERE.rotated(0.3), "`rotation` must be a tuple of three numbers, got 0.3."),
        (lambda: SPHERE.rotated(TURN, about=(0.0, 0.0, np.nan)), "`about[2]` must be a finite number, got nan."),
    ],
)
def test_errors_name_the_argument(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


def test_text():
    placed = str(PARABOLOID.rotated(TURN).moved(SHIFT))
    assert placed == f"{PARABOLOID}, turned by (0.3, 0.2, -0.4), moved by (0.2, -0.1, 0.4)"
    assert str(SPHERE.moved((0.0, 0.0, 0.0))) == str(SPHERE)
    assert triple_text((1.0, 2, np.float64(0.1))) == "(1, 2, 0.1)"


def test_surfaces_say_that_they_are_is_surface():
    assert all(surface.is_surface for surface in SURFACES.values())
