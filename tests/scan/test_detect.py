"""Second contacts and crossings, against polylines that share no code with the search."""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._base.program import compilations
from jaxwhisker._equilibrium.clearance import DEPTH
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._scan import detect
from jaxwhisker._scan.detect import kinds_of
from operations import operations, traced
from scenes import all_ok, cone, model

BOTH = ("second_contact", "crossing")
FINE = 600  # points of a polyline, whose chords are off by less than 1e-5 L
STEPS = 1  # by which the onset may differ: a gap may pass the tolerance, or shafts may touch, right at a step
CONTROL = np.linspace(1.2, -1.6, 281)
ANGLES = np.linspace(-1.4, 1.4, 141)  # of a drive that rotates
BY_DIFFERENCE = 1e-6  # relative error of central differences of sums of signals; they agree to 3e-8
DENSE = np.linspace(-3.0, 3.0, 120_001)  # abscissae of the object's points


def detecting(scene, *names):
    """The same scene, in which contacts of these names are detected."""
    return jw.Scene(scene.whisker, scene.profile, scene.support, scene.rod, scene.motion, scene.friction, names)


def lines(result):
    shapes = jw.shapes(result, points=FINE)
    return np.stack([np.asarray(shapes.x), np.asarray(shapes.y)], axis=-1)


def depths(result):
    """How deep whiskers that touch a parabola dip into it, per step: distance from the tangent at the nearest point."""
    profile, found = result.scene.profile, []
    slope = 2 * profile.a * DENSE
    normal = np.stack([slope, -np.ones_like(slope)], axis=-1) / np.sqrt(1 + slope**2)[:, None]
    outline = np.stack([DENSE, profile.distance + profile.a * DENSE**2], axis=-1)
    for shapes, phases in zip(lines(result), np.asarray(result.phase), strict=True):
        inside = [line[line[:, 1] > profile.distance + profile.a * line[:, 0] ** 2] for line in shapes[phases > 0]]
        points = np.concatenate([*inside, np.zeros((0, 2))])
        near = np.clip(np.searchsorted(DENSE, points[:, 0])[:, None] + np.arange(-6000, 6000, 8), 0, DENSE.size - 1)
        distance = np.linalg.norm(outline[near] - points[:, None], axis=-1)
        nearest = np.take_along_axis(near, distance.argmin(axis=1)[:, None], axis=1)[:, 0]
        found.append(np.max(np.sum(normal[nearest] * (outline[nearest] - points), axis=-1), initial=0.0))
    return np.array(found)


def crosses(first, second):
    """Whether two polylines cross."""
    a, b = first[1:] - first[:-1], second[1:] - second[:-1]

    def cross(u, v):
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    apart = second[None, :-1] - first[:-1, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t, r = (cross(apart, other) / cross(a[:, None], b[None]) for other in (b[None], a[:, None]))
    return bool(np.any((t >= 0) & (t <= 1) & (r >= 0) & (r <= 1)))


def first(flags):
    """Index of the first step at which a flag is set; their number if there is none."""
    return int(np.argmax(flags)) if np.any(flags) else len(flags)


def bent(base, tip, profile, ratio=1.0):
    """A whisker whose intrinsic curvature changes linearly from base to tip."""
    return jw.Scene(cone(ratio, curvature=(base, tip)), profile, jw.Support.fb(70.0))


MEETING = {
    "leans away, then over the object": (bent(-1.5, 2.5, jw.Parabola(0.2, 2.0)), 0.06),
    "with its base, a sharp object": (bent(-1.5, 2.5, jw.Parabola(0.2, 10.0)), 0.1),
    "with its end, curved more than the object": (bent(0.6, 0.6, jw.Parabola(0.2, 1.0), 0.25), 0.005),
}
CLEAR = {
    "curved away": bent(-1.5, -0.5, jw.Parabola(0.2, 2.0)),
    "curved less than the object": bent(0.2, 0.2, jw.Parabola(0.2, 1.0), 0.25),
}


@pytest.mark.parametrize("name", MEETING)
def test_a_second_contact_ends_the_scan_where_a_polyline_dips_into_the_object(name):
    scene, deepest = MEETING[name]
    plain, result = jw.scan(detecting(scene), CONTROL), jw.scan(scene, CONTROL)
    assert all_ok(plain)
    depth = depths(plain)
    assert depth.max() > deepest
    onset, found = first(depth > DEPTH), first(np.asarray(result.status) != jw.Status.ok)
    assert abs(onset - found) <= STEPS
    # Before the contact nothing changes; after it, nothing is known, even where the shaft is clear again.
    assert np.all(np.asarray(result.status)[found:] == jw.Status.second_contact)
    np.testing.assert_array_equal(result.mz[:found], plain.mz[:found])
    assert np.all(np.isnan(result.mz[found:])) and np.all(result.phase[found:] == jw.Phase.free)
    assert all(event.control > CONTROL[min(found, CONTROL.size - 1)] - 0.01 for event in result.events)
    assert 0 < len(result.events) < len(plain.events)


@pytest.mark.parametrize("name", CLEAR)
def test_clear_shafts_are_not_reported(name):
    plain, result = jw.scan(detecting(CLEAR[name]), CONTROL), jw.scan(CLEAR[name], CONTROL)
    assert depths(plain).max() < DEPTH and np.any(np.asarray(plain.phase) == jw.Phase.tangential)
    assert all_ok(result)
    np.testing.assert_array_equal(result.mz, plain.mz)


def inside_polygon(result):
    """How deep the polyline of a whisker is inside a polygon, per step; negative outside."""
    corners = np.asarray(result.scene.profile.vertices)
    x, y = (np.roll(corners, -1, axis=0) - corners).T
    normal = np.stack([y, -x], axis=1) / np.hypot(x, y)[:, None]
    line = lines(result)[:, 0]
    return np.max(-np.max(np.sum((line[:, :, None] - corners) * normal, axis=-1), axis=-1), axis=-1)


@pytest.mark.parametrize(("curvature", "low", "width"), [(1.1, 0.43, 0.4), (0.79, 0.31, 0.6), (0.58, 0.35, 0.45)])
def test_curved_whiskers_meet_polygons_again_where_a_polyline_is_inside(curvature, low, width):
    # Such whiskers cross the line of a face that they are far from, which is no contact.
    corners = [(-width / 2 - 0.1, low + 0.4), (0.0, low), (width / 2, low + 0.3)]
    scene = jw.Scene(jw.Whisker(intrinsic_curvature=curvature), jw.Polygon(corners), jw.Support.fb(70.0))
    plain, result = jw.scan(detecting(scene), CONTROL), jw.scan(scene, CONTROL)
    onset, found = first(inside_polygon(plain) > DEPTH), first(np.asarray(result.status) != jw.Status.ok)
    assert found > first(np.asarray(result.phase)[:, 0] != jw.Phase.free) + 20
    assert abs(onset - found) <= STEPS
    assert found == CONTROL.size or result.status[found] == jw.Status.second_contact


def test_the_onset_does_not_depend_on_the_control():
    # The search follows the path: it finds a contact between two steps, and one before the first step.
    scene, _ = MEETING["leans away, then over the object"]
    scene = detecting(scene, "second_contact")
    onset = CONTROL[first(np.asarray(jw.scan(scene, CONTROL).status))]
    few = np.array([1.2, onset + 0.02, onset - 0.02, -1.5])
    assert list(jw.scan(scene, few).status) == [0, 0, *[jw.Status.second_contact] * 2]
    assert list(jw.scan(scene, np.array([-0.2, -0.3])).status) == [jw.Status.second_contact] * 2


def test_scans_towards_the_right_are_mirror_images():
    scene, _ = MEETING["leans away, then over the object"]
    scene = jw.Scene(scene.whisker, scene.profile, jw.Support.fb(70.0, 0.0), detect="second_contact")
    mirrored = jw.Scene(
        cone(1.0, curvature=(1.5, -2.5)), scene.profile, scene.support, motion=jw.Translation(1), detect=scene.detect
    )
    status = jw.scan(scene, CONTROL).status
    assert np.any(status) and abs(first(status) - first(jw.scan(mirrored, -CONTROL).status)) <= STEPS


def test_uniform_straight_whiskers_stay_on_one_side_of_the_tangent():
    # This is why no search for second contacts is made for them, even on supports that turn.
    turning = jw.Scene(jw.Whisker(), jw.Parabola(0.15, 8.0), jw.Support.follicle(x=30.0, y=300.0, phi=2.0))
    for scene in (model("FB", distance=0.05), turning):
        assert kinds_of(detecting(scene, *BOTH)) == ()
        result = jw.scan(scene, np.linspace(1.2, -1.6, 113))
        touching = np.asarray(result.phase)[:, 0] > 0
        line = lines(result)[touching, 0]
        at = np.stack([result.contact_x[touching, 0], result.contact_y[touching, 0]], axis=-1)
        slope = np.asarray(result.contact_slope)[touching, 0]
        normal = np.stack([np.sin(slope), -np.cos(slope)], axis=-1)
        outside = np.einsum("spk,sk->sp", line - at[:, None], normal)
        assert touching.sum() > 20 and np.min(outside) > -1e-8


@pytest.mark.parametrize(
    ("name", "rest_length", "crossing"),
    [("FBFBR", 0.2, True), ("FBFBR", 0.05, True), ("FBFBR", 1.0, False), ("FBFBFBR", 0.2, True)],
)
def test_a_crossing_ends_the_scan_where_polylines_cross(name, rest_length, crossing):
    # With a rest length of 0.05, the tips pass within 0.002 L of each other on the object before the shafts cross.
    scene = model(name, rest_length=rest_length)
    plain, result = jw.scan(scene, CONTROL), jw.scan(detecting(scene, *BOTH), CONTROL)
    assert all_ok(plain)
    crossed = [any(crosses(a, b) for a, b in combinations(shapes, 2)) for shapes in lines(plain)]
    onset, status = first(crossed), np.asarray(result.status)
    assert (onset < CONTROL.size) == crossing
    assert abs(first(status) - onset) <= STEPS
    assert np.all(status[first(status) :] == jw.Status.crossing)
    np.testing.assert_array_equal(result.mz[: first(status)], plain.mz[: first(status)])


def test_the_onset_is_located_within_a_step_of_the_path():
    scene = model("FBFBR")
    control = np.append(1.2, np.linspace(0.185, 0.175, 101))
    plain, result = jw.scan(scene, control), jw.scan(detecting(scene, *BOTH), control)
    onset = first([crosses(*shapes) for shapes in lines(plain)])
    assert 10 < onset < 90 and abs(first(np.asarray(result.status)) - onset) <= STEPS


def test_whiskers_with_one_base_cross_from_the_start():
    scene = detecting(model("FBFBR", rest_length=0.0), "crossing")
    assert np.all(jw.scan(scene, CONTROL).status == jw.Status.crossing)


def test_bases_that_have_changed_places_are_a_crossing():
    # A snap may lead there without a state in which shafts cross.
    problem = dimensionless(detecting(model("FBFBR"), "crossing"))
    upright = ContactState(jnp.zeros(2, int), jnp.ones(2))
    point = Point(jnp.zeros((2, 3)), jnp.asarray(0.9))
    shafts = detect._shafts(problem, point, upright, ("crossing",))
    assert not detect._any_cross(problem, point, shafts)
    assert detect._any_cross(problem, point, jax.tree.map(lambda leaf: leaf[::-1], shafts))


def test_the_film_of_the_readme_shows_a_crossing():
    result = jw.scan(detecting(model("FBFBR"), "crossing"))
    assert 0 < first(result.status) < result.status.size and "crossing" in str(result)


def test_nothing_is_searched_for_that_cannot_happen():
    scene = jax.tree.map(jnp.asarray, model("FBFBR"))

    def scanned(scene):
        return jw.scan(scene, CONTROL[:64]).mz

    plain, searching = (operations(traced(scanned, s)) for s in (scene, detecting(scene, "crossing")))
    assert kinds_of(scene) == () and searching > plain
    # What cannot happen is not searched for: a single whisker does not cross another one.
    single = jax.tree.map(jnp.asarray, model("FB"))
    assert operations(traced(scanned, single)) == operations(traced(scanned, detecting(single, *BOTH)))


def test_the_search_is_a_program_of_its_own():
    # It shares all programs of a scan with scenes that detect nothing.
    scene = model("FBFBR")
    jw.scan(scene, CONTROL)
    known = compilations()
    jw.scan(detecting(scene, "crossing"), CONTROL)
    assert compilations() <= known + 1


def test_derivatives_and_transformations_are_those_of_plain_scans():
    control = jnp.array([0.6, 0.4, 0.25, 0.0])

    def signals(distance, detect):
        result = jw.scan(detecting(model("FBFBR", distance=distance), *detect), control)
        return result.mz, result.status

    def slope(distance, detect, jacobian=jax.jacfwd):
        return jacobian(lambda distance: signals(distance, detect)[0])(distance)

    (mz, status), plain = signals(0.2, BOTH), signals(0.2, ())[0]
    assert list(status) == [0, 0, 0, jw.Status.crossing]
    np.testing.assert_array_equal(mz[:3], plain[:3])
    np.testing.assert_allclose(slope(0.2, BOTH)[:3], slope(0.2, ())[:3], rtol=1e-12)
    assert np.all(slope(0.2, BOTH)[3] == 0)
    np.testing.assert_allclose(slope(0.2, BOTH, jax.jacrev), slope(0.2, BOTH), rtol=1e-12)
    # One lane of a batch crosses, the other does not reach the object; a jit gives the same.
    many = jax.vmap(lambda distance: signals(distance, BOTH))(jnp.array([0.2, 2.0]))
    np.testing.assert_allclose(many[0][0], mz, rtol=1e-9)
    np.testing.assert_array_equal(many[1], [status, np.zeros(4)])
    staged = jax.jit(lambda distance: signals(distance, BOTH))(jnp.asarray(0.2))
    np.testing.assert_allclose(staged[0], mz, rtol=1e-9)
    np.testing.assert_array_equal(staged[1], status)


def rotating(scene, distance, radius, *names):
    """A scene whose drive rotates about a pivot at height -1."""
    profile = jw.Parabola(distance, scene.profile.a)
    return jw.Scene(scene.whisker, profile, scene.support, motion=jw.Rotation((0.0, -1.0), radius), detect=names)


# The second whisker is so short that it is still free, and turns with the drive, when the first one crosses it.
SHORT = jw.Scene((jw.Whisker(), jw.Whisker(0.7)), jw.Parabola(0.3), jw.Support.fbfbr(70.0, 0.1))


@pytest.mark.parametrize(
    ("name", "scene"),
    [("second_contact", MEETING["with its base, a sharp object"][0]), ("crossing", SHORT)],
    ids=BOTH,
)
def test_a_drive_that_rotates_and_derivatives_backwards(name, scene):
    at = (scene.profile.distance, 1.0)

    def signal(distance, radius):
        return jw.scan(rotating(scene, distance, radius, *BOTH), ANGLES).mz[:, 0]

    plain, result = jw.scan(rotating(scene, *at), ANGLES), jw.scan(rotating(scene, *at, *BOTH), ANGLES)
    assert all_ok(plain)
    bad = depths(plain) > DEPTH if name == "second_contact" else [crosses(*shapes) for shapes in lines(plain)]
    found = first(np.asarray(result.status))
    assert 20 < found < ANGLES.size and abs(found - first(bad)) <= STEPS
    assert np.all(np.asarray(result.status)[found:] == jw.Status[name])

    # The steps that failed hold NaN and contribute nothing to a gradient, with any weight.
    mz, backwards = jax.vjp(signal, *at)
    gradient = np.array(backwards(np.ones(ANGLES.size)))
    np.testing.assert_array_equal(mz[:found], plain.mz[:found, 0])
    forwards = jax.jacfwd(signal, argnums=(0, 1))(*at)
    np.testing.assert_allclose(gradient, [np.sum(slope) for slope in forwards], rtol=1e-10)
    for k, slope in enumerate(gradient):
        there, here = (signal(*(x + h * (i == k) for i, x in enumerate(at))) for h in (1e-4, -1e-4))
        np.testing.assert_allclose(slope, np.sum(there[:found] - here[:found]) / 2e-4, rtol=BY_DIFFERENCE)


@pytest.mark.unchecked
@pytest.mark.parametrize("wrong", ["touch", ("crossing", "touch"), 1, [["crossing"]]])
def test_unknown_names_are_rejected(wrong):
    with pytest.raises(ValueError, match=r"`detect` must be 'second_contact' or 'crossing', or a tuple .* got"):
        jw.Scene(jw.Whisker(), jw.Parabola(0.2), detect=wrong)


def test_the_order_of_names_does_not_matter():
    one, other = (jw.Scene(jw.Whisker(), jw.Parabola(0.2), detect=names) for names in (BOTH, BOTH[::-1]))
    assert jax.tree.structure(one) == jax.tree.structure(other)
    assert str(one).endswith(", detects second contact and crossing")
    assert jw.Scene(jw.Whisker(), jw.Parabola(0.2), detect="crossing").detect == ("crossing",)


def test_curved_whiskers_do_not_pass_into_smooth_objects_by_default():
    scene = jw.Scene(
        jw.Whisker(intrinsic_curvature=0.992381450543045),
        jw.Parabola(0.11704241159057474, 1.044896713171311),
        jw.Support.fb(129.65262162807937, 0.2),
    )
    control = np.linspace(1.9, -2.7, 240)
    plain, result = jw.scan(detecting(scene), control), jw.scan(scene, control)
    depth = depths(plain)
    assert all_ok(plain) and depth.max() > 0.07
    assert abs(first(depth > DEPTH) - first(np.asarray(result.status))) <= STEPS
    assert set(np.unique(result.status)) == {jw.Status.ok, jw.Status.second_contact}


@pytest.mark.parametrize(
    ("whisker", "searched"),
    [
        (jw.Whisker(), False),
        (jw.Whisker.conical(1.0, 1.0, 0.02, 0.005), False),
        (jw.Whisker.conical(1.0, 1.0, 0.005, 0.02), True),
        (jw.Whisker(bending_stiffness=lambda s: 1 - s / 2), True),
        (jw.Whisker(intrinsic_curvature=0.0), True),
    ],
)
def test_second_contacts_are_searched_for_where_they_may_occur(whisker, searched):
    assert (kinds_of(jw.Scene(whisker, jw.Parabola(0.2))) == ("second_contact",)) == searched
