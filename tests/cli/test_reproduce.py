"""The command `reproduce`: messages. Its results are tested in tests/thesis."""

import sys

import pytest

from jaxwhisker import cli
from jaxwhisker.thesis import reproduce as results


def test_wrong_names_end_with_one_line_and_leave_no_folder(tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["reproduce", "--out", str(out), "--only", "6.2,6.25"]) == cli.USAGE
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "got '6.25'" in err
    assert not out.exists()


@pytest.mark.parametrize("out", ["file", "file/out", "/proc/out"])
def test_a_folder_that_cannot_be_written_ends_with_one_line(out, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    monkeypatch.setattr(results, "reproduce", lambda *_: pytest.fail("the computation was started"))
    assert cli.main(["reproduce", "--out", out]) == cli.USAGE
    assert capsys.readouterr().err.count("\n") == 1


def test_a_missing_package_is_reported_with_its_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "xarray", None)
    assert cli.main(["reproduce", "--out", str(tmp_path), "--only", "6.2"]) == cli.USAGE
    assert "pip install jaxwhisker[study]" in capsys.readouterr().err
