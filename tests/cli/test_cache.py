"""The command `cache`: what it shows and deletes."""

import os
import subprocess
import sys

import pytest

from jaxwhisker import cli
from jaxwhisker._base import store
from program_child import solved


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A store of this test's own."""
    monkeypatch.setenv("JAXWHISKER_CACHE", str(tmp_path / "programs"))
    return tmp_path / "programs"


def fill(folder, *sizes):
    """Write entries of these sizes."""
    folder.mkdir(mode=0o700)
    for number, size in enumerate(sizes):
        (folder / f"{number}{store.SUFFIX}").write_bytes(bytes(size))


def lines(capsys, *argv):
    assert cli.main(["cache", *argv]) == cli.OK
    out, err = capsys.readouterr()
    assert err == ""
    return out.splitlines()


def test_an_empty_cache(folder, capsys):
    assert lines(capsys) == [f"0 programs, 0 MB of at most 512 MB, in {folder}"]
    assert lines(capsys, "--clear") == [f"deleted 0 programs, 0 MB, from {folder}"]
    assert not folder.exists()


def test_number_and_size_include_what_an_interrupted_process_left(folder, capsys):
    fill(folder, 2**20, 2**19)
    (folder / f"left{store.UNFINISHED}").write_bytes(bytes(2**20))
    assert lines(capsys) == [f"2 programs, 2.5 MB of at most 512 MB, in {folder}"]
    assert lines(capsys, "--clear") == [f"deleted 2 programs, 2.5 MB, from {folder}"]
    assert list(folder.iterdir()) == []


def test_it_counts_the_programs_of_this_process(folder, capsys):
    solved(2)
    assert lines(capsys)[0].startswith("1 program, 0.0 MB of at most")


@pytest.mark.parametrize("argv", [[], ["--clear"]])
def test_a_cache_that_is_off(argv, folder, monkeypatch, capsys):
    fill(folder, 10)
    monkeypatch.setenv("JAXWHISKER_CACHE", "off")
    assert lines(capsys, *argv) == ["The cache is off (JAXWHISKER_CACHE is off): every process compiles its programs."]
    assert len(list(folder.iterdir())) == 1


def test_a_folder_that_is_not_used_is_reported_with_the_reason(folder, capsys, monkeypatch):
    fill(folder, 10)
    folder.chmod(0o777)
    assert lines(capsys)[1] == "The cache is not used: other users can write to it."
    folder.chmod(0o700)
    assert len(lines(capsys)) == 1
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    assert lines(capsys)[1] == f"The cache is not used: {folder} cannot be written to."


def test_a_file_in_place_of_the_folder(folder, capsys):
    folder.touch(mode=0o600)
    assert lines(capsys)[1] == "The cache is not used: it is a file."


def test_programs_that_cannot_be_deleted_end_with_one_line(folder, monkeypatch, capsys):
    fill(folder, 10)

    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(store.Path, "unlink", forbidden)
    assert cli.main(["cache", "--clear"]) == cli.USAGE
    assert capsys.readouterr().err == "jaxwhisker cache: error: [Errno 13] Permission denied\n"


def test_the_command_starts_no_device_and_compiles_nothing(folder):
    code = (
        "import jax, sys; from jaxwhisker import cli; assert cli.main(['cache']) == 0\n"
        "from jax._src import xla_bridge; sys.exit(xla_bridge.backends_are_initialized())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "") and str(folder) in done.stdout
