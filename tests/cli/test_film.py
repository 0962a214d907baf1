"""The command `film`: checks before the scan, and exit codes. Films are tested in tests/film."""

import pytest

from handmade import handmade_scan
from jaxwhisker import cli
from jaxwhisker.cli import film as command
from jaxwhisker.cli import scan as scan_command


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["scan.avi"], ["`path`", "scan.avi"]),
        (["nowhere/scan.gif"], ["no folder nowhere"]),
        (["/proc/scan.gif"], ["cannot write /proc/scan.gif"]),
        (["--seconds", "1e9", "scan.gif"], ["`seconds`", "1e+09"]),
        (["--seconds", "nan", "scan.gif"], ["`seconds`", "nan"]),
        (["--fps", "61", "scan.gif"], ["`fps`", "61"]),
        (["--width", "1", "scan.gif"], ["`width`", "1"]),
        (["--units", "inch", "scan.gif"], ["--units", "inch"]),
        (["--stiffness", "-1", "scan.gif"], ["`stiffness`", "-1.0"]),
    ],
)
def test_wrong_options_end_with_one_line_before_the_scan(argv, words, refuses, monkeypatch):
    monkeypatch.setattr(scan_command, "scan", lambda *_: pytest.fail("the scan was started"))
    refuses(["film", *argv], words)


@pytest.mark.parametrize(
    ("made", "code"),
    [({}, cli.OK), ({"failed": 1}, cli.NOT_ALL_OK), ({"touching": False}, cli.NO_CONTACT)],
)
def test_the_film_is_written_for_every_exit_code(made, code, tmp_path, monkeypatch, capsys):
    written = {}
    monkeypatch.setattr(scan_command, "scan", lambda scene, control: handmade_scan(**made))
    monkeypatch.setattr(command, "animate", lambda result, path, **settings: written.update(settings, path=path))
    path = tmp_path / "scan.gif"
    assert cli.main(["film", str(path), "--seconds", "3", "--units", "SI"]) == code
    assert written == {"path": path, "seconds": 3.0, "fps": 25, "width": 960, "units": "SI"}
    out = capsys.readouterr().out
    assert out.startswith("FB: 1 whisker") and out.endswith(f"wrote {path}\n")
