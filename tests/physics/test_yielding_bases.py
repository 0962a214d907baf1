"""Springs along x, y and in angle, and mounted whiskers: forward shooting, energy, limits, derivatives."""

from functools import cache

import forward
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discrete import Chains

import jaxwhisker as jw
from jaxwhisker._model.along import LinearTaper
from scenes import all_ok, cone, follicle

EXACT = 1e-7  # of signals relative to their size: error of the rods' steps
SAME = 1e-9  # of signals: the same equilibria, computed in another way
CONTROL = np.linspace(1.2, -1.9, 125)
SIGNALS = ("base_x", "base_y", "base_angle", "fx", "fy", "mz")
PARABOLA = jw.Parabola(0.2)


def spring(ends, stiffness, rest_length=0.0, axis="x"):
    return jw.Spring(ends, stiffness, rest_length, axis)


def coupled(torsion, offset=0.0, feedback=90.0):
    """Two bases coupled by springs along x and by torsion."""
    return jw.Support((
        spring((0, 1), 70.0, 0.2),
        spring((1, 2), 70.0, 0.2),
        spring((0, 1), torsion, 0.0, "phi"),
        spring((1, 2), torsion, offset, "phi"),
        spring((0, 2), feedback, 0.4),
    ))  # fmt: skip


SCENES = {
    "follicle": jw.Scene(jw.Whisker(), PARABOLA, follicle(x=70.0, y=500.0, phi=20.0)),
    "torsion": jw.Scene(jw.Whisker(), PARABOLA, follicle(phi=5.0)),
    "mounted": jw.Scene(jw.Whisker(), PARABOLA, follicle(x=90.0, phi=40.0, mount=(0.1, -0.05, 0.2))),
    "coupled by torsion": jw.Scene(jw.Whisker(), PARABOLA, coupled(30.0, 0.1)),
    # Its free end passes into the object, and what is tested are the equations of one contact.
    "conical spiral on torsion": jw.Scene(
        cone(0.4, curvature=(0.3, 0.8)), PARABOLA, jw.Support.follicle(phi=15.0), detect=()
    ),
    "everything": jw.Scene(
        (cone(0.5, curvature=(-0.2, -0.2)), jw.Whisker(0.95, 0.8, LinearTaper(0.1, 0.29, 0.95))),
        PARABOLA,
        jw.Support(
            (*coupled(30.0, 0.05).springs, spring((0, 2), 300.0, 0.02, "y")),
            (jw.Mount(0.0, 0.02, -0.1), jw.Mount(0.05, 0.0, 0.15)),
        ),
    ),
}


@cache
def scanned(name):
    return jw.scan(SCENES[name], CONTROL)


@pytest.mark.parametrize("name", SCENES)
def test_against_forward_shooting(name):
    result, phases = scanned(name), set()
    assert all_ok(result)
    touching = np.flatnonzero(np.any(np.asarray(result.phase) != jw.Phase.free, axis=1))
    missed = forward.misses(result, touching[1 :: max(1, touching.size // 8)], phases=phases)
    assert max(missed.values()) < EXACT, missed
    assert {jw.Phase.tip, jw.Phase.tangential} <= phases


LINKS = 1e-3  # of energy and displacements: chains of 32 links, whose error falls with the square of their number
BEFORE, AFTER = 0.03, -0.03  # drive positions relative to the loss of stability


@pytest.mark.parametrize(
    "support",
    [follicle(x=70.0, y=500.0, phi=5.0), coupled(10.0), follicle(phi=2.0)],
    ids=["follicle", "coupled by torsion", "soft in angle"],
)
def test_stability_is_lost_where_a_chain_of_links_loses_it(support):
    scene, whiskers = jw.Scene(jw.Whisker(), PARABOLA, support), support.whiskers
    result = jw.scan(scene)
    assert all_ok(result)
    lost = next(e for e in result.events if e.kind in (jw.EventKind.snap_off, jw.EventKind.snap_through))
    numbers = [[float(np.asarray(value)) for value in (s.stiffness, s.rest_length)] for s in scene.support.springs]
    springs = [(s.between, *own, s.axis) for s, own in zip(scene.support.springs, numbers, strict=True)]
    chains = Chains([spring for spring in springs if np.isfinite(spring[1])], whiskers, 0.2)
    energy = jw.stored_energy(scene, result)

    def minimum(by):
        u = lost.control + by
        k = int(np.argmin(np.abs(np.asarray(result.control) - max(u, lost.control + 0.002))))
        lines = jw.shapes(result, [float(result.control[k])])
        base = np.stack([result.base_x[k] - result.control[k], result.base_y[k], result.base_angle[k]], axis=-1)
        unknown = chains.at_rest(u, chains.start(base, np.asarray(lines.x[0]), np.asarray(lines.y[0])))
        return unknown.reshape(whiskers, -1)[:, :3], chains.energy(unknown)[0], base, float(energy[k])

    base, stored, of_scan, of_scan_stored = minimum(BEFORE)
    assert np.max(np.abs(base - of_scan)) < 2 * LINKS
    assert abs(stored - of_scan_stored) < LINKS * of_scan_stored
    base, stored, of_scan, of_scan_stored = minimum(AFTER)
    assert stored < 0.7 * of_scan_stored
    # The scan continues from the state in which the chain comes to rest.
    k = int(np.argmin(np.abs(np.asarray(result.control) - lost.control - AFTER)))
    assert abs(stored - float(energy[k])) < LINKS * of_scan_stored


def close(one, other, within):
    """Check that signals agree, relative to the largest force, the largest moment, a length or a radian."""
    force = np.max(np.hypot(other.fx, other.fy))
    for name in SIGNALS:
        size = {"fx": force, "fy": force, "mz": np.max(np.abs(other.mz))}.get(name, 1.0)
        assert np.max(np.abs(np.asarray(getattr(one, name) - getattr(other, name)))) < within * size, name


# A base on a vertical spring of 1e9 moves by 2e-8 under the largest force, which changes by 214 per length.
@pytest.mark.parametrize(("stiff", "within"), [(1e9, 2.2e-7), (np.inf, SAME)])
def test_very_stiff_springs_along_y_and_in_angle_are_a_clamp(stiff, within):
    clamp = jw.scan(jw.Scene(jw.Whisker(), PARABOLA, jw.Support.clamped()), CONTROL)
    result = jw.scan(jw.Scene(jw.Whisker(), PARABOLA, follicle(y=stiff, phi=stiff)), CONTROL)
    close(result, clamp, within)
    lost = clamp.events.of(jw.EventKind.snap_off)[0].control
    assert abs(result.events.of(jw.EventKind.snap_off)[0].control - lost) < within


def test_a_mount_can_replace_a_rest_length():
    mounted = jw.scan(jw.Scene(jw.Whisker(), PARABOLA, follicle(x=70.0, mount=(0.2, 0.0, 0.0))), CONTROL)
    rested = jw.scan(jw.Scene(jw.Whisker(), PARABOLA, jw.Support.fb(70.0, 0.2)), CONTROL)
    close(mounted, rested, SAME)
    np.testing.assert_allclose(mounted.spring_length[:, 0], rested.spring_length[:, 0] - 0.2, atol=SAME)


def test_a_higher_base_is_a_nearer_object():
    raised = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), follicle(mount=(0.0, 0.1, 0.0))), CONTROL)
    nearer = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2)), CONTROL)
    assert np.allclose(raised.base_y, 0.1)
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(getattr(raised, name), getattr(nearer, name), atol=SAME)


def test_spring_lengths_are_those_of_the_bases():
    result = scanned("coupled by torsion")
    x, angle, u = (np.asarray(leaf) for leaf in (result.base_x, result.base_angle, result.control))
    expected = [x[:, 0] - u, x[:, 1] - x[:, 0], angle[:, 0], angle[:, 1] - angle[:, 0], x[:, 1] - u]
    np.testing.assert_allclose(result.spring_length, np.stack(expected, axis=1), atol=1e-12)
    # The torsion spring of the second whisker carries its moment, that of the first one both moments.
    moments = -np.asarray(result.mz)
    np.testing.assert_allclose(30.0 * (angle[:, 1] - angle[:, 0] - 0.1), moments[:, 1], atol=1e-7)
    np.testing.assert_allclose(30.0 * angle[:, 0], np.sum(moments, axis=1), atol=1e-7)


def test_units_do_not_matter():
    length, stiffness = 0.04, 2e-7
    force = stiffness / length**2
    support = follicle(70.0 * force / length, 500.0 * force / length, 20.0 * force * length, (0.0, 0.25 * length, 0.1))
    result = jw.scan(
        jw.Scene(jw.Whisker(length, stiffness), jw.Parabola(0.4 * length, 1 / length), support), CONTROL * length
    )
    plain = jw.Scene(jw.Whisker(), jw.Parabola(0.4), follicle(70.0, 500.0, 20.0, (0.0, 0.25, 0.1)))
    dimensionless = jw.scan(plain, CONTROL)
    assert all_ok(result)
    np.testing.assert_allclose(result.mz / (force * length), dimensionless.mz, atol=1e-9)
    np.testing.assert_allclose(result.base_angle, dimensionless.base_angle, atol=1e-10)
    np.testing.assert_allclose(result.base_y / length, dimensionless.base_y, atol=1e-10)


EXACT_TORSION = [
    # force, stiffness, tip displacement, tip height, base rotation, moment: elliptic integrals, and an initial value
    # problem solved to 13 digits.
    (1.0, 1.0, 0.753594611, 0.651075285, 0.651075285, 0.651075285),
    (1.0, 4.0, 0.475723740, 0.870801876, 0.217700469, 0.870801876),
    (3.0, 5.0, 0.763454774, 0.606370843, 0.363822506, 1.819112530),
    (5.0, 2.0, 0.930912801, 0.323992438, 0.809981096, 1.619962192),
    (10.0, 20.0, 0.853960568, 0.398666557, 0.199333279, 3.986665571),
]


@pytest.mark.parametrize(("force", "stiffness", "away", "height", "rotation", "moment"), EXACT_TORSION)
def test_deflection_on_a_torsion_spring(force, stiffness, away, height, rotation, moment):
    bent = jw.deflect(jw.Whisker(), jw.PointForce(force), support=jw.Support.follicle(phi=stiffness))
    assert bent.status == jw.Status.ok
    actual = [-bent.x[-1], bent.y[-1], bent.base_angle, -bent.mz]
    np.testing.assert_allclose(actual, [away, height, rotation, moment], atol=1e-9)


def test_deflection_on_springs_along_all_axes():
    support = jw.Support.follicle(x=20.0, y=30.0, phi=8.0, mount=jw.Mount(0.1, 0.05, 0.2))
    bent = jw.deflect(jw.Whisker(), jw.PointForce(2.0, direction=2.5), support=support)
    assert abs(bent.base_x - (0.1 + 2.0 * np.cos(2.5) / 20.0)) < 1e-12
    assert abs(bent.base_y - (0.05 + 2.0 * np.sin(2.5) / 30.0)) < 1e-12
    assert abs(bent.base_angle - (0.2 - bent.mz / 8.0)) < 1e-9
    np.testing.assert_allclose([bent.x[0], bent.y[0]], [bent.base_x, bent.base_y], atol=1e-12)
    # Moments balance about the origin.
    tip = bent.x[-1] * np.sin(2.5) * 2.0 - bent.y[-1] * np.cos(2.5) * 2.0
    assert abs(bent.mz + bent.base_x * bent.fy - bent.base_y * bent.fx + tip) < 1e-9
    with pytest.raises(ValueError, match="`support` must be a Support of one whisker"):
        jw.deflect(jw.Whisker(), jw.PointForce(1.0), support=jw.Support.fbfb(70.0))


def test_an_invalid_batch_element_does_not_affect_its_neighbour():
    def scan(stiffness):
        result = jw.scan(jw.Scene(jw.Whisker(), PARABOLA, follicle(phi=stiffness)), CONTROL[::8])
        return result.mz, result.base_angle, result.status

    mz, angle, status = jax.vmap(scan)(jnp.array([5.0, -1.0]))
    assert np.all(status[1] == jw.Status.invalid) and np.all(np.isnan(mz[1]))
    np.testing.assert_allclose(mz[0], scanned("torsion").mz[::8], atol=1e-9)
    np.testing.assert_allclose(angle[0], scanned("torsion").base_angle[::8], atol=1e-9)


def test_derivatives_of_a_deflection_by_its_support():
    p = jnp.array([20.0, 30.0, 8.0, 0.1, 0.05, 0.2, 2.0])

    def observed(p):
        support = jw.Support.follicle(x=p[0], y=p[1], phi=p[2], mount=jw.Mount(p[3], p[4], p[5]))
        bent = jw.deflect(jw.Whisker(), jw.PointForce(p[6], direction=2.5), support=support, points=3)
        return jnp.stack([bent.mz, bent.base_x, bent.base_y, bent.base_angle, bent.x[-1], bent.y[-1], bent.angle[-1]])

    @jax.jit
    def both(p):
        value, along = jax.linearize(observed, p)
        back = jax.linear_transpose(along, p)
        return value, jax.vmap(along, out_axes=-1)(jnp.eye(p.size)), jax.vmap(lambda w: back(w)[0])(jnp.eye(value.size))

    _, forward, reverse = both(p)
    np.testing.assert_allclose(forward, reverse, atol=1e-10)
    for k in range(p.size):
        step = 1e-5 * p[k]
        difference = (both(p.at[k].add(step))[0] - both(p.at[k].add(-step))[0]) / (2 * step)
        np.testing.assert_allclose(forward[:, k], difference, atol=1e-7)
        assert np.max(np.abs(forward[:, k] * p[k])) > 1e-2
