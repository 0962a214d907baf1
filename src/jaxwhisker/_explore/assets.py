"""What a browser gets: page, style, and one module of the scripts."""

from importlib.resources import files


def _packaged(name: str) -> str:
    return files("jaxwhisker._explore").joinpath(name).read_text(encoding="utf-8")


PAGE, STYLE = _packaged("explore.html"), _packaged("explore.css")
SCRIPT = _packaged("draw.js") + "\n" + _packaged("explore.js")  # anywidget takes one module, which imports nothing
