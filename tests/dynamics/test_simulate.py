"""Motion in time: a reference ring-down, exact motions, the quasi-static limit, energy, order, derivatives, input."""

# pyright: reportArgumentType=false
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks
from jaxwhisker._dynamics.advance import advance
from jaxwhisker._dynamics.moving import Damping, motion_units, system_of
from jaxwhisker._dynamics.start import initial
from scenes import model

RINGDOWN = json.loads((Path(__file__).parents[1] / "data" / "ringdown.json").read_text())["cases"][0]
EARLY, LATE = 1e-3, 5e-3  # of the ring-down, in lengths: the reference's own errors reach 1.2e-3
CONSERVED = 1e-9  # relative change of the energy; each step solves its equations to about 1e-12
BALANCED = 1e-9  # of the ledger of energy
ROUNDING = 1e-12
TOUCH = 1e-6  # error of the drive position at the first touch of a straight whisker, which moves at constant speed
QUASI_STATIC = 2.5e-3  # of the peak of fx: lag of the damping at the slower speed, 2.1e-3
DISPERSION = 1e-3  # relative error of the first frequency, (omega h)^2 / 12 = 4e-4
DIFFERENCES = 2e-5  # relative error of derivatives by central differences
RESTS = 1e-9  # rounding divided by the square of the time step, 1e-12, grows to 1e-10 in 1e5 steps without damping
SNAPPED = 5e-4  # relative error of the frequency after a snap: the amplitude is still 0.1
DECAYS = 1e-2  # relative error of the decay rate
CREATED = 0.02  # of the work: second contacts that are pushed out; 0.3 where energy was created
INSIDE = 1e-2  # length: penetration by a second contact, which the first one keeps from being resolved
ROD = jw.Whisker(mass_per_length=1.0)
FREE = jw.Sensor(ROD)
STEPS = 1200
DAMPING = 0.02


def heavy(scene, **changes):
    """The scene with a mass per length of 1."""
    return jw.Scene(ROD, scene.profile, scene.support, **changes)


class Ramp(eqx.Module):
    """A drive that starts smoothly, from `start` to `start + size` and back."""

    start: float
    size: float

    def __call__(self, t):
        return self.start + self.size * ((1 - jnp.cos(3 * t)) / 2) ** 3


class Steady(eqx.Module):
    """A drive at constant speed."""

    start: float
    speed: float

    def __call__(self, t):
        return self.start + self.speed * t


def sweep(speed, damping=DAMPING, **changes):
    """FB from before the first touch to after the snap-off."""
    scene, start, stop = heavy(model("FB"), **changes), 0.75, -1.6
    return jw.simulate(
        scene, np.array([start, stop]), (start - stop) / speed, steps=STEPS, every=10, stiffness_damping=damping
    )


@pytest.fixture(scope="module")
def slow():
    return sweep(0.08)


def drift(motion):
    """Largest difference between the energy and its ledger."""
    e = motion.energy
    return np.max(np.abs(e.total - (e.total[0] + e.work - e.damping - e.impact - e.friction + e.contact)))


def test_ring_down():
    # Springs this stiff are a clamp: their scan shares the programs of other tests.
    result = jw.scan(model("FB", stiffness=1e9, rest_length=0.0))
    (snap,) = result.events.of(jw.EventKind.snap_off)
    motion = jw.simulate(FREE, float(snap.before.base_x[0]), 1.0, start=snap.before, steps=1000)
    at = np.round(1000 * np.array(RINGDOWN["t"])).astype(int)
    x, y = motion.tip_x[at, 0] - motion.base_x[at, 0], motion.tip_y[at, 0]
    error = np.maximum(np.abs(x - np.array(RINGDOWN["tip_x_from_base"])), np.abs(y - np.array(RINGDOWN["tip_y"])))
    assert error[np.array(RINGDOWN["t"]) <= 0.5].max() < EARLY
    assert error.max() < LATE
    energy = np.asarray(motion.energy.total)
    np.testing.assert_allclose(energy, energy[0], rtol=CONSERVED)
    assert abs(energy[0] - RINGDOWN["stored_energy"]) < 1e-4  # it is given with five decimals
    # The same program: a small ring-down has the first frequency of a clamped beam.
    bent = jw.deflect(ROD, jw.PointForce(1e-3))
    small = jw.simulate(FREE, 0.0, 20.0, start=bent, steps=1000)
    tip, t = np.asarray(small.tip_x[:, 0]), np.asarray(small.time)
    k = np.flatnonzero(np.diff(np.sign(tip)))
    zeros = t[k] + (t[1] - t[0]) * tip[k] / (tip[k] - tip[k + 1])
    omega = np.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0])
    assert abs(omega / 3.5160153 - 1) < DISPERSION


def test_energy_over_many_periods():
    bent, period = jw.deflect(ROD, jw.PointForce(2.0)), 2 * np.pi / 3.516
    motion = jw.simulate(FREE, 0.0, 1000 * period, start=bent, steps=25_000, every=50)
    energy = np.asarray(motion.energy.total)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
    assert np.asarray(motion.energy.kinetic).max() > 0.5 * energy[0]


def test_steady_rotation():
    """A whisker that turns steadily stays straight, and its support pulls it inwards with m omega^2 L / 2."""
    omega = 0.8
    turning = jw.Sensor(ROD, motion=jw.Rotation())
    motion = jw.simulate(turning, np.array([0.0, omega]), 1.0, steps=50)
    angle = omega * np.asarray(motion.time)
    np.testing.assert_allclose(motion.tip_x[:, 0], -np.sin(angle), atol=1e-3)
    # It is stretched no more than inextensible, and bends by Coriolis and centrifugal forces only to higher order.
    np.testing.assert_allclose(motion.fx[5:, 0], omega**2 / 2 * np.sin(angle[5:]), atol=2e-3)
    np.testing.assert_allclose(motion.fy[5:, 0], -(omega**2) / 2 * np.cos(angle[5:]), atol=2e-3)
    assert drift(motion) < BALANCED


def test_order_in_time():
    tips = [jw.simulate(FREE, Ramp(0.0, 0.4), 1.5, steps=n, every=n, shapes=4).tip_x[-1, 0] for n in (50, 100, 200)]
    order = np.log2((tips[0] - tips[1]) / (tips[1] - tips[2]))
    assert 1.8 < order < 2.3


def test_rest_stays_at_rest():
    scene = heavy(model("FB"))
    motion = jw.simulate(scene, np.array([1.0, 1.0]), 1000.0, steps=100_000, every=10_000, shapes=4)
    for name in ("fx", "fy", "mz", "curvature"):
        assert np.abs(getattr(motion, name)).max() < RESTS
    assert np.abs(motion.base_x - 1.2).max() < RESTS
    assert int(motion.events.count) == 0


def test_steps_so_short_that_rounding_is_amplified_are_inexact():
    fast = sweep(1e8)
    assert fast.time[1] - fast.time[0] < 1e-6
    assert np.all(fast.status == jw.Status.inexact) and np.isnan(fast.mz).all()


def test_slow_sweep_approaches_scan(slow):
    assert np.all(slow.status == jw.Status.ok)
    assert drift(slow) < BALANCED
    assert abs(slow.energy.contact[-1]) < 1e-4 * slow.energy.work[-1]
    slower = sweep(0.04)
    scan = jw.scan(model("FB"), np.asarray(slower.control))
    (touch,) = scan.events.of(jw.EventKind.touch)
    (snap,) = scan.events.of(jw.EventKind.snap_off)
    errors, lags = [], []
    for motion in (slow, slower):
        reference = jw.scan(model("FB"), np.asarray(motion.control))
        smooth = (motion.control < 0.5) & (motion.control > -1.1)
        difference = np.asarray(motion.fx - reference.fx)[smooth, 0]
        errors.append(np.sqrt(np.mean(difference**2)))
        assert abs(motion.events[0].control - touch.control) < TOUCH
        left = next(e for e in motion.events.of(jw.EventKind.release) if e.control < -1.2)
        lags.append(snap.control - left.control)
    assert errors[1] < QUASI_STATIC * np.abs(scan.fx).max()
    assert 1.7 < errors[0] / errors[1] < 3.0  # first order: the lag of the damping
    assert 0 < lags[1] < 0.8 * lags[0]  # later at higher speed


def test_friction():
    motion = sweep(0.08, friction=0.3)
    reference = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0), friction=0.3), motion.control)
    assert drift(motion) < BALANCED
    assert motion.energy.friction[-1] > 1.0
    assert motion.slip is not None and motion.friction_force is not None and motion.normal_force is not None
    smooth = (motion.control < 0.4) & (motion.control > -1.1)
    for name in ("fx", "fy", "mz", "friction_force"):
        ours, theirs = (np.asarray(getattr(r, name))[smooth, 0] for r in (motion, reference))
        assert np.abs(ours - theirs).max() < 0.02 * np.abs(theirs).max(), name
    np.testing.assert_array_equal(motion.slip[smooth], -1)
    assert np.all(np.abs(motion.friction_force) <= 0.3 * np.abs(motion.normal_force) + 1e-9)


@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("speed", [1.0, 2.0, 3.0])
def test_violent_motion_creates_no_energy(speed, friction):
    """Undamped whiskers that whip round and hit the object in two places at once."""
    motion = sweep(speed, damping=0.0, friction=friction)
    assert np.all(motion.status == jw.Status.ok)
    energy, impact = motion.energy, np.asarray(motion.energy.impact)
    assert drift(motion) < BALANCED
    assert impact[-1] > 0.1
    assert np.diff(impact).min() > -CREATED * energy.work.max()
    assert np.abs(energy.contact).max() < CREATED * energy.work.max()
    assert motion.gap.min() > -INSIDE


@pytest.mark.parametrize(("speed", "damping"), [(0.08, 0.2), (0.3, DAMPING), (0.3, 0.2)])
def test_contacts_do_not_chatter(speed, damping):
    """Damped whiskers touch once, and come free once: vibrations faster than the time step do not last."""
    kinds = [e.kind for e in sweep(speed, damping=damping).events]
    assert kinds == [
        jw.EventKind.touch,
        jw.EventKind.tip_to_tangential,
        jw.EventKind.vertex,
        jw.EventKind.tangential_to_tip,
        jw.EventKind.release,
    ]


def test_momentum():
    """In every step, linear momentum changes by the impulses of the support and of the contact, with friction too."""
    scene = jax.tree.map(checks.as_float, heavy(model("FB"), friction=0.3))
    none, h, speed = jnp.zeros(()), jnp.asarray(0.02), -0.2
    system = system_of(scene, Damping(none, none + DAMPING, (none, none, none)), 5)
    first, _ = initial(system, motion_units(scene), None, jnp.array([0.7, 0.0, 0.0]), jnp.array([speed, 0.0, 0.0]))

    def momentum(moving):
        return jnp.sum(system.rods.mass[:, None] * moving.rod.velocity, axis=-1)[0]

    def step(old, k):
        new, forces = advance(
            system, old, jnp.stack([0.7 + speed * h * k, none, none]), jnp.array([speed, 0.0, 0.0]), h
        )
        before, after = old.rod.touching, new.rod.touching
        assert before is not None and after is not None
        # A contact that begins acts where it ends the approach; a lasting one, on average between both points.
        first, last = before.gap, after.gap
        normal, tangent = (
            jnp.where(before.touches[:, None], (a + b) / 2, b)
            for a, b in ((first.normal, last.normal), (first.tangent, last.tangent))
        )
        force = after.force * normal + after.drag * tangent
        force += (forces.normal - after.force) * last.normal + (forces.drag - after.drag) * last.tangent
        missing = momentum(new) - momentum(old) - h * (forces.reaction[0, :2] + force[0])
        return new, (missing, after.touches[0], momentum(new))

    _, (missing, touches, size) = jax.jit(lambda: jax.lax.scan(step, first, jnp.arange(1.0, 121.0)))()
    assert 40 < int(touches.sum()) < 120
    assert np.abs(missing).max() < 1e-9 * np.abs(size).max()


def test_sensor_on_springs():
    """A base on a spring follows a slow drive; the force of the spring is the reaction."""
    sensor = jw.Sensor(ROD, jw.Support((jw.Spring((0, 1), 70.0, axis="x"),)))
    slow, fast = (jw.simulate(sensor, jw.Whisking(0.1, f), 2 / f, steps=600, shapes=4) for f in (0.005, 0.5))
    np.testing.assert_allclose(slow.base_x[:, 0], slow.control, atol=1e-3 * 0.1)
    assert drift(slow) < BALANCED and drift(fast) < BALANCED
    stretch = np.asarray(fast.base_x[:, 0] - fast.control)
    assert np.ptp(stretch) > 0.02
    # Reactions are means over the steps before and after: their error is of order 2.
    np.testing.assert_allclose(fast.fx[1:-1, 0], -70.0 * stretch[1:-1], atol=2e-2 * 70.0 * np.ptp(stretch))


def test_coupled_whiskers():
    scene, start, stop = heavy(model("FBFBR")), 0.72, -0.8
    motion = jw.simulate(
        scene, np.array([start, stop]), (start - stop) / 0.08, steps=800, every=20, stiffness_damping=DAMPING
    )
    assert drift(motion) < BALANCED
    reference = jw.scan(model("FBFBR"), np.asarray(motion.control))
    late = motion.control < 0.2
    for name, tolerance in (("fx", 0.02), ("fy", 0.02), ("mz", 0.02), ("spring_length", 0.01)):
        ours, theirs = (np.asarray(getattr(r, name))[late] for r in (motion, reference))
        assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max(), name


def test_starts_in_contact():
    scene = heavy(model("FB"))
    result = jw.scan(model("FB"), np.array([0.5, 0.1]))
    motion = jw.simulate(
        scene, np.array([0.1, 0.1]), 3.0, start=result, steps=STEPS, every=10, stiffness_damping=DAMPING
    )
    assert np.abs(motion.gap).max() < ROUNDING
    assert np.all(motion.phase == jw.Phase.tangential)
    np.testing.assert_allclose(motion.mz[:, 0], result.mz[1, 0], rtol=0.01)
    lines = motion.shapes(points=21)
    np.testing.assert_allclose(lines.x[:, 0, -1], motion.tip_x[:, 0], atol=ROUNDING)
    np.testing.assert_allclose(np.hypot(np.diff(lines.x), np.diff(lines.y)).sum(-1), 1.0, atol=1e-3)


def test_frequency_after_the_snap():
    """Once vibrations are small, a whisker that has snapped off has the frequency and the damping of its first mode."""
    scene, duration = heavy(model("FB")), 30.0
    before = jw.scan(model("FB"), np.array([0.5, -1.32]))
    motion = jw.simulate(
        scene, np.array([-1.32, -1.5]), duration, start=before, steps=STEPS, every=10, stiffness_damping=DAMPING
    )
    assert motion.phase[0, 0] != jw.Phase.free
    assert motion.events[-1].kind == jw.EventKind.release and motion.events[-1].time < duration / 2
    y = np.asarray(motion.mz[motion.time > duration - 8.0, 0])
    # A decaying vibration satisfies y[k + 1] = 2 r cos(phi) y[k] - r^2 y[k - 1].
    (twice, square), *_ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:], rcond=None)
    interval = duration * 10 / STEPS
    omega, decay = np.arccos(twice / 2 / np.sqrt(square)) / interval, -np.log(square) / 2 / interval
    modes = jw.modes(scene, count=1, stiffness_damping=DAMPING)
    first, ratio, h = float(modes.omega[0]), float(modes.damping_ratio[0]), duration / STEPS
    expected = first * np.sqrt(1 - ratio**2) * (1 - (first * h) ** 2 / 12)  # damped, and slowed by the time step
    assert abs(omega / expected - 1) < SNAPPED
    assert abs(decay / (ratio * first) - 1) < DECAYS


def measured(p):
    """Signals of a sweep through the first touch, as a function of lengths, stiffnesses and masses."""
    whisker = jw.Whisker(p[0], p[1], mass_per_length=p[2])
    scene = jw.Scene(whisker, jw.Parabola(p[3]), jw.Support.fb(p[4]))
    motion = jw.simulate(scene, Steady(0.7, -0.2), p[5], steps=60, stiffness_damping=0.05, shapes=5)
    return jnp.stack([motion.mz[-1, 0], motion.base_x[-1, 0], motion.energy.kinetic[30], motion.events.time[0]])


POINT = np.array([1.0, 1.0, 1.0, 0.2, 70.0, 0.97])


def test_derivatives():
    forward = jax.jacfwd(measured)(POINT)
    for k in (0, 2, 3, 5):
        size = 1e-6 * POINT[k]  # small enough for the same steps to touch
        change = np.eye(6)[k] * size
        difference = (measured(POINT + change) - measured(POINT - change)) / (2 * size)
        np.testing.assert_allclose(forward[:, k], difference, rtol=DIFFERENCES, atol=DIFFERENCES)
    np.testing.assert_allclose(jax.grad(lambda p: measured(p)[0])(POINT), forward[0], rtol=1e-8, atol=1e-10)


def test_second_derivatives():
    """They are those of differences, or NaN."""

    def free(p):
        drive = Ramp(0.0, p)
        return jw.simulate(FREE, drive, 0.5, steps=20, shapes=4, mass_damping=p).tip_x[-1, 0]

    forward = jax.jit(jax.jacfwd(free))
    difference = (forward(0.4 + 1e-5) - forward(0.4 - 1e-5)) / 2e-5
    assert jax.jit(jax.jacfwd(jax.jacfwd(free)))(0.4) == pytest.approx(float(difference), rel=DIFFERENCES)
    # Backwards through a loop, jax drops the rule of the implicit function theorem.
    assert np.isnan(jax.jit(jax.jacfwd(jax.grad(free)))(0.4))

    def touching(p):
        motion = jw.simulate(heavy(model("FB")), Steady(0.7, -p), 0.97, steps=60, shapes=4)
        return jnp.stack([motion.mz[-1, 0], motion.mz[3, 0]])

    second = jax.jit(jax.jacfwd(jax.jacfwd(touching)))(0.2)
    assert np.isnan(second[0])  # closest points are exact to first order


def test_batch():
    points = np.stack([POINT, POINT + 0.1 * np.eye(6)[3], POINT - 2 * np.eye(6)[2], POINT + np.nan * np.eye(6)[4]])
    batch = jax.vmap(measured)(points)
    np.testing.assert_allclose(batch[:2], [measured(p) for p in points[:2]], rtol=1e-10)
    assert np.isnan(batch[2:, :3]).all()


def test_samples_and_whisking():
    whisking = jw.Whisking(amplitude=0.1, frequency=0.5)
    t = np.linspace(0.0, 2.0, 201)
    smooth = jw.simulate(FREE, whisking, 2.0, steps=100, shapes=4)
    sampled = jw.simulate(FREE, np.array([float(whisking(s)) for s in t]), 2.0, steps=100, shapes=4)
    np.testing.assert_allclose(sampled.control, smooth.control, atol=1e-6)
    np.testing.assert_allclose(sampled.tip_x, smooth.tip_x, atol=1e-4)


def test_a_sweep_holds_its_position():
    """The drive stops at once, and damping brings the whisker to rest."""
    down = jw.Sweep(0.1, -0.3, 0.4)
    motion = jw.simulate(FREE, down, 8.0, steps=800, stiffness_damping=0.2, shapes=4)
    assert np.all(motion.control[100:] == down.stop)
    swing = np.abs(motion.tip_x[:, 0] - motion.base_x[:, 0])
    assert swing[100:150].max() > 0.05 and swing[-1] < 1e-3  # of the stop, and at rest
    assert drift(motion) < BALANCED


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 0.0}, "duration"),
        ({"drive": np.array([0.8, np.nan, 0.6])}, "drive"),
        ({"drive": "fast"}, "drive"),
        ({"scene": jw.Sensor(jw.Whisker())}, "mass_per_length"),
        ({"scene": jw.Sensor(ROD, jw.Support((jw.Spring((0, 1), np.inf),)))}, "stiffness"),
        ({"steps": 0}, "steps"),
        ({"every": 1.5}, "every"),
        ({"shapes": 1}, "shapes"),
        ({"stiffness_damping": -1.0}, "stiffness_damping"),
        ({"base_damping": (1.0, 2.0)}, "base_damping"),
        ({"start": 3.0}, "start"),
    ],
)
def test_invalid_input(change, message):
    arguments = {"scene": FREE, "drive": 0.0, "duration": 1.0} | change
    with pytest.raises(ValueError, match=message):
        jw.simulate(**arguments)


def test_invalid_mass():
    with pytest.raises(ValueError, match="mass_per_length"):
        jw.Whisker(mass_per_length=-1.0)


def test_starts_inside_the_object():
    arguments = {"steps": STEPS, "every": 10, "stiffness_damping": DAMPING}
    with pytest.raises(ValueError, match=r"`drive` must start where no whisker is inside"):
        jw.simulate(heavy(model("FB")), np.array([0.3, 0.3]), 1.0, **arguments)


def test_drive_that_is_not_finite():
    with pytest.raises(ValueError, match=r"`drive` must be finite at all times, got nan at time 0\.51"):
        jw.simulate(FREE, lambda t: 0.3 * jnp.sqrt(0.5 - t), 1.0, steps=100, shapes=4)
