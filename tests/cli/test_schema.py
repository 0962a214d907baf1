"""The command `schema`."""

import json

from jaxwhisker import cli
from jaxwhisker._file.schema import schema


def test_the_schema_is_printed(capsys):
    assert cli.main(["schema"]) == cli.OK
    assert json.loads(capsys.readouterr().out) == schema()
