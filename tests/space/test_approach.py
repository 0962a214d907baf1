"""Where scans in space begin and end."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._scan.scan import default_control
from jaxwhisker._space.approach import REACH, limits_of
from jaxwhisker._space.stance import clearance

WHOLE = jnp.asarray(jnp.nan)
TOUCH = 1e-7  # the values are rounded to as many digits


@pytest.mark.parametrize(
    "body",
    [jw.Sphere(1.0, (5.0, 1.3, -1.0)), jw.Ellipsoid((3.0, 0.4, 0.4), (0.0, 1.2, 0.1)), jw.Paraboloid(0.4, 0.05, 1.0)],
)
def test_a_scan_along_a_line_begins_free_and_ends_where_no_whisker_reaches(body):
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), body, motion=jw.LinearDrive((-1.0, 0.1, 0.2))))
    start, _, far, _ = limits_of(problem, WHOLE)
    assert clearance(problem, start) > 0
    assert clearance(problem, start) > clearance(problem, start + 1e-3)
    assert clearance(problem, far) > REACH
    middle = -(body.interior_point() @ np.array([1.0, -0.1, -0.2])) / np.sqrt(1.05)
    assert start < middle < far


def test_a_scan_that_begins_in_contact_is_approached_from_where_the_whisker_is_free():
    problem = dimensionless(
        jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1, 0, 0)))
    )
    start, *_ = limits_of(problem, jnp.asarray(-0.2))
    assert start < -0.9
    assert clearance(problem, start) > 0


def test_a_rotation_begins_and_ends_at_its_own_controls():
    drive = jw.WhiskDrive(start=0.8, stop=-0.5)
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(0.3, (0.0, 0.7, 0.2)), motion=drive))
    np.testing.assert_allclose(jnp.stack(limits_of(problem, WHOLE)[:3]), [0.8, -0.5, -0.5])
    np.testing.assert_allclose(jnp.stack(limits_of(problem, jnp.asarray(0.2))[:3]), [0.8, -0.5, -0.5])
    np.testing.assert_allclose(jnp.stack(limits_of(problem, jnp.asarray(1.1))[:3]), [1.1, -0.5, -0.5])


def lean(angle):
    return jw.Support(mount=jw.Mount(angle=angle))


PASSING = {
    "a leaning whisker, a small ball": (
        jw.Scene(jw.Whisker(), jw.Sphere(0.1, (0, 0.85, 0.02)), lean(0.4)),
        {"touch": 0.4657511, "release": 0.2529974},
    ),
    "a leaning whisker, an ellipsoid": (
        jw.Scene(jw.Whisker(), jw.Ellipsoid((0.1, 0.15, 0.3), (0, 0.9, 0.05)), lean(0.4)),
        {"touch": 0.4870149},
    ),
}


@pytest.mark.parametrize("name", PASSING)
def test_whiskers_that_lean_towards_the_motion_do_not_begin_beyond_the_object(name):
    scene, events = PASSING[name]
    result = jw.scan(scene)
    assert np.all(result.status == jw.Status.ok)
    for kind, control in events.items():
        assert result.events.of(jw.EventKind[kind])[0].control == pytest.approx(control, abs=TOUCH)


@pytest.mark.parametrize(
    ("scene", "touch"),
    [
        (
            jw.Scene(jw.Whisker(0.06, 2.5e-5, intrinsic_curvature=6.67), jw.Cylinder(0.006, (0, 0.05, 0), (0, 0, 1))),
            0.014964242 / 0.06,
        ),
        (
            jw.Scene(
                jw.Whisker(),
                jw.Sphere(0.1, (0, 0.9, 0.02)),
                jw.Support(
                    tuple(jw.Spring((0, k), 50.0, axis=axis) for k in (1, 2) for axis in "xyz"),
                    (jw.Mount(), jw.Mount(0.4)),
                ),
            ),
            0.09797959,
        ),
    ],
)
def test_scans_begin_before_the_first_touch_of_any_whisker(scene, touch):
    # The first whisker of the network stands beyond the object where the middle of the bases is beside it.
    problem = dimensionless(scene)
    start, *_ = limits_of(problem, WHOLE)
    assert problem.onwards * (start - touch) < 0
    before = np.linspace(start, touch - 1e-6 * problem.onwards, 200)
    assert min(float(clearance(problem, u)) for u in before[::20]) > 0


@pytest.mark.parametrize(("radius", "touch"), [(1e-4, 0.000103078), (1e-6, 1.031e-6)])
def test_thin_oblique_pegs_are_touched_on_the_near_side(radius, touch):
    scene = jw.Scene(jw.Whisker(), jw.Cylinder(radius, (0, 0.6, 0), (0.25, 0, 1)))
    result = jw.scan(scene, np.linspace(0.3, -1.0, 66))
    assert np.all(result.status == jw.Status.ok)
    assert result.events[0].control == pytest.approx(touch, rel=1e-3)
    # In the plane normal to the peg, a straight whisker is in the plane of its force: nothing but the way differs.
    cosine = 1 / np.hypot(1.0, 0.25)
    plane = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.6 - radius, radius)), np.linspace(0.3, -1.0, 66) * cosine)
    force = np.sqrt(np.asarray(result.fx) ** 2 + np.asarray(result.fz) ** 2)
    np.testing.assert_allclose(force, np.abs(plane.fx), atol=1e-6 * np.max(force))
    np.testing.assert_allclose(result.fy, plane.fy, atol=1e-6 * np.max(force))


def test_thinner_pegs_are_refused():
    thin = jw.Scene(jw.Whisker(0.05), jw.Cylinder(1e-8, (0, 0.03, 0), (0, 0, 1)))
    with pytest.raises(ValueError, match=r"`surface` must be thicker than .* of a whisker's length \(0\.05\)"):
        jw.scan(thin, np.array([0.01, -0.01]))
    assert not dimensionless(thin).valid


@pytest.mark.filterwarnings("default")
def test_a_default_scan_that_touches_nothing_warns():
    with pytest.warns(UserWarning, match="The scan touches nothing: .*sphere r = 0.1"):
        jw.scan(jw.Scene(jw.Whisker(), jw.Sphere(0.1, (0.0, 0.9, 3.0))))


def ring_level(x):
    """The ring with its axis along z, and its centre at (0, 0.8, 0)."""
    off_circle = jnp.sqrt(x[0] ** 2 + (x[1] - 0.8) ** 2 + 1e-12) - 0.4
    return off_circle**2 + x[2] ** 2 - 0.01


def ball_level(x):
    return jnp.sum((x - jnp.array([30.0, 1.0, 0.1])) ** 2) - 400.0


def waves(height):
    return lambda x: height + 0.05 * jnp.sin(6 * x[0]) * jnp.cos(5 * x[2]) - x[1]


def user_problem(level, inside, contacts=2):
    return dimensionless(jw.Scene(jw.Whisker(), jw.Surface(level, inside, convex=False), contacts=contacts))


limits_now = jax.jit(limits_of)


@pytest.mark.parametrize(
    ("level", "inside", "first", "last"),
    [
        (ring_level, (0.4, 0.8, 0.0), 0.5, -0.5),
        (ball_level, (30.0, 1.0, 0.1), 50.0, 10.0),  # forty lengths across
    ],
    ids=["ring", "ball"],
)
def test_scans_past_a_user_defined_object_begin_and_end_near_it(level, inside, first, last):
    problem = user_problem(level, inside)
    limits = limits_now(problem, WHOLE)
    assert limits.known
    # Places away from the middle of the object are ever farther apart, by a tenth of their distance.
    middle = (first + last) / 2
    assert first < limits.start < first + 0.1 + 0.25 * (first - middle)
    assert REACH < last - limits.far < 4 * REACH
    assert clearance(problem, limits.start) > 0 and clearance(problem, limits.far) > REACH


def test_scans_before_a_wall_with_waves_begin_on_its_free_side():
    problem = user_problem(lambda x: x[0] + 0.6 + 0.05 * jnp.sin(6 * x[1]) - 0.3 * x[1], (-3.0, 0.5, 0.1))
    limits = limits_now(problem, WHOLE)
    assert limits.known and -0.3 < limits.start < 0.3


@pytest.mark.parametrize("height", [0.9, 1.2], ids=["within reach", "just out of reach"])
def test_an_object_without_an_end_along_the_drive_has_no_known_start(height):
    assert not limits_now(user_problem(waves(height), (0.0, 3.0, 0.0)), WHOLE).known


def test_in_a_hollow_a_scan_starts_at_its_first_position():
    problem = user_problem(ring_level, (0.4, 0.8, 0.0), contacts=1)
    assert limits_now(problem, jnp.asarray(0.0)).start > 0.5  # the shaft would run through the tube
    around = dimensionless(jw.Scene(jw.Whisker(), jw.Torus(2.0, 0.1, (0.0, 0.5, 0.0))))
    for start in (0.5, -1.5):
        assert limits_now(around, jnp.asarray(start)).start == start
    assert limits_now(around, WHOLE).start > 2.0


def test_right_across_an_object_without_an_end_a_control_must_be_given():
    scene = jw.Scene(jw.Whisker(), jw.Plane((0.0, 0.9, 0.0), (0.0, -1.0, 0.0)))
    with pytest.raises(ValueError, match="`control` must be given for this scene: however far the drive moves back"):
        jw.scan(scene)
    with pytest.raises(ValueError, match="`control` must be given"):
        default_control(scene)
    assert np.all(np.asarray(jw.scan(scene, [0.3, 0.0]).status) == jw.Status.lost)
