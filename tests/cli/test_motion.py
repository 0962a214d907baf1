"""Motion in time from the command line: options, the simulation that they describe, output of `scan` and `film`."""

import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import jaxwhisker as jw
from jaxwhisker import cli
from jaxwhisker._dynamics import simulate as dynamics
from jaxwhisker.cli import film as film_command
from jaxwhisker.cli import motion as command
from jaxwhisker.cli import options
from jaxwhisker.cli import scan as scan_command
from pictured import failed_motion, swept

TOUCH = 1e-6  # error of the drive position at the first touch of a straight whisker, which moves at constant speed
ROUNDING = 1e-12
MOVES = ["--drive-speed", "0.5", "--mass-per-length", "1"]


def parsed(*argv, of="scan"):
    from jaxwhisker.cli import _parser

    return _parser().parse_args([of, *argv])


@pytest.fixture(scope="module")
def motion():
    return swept()


@pytest.mark.parametrize("of", [["scan"], ["film", "motion.gif"]], ids=["scan", "film"])
@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--mass-per-length", "1"], ["--mass-per-length needs --drive-speed"]),
        (["--stiffness-damping", "0.1"], ["--stiffness-damping needs --drive-speed"]),
        (["--time-step", "0.1"], ["--time-step needs --drive-speed"]),
        (["--drive-speed", "1"], ["--drive-speed needs --mass-per-length"]),
        ([*MOVES, "--drive-speed", "0"], ["--drive-speed must be a positive finite number, got 0.0"]),
        ([*MOVES, "--drive-speed", "nan"], ["--drive-speed", "nan"]),
        ([*MOVES, "--drive-speed", "fast"], ["--drive-speed", "'fast'"]),
        ([*MOVES, "--time-step", "-1"], ["--time-step must be a positive finite number, got -1.0"]),
        ([*MOVES, "--mass-per-length", "0"], ["`mass_per_length`", "0.0"]),
        ([*MOVES, "--detect", "crossing"], ["--detect"]),
    ],
)
def test_wrong_options_end_with_one_line_before_anything_is_computed(of, argv, words, refuses):
    refuses([*of, *argv], words)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--start", "0.5", "--stop", "0.5"], "--step must leave at least two positions between --start and --stop"),
        (["--stiffness", "inf", "--start", "1", "--stop", "0"], "`stiffness` must be finite for a simulation"),
        (
            ["--start", "1", "--stop", "0", "--time-step", "1e-9"],
            "--drive-speed must leave at most 2,000,000 time steps, got 0.5, which leaves 2,000,000,000",
        ),
        (["--stiffness-damping", "-1", "--start", "1", "--stop", "0"], "`stiffness_damping` must be"),
    ],
)
def test_motions_that_cannot_be_simulated_end_with_one_line(argv, words, capsys):
    assert cli.main(["scan", *MOVES, *argv]) == cli.USAGE
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--playback-speed", "1"], "--playback-speed needs --drive-speed"),
        ([*MOVES, "--playback-speed", "0"], "--playback-speed must be a positive finite number, got 0.0"),
        ([*MOVES, "--playback-speed", "1", "--seconds", "3"], "--playback-speed must not be given with --seconds"),
        (
            [*MOVES, "--playback-speed", "1e-3"],
            "--playback-speed must be at least 0.01 for a film of at most 300 seconds",
        ),
    ],
)
def test_wrong_playback_ends_with_one_line(argv, words, motion, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scan_command, "motion_of", lambda *_: motion)
    assert cli.main(["film", "motion.gif", *argv]) == cli.USAGE
    assert words in capsys.readouterr().err and list(tmp_path.iterdir()) == []


@pytest.fixture
def asked(monkeypatch):
    """What is asked of `simulate`; scans end at -1."""
    found = {}

    def simulate(scene, drive, duration, **settings):
        found.update(settings, scene=scene, drive=drive, duration=duration)

    monkeypatch.setattr(dynamics, "simulate", simulate)
    monkeypatch.setattr(options, "default_control", lambda scene: np.array([1.0, 0.0, -1.0]))
    return found


def test_samples_are_the_positions_of_a_drive_at_constant_speed(asked):
    args = parsed(*MOVES, "--start", "0.8", "--stop", "0.4", "--step", "0.01", "--stiffness-damping", "0.02")
    command.motion_of(args, options.scene_of(args))
    np.testing.assert_allclose(asked["drive"], [0.8, 0.4], atol=ROUNDING)
    assert asked["duration"] == pytest.approx(0.4 / 0.5)
    assert (asked["every"], asked["steps"]) == (4, 160)  # 0.02 between samples, in steps of 0.005
    assert asked["stiffness_damping"] == 0.02 and asked["scene"].whiskers[0].mass_per_length == 1.0


def test_the_default_step_and_end_follow_the_unit_of_time(asked):
    # T = 2^2 sqrt(9 / 4) = 6
    args = parsed(*MOVES, "--mass-per-length", "9", "--length", "2", "--bending-stiffness", "4", "--step", "0.1")
    command.motion_of(args, options.scene_of(args))
    np.testing.assert_allclose(asked["drive"], [1.0, -7.0])  # for 2 T beyond -1
    assert asked["every"] == 7 and asked["steps"] == 80 * 7  # 0.2 between samples, in steps of at most 0.03
    command.motion_of(parsed(*MOVES, "--step", "0.1", "--time-step", "0.2"), options.scene_of(parsed(*MOVES)))
    assert asked["every"] == 1


def test_a_motion_touches_where_its_tip_meets_the_object(tmp_path, capsys):
    path = tmp_path / "motion.csv"
    argv = ["--model", "clamped", "--start", "0.95", "--stop", "0.85", "--step", "0.01", "--csv", str(path)]
    assert cli.main(["scan", *MOVES, *argv, "--stiffness-damping", "0.02"]) == cli.OK
    out = capsys.readouterr().out
    touch = re.search(r"([\d.]+) +([\d.]+) +touch +1\n", out)
    assert touch is not None
    assert float(touch[2]) == pytest.approx(np.sqrt(0.8), abs=TOUCH)
    assert float(touch[1]) == pytest.approx((0.95 - np.sqrt(0.8)) / 0.5, abs=1e-5)  # five decimals
    table = pd.read_csv(path, comment="#")
    np.testing.assert_allclose(table.control, 0.95 - 0.5 * table.time, atol=ROUNDING)
    np.testing.assert_allclose(table.control, 0.95 - 0.01 * np.arange(11), atol=ROUNDING)


def test_scan_prints_and_draws_a_motion(motion, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(scan_command, "motion_of", lambda *_: motion)
    assert cli.main(["scan", *MOVES, "--plot", str(tmp_path / "motion.png")]) == cli.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].split() == ["time", "(T)", "control", "(L)", "event", "whisker"]
    shown = [line.split() for line in lines[4 : 4 + len(motion.events)]]
    assert [(float(time), kind) for time, _, kind, _ in shown] == [
        (pytest.approx(event.time / 0.5, abs=1e-5), event.kind.name) for event in motion.events
    ]
    assert "101 samples: 101 ok" in lines and (tmp_path / "motion.png").stat().st_size > 10_000
    monkeypatch.setattr(scan_command, "motion_of", lambda *_: failed_motion(motion, 60))
    assert cli.main(["scan", *MOVES]) == cli.NOT_ALL_OK


@pytest.mark.parametrize(
    ("argv", "seconds"), [([], 12.0), (["--seconds", "3"], 3.0), (["--playback-speed", "0.5"], 6.0)]
)
def test_a_film_takes_the_time_of_its_options(argv, seconds, motion, tmp_path, monkeypatch):
    written = {}
    monkeypatch.setattr(scan_command, "motion_of", lambda *_: motion)
    monkeypatch.setattr(film_command, "animate", lambda result, path, **settings: written.update(settings, run=result))
    assert cli.main(["film", str(tmp_path / "motion.gif"), *MOVES, *argv]) == cli.OK
    assert written["run"] is motion and written["seconds"] == seconds


def test_a_motion_without_contact_says_so(motion, monkeypatch, capsys):
    fields = {name: getattr(motion, name) for name in jw.Simulation.__dataclass_fields__}
    free = jw.Simulation(**fields | {"phase": 0 * motion.phase})
    monkeypatch.setattr(scan_command, "motion_of", lambda *_: free)
    assert cli.main(["scan", *MOVES]) == cli.NO_CONTACT
    assert capsys.readouterr().out.endswith("No whisker touches the object.\n")


def test_the_command_line_loads_the_dynamics_only_for_a_motion():
    code = (
        "import sys\nfrom jaxwhisker import cli\ncli.main(['scan', '--drive-speed', '1'])\n"
        "sys.exit(any(name.startswith('jaxwhisker._dynamics') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0
