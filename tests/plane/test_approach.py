"""How drives come to the object and leave it: translations from far away, and bounded motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from exact_contacts import DISTANCE, scene
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._path.path import NO_EVENT, EventKind, Node, Path, Status
from jaxwhisker._plane.approach import FAR, FIRST_STEP, GLANCES, HIGHEST_FORCE, MARGIN, Bounded, FromAfar, approach_of

ROUNDING = 1e-14
TOUCH = np.sqrt(1 - DISTANCE)  # of an upright whisker of length 1 before y = x^2 + DISTANCE
REST = (0.2, 0.15)


def afar(direction=-1, distance=DISTANCE, stiffness=70.0):
    """FBFB before an object, from one side."""
    support = jw.Support.fbfb(stiffness, list(REST))
    motion = jw.Translation(direction)
    problem = dimensionless(jw.Scene(jw.Whisker(), jw.Parabola(distance), support, jw.ClosedForm(), motion))
    approach = approach_of(problem)
    assert isinstance(approach, FromAfar)
    return approach


def turning():
    """A clamped whisker on a turning drive."""
    approach = approach_of(dimensionless(scene(jw.Support.clamped(), motion=jw.Rotation((0.0, -0.5), 0.5))))
    assert isinstance(approach, Bounded)
    return approach


def test_the_first_whisker_to_touch():
    # The drive leads: from the right whisker 1 touches first, from the left whisker 2, which trails on the right.
    np.testing.assert_allclose(afar(-1).first_touch(), TOUCH - REST[0], rtol=ROUNDING)
    np.testing.assert_allclose(afar(+1).first_touch(), -TOUCH - sum(REST), rtol=ROUNDING)


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_scan_starts_ahead_of_the_first_touch_or_at_its_first_position(direction):
    approach = afar(direction)
    first = float(approach.first_touch())
    # A first stop beyond the first touch, and one before it.
    assert abs(approach.start(first + direction * 0.5) - (first - direction * FIRST_STEP)) < ROUNDING
    assert approach.start(first - direction * 0.5) == first - direction * 0.5
    assert approach.starts_clear(first)
    assert approach.longest_step() == np.inf


@pytest.mark.parametrize("direction", [-1, 1])
def test_out_of_reach_a_scan_starts_at_its_first_position(direction):
    approach = afar(direction, distance=1.5)
    assert not np.isfinite(approach.first_touch())
    assert approach.start(0.4) == 0.4
    # Its default control still crosses the object.
    start, end, _ = (float(value) for value in approach.limits()[:3])
    assert np.isfinite([start, end]).all()
    assert direction * start < 0 < direction * (end + np.mean([REST[0], sum(REST)])) + 1


@pytest.mark.parametrize("direction", [-1, 1])
def test_nothing_happens_any_more_when_all_whiskers_are_free_beyond_the_object(direction):
    approach = afar(direction)
    beyond, before = direction * 1.2, -direction * 1.2

    def over(phase, side, x):
        state = ContactState(jnp.asarray(phase), jnp.asarray(side))
        return bool(approach.is_over(state, approach.problem.stance(0.0, jnp.asarray(x)[:, None])))

    free, touching = int(Phase.free), int(Phase.tip)
    far_side = [float(direction)] * 2
    assert over([free, free], far_side, [beyond, beyond])
    assert not over([free, touching], far_side, [beyond, beyond])
    assert not over([free, free], far_side, [beyond, before])
    # Free, but still on the side from which it came: it has yet to touch.
    assert not over([free, free], [float(direction), -float(direction)], [beyond, beyond])


def test_the_range_across_the_object_grows_with_soft_springs():
    for direction in (-1, 1):
        approach = afar(direction, stiffness=1e-3)
        start, end, far = (float(value) for value in approach.limits()[:3])
        assert abs(start - (float(approach.first_touch()) - direction * MARGIN)) < ROUNDING
        # The base that yields most carries the load of both whiskers through two springs.
        softness = HIGHEST_FORCE * (1 + 2) / 1e-3
        np.testing.assert_allclose(far, start + direction * (FAR + softness), rtol=ROUNDING)
        assert direction * (end - start) > 0


def test_a_bounded_motion_lies_between_its_ends():
    approach = turning()
    right_angle = np.pi / 2
    assert approach.limits()[:3] == (-right_angle, right_angle, right_angle)
    assert approach.start(0.3) == -right_angle
    assert approach.start(-2.0) == -2.0
    np.testing.assert_allclose(approach.longest_step(), np.pi / GLANCES, rtol=ROUNDING)
    state = ContactState(jnp.zeros(1, int), -jnp.ones(1))
    assert not approach.is_over(state, approach.problem.stance(right_angle, jnp.zeros((1, 3))))


def test_ends_are_in_units_of_the_control():
    motion = jw.Motion(lambda u: (1 - u / 5, 0.0, 0.0), start=-2.0, stop=8.0)
    approach = approach_of(dimensionless(scene(jw.Support.clamped(), motion=motion)))
    assert float(approach.problem.unit.control) == 10.0
    np.testing.assert_allclose(np.array(approach.limits()[:3]), [-0.2, 0.8, 0.8], rtol=ROUNDING)


def test_a_bounded_motion_must_start_clear_of_the_object():
    approach = turning()
    # Turned by a right angle, the whisker lies beside the object at height -0.5; upright, it would stand inside.
    assert approach.starts_clear(jnp.asarray(-np.pi / 2))
    assert not approach.starts_clear(jnp.asarray(0.0))


def path_of(approach, controls, kinds, phase=Phase.free, status=Status.ok, room=6):
    """A path through these controls, padded."""
    n, count = approach.problem.length.shape[0], len(controls)
    u = jnp.asarray(np.pad(controls, (0, room - count)))
    z, flag = jnp.zeros((room, n, 3)), jnp.zeros((room, n), bool)
    phases = jnp.zeros((room, n), int).at[count - 1].set(int(phase))
    kind = jnp.asarray(np.pad(kinds, (0, room - count), constant_values=EventKind.touch))
    travel = jnp.abs(u - u[0])
    point, state = Point(z, u), ContactState(phases, jnp.ones((room, n)))
    node = Node(point, z, point, point, state, state, travel, kind, flag)
    return Path(node, jnp.asarray(count), jnp.asarray(int(status)))


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_default_control_ends_after_the_last_event(direction):
    approach = afar(direction)
    limits = approach.limits()
    controls = direction * np.array([-0.8, -0.5, 0.4, 0.9])
    kinds = [NO_EVENT, EventKind.touch, EventKind.snap_off, NO_EVENT]
    _, start, stop = approach.crop(path_of(approach, controls, kinds), jnp.asarray(True), limits)
    assert start == limits.start
    np.testing.assert_allclose(stop, direction * (0.4 + MARGIN), rtol=ROUNDING)
    # A path that is lost is followed to its end; one without events to the end of the range.
    _, _, stop = approach.crop(path_of(approach, controls, kinds, status=Status.lost), jnp.asarray(True), limits)
    np.testing.assert_allclose(stop, direction * (0.9 + MARGIN), rtol=ROUNDING)
    _, _, stop = approach.crop(path_of(approach, controls, [NO_EVENT] * 4), jnp.asarray(True), limits)
    np.testing.assert_allclose(stop, limits.end + direction * MARGIN, rtol=ROUNDING)


def test_a_bounded_scan_is_cropped_on_both_sides():
    approach = turning()
    limits = approach.limits()
    controls, kinds = [-1.5, -0.5, 0.4, 0.9], [NO_EVENT, EventKind.touch, EventKind.release, NO_EVENT]
    path = path_of(approach, controls, kinds)
    cropped, start, stop = approach.crop(path, jnp.asarray(True), limits)
    np.testing.assert_allclose(np.array([start, stop]), [-0.5 - MARGIN, 0.4 + MARGIN], rtol=ROUNDING)
    # Travel counts from the new start.
    shift = start - limits.start
    np.testing.assert_allclose(path.nodes.travel[:4] - cropped.nodes.travel[:4], shift, rtol=ROUNDING)
    as_given, *_ = approach.crop(path, jnp.asarray(False), limits)
    assert np.array_equal(as_given.nodes.travel, path.nodes.travel)
    # While a whisker touches, the scan goes on to the end of the motion.
    _, _, stop = approach.crop(path_of(approach, controls, kinds, Phase.tip), jnp.asarray(True), limits)
    assert stop == limits.far
    _, start, _ = approach.crop(path_of(approach, controls, [NO_EVENT] * 4), jnp.asarray(True), limits)
    assert start == limits.start
    assert jax.tree.structure(cropped) == jax.tree.structure(path)
