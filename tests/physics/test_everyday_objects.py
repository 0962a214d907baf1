"""Capsules, boxes and planes in space: exact reductions, laws in random scenes, edges, derivatives, batches."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from random_space import EVERYDAY, drawn
from space_laws import shaft, spread, stability, state_of, violations

EXACT = 1e-9  # both sides are integrated to 1e-12
LAWS = 1e-8  # the states are solved to 1e-10; contact forces reach 1e3 where a wall is close to the base
DIFFERENCES = 2e-6  # relative error of central differences with steps of 1e-5, whose rounding is 1e-7
FLAT = 1e-6  # g_ss of a whisker that lies on a face, where the second variation has a factor 1 / g_ss
ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
SKEW = jw.LinearDrive((-1.0, 0.1, 0.4))
CONTROL = np.linspace(-1.1, 0.9, 41)
NAMES = "force", "moment", "contact_force", "contact_arc"


def scanned(surface, control=CONTROL, motion=ALONG, **parts):
    return jw.scan(jw.SpaceScene(parts.pop("whisker", jw.Whisker()), surface, motion=motion, **parts), control)


def agree(one, other, tolerance=EXACT):
    assert np.array_equal(one.status, other.status) and np.array_equal(one.phase, other.phase)
    assert np.max(one.contact_force[one.status == 0]) > 0.5
    for name in NAMES:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=tolerance, err_msg=name)
    assert one.events.kind.tolist() == other.events.kind.tolist()
    np.testing.assert_allclose(one.events.control, other.events.control, atol=tolerance)


def test_the_middle_of_a_capsule_is_a_cylinder():
    axis = np.array([0.3, 0.1, 0.9])
    ends = (tuple(np.array([0.1, 1.2, 0.0]) + share * axis) for share in (-4.0, 5.0))
    agree(
        scanned(jw.Capsule(0.7, *ends), motion=SKEW),
        scanned(jw.Cylinder(0.7, (0.1, 1.2, 0.0), tuple(axis)), motion=SKEW),
    )


def test_the_end_of_a_capsule_is_a_sphere():
    end, radius = (0.0, 1.2, 0.2), 0.7
    sphere = jw.Sphere(radius * np.sqrt(1 - 0.2 * 0.1**2), end)
    agree(scanned(jw.Capsule(radius, end, (0.1, 4.0, 0.5))), scanned(sphere))


def leaning(**parts):
    """A whisker that leans towards a wall."""
    return jw.Support(mount=jw.Mount(angle=0.5, **parts))


WALL, DISTANCE = np.array([1.0, -0.2, 0.1]), 0.8
TO_WALL = np.linspace(0.2, 0.8, 31)


def test_the_face_of_a_box_is_a_plane():
    outward = WALL / np.linalg.norm(WALL)
    point = -DISTANCE * np.array([1.0, 0.0, 0.0]) + np.array([0.0, 0.8, 0.0])
    size, turn = 6.0, np.cross([1.0, 0.0, 0.0], outward)
    turn *= np.arcsin(np.linalg.norm(turn)) / np.linalg.norm(turn)
    box = jw.RoundedBox((size, size, size), 0.1, tuple(point - outward * size / 2)).rotated(tuple(turn))
    found = scanned(jw.Plane(tuple(point), tuple(outward)), TO_WALL, support=leaning())
    assert np.any(found.phase == jw.Phase.tip) and np.any(found.phase == jw.Phase.tangential)
    agree(scanned(box, TO_WALL, support=leaning()), found)


def test_a_wall_normal_to_the_plane_of_the_scan_is_a_plane_scan_of_a_huge_circle():
    """The same laws without the package's space: a circle of radius R differs from its tangent by y^2 / 2R."""
    radius, tilt = 1e6, 0.3  # a ceiling that falls towards -x
    ceiling = jw.Plane((0.0, 0.9, 0.0), (np.sin(tilt), -np.cos(tilt), 0.0))
    circle = jw.Tilted(jw.Circle(0.9, radius), tilt, about=(0.0, 0.9))
    control = np.linspace(0.0, -1.5, 31)
    found = scanned(ceiling, -control)
    plane = jw.scan(jw.Scene(jw.Whisker(), circle), control)
    good = np.asarray(found.status == 0) & np.asarray(plane.status == 0)
    assert np.sum(good) > 15 and np.max(found.contact_force[good]) > 0.5
    for name in ("fx", "fy", "mz"):
        one, other = np.asarray(getattr(found, name))[good], np.asarray(getattr(plane, name))[good]
        np.testing.assert_allclose(one, other, atol=20 / radius, err_msg=name)


def test_a_whisker_lies_on_a_wall_beyond_its_contact():
    found = scanned(jw.Plane((-DISTANCE, 0.8, 0.0), tuple(WALL)), TO_WALL, support=leaning())
    lies = np.flatnonzero(np.asarray(found.phase)[:, 0] == jw.Phase.tangential)
    shapes = jw.shapes(found, points=60)
    line = np.stack([np.asarray(getattr(shapes, axis))[lies[-1], 0] for axis in "xyz"], axis=-1)
    off = (line - [-DISTANCE, 0.8, 0.0]) @ (WALL / np.linalg.norm(WALL))
    assert np.sum(np.abs(off) < 1e-9) > 15 and np.min(off) > -1e-9


@pytest.mark.parametrize("control", [None, np.linspace(0.4, -1.0, 15)])
def test_a_base_that_arrives_at_a_wall_first_ends_the_scan_there(control):
    """The whisker leans away from the wall, and is free up to there."""
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Plane((-0.55, 0.0, 0.0), (1.0, 0.2, 0.0))), control)
    free = -np.asarray(result.control) < 0.55 + 1e-8  # a free whisker touches at a depth of 1e-9
    assert free.any() and not free.all()
    np.testing.assert_array_equal(result.status, np.where(free, 0, jw.Status.lost))
    assert len(result.events) == 0


def test_a_default_scan_into_a_wall_ends_where_the_base_arrives_there():
    wall = jw.Plane((-1.0, 0.0, 0.0), (1.0, -0.6, 0.2))
    found = jw.scan(jw.SpaceScene(jw.Whisker(), wall, motion=ALONG))
    good = np.asarray(found.status) == 0
    assert np.mean(good) > 0.9 and found.status[-1] == jw.Status.lost
    assert float(found.contact_arc[good][-1, 0]) < 0.05
    away = jw.scan(jw.SpaceScene(jw.Whisker(), wall, jw.Support(mount=jw.Mount(angle=-1.0)), motion=ALONG))
    assert away.control.size < 50 and away.status[-1] == jw.Status.lost and not np.any(away.phase)


VALUES = {
    "capsule": [0.3, 0.05, 1.1, 0.1, 0.3, 0.9],
    "box": [1.1, 0.9, 0.2, 0.05, 1.0, 0.3],
    "plane": [-0.8, 0.8, 1.0, -0.5, 0.1, 0.4],
}
# Over the joint of the capsule, over the edge of the box, and as far as the whisker lies on the wall.
STEPS = {"capsule": np.linspace(-0.25, 0.3, 12), "box": np.linspace(-0.3, 0.5, 9), "plane": np.linspace(0.3, 0.9, 9)}


def signals(name):
    """Reactions and events as a function of the numbers of an object, and of the angle of the mount."""

    def of(p):
        if name == "capsule":
            body, angle = jw.Capsule(p[0], (p[1], p[2], p[3]), (p[4] + 1.0, p[2], 2.0 + p[5])), 0.0
        elif name == "box":
            body, angle = jw.RoundedBox((p[0], 0.6, p[1]), p[2], (p[3], p[4], 0.1)).rotated((0.2, p[5], 0.1)), 0.0
        else:
            body, angle = jw.Plane((p[0], p[1], 0.1), (p[2], p[3], p[4])), p[5]
        support = jw.Support(mount=jw.Mount(angle=angle))
        scene = jw.SpaceScene(jw.Whisker(), body, support, motion=ALONG)
        found = jw.scan(scene, np.append(-1.0 if name != "plane" else 0.0, STEPS[name]))
        return jnp.concatenate([found.force[1:, 0].ravel(), found.moment[1:, 0].ravel(), found.events.control[:2]])

    return of


@pytest.mark.parametrize("name", EVERYDAY)
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_agree_with_differences(name, mode):
    step, values, function = 1e-5, jnp.asarray(VALUES[name]), signals(name)
    found = np.asarray(mode(function)(values))
    assert np.all(np.isfinite(found))
    for k, value in enumerate(VALUES[name]):
        ends = [np.asarray(function(values.at[k].add(sign * step))) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        scale = np.max(np.abs(expected))
        assert scale > 1e-4, (k, value)
        np.testing.assert_allclose(found[:, k], expected, atol=DIFFERENCES * (scale + 1), err_msg=str(k))


@pytest.mark.parametrize("name", EVERYDAY)
def test_batches_and_compiled_scans_equal_eager_ones(name):
    function, values = signals(name), jnp.asarray(VALUES[name])
    some = jnp.stack([values, values.at[0].set(jnp.nan), values * 1.02])
    batch = np.asarray(jax.vmap(function)(some))
    assert np.all(np.isnan(batch[1]))
    for k in (0, 2):
        np.testing.assert_allclose(batch[k], function(some[k]), atol=EXACT)
    np.testing.assert_allclose(jax.jit(function)(values), function(values), atol=EXACT)


KINDS = "straight clamped linear", "curved cone sprung linear", "straight clamped whisk"
SCENES = 20


class Step:
    """The fields of one step of a result."""

    def __init__(self, result, step):
        self.result, self.step = result, step

    def __getattr__(self, name):
        return np.asarray(getattr(self.result, name))[self.step]


@pytest.mark.filterwarnings("ignore:The scan touches nothing")
@pytest.mark.parametrize(("kind", "name"), [(k, n) for k in KINDS for n in EVERYDAY if n != "plane" or k == KINDS[0]])
def test_random_scenes_run_to_their_end_and_obey_the_laws(kind, name):
    ends = []
    for number in range(SCENES):
        scene, plain, text = drawn(kind, np.random.default_rng([77, number]), (name,))
        found = jw.scan(scene)
        good = np.flatnonzero(np.asarray(found.status) == jw.Status.ok)
        arc = float(found.contact_arc[good[-1], 0])
        status = {jw.Status(int(s)).name for s in np.unique(found.status)} - {"ok"}
        # A wall ends a scan where the base gets there; a curved whisker may meet an object twice.
        expected = {"lost"} if name == "plane" else set()
        if "curved" in kind:
            expected |= {"not_convex", "second_contact"}
        if not status <= expected or (status == {"lost"} and arc > 0.05):
            ends.append((text, status, arc))
        if number < 4:
            touching = good[np.asarray(found.phase)[good, 0] > 0]
            for step in touching[:: max(1, touching.size // 3)]:
                state = state_of(Step(found, step), float(found.control[step]))
                whole = shaft(plain, state)
                wrong = {law: value for law, value in violations(plain, state, whole).items() if value > LAWS}
                assert not wrong, (text, state.control)
                lies = state.phase == jw.Phase.tangential and spread(plain, state, whole) < FLAT
                assert lies or state.contact_force < 1e-3 or stability(plain, state, 30) > 0, (text, state.control)
    assert not ends
