"""Deflections in space: published and planar cases, scipy's DOP853, balances, buckling and derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rod_in_space

import jaxwhisker as jw
from functions import Linear
from jaxwhisker._model.loads import SpaceForce
from jaxwhisker._space.deflect import SpaceDeflection

PUBLISHED = 1e-7  # of the radius of the bend
PLANE = 1e-9  # agreement with deflections in the plane, relative to values of about 1
BETWEEN = 1e-3  # of values interpolated between points
SCIPY = 1e-8  # accepted error of the rod with 32 steps; scipy's is smaller
ROUNDING = 1e-12  # of balances
SLOPE = 1e-6  # of central differences of solutions that are solved to 1e-10
EULER = np.pi**2 / 4  # load of the first buckling


class Cone(eqx.Module):
    """Bending stiffness of a cone."""

    taper: jax.Array | float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


RADIUS, EI = 100.0, 1e7 / 12
SQUARE = 12 * 0.140577 / 2  # torsional stiffness G J of a square section over EI, for E = 2 G
BEND = {  # tip (along the tangent at the base, towards the centre, along the load)
    (1.0, 300.0): (58.77968539, 22.24503474, 40.18828384),
    (1.0, 600.0): (47.1512944, 15.68507816, 53.46859844),
    (1.0, 3000.0): (23.02610506, 4.2329387, 68.51225425),
    (SQUARE, 600.0): (46.89277118, 15.55806, 53.60111408),
}


@pytest.mark.parametrize(("ratio", "load"), BEND)
def test_the_bend_of_45_degrees(ratio, load):
    """A standard test of beams in space (Bathe and Bolourchi 1979), solved by shooting with DOP853."""
    bend = jw.Whisker(RADIUS * np.pi / 4, EI, -1 / RADIUS, torsion_ratio=ratio)
    bent = jw.deflect(bend, SpaceForce(0.0, 0.0, load))
    assert isinstance(bent, SpaceDeflection) and bent.status == jw.Status.ok
    tip = np.array([bent.y[-1], bent.x[-1], bent.z[-1]])
    np.testing.assert_allclose(tip, BEND[ratio, load], atol=PUBLISHED * RADIUS)


FORCES = (jw.PointForce(2.0, position=0.9), SpaceForce(0.5, -0.3, 0.0, position=0.4), jw.PointForce(1.0, direction=0.3))
PLANAR = (FORCES[0], jw.PointForce(np.hypot(0.5, 0.3), position=0.4, direction=np.arctan2(-0.3, 0.5)), FORCES[2])


@pytest.mark.parametrize(
    "whisker", [jw.Whisker(), jw.Whisker(1.0, Cone(0.5), Linear(0.4, -0.9))], ids=["plain", "cone"]
)
def test_forces_in_the_plane_deflect_as_in_the_plane(whisker):
    flat, bent = jw.deflect(whisker, *PLANAR), jw.deflect(whisker, *FORCES)
    assert flat.status == bent.status == jw.Status.ok
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(bent, name), getattr(flat, name), atol=PLANE)
    for name in ("fz", "mx", "my", "z"):
        np.testing.assert_allclose(getattr(bent, name), 0.0, atol=PLANE)
    for of_flat, of_bent in ((flat.x, bent.x), (flat.y, bent.y), (flat.curvature, -bent.curvature[:, 1])):
        np.testing.assert_allclose(np.asarray(of_bent)[[0, -1]], np.asarray(of_flat)[[0, -1]], atol=PLANE)
    at = np.interp(bent.s, flat.s, flat.curvature)
    np.testing.assert_allclose(-bent.curvature[:, 1], at, atol=BETWEEN)
    angle = np.interp(bent.s, flat.s, flat.angle)
    np.testing.assert_allclose(bent.rotation[:, 0, 2], np.cos(angle), atol=BETWEEN)
    np.testing.assert_allclose(bent.rotation[:, :, 1], np.tile([0.0, 0.0, -1.0], (bent.s.size, 1)), atol=PLANE)


GENERAL = jw.Whisker(1.0, Cone(0.5), 0.6, torsion_ratio=0.7, lateral_curvature=0.4, twist=1.5)
FORCE = np.array([-0.5, 0.3, 0.4])


def test_a_conical_twisted_whisker_agrees_with_scipy():
    bent = jw.deflect(GENERAL, SpaceForce(*FORCE))
    assert bent.status == jw.Status.ok

    def own(s):
        return np.array([0.4, -0.6, 1.5])

    r, rotation = rod_in_space.end(FORCE, 1.0, bent.rotation[-1], Cone(0.5), 0.7, own)
    np.testing.assert_allclose([-bent.x[-1], -bent.y[-1], -bent.z[-1]], r, atol=SCIPY)
    np.testing.assert_allclose(rotation, np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), atol=SCIPY)


def test_forces_and_moments_balance():
    forces = (SpaceForce(-0.5, 0.3, 0.4), SpaceForce(0.2, 0.1, -0.6, position=0.5), jw.PointForce(0.3, position=0.8))
    bent = jw.deflect(GENERAL, *forces)
    vectors = np.array([[-0.5, 0.3, 0.4], [0.2, 0.1, -0.6], [-0.3, 0.0, 0.0]])
    np.testing.assert_allclose([bent.fx, bent.fy, bent.fz], -vectors.sum(0), atol=ROUNDING)
    along = np.stack([bent.x, bent.y, bent.z], axis=1)
    places = [along[np.argmin(np.abs(bent.s - s))] for s in (1.0, 0.5, 0.8)]
    moment = sum(np.cross(place, vector) for place, vector in zip(places, vectors, strict=True))
    np.testing.assert_allclose([bent.mx, bent.my, bent.mz], -moment, atol=ROUNDING)
    assert np.all(np.diff(bent.s) > 0)


def test_an_unloaded_whisker_is_a_helix():
    k, twist = 0.9, 1.4
    bent = jw.deflect(jw.Whisker(1.0, 2.0, lateral_curvature=k, twist=twist), SpaceForce(0.0, 0.0, 0.0))
    # The Darboux vector k d1 + twist d3 is constant, and at the base d1 = x and d3 = y.
    rate, turn = np.hypot(k, twist), np.hypot(k, twist) * bent.s
    along, around = twist / rate * bent.s, k / rate**2
    axis, second, third = np.array([[k, twist, 0], [-twist, k, 0], [0, 0, rate]]) / rate
    expected = np.outer(along, axis) + around * (np.outer(np.sin(turn), second) + np.outer(1 - np.cos(turn), third))
    np.testing.assert_allclose(np.stack([bent.x, bent.y, bent.z], axis=1), expected, atol=SCIPY)
    np.testing.assert_allclose(bent.curvature, np.tile([k, 0.0, twist], (bent.s.size, 1)), atol=ROUNDING)


@pytest.mark.parametrize(
    ("share", "position", "status"), [(0.999, 1.0, "ok"), (1.001, 1.0, "unstable"), (3.0, 0.5, "ok")]
)
def test_a_straight_whisker_buckles_at_eulers_load(share, position, status):
    """In both directions at once: no determinant of three rotations changes its sign there."""
    bent = jw.deflect(jw.Whisker(), SpaceForce(0.0, -share * EULER, 0.0, position))
    assert bent.status == jw.Status[status]
    assert np.isnan(bent.fy) == (status == "unstable")


def parameters(p):
    whisker = jw.Whisker(p[0], p[1], p[2], torsion_ratio=p[3], lateral_curvature=p[4], twist=p[5])
    bent = jw.deflect(whisker, SpaceForce(p[6], 0.3, p[7], position=p[8]), points=3)
    return jnp.stack([bent.fz, bent.mx, bent.mz, bent.x[-1], bent.z[-1], bent.rotation[-1, 0, 0], bent.curvature[1, 2]])


def test_derivatives_in_both_modes():
    at = jnp.array([1.1, 0.4, 0.6, 0.7, 0.4, 1.5, -0.5, 0.4, 0.8])
    way = jnp.array([0.5, -0.3, 0.7, 0.6, -0.8, 0.4, 0.9, -0.5, 0.3])
    expected = (parameters(at + 1e-4 * way) - parameters(at - 1e-4 * way)) / 2e-4
    value, forward = jax.jvp(parameters, (at,), (way,))
    np.testing.assert_allclose(forward, expected, atol=SLOPE)
    weights = jnp.arange(1.0, 1.0 + value.size)
    reverse = jax.grad(lambda p: weights @ parameters(p))(at)
    np.testing.assert_allclose(reverse @ way, weights @ forward, rtol=ROUNDING)


def test_a_strong_force_bends_the_whisker_in_one_direction():
    for load in (50.0, 150.0):
        bent = jw.deflect(jw.Whisker(), SpaceForce(-load, 0.3 * load, load / 2))
        assert bent.status == jw.Status.ok
        along = bent.rotation[:, :, 2] @ np.array([-1.0, 0.3, 0.5])
        assert np.all(np.diff(along) > 0)  # the tangent turns towards the force, all the way


def test_a_batch_with_an_unstable_whisker():
    loads = jnp.array([-1.0, -3.0, 2.0])

    def bent(load):
        result = jw.deflect(jw.Whisker(), SpaceForce(0.0, load, 0.0), SpaceForce(0.0, 0.0, 0.0, 0.5), points=3)
        return result.status, result.z

    status, z = jax.jit(jax.vmap(bent))(loads)
    assert status.tolist() == [jw.Status.ok, jw.Status.unstable, jw.Status.ok]
    for k, load in enumerate(loads):
        np.testing.assert_allclose(z[k], bent(load)[1], atol=ROUNDING)


def test_traced_values_outside_their_domain_are_invalid():
    @jax.jit
    def status(position):
        return jw.deflect(jw.Whisker(), SpaceForce(0.1, 0.0, 0.1, position), points=3).status

    assert status(0.5) == jw.Status.ok
    assert status(1.5) == status(-0.5) == jw.Status.invalid


@pytest.mark.parametrize(
    ("loads", "options", "message"),
    [
        ((), {"support": jw.Support.fb(70.0)}, "`support` must be an upright clamp"),
        ((), {"support": jw.Support(mount=jw.Mount(angle=0.1))}, "`support` must be an upright clamp"),
        ((), {"gravity": (0.0, -1.0)}, "`mass_per_length` must be given for a whisker with a weight"),
        ((SpaceForce(0.1, 0.0, 0.1, 1.5),), {}, "`position` must be at most the length"),
    ],
)
def test_errors(loads, options, message):
    with pytest.raises(ValueError, match=message):
        jw.deflect(jw.Whisker(), SpaceForce(0.1, 0.0, 0.1), *loads, **options)
