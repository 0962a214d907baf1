"""Capsules and boxes with rounded edges: their parts, their curvature between these, planes before them, errors."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxwhisker._model.quadrics import Cylinder, Plane, Sphere
from jaxwhisker._model.rounded import BLEND, Capsule, Rounded, RoundedBox

EXACT = 1e-13  # sums of a few numbers of size 1
DIFFERENCES = 5e-6  # central differences: the square of the step, times third derivatives of order 1e5 in the strips
STEP = 1e-5

START, END, RADIUS = np.array([0.1, 1.2, -0.3]), np.array([0.4, 1.0, 1.7]), 0.25
CAPSULE = Capsule(RADIUS, tuple(START), tuple(END))
AXIS = (END - START) / np.linalg.norm(END - START)
ACROSS = np.cross(AXIS, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(AXIS, [0.0, 1.0, 0.0]))
CAP = RADIUS * np.sqrt(1 - 0.2 * BLEND**2)  # radius of the hemispheres
SIZE, EDGE, CENTRE = np.array([0.8, 0.5, 0.6]), 0.05, np.array([0.1, 1.0, -0.2])
BOX = RoundedBox(tuple(SIZE), EDGE, tuple(CENTRE))
TURN, SHIFT = (0.3, 0.2, -0.4), (0.2, -0.1, 0.4)
BODIES = {"capsule": CAPSULE, "box": BOX, "turned box": BOX.rotated(TURN).moved(SHIFT)}
each_body = pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)


@eqx.filter_jit
def everything(surface, x):
    return surface.off(x), surface.normal(x), surface.curvature(x)


def same(surface, other, x, tolerance=EXACT):
    for one, expected in zip(everything(surface, jnp.asarray(x)), everything(other, jnp.asarray(x)), strict=True):
        np.testing.assert_allclose(one, expected, atol=tolerance)


def on_surface(body, directions):
    """Points of the surface in these directions from the middle."""
    middle, low, high = np.asarray(body.interior_point()), np.zeros(len(directions)), np.full(len(directions), 4.0)
    level = jax.jit(jax.vmap(body.level))
    for _ in range(60):
        share = (low + high) / 2
        inside = np.asarray(level(jnp.asarray(middle + share[:, None] * directions))) < 0
        low, high = np.where(inside, share, low), np.where(inside, high, share)
    return middle + low[:, None] * directions


def spread(count=300, seed=1):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.7])
def test_the_middle_of_a_capsule_is_a_cylinder(share):
    x = START + share * (END - START) + 1.1 * RADIUS * ACROSS
    same(CAPSULE, Cylinder(RADIUS, tuple(START), tuple(AXIS)), x)


@pytest.mark.parametrize(("end", "outwards"), [(START, -AXIS), (END, AXIS)])
@pytest.mark.parametrize("lean", [0.0, 0.5, 1.3])
def test_the_ends_of_a_capsule_are_hemispheres(end, outwards, lean):
    direction = np.cos(lean) * outwards + np.sin(lean) * ACROSS
    sphere = Sphere(CAP, tuple(end))
    same(CAPSULE, sphere, end + CAP * direction)
    assert RADIUS * 0.998 < CAP < RADIUS


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1, 1])
def test_faces_of_a_box_are_planes(axis, side):
    outward = side * np.eye(3)[axis]
    face = CENTRE + outward * SIZE / 2
    beside = np.array([0.1, -0.1, 0.15])
    beside[axis] = 0.0
    x, plane = jnp.asarray(face + beside), Plane(tuple(face), tuple(outward))
    np.testing.assert_allclose(BOX.off(x + 1e-3 * outward), plane.off(x + 1e-3 * outward), rtol=0.02)  # to first order
    np.testing.assert_allclose(BOX.off(x), 0.0, atol=EXACT)
    np.testing.assert_allclose(BOX.normal(x), plane.normal(x), atol=EXACT)
    flat = np.eye(3) - np.outer(outward, outward)
    np.testing.assert_allclose(flat @ BOX.curvature(x) @ flat, 0.0, atol=EXACT)


@pytest.mark.parametrize(("active", "parts"), [((1, 1, 0), 2), ((0, 1, 1), 2), ((1, 1, 1), 3)])
def test_edges_of_a_box_are_cylinders_and_its_corners_spheres(active, parts):
    active = np.array(active)
    radius = np.sqrt(EDGE**2 - (parts - 1) * 0.2 * (BLEND * EDGE) ** 2)
    centre = CENTRE + active * (SIZE / 2 - EDGE)
    x = centre + radius * active / np.sqrt(parts)
    axis = 1 - active
    same(BOX, Cylinder(radius, tuple(centre), tuple(axis)) if parts == 2 else Sphere(radius, tuple(centre)), x, 1e-12)


def test_the_curvature_along_a_capsule_rises_steadily_over_the_strip():
    places = np.linspace(-1.5 * BLEND, 1.5 * BLEND, 400) * RADIUS
    x = END + places[:, None] * AXIS + RADIUS * ACROSS

    def along(x):
        x = x - CAPSULE.off(x) * CAPSULE.normal(x)
        normal = CAPSULE.normal(x)
        tangent = jnp.asarray(AXIS) - jnp.sum(normal * AXIS) * normal
        tangent = tangent / jnp.linalg.norm(tangent)
        return jnp.sum(tangent * (CAPSULE.curvature(x) @ tangent))

    found = np.asarray(jax.vmap(along)(jnp.asarray(x)))
    np.testing.assert_allclose(found[[0, -1]], [0.0, 1 / CAP], atol=1e-2)  # the point is not yet on the surface
    steps = np.diff(found)
    assert np.min(steps) > -1e-3 and np.max(steps) < 0.02 / RADIUS


@each_body
def test_normals_and_curvatures_are_the_derivatives_of_the_level(body):
    @jax.jit
    @jax.vmap
    def both(x):
        gradient, hessian = jax.grad(body.level)(x), jax.hessian(body.level)(x)
        size = jnp.linalg.norm(gradient)
        return (body.normal(x), gradient / size), (body.curvature(x), hessian / size)

    normals, curvatures = both(jnp.asarray(on_surface(body, spread(20)) + 0.01))
    np.testing.assert_allclose(*normals, atol=EXACT)
    np.testing.assert_allclose(*curvatures, atol=1e-11)


@each_body
def test_on_planes_of_symmetry_curvatures_are_those_beside_them(body):
    rounded = body.in_unit(1.0)
    x = rounded.middle + jnp.sum(rounded.axes * jnp.asarray([[0.0], [0.0], [float(rounded.half[2] + rounded.size)]]), 0)
    beside = x + 1e-9 * rounded.axes[1]
    np.testing.assert_allclose(jax.hessian(rounded.level)(x), jax.hessian(rounded.level)(beside), atol=1e-6)
    by = jax.jacfwd(rounded.normal)
    np.testing.assert_allclose(by(x), by(beside), atol=1e-6)


@each_body
def test_a_plane_before_a_point_does_not_cut_the_body(body):
    surface = on_surface(body, spread())
    extent = float(np.max(np.linalg.norm(surface - np.asarray(body.interior_point()), axis=1)))
    middle, rng = np.asarray(body.interior_point()), np.random.default_rng(2)
    points = middle + extent * rng.uniform(-2, 2, (200, 3))
    points = np.concatenate([points, middle + rng.uniform(0, 1, (300, 1)) * (surface - middle)])
    distances, normals = map(np.asarray, jax.vmap(body.plane_before)(jnp.asarray(points)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=EXACT)
    ahead = np.einsum("pi,spi->sp", normals, surface[:, None] - points) + distances
    assert np.max(ahead) < 1e-9
    levels = np.asarray(jax.vmap(body.level)(jnp.asarray(points)))
    assert 300 <= np.sum(levels < 0) < 400
    np.testing.assert_array_equal(distances < 0, levels < 0)


def test_planes_in_the_core_are_those_of_the_nearest_face():
    distance, normal = BOX.plane_before(jnp.asarray(CENTRE))
    np.testing.assert_allclose(distance, -SIZE[1] / 2, atol=EXACT)
    np.testing.assert_allclose(np.abs(normal), [0.0, 1.0, 0.0], atol=EXACT)
    distance, normal = CAPSULE.plane_before(jnp.asarray(START + 0.9 * (END - START)))
    np.testing.assert_allclose([distance, normal @ AXIS], [-RADIUS, 0.0], atol=EXACT)


@each_body
def test_another_unit_scales_lengths_and_absorbs_the_place(body):
    scaled = body.in_unit(2.5)
    assert isinstance(scaled, Rounded) and scaled.valid() and str(scaled) == "rounded body"
    for x in map(jnp.asarray, on_surface(body, spread(5)) + 0.01):
        for now in (scaled, scaled.in_unit(0.5).in_unit(2.0)):
            off, normal, curvature = everything(body, x)
            for one, expected in zip(everything(now, x / 2.5), (off / 2.5, normal, curvature * 2.5), strict=True):
                np.testing.assert_allclose(one, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scaled.interior_point(), body.interior_point() / 2.5, atol=EXACT)
    np.testing.assert_allclose(scaled.thickness(), body.thickness() / 2.5, rtol=EXACT)


def test_a_placed_box_moves_with_its_points():
    turn, x = Rotation.from_rotvec(TURN).as_matrix(), CENTRE + np.array([0.3, 0.26, 0.1])
    after = jnp.asarray(CENTRE + turn @ (x - CENTRE) + np.array(SHIFT))
    for placed in (BODIES["turned box"], BODIES["turned box"].in_unit(1.0)):
        np.testing.assert_allclose(placed.off(after), BOX.off(jnp.asarray(x)), atol=EXACT)
        np.testing.assert_allclose(placed.normal(after), turn @ BOX.normal(jnp.asarray(x)), atol=EXACT)


def test_the_thickness_is_the_least_half_width():
    assert float(CAPSULE.thickness()) == RADIUS
    np.testing.assert_allclose(BOX.thickness(), SIZE[1] / 2, rtol=1e-3)


def test_stretches_end_where_the_curvature_begins_to_change():
    body, width = CAPSULE.in_unit(1.0), BLEND * RADIUS
    x = jnp.asarray((START + END) / 2 + RADIUS * ACROSS)
    half = np.linalg.norm(END - START) / 2
    way = jnp.asarray(AXIS + ACROSS)
    np.testing.assert_allclose(body.steps_to_joint(x, way), half - width, rtol=EXACT)
    beside = x + 0.1 * half * AXIS
    np.testing.assert_allclose(body.steps_to_joint(beside, way), 0.9 * half - width, rtol=1e-12)
    np.testing.assert_allclose(body.steps_to_joint(beside, -way), 1.1 * half - width, rtol=1e-12)
    np.testing.assert_allclose(body.steps_to_joint(x, 2 * way), (half - width) / 2, rtol=EXACT)
    assert body.steps_to_joint(x, jnp.asarray(ACROSS)) > 1e9  # along the strips
    on_joint = jnp.asarray(END + RADIUS * ACROSS)
    np.testing.assert_allclose(body.steps_to_joint(on_joint, way), width, rtol=1e-9)
    on_cap = jnp.asarray(END + 3 * width * AXIS)
    assert np.isinf(body.steps_to_joint(on_cap, jnp.asarray(AXIS)))
    np.testing.assert_allclose(body.steps_to_joint(on_cap, -jnp.asarray(AXIS)), 2 * width, rtol=1e-9)
    assert np.isinf(Sphere(1.0, (0.0, 0.0, 0.0)).steps_to_joint(x, way))


MAKERS = {
    "capsule": (lambda p: Capsule(p[0], tuple(p[1:4]), tuple(p[4:])), [RADIUS, *START, *END]),
    "box": (lambda p: RoundedBox(tuple(p[:3]), p[3], tuple(p[4:])), [*SIZE, EDGE, *CENTRE]),
}
POINTS = {
    "capsule": [START + 0.4 * (END - START) + RADIUS * ACROSS, END + RADIUS * ACROSS, END + RADIUS * AXIS],
    "box": [CENTRE + SIZE / 2 * [0.5, 1, 0.3], CENTRE + SIZE / 2 - [EDGE, 0, EDGE], CENTRE + SIZE / 2 - 0.4 * EDGE],
}


@pytest.mark.parametrize(("name", "k"), [(name, k) for name in POINTS for k in range(3)])
def test_derivatives_with_respect_to_points_and_parameters(name, k):
    make, numbers = MAKERS[name]

    @jax.jit
    def scaled(numbers, x):
        surface = make(numbers).in_unit(1.7)
        return surface.level(x / 1.7), surface.normal(x / 1.7), EDGE * surface.curvature(x / 1.7)

    x = jnp.asarray(POINTS[name][k] + 0.001)
    check_grads(scaled, (jnp.asarray(numbers), x), 1, ("fwd", "rev"), eps=STEP, atol=DIFFERENCES, rtol=DIFFERENCES)


@each_body
def test_a_batch_equals_a_loop(body):
    points = jnp.asarray(on_surface(body, spread(4)))
    batch = jax.jit(jax.vmap(lambda x: everything(body, x)))(points)
    for k in range(4):
        for one, other in zip(batch, everything(body, points[k]), strict=True):
            np.testing.assert_allclose(one[k], other, atol=1e-11)


def test_a_short_capsule_has_narrow_strips():
    short = Capsule(1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1e-3))
    same(short, Sphere(1.0, (0.0, 0.0, 0.0)), [0.6, 0.0, -0.8], 1e-3)
    assert np.all(np.isfinite(short.hessian(jnp.array([1.0, 0.0, 0.0]))))


def test_traced_parameters_out_of_their_domain_are_invalid():
    capsule = jax.jit(lambda r, z: Capsule(r, (0.0, 1.0, 0.0), (0.0, 1.0, z)).valid())
    assert capsule(0.1, 1.0) and not capsule(-0.1, 1.0) and not capsule(0.1, 0.0) and not capsule(np.nan, 1.0)
    box = jax.jit(lambda a, r: RoundedBox((a, 1.0, 1.0), r, (0.0, 1.0, 0.0)).valid())
    assert box(0.5, 0.1) and not box(0.5, 0.25) and not box(0.5, 0.0) and not box(-0.5, 0.1)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Capsule(0.0, (0.0, 1.0, 0.0), (0.0, 1.0, 1.0)),
            "`radius` must be a positive finite number, got 0.0.",
        ),
        (
            lambda: Capsule(0.1, (0.0, 1.0), (0.0, 1.0, 1.0)),
            "`start` must be a tuple of three numbers, got (0.0, 1.0).",
        ),
        (lambda: Capsule(0.1, (0, 1, 0), (0.0, 1.0, np.nan)), "`end[2]` must be a finite number, got nan."),
        (
            lambda: Capsule(0.1, (0.0, 1.0, 0.0), (0, 1, 0)),
            "`end` must be a point other than `start`, got (0, 1, 0).",
        ),
        (
            lambda: RoundedBox((1.0, -1.0, 1.0), 0.1, (0.0, 1.0, 0.0)),
            "`size[1]` must be a positive finite number, got -1.0.",
        ),
        (
            lambda: RoundedBox((1.0, 1.0, 1.0), 0.0, (0.0, 1.0, 0.0)),
            "`radius` must be a positive finite number, got 0.0.",
        ),
        (
            lambda: RoundedBox((1.0, 0.4, 1.0), 0.2, (0.0, 1.0, 0.0)),
            "`radius` must be less than half of the shortest edge (0.2), got 0.2.",
        ),
        (lambda: RoundedBox((1.0, 1.0, 1.0), 0.1, "here"), "`centre` must be a tuple of three numbers, got 'here'."),
    ],
)
def test_errors_name_the_argument(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


def test_text():
    assert str(Capsule(0.1, (0, 1, 0.0), (0, 1, 2.0))) == "capsule r = 0.1, from (0, 1, 0) to (0, 1, 2)"
    assert str(BOX) == "rounded box (0.8, 0.5, 0.6), r = 0.05, centre (0.1, 1, -0.2)"
