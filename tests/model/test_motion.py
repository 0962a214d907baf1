"""Motions of the drive against forward shooting, limits and moved objects; derivatives, errors."""

# pyright: reportArgumentType=false
import equinox as eqx
import forward
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.motion import Pose, frame_and_rate, pose_of
from scenes import all_ok, check_derivatives, follicle

EXACT = 1e-7  # of signals relative to their size: error of the rods' steps
SAME = 1e-9  # of signals: the same equilibria, computed in another frame
DIFFERENCES = 3e-6  # central differences lose half the digits
VISIBLE = 1e-4  # least relative change of weighted signals when a parameter doubles
FAR = 1e-2  # of signals, with a pivot 1e4 lengths away: the path is curved by 1e-4, and signals are much steeper
SIGNALS = ("base_x", "base_y", "base_angle", "fx", "fy", "mz")


def circle(distance, radius):
    return lambda slope: (radius * np.sin(slope), distance + radius * (1 - np.cos(slope)))


def turning(support, *, pivot=(-0.3, -0.5), radius=0.5, direction=1):
    return jw.Scene(jw.Whisker(), jw.Circle(0.85, 0.3), support, motion=jw.Rotation(pivot, radius, direction))


@pytest.mark.parametrize(
    "support",
    [follicle(), follicle(x=50.0, y=200.0, phi=20.0, mount=(0.02, 0.05, -0.1))],
    ids=["clamped", "follicle"],
)
def test_rotation_against_forward_shooting(support):
    result = jw.scan(turning(support))
    assert all_ok(result)
    assert next(e.kind for e in result.events) == jw.EventKind.touch
    touching = np.flatnonzero(np.asarray(result.phase)[:, 0] != jw.Phase.free)

    def drive(u):
        return -0.3 - 0.5 * np.sin(u), -0.5 + 0.5 * np.cos(u), u

    missed = forward.misses(result, touching[2 :: touching.size // 8], drive=drive, profile=circle(0.85, 0.3))
    assert max(missed.values()) < EXACT, missed


def test_the_mirror_image_turns_the_other_way():
    support = follicle(x=50.0, phi=20.0)
    result = jw.scan(turning(support), np.linspace(-0.6, 0.5, 64))
    mirrored = jw.scan(turning(support, pivot=(0.3, -0.5), direction=-1), np.linspace(0.6, -0.5, 64))
    assert all_ok(result) and all_ok(mirrored)
    for name, sign in (("base_x", -1), ("base_y", 1), ("base_angle", -1), ("fx", -1), ("fy", 1), ("mz", -1)):
        np.testing.assert_allclose(getattr(mirrored, name), sign * getattr(result, name), atol=SAME)
    np.testing.assert_allclose([e.control for e in mirrored.events], [-e.control for e in result.events], atol=SAME)


def test_a_pivot_far_away_is_a_translation():
    control = np.linspace(1.0, -1.2, 56)
    straight = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.2, 0.9), jw.Support.fb(70.0, 0.0)), control)
    missed = []
    for radius in (1e4, 1e5):
        far = turning(follicle(x=70.0), pivot=(0.0, -radius), radius=radius)
        far = eqx.tree_at(lambda s: s.profile, far, jw.Circle(0.2, 0.9))
        result = jw.scan(far, -np.arcsin(control / radius))
        assert all_ok(result) and all_ok(straight)
        missed.append(np.max(np.abs(result.mz - straight.mz)))
    # The difference is proportional to the curvature of the path.
    assert missed[0] < FAR
    assert missed[1] == pytest.approx(missed[0] / 10, rel=0.05)


class Wave(eqx.Module):
    """A motion along a line at an angle to -x, which also moves up and down and turns; all motions of this file."""

    rise: float = 0.0
    turn: float = 0.0
    start: float = 0.0
    angle: float = 0.0

    def __call__(self, u):
        x, y = self.start - u * jnp.cos(self.angle), -u * jnp.sin(self.angle)
        return x, y + self.rise * jnp.sin(2 * u), self.angle + self.turn * jnp.sin(u)


def test_a_user_defined_motion_against_forward_shooting():
    motion = jw.Motion(Wave(0.03, 0.1, 1.2), 0.0, 2.6)
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.25), follicle(x=80.0, phi=30.0), motion=motion))
    assert all_ok(result)
    kinds = [e.kind.name for e in result.events]
    assert kinds[0] == "touch" and kinds[-1] == "snap_off"
    touching = np.flatnonzero(np.asarray(result.phase)[:, 0] != jw.Phase.free)

    def drive(u):
        return 1.2 - u, 0.03 * np.sin(2 * u), 0.1 * np.sin(u)

    missed = forward.misses(result, touching[2 :: touching.size // 8], drive=drive)
    assert max(missed.values()) < EXACT, missed


def test_translation_written_as_a_motion_is_translation():
    control = np.linspace(1.0, -1.5, 64)
    plain = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.0)), control)
    motion = jw.Motion(Wave(start=1.2), 0.0, 3.0)
    own = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), follicle(x=70.0), motion=motion), 1.2 - control)
    for name in SIGNALS:
        np.testing.assert_allclose(getattr(own, name), getattr(plain, name), atol=SAME)
    assert [(e.kind, e.whiskers) for e in own.events] == [(e.kind, e.whiskers) for e in plain.events]
    np.testing.assert_allclose([1.2 - e.control for e in own.events], [e.control for e in plain.events], atol=SAME)


def test_a_scan_from_the_left_is_the_mirror_image():
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2))
    back = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, -0.2), motion=jw.Translation(1))
    one, other = jw.scan(scene), jw.scan(back)
    np.testing.assert_allclose(other.control, -one.control, atol=SAME)
    np.testing.assert_allclose(other.mz, -one.mz, atol=SAME)
    np.testing.assert_allclose([e.control for e in other.events], [-e.control for e in one.events], atol=SAME)


def test_scans_in_both_directions_have_the_same_poses_without_a_static_direction():
    clockwise, left = jw.Rotation((0.3, -0.2), 0.4, direction=-1), jw.Translation(direction=1)
    for motion in (clockwise, left):
        same = motion.undirected()
        np.testing.assert_array_equal(motion.pose(0.7), same.pose(0.7))
        assert jax.tree.structure(same) == jax.tree.structure(type(motion)()) != jax.tree.structure(motion)
    bob = jw.Motion(lambda u: (1.2 - u, 0.0, 0.0), start=0.0, stop=2.6)
    assert bob.undirected() is bob


def test_moving_the_object_is_moving_the_whisker():
    control = np.linspace(-0.5, 0.4, 32)
    shifted = turning(follicle(x=50.0, phi=20.0), pivot=(0.1, -0.4))
    shifted = eqx.tree_at(lambda s: s.profile, shifted, jw.Circle(0.95, 0.3, 0.4))
    one, other = jw.scan(turning(follicle(x=50.0, phi=20.0)), control), jw.scan(shifted, control)
    for name in ("fx", "fy", "mz", "base_angle"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=SAME)
    np.testing.assert_allclose(other.base_x, one.base_x + 0.4, atol=SAME)
    np.testing.assert_allclose(other.base_y, one.base_y + 0.1, atol=SAME)


def test_starting_inside_the_object_is_lost():
    motion = jw.Motion(Wave(start=1.2), 1.2, 2.0)
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), follicle(x=70.0), motion=motion)
    result = jw.scan(scene, np.linspace(1.2, 1.7, 8))
    assert np.all(result.status == jw.Status.lost)
    assert np.all(np.isnan(result.mz))


def test_a_motion_with_nan_gives_no_result():
    motion = jw.Motion(Wave(np.nan, start=1.2), 0.0, 3.0)
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), follicle(x=70.0), motion=motion)
    result = jw.scan(scene, np.linspace(0.0, 2.5, 8))
    assert np.all(result.status != jw.Status.ok)
    assert np.all(np.isnan(result.mz)) and np.all(np.isnan(result.base_y))


def test_poses():
    assert jw.Translation().pose(0.3) == (0.3, 0.0, 0.0)
    turned = jw.Rotation((0.1, -0.4), 0.5).pose(0.3)
    np.testing.assert_allclose(jnp.stack(turned), [0.1 - 0.5 * np.sin(0.3), -0.4 + 0.5 * np.cos(0.3), 0.3], atol=1e-15)
    user_defined = jw.Motion(Wave(0.3, 0.1, 1.2), 0.0, 2.0).pose(0.5)
    np.testing.assert_allclose(jnp.stack(user_defined), [0.7, 0.3 * np.sin(1.0), 0.1 * np.sin(0.5)], atol=1e-15)


def test_a_pose_is_three_arrays_of_floats():
    for motion in (jw.Translation(), jw.Rotation((0, -1), 1), jw.Motion(Wave(), 0.0, 2.0)):
        pose = pose_of(motion, 1)
        assert isinstance(pose, Pose) and {jnp.asarray(part).dtype for part in pose} == {np.dtype(float)}
        assert all(isinstance(part, jax.Array) for part in pose)
        np.testing.assert_array_equal(jnp.stack(pose), jnp.stack([jnp.asarray(part) for part in motion.pose(1)]))


def test_directions_and_units():
    assert (jw.Translation().onwards, jw.Translation().ends, jw.Translation().unit(3.0)) == (-1, None, 3.0)
    clockwise = jw.Rotation(direction=-1)
    assert (clockwise.onwards, clockwise.ends, clockwise.unit(3.0)) == (-1, (np.pi / 2, -np.pi / 2), 1.0)
    falling = jw.Motion(Wave(), 2.0, -1.0)
    assert (falling.onwards, falling.ends, falling.unit(3.0)) == (-1, (2.0, -1.0), 3.0)


def test_frames_of_mounts_and_their_derivative():
    motion, mounts = jw.Rotation((0.1, -0.4), 0.5), Pose(jnp.array([0.2]), jnp.array([0.3]), jnp.array([0.4]))
    frame, rate = frame_and_rate(motion.pose, mounts, jnp.asarray(0.3))
    cos, sin = np.cos(0.3), np.sin(0.3)
    x, y = 0.1 - 0.5 * sin + 0.2 * cos - 0.3 * sin, -0.4 + 0.5 * cos + 0.2 * sin + 0.3 * cos
    np.testing.assert_allclose(np.ravel(frame), [x, y, np.cos(0.7), np.sin(0.7)], atol=1e-15)
    # The rotation moves the frame at right angles to its distance from the pivot.
    np.testing.assert_allclose(np.ravel(rate), [-(y + 0.4), x - 0.1, -np.sin(0.7), np.cos(0.7)], atol=1e-15)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Motion(3.0, 0.0, 1.0), r"`function` must be a function .* returns \(x, y, angle\), got 3.0"),
        (lambda: jw.Motion(lambda u: (u, 0.0), 0.0, 1.0), r"`function` .* \(x, y, angle\), got <lambda>, .* 2 values"),
        (lambda: jw.Motion(lambda u: u, 0.0, 1.0), r"`function` .* \(x, y, angle\), got <lambda>, .* shape \(\)"),
        (lambda: jw.Motion(lambda u: (u, jnp.ones(2), 0), 0.0, 1.0), r"`function` .* array of shape \(2,\)"),
        (
            lambda: jw.Motion(lambda u: (u, 0.0, 0.1 if u > 1 else 0.0), 0.0, 1.0),
            "`function` must be a function that JAX can trace, got <lambda>, .* jnp.where instead of `if`",
        ),
        (
            lambda: jw.Motion(lambda u: (u, 0.0, 0.0), 1.0, 1.0),
            "`stop` must be different from `start`, got 1.0 for both",
        ),
        (lambda: jw.Translation(0), "`direction` must be -1 or 1, got 0"),
        (lambda: jw.Rotation(direction=True), "`direction` must be -1 or 1, got True"),
        (lambda: jw.Rotation(pivot=1.0), "`pivot` must be a pair of numbers, got 1.0"),
    ],
)
def test_wrong_motions(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# Stiffnesses along x, y, phi; rest lengths; mount; pivot, radius; distance and radius of the object, its tilt.
P = jnp.array(np.r_[50.0, 200.0, 20.0, 0.02, 0.03, 0.05, 0.02, 0.04, -0.1, -0.3, -0.5, 0.5, 0.85, 0.3, 0.1, 0.1, 0.7])


def observed(p):
    springs = tuple(jw.Spring((0, 1), p[k], p[3 + k], axis) for k, axis in enumerate(("x", "y", "phi")))
    scene = jw.Scene(
        jw.Whisker(),
        jw.Tilted(jw.Circle(p[12], p[13]), p[14], (p[15], p[16])),
        jw.Support(springs, jw.Mount(p[6], p[7], p[8])),
        motion=jw.Rotation((p[9], p[10]), p[11]),
    )
    result = jw.scan(scene, jnp.array([-0.4, -0.1, 0.1]))
    events = result.events
    signals = [result.fx, result.fy, result.mz, result.base_x, result.base_y, result.base_angle]
    return jnp.concatenate([*(jnp.ravel(s) for s in signals), jnp.ravel(result.spring_length), events.control[:1]])


def test_derivatives_by_all_parameters_of_supports_and_motions():
    # One program: no other test uses this problem shape.
    check_derivatives(observed, P, seed=5, differences=DIFFERENCES, visible=VISIBLE, jit=True)


def test_tilting_the_object_is_turning_everything_else():
    # In the frame of a parabola that is tilted by tau, the whisker leans by -tau and moves along a line that does.
    tau, control = 0.15, np.linspace(1.1, -0.9, 33)
    tilted = jw.scan(jw.Scene(jw.Whisker(), jw.Tilted(jw.Parabola(0.2), tau), follicle(x=90.0, phi=30.0)), control)
    way = jw.Motion(Wave(angle=-tau), -1.5, 2.0)
    turned = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), follicle(x=90.0, phi=30.0), motion=way), -control)
    assert all_ok(tilted) and all_ok(turned)
    assert np.max(np.asarray(tilted.contact_force)) > 1
    cos, sin = np.cos(tau), np.sin(tau)
    for one, right, up in ((tilted.fx, turned.fx, turned.fy), (tilted.base_x, turned.base_x, turned.base_y)):
        np.testing.assert_allclose(one, right * cos - up * sin, atol=SAME)
    np.testing.assert_allclose(tilted.fy, turned.fx * sin + turned.fy * cos, atol=SAME)
    np.testing.assert_allclose(tilted.mz, turned.mz, atol=SAME)
    np.testing.assert_allclose(tilted.base_angle, turned.base_angle + tau, atol=SAME)
    kinds = [[e.kind for e in result.events if e.kind != jw.EventKind.vertex] for result in (tilted, turned)]
    assert kinds[0] == kinds[1]
