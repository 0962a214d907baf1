"""Objects with edges: closed forms, limits of smooth objects, cones of forces, mirror images, derivatives."""

from functools import cache
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipeinc, ellipkinc

import jaxwhisker as jw
from scenes import all_ok, event_list, follicle, in_both_modes

EXACT = 1e-7  # relative to the size of a signal: error of the integrated rods
CLOSED = 1e-9  # geometry of contacts, balance of forces
SAME = 1e-9  # two computations of the same state
MODES = 1e-9  # forward against reverse mode, relative to the sum of sizes
DIFFERENCE, DIFFERENCES = 1e-6, 1e-6  # step and error of central differences
ROUNDED = 1.2 * 3 / 0.2**2  # error of a rounded blade's moment per radius: the whisker below it is a cantilever

CONTROL = np.linspace(0.5, -1.4, 96)
RIGID = jw.Support.fb(np.inf, 0.0)
# They have as many corners, so that they share programs.
UPRIGHT = np.array([(-0.45, 0.7), (-0.3, 0.35), (0.1, 0.2), (0.4, 0.35), (0.45, 0.75)])
SLANTED = np.array([(-0.45, 0.75), (-0.4, 0.6), (-0.1, 0.25), (0.2, 0.3), (0.45, 0.6)])


def scene(profile, support=None, whisker=None, **fields):
    return jw.Scene(whisker or jw.Whisker(), profile, support or jw.Support.fb(70.0, 0.2), **fields)


@cache
def scanned(name):
    profile = {"upright": jw.Polygon(UPRIGHT), "slanted": jw.Polygon(SLANTED), "box": jw.Box(0.3, 0.8, 0.5)}[name]
    return jw.scan(scene(profile), CONTROL)


def touching(result, phase=None):
    """States with contact, flattened: slope, force, contact, base, moment, arc."""
    of = np.asarray(result.phase)
    at = (of != jw.Phase.free) if phase is None else (of == phase)
    names = ("contact_slope", "contact_force", "contact_x", "contact_y", "base_x", "mz", "contact_arc")
    return [np.asarray(getattr(result, name))[at] for name in names]


def elastica(slope, k):
    """T, N and s1, each times sqrt f (see oracles/exact.py), for a whisker bent to the right."""
    t0 = np.arcsin(np.sin(slope / 2) / k)
    psi = np.arctan2(np.cos(t0), np.sin(t0) * np.sqrt(1 - k**2))
    arc = ellipkinc(psi, k**2)
    rest = ellipeinc(psi, k**2) - k**2 * np.sin(t0) * np.sin(psi)
    return 2 * k * np.cos(t0), 2 * rest - arc, arc


def misses(result, phase):
    """Errors of force, base, moment and arc against the closed form of a contact at this point with this slope."""
    slope, force, x, y, base, moment, arc = touching(result, phase)
    pressed = force > 0.05  # k is not determined by the signals of hardly any force
    slope, force, x, y, base, moment, arc = (v[pressed] for v in (slope, force, x, y, base, moment, arc))
    root = np.sqrt(force)
    k = np.sqrt(0.5) if phase == jw.Phase.tangential else np.sqrt(np.sin(slope / 2) ** 2 + moment**2 / (4 * force))
    along, across, length = elastica(slope, k)
    return {
        "height": (along * np.sin(slope) + across * np.cos(slope)) / root - y,
        "base": x - (along * np.cos(slope) - across * np.sin(slope)) / root - base,
        "moment": (along * root - moment) / (1 + np.abs(moment)),
        "arc": length / root - arc,
    }


@pytest.mark.parametrize("name", ["upright", "slanted", "box"])
def test_tangential_contacts_at_corners_and_on_faces_have_the_closed_form(name):
    errors = misses(scanned(name), jw.Phase.tangential)
    assert all_ok(scanned(name)) and errors["arc"].size > 30
    for error in errors.values():
        np.testing.assert_allclose(error, 0, atol=EXACT)


def test_tip_contacts_on_faces_have_the_closed_form():
    # A short whisker that leans on a steep face touches it with its tip.
    result = jw.scan(scene(jw.Polygon(UPRIGHT), whisker=jw.Whisker(0.5)), np.linspace(0.4, -0.8, 64))
    errors = misses(result, jw.Phase.tip)
    assert errors["arc"].size > 5
    for name, error in errors.items():
        np.testing.assert_allclose(error, 0, atol=10 * EXACT, err_msg=name)


def corner_of(corners, x, y):
    """Number of the corner at each point, -1 on a face, and the distance from the nearest of both."""
    distance = np.hypot(x[:, None] - corners[:, 0], y[:, None] - corners[:, 1])
    start, end = corners[:-1], corners[1:]
    way = end - start
    size = np.hypot(*way.T)
    right, up = x[:, None] - start[:, 0], y[:, None] - start[:, 1]
    along, off = (right * way[:, 0] + up * way[:, 1]) / size, np.abs(right * way[:, 1] - up * way[:, 0]) / size
    on_face = np.where((along >= -CLOSED) & (along <= size + CLOSED), off, np.inf)
    corner = np.where(distance.min(axis=1) < CLOSED, distance.argmin(axis=1), -1)
    return corner, np.minimum(distance.min(axis=1), on_face.min(axis=1)), on_face.argmin(axis=1)


@pytest.mark.parametrize(("name", "corners"), [("upright", UPRIGHT), ("slanted", SLANTED)])
def test_forces_lie_between_the_normals_of_both_faces(name, corners):
    slope, force, x, y, *_ = touching(scanned(name))
    corner, off, face = corner_of(corners, x, y)
    slopes = np.arctan2(*np.diff(corners, axis=0).T[::-1])
    slopes = np.concatenate([[-np.pi], slopes, [np.pi]])  # the top is not seen
    np.testing.assert_allclose(off, 0, atol=CLOSED)
    at_corner = corner >= 0
    assert at_corner.any() and not at_corner.all()
    assert np.all(force >= 0)
    assert np.all(slope[at_corner] >= slopes[corner[at_corner]] - CLOSED)
    assert np.all(slope[at_corner] <= slopes[corner[at_corner] + 1] + CLOSED)
    np.testing.assert_allclose(slope[~at_corner], slopes[face[~at_corner] + 1], atol=CLOSED)


@pytest.mark.parametrize("name", ["upright", "box"])
def test_every_whisker_is_in_balance(name):
    result = scanned(name)
    f, alpha = np.asarray(result.contact_force), np.asarray(result.contact_slope)
    np.testing.assert_allclose(result.fx, -f * np.sin(alpha), atol=SAME)
    np.testing.assert_allclose(result.fy, f * np.cos(alpha), atol=SAME)
    np.testing.assert_allclose(np.asarray(result.fx), -70.0 * np.asarray(result.spring_length - 0.2), atol=100 * SAME)


def test_edge_events_lie_at_corners_with_the_slope_of_a_face():
    edges = scanned("upright").events.of(jw.EventKind.edge)
    assert len(edges) >= 4
    at = np.array([(e.before.contact_x[0], e.before.contact_y[0], e.before.contact_slope[0]) for e in edges])
    corner, _, _ = corner_of(UPRIGHT, at[:, 0], at[:, 1])
    slopes = np.arctan2(*np.diff(UPRIGHT, axis=0).T[::-1])
    assert np.all(corner >= 0)
    np.testing.assert_allclose(np.abs(at[:, 2, None] - slopes).min(axis=1), 0, atol=CLOSED)
    for event in edges:
        np.testing.assert_allclose(event.before.mz, event.after.mz, atol=EXACT)


def test_at_a_corner_the_whisker_slides_along_its_shaft():
    result = scanned("box")
    x, y = np.asarray(result.contact_x)[:, 0], np.asarray(result.contact_y)[:, 0]
    at = (np.abs(x - 0.4) < CLOSED) & (np.abs(y - 0.3) < CLOSED) & (np.asarray(result.phase)[:, 0] != jw.Phase.free)
    arc, slope = (np.asarray(values)[at, 0] for values in (result.contact_arc, result.contact_slope))
    assert at.sum() > 10
    assert np.all(np.diff(arc) > 0) and np.all(np.diff(slope) < 0)
    assert slope[0] > 1.2 and slope[-1] < 0.2  # from the flank almost to the bottom


def test_beneath_a_level_face_nothing_changes():
    # The whisker moves on as a rigid body: the face looks the same everywhere.
    result = scanned("box")
    x = np.asarray(result.contact_x)[:, 0]
    below = (np.abs(np.asarray(result.contact_slope)[:, 0]) < CLOSED) & (np.abs(x) < 0.39) & (x != 0)
    assert below.sum() > 20
    for values in (result.fy, result.mz, result.contact_arc):
        assert np.ptp(np.asarray(values)[below, 0]) < EXACT
    events = [name for name, *_ in event_list(result)]
    assert events.index("vertex") > events.index("edge")  # it is passed where the level face ends


def test_a_sharp_blade_is_the_limit_of_round_ones():
    blade = jw.scan(scene(jw.Polygon([(0.0, 0.9), (0.0, 0.2)]), RIGID), np.linspace(0.1, -0.7, 41))
    assert all_ok(blade)
    for radius in (1e-3, 1e-4):
        round_ = jw.scan(scene(jw.Circle(0.2, radius), RIGID), np.linspace(0.1, -0.7, 41))
        size = 1 + np.abs(np.asarray(blade.mz))
        off = np.max(np.abs(np.asarray(round_.mz - blade.mz)) / size)
        assert 0.01 * radius < off < ROUNDED * radius


def test_a_fine_polygon_converges_to_its_circle():
    radius, control = 0.4, np.linspace(0.3, -0.9, 61)
    circle = np.asarray(jw.scan(scene(jw.Circle(0.2, radius), RIGID), control).mz)

    def off(corners):
        angles = 2 * np.pi * (np.arange(corners) + 0.5) / corners
        points = np.stack([radius * np.cos(angles), 0.6 + radius * np.sin(angles)], axis=1)
        result = jw.scan(scene(jw.Polygon(points), RIGID), control)
        assert all_ok(result)
        return np.sqrt(np.mean((np.asarray(result.mz) - circle) ** 2))

    coarse, fine = off(12), off(36)
    assert fine < coarse / 2.5  # at least of first order
    assert fine < 0.1


def test_the_mirror_image_is_scanned_from_the_other_side():
    support = jw.Support.fb(70.0, 0.0)
    there = jw.scan(scene(jw.Polygon(UPRIGHT), support), CONTROL)
    mirrored = UPRIGHT[::-1] * np.array([-1.0, 1.0])
    back = jw.scan(scene(jw.Polygon(mirrored), support, motion=jw.Translation(direction=1)), -CONTROL)
    assert all_ok(there) and all_ok(back)
    for name, sign in {"fx": -1, "fy": 1, "mz": -1, "contact_slope": -1, "contact_arc": 1}.items():
        np.testing.assert_allclose(sign * np.asarray(getattr(back, name)), getattr(there, name), atol=EXACT)
    assert len(event_list(there)) > 5
    assert [e[:2] for e in event_list(there)] == [e[:2] for e in event_list(back)]
    np.testing.assert_allclose([e[2] for e in event_list(there)], [-e[2] for e in event_list(back)], atol=EXACT)


def signals(corners):
    result = jw.scan(scene(jw.Polygon(corners)), CONTROL)
    events = result.events
    numbers = result.fx, result.fy, result.mz, events.control[:6], events.after.contact_arc[1:6]
    return jnp.concatenate([jnp.ravel(values) for values in numbers])


def test_derivatives_by_the_corners():
    corners = jnp.asarray(SLANTED)
    random = np.random.default_rng(1)
    direction = jnp.asarray(random.normal(size=SLANTED.shape))
    weights = jnp.asarray(random.normal(size=signals(corners).shape))
    _, along, gradient = in_both_modes(signals, direction)(corners, weights)
    difference = (signals(corners + DIFFERENCE * direction) - signals(corners - DIFFERENCE * direction)) / (
        2 * DIFFERENCE
    )
    assert np.all(np.isfinite(along)) and np.max(np.abs(along)) > 1
    np.testing.assert_allclose(along, difference, rtol=DIFFERENCES, atol=DIFFERENCES)
    size = np.sum(np.abs(along * weights))
    np.testing.assert_allclose(np.sum(gradient * direction), np.sum(along * weights), atol=MODES * size)


def test_a_batch_of_polygons_with_a_hopeless_one():
    dented = SLANTED.copy()
    dented[2] = (-0.1, 0.5)
    batch = jnp.stack([jnp.asarray(c) for c in (SLANTED, dented, SLANTED + np.array([0.1, 0.05]))])
    result = jax.vmap(lambda corners: jw.scan(scene(jw.Polygon(corners)), CONTROL))(batch)
    assert np.all(np.asarray(result.status)[1] == jw.Status.invalid)
    assert np.all(np.isnan(np.asarray(result.mz)[1]))
    for k in (0, 2):
        alone = jw.scan(scene(jw.Polygon(batch[k])), CONTROL)
        np.testing.assert_allclose(result.mz[k], alone.mz, atol=SAME)
    staged = jax.jit(lambda corners: jw.scan(scene(jw.Polygon(corners)), CONTROL).mz)(batch[0])
    np.testing.assert_allclose(staged, result.mz[0], atol=SAME)
    # Derivatives of the good ones are finite.
    slope = jax.grad(lambda b: jnp.nansum(jax.vmap(lambda c: jw.scan(scene(jw.Polygon(c)), CONTROL).mz)(b)))(batch)
    assert np.all(np.isfinite(np.asarray(slope)[np.array([0, 2])]))


def random_corners(random):
    while True:
        angles = np.sort(random.uniform(0, 2 * np.pi, 5))
        (a, b), turn = random.uniform(0.2, 0.6, 2), random.uniform(-0.5, 0.5)
        x, y = a * np.cos(angles), b * np.sin(angles)
        corners = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=1)
        corners[:, 1] += random.uniform(0.1, 0.5) - corners[:, 1].min()
        sides = np.roll(corners, -1, axis=0) - corners
        if np.hypot(*sides.T).min() > 0.05:
            return corners


def test_random_polygons_with_reversals():
    random = np.random.default_rng(3)
    corners = jnp.asarray(np.stack([random_corners(random) for _ in range(32)]))
    stiffness = jnp.asarray(10 ** random.uniform(1, 3, 32))
    control = np.concatenate([np.linspace(1.2, -3.0, 128), np.linspace(-3.0, 1.2, 128)])

    def scan(corners, c):
        return jw.scan(scene(jw.Polygon(corners), jw.Support.fb(c)), control)

    result = jax.vmap(scan)(corners, stiffness)
    assert np.all(np.asarray(result.status) == jw.Status.ok)
    # Bent to the right, as on the way out.
    out = jax.tree.map(lambda leaf: leaf[:, :128], (result.phase, result.mz))
    assert np.any(np.asarray(out[0]) == jw.Phase.tangential)
    right = (np.asarray(result.phase) == jw.Phase.tangential) & (np.asarray(result.mz) > 1e-6)
    slope, force, y, arc = (
        np.asarray(getattr(result, name))[right]
        for name in ("contact_slope", "contact_force", "contact_y", "contact_arc")
    )
    along, across, length = elastica(slope, np.sqrt(0.5))
    np.testing.assert_allclose((along * np.sin(slope) + across * np.cos(slope)) - y * np.sqrt(force), 0, atol=EXACT)
    np.testing.assert_allclose(length - arc * np.sqrt(force), 0, atol=EXACT)


LEAN = 0.3  # rad, of the whisker's base
TALL = jw.Box(0.3, 0.8, 0.9)
LOW = jw.Box(0.3, 0.8, 0.5)


@pytest.mark.parametrize(
    ("profile", "angle", "x", "phase"),
    [
        # The tip meets the flank, the shaft the upper corner, or the lower corner.
        (TALL, LEAN, 0.4 + np.sin(LEAN), jw.Phase.tip),
        (LOW, LEAN, 0.4 + 0.8 * np.tan(LEAN), jw.Phase.tangential),
        (TALL, -LEAN, 0.4 - 0.3 * np.tan(LEAN), jw.Phase.tangential),
        (TALL, 0.0, 0.4, jw.Phase.tangential),
    ],
    ids=["leaning forwards at a tall box", "leaning forwards at a low box", "leaning backwards", "upright"],
)
def test_first_touches_of_leaning_whiskers(profile, angle, x, phase):
    result = jw.scan(scene(profile, follicle(x=70.0, mount=(0.0, 0.0, angle))), np.linspace(1.0, -0.2, 13))
    touch = result.events[0]
    assert touch.kind == jw.EventKind.touch
    np.testing.assert_allclose(touch.control, x, atol=SAME)
    assert touch.after.phase[0] == phase
    assert all_ok(result)


def test_the_vertex_of_a_level_face_is_where_the_contact_leaves_it():
    # Rounding alone would decide otherwise: here, before the face.
    support = follicle(x=70.0, mount=(0.0, 0.0, -LEAN))
    events = event_list(jw.scan(scene(LOW, support), np.linspace(1.0, -1.2, 13)))
    assert [name for name, *_ in events] == ["touch", "edge", "edge", "vertex"]


def test_a_curved_whisker_that_meets_two_corners_is_detected():
    curved = scene(LOW, whisker=jw.Whisker(intrinsic_curvature=0.5))
    found = jw.scan(curved, CONTROL)
    assert set(np.unique(np.asarray(found.status))) == {jw.Status.ok, jw.Status.second_contact}


def test_a_cut_profile_is_the_profile_between_its_ends():
    whole = jw.scan(scene(jw.Parabola(0.2)), CONTROL)
    cut = jw.scan(scene(jw.Cut(jw.Parabola(0.2), left=-0.3, right=0.3)), CONTROL)
    assert all_ok(cut)
    x, there = np.asarray(whole.contact_x)[:, 0], np.asarray(cut.contact_x)[:, 0]
    inside = (np.abs(x) < 0.299) & (np.abs(there) < 0.299) & (x != 0) & (there != 0)
    assert inside.sum() > 10
    np.testing.assert_allclose(np.asarray(cut.mz)[inside], np.asarray(whole.mz)[inside], atol=SAME)
    for error in misses(cut, jw.Phase.tangential).values():
        np.testing.assert_allclose(error, 0, atol=EXACT)
    assert np.max(np.abs(there)) < 0.3 + CLOSED
    touch, edge = cut.events[0], cut.events.of(jw.EventKind.edge)[0]
    np.testing.assert_allclose(touch.control, 0.3 - 0.2, atol=CLOSED)
    np.testing.assert_allclose(edge.before.contact_slope, np.arctan(0.6), atol=CLOSED)


def test_derivatives_by_the_ends_of_a_cut():
    def moment(right):
        cut = jw.Cut(jw.Parabola(0.2), left=-0.3, right=right)
        result = jw.scan(scene(cut), CONTROL)
        return jnp.append(result.mz[:, 0], result.events.control[1])

    right = jnp.asarray(0.305)  # no step lies at the touch
    _, along, _ = in_both_modes(moment, jnp.asarray(1.0))(right, jnp.ones(CONTROL.size + 1))
    difference = (moment(right + DIFFERENCE) - moment(right - DIFFERENCE)) / (2 * DIFFERENCE)
    assert np.abs(along).max() > 0.1
    np.testing.assert_allclose(along, difference, rtol=DIFFERENCES, atol=DIFFERENCES)


def test_friction_is_not_modelled():
    with pytest.raises(ValueError, match=r"`friction` must be None for an object with edges.*got friction 0.3 and box"):
        scene(LOW, friction=0.3)
    with pytest.raises(ValueError, match="`friction` must be None"):
        jw.Sensor(jw.Whisker(), friction=0.3).before(LOW)


def test_a_whisker_leaves_the_side_of_a_box_where_it_touched_it():
    # There, the contact ends at an end of its piece: the corner's force has turned as far as the vertical side.
    control = np.concatenate([np.linspace(0.3, -0.6, 10), np.linspace(-0.6, 0.3, 10)])
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Box(0.3, width=0.8, height=0.5), jw.Support.fb(70.0)), control)
    assert all_ok(result)
    (touch,), (release,) = (result.events.of(kind) for kind in (jw.EventKind.touch, jw.EventKind.release))
    np.testing.assert_allclose(release.control, touch.control, atol=1e-9)
    assert int(result.phase[-1, 0]) == jw.Phase.free


SHORT = [-0.46017, 0.79375], [-0.06368, 0.0], [0.34636, 0.7804]


def five_corners(lowest):
    left, middle, right = SHORT
    return jw.Polygon([(-0.61017, 1.36177), left, (middle[0], lowest), right, (0.49636, 1.33507)])


@pytest.mark.parametrize("lowest", [0.482, 0.485, 0.4875, 0.49, 0.491])
def test_snaps_of_tips_over_corners_may_be_very_short(lowest):
    # On the way back, a tip slips over a corner, and the stable branch is closer than the flow's longest step.
    turns = [1.9, -0.6353, -0.0747, -2.7]
    control = np.concatenate([np.linspace(a, b, 80) for a, b in pairwise(turns)])
    result = jw.scan(scene(five_corners(lowest), jw.Support.fb(34.0907, 0.2)), control)
    assert all_ok(result)
    assert len(result.events.of(jw.EventKind.snap_off)) == 1


def test_a_snap_of_a_stepped_whisker_ends_on_the_near_side():
    # The state at the last position is known from independent shooting; there, the drive has turned after the snap.
    whisker = jw.Whisker(1.0, jw.Table([0.0, 0.318588, 0.318588, 1.0], [1.0, 1.0, 0.2, 0.2]), breaks=(0.318588,))
    control = np.concatenate([np.linspace(1.9, -0.6353, 60), np.linspace(-0.6, -0.3588, 60), [-0.3589012]])
    result = jw.scan(scene(five_corners(0.57573), jw.Support.fb(34.0907, 0.2), whisker), control)
    assert all_ok(result)
    snap = result.events.of(jw.EventKind.snap_through)[-1]
    assert snap.control == pytest.approx(-0.358864, abs=1e-6)
    assert float(snap.after.base_x[0] - snap.before.base_x[0]) == pytest.approx(3.2e-4, rel=0.02)
    assert float(result.base_x[-1, 0]) == pytest.approx(-0.1480, abs=5e-5)
    for name, value in {"fx": -0.371629, "mz": 0.642983, "contact_arc": 0.999564}.items():
        assert float(getattr(result, name)[-1, 0]) == pytest.approx(value, abs=1e-6), name
