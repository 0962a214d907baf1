"""Shapes of whiskers: they begin at the base, pass the contact, and have the right length.

In space: exact curves of free whiskers, and a published bend under a force.
"""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.shapes import shapes_of
from scenes import model

EXACT = 1e-8  # of points: the integration outwards and the scan's own integration
CONTROL = np.linspace(0.8, -1.6, 64)  # also that of test_cost.py, for the same programs
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns d1 = x, d2 = -z, d3 = y
HELIX = 1e-9  # of a length of 1: the splitting of order 6 with 43 and 21 steps
PUBLISHED = 2e-7  # of a length of 78: the digits of the reference, and 85 steps
SPHERE = jw.Sphere(1.0, (0.0, 5.0, 0.0))


@cache
def scanned():
    return jw.scan(model("FB"), CONTROL)


def test_shapes_run_from_the_base_through_the_contact_to_the_tip():
    result = scanned()
    lines = jw.shapes(result, points=200)
    assert lines.x.shape == (CONTROL.size, 1, 200)
    np.testing.assert_allclose(lines.x[..., 0], result.base_x, atol=EXACT)
    np.testing.assert_allclose(lines.y[..., 0], 0.0, atol=EXACT)
    touching = np.asarray(result.phase) != jw.Phase.free
    np.testing.assert_allclose(lines.x[..., -2][touching], result.contact_x[touching], atol=EXACT)
    np.testing.assert_allclose(lines.y[..., -2][touching], result.contact_y[touching], atol=EXACT)
    length = jnp.sum(jnp.hypot(jnp.diff(lines.x), jnp.diff(lines.y)), axis=-1)
    np.testing.assert_allclose(length, 1.0, atol=1e-4)  # chords are shorter than arcs


def test_free_whiskers_are_upright():
    result = scanned()
    lines = jw.shapes(result, points=3)
    free = np.asarray(result.phase)[:, 0] == jw.Phase.free
    assert free.any()
    np.testing.assert_allclose(lines.x[free, 0] - result.base_x[free], 0.0, atol=EXACT)
    np.testing.assert_allclose(lines.y[free, 0, -1], 1.0, atol=EXACT)


def test_positions_select_the_nearest_step():
    result, whole = scanned(), jw.shapes(scanned(), points=8)
    some = jw.shapes(result, [CONTROL[5] + 0.001, CONTROL[40] - 0.001], points=8)
    np.testing.assert_array_equal(some.x, whole.x[np.array([5, 40])])  # by the same program


def state(**fields):
    """One whisker that stands upright at the origin."""
    names = [name for name, field in jw.SpaceState.__dataclass_fields__.items() if not field.kw_only]
    none = dict.fromkeys(names, jnp.zeros(1)) | {"phase": jnp.zeros(1, int), "base_rotation": jnp.asarray([UPRIGHT])}
    return jw.SpaceState(**none | {name: jnp.asarray([value]) for name, value in fields.items()})


def points(whisker, state, count=64):
    lines = shapes_of(jw.SpaceScene(whisker, SPHERE), state, 0.0, points=count)
    return np.stack([lines.x, lines.y, lines.z], axis=-1)[0]


def test_a_free_twisted_whisker_is_a_helix():
    """With curvature k towards +z and twist T, the Darboux vector is (k, 0, T) in the body and constant in space."""
    k, twist = 0.9, 1.7
    at = points(jw.Whisker(lateral_curvature=k, twist=twist), state())
    # The integral of Rodrigues' formula for the tangent.
    omega = np.hypot(k, twist)
    axis = UPRIGHT @ np.array([k, 0.0, twist]) / omega
    assert at[5, 2] > 0  # towards -d2
    tangent = UPRIGHT[:, 2]
    along = (tangent @ axis) * axis
    for s, point in zip(np.linspace(0.0, 1.0, 64), at, strict=True):
        sin, cos = np.sin(omega * s) / omega, (1 - np.cos(omega * s)) / omega
        exact = s * along + sin * (tangent - along) + cos * np.cross(axis, tangent)
        np.testing.assert_allclose(point, exact, atol=HELIX)


def test_the_published_bend_of_45_degrees_ends_at_its_contact():
    """Bathe and Bolourchi (1979): the reaction at the base bends the arc so far that it ends at the tip."""
    arc = jw.Whisker(length=25 * np.pi, bending_stiffness=1e7 / 12, intrinsic_curvature=-0.01, torsion_ratio=1.0)
    tip = np.array([15.6850782, 47.1512944, 53.4685984])
    bent = state(
        fz=-600.0, contact_force=600.0, contact_arc=25 * np.pi, phase=1, contact_x=tip[0], contact_y=tip[1],
        contact_z=tip[2],
    )  # fmt: skip
    np.testing.assert_allclose(points(arc, bent, 128)[-1], tip, atol=PUBLISHED * 78)


def test_beyond_its_contact_a_straight_whisker_is_straight():
    bent = state(fx=1.0, contact_force=1.0, contact_arc=0.6, phase=2, contact_x=-0.2, contact_y=0.55)
    at = points(jw.Whisker(), bent)
    step = np.diff(at, axis=0)
    np.testing.assert_allclose(step[42:], np.broadcast_to(step[42], (21, 3)), atol=HELIX)
    assert np.linalg.norm(step[42:], axis=1).sum() == pytest.approx(0.4, abs=HELIX)
    assert np.abs(np.cross(step[0], step[41])).max() > 1e-6


def test_states_are_as_many_as_asked_for_and_failed_ones_are_nan():
    one = state()
    several = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), one)
    several = dataclasses.replace(several, base_x=several.base_x.at[1].set(jnp.nan))
    lines = shapes_of(jw.SpaceScene(jw.Whisker(), SPHERE), several, np.zeros(3), points=10)
    assert lines.x.shape == lines.y.shape == lines.z.shape == (3, 1, 10)
    assert np.isnan(lines.x[1]).all() and np.isfinite(lines.x[np.array([0, 2])]).all()
    np.testing.assert_allclose(lines.y[0, 0], np.linspace(0.0, 1.0, 10), atol=HELIX)


def test_shapes_have_derivatives():
    def tip(force):
        bent = state(contact_force=1.0, contact_arc=1.0, phase=1, contact_y=1.0)
        bent = dataclasses.replace(bent, fz=force[None])
        return shapes_of(jw.SpaceScene(jw.Whisker(), SPHERE), bent, 0.0, points=64).z[0, -1]

    # A small force across the tip bends a cantilever by 1/3.
    assert float(jax.grad(tip)(jnp.asarray(0.0))) == pytest.approx(-1 / 3, abs=1e-8)


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda r: jw.shapes(3), "`result` must be the Result of a scan, got 3"),  # pyright: ignore[reportArgumentType, reportCallIssue]
        (lambda r: jw.shapes(r, points=2), "`points` must be an int of at least 3, got 2"),
        (lambda r: jw.shapes(r, 0.5), r"`at` must be a non-empty one-dimensional array .*, got an array of shape \(\)"),  # pyright: ignore[reportArgumentType, reportCallIssue]
        (
            lambda r: jw.shapes(r, [0.0, 0.9]),
            "`at` must be within the drive positions of the scan, from -1.6 to 0.8, got",
        ),
        (lambda r: jw.shapes(r, [np.nan]), "`at` must be .* finite numbers, got nan at index 0"),
    ],
)
def test_wrong_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make(scanned())
