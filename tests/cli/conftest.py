"""What all commands do with wrong options."""

import pytest

from jaxwhisker import cli


@pytest.fixture
def refuses(tmp_path, monkeypatch, capsys):
    """Check that a command with wrong options ends with one line that contains these words, and leaves no file."""

    def check(argv, words):
        monkeypatch.chdir(tmp_path)
        assert cli.main(argv) == cli.USAGE
        out, err = capsys.readouterr()
        assert out == "" and err.endswith("\n") and err.count("\n") == 1
        assert err.startswith(f"jaxwhisker {argv[0]}: error:")
        assert [word for word in words if word not in err] == []
        assert list(tmp_path.iterdir()) == []

    return check
