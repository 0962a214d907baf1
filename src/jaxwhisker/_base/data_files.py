"""Numbers from publications, in files beside the packages of the engine."""

from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "published"


@cache
def published(name: str) -> dict[str, Any]:
    """The tables of the file `published/<name>.toml`, whose comments name the units and sources."""
    import tomllib

    return tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))
