"""From signals back to points in the plane: exact scans, noise, phases, derivatives and wrong input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from contacts import CASES, CONTROL, noisy, sensor, signals
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._inverse.statistics import NORMAL_95
from jaxwhisker._model.scene import Sensor
from scenes import cone

POINT = 1e-7  # of the length; for exact signals 1e-13 is usual
STRONG = 10.0  # standard deviations that a contact force has to have for errors to be linear in the noise
COVERAGE = 0.93, 0.97  # of 95 % bands
REPETITIONS = 20
SAME_STATUS = 0.97  # share of steps; whether weak contacts are free depends on the estimate of the noise
SCATTER = 0.25  # relative error of the noise estimated from 256 samples: three standard errors of a median
DIFFERENCE = 1e-6
DIFFERENCES = 1e-6  # central differences, relative to the largest derivative
MODES = 1e-9  # forward against reverse
BLOCK = 4  # steps to which a recording is padded for derivatives, instead of 512


@pytest.mark.parametrize("name", CASES)
def test_points_of_exact_signals(name):
    (states, measured), profile = signals(name), CASES[name][1]
    points = reconstruct(measured, sensor(name))
    phases = np.array([jw.Phase(int(p)).name for p in np.ravel(points.phase)]).reshape(states.phase.shape)
    assert np.array_equal(phases, states.phase)  # no step of this control is within 1e-6 of a change
    touching = states.phase != "free"
    assert np.array_equal(np.asarray(points.status) == PointStatus.ok, touching)
    assert np.array_equal(np.isfinite(points.x), touching) and touching.any() and not touching.all()
    x, y = profile(states.contact_slope)
    pairs = (
        (points.x, x), (points.y, y), (points.slope, states.contact_slope), (points.arc, states.contact_arc),
        (points.force, states.contact_force), (points.base_x, states.base_x),
    )  # fmt: skip
    for ours, theirs in pairs:
        assert np.max(np.abs(np.asarray(ours) - theirs)[touching]) < POINT
    np.testing.assert_allclose(points.base_x, states.base_x, atol=POINT)


def test_the_thesis_s_equation_of_tangential_contact():
    measured = signals("FB")[1]
    points = reconstruct(measured, sensor("FB"))
    tangential = np.asarray(points.phase) == jw.Phase.tangential
    np.testing.assert_allclose(measured["mz"][tangential] ** 2, 2 * measured["fy"][tangential], rtol=1e-9)


def follicle():
    springs = (
        jw.Spring((0, 1), 50.0, 0.1),
        jw.Spring((1, 2), 60.0, 0.3),
        jw.Spring((0, 1), 9.0, axis="phi"),
        jw.Spring((1, 2), 12.0, 0.05, axis="phi"),
        jw.Spring((0, 2), 90.0, axis="y"),
    )
    whiskers = cone(0.2), jw.Whisker(1.1, 2.0)
    mounts = jw.Mount(0.05, 0.02, 0.1), jw.Mount(0.0, 0.03, -0.2)
    return jw.Scene(whiskers, jw.Parabola(0.2), jw.Support(springs, mounts), jw.Shooting(steps=16))


OTHERS = {
    "curved cone": lambda: jw.Scene(cone(0.2, curvature=(0.4, 0.6)), jw.Parabola(0.2), jw.Support.fb(70.0)),
    "springs along all axes, two kinds of whisker": follicle,
    "rotation, other units": lambda: jw.Scene(
        jw.Whisker(10.0, 3.0), jw.Circle(3.0, 6.0), jw.Support.follicle(0.15, 0.24, 2.7, mount=jw.Mount(0.0, 2.0, 0.1)),
        jw.ClosedForm(), jw.Rotation((1.0, -5.0), 3.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_other_sensors(name):
    scene = OTHERS[name]()
    control = np.linspace(1.2, -1.6, 113) if isinstance(scene.motion, jw.Translation) else np.linspace(-1.2, 1.2, 113)
    result = jw.scan(scene, control)
    length = max(float(whisker.length) for whisker in scene.whiskers)
    points = reconstruct(result, scene)
    assert np.array_equal(points.phase, result.phase)
    touching = np.asarray(result.phase) != jw.Phase.free
    pairs = (
        (points.x, result.contact_x), (points.y, result.contact_y), (points.slope, result.contact_slope),
        (points.arc, result.contact_arc), (points.base_x, result.base_x), (points.base_y, result.base_y),
        (points.base_angle, result.base_angle),
    )  # fmt: skip
    for ours, theirs in pairs:
        assert np.max(np.abs(np.asarray(ours) - np.asarray(theirs))[touching]) < POINT * length
    # Measured poses replace those that springs give.
    base = result.base_x, result.base_y, result.base_angle
    measured = reconstruct(
        result, Sensor(scene.whisker, jw.Support(mount=(jw.Mount(),) * len(scene.whiskers))), base=base
    )
    np.testing.assert_allclose(np.asarray(measured.x)[touching], np.asarray(points.x)[touching], atol=POINT * length)


def test_bands_cover_the_truth():
    states, profile = signals("FBFBR")[0], CASES["FBFBR"][1]
    x, y = profile(states.contact_slope)
    inside, across, chi2 = [], [], []
    for seed in range(REPETITIONS):
        measured, sigma = noisy("FBFBR", seed)
        points = reconstruct(measured, sensor("FBFBR"), sigma=sigma)
        strong = states.contact_force > STRONG * max(sigma.values())
        assert np.all(np.asarray(points.status)[strong] == PointStatus.ok)
        off = np.stack([points.x - x, points.y - y, points.slope - states.contact_slope], axis=-1)
        inside.append((np.abs(off) < NORMAL_95 * np.asarray(points.standard_error)[..., :3])[strong])
        there_x, there_y = profile(np.asarray(points.slope))
        off = (points.x - there_x) * np.sin(points.slope) - (points.y - there_y) * np.cos(points.slope)
        across.append((np.abs(off) < NORMAL_95 * np.asarray(points.normal_error))[strong])
        chi2.append(np.asarray(points.chi2)[strong])
    covered = [*np.mean(np.concatenate(inside), axis=0), np.mean(np.concatenate(across))]
    assert min(covered) > COVERAGE[0] and max(covered) < COVERAGE[1], covered
    assert 0.9 < np.mean(np.concatenate(chi2)) < 1.1  # one degree of freedom


@pytest.fixture(scope="module")
def summary():
    """Sum of weighted points at some steps with noise, by reactions, and by a spring's stiffness."""
    measured, sigma = noisy("FBFBR", 0)
    steps = np.array([100, 140, 180])
    some = {c: jnp.asarray(measured[c][steps]) for c in ("control", "fx", "fy", "mz")}

    def points(shift, stiffness):
        shifted = some | {c: some[c] + shift[:, :, k] for k, c in enumerate(("fx", "fy", "mz"))}
        springs = jw.Support.fbfbr([stiffness, 70.0, 70.0])
        located = reconstruct(shifted, Sensor(jw.Whisker(), springs), sigma=sigma)
        return jnp.stack([located.x, located.y, located.slope, located.arc]).ravel()

    return points, (jnp.zeros((3, 2, 3)), jnp.asarray(70.0))


def test_derivatives(summary, monkeypatch):
    monkeypatch.setattr("jaxwhisker._inverse.reconstruct.BLOCK", BLOCK)
    points, at = summary

    @jax.jit
    def both(*at):
        value, pull = jax.vjp(points, *at)
        return value, jax.jacfwd(points, argnums=(0, 1))(*at), jax.vmap(pull)(jnp.eye(value.size))

    def value(*at):
        return both(*at)[0]

    _, forward, reverse = both(*at)
    for ahead, back in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(ahead, back, rtol=0, atol=MODES * np.max(np.abs(ahead)))
    shift = jnp.zeros((3, 2, 3)).at[1, 0, 2].set(DIFFERENCE)
    by_reaction = (value(at[0] + shift, at[1]) - value(at[0] - shift, at[1])) / (2 * DIFFERENCE)
    scale = np.max(np.abs(by_reaction))
    np.testing.assert_allclose(forward[0][:, 1, 0, 2], by_reaction, rtol=0, atol=DIFFERENCES * scale)
    step = 1e-3
    by_stiffness = (value(at[0], at[1] + step) - value(at[0], at[1] - step)) / (2 * step)
    assert np.max(np.abs(by_stiffness)) > 1e-4
    np.testing.assert_allclose(forward[1], by_stiffness, rtol=0, atol=DIFFERENCES * np.max(np.abs(by_stiffness)))


def test_uncertain_parameters_widen_the_bands():
    measured, sigma = noisy("FB", 0)

    def build(stiffness, length):
        return Sensor(jw.Whisker(length), jw.Support.fb(stiffness))

    parameters, covariance = {"stiffness": 70.0, "length": 1.0}, np.diag([4.0, 0.0])
    exactly = reconstruct(measured, sensor("FB"), sigma=sigma)
    widened = reconstruct(measured, build, sigma=sigma, parameters=parameters, covariance=covariance)
    np.testing.assert_allclose(exactly.x, widened.x, rtol=1e-12)
    ends = [
        reconstruct(measured, build, sigma=sigma, parameters=parameters | {"stiffness": c}).x for c in (70.01, 69.99)
    ]
    added = (widened.covariance - exactly.covariance)[..., 0, 0]
    np.testing.assert_allclose(added, 4.0 * ((ends[0] - ends[1]) / 0.02) ** 2, rtol=1e-4, atol=1e-13)


def test_a_step_without_a_signal_leaves_its_neighbours_alone():
    _, measured = signals("FBFBR")
    fx = measured["fx"].copy()
    fx[120, 1] = np.nan
    whole, points = reconstruct(measured, sensor("FBFBR")), reconstruct(measured | {"fx": fx}, sensor("FBFBR"))
    # A base's position depends on the load on the other one.
    assert np.all(np.asarray(points.status)[120] == PointStatus.missing) and np.all(np.isnan(points.x[120]))
    others = np.arange(CONTROL.size) != 120
    np.testing.assert_array_equal(np.asarray(points.x)[others], np.asarray(whole.x)[others])
    assert np.array_equal(np.asarray(points.phase)[others], np.asarray(whole.phase)[others])
    assert "missing" in str(points)


@pytest.mark.parametrize("name", ["FB", "FBFBR"])
def test_noise_that_is_not_given_is_estimated(name):
    measured, sigma = noisy(name, 0)
    points, given = reconstruct(measured, sensor(name)), reconstruct(measured, sensor(name), sigma=sigma)
    assert np.mean(np.asarray(points.status) == np.asarray(given.status)) > SAME_STATUS
    ratio = np.asarray(points.normal_error) / np.asarray(given.normal_error)
    assert np.nanmedian(ratio) == pytest.approx(1.0, rel=SCATTER)
    assert "nan" not in str(points) and "+-" in str(points)
    assert "nan" not in str(reconstruct(signals(name)[1], sensor(name)))


@pytest.mark.unchecked
def test_wrong_arguments():
    measured, known = signals("FB")[1], sensor("FB")
    with pytest.raises(ValueError, match="`sensor`"):
        reconstruct(measured, jw.Whisker())  # pyright: ignore[reportArgumentType, reportCallIssue]
    with pytest.raises(ValueError, match="`parameters`"):
        reconstruct(measured, known, parameters={"a": 1.0})
    with pytest.raises(ValueError, match="`covariance`"):
        reconstruct(measured, lambda a: known, parameters={"a": 1.0}, covariance=np.eye(2))
    with pytest.raises(ValueError, match="`measured`"):
        reconstruct({"fx": measured["fx"]}, known)
    with pytest.raises(ValueError, match="`base`"):
        reconstruct(measured, known, base=(np.zeros(3), np.zeros(3), np.zeros(3)))
    with pytest.raises(ValueError, match=r"`parameters` must name the parameters of `sensor`.*'c'"):
        reconstruct(measured, lambda c: known, parameters={"a": 1.0})
    with pytest.raises(ValueError, match="`sensor` must be a function that JAX can trace"):
        reconstruct(
            measured, lambda a: Sensor(jw.Whisker(float(a))), parameters={"a": 1.0}, covariance=np.eye(1), sigma=1.0
        )
