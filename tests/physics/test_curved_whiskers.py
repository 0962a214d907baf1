"""Whiskers that are curved when unloaded, and cones: forward shooting, limits, first touch, derivatives."""

from functools import cache

import forward
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._model.along import LinearTaper
from scenes import all_ok, check_derivatives, cone

EXACT = 1e-7  # of signals relative to their size: error of the rods' steps
SAME = 1e-9  # of signals relative to their size: the same rod, computed in another way
ARC = 1e-10  # of a circle's points and of constant curvatures
DIFFERENCES = 1e-6  # central differences lose half the digits
DIFFERENCE = 1e-5
VISIBLE = 1e-2  # least relative change of weighted signals when a parameter doubles

CONTROL = np.linspace(1.2, -1.6, 113)
SIGNALS = ("base_x", "fx", "fy", "mz")


RIGID = jw.Support.fb(np.inf, 0.0)  # a clamp with the programs of a spring


def curved(kappa, whisker=None, support=None, profile=None):
    """A scene whose equilibria are those of one contact, even where the shaft passes into the object elsewhere."""
    whisker = jw.Whisker(intrinsic_curvature=kappa) if whisker is None else whisker
    return jw.Scene(whisker, profile or jw.Parabola(0.2), support or jw.Support.fb(70.0, 0.2), detect=())


SCENES = {
    "towards": curved(0.6),
    "away": curved(-0.6),
    "clamped": curved(0.5, support=RIGID),
    "cone": curved(None, cone(0.2, curvature=(0.0, 0.0))),
    "conical spiral": curved(None, cone(0.25, curvature=(0.3, 0.8))),
}


@cache
def scanned(name):
    return jw.scan(SCENES[name], CONTROL)


@pytest.mark.parametrize("name", SCENES)
def test_against_forward_shooting(name):
    result, phases = scanned(name), set()
    touching = np.flatnonzero((np.asarray(result.phase)[:, 0] != jw.Phase.free) & (np.asarray(result.mz)[:, 0] > 0))
    assert all_ok(result)
    missed = forward.misses(result, touching[2 :: max(1, touching.size // 8)], phases=phases)
    assert max(missed.values()) < EXACT, missed
    assert phases == {jw.Phase.tip, jw.Phase.tangential}


def test_zero_curvature_is_a_straight_whisker():
    straight, zero = jw.scan(curved(None), CONTROL), jw.scan(curved(0.0), CONTROL)
    for name in SIGNALS:
        assert np.max(np.abs(getattr(zero, name) - getattr(straight, name))) < SAME * np.max(np.abs(straight.mz))
    np.testing.assert_allclose([e.control for e in zero.events], [e.control for e in straight.events], atol=SAME)


@pytest.mark.parametrize("kappa", [-0.3, 0.8])
def test_the_first_touch_of_an_arc_by_its_tip(kappa):
    # Clamped, no springs: the tip of a circular arc meets the parabola at its own height.
    tip_x, tip_y = -(1 - np.cos(kappa)) / kappa, np.sin(kappa) / kappa
    result = jw.scan(curved(kappa, support=RIGID))
    touch = next(iter(result.events))
    assert touch.kind == jw.EventKind.touch
    assert touch.control == pytest.approx(np.sqrt(tip_y - 0.2) - tip_x, abs=ARC)


def test_the_first_touch_of_an_arc_by_its_shaft():
    # The whisker bends away from a small ball whose centre is below the tip: circle touches circle.
    kappa, radius, distance = -0.5, 0.1, 0.4
    result = jw.scan(curved(kappa, support=RIGID, profile=jw.Circle(distance, radius)))
    touch = next(iter(result.events))
    # The centre of the whisker's circle is at base_x + 1/|kappa|; the ball touches it from outside, on the left.
    apart = np.sqrt((1 / abs(kappa) + radius) ** 2 - (distance + radius) ** 2)
    assert touch.after.phase[0] == jw.Phase.tangential
    assert touch.control == pytest.approx(apart - 1 / abs(kappa), abs=ARC)


def test_moving_from_the_other_side_is_the_mirror_image():
    # A scan to the left and back to the right: on the way back, the whisker is curved away from the object.
    support = jw.Support.fb(70.0, 0.0)
    turning = np.concatenate([np.linspace(1.3, -2.0, 50), np.linspace(-2.0, 1.5, 50)[1:]])
    there = jw.scan(curved(0.4, support=support), turning)
    mirrored = jw.scan(curved(-0.4, support=support), -turning[49:])
    assert all_ok(there) and all_ok(mirrored)
    np.testing.assert_allclose(there.mz[49:], -mirrored.mz, atol=SAME * 10)


def test_a_whisker_that_touches_during_a_snap_keeps_its_contact():
    # Where it touches is known to 1e-9 only: the new contact would pull a little, and must not end at once for that.
    whisker = cone(0.1365558056854707, curvature=(0.7514765001311368, 0.5371876867275924))
    support, profile = jw.Support.fb(43.88185254548893), jw.Parabola(0.21644107437614563)
    result = jw.scan(curved(None, whisker, support, profile), CONTROL)
    assert all_ok(result)
    (snap,) = result.events.of(jw.EventKind.snap_through)
    assert snap.before.mz[0] > 0 > snap.after.mz[0]


def test_an_unloaded_arc_keeps_its_shape():
    kappa = 0.7
    d = jw.deflect(jw.Whisker(intrinsic_curvature=kappa), jw.PointForce(0.0, position=0.6))
    np.testing.assert_allclose(d.curvature, kappa, atol=ARC)
    np.testing.assert_allclose(d.x, -(1 - np.cos(kappa * np.asarray(d.s))) / kappa, atol=ARC)
    np.testing.assert_allclose(d.y, np.sin(kappa * np.asarray(d.s)) / kappa, atol=ARC)


def test_a_moment_at_the_tip_shifts_the_curvature_everywhere():
    whisker = jw.Whisker(1.0, LinearTaper(2.0, 1.0, 1.0), LinearTaper(0.3, 0.8, 1.0))
    d = jw.deflect(whisker, jw.PointMoment(0.4), points=50)
    s = np.asarray(d.s)[:50]  # beyond the moment, at the tip, the curvature is intrinsic
    np.testing.assert_allclose(d.curvature[:50], 0.3 + 0.5 * s + 0.4 / (2.0 - s), atol=ARC)


def test_free_whiskers_have_their_unloaded_shape():
    result = scanned("towards")
    line = jw.shapes(result, CONTROL[:1])
    x, y = np.asarray(line.x)[0, 0], np.asarray(line.y)[0, 0]
    angle = 0.6 * np.linspace(0, 1, 200)
    np.testing.assert_allclose(x[-1] - x[0], -(1 - np.cos(angle[-1])) / 0.6, atol=ARC)
    np.testing.assert_allclose(y[-1], np.sin(angle[-1]) / 0.6, atol=ARC)


# Length, Young's modulus, diameters at base and tip, curvatures at base and tip, stiffness of the spring.
P = jnp.array([1.0, 64e4 / np.pi, 0.1, 0.03, 0.3, 0.7, 70.0])


def observed(p):
    """Signals before and after the vertex and on the far side; positions of the first events, including a snap."""
    length, modulus, base, tip, first, last, c = p
    stiffness = jw.Whisker.conical(length, modulus, base, tip).bending_stiffness
    whisker = jw.Whisker(length, stiffness, LinearTaper(first, last, length))
    control = jnp.array([0.65, 0.3, -0.1, -0.4, -0.7, -1.6])
    result = jw.scan(jw.Scene(whisker, jw.Parabola(0.2), jw.Support.fb(c, 0.2), detect=()), control)
    return jnp.concatenate([result.fx[:5, 0], result.mz[:5, 0], result.events.control[:3]])


def test_derivatives_by_all_parameters_of_a_whisker():
    check_derivatives(observed, P, seed=3, differences=DIFFERENCES, visible=VISIBLE)


def test_a_whisker_that_curls_up_is_invalid_in_a_batch():
    kappa = jnp.array([0.4, 1.6])
    mz, status = jax.vmap(lambda k: (lambda r: (r.mz, r.status))(jw.scan(curved(k), CONTROL[::16])))(kappa)
    assert np.all(status[1] == jw.Status.invalid) and np.all(np.isnan(mz[1]))
    assert np.all(status[0] == jw.Status.ok) and np.all(np.isfinite(mz[0]))


def test_a_whisker_that_would_touch_in_two_places_is_an_error():
    # The whisker leans away and then over the object: its lower half and its tip protrude.
    def bent(growth):
        return cone(1.0, curvature=(-3.0 * growth / 8, 5.0 * growth / 8))

    with pytest.raises(ValueError, match=r"`intrinsic_curvature` must let .* in one place only"):
        jw.scan(curved(None, bent(8.0), RIGID, jw.Parabola(0.2, 10.0)), CONTROL[::16])
    # A flatter object meets the same whisker at its tip only.
    assert all_ok(jw.scan(curved(None, bent(8.0), RIGID, jw.Parabola(0.2, 0.3)), CONTROL[:32:8]))

    def status(growth):
        return jw.scan(curved(None, bent(growth), RIGID, jw.Parabola(0.2, 10.0)), CONTROL[::16]).status

    each = jax.vmap(status)(jnp.array([8.0, 2.0]))
    assert np.all(each[0] == jw.Status.invalid)
    assert np.all(each[1] == jw.Status.ok)


def test_a_tip_may_touch_above_the_widest_place_of_an_object():
    whisker, a, b, low = jw.Whisker(intrinsic_curvature=0.7), 0.073, 0.363, 0.31

    def moments(distance):
        scene = jw.Scene(whisker, jw.Ellipse(distance, a, b), jw.Support.fb(70.0))
        return jw.scan(scene, np.linspace(0.18, -0.04, 12))

    result = moments(low)
    assert np.all(np.asarray(result.status) == jw.Status.ok) and np.all(np.asarray(result.phase) == jw.Phase.tip)
    shapes = jw.shapes(result)
    base, (x, y) = np.asarray(shapes.x)[:, 0, 0], (np.asarray(s)[:, 0, -1] for s in (shapes.x, shapes.y))
    assert np.all(y > low + b)
    np.testing.assert_allclose((x / a) ** 2 + ((y - low - b) / b) ** 2, 1.0, atol=SAME)
    angle = np.arctan2((y - low - b) / b**2, x / a**2)  # of the outward normal
    reaction = np.stack([np.asarray(result.fx)[:, 0], np.asarray(result.fy)[:, 0]])
    size = np.hypot(*reaction)
    np.testing.assert_allclose(reaction, -size * np.stack([np.cos(angle), np.sin(angle)]), atol=SAME)
    # The same force at the tip of a clamped whisker bends it to the same place.
    bend = jax.jit(jax.vmap(lambda force, angle: jw.deflect(whisker, jw.PointForce(force, direction=angle))))
    bent = bend(jnp.asarray(size), jnp.asarray(angle))
    np.testing.assert_allclose(bent.x[:, -1], x - base, atol=SAME)
    np.testing.assert_allclose(bent.y[:, -1], y, atol=SAME)
    np.testing.assert_allclose(bent.mz, np.asarray(result.mz)[:, 0], atol=SAME)
    above, below = (np.asarray(moments(low + d).mz) for d in (DIFFERENCE, -DIFFERENCE))
    slope = jax.jvp(lambda q: moments(q).mz, (low,), (1.0,))[1]
    np.testing.assert_allclose(slope, (above - below) / (2 * DIFFERENCE), rtol=DIFFERENCES)
