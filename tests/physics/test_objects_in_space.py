"""Several objects in one scene in space: touched one after the other, landed on, and met in a second place."""

# pyright: reportArgumentType=false, reportOptionalSubscript=false, reportOptionalOperand=false, reportCallIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from random_space import drawn_before_two
from space_laws import Apart, state_of, violations

EXACT = 1e-9  # both sides are integrated to 1e-12
LAWS = 1e-8  # the states are solved to 1e-10
DEPTH = 1e-5  # lengths: a touch is found when the shaft is 1e-6 deep
ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
PEG = jw.Cylinder(0.2, (0.0, 0.8, 0.0), (0.0, 0.3, 1.0))
BALL = jw.Sphere(0.25, (-1.6, 0.9, 0.1))
NAMES = "force", "moment", "contact_force", "contact_arc", "phase"


def before(*objects, **parts):
    return jw.SpaceScene(jw.Whisker(), objects, motion=ALONG, **parts)


def peg(radius, x, y, z=0.0):
    return jw.Cylinder(radius, (x, y, z), (0.0, 0.3, 1.0))


@pytest.mark.parametrize("friction", [None, 0.2], ids=["smooth", "friction"])
def test_objects_are_scanned_one_after_the_other_as_if_they_were_alone(friction):
    control = np.linspace(-0.3, 2.0, 47)
    result = jw.scan(before(PEG, BALL, friction=friction), control)
    each = [jw.scan(before(one, friction=friction), control) for one in (PEG, BALL)]
    assert np.all(result.status == 0)
    assert set(np.unique(result.contact_object)) == {0, 1, 2}
    assert np.array_equal(result.contact_object > 0, result.phase > 0)
    for name in NAMES:
        alone = sum(np.asarray(getattr(one, name)) for one in each)  # zero without contact
        np.testing.assert_allclose(getattr(result, name), alone, atol=EXACT, err_msg=name)
    events = [event for one in each for event in one.events]
    assert [event.kind for event in result.events] == [event.kind for event in events]
    np.testing.assert_allclose([e.control for e in result.events], [e.control for e in events], atol=1e-8)
    kinds = {1: each[0].events, 2: each[1].events}
    for number, own in kinds.items():
        assert sum(event.object == number for event in result.events) == sum(e.object == 1 for e in own)


def test_events_name_the_object():
    text = str(jw.scan(before(PEG, BALL), np.linspace(-0.3, 2.0, 5)))
    assert "touch of whisker 1 with object 1" in text and "release of whisker 1 from object 2" in text


@pytest.mark.parametrize(
    "second",
    [
        jw.Cylinder(0.2, (-0.6, 0.7, 0.1), (0.2, 0.1, 1.0)),
        jw.Cylinder(0.2, (-0.5, 0.7, 0.1), (0.2, 0.1, 1.0)),
        peg(0.01, -0.3, 0.8, 0.1),
    ],
    ids=["near the unloaded shape", "far from it", "a thin peg that the unloaded shape clears"],
)
def test_a_whisker_that_comes_free_lands_on_an_object_in_its_way(second):
    """It lands where it would be if there were only this one."""
    control = np.linspace(-0.3, 0.55, 41)
    result, alone = jw.scan(before(PEG, second), control), jw.scan(before(second), control)
    snap = next(event for event in result.events if event.kind == jw.EventKind.snap_through)
    lands = control > snap.control
    assert np.all(result.status == 0) and np.all(result.contact_object[lands] == 2)
    for name in NAMES:
        np.testing.assert_allclose(getattr(result, name)[lands], getattr(alone, name)[lands], atol=EXACT)


def test_a_curved_whisker_on_a_rolled_mount_lands_like_a_straight_one():
    parts = {"motion": ALONG, "support": jw.Support(mount=jw.Mount(roll=2.0))}
    curved, second = jw.Whisker(intrinsic_curvature=0.2, lateral_curvature=0.15), peg(0.01, -0.3, 0.8, 0.1)
    control = np.linspace(-0.2, 0.6, 41)
    result = jw.scan(jw.SpaceScene(curved, (PEG, second), **parts), control)
    alone = jw.scan(jw.SpaceScene(curved, second, **parts), control)
    lands = control > next(event for event in result.events if event.kind == jw.EventKind.snap_through).control
    assert np.all(result.status == 0) and np.all(result.contact_object[lands] == 2)
    for name in NAMES:
        np.testing.assert_allclose(getattr(result, name)[lands], getattr(alone, name)[lands], atol=EXACT)


def test_a_whisker_comes_free_if_the_next_object_is_not_in_its_way():
    result = jw.scan(before(PEG, peg(0.01, -0.3, 0.95)), np.linspace(-0.3, 0.6, 41))
    assert np.all(result.status == 0) and result.phase[-1, 0] == 0
    assert result.events[len(result.events) - 1].kind == jw.EventKind.snap_off


def test_a_scan_ends_where_the_shaft_meets_another_object():
    result = jw.scan(before(PEG, peg(0.01, 0.05, 0.55)), np.linspace(-0.3, 0.4, 701))
    status = np.asarray(result.status)
    last = np.flatnonzero(status == 0)[-1]
    assert set(status[last + 1 :]) == {jw.Status.second_contact} and result.phase[last, 0] > 0
    # Scanned alone, the first object tells where the shaft is: just outside the second one, and then inside.
    alone = jw.scan(before(PEG), result.control[last : last + 2])
    lines = jw.shapes(alone, points=2001)
    axis = np.array([0.0, 0.3, 1.0]) / np.hypot(0.3, 1.0)
    away = np.stack([np.asarray(part)[:, 0] for part in (lines.x, lines.y, lines.z)], axis=-1) - [0.05, 0.55, 0.0]
    gap = np.min(np.linalg.norm(away - (away @ axis)[..., None] * axis, axis=-1), axis=1) - 0.01
    assert gap[0] > -DEPTH and gap[1] < DEPTH


@pytest.mark.parametrize("x", [-0.2, -0.4])
def test_a_scan_ends_where_a_tip_slides_onto_an_object_that_overlaps(x):
    result = jw.scan(before(jw.Sphere(0.3, (0.0, 1.0, 0.05)), jw.Sphere(0.3, (x, 1.05, 0.05))))
    assert int(np.max(result.status)) in (jw.Status.second_contact, jw.Status.lost)
    assert set(np.unique(result.contact_object)) == {0, 1}


def test_a_contact_does_not_slide_onto_another_object_unnoticed():
    """The corner between two balls is so shallow that nothing else ends the scan: the directions differ by 0.003."""
    result = jw.scan(before(jw.Sphere(1.0, (0.0, 1.9, 0.05)), jw.Sphere(1.0, (-0.003, 1.9, 0.05))))
    assert int(np.max(result.status)) == jw.Status.second_contact
    assert set(np.unique(result.contact_object)) == {0, 1}


def moment(y, objects):
    """The moments on the way past both objects, the second one at this height."""
    sphere = jw.Sphere(0.25, (-1.6, y, 0.1))
    return jw.scan(before(*(PEG, sphere)[-objects:]), jnp.array([-0.1, 0.2, 1.65])).moment[:, 0]


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_derivatives_know_which_object_is_touched(derivative):
    found = derivative(lambda y: moment(y, 2))(0.9)
    alone = derivative(lambda y: moment(y, 1))(0.9)
    assert np.all(found[:2] == 0) and np.max(np.abs(found[2])) > 0.1
    np.testing.assert_allclose(found[2], alone[2], atol=EXACT)


def test_scans_of_a_batch_are_those_of_single_scenes():
    heights = jnp.array([0.85, 0.9, 1.3])
    batch = jax.jit(jax.vmap(lambda y: moment(y, 2)))(heights)
    np.testing.assert_allclose(batch, jnp.stack([moment(y, 2) for y in heights]), atol=1e-12)


@pytest.mark.parametrize("kind", ["straight clamped linear", "curved clamped linear"])
def test_random_scenes_obey_all_laws(kind):
    fields = [*NAMES[2:], "base_rotation", *(f + a for f in ("f", "m", "base_", "contact_") for a in "xyz")]
    touched = set()
    for seed in range(8):
        rng = np.random.default_rng([23, seed])
        scene, plain, _ = drawn_before_two(kind, rng)
        assert isinstance(plain.surface, Apart)
        result = jw.scan(scene)
        assert np.all(result.status == 0)
        touched |= set(np.unique(result.contact_object))
        steps = rng.choice(np.flatnonzero(np.asarray(result.phase)[:, 0]), 3)
        for k in steps:
            row = type("Row", (), {name: np.asarray(getattr(result, name))[k] for name in fields})
            state = state_of(row, result.control[k])
            assert max(violations(plain, state).values()) < LAWS
            offs = [abs(one.off(state.contact)) for one in plain.surface.each]
            assert np.argmin(offs) + 1 == result.contact_object[k, 0]
    assert touched == {0, 1, 2}


def test_what_is_no_surface_is_named():
    with pytest.raises(ValueError, match=r"`surface` must be a Sphere.*or a tuple of these"):
        before(PEG, jw.Circle(0.3, 0.2))
    with pytest.raises(ValueError, match=r"or a tuple of these, got \[Cylinder"):
        jw.Scene(jw.Whisker(), [PEG, BALL])


def test_scenes_with_two_objects_are_written_and_drawn(tmp_path):
    scene = before(PEG, BALL.moved((0.0, 0.1, 0.0)))
    jw.save_scene(scene, tmp_path / "scene.toml")
    assert str(jw.load_scene(tmp_path / "scene.toml")) == str(scene)
