"""Scenes in files, and the positions of the drive at which they are scanned."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.types import Control
from jaxwhisker._file.kinds import RENAMED, SCAN, file_arguments
from jaxwhisker._file.named import same
from jaxwhisker._file.numbers import Number, chosen, numbers_of, with_values
from jaxwhisker._file.reading import Document
from jaxwhisker._file.scan_range import WHOLE, ScanRange, spaced
from jaxwhisker._file.toml import text_of
from jaxwhisker._file.writing import tables_of
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._model.scene import Scene
from jaxwhisker._model.space_scene import SpaceScene


class SceneFile:
    """A file that describes a scene: the scene, its numbers by name, and how the commands scan it.

    Args:
        path: of the file.

    Raises:
        ValueError: if the file does not describe a scene; the message names the file, the line and the key.
    """

    scene: Scene | SpaceScene
    range: ScanRange

    def __init__(self, path: str | Path):
        self.path, self._document = path, Document.read(path)
        self.scene, self.range = _made_of(self._document)

    @cached_property
    def numbers(self) -> dict[str, Number]:
        """The numbers of the scene by name."""
        return numbers_of(self._document)

    def chosen(self, name: str) -> list[str]:
        """The names of the numbers that a name stands for.

        Raises:
            ValueError: if there are none.
        """
        found = chosen(name, self.numbers, self._document)
        if not found:
            raise ValueError(f"`{name}` must be a number in {self.path}: one of {', '.join(self.numbers)}.")
        return found

    def build(self, **values: Any) -> Scene | SpaceScene:
        """The scene with other values of some numbers, by name."""
        return _made_of(with_values(self._document, self.numbers, values))[0]

    def save(self, path: str | Path, values: Mapping[str, Any]) -> None:
        """Write the file with other values of some numbers, by name; comments are lost."""
        changed = {name: float(value) for name, value in values.items() if value != self.numbers[name].value}
        Path(path).write_text(text_of(with_values(self._document, self.numbers, changed).tables), "utf-8")


def _made_of(document: Document) -> tuple[Scene | SpaceScene, ScanRange]:
    return document.call(_make, file_arguments(), document.tables, (), "the scene", RENAMED)


def _make(objects: Any, scan: ScanRange = WHOLE, **parts: Any) -> tuple[Scene | SpaceScene, ScanRange]:
    """The scene of the keys of a file, and the range of its scan."""
    one = objects[0] if isinstance(objects, tuple) and len(objects) == 1 else objects
    return Scene(profile=one, **{_ARGUMENTS.get(key, key): value for key, value in parts.items()}), scan


_ARGUMENTS = {key: name for name, key in RENAMED.items()}


def load_scene(path: str | Path) -> Scene | SpaceScene:
    """The scene that a TOML file describes.

    [Scenes as files](../scene_files.md) describes the format. `jaxwhisker schema` prints it as a JSON schema.

    Args:
        path: of the file.

    Returns:
        A Scene, or a SpaceScene for an object in space.

    Raises:
        ValueError: if the file does not describe a scene. The message names the file, the line, the key and its value,
            and what is allowed.

    Examples:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp(), "sensor.toml")
        >>> jw.save_scene(jw.Scene(jw.Whisker(), jw.Circle(0.3, 0.5), friction=0.2), path)
        >>> print(path.read_text())
        friction = 0.2
        <BLANKLINE>
        [whisker]
        <BLANKLINE>
        [[objects]]
        kind = "circle"
        distance = 0.3
        radius = 0.5
        <BLANKLINE>
        >>> jw.load_scene(path)
        clamped: 1 whisker, circle q = 0.3, r = 0.5, friction 0.2
    """
    return SceneFile(path).scene


def load_control(path: str | Path) -> np.ndarray | None:
    """The drive positions in the table `scan` of a file that describes a scene.

    Args:
        path: of the file.

    Returns:
        Positions, shape (steps,), for `jw.scan(jw.load_scene(path), jw.load_control(path))`; None without such a table,
        for the default of `scan`.

    Raises:
        ValueError: as for `load_scene`.
    """
    file = SceneFile(path)
    return file.range.control(file.scene)


def save_scene(scene: AbstractScene, path: str | Path, control: Control | None = None) -> None:
    """Write a scene as a TOML file, from which `load_scene` makes the same scene, to the last digit.

    Args:
        scene: in the plane or in space, without Python functions and classes of your own.
        path: of the file; an existing file is overwritten.
        control: drive positions, shape (steps,), which `load_control` and the commands use. Default: those of `scan`.

    Raises:
        ValueError: if the scene has a part that a file cannot hold, such as a Python function; the message names it and
            what can take its place. Or if the scene is traced or a batch.
    """
    checks.instance("scene", scene, AbstractScene, "a Scene")
    tables = tables_of(scene)
    try:
        again = _made_of(Document("the file", tables, {}))[0]
    except ValueError as error:
        raise ValueError(f"`scene` must be a single scene to be written to a file: {error}") from error
    if not same(again, scene):
        checks.fail("scene", "one that a file gives again", str(scene))
    if control is not None:
        checks.vector("control", control)
        tables[SCAN] = _scan_table(np.asarray(control, dtype=float))
    Path(path).write_text(text_of(tables), "utf-8")


def _scan_table(control: np.ndarray) -> dict[str, Any]:
    start, stop = control[[0, -1]].tolist()
    if control.size > 1 and np.array_equal(control, spaced(start, stop, control.size)):
        return {"start": start, "stop": stop, "steps": control.size}
    return {"positions": control.tolist()}
