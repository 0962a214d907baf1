"""Scans in space: the reference, exact reductions to the plane, symmetries, laws of single states, batches."""

# pyright: reportArgumentType=false

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from random_space import KINDS, drawn
from space_cases import ALONG, case
from space_laws import UPRIGHT, Plain, Surface, power, shaft, stability, state_of, violations

REFERENCE = 1e-7  # relative to the largest; the reference gives ten digits and is accurate to 1e-9
EXACT = 1e-9  # both sides are integrated to 1e-12
LAWS = 1e-9  # the states are solved to 1e-10, and the laws are integrated to 1e-12
CASES = json.loads((Path(__file__).parents[1] / "data" / "space.json").read_text("utf-8"))["cases"]
CONTROL = np.linspace(-1.2, 1.2, 49)


@pytest.mark.parametrize("row", CASES, ids=[row["name"].replace(" ", "_") for row in CASES])
def test_scans_agree_with_the_reference(row):
    states = {key: np.array(values) for key, values in row["states"].items() if key != "phase"}
    result = jw.scan(case(row), np.concatenate([[-1.5], states["u"], [1.5]]))
    for name in ("force", "moment", "contact_force", "contact_arc"):
        values, expected = np.asarray(getattr(result, name))[1:-1, 0], states[name]
        np.testing.assert_allclose(values, expected, atol=REFERENCE * np.max(np.abs(expected)), rtol=0, err_msg=name)
    expected = [(event["kind"], event["u"]) for event in row["events"]]
    if expected[-1][0] != row["end"]["kind"]:
        expected.append((row["end"]["kind"], row["end"]["u"]))
    names = {"snap_through": "fold", "snap_off": "fold"}
    found = [(names.get(event.kind.name, event.kind.name), event.control) for event in result.events][: len(expected)]
    assert [kind for kind, _ in found] == [kind for kind, _ in expected]
    np.testing.assert_allclose([u for _, u in found], [u for _, u in expected], atol=REFERENCE)


def sphere(b=0.2, **fields):
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, b)), motion=ALONG, **fields)


@pytest.fixture(scope="module")
def beside():
    """The scan of a clamped straight whisker past a sphere with a lateral offset."""
    return jw.scan(sphere(), CONTROL)


def in_plane(profile, distances):
    """Reactions (force x, force y, moment z) of a plane scan at these distances of the base before the vertex."""
    order = np.argsort(-distances)
    found = jw.scan(jw.Scene(jw.Whisker(), profile), distances[order])
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    values = np.stack([found.fx[:, 0], found.fy[:, 0], found.mz[:, 0]], axis=-1)
    return values[np.argsort(order)]


def in_space(plane, outwards):
    """The same reactions in space, if x of the plane is this direction."""
    up = np.array([0.0, 1.0, 0.0])
    return plane[:, :1] * outwards + plane[:, 1:2] * up, plane[:, 2:] * np.cross(outwards, up)


def test_a_sphere_beside_the_scan_is_the_plane_problem_at_the_distance_of_its_axis(beside):
    offset = np.stack([-CONTROL, 0 * CONTROL, np.full(CONTROL.size, -0.2)], axis=-1)
    distance = np.linalg.norm(offset, axis=1)
    force, moment = in_space(in_plane(jw.Circle(0.3, 1.0), distance), offset / distance[:, None])
    assert np.max(np.abs(force)) > 1
    np.testing.assert_allclose(beside.force[:, 0], force, atol=EXACT)
    np.testing.assert_allclose(beside.moment[:, 0], moment, atol=EXACT)


def test_a_tilted_cylinder_is_the_plane_problem_normal_to_its_axis():
    tilt, control = 0.5, np.linspace(-1.3, -0.01, 30)
    body = jw.Cylinder(1.0, (0.0, 1.3, 0.0), (np.sin(tilt), 0.0, np.cos(tilt)))
    found = jw.scan(jw.SpaceScene(jw.Whisker(), body, motion=ALONG), control)
    outwards = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    force, moment = in_space(in_plane(jw.Circle(0.3, 1.0), -control * np.cos(tilt)), outwards)
    np.testing.assert_allclose(found.force[:, 0], force, atol=EXACT)
    np.testing.assert_allclose(found.moment[:, 0], moment, atol=EXACT)


def ellipsoid(turn, centre, direction):
    body = jw.Ellipsoid((1.1, 0.8, 0.6), centre).rotated(turn)
    return jw.scan(jw.SpaceScene(jw.Whisker(), body, motion=jw.LinearDrive(direction)), CONTROL)


def test_a_mirrored_scene_has_mirrored_reactions():
    one = ellipsoid((0.3, 0.2, -0.4), (0.0, 1.2, 0.1), (-1.0, 0.1, 0.3))
    other = ellipsoid((-0.3, -0.2, -0.4), (0.0, 1.2, -0.1), (-1.0, 0.1, -0.3))
    assert np.max(np.abs(one.fz)) > 0.1
    np.testing.assert_allclose(other.force, np.asarray(one.force) * [1, 1, -1], atol=EXACT)
    np.testing.assert_allclose(other.moment, np.asarray(one.moment) * [-1, -1, 1], atol=EXACT)
    np.testing.assert_allclose(one.events.control, other.events.control, atol=EXACT)


def test_a_turned_and_shifted_scene_has_turned_reactions(beside):
    vector, shift = (0.4, -0.7, 0.5), (3.0, -2.0, 1.0)
    turn = Rotation.from_rotvec(vector)
    angle, elevation, roll = map(float, turn.as_euler("ZXY"))
    body = jw.Sphere(1.0, (0.0, 1.3, 0.2)).rotated(vector, about=(0.0, 0.0, 0.0)).moved(shift)
    drive = jw.LinearDrive(tuple(map(float, turn.apply([-1.0, 0.0, 0.0]))), shift)
    mount = jw.Mount(angle=angle, elevation=elevation, roll=roll)
    found = jw.scan(jw.SpaceScene(jw.Whisker(), body, jw.Support(mount=mount), motion=drive), CONTROL)
    np.testing.assert_allclose(found.force[:, 0], turn.apply(np.array(beside.force[:, 0])), atol=EXACT)
    np.testing.assert_allclose(found.moment[:, 0], turn.apply(np.array(beside.moment[:, 0])), atol=EXACT)
    np.testing.assert_allclose(found.own_force, beside.own_force, atol=EXACT)


def test_reactions_scale_with_the_units(beside):
    size, stiffness = 30.0, 7.0
    body = jw.Sphere(size, (0.0, 1.3 * size, 0.2 * size))
    whisker = jw.Whisker(length=size, bending_stiffness=stiffness)
    found = jw.scan(jw.SpaceScene(whisker, body, motion=ALONG), CONTROL * size)
    np.testing.assert_allclose(np.asarray(found.force) * size**2 / stiffness, beside.force, atol=EXACT)
    np.testing.assert_allclose(np.asarray(found.moment) * size / stiffness, beside.moment, atol=EXACT)
    np.testing.assert_allclose(np.asarray(found.contact_arc) / size, beside.contact_arc, atol=EXACT)


def curved(roll, direction, b):
    whisker = jw.Whisker(intrinsic_curvature=0.7, torsion_ratio=0.7)
    scene = jw.SpaceScene(
        whisker, jw.Sphere(1.0, (0.0, 1.2, b)), jw.Support(mount=jw.Mount(roll=roll)), motion=direction
    )
    return jw.scan(scene, CONTROL)


def test_a_roll_by_180_degrees_and_a_scan_in_the_other_direction_turn_all_reactions():
    one = curved(0.6, ALONG, 0.2)
    other = curved(0.6 + np.pi, jw.LinearDrive((1.0, 0.0, 0.0)), -0.2)
    assert np.max(np.abs(one.fz)) > 0.1
    for name in ("force", "moment"):
        np.testing.assert_allclose(getattr(other, name), np.asarray(getattr(one, name)) * [-1, 1, -1], atol=EXACT)
    np.testing.assert_allclose(one.own_moment, other.own_moment, atol=EXACT)


LAWFUL = ["straight clamped linear", "straight sprung linear", "curved clamped linear", "curved tilting whisk"]


@pytest.mark.parametrize("kind", LAWFUL)
def test_states_of_random_scenes_obey_the_laws_and_are_stable(kind):
    rng, touching = np.random.default_rng(7), 0
    for _ in range(3):
        scene, plain, text = drawn(kind, rng)
        found = jw.scan(scene)
        steps = np.flatnonzero(np.asarray(found.status) == jw.Status.ok)
        for step in steps[:: max(1, steps.size // 6)]:
            state = state_of(Step(found, step), float(found.control[step]))
            wrong = {law: value for law, value in violations(plain, state).items() if value > LAWS}
            assert not wrong, (text, state.control)
            touching += state.phase > 0
            assert state.contact_force < 1e-3 or stability(plain, state, 30) > 0, (text, state.control)
    assert touching > 6


def random_scene(name):
    """A scene of the soak test, by its kind and number."""
    kind, number = name.rsplit(" ", 1)
    return drawn(kind, np.random.default_rng([KINDS.index(kind), int(number)]))


@pytest.mark.parametrize("scene", ["straight clamped linear 24", "cone clamped linear 42"])
def test_two_changes_of_phase_within_one_step_of_the_path_are_both_found(scene):
    scene, plain, text = random_scene(scene)
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok), text
    kinds = [event.kind for event in found.events]
    assert kinds[1:3] == [jw.EventKind.tip_to_tangential, jw.EventKind.tangential_to_tip], text
    between = np.flatnonzero(np.asarray(found.phase[:, 0]) == jw.Phase.tangential)
    assert between.size > 1
    for step in between:
        state = state_of(Step(found, step), float(found.control[step]))
        assert max(violations(plain, state).values()) < LAWS


FOLD = 1e-3  # of the control, which changes with the square of the least eigenvalue of the second variation: 0.03


@pytest.mark.parametrize("scene", ["straight sprung whisk 115", "curved tilting linear 115"])
def test_a_loss_of_stability_just_before_a_change_of_phase_is_found(scene):
    scene, plain, text = random_scene(scene)
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok), text
    (snap,) = [event for event in found.events if event.kind in (jw.EventKind.snap_through, jw.EventKind.snap_off)]
    before = state_of(snap.before, snap.control)
    assert max(violations(plain, before).values()) < LAWS
    assert abs(stability(plain, before, 30)) < FOLD**0.5
    assert not [event for event in found.events if event.kind == jw.EventKind.tangential_to_tip]


def ends(scene):
    """Names of all statuses in a random scene."""
    return {jw.Status(int(status)).name for status in np.asarray(jw.scan(random_scene(scene).scene).status)}


@pytest.mark.parametrize(
    "scene", ["curved clamped whisk 39", "curved clamped whisk 1181", "curved cone tilting whisk 30"]
)
def test_a_scan_ends_as_not_convex_where_a_contact_splits_in_a_slide_or_at_an_event(scene):
    assert ends(scene) == {"ok", "not_convex"}


@pytest.mark.parametrize("scene", ["straight clamped linear 1049", "straight sprung linear 1546"])
def test_a_scan_is_lost_where_a_contact_reaches_the_base_on_the_path_or_in_a_slide(scene):
    assert ends(scene) == {"ok", "lost"}


@pytest.mark.parametrize("scene", ["straight tilting whisk 1221", "curved tilting whisk 1006"])
def test_a_whisker_that_comes_free_while_its_unloaded_shape_is_inside_the_object_lands_on_it_again(scene):
    scene, plain, text = random_scene(scene)
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok), text
    (snap,) = [event for event in found.events if event.kind == jw.EventKind.snap_through]
    landed = state_of(snap.after, snap.control)
    position, _, rotation = plain.placement(snap.control)
    unloaded = landed._replace(phase=0, force=np.zeros(3), moment=np.zeros(3), base=position, rotation=rotation)
    assert violations(plain, unloaded)["depth"] > 1e-3
    assert max(violations(plain, landed).values()) < LAWS
    assert landed.contact_force > 1e-3
    assert stability(plain, landed, 30) > 0


class Step:
    """One step of a result."""

    def __init__(self, result, step):
        self.result, self.step = result, step

    def __getattr__(self, name):
        return np.asarray(getattr(self.result, name))[self.step]


WOUND_UP = 2e-4  # rods magnify the errors of their integration, 1e-9, by 300 in either direction at most


def test_a_whisker_that_winds_up_is_inexact_where_errors_grow_too_much_along_it():
    ratio, curvature, roll = 0.003, 0.8, np.pi / 3
    past, mount = jw.Sphere(1.0, (0.0, 1.3, 0.0)), UPRIGHT @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
    whisker = jw.Whisker(torsion_ratio=ratio, intrinsic_curvature=curvature)
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    found = jw.scan(jw.SpaceScene(whisker, past, jw.Support((), jw.Mount(roll=roll)), motion=drive), CONTROL)
    plain = Plain(
        Surface(np.array([0.0, 1.3, 0.0]), np.eye(3), np.zeros(3), 0.5),
        lambda u: (np.array([-u, 0.0, 0.1]), np.eye(3), mount),
        stiffness=lambda s: 1.0,
        torsion_ratio=ratio,
        curvature=lambda s: np.array([0.0, -curvature, 0.0]),
    )
    status = np.asarray(found.status)
    assert set(status) == {jw.Status.ok, jw.Status.inexact}
    for step in np.flatnonzero((status == jw.Status.ok) & (np.asarray(found.phase)[:, 0] > 0)):
        wrong = violations(plain, state_of(Step(found, step), float(found.control[step])))
        assert max(wrong.values()) < WOUND_UP


def test_a_contact_over_a_hundred_lengths_fits_into_a_path():
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, 0.2))
    scene = jw.SpaceScene(jw.Whisker(), jw.Sphere(1e4, (0.0, 1e4 + 0.3, 0.0)), motion=drive)
    found = jw.scan(scene, np.linspace(-90.0, 120.0, 43))
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert [event.kind for event in found.events][-1] == jw.EventKind.release


def test_the_drive_does_the_work_that_the_whisker_stores():
    scene, plain, _ = drawn("straight clamped linear", np.random.default_rng(3))
    found = jw.scan(scene)
    touching = np.flatnonzero(np.asarray(found.phase)[:, 0] > 0)
    steps = touching[: touching.size // 2]
    states = [state_of(Step(found, step), float(found.control[step])) for step in steps]
    energy = np.array([shaft(plain, state).energy for state in states[:: steps.size - 1]])
    rates = np.array([power(plain, state) for state in states])
    assert energy[1] > 0.05
    work = np.trapezoid(rates, found.control[steps])
    rule = np.max(np.abs(np.diff(rates))) * np.max(np.diff(found.control[steps]))  # error of the trapezoidal rule
    np.testing.assert_allclose(work, energy[1] - energy[0], atol=rule)


def test_a_scan_that_returns_touches_again():
    there = np.linspace(-1.2, 1.2, 25)
    found = jw.scan(sphere(), np.concatenate([there, there[-2::-1]]))
    np.testing.assert_allclose(found.force[25:], found.force[23::-1], atol=EXACT)
    assert len(found.events.of(jw.EventKind.release)) == 2


def test_a_whisker_that_swings_around_a_cylinder_comes_free():
    body = jw.Cylinder(0.22, (-0.07, 0.67, -0.16), (0.19, 0.14, 0.98))
    found = jw.scan(jw.SpaceScene(jw.Whisker(), body, motion=jw.LinearDrive((-0.91, 0.125, 0.39))))
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert [event.kind.name for event in found.events][-1] == "snap_off"


def test_a_scan_goes_on_until_the_loaded_whisker_is_free():
    """The drive moves nearly along a cylinder, and drags the whisker far behind its unloaded shape."""
    scene, _, _ = drawn("straight clamped linear", np.random.default_rng([0, 131]))
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert int(found.phase[-1, 0]) == jw.Phase.free


def test_a_loss_that_is_approached_from_the_stable_side_is_found():
    scene, _, _ = drawn("straight sprung linear", np.random.default_rng([2, 42]))
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert found.events.of(jw.EventKind.snap_through) or found.events.of(jw.EventKind.snap_off)


def test_a_release_just_before_a_change_of_phase_is_found():
    """A whisker that leaves a cylinder while its contact reaches the tip: the force vanishes first."""
    scene, _, _ = drawn("straight clamped whisk", np.random.default_rng([1, 63]))
    found = jw.scan(scene, np.linspace(0.5, 0.7, 21))
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert [event.kind for event in found.events][-1] == jw.EventKind.release


def test_the_default_scan_of_a_rotation_ends_at_its_last_control():
    row = next(row for row in CASES if row["name"].startswith("S7"))
    scene = eqx.tree_at(lambda scene: scene.motion.stop, case(row), 0.3)
    found = jw.scan(scene)
    assert np.all(np.asarray(found.status) == jw.Status.ok)
    assert int(found.phase[-1, 0]) != jw.Phase.free


NAMES = "radius", "height", "offset", "spring", "curvature", "roll", "torsion"
VALUES = jnp.array([1.0, 1.25, 0.2, 30.0, 0.6, 0.5, 0.7])
STEPS = np.array([-0.5, -0.1, 0.3])


def sprung(values):
    """Reactions and the positions of the first two events of a curved whisker on springs."""
    radius, height, offset, spring, curvature, roll, torsion = values
    whisker = jw.Whisker(intrinsic_curvature=curvature, torsion_ratio=torsion)
    support = jw.Support.follicle(x=spring, y=300.0, z=20.0, mount=jw.Mount(roll=roll))
    scene = jw.SpaceScene(whisker, jw.Sphere(radius, (0.0, height, offset)), support, motion=ALONG)
    found = jw.scan(scene, np.concatenate([[-1.5], STEPS]))
    return jnp.concatenate([found.force[1:, 0].ravel(), found.moment[1:, 0].ravel(), found.events.control[:2]])


DIFFERENCES = 2e-6  # relative error of central differences with steps of 1e-5, whose rounding is 1e-7


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_agree_with_differences(mode):
    step = 1e-5
    found = np.asarray(mode(sprung)(VALUES))
    for k, name in enumerate(NAMES):
        ends = [np.asarray(sprung(VALUES.at[k].multiply(1 + sign * step))) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step * VALUES[k])
        scale = np.max(np.abs(expected))
        assert scale > 1e-4, name
        np.testing.assert_allclose(found[:, k], expected, atol=DIFFERENCES * (scale + 1), err_msg=name)


def test_a_batch_equals_a_loop_and_a_hopeless_scene_leaves_its_neighbours_alone():
    some = jnp.stack([VALUES, VALUES.at[0].set(jnp.nan), VALUES.at[2].set(-0.3)])
    batch = np.asarray(jax.vmap(sprung)(some))
    assert np.all(np.isnan(batch[1]))
    for k in (0, 2):
        np.testing.assert_allclose(batch[k], sprung(some[k]), atol=EXACT)


def test_a_compiled_scan_equals_an_eager_one():
    np.testing.assert_allclose(jax.jit(sprung)(VALUES), sprung(VALUES), atol=EXACT)
