"""From signals back to points: exact scans, noise, phases, derivatives, what follows from the points, wrong input."""

from functools import cache

import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.fit_profile import FitStatus, fit_profile
from jaxwhisker._inverse.points import NORMAL_95, PointStatus
from jaxwhisker._inverse.reconstruct import reconstruct
from jaxwhisker._model.contour import Contour
from jaxwhisker._model.scene import Sensor

POINT = 1e-7  # of the length; of exact signals 1e-13 is usual
CHANGE = 1e-6  # within which of a change the phase may be the other one
NOISE = 0.01  # of a channel's peak
STRONG = 10.0  # standard deviations that a contact force has to have for errors to be linear in the noise
COVERAGE = 0.93, 0.97  # of 95 % bands
REPETITIONS = 20
DIFFERENCE = 1e-6
DIFFERENCES = 1e-6  # central differences, relative to the largest derivative
MODES = 1e-9  # forward against reverse
BIAS = 4.0  # standard errors
CROSSING = 3e-4  # of the base: a cubic through some steps
CONTROL = np.linspace(0.9503, -1.6, 256)

CASES = {
    "clamped": (jw.Support(), exact.parabola(0.2)),
    "FB": (jw.Support.fb(70.0), exact.parabola(0.2)),
    "FBFBR": (jw.Support.fbfbr(70.0), exact.parabola(0.2)),
    "circle": (jw.Support.fbfbr(70.0), exact.circle(0.3, 0.6)),
}


@cache
def signals(name):
    """Exact states, and the signals of them."""
    support, profile = CASES[name]
    keys = ("between", "stiffness", "rest_length")
    springs = [
        dict(zip(keys, (s.between, 1 / float(s.softness), float(s.rest_length)), strict=True)) for s in support.springs
    ]
    states = exact.exact_scan(profile, springs, CONTROL).states
    return states, {"control": CONTROL, "fx": states.fx, "fy": states.fy, "mz": states.mz}


def sensor(name):
    return Sensor(jw.Whisker(), CASES[name][0])


def noisy(name, seed):
    """Signals with noise, and its standard deviations."""
    _, exactly = signals(name)
    random = np.random.default_rng(seed)
    sigma = {c: NOISE * np.max(np.abs(exactly[c])) for c in ("fx", "fy", "mz")}
    shape = exactly["fx"].shape
    return exactly | {c: exactly[c] + s * random.standard_normal(shape) for c, s in sigma.items()}, sigma


@pytest.mark.parametrize("name", CASES)
def test_exact_signals(name):
    (states, measured), profile = signals(name), CASES[name][1]
    found = reconstruct(measured, sensor(name))
    phases = np.array([jw.Phase(int(p)).name for p in np.ravel(found.phase)]).reshape(states.phase.shape)
    assert np.array_equal(phases, states.phase)  # no step of this control is within CHANGE of a change
    touching = states.phase != "free"
    assert np.array_equal(np.asarray(found.status) == PointStatus.ok, touching)
    assert np.array_equal(np.isfinite(found.x), touching) and touching.any() and not touching.all()
    x, y = profile(states.contact_slope)
    pairs = (
        (found.x, x), (found.y, y), (found.slope, states.contact_slope), (found.arc, states.contact_arc),
        (found.force, states.contact_force), (found.base_x, states.base_x),
    )  # fmt: skip
    for ours, theirs in pairs:
        assert np.max(np.abs(np.asarray(ours) - theirs)[touching]) < POINT
    np.testing.assert_allclose(found.base_x, states.base_x, atol=POINT)


def test_the_thesis_s_equation_of_tangential_contact():
    measured = signals("FB")[1]
    found = reconstruct(measured, sensor("FB"))
    tangential = np.asarray(found.phase) == jw.Phase.tangential
    np.testing.assert_allclose(measured["mz"][tangential] ** 2, 2 * measured["fy"][tangential], rtol=1e-9)


def follicle():
    springs = (
        jw.Spring((0, 1), 50.0, 0.1),
        jw.Spring((1, 2), 60.0, 0.3),
        jw.Spring((0, 1), 9.0, axis="phi"),
        jw.Spring((1, 2), 12.0, 0.05, axis="phi"),
        jw.Spring((0, 2), 90.0, axis="y"),
    )
    whiskers = jw.Whisker(1.0, lambda s: (1 - 0.8 * s) ** 4), jw.Whisker(1.1, 2.0)
    mounts = jw.Mount(0.05, 0.02, 0.1), jw.Mount(0.0, 0.03, -0.2)
    return jw.Scene(whiskers, jw.Parabola(0.2), jw.Support(springs, mounts), jw.Shooting(steps=16))


OTHERS = {
    "cone": lambda: jw.Scene(
        jw.Whisker(1.0, lambda s: (1 - 0.8 * s) ** 4), jw.Parabola(0.2), jw.Support.fb(70.0), jw.Shooting(steps=16)
    ),
    "curved": lambda: jw.Scene(
        jw.Whisker(intrinsic_curvature=0.6), jw.Parabola(0.2), jw.Support.fb(70.0), jw.Shooting(steps=16)
    ),
    "springs along all axes, two kinds of whisker": follicle,
    "rotation, other units": lambda: jw.Scene(
        jw.Whisker(10.0, 3.0), jw.Circle(3.0, 6.0), jw.Support.follicle(0.15, 0.24, 2.7, mount=jw.Mount(0.0, 2.0, 0.1)),
        jw.ClosedForm(), jw.Rotation((1.0, -5.0), 3.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_other_instruments(name):
    scene = OTHERS[name]()
    control = np.linspace(1.2, -1.6, 113) if isinstance(scene.motion, jw.Translation) else np.linspace(-1.2, 1.2, 113)
    result = jw.scan(scene, control)
    length = max(float(whisker.length) for whisker in scene.whiskers)
    found = reconstruct(result, scene)
    assert np.array_equal(found.phase, result.phase)
    touching = np.asarray(result.phase) != jw.Phase.free
    pairs = (
        (found.x, result.contact_x), (found.y, result.contact_y), (found.slope, result.contact_slope),
        (found.arc, result.contact_arc), (found.base_x, result.base_x), (found.base_y, result.base_y),
        (found.base_angle, result.base_angle),
    )  # fmt: skip
    for ours, theirs in pairs:
        assert np.max(np.abs(np.asarray(ours) - np.asarray(theirs))[touching]) < POINT * length
    # Poses that are measured in place of those that springs give.
    base = result.base_x, result.base_y, result.base_angle
    measured = reconstruct(
        result, Sensor(scene.whisker, jw.Support(mount=(jw.Mount(),) * len(scene.whiskers))), base=base
    )
    np.testing.assert_allclose(np.asarray(measured.x)[touching], np.asarray(found.x)[touching], atol=POINT * length)


def test_bands_cover_the_truth():
    states, profile = signals("FBFBR")[0], CASES["FBFBR"][1]
    x, y = profile(states.contact_slope)
    inside, across, chi2 = [], [], []
    for seed in range(REPETITIONS):
        measured, sigma = noisy("FBFBR", seed)
        found = reconstruct(measured, sensor("FBFBR"), sigma=sigma)
        strong = states.contact_force > STRONG * max(sigma.values())
        assert np.all(np.asarray(found.status)[strong] == PointStatus.ok)
        off = np.stack([found.x - x, found.y - y, found.slope - states.contact_slope], axis=-1)
        inside.append((np.abs(off) < NORMAL_95 * np.asarray(found.standard_error)[..., :3])[strong])
        there_x, there_y = profile(np.asarray(found.slope))
        off = (found.x - there_x) * np.sin(found.slope) - (found.y - there_y) * np.cos(found.slope)
        across.append((np.abs(off) < NORMAL_95 * np.asarray(found.normal_error))[strong])
        chi2.append(np.asarray(found.chi2)[strong])
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
        told = some | {c: some[c] + shift[:, :, k] for k, c in enumerate(("fx", "fy", "mz"))}
        springs = jw.Support.fbfbr([stiffness, 70.0, 70.0])
        found = reconstruct(told, Sensor(jw.Whisker(), springs), sigma=sigma)
        return jnp.stack([found.x, found.y, found.slope, found.arc]).ravel()

    return points, (jnp.zeros((3, 2, 3)), jnp.asarray(70.0))


def test_derivatives(summary):
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


def test_parameters_that_are_not_known_widen_the_bands():
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
    whole, found = reconstruct(measured, sensor("FBFBR")), reconstruct(measured | {"fx": fx}, sensor("FBFBR"))
    # A base's position depends on the load on the other one.
    assert np.all(np.asarray(found.status)[120] == PointStatus.missing) and np.all(np.isnan(found.x[120]))
    others = np.arange(CONTROL.size) != 120
    np.testing.assert_array_equal(np.asarray(found.x)[others], np.asarray(whole.x)[others])
    assert np.array_equal(np.asarray(found.phase)[others], np.asarray(whole.phase)[others])
    assert "missing" in str(found)


def test_the_vertex_and_whether_whiskers_agree():
    exactly = reconstruct(signals("FBFBR")[1], sensor("FBFBR"))
    assert np.max(np.abs(exactly.vertex().x)) < 1e-6 and np.max(np.abs(exactly.vertex().y - 0.2)) < 1e-6
    np.testing.assert_allclose(exactly.vertex().base_x, -0.3338507, atol=CROSSING)
    measured, sigma = noisy("FBFBR", 1)
    found = reconstruct(measured, sensor("FBFBR"), sigma=sigma)
    vertex = found.vertex()
    assert np.all(np.abs(vertex.x) < BIAS * vertex.x_error) and np.all(np.abs(vertex.y - 0.2) < BIAS * vertex.y_error)
    assert np.all(vertex.y_error < 1e-3)
    assert 0.5 < found.consistency().chi2 < 1.5
    # A wrong rest length tears the two contours apart.
    shifted = Sensor(jw.Whisker(), jw.Support.fbfbr(70.0, [0.2, 0.23, 0.43]))
    assert reconstruct(measured, shifted, sigma=sigma).consistency().chi2 > 3.0


FITS = [("FBFBR", jw.Parabola, jw.Parabola(0.2)), ("circle", jw.Circle, jw.Circle(0.3, 0.6))]


@pytest.mark.parametrize(("name", "family", "truth"), FITS)
def test_fits(name, family, truth):
    exactly = fit_profile(reconstruct(signals(name)[1], sensor(name)), family)
    assert exactly.status == FitStatus.ok
    for field, value in exactly.estimates.items():
        assert abs(value - getattr(truth, field)) < POINT
    measured, sigma = noisy(name, 2)
    found = fit_profile(reconstruct(measured, sensor(name), sigma=sigma), family)
    assert 0.8 < found.chi2 / found.degrees_of_freedom < 1.2
    for field, value in found.estimates.items():
        assert abs(value - getattr(truth, field)) < BIAS * found.standard_error[field] < 0.01
    assert family.__name__.lower() in str(found)


def test_a_shape_that_is_another_one_is_implausible():
    measured, sigma = noisy("circle", 2)
    found = fit_profile(reconstruct(measured, sensor("circle"), sigma=sigma), jw.Parabola)
    assert found.status == FitStatus.implausible and found.chi2 > 2 * found.degrees_of_freedom
    assert np.isnan(list(found.standard_error.values())).all() and "implausible" in str(found)


def test_a_contour_is_fitted():
    measured, sigma = noisy("circle", 3)
    found = fit_profile(reconstruct(measured, sensor("circle"), sigma=sigma), Contour, knots=5)
    assert found.status == FitStatus.ok
    x, y, error = found.band(np.linspace(-0.5, 0.5, 5))
    off = np.hypot(x, y - 0.9) - 0.6
    assert np.all(np.abs(off) < BIAS * error) and np.all(error < 5e-3)


def test_points_without_slopes_or_errors():
    slopes = jnp.linspace(-0.8, 0.9, 40)
    at = jax.vmap(jw.Ellipse(0.2, 0.5, 0.8, 0.1).point)(slopes)
    found = fit_profile({"x": np.asarray(at.x), "y": np.asarray(at.y)}, jw.Ellipse)
    np.testing.assert_allclose(list(found.estimates.values()), [0.2, 0.5, 0.8, 0.1], atol=1e-6)
    few = fit_profile({"x": np.array([0.0, 0.0, 0.0]), "y": np.array([0.2, 0.2, 0.2])}, jw.Circle)
    assert few.status != FitStatus.ok and np.isnan(few.standard_error["radius"]) and "not known" in str(few)


@pytest.mark.unchecked
def test_wrong_input():
    measured, known = signals("FB")[1], sensor("FB")
    with pytest.raises(ValueError, match="`sensor`"):
        reconstruct(measured, jw.Whisker())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`parameters`"):
        reconstruct(measured, known, parameters={"a": 1.0})
    with pytest.raises(ValueError, match="`covariance`"):
        reconstruct(measured, lambda a: known, parameters={"a": 1.0}, covariance=np.eye(2))
    with pytest.raises(ValueError, match="`measured`"):
        reconstruct({"fx": measured["fx"]}, known)
    with pytest.raises(ValueError, match="`base`"):
        reconstruct(measured, known, base=(np.zeros(3), np.zeros(3), np.zeros(3)))
    with pytest.raises(ValueError, match="`whisker`"):
        Sensor(3.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`family`"):
        fit_profile({"x": np.zeros(3), "y": np.zeros(3)}, jw.Graph)
    with pytest.raises(ValueError, match="`points`"):
        fit_profile({"x": np.zeros(3)}, jw.Circle)
    with pytest.raises(ValueError, match="`guess`"):
        fit_profile({"x": np.zeros(3), "y": np.zeros(3)}, jw.Circle, guess=jw.Parabola(0.2))
