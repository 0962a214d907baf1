"""Several objects: each alone, one after the other, from one to the next, and laws where they come close or overlap."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker._equilibrium.clearance import DEPTH
from jaxwhisker._scan.detect import kinds_of
from scenes import all_ok, event_list, follicle, in_both_modes

SAME = 1e-9  # two computations of the same state
DIFFERENCE, DIFFERENCES = 1e-6, 1e-6  # step and error of central differences
MODES = 1e-9  # forward against reverse mode, relative to the sum of sizes
ROUNDING = 1e-12  # of a force that has just begun
INTEGRATED = 1e-5  # distance of a polyline from an object: its own error, half of the depth at which a scan ends
SIGNALS = ("fx", "fy", "mz", "contact_force", "contact_x", "contact_y", "contact_arc")

CIRCLE, BOX = jw.Circle(0.3, 0.3), jw.Box(0.25, 0.4, 0.5, -3.0)
FIRST, SECOND = jw.Circle(0.3, 0.2), jw.Circle(0.35, 0.25, -3.0)
ACROSS = np.linspace(0.9, -5.5, 161)
APART = {
    "clamped": (jw.Support.clamped(), FIRST, SECOND, {}),
    "FB": (jw.Support.fb(70.0, 0.2), CIRCLE, BOX, {}),
    "network": (jw.Support.fbfb(70.0, 0.2), CIRCLE, BOX, {}),
    "follicle": (follicle(x=70.0, y=500.0, phi=50.0), FIRST, SECOND, {}),
    "friction": (jw.Support.fb(70.0, 0.2), FIRST, SECOND, {"friction": 0.3}),
}


def scene(profile, support=None, **fields):
    return jw.Scene(jw.Whisker(), profile, support or jw.Support.clamped(), **fields)


def at(x):
    """The second object at another place."""
    return jw.Circle(SECOND.distance, SECOND.radius, x)


@cache
def scanned(name):
    """Scans before both objects, and before each alone."""
    support, one, other, fields = APART[name]
    return [jw.scan(scene(profile, support, **fields), ACROSS) for profile in ((one, other), one, other)]


def in_order(events):
    """Events along the scan; those at the same place by name."""
    return sorted(events, key=lambda event: (-round(event[2], 8), event[0]))


@pytest.mark.parametrize("name", APART)
def test_objects_far_apart_give_the_signals_of_each_alone(name):
    both, *alone = scanned(name)
    assert all(map(all_ok, (both, *alone)))
    for field in SIGNALS:
        sums = sum(np.asarray(getattr(result, field)) for result in alone)
        np.testing.assert_allclose(getattr(both, field), sums, rtol=SAME, atol=SAME)
    numbers = sum(k * (np.asarray(result.phase) > 0) for k, result in enumerate(alone, 1))
    np.testing.assert_array_equal(both.contact_object, numbers)
    assert {1, 2} <= set(np.unique(numbers))
    together, *apart = [event_list(result) for result in (both, *alone)]
    together, apart = in_order(together), in_order(apart[0] + apart[1])
    assert [event[:2] for event in together] == [event[:2] for event in apart]
    np.testing.assert_allclose([event[2] for event in together], [event[2] for event in apart], atol=SAME)


def test_a_drive_that_turns_between_the_objects_goes_back_past_the_first_one():
    there = np.linspace(0.9, -1.8, 40)
    control = np.concatenate([there, there[::-1], there[:20]])
    both, alone = (jw.scan(scene(profile), control) for profile in ((FIRST, SECOND), FIRST))
    assert all_ok(both) and np.sum(np.diff(np.asarray(both.phase)[:, 0] > 0)) == 5
    np.testing.assert_array_equal(both.mz, alone.mz)


def test_a_drive_that_turns_beyond_both_objects_goes_back_past_them():
    control = np.concatenate([ACROSS, ACROSS[::-1]])
    both, *alone = (jw.scan(scene(profile), control) for profile in ((FIRST, SECOND), FIRST, SECOND))
    assert all_ok(both)
    np.testing.assert_allclose(both.mz, sum(result.mz for result in alone), atol=SAME)


def test_a_whisker_that_snaps_off_one_object_may_land_on_the_next():
    # A clamped whisker is where the drive is. After it has snapped off, it is where it had been without the first
    # object: bent to the right by the second one.
    control = np.linspace(0.6, -2.2, 141)
    both, first, second = (jw.scan(scene(some), control) for some in ((FIRST, at(-1.0)), FIRST, at(-1.0)))
    on = np.asarray(both.contact_object)[:, 0]
    lands = np.argmax(on == 2)
    assert all_ok(both) and on[lands - 1] == 1 and second.phase[lands - 1] != jw.Phase.free
    np.testing.assert_allclose(both.mz[:lands], first.mz[:lands], atol=SAME)
    np.testing.assert_allclose(both.mz[lands:], second.mz[lands:], atol=SAME)
    kinds = [event.kind.name for event in both.events]
    assert kinds.count("snap_through") == 1 and kinds.count("touch") == 1
    [snap] = [event.control for event in both.events if event.kind == jw.EventKind.snap_through]
    [alone] = [event.control for event in first.events if event.kind == jw.EventKind.snap_off]
    assert abs(snap - alone) < SAME


def test_whiskers_may_touch_different_objects_at_the_same_time():
    # Rigid springs: each whisker is clamped, 1.2 behind the one before.
    support = jw.Support.fbfb(np.inf, (0.0, 1.2))
    box = jw.Box(BOX.distance, BOX.width, BOX.height, -1.3)
    control = np.linspace(0.5, -3.2, 112)
    both = jw.scan(scene((CIRCLE, box), support), control)
    assert all_ok(both) and np.sum(np.all(np.asarray(both.contact_object) == [2, 1], axis=1)) > 10
    for whisker, behind in enumerate((0.0, 1.2)):
        single = jw.scan(scene((CIRCLE, box), jw.Support.fb(np.inf, behind)), control)
        np.testing.assert_allclose(both.mz[:, whisker], single.mz[:, 0], atol=SAME)


class Moments:
    """Weighted sum of the moments, by the position of the second object, its distance and the first one's radius."""

    def __init__(self, control):
        self.control = control

    def __call__(self, p):
        objects = jw.Circle(FIRST.distance, p[2]), jw.Circle(p[1], SECOND.radius, p[0])
        return jw.scan(scene(objects), self.control).mz[:, 0]


def test_derivatives_by_the_numbers_of_each_object():
    control = np.array([0.0, -0.4, -0.8, -1.5, -2.8, -3.3, -3.6])
    moments, p = Moments(control), np.array([-3.0, 0.35, 0.2])
    slopes = np.asarray(jax.jacfwd(moments)(p))
    steps = DIFFERENCE * np.eye(3)
    differences = np.stack([(moments(p + d) - moments(p - d)) / (2 * DIFFERENCE) for d in steps], axis=1)
    np.testing.assert_allclose(slopes, differences, rtol=DIFFERENCES, atol=DIFFERENCES)
    # Before it touches the second object, the whisker does not know of it, and then it forgets the first.
    assert np.all(slopes[:4, :2] == 0) and np.all(slopes[4:, 2] == 0)
    assert np.all(slopes[:3, 2] != 0) and np.all(slopes[4:, :2] != 0)
    value, along, weights = in_both_modes(moments, np.ones(3))(p, np.ones(7))
    np.testing.assert_allclose(np.sum(along), np.sum(weights), rtol=MODES)
    np.testing.assert_allclose(weights, slopes.sum(axis=0), rtol=SAME)
    assert np.all(np.isfinite(value))


def polylines(result, points=400):
    """Centre lines (..., steps, points, 2) of clamped whiskers, by Runge and Kutta's method from the base."""
    fx, fy, x1, y1, s1, x = (np.asarray(getattr(result, name))[..., 0] for name in ("fx", "fy", *SIGNALS[4:], "base_x"))
    s1 = np.where(np.asarray(result.phase)[..., 0] == jw.Phase.free, 0.0, s1)

    def rate(s, state):
        x, y, angle = state
        bend = np.where(s < s1, -(x1 - x) * fy + (y1 - y) * fx, 0.0)
        return np.stack([np.cos(angle), np.sin(angle), bend])

    state, size = np.stack([x, 0 * x, 0 * x + np.pi / 2]), 1 / points
    lines = [state[:2]]
    for s in np.arange(points) / points:
        a = rate(s, state)
        b = rate(s + size / 2, state + size / 2 * a)
        c = rate(s + size / 2, state + size / 2 * b)
        d = rate(s + size * (1 - 1e-9), state + size * c)
        state = state + size / 6 * (a + 2 * b + 2 * c + d)
        lines.append(state[:2])
    return np.moveaxis(np.stack(lines), (0, 1), (-2, -1))


def clearance(lines, circle, x):
    """Distances of lines from a circle at x, negative inside."""
    y = circle.distance + circle.radius
    return np.min(np.hypot(lines[..., 0] - np.asarray(x)[..., None], lines[..., 1] - y), axis=-1) - circle.radius


PLACES = np.linspace(-1.4, 0.6, 81)  # of the second object: apart, close, overlapping, and behind


@cache
def swept():
    control = np.linspace(0.9, -2.4, 133)
    return jax.vmap(lambda x: jw.scan(scene((FIRST, at(x))), control))(jnp.asarray(PLACES))


def test_no_whisker_enters_an_object_however_close_they_are():
    result = swept()
    ok, on = np.asarray(result.status) == jw.Status.ok, np.asarray(result.contact_object)[..., 0]
    assert set(np.unique(np.asarray(result.status))) <= {jw.Status.ok, jw.Status.second_contact, jw.Status.unsettled}
    lines = polylines(result)
    for number, circle, x in ((1, FIRST, 0.0), (2, SECOND, PLACES[:, None])):
        gaps = clearance(lines, circle, x)
        assert np.min(gaps[ok]) > -DEPTH - INTEGRATED
        assert np.max(np.abs(gaps[ok & (on == number)])) < INTEGRATED
    assert np.min(np.asarray(result.contact_force)[ok]) > -ROUNDING
    assert np.mean(ok) > 0.5 and np.sum(np.any(on == 1, axis=1) & np.any(on == 2, axis=1) & np.all(ok, axis=1)) > 10


def test_no_whisker_passes_an_object_without_touching_it():
    # The side of the object's lowest point on which the shaft is, where it is high enough.
    result = swept()
    ok, on = np.asarray(result.status) == jw.Status.ok, np.asarray(result.contact_object)[..., 0]
    lines, found = polylines(result), 0
    for number, circle, x0 in ((1, FIRST, 0.0), (2, SECOND, PLACES[:, None])):
        high = lines[..., 1] >= circle.distance
        x = np.take_along_axis(lines[..., 0], np.argmax(high, axis=-1)[..., None], axis=-1)[..., 0]
        side = np.where(ok & np.any(high, axis=-1), np.sign(x - x0), 0)
        passes = side[:, 1:] * side[:, :-1] < 0
        assert np.all((on[:, 1:] == number)[passes] | (on[:, :-1] == number)[passes])
        found += np.sum(passes)
    assert found > 50


def test_a_second_object_met_during_a_contact_ends_the_scan():
    objects, control = (FIRST, jw.Circle(0.12, 0.1, -0.45)), np.linspace(0.6, -0.8, 281)
    result, alone = jw.scan(scene(objects), control), jw.scan(scene(FIRST), control)
    assert kinds_of(scene(objects)) == ("second_contact",) and kinds_of(scene(FIRST)) == ()
    met = np.argmax(clearance(polylines(alone), objects[1], objects[1].position) < -DEPTH)
    found = np.argmax(np.asarray(result.status) != jw.Status.ok)
    assert alone.phase[met] != jw.Phase.free and abs(found - met) <= 1
    assert np.all(np.asarray(result.status)[found:] == jw.Status.second_contact)
    np.testing.assert_array_equal(result.mz[:found], alone.mz[:found])


def test_a_tiny_object_is_not_passed_between_two_states():
    # It is thinner than the distance between two states, and is met by the middle of the shaft.
    objects = FIRST, jw.Circle(0.15, 0.002, -0.5)
    result = jw.scan(scene(objects), np.linspace(0.6, -1.2, 61))
    assert result.status[-1] == jw.Status.second_contact


def test_scenes_with_several_objects():
    pair = scene((CIRCLE, BOX))
    assert str(pair) == "clamped: 1 whisker, circle q = 0.3, r = 0.3; box q = 0.25, width 0.4, height 0.5, x = -3"
    assert pair.profile.objects == (CIRCLE, BOX) and scene((CIRCLE,)).profile is CIRCLE
    assert scene((pair.profile, FIRST)).profile.objects == (CIRCLE, BOX, FIRST)
    with pytest.raises(ValueError, match="`friction` must be None for an object with edges"):
        scene((CIRCLE, BOX), friction=0.3)
    with pytest.raises(ValueError, match="`profile` must be a single object, got circle"):
        jw.Tilted(scene((FIRST, SECOND)).profile, 0.1)
    for wrong in ((), (CIRCLE, 0.2)):
        with pytest.raises(ValueError, match=r"`profile` must be a Parabola, .* or a tuple of these, got"):
            scene(wrong)


@pytest.mark.unchecked
def test_an_object_below_the_bases_is_rejected_or_invalid():
    sunk = scene((FIRST, jw.Graph(lambda x: x**2 - 0.1)))
    with pytest.raises(ValueError, match="`profile` must be strictly convex with its lowest point above the bases"):
        jw.scan(sunk)


def test_units_do_not_matter():
    length, stiffness = 0.05, 2.4e-5
    objects = tuple(
        jw.Circle(one.distance * length, one.radius * length, one.position * length) for one in (FIRST, SECOND)
    )
    result = jw.scan(jw.Scene(jw.Whisker(length, stiffness), objects), ACROSS * length)
    np.testing.assert_allclose(result.mz * length / stiffness, scanned("clamped")[0].mz, rtol=SAME, atol=SAME)


def test_tables_tell_the_object():
    both, alone, _ = scanned("clamped")
    assert "contact_object_1" in jw.to_dataframe(both).columns and alone.contact_object is None
    data = both.to_xarray()
    np.testing.assert_array_equal(data.contact_object, both.contact_object)
    assert "contact_object" not in alone.to_xarray()


def test_figures_show_all_objects():
    axes = jw.plot.scene(scene((FIRST, SECOND)))
    left, right = axes.get_xlim()
    assert left < -3.0 and right > 0.0
    assert len(axes.patches) - len(jw.plot.scene(scene(FIRST)).patches) == 1
    pyplot.close("all")
