"""The command line: exit codes, messages, files; the catalogue and the page of the reproduction."""

import os
import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from matplotlib.image import imread

import jaxwhisker as jw
from jaxwhisker import cli, thesis
from jaxwhisker._path.path import Status
from jaxwhisker.cli import scan as command
from jaxwhisker.thesis import page
from jaxwhisker.thesis.catalogue import FIGURES
from jaxwhisker.thesis.claim import CLAMPED, MAXIMA
from jaxwhisker.thesis.critical import bracket, slope, trials
from jaxwhisker.thesis.scans import Case, Scans, snap_through

CSV_DIGITS = 1e-8  # files hold nine significant digits
PRINTED = 1e-6  # the table of events shows six decimals of the control
THESIS_DIGIT = 5.001e-5  # half a unit of the last printed digit
MAXIMUM = 1e-6  # relative: the maxima are printed to this
BATCHED = 1e-8  # rounding is another one in a batch

BAD = {
    "stiffness": (["scan", "--model", "FB", "--stiffness", "-3"], ["`stiffness`", "-3.0", "positive"]),
    "stiffness zero": (["scan", "--stiffness", "0"], ["`stiffness`", "0.0", "positive"]),
    "stiffness count": (["scan", "--model", "FBFB", "--stiffness", "1,2,3"], ["`stiffness`", "one per spring (2)"]),
    "stiffness word": (["scan", "--stiffness", "stiff"], ["--stiffness", "'stiff'"]),
    "stiffness of nothing": (["scan", "--model", "clamped", "--stiffness", "3"], ["--stiffness", "clamped"]),
    "rest length": (["scan", "--rest-length", "nan"], ["`rest_length`", "nan"]),
    "model": (["scan", "--model", "FBX"], ["--model", "'FBX'", "FBFBFBR"]),
    "length": (["scan", "--length", "0"], ["`length`", "0.0"]),
    "bending stiffness": (["scan", "--bending-stiffness", "inf"], ["`bending_stiffness`", "inf"]),
    "distance": (["scan", "--distance", "-0.1"], ["`distance`", "-0.1"]),
    "radius": (["scan", "--profile", "circle", "--radius", "-1"], ["`radius`", "-1.0"]),
    "radius of a parabola": (["scan", "--radius", "1"], ["--radius", "parabola"]),
    "profile": (["scan", "--profile", "square"], ["--profile", "square"]),
    "step": (["scan", "--step", "0"], ["--step", "0.0"]),
    "too many steps": (["scan", "--start", "1", "--stop", "0", "--step", "1e-9"], ["--step", "1e-09"]),
    "start": (["scan", "--start", "inf"], ["--start", "inf"]),
    "option": (["scan", "--speed", "1"], ["--speed"]),
    "no command": ([], ["command"]),
    "picture's kind": (["scan", "--plot", "scan.doc"], ["--plot", "scan.doc", ".png"]),
    "picture's folder": (["scan", "--plot", "nowhere/scan.png"], ["nowhere"]),
    "csv's folder": (["scan", "--csv", "nowhere/scan.csv"], ["nowhere"]),
    "csv is a folder": (["scan", "--csv", "."], ["is a folder"]),
    "figure": (["reproduce", "--only", "6.2,6.25"], ["--only", "'6.25'"]),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_ends_with_one_line_and_exit_code_2(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    argv, words = BAD[name]
    assert cli.main(argv) == cli.USAGE
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n") and err.count("\n") == 1
    assert err.startswith("jaxwhisker")
    for word in words:
        assert word in err
    assert list(tmp_path.iterdir()) == []


def test_the_module_runs_as_a_command_in_a_process_of_its_own(tmp_path):
    environment = {key: value for key, value in os.environ.items() if key != "JAX_ENABLE_X64"}

    def run(*argv):
        command = [sys.executable, "-m", "jaxwhisker", *argv]
        return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300)

    wrong = run("scan", "--model", "FB", "--stiffness", "-3")
    assert wrong.returncode == cli.USAGE
    assert wrong.stdout == "" and wrong.stderr.count("\n") == 1 and "Traceback" not in wrong.stderr
    right = run("scan", "--start", "0.7", "--stop", "0.6", "--step", "0.01", "--csv", "scan.csv")
    assert (right.returncode, right.stderr) == (cli.OK, "")
    assert "touch" in right.stdout and (tmp_path / "scan.csv").exists()


@pytest.mark.parametrize("argv", [["--help"], ["scan", "--help"], ["study", "--help"], ["reproduce", "--help"]])
def test_help_fits_a_terminal(argv, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(argv) == cli.OK
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("usage: jaxwhisker")


def test_help_shows_every_default(capsys):
    cli.main(["scan", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    options = [word for word in shown.split() if word.startswith("--") and word[2:].replace("-", "").isalpha()]
    for option in {"--stiffness", "--rest-length", "--length", "--distance", "--a", "--b", "--radius", "--step"}:
        assert option in options
    outputs_and_choices = 3  # --help, --plot and --csv have none
    described = shown.split("options:")[1].split("Any consistent")[0]
    assert (
        described.count("default:") >= len({o for o in described.split() if o.startswith("--")}) - outputs_and_choices
    )


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """One scan by command line: exit code, what was printed, and the folder with its files."""
    folder = tmp_path_factory.mktemp("scan")
    argv = ["scan", "--stiffness", "50", "--distance", "0.3", "--rest-length", "0.1"]
    files = ["--plot", str(folder / "scan.png"), "--csv", str(folder / "scan.csv")]
    command = [sys.executable, "-m", "jaxwhisker", *argv, *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    return done, folder


def _read(path):
    """Columns of a CSV below a comment line, by name."""
    lines = path.read_text().splitlines()
    assert lines[0].startswith("# ")
    rows = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines[2:]])
    return dict(zip(lines[1].split(","), rows.T, strict=True))


def test_csv_holds_the_scan(scanned):
    done, folder = scanned
    assert (done.returncode, done.stderr) == (cli.OK, "")
    columns = _read(folder / "scan.csv")
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support.fb(50.0, 0.1)))
    for name in ("fx", "fy", "mz", "base_x", "contact_force", "contact_slope", "contact_arc", "phase"):
        expected = np.asarray(getattr(result, name))[:, 0]
        np.testing.assert_allclose(columns[f"{name}_1"], expected, rtol=CSV_DIGITS, atol=CSV_DIGITS)
    np.testing.assert_allclose(columns["control"], result.control, atol=CSV_DIGITS)
    np.testing.assert_allclose(columns["spring_1"], np.asarray(result.spring_length)[:, 0], atol=CSV_DIGITS)
    assert np.all(columns["status"] == Status.ok)


def test_screen_shows_events_and_peaks(scanned):
    done, _ = scanned
    lines = done.stdout.splitlines()
    assert lines[0] == "FB: 1 whisker, 1 spring, parabola q = 0.3"
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support.fb(50.0, 0.1)))
    printed = [line.split() for line in lines]
    for event in result.events:
        rows = [words for words in printed if len(words) > 1 and words[1] == event.kind.name]
        assert rows, event.kind.name
        assert min(abs(float(words[0]) - event.control) for words in rows) < PRINTED
    assert any(words[:2] == ["1", "mz"] and words[4] == f"{np.max(result.mz):.5f}" for words in printed)
    assert f"{result.control.size} steps: {result.control.size} ok" in lines


def test_picture_is_no_blank(scanned):
    _, folder = scanned
    picture = imread(folder / "scan.png")
    assert picture.shape[0] > 500 and picture.shape[1] > 800
    assert np.std(picture[..., :3]) > 0.05


def test_control_is_what_the_options_say(tmp_path, capsys):
    path = tmp_path / "scan.csv"
    argv = ["scan", "--model", "fb", "--start", "0.2", "--stop", "0.9", "--step", "0.1", "--csv", str(path)]
    assert cli.main(argv) == cli.OK
    columns = _read(path)
    np.testing.assert_allclose(columns["control"], 0.2 + 0.1 * np.arange(8), atol=CSV_DIGITS)
    assert columns["contact_force_1"][0] > 0 and columns["contact_force_1"][-1] == 0
    assert "release" in capsys.readouterr().out


def test_failed_steps_are_counted_and_end_with_exit_code_1(monkeypatch, capsys):
    def failing(scene, control=None):
        result = jw.scan(scene, control)
        bad = np.arange(result.control.size) >= result.control.size - 2
        nan = lambda leaf: np.where(bad[:, None], np.nan, leaf)  # noqa: E731
        fields = lambda r: (r.fx, r.fy, r.mz)  # noqa: E731
        result = eqx.tree_at(fields, result, tuple(nan(np.asarray(leaf)) for leaf in fields(result)))
        return eqx.tree_at(lambda r: r.status, result, np.where(bad, int(Status.lost), 0))

    monkeypatch.setattr(command, "scan", failing)
    assert cli.main(["scan", "--start", "0.9", "--stop", "0.8", "--step", "0.01"]) == cli.NOT_ALL_OK
    assert "11 steps: 9 ok, 2 lost" in capsys.readouterr().out


def test_every_number_of_the_thesis_is_in_the_catalogue():
    chapters = {5: range(10, 17), 6: range(1, 25), 7: (4,)}
    assert list(FIGURES) == [f"{chapter}.{k}" for chapter, numbers in chapters.items() for k in numbers]
    titles = [figure.title for figure in FIGURES.values()]
    assert len(set(titles)) == len(titles)


def test_names_are_read_with_and_without_leading_zero():
    assert thesis.names("6.02, a.1,CLAIMS,7.4") == ["6.2", "A.1", "claims", "7.4"]
    with pytest.raises(ValueError, match=r"'6\.99'"):
        thesis.names("6.99")


def test_reproduce_writes_what_it_is_asked_for(tmp_path, capsys):
    out = tmp_path / "results" / "here"
    assert cli.main(["reproduce", "--out", str(out), "--only", "6.02,A.1"]) == cli.OK
    stems = {"figure_6.02", "table_A.1"}
    files = {f"{stem}{ending}" for stem in stems for ending in (".png", ".csv")}
    assert {path.name for path in out.iterdir()} == files | {"README.md", "index.html"}
    for file in ("README.md", "index.html"):
        text = (out / file).read_text()
        assert all(f"{name}" in text for name in ("figure_6.02.png", "figure_6.02.csv", "table_A.1.csv", "0.8795"))
    assert np.std(imread(out / "figure_6.02.png")[..., :3]) > 0.05

    rows = [line.split(",") for line in (out / "table_A.1.csv").read_text().splitlines()]
    assert rows[0] == ["load", "reaction", "jaxwhisker", "thesis", "difference", "multi-body"]
    assert len(rows) == 1 + 5 * 3
    for _, _, ours, printed, difference, _ in rows[1:]:
        assert abs(float(ours) - float(printed)) < THESIS_DIGIT
        assert abs(float(ours) - float(printed) - float(difference)) < PRINTED

    columns = _read(out / "figure_6.02.csv")
    rigid = columns["mz_1 (c=inf)"].max()
    for c in ("30", "50", "70", "100", "200"):
        assert abs(columns[f"mz_1 (c={c})"].max() / rigid - 1) < 1e-4  # read off the steps
        assert (
            columns["control"][np.argmax(columns[f"mz_1 (c={c})"])]
            < columns["control"][np.argmax(columns["mz_1 (c=inf)"])]
        )
    assert "2 results" in capsys.readouterr().out


SOFT = Case(stiffness=30.0)


@pytest.fixture(scope="module")
def scans():
    with Scans([CLAMPED, SOFT, *trials("FB", 0.2)]) as kept:
        yield kept


def test_one_whisker_snaps_through_below_the_steepest_slope_only(scans):
    low, high = bracket(scans, trials("FB", 0.2))
    assert low < slope(0.2).slope < high
    assert snap_through(scans(SOFT)) is None


@pytest.mark.parametrize(("name", "expected"), [("min_fx", -7.40235), ("max_fy", 20.89341), ("max_mz", 6.46427)])
def test_peaks_are_those_of_the_clamped_whisker(scans, name, expected):
    assert name in MAXIMA
    assert abs(scans.summary(CLAMPED, name, 1) / expected - 1) < MAXIMUM
    assert abs(scans.summary(SOFT, name, 1) / expected - 1) < MAXIMUM


def test_a_case_of_a_study_is_the_result_of_its_scan(scans):
    study, alone = scans(SOFT), jw.scan(scans(SOFT).scene, SOFT.control())
    for one, other in zip(jax.tree.leaves(study), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=BATCHED)


def test_reproduce_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "xarray", None)
    assert cli.main(["reproduce", "--out", str(tmp_path), "--only", "6.2"]) == cli.USAGE
    assert "pip install jaxwhisker[study]" in capsys.readouterr().err


def test_a_page_is_written_as_markdown_and_html():
    blocks = [
        page.Heading(1, "Title"),
        page.Paragraph("a < b", strong="Found:"),
        page.Table([["x", "y"], ["1", "a|b"]], files=("t.csv",)),
        page.Image("f.png", "What it shows", "f.csv"),
    ]
    text = page.markdown(blocks)
    assert text.startswith("# Title\n\n**Found:** a < b\n\n| x | y |\n| ---: | ---: |\n| 1 | a\\|b |\n")
    assert "![What it shows](f.png)" in text and "(f.csv)" in text and "(t.csv)" in text
    html = page.html(blocks)
    assert "<title>Title</title>" in html and "<strong>Found:</strong> a &lt; b" in html
    assert 'src="f.png"' in html and 'href="f.csv"' in html and "<td>a|b</td>" in html
