"""The command line: help, version, exit codes, errors on one line, and `python -m jaxwhisker`."""

import os
import subprocess
import sys
from importlib.metadata import version

import pytest

from jaxwhisker import cli
from jaxwhisker.cli import scan as command

COMMANDS = ("scan", "film", "explore", "study", "identify", "reconstruct", "reproduce", "cache", "schema")


def test_the_module_runs_as_a_command_in_its_own_process(tmp_path):
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


@pytest.mark.parametrize("argv", [["--help"], *([name, "--help"] for name in COMMANDS)])
def test_help_fits_a_terminal(argv, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(argv) == cli.OK
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("usage: jaxwhisker")


def test_the_version_is_that_of_the_package(capsys):
    assert cli.main(["--version"]) == cli.OK
    assert capsys.readouterr().out == f"jaxwhisker {version('jaxwhisker')}\n"


@pytest.mark.parametrize("argv", [[], ["scan", "--speed", "1"], ["reproduce", "--only", "6.2,6.25"]])
def test_wrong_commands_and_options_end_with_one_line(argv, capsys):
    assert cli.main(argv) == cli.USAGE
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("jaxwhisker")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device"), "No space left"),
        (MemoryError(), "not enough memory"),
        (ValueError("`fps` must be\nat most 60, got 61."), "`fps` must be at most 60, got 61."),
        (ImportError("`study` needs zarr: pip install jaxwhisker[study]"), "pip install jaxwhisker[study]"),
    ],
)
def test_errors_while_running_end_with_one_line(error, words, capsys, monkeypatch):
    def fail(*_):
        raise error

    monkeypatch.setattr(command, "scan", fail)
    assert cli.main(["scan"]) == cli.USAGE
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and err.startswith("jaxwhisker scan: error: ") and words in err


def test_ctrl_c_has_its_own_exit_code(monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "scan", interrupt)
    assert cli.main(["scan"]) == cli.INTERRUPTED
