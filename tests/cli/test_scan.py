"""The command `scan`: messages, tables, files, exit codes."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.image import imread

import jaxwhisker as jw
from handmade import SI, handmade_scan
from jaxwhisker import cli
from jaxwhisker.cli import scan as command

CSV_DIGITS = 1e-8  # files contain nine significant digits
PRINTED = 1e-6  # the table of events shows six decimals of the control

BAD = {
    "stiffness": (["--model", "FB", "--stiffness", "-3"], ["`stiffness`", "-3.0", "positive"]),
    "stiffness zero": (["--stiffness", "0"], ["`stiffness`", "0.0", "positive"]),
    "stiffness count": (["--model", "FBFB", "--stiffness", "1,2,3"], ["`stiffness`", "one per spring (2)"]),
    "stiffness word": (["--stiffness", "stiff"], ["--stiffness", "got 'stiff'"]),
    "stiffness of no spring": (["--model", "clamped", "--stiffness", "3"], ["--stiffness", "clamped"]),
    "rest length": (["--rest-length", "nan"], ["`rest_length`", "nan"]),
    "model": (["--model", "FBX"], ["--model", "got 'FBX'", "FBFBFBR"]),
    "length": (["--length", "0"], ["`length`", "0.0"]),
    "bending stiffness": (["--bending-stiffness", "inf"], ["`bending_stiffness`", "inf"]),
    "distance": (["--distance", "-0.1"], ["`distance`", "-0.1"]),
    "radius": (["--profile", "circle", "--radius", "-1"], ["`radius`", "-1.0"]),
    "radius of a parabola": (["--radius", "1"], ["--radius", "parabola"]),
    "profile": (["--profile", "square"], ["--profile", "square"]),
    "step": (["--step", "0"], ["--step", "got 0.0"]),
    "too many steps": (["--start", "1", "--stop", "0", "--step", "1e-9"], ["--step", "got 1e-09"]),
    "start": (["--start", "inf"], ["--start", "got inf"]),
    "lateral curvature": (["--lateral-curvature", "round"], ["--lateral-curvature", "round"]),
    "units": (["--units", "inch"], ["--units", "inch", "dimensionless"]),
    "format of the picture": (["--plot", "scan.doc"], ["--plot", "scan.doc", ".png"]),
    "folder of the picture": (["--plot", "nowhere/scan.png"], ["nowhere"]),
    "folder of the csv": (["--csv", "nowhere/scan.csv"], ["nowhere"]),
    "csv is a folder": (["--csv", "."], ["is a folder"]),
    "picture that cannot be written": (["--plot", "/proc/scan.png"], ["cannot write /proc/scan.png"]),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_options_end_with_one_line_and_exit_code_2(name, refuses):
    argv, words = BAD[name]
    refuses(["scan", *argv], words)


def test_help_shows_every_default(capsys):
    cli.main(["scan", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    described = shown.split("options:")[1].split("Any consistent")[0]
    names = {word for word in described.split() if word.startswith("--") and word[2:].replace("-", "").isalpha()}
    assert {"--stiffness", "--rest-length", "--length", "--distance", "--a", "--b", "--radius", "--step"} <= names
    without = {"--help", "--plot", "--csv", "--save", "--stop."}
    assert described.count("default:") >= len(names - without)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """A scan from the command line: the finished process, and the folder with its files."""
    folder = tmp_path_factory.mktemp("scan")
    argv = ["scan", "--stiffness", "50", "--distance", "0.3", "--rest-length", "0.1"]
    files = ["--plot", str(folder / "scan.png"), "--csv", str(folder / "scan.csv")]
    line = [sys.executable, "-m", "jaxwhisker", *argv, *files]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300)
    return done, folder


def read(path):
    """Columns of a CSV below a comment line, by name."""
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# ")
    rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines[2:]])
    return dict(zip(lines[1].split(","), rows.T, strict=True))


def test_the_csv_contains_the_scan(scanned):
    done, folder = scanned
    assert (done.returncode, done.stderr) == (cli.OK, "")
    columns = read(folder / "scan.csv")
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support.fb(50.0, 0.1)))
    for name in ("fx", "fy", "mz", "base_x", "contact_force", "contact_slope", "contact_arc", "phase"):
        expected = np.asarray(getattr(result, name))[:, 0]
        np.testing.assert_allclose(columns[f"{name}_1"], expected, rtol=CSV_DIGITS, atol=CSV_DIGITS)
    np.testing.assert_allclose(columns["control"], result.control, atol=CSV_DIGITS)
    np.testing.assert_allclose(columns["spring_1"], np.asarray(result.spring_length)[:, 0], atol=CSV_DIGITS)
    assert np.all(columns["status"] == jw.Status.ok)


def test_the_output_shows_events_and_peaks(scanned):
    done, _ = scanned
    lines = done.stdout.splitlines()
    assert lines[0] == "FB: 1 whisker, 1 spring, parabola q = 0.3"
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support.fb(50.0, 0.1)))
    printed = [line.split() for line in lines]
    for event in result.events:
        rows = [words for words in printed if len(words) > 1 and words[1] == event.kind.name]
        assert rows, event.kind.name
        assert min(abs(float(words[0]) - event.control) for words in rows) < PRINTED
    assert any(words[:3] == ["1", "mz", "(EI/L)"] and words[5] == f"{np.max(result.mz):.5f}" for words in printed)
    assert f"{result.control.size} steps: {result.control.size} ok" in lines


def test_picture_is_not_blank(scanned):
    _, folder = scanned
    picture = imread(folder / "scan.png")
    assert picture.shape[0] > 500 and picture.shape[1] > 800
    assert np.std(picture[..., :3]) > 0.05


def test_control_is_that_of_the_options(tmp_path, capsys):
    path = tmp_path / "scan.csv"
    argv = ["scan", "--model", "fb", "--start", "0.2", "--stop", "0.9", "--step", "0.1", "--csv", str(path)]
    assert cli.main(argv) == cli.OK
    columns = read(path)
    np.testing.assert_allclose(columns["control"], 0.2 + 0.1 * np.arange(8), atol=CSV_DIGITS)
    assert columns["contact_force_1"][0] > 0 and columns["contact_force_1"][-1] == 0
    assert "release" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("made", "code", "line"),
    [
        ({"failed": 1}, cli.NOT_ALL_OK, "2 steps: 1 ok, 1 lost"),
        ({"failed": 2, "touching": False}, cli.NOT_ALL_OK, "2 steps: 2 lost"),
        ({}, cli.OK, "2 steps: 2 ok"),
        ({"touching": False}, cli.NO_CONTACT, "No whisker touches the object: all reactions are zero."),
    ],
)
def test_exit_code_and_last_line_report_how_the_scan_ended(made, code, line, monkeypatch, capsys):
    monkeypatch.setattr(command, "scan", lambda scene, control: handmade_scan(**made))
    assert cli.main(["scan"]) == code
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == line
    assert ("minimum" in out) == made.get("touching", True)  # no tables of zeros


def test_units_of_the_tables_follow_the_option(monkeypatch, capsys):
    monkeypatch.setattr(command, "scan", lambda scene, control: handmade_scan(*SI))
    for units, words in (("auto", "fx (mN)"), ("SI", "mz (mN mm)"), ("dimensionless", "fx (EI/L^2)")):
        assert cli.main(["scan", "--units", units]) == cli.OK
        assert words in capsys.readouterr().out


def test_friction_and_detection_are_options(capsys):
    argv = ["scan", "--model", "FBFBR", "--friction", "0.3", "--detect", "crossing", "--step", "0.05"]
    assert cli.main(argv) == cli.NOT_ALL_OK  # the whiskers cross
    out = capsys.readouterr().out
    assert "friction 0.3, detects crossing" in out and " crossing" in out.splitlines()[-1]
    assert cli.main(["scan", "--friction", "-1"]) == cli.USAGE
    assert "`friction`" in capsys.readouterr().err


def test_the_loss_of_lateral_stability_is_an_option(capsys, tmp_path):
    picture = tmp_path / "scan.png"
    options = ["scan", "--model", "FB", "--stiffness", "70", "--lateral-curvature", "0", "--plot", str(picture)]
    assert cli.main(options) == 0
    printed = capsys.readouterr().out
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0))
    (vertex,) = jw.scan(scene).events.of(jw.EventKind.vertex)
    assert f"whisker 1 leaves the plane at u = {vertex.control:+.6g}" in printed
    assert picture.exists()


def test_motions_in_time_have_no_lateral_stability(capsys):
    assert cli.main(["scan", "--lateral-curvature", "0", "--drive-speed", "0.1"]) == 2
    assert "--lateral-curvature" in capsys.readouterr().err
