"""Stored energy: exact values, its derivatives as forces, reciprocity, and the energy lost in snaps."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipeinc, ellipkinc

import jaxwhisker as jw
from scenes import all_ok, model
from several import BOTH, circles, with_one_contact
from several import CONTROL as SEVERAL
from several import scanned as scanned_several

EXACT = 1e-9  # relative to the largest energy: the accuracy of the states
SLOPES = 1e-7  # relative to the largest: a rod in constant steps has no exact potential, and its error is amplified
QUADRATURE = 1e-7  # relative to the largest: Gauss points between two events
COMPLIANCE = 1e-8  # relative: points along the deflected rod
NODES = 48  # between two events

MODELS = ("FB", "FBFBFBR")
SNAPS = (jw.EventKind.snap_through, jw.EventKind.snap_off)
CONTROL = np.linspace(0.9, -2.2, 140)


def scene(name, distance=0.2, position=0.0, stiffness=80.0, bending_stiffness=1.0):
    """A model whose whiskers all differ; `bending_stiffness` is that of the first one."""
    support = jw.Support.named(name, stiffness, 0.2)
    lengths = (1.0, 0.9, 1.1)[: support.whiskers]
    whiskers = tuple(jw.Whisker(length, bending_stiffness * (1 + 0.2 * k)) for k, length in enumerate(lengths))
    return jw.Scene(whiskers, jw.Parabola(distance, position=position), support)


@cache
def scanned(name):
    return jw.scan(scene(name), CONTROL)


def bent(result):
    """Energy of each whisker by elliptic integrals: 2 sqrt(EI f) [E - (1 - k^2) F], from t0 at the base to pi/2."""
    stiffness = np.array([float(w.bending_stiffness) for w in result.scene.whiskers])
    touching = np.asarray(result.phase) != jw.Phase.free
    force = np.where(touching, result.contact_force, 1.0)
    half = np.sin(np.asarray(result.contact_slope) / 2)
    k = np.sqrt(np.asarray(result.mz) ** 2 / (4 * stiffness * force) + half**2)
    k = np.where(touching, k, 0.5)
    t0 = np.arcsin(half / k)
    first = ellipkinc(np.pi / 2, k**2) - ellipkinc(t0, k**2)
    second = ellipeinc(np.pi / 2, k**2) - ellipeinc(t0, k**2)
    return np.where(touching, 2 * np.sqrt(stiffness * force) * (second - (1 - k**2) * first), 0.0)


def strained(result):
    """Energy of each spring."""
    springs = result.scene.support.springs
    strain = np.asarray(result.spring_length) - np.array([float(s.rest_length) for s in springs])
    return np.array([float(s.stiffness) for s in springs]) * strain**2 / 2


@pytest.mark.parametrize("name", MODELS)
def test_energy_is_the_sum_over_whiskers_and_springs(name):
    result = scanned(name)
    assert all_ok(result)
    expected = bent(result).sum(axis=1) + strained(result).sum(axis=1)
    assert {int(p) for p in np.unique(np.asarray(result.phase))} == set(jw.Phase)
    assert strained(result).max() > 0.01 * expected.max()
    np.testing.assert_allclose(jw.stored_energy(result.scene, result), expected, atol=EXACT * expected.max())


def test_energy_is_zero_for_free_whiskers_and_nan_for_unused_events():
    result = scanned("FB")
    energy = np.asarray(jw.stored_energy(result.scene, result))
    free = np.asarray(result.phase)[:, 0] == jw.Phase.free
    assert free.any() and np.all(energy[free] == 0) and np.all(energy[~free] > 0)
    states = result.events.before
    at_events = jw.stored_energy(result.scene, states)
    assert at_events.shape == states.fx.shape[:1]
    np.testing.assert_array_equal(np.isnan(at_events), np.arange(states.fx.shape[0]) >= len(result.events))


def test_energy_is_in_the_units_of_the_scene():
    length, bending = 37.5, 4.2e4
    unit = bending / length**3
    large = jw.Scene(
        jw.Whisker(length, bending), jw.Parabola(0.2 * length, 1 / length), jw.Support.fb(80.0 * unit, 0.2 * length)
    )
    energy = jw.stored_energy(large, jw.scan(large, CONTROL * length))
    result = scanned("FB")
    np.testing.assert_allclose(energy * length / bending, jw.stored_energy(result.scene, result), atol=EXACT * 10)


@cache
def slopes(name):
    """Energy, sum of fx, sum of fy; their derivatives by drive, distance, position, stiffness and bending stiffness."""

    def observed(parameters):
        drive, *rest = parameters
        here = scene(name, *rest)
        result = jw.scan(here, CONTROL + drive)
        return jnp.stack([jw.stored_energy(here, result), result.fx.sum(axis=1), result.fy.sum(axis=1)])

    at = jnp.array([0.0, 0.2, 0.0, 80.0, 1.0])
    return tuple(np.asarray(leaf) for leaf in (observed(at), jax.jacfwd(observed)(at)))


def same(actual, expected, size, tolerance=SLOPES):
    assert np.max(np.abs(expected)) > 0.1 * size  # not a comparison of zeros
    np.testing.assert_allclose(actual, expected, atol=tolerance * size)


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_of_the_energy_are_forces_and_strains(name):
    (_, fx, fy), (energy, _, _) = slopes(name)
    by_drive, by_distance, by_position, by_stiffness, by_bending_stiffness = energy.T
    same(by_drive, fx, np.max(np.abs(fx)))
    same(by_distance, -fy, np.max(np.abs(fy)))
    same(by_position, -fx, np.max(np.abs(fx)))
    # In equilibrium the energy is stationary. Only the direct effect of a parameter remains.
    springs, whiskers = strained(scanned(name)).sum(axis=1) / 80.0, bent(scanned(name)).sum(axis=1)
    same(by_stiffness, springs, springs.max())
    same(by_bending_stiffness, whiskers, whiskers.max())


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_of_forces_are_reciprocal(name):
    _, (_, fx, fy) = slopes(name)
    size = np.max(np.abs(fx[:, :3]))
    same(fx[:, 1], -fy[:, 0], size)  # drive and distance
    same(fx[:, 1], fy[:, 2], size)  # position and distance
    same(fx[:, 2], -fx[:, 0], size)  # position and drive


@pytest.mark.parametrize("name", MODELS)
def test_the_work_of_the_drive_between_events_is_the_gain_of_energy(name):
    events = scanned(name).events
    here = scanned(name).scene
    at = np.array([e.control for e in events])
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    t = (nodes + 1) / 2
    # Quadratic at both ends, which removes the square root from reactions near a fold.
    share, rate = t**2 * (3 - 2 * t), 6 * t * (1 - t)
    stretch = np.diff(at)
    control = (at[:-1, None] + stretch[:, None] * share).ravel()
    result = jw.scan(here, np.append(control, at[-1] - 0.1))  # the last snap is within the scan
    assert all_ok(result)
    drive = np.asarray(result.fx)[:-1].sum(axis=1).reshape(-1, NODES)
    work = np.sum(weights / 2 * rate * drive, axis=1) * stretch
    before, after = (np.asarray(jw.stored_energy(here, s)) for s in (events.before, events.after))
    size = np.nanmax(before)
    same(work, before[1 : at.size] - after[: at.size - 1], size, QUADRATURE)
    snaps = [k for k, e in enumerate(events) if e.kind in SNAPS]
    assert len(snaps) >= here.support.whiskers
    # At other events the state is the same before and after.
    others = np.setdiff1d(np.arange(at.size), snaps)
    np.testing.assert_allclose(before[others], after[others], atol=EXACT * size)
    assert np.all(before[snaps] - after[snaps] > 1e-3 * size)


@pytest.mark.parametrize(("stiffness", "distance"), [(10.0, 0.2), (30.0, 0.1)])
def test_a_snap_loses_energy(stiffness, distance):
    # Below the critical stiffness whiskers snap through the vertex, the softest one to the far side of the object.
    result = jw.scan(model("FB", stiffness, distance=distance), CONTROL)
    snaps = [e for e in result.events if e.kind in SNAPS]
    assert jw.EventKind.snap_through in [e.kind for e in snaps]
    for snap in snaps:
        assert jw.stored_energy(result.scene, snap.before) > jw.stored_energy(result.scene, snap.after) + 0.1


def _compliance(follower):
    """d(displacement of load i along its direction) / d(load j) of two loads, at finite deflection."""
    inner, outer, points = 0.6, 1.0, 101
    directions = (2.8, 0.3)

    def along(forces):
        loads = [
            jw.PointForce(force, position=position, direction=direction, follower=follower)
            for force, position, direction in zip(forces, (inner, outer), directions, strict=True)
        ]
        rod = jw.deflect(jw.Whisker(), *loads, points=points)
        ends = jnp.array([points - 1, 2 * points - 1])
        # The loads' own directions, which do not turn while these loads change.
        ways = jnp.array(directions) + follower * jax.lax.stop_gradient(rod.angle[ends] - jnp.pi / 2)
        return rod.x[ends] * jnp.cos(ways) + rod.y[ends] * jnp.sin(ways), rod.s[ends]

    matrix, arcs = jax.jit(jax.jacfwd(along, has_aux=True))(jnp.array([2.0, 3.0]))
    np.testing.assert_allclose(arcs, [inner, outer])
    return np.asarray(matrix)


def test_compliance_is_symmetric_for_dead_loads():
    matrix = _compliance(follower=False)
    assert abs(matrix[0, 1]) > 1e-3
    assert abs(matrix[0, 1] / matrix[1, 0] - 1) < COMPLIANCE


def test_compliance_is_not_symmetric_for_follower_loads():
    matrix = _compliance(follower=True)
    assert abs(matrix[0, 1] / matrix[1, 0] - 1) > 1e-2


def test_a_whisker_with_one_of_several_contacts_has_the_energy_of_one_contact():
    result = scanned_several()
    energy, single = (jw.stored_energy(one.scene, one) for one in (result, with_one_contact(result)))
    one = np.asarray(result.phase)[:, 0, 1] == jw.Phase.free
    np.testing.assert_allclose(energy[one], single[one], atol=EXACT * np.max(energy))
    assert np.max(np.abs(np.asarray(energy - single)[BOTH])) > 0.01


def test_derivatives_of_the_energy_with_several_contacts_are_those_of_differences():
    def energy(distance):
        scene = circles(distance)
        return jw.stored_energy(scene, jw.scan(scene, SEVERAL))[BOTH]

    step = 1e-5
    differences = (energy(0.25 + step) - energy(0.25 - step)) / (2 * step)
    slopes = jax.jvp(energy, (0.25,), (1.0,))[1]
    np.testing.assert_allclose(slopes, differences, rtol=1e-6)
