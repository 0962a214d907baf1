"""Motion of whiskers with springs on their shafts: vibrations, slow sweeps, energy, rest, derivatives, input."""

# pyright: reportArgumentType=false
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from functions import Stiffening
from jaxwhisker.plot.drawing import drawing_at

FREQUENCY = 1e-3  # relative error; the amplitude is 0.02
DECAY = 1e-2  # relative error of the rate at which vibrations decay
QUASI_STATIC = 1e-2  # of the peak: lag of the damping at 0.08 L/T, 4e-3, and vibrations since the first touch
CONSERVED = 1e-9  # relative change of the energy; each step solves its equations to about 1e-12
BALANCED = 1e-9  # of the ledger of energy
RESTS = 1e-9  # rounding divided by the square of the time step
EQUILIBRIUM = 5e-3  # of forces: six shape functions, whose curvature has no kinks at the springs
DIFFERENCES = 2e-5  # relative error of derivatives by central differences
MODES = 1e-8  # relative difference of derivatives in both modes
DRAWN = 1e-4  # centre lines have 64 points
SAME = 1e-10  # uncoupled whiskers in one simulation or in two
ROD = jw.Whisker(mass_per_length=1.0)
STEPS, DAMPING = 1200, 0.02
NONE = 0.1  # stiffness of a spring that hardly acts: all supports share programs


def support(axial=NONE, deep=NONE, base=NONE, tissue=NONE, rest=0.2):
    """An axial spring, a follicle between two springs along x, free to turn, and a foundation."""
    springs = (
        jw.Spring((0, 1), axial, 0.2, axis="axial", at=0.1),
        jw.Spring((0, 1), deep, rest, at=-0.15),
        jw.Spring((0, 1), base, 0.2),
    )
    return jw.Support(springs, foundation=jw.Foundation(0.0, 0.2, tissue, 0.2), free=("phi",))


SUPPORTS = {
    "axial": support(axial=70.0, deep=50.0),
    "follicle": support(deep=200.0, base=200.0),
    "foundation": support(tissue=2000.0),
}
ALL = support(axial=70.0, deep=100.0, base=40.0, tissue=300.0)


def drift(motion):
    """Largest difference between the energy and its ledger."""
    e = motion.energy
    return np.max(np.abs(e.total - (e.total[0] + e.work - e.damping - e.impact - e.friction + e.contact)))


def let_go(support, damping, at):
    """Free vibrations after a scan has bent the whisker with its drive at this position."""
    bent = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support), np.array([0.75, at]))
    assert bent.phase[1, 0] == jw.Phase.tip
    return jw.simulate(
        jw.Sensor(ROD, support), at, 16.0, start=bent, steps=STEPS, every=10, stiffness_damping=damping, shapes=6
    )


@pytest.mark.parametrize("name", SUPPORTS)
def test_small_vibrations_have_the_first_frequency(name):
    motion = let_go(SUPPORTS[name], DAMPING, 0.68)
    y = np.asarray(motion.tip_x[motion.time > 6.0, 0]) - 0.88
    assert 1e-3 < np.abs(y).max() < 0.05
    # A decaying vibration satisfies y[k + 1] = 2 r cos(phi) y[k] - r^2 y[k - 1].
    (twice, square), *_ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:], rcond=None)
    interval, h = 16.0 * 10 / STEPS, 16.0 / STEPS
    omega, decay = np.arccos(twice / 2 / np.sqrt(square)) / interval, -np.log(square) / 2 / interval
    modes = jw.modes(jw.Sensor(ROD, SUPPORTS[name]), count=1, stiffness_damping=DAMPING)
    first, ratio = float(modes.omega[0]), float(modes.damping_ratio[0])
    assert abs(omega / (first * np.sqrt(1 - ratio**2) * (1 - (first * h) ** 2 / 12)) - 1) < FREQUENCY
    assert abs(decay / (ratio * first) - 1) < DECAY


def test_energy_is_conserved():
    """Large vibrations without damping, to which a drive at rest adds nothing."""
    motion = let_go(ALL, 0.0, 0.35)
    np.testing.assert_allclose(motion.energy.total, motion.energy.total[0], rtol=CONSERVED)
    assert np.abs(motion.energy.work).max() < CONSERVED * motion.energy.total[0]
    assert np.ptp(motion.spring_length[:, 0]) > 0.02
    assert motion.energy.springs.max() > 0.1 * motion.energy.total[0]
    assert motion.energy.kinetic.max() > 0.5 * motion.energy.total[0]


def sweep(support, start, stop, speed, damping=DAMPING):
    scene = jw.Scene(ROD, jw.Parabola(0.2), support)
    duration = (start - stop) / speed if speed else 30.0
    return jw.simulate(
        scene, np.array([start, stop]), duration, steps=STEPS, every=10, stiffness_damping=damping, shapes=6
    )


@pytest.mark.parametrize("held", [ALL, *SUPPORTS.values()], ids=["all", *SUPPORTS])
def test_slow_sweep_approaches_scan(held):
    motion = sweep(held, 0.75, -1.6, 0.08)
    assert np.all(motion.status == jw.Status.ok)
    assert drift(motion) < BALANCED
    scan = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), held), np.asarray(motion.control[:101]))
    smooth = (scan.control < 0.4) & (scan.control > -0.9)
    assert np.all(scan.status[smooth] == jw.Status.ok)
    for name in ("fx", "fy", "mz", "base_x", "base_angle", "spring_length", "contact_arc"):
        ours, theirs = (np.asarray(getattr(r, name))[: smooth.size][smooth] for r in (motion, scan))
        atol = QUASI_STATIC * np.abs(theirs).max() + 1e-3
        np.testing.assert_allclose(ours, theirs, atol=atol, rtol=0, err_msg=name)


@cache
def violent():
    return sweep(ALL, 0.75, -1.6, 2.0, damping=0.0)


def test_pictures_show_springs_where_they_are():
    motion = violent()
    for k in (0, 40):
        axial, deep, _ = drawing_at(motion, k).springs
        length = np.asarray(motion.spring_length[k])
        assert abs(np.hypot(axial.x[-1] - axial.x[0], axial.y[-1] - axial.y[0]) - length[0]) < DRAWN
        assert abs(deep.x[-1] - deep.x[0] - length[1]) < DRAWN


def test_violent_sweep_keeps_the_balance():
    motion = violent()
    assert np.all(motion.status == jw.Status.ok)
    assert drift(motion) < BALANCED
    assert motion.energy.impact[-1] > 0.1


def test_rest_stays_at_rest():
    """Springs that disagree bend the whisker before it touches anything."""
    held = support(axial=70.0, deep=100.0, base=40.0, tissue=300.0, rest=0.3)
    motion = sweep(held, 1.3, 1.3, 0.0, damping=0.0)
    scan = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), held), np.array([1.3, 1.29]))
    assert abs(scan.mz[0, 0]) > 0.1
    for name in ("fx", "fy", "mz", "base_x", "base_angle", "spring_length"):
        values, expected = np.asarray(getattr(motion, name)), np.asarray(getattr(scan, name))[0]
        assert np.abs(values - values[0]).max() < RESTS, name
        np.testing.assert_allclose(values[0], expected, atol=EQUILIBRIUM * max(1.0, np.abs(expected).max()), rtol=0)
    assert int(motion.events.count) == 0


class Swing(eqx.Module):
    """A drive that moves to and fro once."""

    size: float

    def __call__(self, t):
        return self.size * jnp.sin(4 * t) ** 2


POINT = np.array([30.0, 200.0, 0.12, -0.1, 5.0, 0.07])


def springs(p, whisker=1):
    linear, cubic, at, below, torsion, anchor = p
    return (
        jw.Spring((0, whisker), Stiffening(linear, cubic), 0.1, axis="axial", at=at, anchor=(0.0, anchor)),
        jw.Spring((0, whisker), 100.0, 0.08, at=below, one_sided="compression"),
        jw.Spring((0, whisker), torsion, 0.1, axis="phi", at=0.5),
        jw.Spring((0, whisker), 50.0, -0.02, axis="y", at=0.2),
        jw.Spring((0, whisker), 10.0, axis="phi"),
    )


def swung(p):
    sensor = jw.Sensor(ROD, jw.Support(springs(p), jw.Mount(0.0, 0.0, 0.1)), motion=jw.Rotation((0.1, -0.3)))
    return jw.simulate(sensor, Swing(0.4), 0.8, steps=80, stiffness_damping=0.01, shapes=3)


def measured(p):
    motion = swung(p)
    return jnp.stack([motion.mz[-1, 0], motion.tip_x[-1, 0], motion.spring_length[-1, 0], motion.energy.springs[-1]])


@pytest.fixture(scope="module")
def batch():
    """Derivatives and values at a point, at one that is invalid, and at another one."""
    points = np.stack([POINT, POINT - 2 * np.eye(6)[4] * POINT[4], 1.1 * POINT])
    return jax.vmap(jax.jacfwd(lambda p: (measured(p),) * 2, has_aux=True))(points)


def test_derivatives(batch):
    forward = np.asarray(batch[0])[0]
    for k in range(POINT.size):
        change = 1e-5 * np.eye(POINT.size)[k] * POINT[k]
        difference = (measured(POINT + change) - measured(POINT - change)) / (2e-5 * POINT[k])
        np.testing.assert_allclose(forward[:, k], difference, rtol=DIFFERENCES, atol=DIFFERENCES)
    reverse = jax.grad(lambda p: measured(p)[0])(POINT)
    np.testing.assert_allclose(reverse, forward[0], rtol=MODES, atol=MODES)


def test_batch(batch):
    values = np.asarray(batch[1])
    np.testing.assert_allclose(values[0], measured(POINT), rtol=SAME)
    np.testing.assert_allclose(values[2], measured(1.1 * POINT), rtol=SAME)
    assert np.isnan(values[1]).all()


def test_nonlinear_springs_keep_the_balance():
    motion = swung(POINT)
    assert drift(motion) < BALANCED
    assert motion.energy.damping[-1] > 1e-3
    assert np.ptp(motion.energy.springs) > 0.01
    # Lengths start at those of the equilibrium, and the stop is met and left.
    stop = np.asarray(motion.spring_length[:, 1])
    assert stop.min() < 0.08 < stop.max()


def test_whiskers_that_nothing_couples():
    """One of two whiskers moves as if it were alone, whatever holds the other one."""
    other = jw.Spring((0, 1), 60.0, -0.3)
    both = jw.Support(
        (other, *springs(POINT, whisker=2)),
        (jw.Mount(), jw.Mount(0.0, 0.0, 0.1)),
        foundation=(jw.Foundation(0.0, 0.2, 500.0, -0.3), None),
        free=("phi",),
    )
    sensor = jw.Sensor((ROD, ROD), both, motion=jw.Rotation((0.1, -0.3)))
    motion = jw.simulate(sensor, Swing(0.4), 0.8, steps=80, stiffness_damping=0.01, shapes=3)
    alone = swung(POINT)
    for name in ("fx", "fy", "mz", "base_x", "base_y", "tip_x"):
        np.testing.assert_allclose(getattr(motion, name)[:, 1], getattr(alone, name)[:, 0], atol=SAME, err_msg=name)
    np.testing.assert_allclose(motion.spring_length[:, 1:], alone.spring_length, atol=SAME)
    assert drift(motion) < BALANCED


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"springs": (jw.Spring((0, 1), 1.0), jw.Spring((1, 2), 1.0, at=(0.1, 0.2)))}, "support"),
        ({"springs": (jw.Spring((0, 1), np.inf), jw.Spring((0, 1), 1.0, at=0.1))}, "stiffness"),
        ({"springs": (jw.Spring((0, 1), 1.0, at=1.5),)}, "at"),
        ({"foundation": jw.Foundation(0.0, 1.5, 1.0)}, "stop"),
    ],
)
def test_invalid_input(change, message):
    with pytest.raises(ValueError, match=message):
        jw.simulate(jw.Sensor(ROD, jw.Support(**change)), 0.0, 1.0)
