"""Commands with a file of a scene: the example files, control, options that do not go with a file, errors."""

import argparse
from pathlib import Path

import numpy as np
import pytest

import jaxwhisker as jw
from handmade import handmade_scan
from jaxwhisker import cli
from jaxwhisker.cli import explore, inverse
from jaxwhisker.cli import film as film_command
from jaxwhisker.cli import scan as scan_command
from jaxwhisker.cli.scene_file import control_of, file_of

ROOT = Path(__file__).parents[2]
SENSOR, VIBRISSA = (str(ROOT / "examples" / f"{name}.toml") for name in ("sensor", "vibrissa"))
EXACT = 1e-9  # relative: the file has all digits
FITTED = 1e-6  # relative: of fits to signals without noise

SMALL = """
[whisker]
mass_per_length = 1.0
[support]
kind = "FB"
stiffness = 50
rest_length = 0.1
[[objects]]
kind = "parabola"
distance = 0.3
[scan]
start = 0.9
stop = 0.5
steps = 21
units = "SI"
"""

# A straight whisker on a drive towards -x, past a ball beside its path.
BALL = """
friction = 0.3
[whisker]
[[objects]]
kind = "sphere"
radius = 1.0
centre = [0.0, 1.3, -0.5]
[scan]
start = 1.0
stop = -1.0
"""


def parsed(*argv) -> argparse.Namespace:
    return cli._parser().parse_args(argv)


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_the_scan_is_that_of_the_file(small, tmp_path, capsys):
    csv = tmp_path / "scan.csv"
    assert cli.main(["scan", str(small), "--csv", str(csv)]) == cli.OK
    out = capsys.readouterr().out
    assert out.startswith("FB: 1 whisker, 1 spring, parabola q = 0.3\n") and "control (m)" in out
    data = jw.read_columns(csv)
    result = jw.scan(jw.load_scene(small), jw.load_control(small))
    np.testing.assert_array_equal(data["control"], np.linspace(0.9, 0.5, 21))
    np.testing.assert_allclose(data["mz_1"], np.asarray(result.mz)[:, 0], rtol=EXACT)
    assert np.max(data["mz_1"]) > 0


@pytest.mark.parametrize(("scene", "step"), [("ball", "0.02"), ("vibrissa", "0.001")])
def test_scenes_in_space_are_scanned(scene, step, tmp_path, capsys):
    file, csv, plot = tmp_path / "ball.toml", tmp_path / "scan.csv", tmp_path / "scan.png"
    file.write_text(BALL, "utf-8")
    argv = ["scan", VIBRISSA if scene == "vibrissa" else str(file), "--csv", str(csv), "--plot", str(plot)]
    argv += ["--step", step]
    assert cli.main(argv) == cli.OK
    lines = capsys.readouterr().out.splitlines()
    words = next(line for line in lines if line.startswith("control")).split()
    assert [word for word in words if word[0] in "fm" and len(word) == 2] == ["fx", "fy", "fz", "mx", "my", "mz"]
    assert [line.split()[1] for line in lines if len(line.split()) > 3 and line.split()[1] in ("touch", "release")]
    assert any(line.split()[:2] == ["1", "fz"] for line in lines)
    assert np.max(np.abs(jw.read_columns(csv)["fz_1"])) > 0 and plot.stat().st_size > 0


@pytest.mark.parametrize("name", ["sensor", "vibrissa"])
def test_examples_are_scenes_that_are_written_again(name, tmp_path):
    scene, path = jw.load_scene(ROOT / "examples" / f"{name}.toml"), tmp_path / "again.toml"
    jw.save_scene(scene, path)
    assert str(jw.load_scene(path)) == str(scene)


@pytest.mark.parametrize(
    ("argv", "control"),
    [
        ([], np.linspace(0.9, 0.5, 21)),
        (["--start", "0.8"], np.linspace(0.8, 0.5, 21)),
        (["--stop", "0.8"], np.linspace(0.9, 0.8, 21)),
        (["--step", "0.1"], 0.9 - 0.1 * np.arange(5)),
        (["--start", "0.7", "--stop", "0.8", "--step", "0.05"], [0.7, 0.75, 0.8]),
    ],
)
def test_options_of_the_drive_come_before_the_file(argv, control, small):
    args = parsed("scan", str(small), *argv)
    file = file_of(args)
    assert file is not None
    np.testing.assert_allclose(np.asarray(control_of(args, file.scene, file)), control, rtol=EXACT)


def test_without_a_range_the_scan_goes_right_across(small):
    small.write_text(SMALL.partition("[scan]")[0])
    args = parsed("scan", str(small))
    file = file_of(args)
    assert file is not None and control_of(args, file.scene, file) is None
    args = parsed("scan", str(small), "--step", "0.05")
    some = control_of(args, file.scene, file)
    assert some is not None and some[0] > 0.5 > -0.5 > some[-1]


def test_units_are_those_of_the_options_or_of_the_file(small):
    for argv, units in ((["--units", "dimensionless"], "dimensionless"), ([], "SI")):
        args = parsed("scan", str(small), *argv)
        file_of(args)
        assert args.units == units


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("--model", "FB"), ("--stiffness", "70"), ("--rest-length", "0.2"), ("--length", "1.0")),
        *(("--bending-stiffness", "1.0"), ("--profile", "parabola"), ("--distance", "0.2"), ("--position", "0.0")),
        *(("--a", "1"), ("--b", "1"), ("--radius", "1"), ("--friction", "0.1"), ("--detect", "crossing")),
        ("--mass-per-length", "1"),
    ],
)
def test_options_of_scenes_do_not_go_with_a_file(option, value, capsys):
    """Not even with their defaults."""
    assert cli.main(["scan", SENSOR, option, value]) == cli.USAGE
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and f"{option} does not go with a file of a scene: change {SENSOR}" in err


ERRORS = {
    "value": (["scan"], "distance = 0.3", "distance = -1", ["line 10 (parabola)", "`distance`", "positive", "-1.0"]),
    "key": (["film"], "distance", "distanse", ["line 10", "`distanse` is not a key of parabola", "`distance`?"]),
    "syntax": (["explore", "--no-browser"], "distance =", "distance", ["line 10", "not TOML"]),
    "scan": (["identify"], "steps = 21", "steps = 0.5", ["line 14 (scan)", "`steps`", "0.5"]),
    "mass": (["scan", "--drive-speed", "1"], "mass_per_length = 1.0", "", ["--drive-speed", "`mass_per_length`"]),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", ERRORS)
def test_errors_in_files_end_with_one_line_and_exit_code_2(name, small, tmp_path, capsys):
    (command, *further), old, new, words = ERRORS[name]
    small.write_text(SMALL.replace(old, new))
    last = {"film": [str(tmp_path / "scan.gif")], "identify": ["data.csv", "--free", "stiffness"]}.get(command, [])
    assert cli.main([command, str(small), *last, *further]) == cli.USAGE
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(f"jaxwhisker {command}: error: ")
    assert [word for word in words if word not in err] == []


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["scan", "nowhere.toml"], ["nowhere.toml", "TOML"]),
        (["scan", VIBRISSA, "--drive-speed", "1"], ["--drive-speed", "plane"]),
        (["scan", VIBRISSA, "--lateral-curvature", "1"], ["--lateral-curvature", "plane"]),
        (["identify", SENSOR, "data.csv", "--free", "width"], ["`width`", "stiffness.1", "radius"]),
        (["identify", SENSOR, "nowhere.csv", "--free", "radius"], ["nowhere.csv"]),
        (["explore", "--no-browser", SENSOR, "--range", "width=1:2"], ["`width`", "radius"]),
        (["explore", "--no-browser", SENSOR, "--range", "radius"], ["--range", "NAME=RANGE"]),
        (["explore", "--no-browser", SENSOR, "--range", "radius=2:1"], ["`radius`", "low < high"]),
        (["explore", "--no-browser", "--range", "radius=1:2"], ["--range", "file"]),
        (["film", SENSOR, "scan.avi"], ["`path`", "scan.avi"]),
    ],
)
def test_wrong_options_end_with_one_line_and_exit_code_2(argv, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(argv) == cli.USAGE
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and [word for word in words if word not in err] == []


def test_motions_have_the_mass_and_range_of_the_file(small, monkeypatch, capsys):
    asked = {}

    def simulated(scene, ends, duration, **settings):
        asked.update(settings, ends=tuple(ends), duration=duration, mass=scene.whiskers[0].mass_per_length)
        return handmade_scan()

    monkeypatch.setattr("jaxwhisker._dynamics.simulate.simulate", simulated)
    assert cli.main(["scan", str(small), "--drive-speed", "0.1"]) == cli.OK
    assert asked["ends"] == (0.9, 0.5) and asked["mass"] == 1.0
    assert asked["duration"] == pytest.approx(4.0, rel=EXACT) and asked["steps"] == 20 * asked["every"]


def test_films_are_of_the_scene_in_the_file(monkeypatch, tmp_path, capsys):
    filmed, written = {}, {}
    monkeypatch.setattr(
        scan_command, "scan", lambda scene, control: filmed.update(scene=scene, control=control) or handmade_scan()
    )
    monkeypatch.setattr(film_command, "animate", lambda result, path, **settings: written.update(settings, path=path))
    path = tmp_path / "scan.gif"
    assert cli.main(["film", VIBRISSA, str(path), "--seconds", "3"]) == cli.OK
    assert str(filmed["scene"]) == str(jw.load_scene(VIBRISSA))
    np.testing.assert_array_equal(filmed["control"], jw.load_control(VIBRISSA))
    assert written["path"] == path and written["units"] == "auto"


def test_fits_find_the_numbers_of_the_file(small, tmp_path, capsys):
    scan, fit = tmp_path / "scan.csv", tmp_path / "fit.csv"
    assert cli.main(["scan", str(small), "--csv", str(scan)]) == cli.OK
    saved = tmp_path / "fitted.toml"
    argv = ["identify", str(small), str(scan), "--free", "stiffness,objects.distance", "--save", str(saved)]
    assert cli.main([*argv, "--guess", "distance=0.32,stiffness=40", "--csv", str(fit)]) == cli.OK
    out = capsys.readouterr().out
    assert f"fitting stiffness, distance to {scan}" in out
    rows = [line.split(",") for line in fit.read_text().splitlines()[1:]]
    assert {row[0]: pytest.approx(float(row[1]), rel=FITTED) for row in rows} == {"stiffness": 50.0, "distance": 0.3}
    assert 'kind = "FB"' in saved.read_text()
    assert 1 / float(jw.load_scene(saved).support.springs[0].softness) == pytest.approx(50.0, rel=FITTED)
    np.testing.assert_array_equal(np.asarray(jw.load_control(saved)), np.asarray(jw.load_control(small)))


def test_scenes_of_options_are_saved(monkeypatch, tmp_path, capsys):
    result = handmade_scan(0.05, 2.4e-5)
    monkeypatch.setattr(scan_command, "scan", lambda scene, control: result)
    path = tmp_path / "scene.toml"
    assert cli.main(["scan", "--save", str(path)]) == cli.OK
    assert capsys.readouterr().out.endswith(f"wrote {path}\n")
    assert str(jw.load_scene(path)) == str(result.scene)


def test_parameters_of_fits_are_those_of_the_file():
    file = file_of(parsed("identify", SENSOR, "data.csv", "--free", "radius"))
    assert file is not None
    values, expanded, build = inverse._of_file(file)
    names = "length youngs_modulus diameter stiffness.1 stiffness.2 stiffness.3 rest_length distance radius"
    assert list(values) == names.split()
    assert expanded("stiffness") == ["stiffness.1", "stiffness.2", "stiffness.3"]
    assert float(build(**values | {"radius": 0.04}).profile.radius) == 0.04


@pytest.mark.parametrize(
    ("argv", "sliders"),
    [
        ([SENSOR], dict.fromkeys(("distance", "radius"), (0.01, 0.09, 0.03)) | {"rest_length": (0.006667, 0.06, 0.02)}),
        ([SENSOR, "--range", "radius=0.02:0.04"], {"radius": (0.02, 0.04, 0.03)}),
        ([SENSOR, "--range", "radius=0.04:0.05,length=0.2"], {"radius": (0.04, 0.05), "length": (0.06667, 0.6, 0.2)}),
        (
            [SENSOR, "--range", "stiffness=1:10:2"],
            {"stiffness.1": (1.0, 10.0, 2.0), "stiffness.2": (1.0, 10.0, 2.0), "stiffness.3": (1.0, 10.0, 2.0)},
        ),
        (
            [VIBRISSA],
            {
                "friction": (0.06667, 0.6, 0.2),
                "x": (0.3333, 3.0, 1.0),
                "phi": (3.333e-5, 3e-4, 1e-4),
                "elevation": (0.03333, 0.3, 0.1),
            },
        ),
        ([VIBRISSA, "--range", "centre.3=-0.01:0.01"], {"centre.3": (-0.01, 0.01, 0.0)}),
    ],
)
def test_sliders_follow_the_file(argv, sliders):
    args = parsed("explore", *argv)
    file = file_of(args)
    assert file is not None
    found = explore._sliders_of(file, args.range)
    assert found == {name: pytest.approx(limits) for name, limits in sliders.items()}
    assert set(explore._kinds_of(file, found)) == set(sliders)


def test_sliders_know_kinds_of_numbers():
    file = file_of(parsed("explore", SENSOR))
    assert file is not None
    assert explore._kinds_of(file, ["stiffness.1", "radius", "youngs_modulus"]) == {
        **{"stiffness.1": "stiffness", "radius": "length", "youngs_modulus": "number"}
    }


def test_pages_show_scenes_of_files():
    from jaxwhisker._explore.session import Session

    file = file_of(parsed("explore", SENSOR))
    assert file is not None
    sliders = explore._sliders_of(file, None)
    session = Session(file.build, sliders, explore._kinds_of(file, sliders))
    assert [slider.name for slider in session.sliders] == ["rest_length", "distance", "radius"]
    answer = session.answer({slider.name: slider.start for slider in session.sliders})
    assert b"jw.Circle(distance=0.03, radius=0.03)" in answer
