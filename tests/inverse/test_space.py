"""From signals back to points in space: the reference, noise, fewer channels, derivatives and wrong input."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

import jaxwhisker as jw
from jaxwhisker._inverse.reconstruct import reconstruct
from random_space import Cone
from space_cases import case

REFERENCE = 1e-8  # of the length; the reference gives ten digits
POINT = 1e-9  # of the length, from signals of scans, which are solved to 1e-10
FRICTION = 1e-7  # the same with friction: states of such scans satisfy the rod to 1e-8 of the peaks
MODES = 1e-10  # forward against reverse
DIFFERENCE, DIFFERENCES = 1e-5, 1e-8  # step of central differences, and their error relative to the largest
NOISE = 0.01  # of the peaks
TRIALS, DEVIATIONS, INSIDE = 1000, 2.0, 0.9545  # of a normal distribution, within two standard deviations
CHANCE = 1e-4  # that a correct count of trials is outside its bounds
SCATTER = 4.0  # standard errors of a mean
CASES = json.loads((Path(__file__).parents[1] / "data" / "space_points.json").read_text("utf-8"))["cases"]
SIX, OWN = ("fx", "fy", "fz", "mx", "my", "mz"), ("f1", "f2", "f3", "m1", "m2", "m3")
BALL = jw.Sphere(0.9, (0.0, 1.2, 0.2))
CONTROL = np.linspace(1.05, -1.05, 16)
HAIR = jw.Whisker(bending_stiffness=Cone(0.5), lateral_curvature=0.3, torsion_ratio=0.7)


@pytest.fixture(autouse=True)
def short_recordings(monkeypatch):
    """Pad recordings to 32 steps instead of 512."""
    monkeypatch.setattr("jaxwhisker._inverse.reconstruct.BLOCK", 32)


@pytest.fixture(scope="module")
def straight():
    """The scan of a straight clamped whisker."""
    return jw.scan(jw.Scene(jw.Whisker(), BALL), CONTROL)


@pytest.fixture(scope="module")
def hair():
    """The scan of a curved conical whisker."""
    return jw.scan(jw.Scene(HAIR, BALL), CONTROL)


def six(result, steps=slice(None)):
    return {name: np.array(getattr(result, name))[steps] for name in ("control", *SIX)}


def own(result, names=OWN):
    """Signals along the directors of the base."""
    every = np.concatenate([result.own_force, result.own_moment], axis=-1)
    return {"control": result.control} | {name: every[..., OWN.index(name)] for name in names}


def assert_same_points(points, result, tolerance):
    touching = np.asarray(result.phase) > 0
    np.testing.assert_array_equal(points.phase, result.phase)
    assert np.any(touching) and np.array_equal(np.asarray(points.status) == jw.PointStatus.ok, touching)
    force = np.asarray(points.force) + np.where(touching[..., None], np.asarray(result.force), 0.0)
    for ours, theirs in [(getattr(points, a), getattr(result, f"contact_{a}")) for a in ("x", "y", "z", "arc")]:
        off = np.abs(np.asarray(ours) - np.asarray(theirs))
        assert np.max(off[touching]) < tolerance and np.all(np.isnan(off[~touching]))
    assert np.max(np.abs(force[touching])) < tolerance * np.max(np.abs(result.force))
    for name in ("base_x", "base_y", "base_z", "base_rotation"):
        np.testing.assert_allclose(getattr(points, name), getattr(result, name), rtol=0, atol=tolerance)


@pytest.mark.parametrize("row", CASES, ids=[row["name"].replace(" ", "_") for row in CASES])
def test_points_of_the_reference(row):
    states = {key: np.array(values) for key, values in row["states"].items()}
    signals = zip(SIX, np.concatenate([states["force"], states["moment"]], axis=1).T, strict=True)
    points = reconstruct({"control": states["u"]} | dict(signals), case(row))
    assert [jw.Phase(int(p)).name for p in points.phase[:, 0]] == row["states"]["phase"]
    assert np.max(np.abs(np.asarray(points.point)[:, 0] - states["contact_point"])) < REFERENCE
    assert np.max(np.abs(np.asarray(points.arc)[:, 0] - states["contact_arc"])) < REFERENCE


def noisy(result, step, rng, names=SIX, root=None):
    """Trials of one step of a scan with noise, its standard deviations, and the true point and arc."""
    exact = own(result, names) if names[0] in OWN else six(result)
    peak = {kind: max(np.max(np.abs(exact[n])) for n in names if n[0] == kind) for kind in "fm"}
    sigma = {name: NOISE * peak[name[0]] for name in names}
    noise = rng.standard_normal((TRIALS, len(names))) @ (np.diag(list(sigma.values())) if root is None else root.T)
    data = {name: float(exact[name][step, 0]) + noise[:, k] for k, name in enumerate(names)}
    truth = [float(getattr(result, f"contact_{a}")[step, 0]) for a in ("x", "y", "z", "arc")]
    return data | {"control": np.full(TRIALS, float(result.control[step]))}, sigma, np.array(truth)


def assert_covered(points, truth):
    """Whether points are within two standard errors as often as those of a normal distribution."""
    off = np.stack([points.x, points.y, points.z, points.arc], axis=-1)[:, 0] - truth
    inside = np.sum(np.abs(off) < DEVIATIONS * np.asarray(points.standard_error)[:, 0, :4], axis=0)
    least, most = binom.ppf([CHANCE / 2, 1 - CHANCE / 2], TRIALS, INSIDE)
    assert np.all((inside >= least) & (inside <= most)), (inside, least, most)


def test_points_are_within_their_errors(straight):
    rng = np.random.default_rng(0)
    for step in (5, 7):
        data, sigma, truth = noisy(straight, step, rng)
        points = reconstruct(data, straight.scene, sigma=sigma)
        assert np.all(points.clear) and np.all(np.asarray(points.phase) == jw.Phase.tangential)
        assert_covered(points, truth)
        spread = SCATTER * np.sqrt(2 * 3 / TRIALS)  # of the mean of chi-squared with three degrees of freedom
        assert np.mean(points.chi2) == pytest.approx(3.0, abs=spread)
        assert np.mean(np.asarray(points.force_moment_score) ** 2) == pytest.approx(
            1.0, abs=SCATTER * np.sqrt(2 / TRIALS)
        )


def test_points_from_correlated_noise_are_within_their_errors(straight):
    rng = np.random.default_rng(1)
    _, sigma, _ = noisy(straight, 6, rng)
    alike = 0.2 * np.eye(6) + 0.8 * np.ones((6, 6))  # all channels share most of their noise
    root = np.diag(list(sigma.values())) @ np.linalg.cholesky(alike)
    data, _, truth = noisy(straight, 6, rng, root=root)
    points = reconstruct(data, straight.scene, sigma=root @ root.T)
    assert_covered(points, truth)
    assert np.mean(points.chi2) == pytest.approx(3.0, abs=SCATTER * np.sqrt(2 * 3 / TRIALS))
    scatter = SCATTER * np.sqrt(2 / TRIALS)
    assert np.mean(np.asarray(points.force_moment_score) ** 2) == pytest.approx(1.0, abs=scatter)
    # Taken for uncorrelated, the same noise is implausible.
    points = reconstruct(data, straight.scene, sigma=sigma)
    assert np.mean(np.asarray(points.force_moment_score) ** 2) > 1.5


def test_points_with_friction_are_within_their_errors():
    result = jw.scan(jw.Scene(jw.Whisker(), BALL, friction=0.3), CONTROL)
    assert_same_points(reconstruct(result, result.scene), result, FRICTION)
    data, sigma, truth = noisy(result, 6, np.random.default_rng(2))
    points = reconstruct(data, result.scene, sigma=sigma)
    assert_covered(points, truth)
    assert np.mean(points.chi2) == pytest.approx(2.0, abs=SCATTER * np.sqrt(2 * 2 / TRIALS))


@pytest.mark.parametrize("names", [OWN, OWN[:5], ("f3", "m1", "m2")])
def test_fewer_channels_in_the_frame_of_the_base(hair, names):
    points = reconstruct(own(hair, names), hair.scene)
    assert_same_points(points, hair, POINT)
    assert np.all(np.isnan(points.force_moment)) == (len(names) < 6)
    data, sigma, truth = noisy(hair, 7, np.random.default_rng(3), names)
    assert_covered(reconstruct(data, hair.scene, sigma=sigma), truth)


def springs(length=1.0, force=1.0):
    """Two whiskers of different lengths on springs, one of which connects them, in other units."""
    along = [("x", 40.0, (0, 1)), ("z", 25.0, (0, 1)), ("x", 30.0, (1, 2)), ("z", 20.0, (0, 2))]
    about = [(axis, c, (0, k)) for k in (1, 2) for axis, c in (("phi_x", 5.0), ("phi", 8.0), ("phi_y", 6.0))]
    stiffness = [(axis, c * force / length, ends) for axis, c, ends in along]
    stiffness += [(axis, c * force * length, ends) for axis, c, ends in about]
    every = tuple(jw.Spring(ends, c, 0.2 * length * (ends == (1, 2)), axis=axis) for axis, c, ends in stiffness)
    mounts = jw.Mount(0.0, 0.0, 0.1, elevation=-0.05, roll=0.4), jw.Mount(0.0, 0.02 * length, z=0.05 * length)
    bent = {"bending_stiffness": force * length**2, "intrinsic_curvature": -0.3 / length}
    whiskers = jw.Whisker(length, **bent), jw.Whisker(1.1 * length, **bent)
    ball = jw.Sphere(0.9 * length, (0.0, 1.25 * length, 0.2 * length))
    return jw.Scene(whiskers, ball, jw.Support(every, mounts))


def test_whiskers_that_springs_connect_in_other_units():
    length, force = 20.0, 0.3
    result = jw.scan(springs(length, force), length * np.linspace(1.0, -0.2, 13))
    assert np.all(np.any(np.asarray(result.phase) > 0, axis=0))
    points = reconstruct(result, result.scene)
    assert_same_points(points, result, POINT * length)
    signals = six(result)
    signals["fy"][6, 1] = np.nan
    lacking = reconstruct(signals, result.scene)
    # The place of one base depends on the load on the other one.
    assert np.all(np.asarray(lacking.status)[6] == jw.PointStatus.missing) and np.all(np.isnan(lacking.base_x[6]))
    others = np.arange(13) != 6
    np.testing.assert_array_equal(np.asarray(lacking.x)[others], np.asarray(points.x)[others])
    assert "missing" in str(lacking)


def test_the_error_of_a_point_contains_the_yield_of_the_other_base():
    result = jw.scan(springs(), np.linspace(1.0, -0.2, 13))
    sigma = dict.fromkeys(SIX, 1e-3)
    signals, step = six(result), 8
    assert np.all(np.asarray(result.phase)[step] > 0)
    covariance, points = np.zeros((3, 3)), reconstruct(signals, result.scene, sigma=sigma)
    for k in range(2):
        for name in SIX:
            ends = []
            for sign in (1.0, -1.0):
                changed = signals | {name: signals[name].copy()}
                changed[name][step, k] += sign * 1e-5
                ends.append(np.asarray(reconstruct(changed, result.scene, sigma=sigma).point)[step, 0])
            by = (ends[0] - ends[1]) / 2e-5 * 1e-3
            covariance += np.outer(by, by)
    ours = np.asarray(points.covariance)[step, 0, :3, :3]
    np.testing.assert_allclose(ours, covariance, rtol=0, atol=1e-5 * np.max(covariance))


def test_force_and_moment_that_are_not_perpendicular_are_reported(straight):
    signals = six(straight)
    sigma = 0.01
    signals["my"] = signals["my"] + 0.2  # an offset of a sensor
    points, step = reconstruct(signals, straight.scene, sigma=sigma), 7
    force, moment = (np.array([signals[f"{kind}{a}"][step, 0] for a in "xyz"]) for kind in "fm")
    product = force @ moment
    sizes = np.linalg.norm(force), np.linalg.norm(moment)
    assert float(points.force_moment[step, 0]) == pytest.approx(product / (sizes[0] * sizes[1]), rel=1e-12)
    assert float(points.force_moment_score[step, 0]) == pytest.approx(product / (sigma * np.hypot(*sizes)), rel=1e-12)
    assert float(points.force_moment_score[step, 0]) > 10
    assert "force . moment" in str(points)
    assert np.max(np.abs(np.nan_to_num(reconstruct(straight, straight.scene).force_moment))) < 1e-12


def test_signals_of_scans_may_come_in_any_form(straight, tmp_path):
    points = reconstruct(straight, straight.scene)
    assert_same_points(points, straight, POINT)
    assert "nan" not in str(points) and "standard" not in str(points)
    jw.to_csv(straight, tmp_path / "scan.csv")
    for form in (straight.to_xarray(), jw.to_dataframe(straight), tmp_path / "scan.csv", six(straight)):
        np.testing.assert_allclose(reconstruct(form, straight.scene).point, points.point, rtol=0, atol=POINT)


def test_noise_that_is_not_given_is_estimated(straight):
    control = np.linspace(0.9, -0.2, 256)
    exact = jw.scan(straight.scene, control)
    rng = np.random.default_rng(4)
    noise = {name: 0.05 if name[0] == "f" else 0.03 for name in SIX}
    measured = {n: v if n == "control" else v + noise[n] * rng.standard_normal(v.shape) for n, v in six(exact).items()}
    points, given = reconstruct(measured, exact.scene), reconstruct(measured, exact.scene, sigma=noise)
    ratio = np.asarray(points.normal_error) / np.asarray(given.normal_error)
    assert np.nanmedian(ratio) == pytest.approx(1.0, rel=0.25)  # three standard errors of a median of 256 samples
    assert "standard error along the force" in str(points)


def sprung(stiffness):
    return jw.Scene(jw.Whisker(), BALL, jw.Support.follicle(x=stiffness, z=20.0))


def test_derivatives(monkeypatch):
    monkeypatch.setattr("jaxwhisker._inverse.reconstruct.BLOCK", 2)
    result = jw.scan(sprung(40.0), np.array([1.0, 0.72, 0.2]))
    assert [int(phase) for phase in result.phase[1:, 0]] == [jw.Phase.tip, jw.Phase.tangential]
    some = six(result, slice(1, None))
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, 6))

    def points(shift, stiffness):
        shifted = some | {n: some[n][:, 0] + shift[:, k] for k, n in enumerate(SIX)}
        found = reconstruct(shifted, sprung(stiffness), sigma=0.01)
        return jnp.concatenate([jnp.ravel(part) for part in (found.point, found.arc, found.force)])

    at = jnp.asarray(noise), jnp.asarray(40.0)

    @jax.jit
    def both(*at):
        value, pull = jax.vjp(points, *at)
        return value, jax.jacfwd(points, argnums=(0, 1))(*at), jax.vmap(pull)(jnp.eye(value.size))

    value, forward, reverse = both(*at)
    for ahead, back in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(ahead, back, rtol=0, atol=MODES * np.max(np.abs(ahead)))
    each = jax.jit(points)
    for step, channel in ((0, 0), (0, 1), (1, 2), (1, 5)):
        shift = jnp.zeros((2, 6)).at[step, channel].set(DIFFERENCE)
        by_channel = (each(at[0] + shift, at[1]) - each(at[0] - shift, at[1])) / (2 * DIFFERENCE)
        scale = np.max(np.abs(by_channel))
        np.testing.assert_allclose(forward[0][:, step, channel], by_channel, rtol=0, atol=DIFFERENCES * scale)
    by_stiffness = (each(at[0], at[1] + 1e-3) - each(at[0], at[1] - 1e-3)) / 2e-3
    np.testing.assert_allclose(forward[1], by_stiffness, rtol=0, atol=DIFFERENCES)
    assert np.max(np.abs(by_stiffness)) > 1e-4
    # The same in a batch, one element of which has no signal.
    batch = jax.vmap(points, in_axes=(0, None))(jnp.stack([at[0], at[0].at[0, 3].set(jnp.nan)]), at[1])
    np.testing.assert_allclose(batch[0], value, rtol=1e-12)
    lost = np.isnan(batch[1]).reshape(-1)
    assert lost[:3].all() and not lost[3:6].any()
    np.testing.assert_allclose(batch[1][~lost], value[~lost], rtol=1e-12)


def test_uncertain_parameters_widen_the_errors():
    result = jw.scan(sprung(40.0), np.linspace(0.9, 0.0, 10))
    sigma = dict.fromkeys(SIX, 0.01)
    exactly = reconstruct(result, result.scene, sigma=sigma)
    widened = reconstruct(result, sprung, sigma=sigma, parameters={"stiffness": 40.0}, covariance=np.diag([4.0]))
    np.testing.assert_allclose(exactly.x, widened.x, rtol=1e-12)
    ends = [reconstruct(result, sprung, sigma=sigma, parameters={"stiffness": c}).x for c in (40.01, 39.99)]
    added = np.asarray(widened.covariance - exactly.covariance)[..., 0, 0]
    np.testing.assert_allclose(added, 4.0 * ((ends[0] - ends[1]) / 0.02) ** 2, rtol=1e-4, atol=1e-13)


def test_signals_of_no_state_fail(straight):
    signals = six(straight)
    signals |= {name: -signals[name] for name in ("mx", "my", "mz")}
    points = reconstruct(signals, straight.scene, sigma=0.01)
    touching = np.asarray(straight.phase)[:, 0] > 0
    bad = np.asarray(points.status)[touching, 0] == jw.PointStatus.failed
    assert np.all(bad | (np.asarray(points.chi2)[touching, 0] > 100))


@pytest.mark.unchecked
def test_wrong_arguments(straight):
    signals, scene = six(straight), straight.scene
    with pytest.raises(ValueError, match=r"`measured` must hold fx, fy, fz, mx, my and mz.*got fx, fy, fz"):
        reconstruct({n: signals[n] for n in ("control", "fx", "fy", "fz")}, scene)
    with pytest.raises(ValueError, match="`measured` must hold f1 and f2 for whiskers of constant stiffness"):
        reconstruct(own(straight, ("f3", "m1", "m2")), scene)
    with pytest.raises(ValueError, match=r"`measured` must hold all components of the force.*friction"):
        reconstruct(own(straight, ("f3", "m1", "m2")), jw.Scene(HAIR, BALL, friction=0.3))
    with pytest.raises(ValueError, match="`measured` must be channels in one frame"):
        reconstruct(signals | own(straight), scene)
    with pytest.raises(ValueError, match="`sigma` must be a symmetric positive definite covariance"):
        reconstruct(signals, scene, sigma=-np.eye(6))
    with pytest.raises(ValueError, match="`sigma` must be a symmetric positive definite covariance"):
        reconstruct(signals, scene, sigma=np.eye(5))
    with pytest.raises(ValueError, match="`base` must be None in space"):
        reconstruct(signals, scene, base=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="`slip` must be None in space"):
        reconstruct(signals, scene, slip=1.0)
    springs = jw.Spring((0, 1), 5.0, axis="phi_x"), jw.Spring((1, 2), 5.0, axis="phi_x")
    with pytest.raises(ValueError, match="`sensor` must be a scene whose torsion springs do not connect"):
        reconstruct(signals, jw.Scene(jw.Whisker(), BALL, jw.Support(springs)))
    with pytest.raises(ValueError, match="`measured` must be values of the same channels of every whisker"):
        first = {"control": CONTROL} | {f"{n}_1": signals[n][:, 0] for n in SIX}
        reconstruct(first, jw.Scene(jw.Whisker(), BALL, jw.Support(mount=(jw.Mount(), jw.Mount(z=0.1)))))
