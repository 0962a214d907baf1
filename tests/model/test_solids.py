"""Extruded and revolved profiles and user-defined surfaces: against closed forms, on the axis, beyond ends, errors."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxwhisker as jw
from jaxwhisker._model.objects import as_one
from jaxwhisker._model.quadrics import Cylinder, Ellipsoid, Paraboloid, Sphere
from jaxwhisker._model.solids import CORE, Extruded, Revolved
from jaxwhisker._model.surface import Quadric
from jaxwhisker._model.user_surface import Surface

EXACT = 1e-12  # sums of a few numbers of size 1, after a search that ends at rounding
TABLE = 1e-9  # contours are tables of polynomials, whose second derivatives are a little less exact
SMOOTHED = CORE**2  # relative to the radius of curvature: what the smooth distance from the axis changes
DIFFERENCES = 1e-6  # central differences: the square of the step, times third derivatives of order 1000
STEP = 1e-5
VERTICAL = 1e-5  # the steepest slope of a contour is 1e-6 below a right angle
INSIDE = (0.0, 1.2, 0.0)


class Curve(eqx.Module):
    """y = height + bow (x - shift)^2 + growth (x - shift)^4."""

    height: float | jax.Array
    bow: float | jax.Array = 1.0
    growth: float | jax.Array = 0.0
    shift: float | jax.Array = 0.0

    def __call__(self, x):
        return self.height + self.bow * (x - self.shift) ** 2 + self.growth * (x - self.shift) ** 4


class Power(eqx.Module):
    """The sum of fourth powers of the distances from a point, over a size."""

    size: float | jax.Array = 1.0
    height: float | jax.Array = 1.2

    def __call__(self, x):
        return jnp.sum(((x - jnp.array([0.0, 1.0, 0.0]) * self.height) / self.size) ** 4) - 1


SEMICIRCLE = jw.Graph(lambda x: 1.3 - jnp.sqrt(1.0 - x**2))


def contour(radii=(0.5, 0.5, 0.5), distance=0.2, position=0.0):
    return jw.Contour(distance, jnp.log(jnp.asarray(radii)), (-1.0, 0.0, 1.0), position)


@eqx.filter_jit
def evaluated(surface, x, length=1.0):
    """Distance, normal, curvature and interior point, computed in another unit of length."""
    scaled, at = surface.in_unit(length), x / length
    return scaled.off(at) * length, scaled.normal(at), scaled.curvature(at) / length, scaled.interior_point() * length


@eqx.filter_jit
def along_tangent(surface, x, tangent):
    """Distance, normal, curvature within the tangent plane, and the derivative of the latter along a tangent."""
    form = surface.in_unit(1.0)
    bent, change = jax.jvp(lambda x: in_plane(form.curvature(x), form.normal(x)), (x,), (tangent,))
    return form.off(x), form.normal(x), bent, change


def in_plane(curvature, normal):
    """Curvature within the tangent plane, which unlike the whole matrix does not depend on the level."""
    plane = jnp.eye(3) - normal[:, None] * normal
    return plane @ curvature @ plane


def on(surface, direction):
    """The point of the surface in this direction from the inside."""
    start = surface.interior_point()
    low, high = 0.0, 1.0
    while surface.level(start + high * jnp.asarray(direction)) < 0:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if surface.level(start + middle * jnp.asarray(direction)) < 0 else (low, middle)
    return start + low * jnp.asarray(direction)


DIRECTIONS = ([0.0, -1.0, 0.0], [0.3, -0.8, 0.4], [-0.7, -0.5, -0.2], [0.9, 0.1, 0.3])
SAME = {
    "revolved circle": (Revolved(jw.Circle(0.3, 0.9, 0.1)), Sphere(0.9, (0.1, 1.2, 0.0)), EXACT),
    "revolved ellipse": (Revolved(jw.Ellipse(0.3, 0.9, 0.5)), Ellipsoid((0.9, 0.5, 0.9), (0.0, 0.8, 0.0)), EXACT),
    "revolved steep ellipse": (Revolved(jw.Ellipse(0.3, 0.5, 0.9)), Ellipsoid((0.5, 0.9, 0.5), (0.0, 1.2, 0.0)), EXACT),
    "revolved parabola": (Revolved(jw.Parabola(0.2, 2.0)), Paraboloid(0.2, 2.0), EXACT),
    "revolved graph": (Revolved(jw.Graph(Curve(0.2, 2.0))), Paraboloid(0.2, 2.0), EXACT),
    "extruded circle": (Extruded(jw.Circle(0.3, 0.9, 0.1)), Cylinder(0.9, (0.1, 1.2, 0.0)), EXACT),
    "tilted circle": (
        Extruded(jw.Tilted(jw.Circle(0.3, 0.9, 0.1), 0.4, (0.1, 1.2))),
        Cylinder(0.9, (0.1, 1.2, 0.0)),
        EXACT,
    ),
    "extruded graph": (Extruded(jw.Graph(Curve(0.2, 2.0))), Extruded(jw.Parabola(0.2, 2.0)), EXACT),
    "tilted graph": (
        Extruded(jw.Tilted(jw.Graph(Curve(0.2, 2.0)), 0.3)),
        Extruded(jw.Parabola(0.2, 2.0)).rotated((0.0, 0.0, 0.3), about=(0.0, 0.0, 0.0)),
        EXACT,
    ),
    "revolved contour": (Revolved(contour(position=0.1)), Sphere(0.5, (0.1, 0.7, 0.0)), TABLE),
    "extruded contour": (Extruded(contour(position=0.1)), Cylinder(0.5, (0.1, 0.7, 0.0)), TABLE),
}


@pytest.mark.parametrize(("solid", "exact", "tolerance"), SAME.values(), ids=SAME)
def test_a_solid_equals_the_surface_in_closed_form(solid, exact, tolerance):
    for direction in DIRECTIONS:
        if "contour" in str(solid) and direction[1] > 0:
            continue  # above its widest place, the object goes straight up
        x = on(exact.in_unit(1.0), direction)
        (off, normal, curvature, _), (_, expected, bent, _) = evaluated(solid, x), evaluated(exact, x)
        assert abs(off) < tolerance
        np.testing.assert_allclose(normal, expected, atol=tolerance)
        np.testing.assert_allclose(in_plane(curvature, normal), in_plane(bent, expected), atol=10 * tolerance)


def test_solids_of_conic_sections_are_quadrics():
    for profile in (jw.Parabola(0.2), jw.Circle(0.2, 0.5), jw.Ellipse(0.2, 0.5, 0.3)):
        for solid in (Extruded(profile), Revolved(profile), Extruded(jw.Tilted(profile, 0.3))):
            assert isinstance(solid.rotated((0.1, 0.2, 0.3)).in_unit(2.0), Quadric)


PROFILES = {
    "graph": jw.Graph(Curve(0.2, 1.0, 0.5), position=0.1),
    "hyperbolic cosine": jw.Graph(lambda x: jnp.cosh(8 * x) / 5),  # overflows within the searched range
    "semicircle": SEMICIRCLE,
    "contour": contour((0.4, 0.5, 0.8), position=-0.1),
    "tilted contour": jw.Tilted(contour((0.4, 0.5, 0.8)), 0.3, (0.1, 0.2)),
    "tilted parabola": jw.Tilted(jw.Parabola(0.2), -0.3, (0.1, 0.2)),
    "ellipse": jw.Ellipse(0.2, 0.5, 0.3, 0.1),
}
each_profile = pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)


@each_profile
def test_an_extruded_profile_contains_its_points_and_has_their_normals(profile):
    for parameter in (-0.5, 0.0, 0.02, 0.7):
        at, rate = jax.jvp(profile.point, (jnp.asarray(parameter),), (jnp.ones(()),))
        off, normal, curvature, _ = evaluated(Extruded(profile), jnp.stack([at.x, at.y, jnp.asarray(0.6)]))
        assert abs(off) < EXACT
        np.testing.assert_allclose(normal, [at.sin, -at.cos, 0.0], atol=EXACT)
        expected, tangent = np.hypot(rate.cos, rate.sin) / np.hypot(rate.x, rate.y), np.array([at.cos, at.sin, 0.0])
        np.testing.assert_allclose(in_plane(curvature, normal), expected * np.outer(tangent, tangent), atol=TABLE)


@each_profile
def test_the_interior_point_is_inside(profile):
    inside = evaluated(Extruded(profile), jnp.zeros(3))[3]
    assert evaluated(Extruded(profile), inside)[0] < 0


@pytest.mark.parametrize("make", [Extruded, Revolved])
def test_the_level_is_the_distance_from_the_profile(make):
    curve = jw.Graph(Curve(0.2, 1.0, 0.5), position=0.1)
    for parameter in (0.0, 0.3, 1.2):
        at = curve.point(jnp.asarray(parameter))
        for distance in (-0.1, 0.0, 0.2, 5.0):
            x = jnp.stack([at.x + distance * at.sin, at.y - distance * at.cos, jnp.zeros(())])
            off, normal, _, _ = evaluated(make(curve), x)
            np.testing.assert_allclose(off, distance, atol=EXACT)
            np.testing.assert_allclose(normal, np.array([at.sin, -at.cos, 0.0]), atol=EXACT)


@pytest.mark.parametrize("distance", [0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-3])
def test_a_revolved_profile_is_smooth_on_its_axis(distance):
    solid, radius = Revolved(jw.Graph(Curve(0.2, 2.0, shift=0.37), position=0.1)), 0.25
    exact = Paraboloid(0.2, 2.0).moved((0.47, 0.0, 0.0))
    x = jnp.array([0.47 + 0.6 * distance, 0.2 + 2.0 * distance**2, -0.8 * distance])
    tangent = jnp.array([0.3, 4.0 * distance * (0.3 * 0.6 + 0.5 * 0.8), -0.5])
    (off, normal, bent, change), expected = (along_tangent(surface, x, tangent) for surface in (solid, exact))
    assert abs(off) < SMOOTHED * radius
    np.testing.assert_allclose(normal, expected[1], atol=SMOOTHED)
    # The slope is exact to rounding; the curvature is its ratio to the distance from the axis, at least the core.
    rounding = 1e-16 / (CORE * radius)
    np.testing.assert_allclose(bent, expected[2], atol=4 * rounding)
    np.testing.assert_allclose(change, expected[3], atol=4 * rounding / (CORE * radius))


@pytest.mark.parametrize("make", [Extruded, Revolved])
@pytest.mark.parametrize("profile", [contour(), SEMICIRCLE], ids=["contour", "semicircle"])
def test_above_its_widest_place_the_object_goes_straight_up(make, profile):
    width = 0.5 if profile is not SEMICIRCLE else 1.0
    right, left = jnp.array([width + 0.1, 2.0, 0.0]), jnp.array([-width - 0.2, 3.0, 0.0])
    off, normal, curvature, _ = evaluated(make(profile), right)
    np.testing.assert_allclose(off, 0.1, atol=VERTICAL)
    np.testing.assert_allclose(normal, [1.0, 0.0, 0.0], atol=VERTICAL)
    np.testing.assert_allclose(curvature, np.diag([0.0, 0.0, make is Revolved]) / (width + 0.1), atol=VERTICAL)
    off, normal, _, _ = evaluated(make(profile), left)
    np.testing.assert_allclose([off, *normal], [0.2, -1.0, 0.0, 0.0], atol=VERTICAL)


def test_revolved_profiles_can_be_made_below_jit():
    level = jax.jit(lambda x: Revolved(jw.Graph(Curve(0.2))).level(x))(jnp.array([0.6, 1.2, -0.8]))
    assert abs(level) < EXACT


def _everything(surface, x):
    return surface.level(x), surface.normal(x), surface.curvature(x)


def graph(p):
    return jw.Graph(Curve(p[0], p[1], p[2], p[3]), position=p[4])


MAKERS = {
    "extruded graph": (lambda p: Extruded(graph(p)), [0.2, 1.0, 0.5, 0.2, 0.1]),
    "revolved graph": (lambda p: Revolved(graph(p)), [0.2, 1.0, 0.5, 0.2, 0.1]),
    "revolved contour": (lambda p: Revolved(contour(p[jnp.array([0, 1, 0])], p[3], p[4])), [0.4, 0.5, 0.8, 0.2, 0.1]),
    "tilted graph": (
        lambda p: Extruded(jw.Tilted(graph(p[:5]), p[5], (p[6], p[7]))),
        [0.2, 1.0, 0.5, 0.2, 0.1, 0.3, 0.2, 0.1],
    ),
    "extruded ellipse": (lambda p: Extruded(jw.Ellipse(p[0], p[1], p[2], p[3])), [0.2, 0.9, 0.5, 0.1]),
    "revolved ellipse": (lambda p: Revolved(jw.Ellipse(p[0], p[1], p[2], p[3])), [0.2, 0.5, 0.9, 0.1]),
    "function": (lambda p: Surface(Power(p[0], p[1]), INSIDE), [0.9, 1.3]),
}


@pytest.mark.parametrize(("make", "numbers"), MAKERS.values(), ids=MAKERS)
def test_derivatives_with_respect_to_points_and_parameters(make, numbers):
    numbers, x = jnp.asarray(numbers), jnp.array([0.52, 0.37, 0.23])
    scaled = jax.jit(lambda p, x: _everything(make(p).in_unit(1.7), x / 1.7))
    check_grads(scaled, (numbers, x), order=1, modes=("fwd", "rev"), eps=STEP, atol=DIFFERENCES, rtol=DIFFERENCES)


@pytest.mark.parametrize("make", [Extruded, Revolved])
def test_the_gradient_and_the_hessian_are_derivatives_of_the_level(make):
    form = make(jw.Graph(Curve(0.2, 1.0, 0.5), position=0.1)).in_unit(1.0)

    @jax.jit
    @jax.vmap
    def both(x):
        third, slope = jax.jacfwd(jax.hessian(form.level))(x), jax.jacfwd(form.hessian)(x)
        return (form.gradient(x), form.hessian(x), slope), (jax.grad(form.level)(x), jax.hessian(form.level)(x), third)

    own, derived = both(jnp.array([[0.5, 0.4, 0.2], [-0.3, 0.1, 0.2], [0.2, 0.35, -0.1]]))
    for one, other in zip(own, derived, strict=True):
        np.testing.assert_allclose(one, other, atol=100 * EXACT)


@pytest.mark.parametrize("side", [1, -1])
def test_a_foot_is_on_the_side_of_its_point_of_a_profile_with_unequal_sides(side):
    # At some heights, only one of the sides goes on.
    profile = contour((0.9, 0.5, 0.2))
    for slope in (0.3, 1.0, 1.5):
        at = profile.point(jnp.asarray(side * slope))
        x = jnp.stack([at.x + 3 * at.sin, at.y - 3 * at.cos, jnp.zeros(())])
        np.testing.assert_allclose(evaluated(Extruded(profile), x)[0], 3.0, atol=TABLE)


@pytest.mark.parametrize("make", [Extruded, Revolved])
def test_a_batch_equals_a_loop(make):
    points = jnp.array([[0.5, 0.4, 0.2], [0.1, 0.1, 0.0], [-0.3, 3.0, 0.2], [4.0, -2.0, 7.0]])
    heights = jnp.array([0.1, 0.2, 0.3, 0.4])

    def one(height, x):
        return _everything(make(jw.Graph(Curve(height), position=0.1)).in_unit(1.0), x)

    batch = jax.jit(jax.vmap(one))(heights, points)
    for k in range(len(points)):
        for whole, part in zip(batch, jax.jit(one)(heights[k], points[k]), strict=True):
            np.testing.assert_allclose(whole[k], part, rtol=EXACT, atol=EXACT)


@pytest.mark.parametrize(
    "surface",
    [
        Extruded(jw.Graph(Curve(0.2), position=0.1)),
        Revolved(contour((0.4, 0.5, 0.4))),
        Extruded(jw.Tilted(contour((0.4, 0.5, 0.8)), 0.3, (0.1, 0.2))),
        Surface(Power(), INSIDE),
    ],
    ids=str,
)
def test_another_unit_scales_lengths(surface):
    x = jnp.array([0.5, 0.4, 0.2])
    for one, other in zip(evaluated(surface, x, 1.0), evaluated(surface, x, 2.5), strict=True):
        np.testing.assert_allclose(one, other, rtol=TABLE, atol=TABLE)
    for one, other in zip(
        evaluated(surface, x, 1.0)[:2], evaluated(surface.in_unit(2.5), x / 2.5, 0.4)[:2], strict=True
    ):
        np.testing.assert_allclose(one, other * (2.5 if jnp.ndim(other) == 0 else 1), rtol=TABLE, atol=TABLE)


class Flattening(eqx.Module):
    """A ball, by a function that hardly changes far from it, where its gradient vanishes in float64."""

    radius: float = 0.2

    def __call__(self, x):
        return jnp.exp(-1.0) - jnp.exp(-jnp.sum((x - jnp.array([0.0, 1.0, 0.05])) ** 2) / self.radius**2)


def test_planes_before_a_user_defined_surface_do_not_depend_on_how_its_function_grows():
    centre = np.array([0.0, 1.0, 0.05])
    flat, ball = Surface(Flattening(), tuple(centre)), Sphere(0.2, tuple(centre))
    way = np.random.default_rng(0).normal(size=(20, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    for far in (0.01, 0.1, 0.19, 0.2, 0.21, 0.3, 1.0, 10.0, 1e3):
        points = jnp.asarray(centre + far * way)
        distance, normal = jax.vmap(flat.plane_before)(points)
        np.testing.assert_allclose(distance, far - 0.2, atol=1e-9 * max(1.0, far))
        np.testing.assert_allclose(normal, way, atol=1e-8)
        # That of a quadric is no farther away than the object.
        first_order, same = jax.vmap(ball.plane_before)(points)
        assert np.all(np.asarray(first_order) <= far - 0.2 + EXACT * max(1.0, far))
        np.testing.assert_allclose(same, way, atol=EXACT * 100)
    distance, normal = flat.plane_before(jnp.asarray(centre))
    assert distance < 0 and np.all(np.isfinite(normal))


def test_planes_turn_with_a_surface():
    placed = Ellipsoid((0.1, 0.2, 0.3), INSIDE).rotated((0.3, -0.2, 0.5)).moved((0.1, 0.0, -0.2))
    point = jnp.array([0.5, 0.4, 0.3])
    distance, normal = placed.plane_before(point)
    np.testing.assert_allclose(distance, placed.off(point), rtol=EXACT)
    np.testing.assert_allclose(normal, placed.normal(point), atol=EXACT)


def test_a_user_defined_surface_has_the_derivatives_of_its_function():
    sphere = Surface(lambda x: jnp.sum((x - jnp.array([0.0, 1.2, 0.0])) ** 2) - 0.81, INSIDE)
    exact = Sphere(0.9, INSIDE)
    x = jnp.array([0.5, 0.4, 0.2])
    for one, other in zip(_everything(sphere, x)[1:], _everything(exact, x)[1:], strict=True):
        np.testing.assert_allclose(one, other, atol=EXACT)
    np.testing.assert_allclose(sphere.off(x), exact.off(x), atol=EXACT)


def test_traced_parameters_out_of_their_domain_are_invalid():
    for make in (lambda q: Extruded(jw.Parabola(q)), lambda q: Revolved(jw.Graph(Curve(q)))):
        valid = jax.jit(lambda q, make=make: make(q).valid() & make(jnp.abs(q)).in_unit(1.0).valid())
        assert valid(0.2) and not valid(-0.2) and not valid(np.nan)
    valid = jax.jit(lambda size: Surface(Power(size), INSIDE).valid())
    assert valid(1.0) and not valid(np.nan)
    assert not jax.jit(lambda y: Surface(Power(), (0.0, y, 0.0)).valid())(3.0)
    Surface(Power(), INSIDE)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Extruded(3.0), "`profile` must be a profile such as Parabola or Graph, got 3.0."),
        (
            lambda: Extruded(jw.Polygon([(-1.0, 1.0), (0.0, 0.2), (1.0, 1.0)])),
            "`profile` must be a profile without edges, such as Parabola, Circle, Ellipse, Graph or Contour, ",
        ),
        (
            lambda: Extruded(as_one((jw.Parabola(0.2), jw.Circle(0.2, 0.1, 3.0)))),
            "`profile` must be a single object, got",
        ),
        (lambda: Revolved(jw.Box(0.2, 0.3, 0.4)), "In space, use a RoundedBox, or a Capsule for a peg with an end."),
        (
            lambda: Extruded(jw.Tilted(jw.Box(0.2, 0.3, 0.4), 0.1)),
            "In space, use a RoundedBox, or a Capsule for a peg with an end.",
        ),
        (lambda: Extruded(jw.Cut(jw.Parabola(0.2), -0.3, 0.3)), "In space, use a RoundedBox"),
        (lambda: Extruded(jw.Graph(lambda x: 0.3 + x**2 + 0.1 * jnp.cos(9 * x))), "`profile` must be convex"),
        (lambda: Revolved(jw.Graph(lambda x: 0.3 + x**2 - 0.1 * jnp.cos(9 * x))), "`profile` must be convex"),
        (
            lambda: Revolved(jw.Tilted(jw.Parabola(0.2), 0.3)),
            "`profile` must be symmetric about the vertical axis through its lowest point, got parabola q = 0.2, "
            "tilted by 0.3. Revolve the profile that is not tilted, and turn the surface with `rotated`.",
        ),
        (
            lambda: Revolved(contour((0.4, 0.5, 0.6))),
            "must be symmetric about the vertical axis through its lowest point, got contour q = 0.2, 3 knots.",
        ),
        (lambda: Revolved(jw.Graph(lambda x: 0.2 + x**2 + x**3 / 100)), "`profile` must be symmetric"),
        (lambda: Revolved(jw.Graph(lambda x: 0.2 + x**2 + x**3 / 2)), "`profile` must be symmetric"),
        (lambda: Surface(3.0, INSIDE), "`function` must be a function that is called with one array of shape (3,)"),
        (lambda: Surface(lambda x: x, INSIDE), "which returns an array of shape (3,)"),
        (lambda: Surface(Power(), (0.0, 1.2)), "`inside` must be a tuple of three numbers, got (0.0, 1.2)."),
        (
            lambda: Surface(Power(), (0.0, 3.2, 0.0)),
            "`inside` must be a point at which `function` is negative, got (0, 3.2, 0): 15.",
        ),
    ],
)
def test_errors_name_the_argument(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


@pytest.mark.parametrize(
    "profile",
    [
        jw.Graph(Curve(0.2, 1.0, 0.5, 0.3), position=0.1),
        jw.Graph(lambda x: 0.2 * jnp.sqrt(1 + (x - 0.4) ** 2)),  # never steeper than 0.2
        SEMICIRCLE,
        contour((0.3, 0.5, 0.3), position=0.2),
    ],
    ids=["quartic", "hyperbola", "semicircle", "contour"],
)
def test_symmetric_profiles_can_be_revolved(profile):
    x, y = profile.vertex()
    _, normal, _, _ = evaluated(Revolved(profile), jnp.stack([x, y, jnp.zeros(())]))
    np.testing.assert_allclose(normal, [0.0, -1.0, 0.0], atol=TABLE)


def test_text():
    assert str(Extruded(jw.Parabola(0.2))) == "parabola q = 0.2, extruded along z"
    assert str(Revolved(jw.Circle(0.2, 0.5))) == "circle q = 0.2, r = 0.5, revolved about its axis"
    assert str(Surface(Power(), INSIDE)) == "surface Power(x) = 0"
    assert str(Extruded(contour()).in_unit(1.0)) == "contour q = 0.2, extruded along z"
    assert str(Revolved(contour()).in_unit(1.0)) == "contour q = 0.2, revolved about its axis"
