"""Springs on shafts of moving whiskers: lengths by geometry, and forces whose work is the change of energy."""

# pyright: reportArgumentType=false
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.held import ROW, SprungShafts, ends_of, energies, held_of, mean_tensions, pulls_of, tensions
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._equilibrium.shaft_springs import AXIAL, ShaftSprings

N = 4
EXACT = 1e-12
X, Y, PHI = range(AXIAL)


def cubic(extension):
    return 2.0 * extension + 5.0 * extension**3


def held(axis, law=0, one_sided=0.0, at=0.0):
    """Springs on one whisker, with stiffness 3 and rest length 0.2."""
    axis, law, one_sided, at = np.broadcast_arrays(axis, law, one_sided, at)
    none, shapes = jnp.zeros(axis.shape), basis(N)
    springs = ShaftSprings(at, none, none, none, none + 3, none + 0.2, axis, one_sided, law, none + 1)
    springs = jax.tree.map(jnp.asarray, springs)
    direction = jnp.eye(AXIAL + 1, 3)[springs.axis]
    reach = jnp.outer(jnp.maximum(springs.at, 0.0), shapes.weights)  # of a straight whisker
    return SprungShafts(springs, direction, reach, reach @ shapes.curvatures, none)


def potential(length, law, one_sided):
    extension = length - 0.2
    if one_sided * extension < 0:
        return 0.0
    return extension**2 + 1.25 * extension**4 if law else 1.5 * extension**2


def test_lengths_and_energies_of_a_leaning_whisker_are_those_of_geometry():
    springs = (
        jw.Spring((0, 1), 70.0, 0.2, axis="axial", at=0.1),
        jw.Spring((0, 1), 50.0, 0.1, at=-0.15),
        jw.Spring((0, 1), 4.0, 0.3, axis="phi", at=0.2),
    )
    support = jw.Support(springs, foundation=jw.Foundation(0.1, 0.5, 300.0, 0.02), free=("phi",))
    sensor, lean = jw.Sensor(jw.Whisker(), support), 0.3
    base, drive = np.array([0.5, 0.1, lean]), np.array([0.4, 0.05, 0.0])

    @eqx.filter_jit
    def of(sensor, base, drive):
        own, laws = held_of(sensor, basis(N))
        assert own is not None and laws == ()
        own = jax.tree.map(lambda leaf: leaf[0], own)
        angle = jnp.pi / 2 + base[2] + jnp.zeros(basis(N).points.size)
        at = ends_of(own, 1.0, jnp.zeros(N), base, angle, drive)
        return own.springs, at, energies(own, laws, at.length)

    found, at, energy = of(jax.tree.map(checks.as_float, sensor), jnp.asarray(base), jnp.asarray(drive))
    way, across = np.array([-np.sin(lean), np.cos(lean)]), base[0] - drive[0]
    place = {s: base[:2] + s * way for s in (0.1, -0.15, 0.2)}
    expected = {0.1: np.hypot(*(place[0.1] - drive[:2] - [0.0, 0.1])), -0.15: place[-0.15][0] - drive[0], 0.2: lean}
    for s, length in expected.items():
        (k,) = np.flatnonzero(np.isclose(found.at, s) & (found.stiffness > 0) & (np.arange(len(found.at)) < 3))
        np.testing.assert_allclose(at.at[k], [*place[s], lean], atol=EXACT)
        assert at.length[k] == pytest.approx(length, abs=EXACT)
        stiffness, rest = {0.1: (70.0, 0.2), -0.15: (50.0, 0.1), 0.2: (4.0, 0.3)}[s]
        assert energy[k] == pytest.approx(stiffness * (length - rest) ** 2 / 2, abs=EXACT)
    # The displacement across the unloaded whisker is linear along the foundation.
    integral = [-((across - s * np.sin(lean) - 0.02) ** 3) / (3 * np.sin(lean)) for s in (0.1, 0.5)]
    assert np.sum(energy[-ROW:]) == pytest.approx(300.0 * (integral[1] - integral[0]) / 2, abs=1e-10)


def test_a_sensor_without_springs_on_shafts_holds_nothing():
    assert held_of(jw.Sensor(jw.Whisker(), jw.Support.fb(70.0)), basis(N)) == (None, ())


KINDS = [(law, sided) for law in (0, 1) for sided in (0.0, 1.0, -1.0)]
LAW, SIDED = np.array(KINDS).T
CHANGES = [(0.05, 0.5), (0.5, 0.05), (0.3, 0.3), (0.1, 0.15), (0.2, 0.4)]


def test_mean_tensions_do_the_work_of_the_change_of_energy():
    own, laws = held(X, LAW.astype(int), SIDED), (cubic,)

    @jax.jit
    def step(first, last):
        both = [energies(own, laws, length) for length in (first, last)]
        means = [mean_tensions(own, laws, first, last, ahead) for ahead in (0.5, 1.0)]
        return both, means, tensions(own, laws, last)

    for first, last in CHANGES:
        both, (mean, late), end = step(*(jnp.full(LAW.size, length) for length in (first, last)))
        for length, energy in zip((first, last), both, strict=True):
            np.testing.assert_allclose(energy, [potential(length, *kind) for kind in KINDS], atol=EXACT)
        work = [potential(last, *kind) - potential(first, *kind) for kind in KINDS]
        np.testing.assert_allclose(mean * (last - first), work, atol=EXACT)
        np.testing.assert_allclose(late, end, atol=EXACT)  # of an implicit step
        if first == last:
            np.testing.assert_allclose(mean, end, atol=EXACT)


PLACES = np.array([0.6, 0.3, 0.7, -0.2, -0.1])
FIRST, LAST = np.array([0.5, 0.1, 0.3]), np.array([0.55, 0.02, -0.4])


@eqx.filter_jit
def pulls(base, drives, lag):
    """Springs of a straight whisker between two poses of its base."""
    own = held(np.array([AXIAL, X, PHI, AXIAL, Y]), at=PLACES)
    first, last = (
        ends_of(own, 1.0, jnp.zeros(N), at, jnp.pi / 2 + at[2] + jnp.zeros(8), drive)
        for at, drive in zip(base, drives, strict=True)
    )
    return pulls_of(own, (), first, last, (drives[:, 2], base[:, 2]), 0.5, lag)


def test_forces_of_springs_on_a_resting_drive_do_the_work_of_their_tensions():
    base, drives = np.stack([FIRST, LAST]), np.tile([0.2, -0.1, 0.25], (2, 1))
    done = pulls(jnp.asarray(base), jnp.asarray(drives), 1.5)
    longer, moved = done.last.length - done.first.length, done.last.at - done.first.at
    np.testing.assert_allclose(done.elastic, 3 * ((done.first.length + done.last.length) / 2 - 0.2), atol=EXACT)
    np.testing.assert_allclose(done.damped, 1.5 * 3 * longer, atol=EXACT)
    work = np.sum(done.load * moved, axis=1)
    np.testing.assert_allclose(work, -(done.elastic + done.damped) * longer, atol=EXACT)
    assert np.all(np.abs(work) > 1e-6)
    # Below the base, the whisker is rigid: the same work is that of the forces and moments on the base.
    on_base = np.sum(done.about_base * (LAST - FIRST), axis=1)
    np.testing.assert_allclose(on_base[PLACES < 0], work[PLACES < 0], atol=EXACT)
    np.testing.assert_allclose(done.about_base[PLACES >= 0], done.load[PLACES >= 0], atol=EXACT)


def test_forces_turn_with_the_scene():
    base, drives, turn = np.stack([FIRST, LAST]), np.tile([0.2, -0.1, 0.25], (2, 1)), 0.7
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    one = pulls(jnp.asarray(base), jnp.asarray(drives), 1.5)
    turned = [jnp.asarray(at @ rotation.T + [0, 0, turn]) for at in (base, drives)]
    other = pulls(turned[0], turned[1], 1.5)
    np.testing.assert_allclose(other.load, one.load @ rotation.T, atol=EXACT)
    np.testing.assert_allclose(other.about_base, one.about_base @ rotation.T, atol=EXACT)
