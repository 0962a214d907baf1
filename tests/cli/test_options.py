"""Options that commands share: scenes, drive positions, and checks of output files before the computation."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker.cli import options


def arguments(*argv):
    parser = argparse.ArgumentParser()
    options.add_sensor(parser)
    options.add_object(parser)
    options.add_drive(parser)
    return parser.parse_args(argv)


@pytest.mark.parametrize(
    ("argv", "scene"),
    [
        ([], jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2))),
        (["--model", "clamped"], jw.Scene(jw.Whisker(), jw.Parabola(0.2))),
        (
            ["--model", "fbfb", "--stiffness", "70,inf", "--rest-length", "0.2,0.3", "--profile", "circle"],
            jw.Scene(jw.Whisker(), jw.Circle(0.2, 1.0), jw.Support.fbfb([70.0, np.inf], [0.2, 0.3])),
        ),
        (
            ["--length", "2", "--bending-stiffness", "3", "--profile", "ellipse", "--b", "0.5", "--position", "0.1"],
            jw.Scene(jw.Whisker(2.0, 3.0), jw.Ellipse(0.4, a=2.0, b=0.5, position=0.1), jw.Support.fb(26.25, 0.4)),
        ),
        (
            ["--model", "fbfbr", "--length", "0.5", "--bending-stiffness", "0.5", "--distance", "0.3"],
            jw.Scene(jw.Whisker(0.5, 0.5), jw.Parabola(0.3, a=2.0), jw.Support.fbfbr(280.0, 0.1)),
        ),
    ],
)
def test_scenes_are_those_of_the_options(argv, scene):
    built = options.scene_of(arguments(*argv))
    assert str(built) == str(scene)
    assert [str(s) for s in built.support.springs] == [str(s) for s in scene.support.springs]


def test_positions_include_both_ends():
    np.testing.assert_allclose(options.positions(0.2, 0.9, 0.1), 0.2 + 0.1 * np.arange(8))
    np.testing.assert_allclose(options.positions(0.9, 0.2, 0.25), [0.9, 0.65, 0.4])
    with pytest.raises(ValueError, match=r"--step must leave at most 1,000,000 positions, got 1e-09"):
        options.positions(1.0, 0.0, 1e-9)


def test_ends_of_the_drive_default_to_those_of_the_default_control(monkeypatch):
    monkeypatch.setattr(options, "default_control", lambda scene: np.array([1.0, 0.5, -1.0]))

    def control(*argv) -> Any:
        args = arguments(*argv)
        return options.control_of(args, options.scene_of(args))

    assert control() is None
    np.testing.assert_allclose(control("--step", "0.5"), [1.0, 0.5, 0.0, -0.5, -1.0])
    np.testing.assert_allclose(control("--start", "0.25", "--step", "0.5"), [0.25, -0.25, -0.75])
    assert control("--stop", "0")[[0, -1]].tolist() == pytest.approx([1.0, 0.0])
    assert control("--stop", "0", "--length", "2").size == 501  # steps of 0.001 whisker lengths


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (".", "is a folder"),
        ("nowhere/scan.csv", "no folder nowhere"),
        ("/proc/scan.csv", "No such file"),  # a folder that even root cannot write
    ],
)
def test_files_that_cannot_be_written_are_rejected(path, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(options.UsageError, match=words):
        options.check_writable(None, Path(path))


@pytest.mark.parametrize(
    ("path", "words"),
    [("nowhere/out.zarr", "no folder nowhere"), ("file", "is a file"), ("/proc/out.zarr", "cannot write")],
)
def test_folders_that_cannot_be_written_are_rejected(path, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    with pytest.raises(options.UsageError, match=words):
        options.check_writable(Path(path), folder=True)


def test_checks_of_outputs_leave_nothing_behind(tmp_path):
    kept = tmp_path / "kept.csv"
    kept.write_text("kept")
    options.check_writable(kept, tmp_path / "new.csv")
    options.check_writable(tmp_path, tmp_path / "new.zarr", folder=True)
    assert [path.name for path in tmp_path.iterdir()] == ["kept.csv"] and kept.read_text() == "kept"
    options.check_writable(Path("/dev/null"))


def test_errors_about_the_control_name_its_options():
    with pytest.raises(options.UsageError, match="--start, --stop and --step"), options.usage_errors():
        raise ValueError("Springs this soft need an explicit `control`: the default would have 2,000,000 steps.")
