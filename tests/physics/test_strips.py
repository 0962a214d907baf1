"""Strips, which bend in one direction more easily than in the other: reductions to the plane, laws, closed forms."""

# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from random_space import drawn
from space_laws import shaft, stability, state_of, violations

STEPS = 1e-8  # scans in the plane and in space take other integration steps
LAWS = 1e-8  # the states are solved to 1e-10, and the laws are integrated to 1e-12
EXACT = 1e-9
DIFFERENCES = 2e-6  # relative error of central differences with steps of 1e-5
TORSION = 4e-4  # relative; the tables have four digits
ALONG = jw.LinearDrive((-1.0, 0.0, 0.0))
CYLINDER = jw.Cylinder(0.6, (0.0, 1.1, 0.0), (0.0, 0.0, 1.0))
CONTROL = np.linspace(-0.7, 1.2, 39)
BESIDE = jw.Sphere(1.0, (0.0, 1.3, -0.3))
NAMES = "force", "moment"


def scanned(whisker, roll, surface=BESIDE, control=CONTROL):
    return jw.scan(jw.SpaceScene(whisker, surface, jw.Support(mount=jw.Mount(roll=roll)), motion=ALONG), control)


@pytest.mark.parametrize(("ratio", "roll", "stiffness"), [(25.0, 0.0, 1.0), (0.04, np.pi / 2, 0.04)])
def test_across_a_cylinder_a_strip_bends_in_the_plane(ratio, roll, stiffness):
    """Flat or on edge; the drive moves towards -x with the control, that in the plane against it."""
    plane = jw.scan(jw.Scene(jw.Whisker(), jw.Circle(0.5, 0.6)), -CONTROL)
    found = scanned(jw.Whisker(lateral_ratio=ratio), roll, CYLINDER)
    assert np.all(found.status == 0) and np.max(plane.contact_force) > 1
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(found, name) / stiffness, getattr(plane, name), atol=STEPS, err_msg=name)
    for name in ("fz", "mx", "my"):
        np.testing.assert_allclose(getattr(found, name), 0.0, atol=STEPS)
    events = [(event.kind, -event.control) for event in plane.events if event.kind != jw.EventKind.vertex]
    assert [event.kind for event in found.events] == [kind for kind, _ in events]
    np.testing.assert_allclose([event.control for event in found.events], [u for _, u in events], atol=STEPS)


def test_as_stiff_in_all_directions_is_no_strip():
    round_, strip = (jw.Whisker(twist=0.3, **own) for own in ({}, {"lateral_ratio": 1.0}))
    for name in NAMES:
        np.testing.assert_allclose(*(getattr(scanned(w, 0.4), name) for w in (round_, strip)), atol=EXACT)


class Step:
    """The fields of one step of a result."""

    def __init__(self, result, step):
        self.result, self.step = result, step

    def __getattr__(self, name):
        return np.asarray(getattr(self.result, name))[self.step]


@pytest.mark.filterwarnings("ignore:The scan touches nothing")
@pytest.mark.parametrize("kind", ["straight strip clamped linear", "curved strip sprung linear"])
def test_random_strips_obey_the_laws(kind):
    checked = 0
    for number in range(8):
        scene, plain, text = drawn(kind, np.random.default_rng([78, number]))
        found = jw.scan(scene)
        good = np.flatnonzero(np.asarray(found.status) == jw.Status.ok)
        touching = good[np.asarray(found.phase)[good, 0] > 0]
        for step in touching[:: max(1, touching.size // 3)]:
            state = state_of(Step(found, step), float(found.control[step]))
            worst = max(violations(plain, state, shaft(plain, state)).items(), key=lambda law: law[1])
            assert worst[1] < LAWS, (text, step, worst)
            assert stability(plain, state) > 0, (text, step)
            checked += 1
    assert checked > 12


def signals(p):
    strip = jw.Whisker(lateral_ratio=p[0], torsion_ratio=p[1], intrinsic_curvature=0.2)
    found = scanned(strip, p[2], control=CONTROL[::3])
    return jnp.concatenate([found.force.ravel(), found.moment.ravel(), found.events.control[:2]])


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_agree_with_differences(mode):
    values, step = jnp.array([6.0, 1.4, 0.5]), 1e-5
    found = np.asarray(mode(signals)(values))
    for k in range(3):
        ends = [np.asarray(signals(values.at[k].add(sign * step))) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        scale = np.max(np.abs(expected))
        assert scale > 1e-3
        np.testing.assert_allclose(found[:, k], expected, atol=DIFFERENCES * (scale + 1), err_msg=str(k))


def test_batches_and_compiled_scans_equal_eager_ones():
    values = jnp.array([6.0, 1.4, 0.5])
    batch = np.asarray(jax.vmap(signals)(jnp.stack([values, values.at[0].set(-1.0), values * 1.02])))
    assert np.all(np.isnan(batch[1]))
    np.testing.assert_allclose(batch[0], signals(values), atol=EXACT)
    np.testing.assert_allclose(batch[2], signals(values * 1.02), atol=EXACT)
    np.testing.assert_allclose(jax.jit(signals)(values), batch[0], atol=EXACT)


def test_bending_of_a_strip_is_moment_over_stiffness():
    found = scanned(jw.Whisker(lateral_ratio=6.0), 0.5)
    bent = jw.bending(found, at=(0.0, 0.3))
    moment, curvature = np.asarray(bent.moment), np.asarray(bent.curvature)
    assert np.nanmax(np.abs(moment[..., 0])) > 0.1
    np.testing.assert_allclose(curvature[..., 0] * 6.0, moment[..., 0], atol=EXACT)
    np.testing.assert_allclose(curvature[..., 1], moment[..., 1], atol=EXACT)


# Given loads


def test_a_strip_bends_under_a_load_as_in_the_plane_of_the_load():
    side, ahead = jw.SpaceForce(0.0, 0.0, -2.0), jw.SpaceForce(-2.0, 0.0, 0.0)
    strip = jw.deflect(jw.Whisker(lateral_ratio=4.0), side)
    plain = jw.deflect(jw.Whisker(), jw.SpaceForce(0.0, 0.0, -0.5))
    for name in "xyz":
        np.testing.assert_allclose(getattr(strip, name), getattr(plain, name), atol=EXACT)
    flat, same = jw.deflect(jw.Whisker(lateral_ratio=4.0), ahead), jw.deflect(jw.Whisker(), ahead)
    np.testing.assert_allclose(flat.x, same.x, atol=EXACT)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_strip_buckles_about_its_weak_axis(share):
    ratio = 0.3
    push = jw.SpaceForce(0.0, -share * ratio * np.pi**2 / 4, 0.0)
    found = jw.deflect(jw.Whisker(lateral_ratio=ratio), push)
    assert (int(found.status) == jw.Status.ok) == (share < 1)


@pytest.mark.parametrize("share", [0.97, 1.03])
def test_a_strip_on_edge_tips_over_sideways(share):
    """Prandtl's lateral buckling of a cantilever: P L^2 = 4.0126 sqrt(B1 C) where both are small."""
    ratio, torsion = 1e-3, 2e-3
    force = jw.SpaceForce(-share * 4.0126 * np.sqrt(ratio * torsion), 0.0, 0.0)
    found = jw.deflect(jw.Whisker(lateral_ratio=ratio, torsion_ratio=torsion), force)
    assert (int(found.status) == jw.Status.ok) == (share < 1)


# Whiskers


@pytest.mark.parametrize(("slenderness", "torsion"), [(1.0, 0.1406), (2.0, 0.2287), (5.0, 0.2913), (50.0, 0.3291)])
def test_a_rectangle_has_the_torsion_of_the_tables(slenderness, torsion):
    """J / (w t^3), Timoshenko and Goodier (1970), table 7."""
    strip = jw.Whisker.strip(0.1, 2e11, slenderness * 1e-4, 1e-4, density=8000.0, poisson_ratio=0.25)
    stiffness = 2e11 * slenderness * 1e-16 / 12
    assert float(strip.bending_stiffness) == pytest.approx(stiffness, rel=1e-12)
    assert float(strip.lateral_ratio) == pytest.approx(slenderness**2, rel=1e-12)
    assert float(strip.torsion_ratio) * stiffness == pytest.approx(
        torsion * 2e11 / 2.5 * slenderness * 1e-16, rel=TORSION
    )
    assert float(strip.mass_per_length) == pytest.approx(8000.0 * slenderness * 1e-8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.Whisker(lateral_ratio=0.0), r"`lateral_ratio` must be a positive finite number, got 0"),
        (lambda: jw.Whisker(lateral_ratio=np.inf), r"`lateral_ratio` must be"),
        (
            lambda: jw.Scene(jw.Whisker(lateral_ratio=2.0), jw.Parabola(0.2)),
            r"`lateral_ratio` must be None in the plane",
        ),
        (lambda: jw.Whisker.strip(0.1, 2e11, 0.05, 1e-4), r"`width` must be at most 1/5 of the length"),
        (lambda: jw.Whisker.strip(0.1, 2e11, -1e-3, 1e-4), r"`width` must be a positive"),
    ],
)
def test_wrong_strips(make, message):
    with pytest.raises(ValueError, match=message):
        make()
