"""Contacts of whiskers with springs on their shafts: states in closed form and against scipy, then scans and noise."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwhisker as jw
from jaxwhisker._inverse.inverse_held import HeldObservation
from jaxwhisker._inverse.nearest import PhaseCandidate, rotated
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._scan.loaded_rod import LoadedRod, loaded_rod
from scenes import all_ok, cone

EXACT = 1e-12
ROD = 1e-9  # of rods that scipy integrates to 1e-12
DRIVE = np.array([0.2, -0.1, 0.3])
BASE, BELOW = (40.0, 0.25), (15.0, 0.21)  # stiffness and rest length of springs at the base and below it
AXIAL = jw.Spring((0, 1), 20.0, 0.2, axis="axial", at=0.4, anchor=(-0.15, 0.3))
POINT = 1e-7  # of the length; 1e-10 is usual
SIGMA = {"fx": 0.02, "fy": 0.02, "mz": 0.005}
STRONG = 50.0  # standard deviations that a contact force has to have for errors to be linear in the noise
CALLS, RECORDINGS = 2, 6  # noisy recordings of one call, which is padded to 512 steps anyway
BLOCK = 4  # steps to which a recording is padded for derivatives, instead of 512
COVERAGE = 0.92, 0.975  # of 95 % bands
DIFFERENCE = 1e-6
DIFFERENCES = 1e-5  # central differences, relative to the largest derivative
MODES = 1e-9  # forward against reverse
OPTIONS = {"xla_backend_optimization_level": 0}  # more takes longer to compile than it saves


def equations(*springs) -> LoadedRod:
    return loaded_rod(jw.Whisker(), (jw.PointForce(0.0),), jw.Support((jw.Spring((0, 1), *BASE), *springs)))


def observed(known, reaction, pose=None, lean=None):
    return HeldObservation(jnp.asarray(reaction), jnp.ones(3), jnp.asarray(DRIVE), known, pose, lean)


def turned(vector, angle):
    x, y, rest = vector
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, rest])


def test_the_base_lies_where_its_springs_carry_the_reaction():
    @jax.jit
    def bases(stiffness, force):
        def base(force):
            reaction = rotated(jnp.stack([force, -0.3, 0.2]), DRIVE[2])
            known = equations(AXIAL, jw.Spring((0, 1), stiffness, BELOW[1], at=-0.1))
            return observed(known, reaction).base()

        return jax.jvp(base, (force,), (jnp.ones(()),))

    # Springs at the base and below it act along x of the drive; the base turns in no other way.
    for stiffness, force in ((BELOW[0], -1.7), (1e-9, 0.4)):
        total = BASE[0] + stiffness
        x = (BASE[0] * BASE[1] + stiffness * BELOW[1] - force) / total
        found, slope = bases(stiffness, force)
        np.testing.assert_allclose(found, DRIVE + turned([x, 0.0, 0.0], DRIVE[2]), atol=EXACT)
        np.testing.assert_allclose(slope, turned([-1 / total, 0.0, 0.0], DRIVE[2]), atol=EXACT)


def by_scipy(pose, reaction, arc):
    """State, load and internal moment of the rod at an arc length beyond the axial spring, in the drive's frame."""

    def rate(s, values):
        x, y, phi, fx, fy, about = values
        return [np.cos(phi), np.sin(phi), about - x * fy + y * fx, 0.0, 0.0, 0.0]

    x, y, angle = pose
    fx, fy, mz = reaction
    values = np.array([x, y, np.pi / 2 + angle, -fx, -fy, -mz - x * fy + y * fx])
    values = solve_ivp(rate, (0.0, 0.4), values, rtol=1e-12, atol=1e-13).y[:, -1]
    away = values[:2] - [-0.15, 0.3]
    push = -20.0 * (np.hypot(*away) - 0.2) * away / np.hypot(*away)
    values[3:] -= *push, values[0] * push[1] - values[1] * push[0]
    values = solve_ivp(rate, (0.4, arc), values, rtol=1e-12, atol=1e-13).y[:, -1]
    x, y, phi, fx, fy, about = values
    return x, y, phi, fx, fy, about - x * fy + y * fx


def test_a_state_is_that_of_the_rod_past_its_springs():
    lean = 0.15

    @jax.jit
    def states(loads):
        known = equations(AXIAL)
        tip = observed(known, jnp.zeros(3)).state(
            jnp.append(loads, 0.6), PhaseCandidate(jnp.asarray(True), jnp.zeros(()))
        )
        tangent = PhaseCandidate(jnp.asarray(False), jnp.asarray(np.pi))
        return tip, observed(known, jnp.zeros(3), lean=jnp.asarray(lean)).state(jnp.append(loads, 0.2), tangent)

    loads = np.array([1.1, -0.4, 0.5])  # on the springs between drive and base
    pose, reaction = np.array([BASE[1] + loads[0] / BASE[0], 0.0, 0.0]), -loads
    for state, arc, beyond, leaning in zip(states(loads), (1.0, 0.8), (0.6, np.pi), (0.0, lean), strict=True):
        x, y, phi, fx, fy, moment = by_scipy(pose, reaction, arc)
        slope = np.arctan2(fx, -fy) + leaning
        np.testing.assert_allclose(state.reaction, turned(reaction, DRIVE[2]), atol=EXACT)
        contact, base = (DRIVE + turned(at, DRIVE[2]) for at in ((x, y, slope), pose))
        np.testing.assert_allclose(state.values, [*contact, arc, *base, np.hypot(fx, fy)], atol=ROD)
        off = phi - slope - beyond
        angle = np.arctan2(np.sin(off), np.cos(off))
        np.testing.assert_allclose(state.conditions, [moment, angle], atol=ROD)


def prestressed(stiffness=70.0, at=0.1):
    axial = jw.Spring((0, 1), stiffness, 0.2, axis="axial", at=at, anchor=(0.02, 0.07))
    return jw.Support((axial, jw.Spring((0, 1), 40.0, 0.23)))


def follicles():
    """Two whiskers that are not coupled: one in a follicle that turns, and one on a base spring."""
    springs = (
        jw.Spring((0, 1), 150.0, at=0.0),
        jw.Spring((0, 1), 250.0, 0.01, at=-0.15),
        jw.Spring((0, 1), 20.0, at=0.1),
        jw.Spring((0, 2), 70.0, 0.5),
    )
    mounts = jw.Mount(0.05, 0.02, 0.1), jw.Mount()
    support = jw.Support(springs, mounts, free=("phi",))
    return jw.Scene((jw.Whisker(), jw.Whisker(1.1, 2.0)), jw.Parabola(0.3), support, friction=0.2)


def tapered():
    support = jw.Support(foundation=jw.Foundation(0.0, 0.2, 500.0))
    return jw.Scene(cone(0.5), jw.Parabola(0.3), support, motion=jw.Rotation((0.3, -0.3), 0.4))


SCENES = {
    "prestressed": lambda: jw.Scene(jw.Whisker(), jw.Parabola(0.2), prestressed()),
    "follicles, friction": follicles,
    "tapered on tissue, rotation": tapered,
}


@cache
def scanned(name):
    scene = SCENES[name]()
    control = np.linspace(-1.1, 0.9, 61) if "rotation" in name else np.linspace(1.2, -1.3, 61)
    return jw.scan(scene, control)


@pytest.mark.parametrize("name", SCENES)
def test_points_of_exact_signals(name):
    result = scanned(name)
    assert all_ok(result)
    base = (result.base_x, result.base_y, result.base_angle) if "tissue" in name else None
    points = jw.reconstruct(result, result.scene, base=base, slip=result.slip)
    np.testing.assert_array_equal(points.phase, result.phase)
    touching = np.asarray(result.phase) != jw.Phase.free
    assert np.all(touching.any(axis=0)) and not touching.all()
    np.testing.assert_array_equal(np.asarray(points.status) == PointStatus.ok, touching)
    pairs = (
        (points.x, result.contact_x), (points.y, result.contact_y), (points.slope, result.contact_slope),
        (points.arc, result.contact_arc), (points.force, result.contact_force),
    )  # fmt: skip
    for ours, theirs in pairs:
        assert np.max(np.abs(np.asarray(ours) - np.asarray(theirs))[touching]) < POINT
    for field in ("base_x", "base_y", "base_angle"):
        np.testing.assert_allclose(getattr(points, field), getattr(result, field), atol=POINT, err_msg=field)


def test_bands_cover_the_truth():
    result, rng = scanned("prestressed"), np.random.default_rng(3)
    strong = np.asarray(result.contact_force) > STRONG * max(SIGMA.values())
    inside, chi2 = [], []
    names = ("control", "contact_x", "contact_y", "contact_slope", *SIGMA)
    r = {name: np.concatenate([np.asarray(getattr(result, name))] * RECORDINGS) for name in names}
    strong = np.concatenate([strong] * RECORDINGS)
    for _ in range(CALLS):
        noisy = {c: r[c] + s * rng.normal(size=strong.shape) for c, s in SIGMA.items()}
        points = jw.reconstruct(noisy | {"control": r["control"]}, result.scene, sigma=SIGMA)
        assert np.all(np.asarray(points.status)[strong] == PointStatus.ok)
        off = [points.x - r["contact_x"], points.y - r["contact_y"], points.slope - r["contact_slope"]]
        inside.append((np.abs(np.stack(off, axis=-1)) < 1.96 * np.asarray(points.standard_error)[..., :3])[strong])
        chi2.append(np.asarray(points.chi2)[strong])
    covered = np.mean(np.concatenate(inside), axis=0)
    assert min(covered) > COVERAGE[0] and max(covered) < COVERAGE[1], covered
    assert 0.85 < np.mean(np.concatenate(chi2)) < 1.15  # one degree of freedom


@pytest.mark.unchecked
def test_derivatives(monkeypatch):
    monkeypatch.setattr("jaxwhisker._inverse.reconstruct.BLOCK", BLOCK)
    result, steps = scanned("prestressed"), np.array([30, 36, 44])
    some = {c: jnp.asarray(getattr(result, c))[steps] for c in ("control", "fx", "fy", "mz")}
    rng = np.random.default_rng(5)
    some |= {c: some[c] + s * rng.normal(size=(3, 1)) for c, s in SIGMA.items()}

    def points(numbers):
        shift, stiffness, at = numbers[:3], numbers[3], numbers[4]
        shifted = some | {c: some[c] + shift[k] for k, c in enumerate(SIGMA)}
        sensor = jw.Sensor(jw.Whisker(), prestressed(stiffness, at))
        located = jw.reconstruct(shifted, sensor, sigma=SIGMA)
        return jnp.concatenate([located.x, located.y, located.slope, located.arc, located.base_x]).ravel()

    @partial(jax.jit, compiler_options=OPTIONS)
    def all_of(numbers, direction, weights):
        value, along = jax.linearize(points, numbers)
        return value, along(direction), jax.linear_transpose(along, numbers)(weights)[0]

    numbers, weights = jnp.array([0.0, 0.0, 0.0, 70.0, 0.1]), rng.normal(size=15)
    for k in range(5):
        direction = jnp.eye(5)[k]
        value, forward, reverse = all_of(numbers, direction, weights)
        assert np.all(np.isfinite(value))
        np.testing.assert_allclose(reverse[k], weights @ np.asarray(forward), rtol=MODES)
        step = DIFFERENCE * max(1.0, float(numbers[k])) * direction
        ahead, behind = (all_of(numbers + sign * step, direction, weights)[0] for sign in (1, -1))
        difference = (ahead - behind) / (2 * jnp.max(step))
        np.testing.assert_allclose(forward, difference, atol=DIFFERENCES * np.max(np.abs(forward)))


def test_missing_signals_leave_their_neighbours_alone():
    result = scanned("prestressed")
    measured = {c: np.asarray(getattr(result, c)).copy() for c in ("control", "fx", "fy", "mz")}
    measured["fy"][30] = np.nan
    points = jw.reconstruct(measured, result.scene)
    assert points.status[30, 0] == PointStatus.missing and np.isnan(points.x[30, 0])
    others = np.delete(np.arange(61), 30)
    np.testing.assert_allclose(points.x[others], jw.reconstruct(result, result.scene).x[others], atol=POINT)
