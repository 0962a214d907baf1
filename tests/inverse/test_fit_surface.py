"""Surfaces fitted to points in space: from scans, errors, bands, and wrong input."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

import jaxwhisker as jw
from jaxwhisker._inverse.fit_surface import FAMILIES, _rotation_vector, _surface, fit_surface
from jaxwhisker._inverse.points import SpaceReconstruction

EXACT = 1e-6  # of the length, from scans without noise
ROUNDING = 1e-12
TRIALS, DEVIATIONS, INSIDE = 200, 2.0, 0.9545  # of a normal distribution, within two standard deviations
CHANCE = 1e-4  # that a correct count of trials is outside its bounds
SCATTER = 4.0  # standard errors
NOISE = 1e-4  # so small that errors are of first order, also of combinations of residuals that vary least
TRUTH = {
    jw.Sphere: [0.9, 0.05, 1.2, 0.02],
    jw.Ellipsoid: [1.1, 0.7, 0.8, 0.05, 1.1, -0.02, 0.1, 0.3, -0.2],
}
CONTROL = np.linspace(-0.8, 0.8, 17)


def along_x(offset, surface):
    drive = jw.LinearDrive((1.0, 0.0, 0.0), origin=(0.0, 0.0, offset))
    return jw.Scene(jw.Whisker(), surface, motion=drive)


def points_of(position, force, covariance=None, **fields):
    """A reconstruction of one whisker with these contacts; covariances are of position and force."""
    count = len(position)
    unknown = jnp.full((count, 1), jnp.nan)
    whole = np.full((count, 1, 7, 7), np.nan)
    if covariance is not None:
        whole[:] = 0.0
        where = np.array([0, 1, 2, 4, 5, 6])
        whole[:, 0, where[:, None], where] = covariance
    names = ("arc", "base_x", "base_y", "base_z", "chi2", "significance", "force_moment", "force_moment_score")
    every = {name: unknown for name in names} | {"control": jnp.arange(float(count)), "length": jnp.asarray(1.0)}
    every |= {f"{a}": jnp.asarray(position)[:, k, None] for k, a in enumerate("xyz")}
    every |= {f"force_{a}": jnp.asarray(force)[:, k, None] for k, a in enumerate("xyz")}
    every |= {"tangent": jnp.zeros((count, 1, 3)), "base_rotation": jnp.zeros((count, 1, 3, 3))}
    every |= {"phase": jnp.full((count, 1), 2), "status": jnp.zeros((count, 1), int), "covariance": jnp.asarray(whole)}
    return SpaceReconstruction(**every | fields)


def contacts(family, count, rng):
    """Points of the lower part of a surface, where whiskers touch it, and its normals there, by its geometry."""
    normals = rng.standard_normal((count, 3)) * [1.0, 0.5, 1.0] - [0.0, 1.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    if family is jw.Sphere:
        radius, *centre = TRUTH[family]
        return centre + radius * normals, normals
    a, centre = np.array(TRUTH[family][:3]), np.array(TRUTH[family][3:6])
    turn = turned(np.array(TRUTH[family][6:]))
    inwards = normals @ turn * a
    return centre + (inwards * a / np.linalg.norm(inwards, axis=1)[:, None]) @ turn.T, normals


def turned(vector):
    """The rotation of a rotation vector, by the exponential series."""
    from scipy.linalg import expm

    x, y, z = vector
    return expm(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))


@pytest.mark.parametrize("family", TRUTH)
def test_points_of_scans_give_the_surface_back(family):
    surface = _surface(family, TRUTH[family])
    scans = [jw.scan(along_x(offset, surface), CONTROL) for offset in (-0.4, -0.1, 0.3)]
    points = [jw.reconstruct(scan, scan.scene) for scan in scans]
    for normals in (True, False):
        fit = jw.fit_contour(points, family=family, normals=normals)
        assert fit.status == jw.FitStatus.ok and fit.chi2 < EXACT**2
        np.testing.assert_allclose(list(fit.estimates.values()), TRUTH[family], rtol=0, atol=EXACT)
        count = sum(int(one.clear.sum()) for one in points)
        assert fit.degrees_of_freedom == count * (3 if normals else 1) - len(TRUTH[family])
        assert tuple(fit.estimates) == FAMILIES[family]
    assert str(fit.surface) in str(fit)


def test_the_curvature_of_the_object_does_not_bias_the_fit():
    """Errors along a sphere lead out of it, by half their square over the radius."""
    rng, sigma, across, count = np.random.default_rng(8), 0.03, 0.01, 20000
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    position = np.array(TRUTH[jw.Sphere][1:]) + TRUTH[jw.Sphere][0] * normals
    outer = normals[:, :, None] * normals[:, None, :]
    noise = sigma * (np.eye(3) - outer) + across * outer  # square root of the covariance
    covariance = np.zeros((count, 6, 6))
    covariance[:, :3, :3] = noise @ noise
    noisy = position + np.einsum("pij,pj->pi", noise, rng.standard_normal((count, 3)))
    fit = fit_surface(points_of(noisy, normals, covariance), jw.Sphere, False)
    outwards = sigma**2 / TRUTH[jw.Sphere][0]
    assert SCATTER * across / np.sqrt(count) < 0.3 * outwards
    assert abs(fit.estimates["radius"] - TRUTH[jw.Sphere][0]) < 0.3 * outwards


@pytest.mark.parametrize("family", TRUTH)
def test_surfaces_are_within_their_errors(family):
    rng = np.random.default_rng(0)
    position, normals = contacts(family, 40, rng)
    force = rng.uniform(0.5, 3.0, (40, 1)) * normals
    root = NOISE * rng.standard_normal((40, 6, 6))
    names, inside, chi2 = FAMILIES[family], np.zeros(len(TRUTH[family])), []
    directions = -np.eye(3)[1] + 0.3 * rng.standard_normal((3, 3))
    exactly = points_and_normals_at(family, directions)
    banded = np.zeros(3)
    for _ in range(TRIALS):
        noise = np.einsum("pij,pj->pi", root, rng.standard_normal((40, 6)))
        points = points_of(position + noise[:, :3], force + noise[:, 3:], root @ root.transpose(0, 2, 1))
        fit = fit_surface(points, family, True)
        assert fit.status == jw.FitStatus.ok
        off = [abs(fit.estimates[name] - truth) for name, truth in zip(names, TRUTH[family], strict=True)]
        inside += np.array(off) < DEVIATIONS * np.array(list(fit.standard_error.values()))
        chi2.append(fit.chi2)
        at, error = fit.band(directions)
        unit = directions / np.linalg.norm(directions, axis=1)[:, None]
        banded += np.abs(np.sum((at - exactly) * unit, axis=1)) < DEVIATIONS * error
    least, most = binom.ppf([CHANCE / 2, 1 - CHANCE / 2], TRIALS, INSIDE)
    assert np.all((inside >= least) & (inside <= most)), (inside, least, most)
    assert np.all((banded >= least) & (banded <= most)), (banded, least, most)
    degrees = 3 * 40 - len(names)
    assert np.mean(chi2) == pytest.approx(degrees, abs=SCATTER * np.sqrt(2 * degrees / TRIALS))


def points_and_normals_at(family, normals):
    """Points with these outward normals."""
    unit = normals / np.linalg.norm(normals, axis=1)[:, None]
    if family is jw.Sphere:
        return np.array(TRUTH[family][1:]) + TRUTH[family][0] * unit
    a, turn = np.array(TRUTH[family][:3]), turned(np.array(TRUTH[family][6:]))
    inwards = unit @ turn * a
    return np.array(TRUTH[family][3:6]) + (inwards * a / np.linalg.norm(inwards, axis=1)[:, None]) @ turn.T


def test_errors_without_covariances_follow_from_the_scatter():
    rng, sigma = np.random.default_rng(1), 1e-3
    position, normals = contacts(jw.Sphere, 400, rng)
    noisy = position + sigma * rng.standard_normal((400, 3))
    scattered = fit_surface(points_of(noisy, normals), jw.Sphere, False)
    known = np.zeros((400, 6, 6))
    known[:, range(3), range(3)] = sigma**2
    weighted = fit_surface(points_of(noisy, normals, known), jw.Sphere, False)
    assert scattered.chi2 == pytest.approx(
        sigma**2 * weighted.chi2, rel=0.05
    )  # outliers have less weight in one of them
    errors = [np.array(list(fit.standard_error.values())) for fit in (scattered, weighted)]
    np.testing.assert_allclose(errors[0], errors[1], rtol=SCATTER / np.sqrt(2 * 396))


def test_lengths_may_have_any_unit_and_place():
    rng = np.random.default_rng(2)
    position, normals = contacts(jw.Ellipsoid, 30, rng)
    shift = np.array([3.0, -1.0, 2.0])
    fit = fit_surface(points_of(1e-3 * (position + shift), 7.0 * normals), jw.Ellipsoid, True)
    expected = np.array(TRUTH[jw.Ellipsoid])
    expected[3:6] += shift
    expected[:6] *= 1e-3
    np.testing.assert_allclose(list(fit.estimates.values()), expected, rtol=1e-8)


def test_weak_and_failed_points_are_left_out():
    rng = np.random.default_rng(3)
    position, normals = contacts(jw.Sphere, 20, rng)
    position[:2] += 0.3
    status, significance = np.zeros((20, 1), int), np.full((20, 1), 100.0)
    status[0], significance[1] = jw.PointStatus.failed, 10.0
    fit = fit_surface(
        points_of(position, normals, status=jnp.asarray(status), significance=jnp.asarray(significance)),
        jw.Sphere,
        True,
    )
    np.testing.assert_allclose(list(fit.estimates.values()), TRUTH[jw.Sphere], atol=ROUNDING)
    assert fit.degrees_of_freedom == 3 * 18 - 4


def test_the_wrong_family_is_implausible_and_few_points_are_undetermined():
    rng = np.random.default_rng(4)
    position, normals = contacts(jw.Ellipsoid, 30, rng)
    covariance = np.broadcast_to(1e-6 * np.eye(6), (30, 6, 6))
    fit = fit_surface(points_of(position, normals, covariance), jw.Sphere, True)
    assert fit.status == jw.FitStatus.implausible and "implausible" in str(fit)
    assert np.isnan(fit.covariance).all() and np.isnan(fit.band(normals[:2])[1]).all()
    same = np.broadcast_to(position[0], (4, 3))
    fit = fit_surface(points_of(same, np.broadcast_to(normals[0], (4, 3))), jw.Ellipsoid, True)
    assert fit.status != jw.FitStatus.ok and np.isnan(fit.standard_error["a"])


def test_the_band_has_the_normals_of_the_surface():
    rng = np.random.default_rng(5)
    position, normals = contacts(jw.Ellipsoid, 30, rng)
    fit = fit_surface(points_of(position, normals), jw.Ellipsoid, True)
    points, _ = fit.band(3.0 * normals)
    np.testing.assert_allclose(points, position, atol=EXACT)
    for point, normal in zip(points, normals, strict=True):
        assert float(fit.surface.off(jnp.asarray(point))) == pytest.approx(0.0, abs=EXACT)
        np.testing.assert_allclose(fit.surface.normal(jnp.asarray(point)), normal, atol=EXACT)


def test_rotation_vectors():
    for vector in ([0.1, 0.3, -0.2], [0.0, 0.0, 0.0], [2.0, -1.5, 0.4]):
        np.testing.assert_allclose(_rotation_vector(turned(np.array(vector))), vector, atol=ROUNDING)


RADIUS, AXIS, ON_AXIS = 0.4, np.array([0.3, 0.1, 0.9]) / np.sqrt(0.91), np.array([0.05, 1.1, -0.1])
OUTWARD, ON_PLANE = np.array([0.6, -0.8, 0.0]), np.array([0.3, 0.5, 0.2])


def along_axis(family, count, rng):
    """Points of the lower part of a cylinder, or of a plane, and their normals."""
    if family is jw.Plane:
        first, second = np.cross(OUTWARD, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
        places = ON_PLANE + rng.uniform(-0.5, 0.5, (count, 1)) * first + rng.uniform(-0.3, 0.3, (count, 1)) * second
        return places, np.broadcast_to(OUTWARD, (count, 3))
    first = np.cross(AXIS, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    angle = rng.uniform(-0.4, np.pi - 0.4, (count, 1))
    normals = np.cos(angle) * first + np.sin(angle) * np.cross(AXIS, first)
    return ON_AXIS + RADIUS * normals + rng.uniform(-0.5, 0.5, (count, 1)) * AXIS, normals


def expected(family, middle):
    """The estimates of the cylinder or the plane for points with this middle."""
    if family is jw.Plane:
        return np.r_[middle + ((ON_PLANE - middle) @ OUTWARD) * OUTWARD, OUTWARD]
    return np.r_[RADIUS, ON_AXIS + ((middle - ON_AXIS) @ AXIS) * AXIS, AXIS]


def aligned(fit, family):
    """Estimates of a fit, with the axis in the direction of the true one, and their errors."""
    found = np.array(list(fit.estimates.values()))
    if family is jw.Cylinder and found[4:] @ AXIS < 0:
        found[4:] *= -1
    return found, np.array(list(fit.standard_error.values()))


@pytest.mark.parametrize("normals", [True, False])
@pytest.mark.parametrize("family", [jw.Cylinder, jw.Plane])
def test_exact_points_give_a_cylinder_or_a_plane_in_any_unit(family, normals):
    position, directions = along_axis(family, 30, np.random.default_rng(9))
    for unit, shift in ((1.0, np.zeros(3)), (1e-3, np.array([0.1, 0.2, -0.3]))):
        points = points_of(unit * position + shift, 7.0 * directions)
        fit = fit_surface(points, family, normals)
        exact = expected(family, position.mean(axis=0))
        exact[-6:-3] = unit * exact[-6:-3] + shift
        exact[:-6] *= unit
        assert fit.status == jw.FitStatus.ok and tuple(fit.estimates) == FAMILIES[family]
        np.testing.assert_allclose(aligned(fit, family)[0], exact, atol=EXACT**2)
        assert fit.degrees_of_freedom == 30 * (3 if normals else 1) - (5 if family is jw.Cylinder else 3)
        on = [float(fit.surface.off(jnp.asarray(x))) for x in np.asarray(points.point)[:, 0]]
        np.testing.assert_allclose(on, 0.0, atol=EXACT**2)


@pytest.mark.parametrize("normals", [True, False])
@pytest.mark.parametrize("family", [jw.Cylinder, jw.Plane])
def test_cylinders_and_planes_are_within_their_errors(family, normals):
    rng = np.random.default_rng(0)
    position, directions = along_axis(family, 40, rng)
    force = rng.uniform(0.5, 3.0, (40, 1)) * directions
    root = NOISE * rng.standard_normal((40, 6, 6))
    inside, chi2, banded = np.zeros(len(FAMILIES[family])), [], 0
    for _ in range(TRIALS):
        noise = np.einsum("pij,pj->pi", root, rng.standard_normal((40, 6)))
        points = points_of(position + noise[:, :3], force + noise[:, 3:], root @ root.transpose(0, 2, 1))
        fit = fit_surface(points, family, normals)
        assert fit.status == jw.FitStatus.ok
        exact = expected(family, np.mean(position + noise[:, :3], axis=0))
        found, errors = aligned(fit, family)
        inside += np.abs(found - exact) <= DEVIATIONS * errors + ROUNDING  # parts along the normal may be fixed
        chi2.append(fit.chi2)
        at, error = fit.band(directions[:1])
        missed = (at[0] - ON_PLANE) @ OUTWARD
        if family is jw.Cylinder:
            across = (at[0] - ON_AXIS) - ((at[0] - ON_AXIS) @ AXIS) * AXIS
            missed = np.linalg.norm(across) - RADIUS
        banded += abs(missed) < DEVIATIONS * error[0]
    least, most = binom.ppf([CHANCE / 2, 1 - CHANCE / 2], TRIALS, INSIDE)
    assert np.all((inside >= least) & (inside <= most)), (inside, least, most)
    assert least <= banded <= most
    degrees = fit.degrees_of_freedom
    assert np.mean(chi2) == pytest.approx(degrees, abs=SCATTER * np.sqrt(2 * degrees / TRIALS))


def test_scans_give_a_cylinder_back():
    surface = jw.Cylinder(RADIUS, tuple(ON_AXIS), tuple(AXIS))
    scans = [jw.scan(along_x(offset, surface), CONTROL) for offset in (-0.4, -0.1, 0.3)]
    fit = jw.fit_contour([jw.reconstruct(scan, scan.scene) for scan in scans], family=jw.Cylinder)
    found, _ = aligned(fit, jw.Cylinder)
    assert fit.status == jw.FitStatus.ok and found[0] == pytest.approx(RADIUS, abs=EXACT)
    np.testing.assert_allclose(found[4:], AXIS, atol=EXACT)
    np.testing.assert_allclose(np.cross(found[1:4] - ON_AXIS, AXIS), 0.0, atol=EXACT)
    assert "cylinder r = 0.4" in str(fit)


def test_points_of_a_line_do_not_determine_a_cylinder():
    rng = np.random.default_rng(10)
    position = ON_AXIS + rng.uniform(-1.0, 1.0, (20, 1)) * AXIS
    fit = fit_surface(points_of(position, np.broadcast_to(OUTWARD, (20, 3))), jw.Cylinder, True)
    assert fit.status != jw.FitStatus.ok and np.isnan(fit.standard_error["radius"])


@pytest.mark.unchecked
def test_wrong_arguments():
    position, normals = contacts(jw.Sphere, 5, np.random.default_rng(7))
    points = points_of(position, normals)
    with pytest.raises(ValueError, match="`family` must be Sphere, Ellipsoid, Cylinder or Plane, got None"):
        jw.fit_contour(points)
    with pytest.raises(ValueError, match="`family` must be Sphere, Ellipsoid"):
        jw.fit_contour(points, family=jw.Capsule)
    with pytest.raises(ValueError, match="`measured` must hold enough points for 5 parameters, got 4"):
        jw.fit_contour(points_of(position[:4], normals[:4]), family=jw.Cylinder, normals=False)
    with pytest.raises(ValueError, match="`sensor` must be left out in space"):
        jw.fit_contour(points, jw.Sensor(jw.Whisker()), family=jw.Sphere)
    with pytest.raises(ValueError, match="`unknown` must be left out in space"):
        jw.fit_contour([points], unknown=("c",), family=jw.Sphere)
    with pytest.raises(ValueError, match="`family` must be left out in the plane"):
        jw.fit_contour({"fx": [0.0]}, jw.Sensor(jw.Whisker()), family=jw.Sphere)
    with pytest.raises(ValueError, match="`normals` must be True or False"):
        jw.fit_contour(points, family=jw.Sphere, normals=1)
    with pytest.raises(ValueError, match=r"`measured` must be the result of jw.reconstruct in space"):
        jw.fit_contour([points, 3.0], family=jw.Sphere)
    with pytest.raises(ValueError, match="`measured` must hold enough points for 9 parameters, got 5"):
        jw.fit_contour(points, family=jw.Ellipsoid, normals=False)
    weak = points_of(position, normals, significance=jnp.ones((5, 1)))
    with pytest.raises(ValueError, match="`measured` must hold significant points"):
        jw.fit_contour(weak, family=jw.Sphere)
    with pytest.raises(ValueError, match="`normals` must be an array"):
        jw.fit_contour(points, family=jw.Sphere).band([1.0, 0.0, 0.0])
