"""The commands `identify` and `reconstruct` with the data of the example: tables, files, exit codes, messages."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from jaxwhisker import cli
from jaxwhisker.cli import inverse, options

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "examples"))

import make_measured  # noqa: E402

DATA = str(ROOT / "examples" / "measured.csv")
LIKELY = 4.0  # standard errors: exceeded by one estimate in 16,000
SCATTER = 0.2  # relative error of the noise estimated from 882 samples: four standard errors of a median
WRITTEN = 1e-5  # relative: six digits

NOISE = ",".join(f"{name}={value}" for name, value in make_measured.NOISE.items())


def test_the_script_of_the_example_writes_the_stored_file(tmp_path):
    make_measured.write(tmp_path / "measured.csv")
    made, stored = (np.loadtxt(p, delimiter=",", skiprows=2) for p in (tmp_path / "measured.csv", DATA))
    np.testing.assert_allclose(made, stored, rtol=WRITTEN, atol=WRITTEN)


def test_identify_prints_and_writes_estimates_close_to_the_truth(tmp_path, capsys):
    csv, plot = tmp_path / "fit.csv", tmp_path / "fit.png"
    argv = ["--model", "FBFBR", "--guess", "stiffness=100,distance=0.25", "--free", "stiffness,distance"]
    assert cli.main(["identify", DATA, *argv, "--csv", str(csv), "--plot", str(plot)]) == cli.OK
    out = capsys.readouterr().out
    assert "standard error" in out and "identified" in out and "not identified" not in out
    rows = [line.split(",") for line in csv.read_text().splitlines()]
    assert rows[0] == ["parameter", "estimate", "standard_error", "low", "high"]
    truth = dict(zip(("c1", "c2", "c3", "distance"), (*make_measured.STIFFNESS, 0.3), strict=True))
    assert {row[0] for row in rows[1:]} == set(truth)
    for name, estimate, error, low, high in rows[1:]:
        assert abs(float(estimate) - truth[name]) < LIKELY * float(error)
        assert float(low) < float(estimate) < float(high)
    assert imread(plot).std() > 0


def test_reconstruct_writes_points_close_to_the_object(tmp_path, capsys):
    csv, plot = tmp_path / "points.csv", tmp_path / "points.pdf"
    stiffness = ",".join(map(str, make_measured.STIFFNESS))
    argv = ["--model", "FBFBR", "--stiffness", stiffness, "--sigma", NOISE, "--family", "parabola"]
    assert cli.main(["reconstruct", DATA, *argv, "--csv", str(csv), "--plot", str(plot)]) == cli.OK
    assert "whisker 2: vertex at" in capsys.readouterr().out
    table = np.genfromtxt(csv, delimiter=",", names=True, skip_header=1)
    clear = table["normal_error_1"] < 0.01
    off = np.abs(table["y_1"] - 0.3 - table["x_1"] ** 2) / np.sqrt(1 + 4 * table["x_1"] ** 2)
    assert clear.sum() > 100 and np.all(off[clear] < LIKELY * table["normal_error_1"][clear])
    assert plot.stat().st_size > 0


@pytest.mark.filterwarnings("default")
def test_reconstruct_estimates_the_noise_of_a_table_of_a_spreadsheet(tmp_path, capsys):
    path = tmp_path / "measured.csv.gz"
    frame = pd.read_csv(DATA, comment="#").assign(température=20.5)
    frame.to_csv(path, sep=";", decimal=",", encoding="latin-1")
    argv = ["--model", "FBFBR", "--stiffness", ",".join(map(str, make_measured.STIFFNESS)), "--family", "parabola"]
    assert cli.main(["reconstruct", str(path), *argv]) == cli.OK
    out, error = capsys.readouterr()
    assert error.startswith("jaxwhisker: warning: Columns of `measured`") and error.endswith(": température.\n")
    assert error.count("\n") == 1 and "nan" not in out
    estimated = dict(pair.split("=") for pair in out.partition("samples: ")[2].splitlines()[0].split(", "))
    for name, sigma in make_measured.NOISE.items():
        assert float(estimated[name]) == pytest.approx(sigma, rel=SCATTER)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda frame: frame[["control", "mz_1", "mz_2"]], "no value of fx_1, fy_1, fx_2, fy_2"),
        (lambda frame: frame.assign(mz_1=-frame.mz_1, mz_2=-frame.mz_2), "check the sign of mz"),
    ],
)
def test_missing_and_negated_signals_are_named(change, words, tmp_path, capsys):
    path = tmp_path / "measured.csv"
    change(pd.read_csv(DATA, comment="#")).to_csv(path, index=False)
    assert cli.main(["reconstruct", str(path), "--model", "FBFBR"]) == cli.USAGE
    assert words in capsys.readouterr().err


def arguments(*argv):
    return cli._parser().parse_args(["identify", DATA, "--free", "c1", *argv])


@pytest.mark.parametrize(
    ("argv", "names"),
    [
        (
            ["--model", "FBFBR", "--stiffness", "60,80,70"],
            "c1 c2 c3 l1 l2 l3 length bending_stiffness distance position a",
        ),
        (["--model", "clamped", "--profile", "circle"], "length bending_stiffness distance position radius"),
    ],
)
def test_parameters_build_the_scene_of_the_options(argv, names):
    args = arguments(*argv)
    values = inverse._parameters(args)
    built, expected = options.make_scene(args, **values), options.scene_of(args)
    assert list(values) == names.split()
    assert str(built) == str(expected)
    for spring, other in zip(built.support.springs, expected.support.springs, strict=True):
        assert (spring.between, float(spring.softness)) == (other.between, float(other.softness))
        assert float(spring.rest_length) == pytest.approx(float(other.rest_length))


def test_stiffness_and_rest_length_stand_for_all_springs():
    values = inverse._parameters(arguments("--model", "FBFB"))
    assert inverse._expanded("stiffness", values) == ["c1", "c2"]
    assert inverse._expanded("rest_length", values) == ["l1", "l2"]
    assert inverse._expanded("c2", values) == ["c2"]
    with pytest.raises(options.UsageError, match=r"parameters of the scene \(c1, c2, .*\), got radius"):
        inverse._expanded("radius", values)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["identify", "none.csv", "--free", "distance"], ["none.csv"]),
        (["identify", DATA, "--model", "FBFBR", "--free", "radius"], ["radius", "distance"]),
        (["identify", DATA, "--free", "distance"], ["2"]),
        (["identify", DATA, "--model", "FBFBR", "--free", "distance", "--guess", "distance"], ["NAME=VALUE"]),
        (["identify", DATA, "--model", "FBFBR", "--free", "distance", "--sigma", "fx=0"], ["`sigma`", "0.0"]),
        (["identify", DATA, "--model", "FBFBR", "--free", "distance", "--csv", "/none/fit.csv"], ["/none"]),
        (["reconstruct", DATA, "--model", "FBFBR", "--sigma", "-1"], ["`sigma`", "-1.0"]),
        (["reconstruct", DATA, "--model", "FB"], ["whiskers"]),
        (["reconstruct", DATA, "--model", "FBFBR", "--plot", "x.abc"], ["x.abc"]),
    ],
)
def test_wrong_options_end_with_one_line_and_exit_code_2(argv, words, capsys):
    assert cli.main(argv) == cli.USAGE
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and all(word in error for word in words)
