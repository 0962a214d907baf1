"""Bending tests: stiffness, taper and curvature from known loads and measured positions, reactions and shapes."""

import jax
import numpy as np
import pytest

import jaxwhisker as jw

# A steel ruler under its weight and a load at its tip: Belendez, Neipp, Belendez (2003), Int. J. Engng Ed. 19, 885,
# "Numerical and experimental analysis of a cantilever beam".
LENGTH, WIDTH, THICKNESS, WEIGHT = 0.4, 0.025, 0.0004, 0.3032  # m, N
FORCE = np.array([0.0, 0.098, 0.196, 0.294, 0.392, 0.490, 0.588])  # N
FALL = np.array([0.089, 0.149, 0.195, 0.227, 0.251, 0.268, 0.281])  # m, of the tip
RULER = {"force": FORCE, "tip_x": -FALL}
PUBLISHED = 194.3  # GPa, which the authors found to fit best
RECOVERED = 1e-6  # relative, from data without noise
LOADS = np.array([0.4, 1.0])
SHAPE = 9  # points
TRUTH = {"stiffness": 1.2, "taper": 0.7, "curvature": 0.3}
GUESS = {"stiffness": 0.8, "taper": 0.4, "curvature": 0.0}


def ruler(force, modulus):
    """A ruler, upright here: gravity is along -x."""
    beam = jw.Whisker(length=LENGTH, bending_stiffness=modulus * 1e9 * WIDTH * THICKNESS**3 / 12)
    return beam, jw.LineLoad(x=-WEIGHT / LENGTH), jw.PointForce(force)


def tapered(force, stiffness, taper, curvature):
    whisker = jw.Whisker(1.0, jw.Polynomial((stiffness, -stiffness * taper), 1.0), curvature)
    return whisker, jw.PointForce(force, position=0.9)


def bent(force, **parameters):
    whisker, *loads = tapered(force, **parameters)
    return jw.deflect(whisker, *loads)


@pytest.fixture(scope="module")
def shapes():
    """Points of two shapes, with their arc lengths and the moment at the base in the last row of each."""
    rows = {name: [] for name in ("force", "s", "x", "y", "angle", "mz")}
    for force in LOADS:
        found = bent(force, **TRUTH)
        s = np.linspace(0.1, 1.0, SHAPE)
        place = np.argmin(np.abs(np.asarray(found.s) - s[:, None]), axis=1)
        for name in ("s", "x", "y", "angle"):
            rows[name] += np.asarray(getattr(found, name))[place].tolist()
        rows["force"] += [force] * SHAPE
        rows["mz"] += [np.nan] * (SHAPE - 1) + [float(found.mz)]
    return {name: np.array(values) for name, values in rows.items()}


@pytest.fixture(scope="module")
def of_ruler():
    return jw.identify(ruler, {"modulus": 120.0}, RULER)


def test_a_published_beam(of_ruler):
    fit = of_ruler
    assert isinstance(fit, jw.BendingFit) and fit.status == jw.FitStatus.ok and fit.degrees == FALL.size - 1
    assert abs(fit.estimates["modulus"] - PUBLISHED) < fit.standard_error["modulus"] < 0.01 * PUBLISHED
    np.testing.assert_allclose(fit.fitted["tip_x"], -FALL, atol=0.003)  # their scatter
    np.testing.assert_allclose(fit.fitted["tip_x"], fit.deflections.x[:, -1], atol=1e-12)
    np.testing.assert_allclose(fit.residuals["tip_x"], -FALL - fit.fitted["tip_x"])
    assert fit.chi2 == pytest.approx(fit.degrees, rel=0.01)  # the noise is estimated from the residuals
    assert "modulus" in str(fit) and "identified" in str(fit)


def test_the_noise_decides_what_is_plausible(of_ruler):
    coarse, fine = (jw.identify(ruler, {"modulus": 200.0}, RULER, sigma=sigma) for sigma in (0.004, 1e-4))
    assert coarse.status == jw.FitStatus.ok
    assert coarse.estimates["modulus"] == pytest.approx(of_ruler.estimates["modulus"], rel=1e-3)
    ratio = 0.004 / of_ruler.sigma["tip_x"][0]
    assert coarse.standard_error["modulus"] == pytest.approx(ratio * of_ruler.standard_error["modulus"], rel=0.01)
    assert fine.status == jw.FitStatus.implausible and np.isnan(fine.standard_error["modulus"])
    # Twice the falls at the light loads fit no beam, whatever the noise.
    wrong = RULER | {"tip_x": -FALL * np.linspace(2.0, 1.0, FALL.size)}
    fit = jw.identify(ruler, {"modulus": 200.0}, wrong)
    assert fit.status == jw.FitStatus.implausible and "tip_x" in fit.reason


def test_stiffness_taper_and_curvature_from_shapes(shapes):
    fit = jw.identify(tapered, GUESS, shapes, sigma=1e-3)
    assert fit.status == jw.FitStatus.ok and fit.chi2 < 1e-6 and set(fit.residuals) == {"x", "y", "angle", "mz"}
    for name, value in TRUTH.items():
        assert fit.estimates[name] == pytest.approx(value, rel=RECOVERED)
        assert fit.identified[name] and 0 < fit.standard_error[name] < 0.1
    assert np.isnan(fit.measured["mz"]).sum() == 2 * (SHAPE - 1)
    np.testing.assert_array_equal(fit.case, np.repeat([0, 1], SHAPE))


def test_points_of_shapes_without_arc_lengths(shapes):
    points = {name: shapes[name] for name in ("force", "x", "y")}
    fit = jw.identify(tapered, GUESS, points, sigma=1e-3)
    assert fit.status == jw.FitStatus.ok and list(fit.residuals) == ["distance"]
    for name, value in TRUTH.items():
        assert fit.estimates[name] == pytest.approx(value, rel=RECOVERED)
    # The same points, moved by 0.01 to the left.
    across = shapes["angle"] + np.pi / 2
    moved = points | {"x": points["x"] + 0.01 * np.cos(across), "y": points["y"] + 0.01 * np.sin(across)}
    off = jw.identify(
        lambda force, stiffness: tapered(force, **TRUTH | {"stiffness": stiffness}), {"stiffness": 1.2}, moved
    )
    assert 0.002 < np.mean(off.residuals["distance"]) < 0.01


def test_the_standard_error_follows_from_the_derivatives():
    fit = jw.identify(ruler, {"modulus": 190.0}, RULER, sigma=0.004)
    at = fit.estimates["modulus"] * np.array([0.999, 1.001])
    falls = jax.vmap(lambda e, f: jw.deflect(*ruler(f, e)).x[-1])(np.repeat(at, FORCE.size), np.tile(FORCE, 2))
    slope = np.diff(np.reshape(falls, (2, -1)), axis=0) / np.diff(at)
    assert fit.standard_error["modulus"] == pytest.approx(0.004 / np.linalg.norm(slope), rel=1e-4)


def test_a_file_of_measurements(tmp_path, of_ruler):
    path = tmp_path / "ruler.csv"
    rows = [f"{force:.3f};{-fall:.3f}".replace(".", ",") for force, fall in zip(FORCE, FALL, strict=True)]
    path.write_text("\n".join(["force;tip_x", *rows]))
    fit = jw.identify(ruler, {"modulus": 150.0}, path)
    assert fit.estimates["modulus"] == pytest.approx(of_ruler.estimates["modulus"], rel=1e-4)


def test_a_whisker_that_cannot_be_deflected_is_a_failure():
    def column(force, modulus):
        beam, *_ = ruler(force, modulus)
        return beam, jw.LineLoad(y=-1e-3), jw.PointForce(force, direction=-np.pi / 2)

    # At the guess, the ruler may buckle to either side under the second load.
    rows = {"force": np.array([0.01, 5.0]), "tip_x": np.array([0.0, 0.0])}
    fit = jw.identify(column, {"modulus": 194.0}, rows, sigma=1e-3)
    assert fit.status == jw.FitStatus.failed and "unstable" in fit.reason and np.isnan(fit.standard_error["modulus"])


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"gains": True}, "`gains`.*omitted for bending tests"),
        ({"individual": ["modulus"]}, "`individual`"),
        ({"measured": {"force": FORCE, "tip_x": -FALL[:3]}}, "columns of one length"),
        ({"measured": {"force": [], "tip_x": []}}, "columns of one length, not empty"),
        (
            {"build": lambda modulus: ruler(0.1, modulus), "measured": {"deflection": FALL}},
            "columns among fx, .*got deflection",
        ),
        ({"measured": RULER | {"tip_x": FALL * np.nan}}, "more values than the 1 parameters, .*got 0"),
        ({"measured": {"force": FORCE[:1], "tip_x": -FALL[:1]}}, "more values than the 1 parameters"),
        ({"measured": {"force": FORCE, "angle": FALL}}, "angles need the arc length"),
        ({"measured": {"force": FORCE * np.nan, "tip_x": FALL}}, "finite numbers in the column force"),
        ({"measured": {"tip_x": -FALL}}, "'force'"),
        ({"sigma": {"tip_y": 1.0}}, "`sigma`.*tip_x"),
        ({"sigma": -1.0}, "`sigma`.*positive"),
        ({"sigma": np.nan}, "`sigma`.*positive"),
        ({"build": lambda force, modulus: (jw.PointForce(force * modulus),)}, "`build`.*a Whisker and its loads"),
        ({"build": lambda force, modulus: jw.Whisker(bending_stiffness=modulus + force)}, "`guess`"),
        ({"build": lambda force, modulus: ruler(force, float(modulus))}, "`build`.*JAX can trace"),
    ],
)
def test_wrong_arguments_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        jw.identify(**{"build": ruler, "guess": {"modulus": 190.0}, "measured": RULER} | arguments)
