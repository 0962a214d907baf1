"""A study on disk: a zarr group that xarray reads at any time, and a note of which blocks are complete.

    study.zarr/            the Dataset: what is not computed yet is NaN, -1 or False
    study.zarr/.study/     lock (held while somebody computes), the description, done/<block>.json

A block is noted once its chunks are on disk; a resumed study computes what is not noted. The empty Dataset is written
beside, in study.zarr.new, and renamed when complete.
"""

import fcntl
import json
import os
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._path.path import Status
from jaxwhisker._study.description import Description, difference
from jaxwhisker._study.layout import Layout
from jaxwhisker._study.parameters import Blocks, Index

if TYPE_CHECKING:
    import xarray as xr

NOTES, LOCK, DESCRIPTION, DONE = ".study", "lock", "study.json", "done"
GROUP = '{"zarr_format": 3, "node_type": "group", "attributes": {}}'  # makes zarr take the notes for a part of it


class Store:
    """The place of a study on disk, held by one process at a time.

    Raises:
        ValueError: if there is something else, or somebody else computes there.
    """

    def __init__(self, path: str | os.PathLike[str]):
        if not isinstance(path, str | os.PathLike) or "://" in str(path):
            raise ValueError(f"`store` must be the path of a folder, but is {path!r}.")
        self.path = Path(path).absolute()
        self._new = self.path.with_name(self.path.name + ".new")
        if self.path.exists() and not (self.path / NOTES / DESCRIPTION).is_file():
            raise ValueError(f"`store` must hold a study or not exist, but {path} is something else.")
        if not self.path.parent.is_dir():
            raise ValueError(f"`store` must be in a folder that exists, but there is no {self.path.parent}.")
        self._lock = self._locked()
        self._known: Description | None = None
        if self.path.exists():
            self._known = json.loads((self.path / NOTES / DESCRIPTION).read_text())

    def _locked(self) -> int:
        while True:
            folder = self.path if self.path.exists() else self._new
            (folder / NOTES).mkdir(parents=True, exist_ok=True)
            lock = os.open(folder / NOTES / LOCK, os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                raise ValueError(
                    f"`store` must be free, but another process computes the study in {self.path}."
                ) from None
            if folder == self.path or not self.path.exists():
                return lock
            os.close(lock)  # another process has made the study in between

    def close(self) -> None:
        """Let others have the store. The system does so, too, when a process dies."""
        os.close(self._lock)

    def control(self) -> np.ndarray:
        """The control of the study that is there."""
        import zarr

        return np.asarray(zarr.open_array(self.path / "control", mode="r")[:])

    def begin(self, layout: Layout, blocks: Blocks, description: Description) -> dict[Index, np.ndarray]:
        """Go on with the study or lay it out; return the status of all points of the blocks that are complete.

        Raises:
            ValueError: if the store holds another study.
        """
        import zarr

        if self.check(description) is None:
            self._lay_out(layout, blocks, description)
        self._layout, self._blocks = layout, blocks
        group = zarr.open_group(self.path, mode="r+", use_consolidated=False)
        self._arrays: dict[str, Any] = {name: group[name] for name in layout.variables}
        return dict(self._noted(note) for note in sorted((self.path / NOTES / DONE).glob("*.json")))

    def check(self, description: Description) -> Description | None:
        """The description of the study that is there, which must agree with this one; None if there is none."""
        if self._known is None:
            return None
        differs = difference(description, self._known)
        if differs:
            raise ValueError(
                f"`store` must hold this study or not exist, but {self.path} holds another study: {differs}."
            )
        return self._known

    def _lay_out(self, layout: Layout, blocks: Blocks, description: Description) -> None:
        """Write the empty Dataset, all or nothing."""
        import zarr
        from zarr.errors import ZarrUserWarning

        for entry in (*self._new.iterdir(), *(self._new / NOTES).iterdir()):  # of somebody who was killed here
            if entry.name not in (NOTES, LOCK):
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        _replace(self._new / NOTES / "zarr.json", GROUP)
        with warnings.catch_warnings():
            # That others may not read consolidated metadata, and that the notes are no part of the Dataset.
            warnings.simplefilter("ignore", ZarrUserWarning)
            layout.frame().to_zarr(self._new, mode="a", zarr_format=3, consolidated=False)
            group = zarr.open_group(self._new, mode="r+", use_consolidated=False)
            for name, field in layout.variables.items():
                shape = layout.shape(name)
                known = layout.attributes(name)
                group.create_array(
                    name,
                    shape=shape,
                    dtype=field.dtype,
                    chunks=(*blocks.block, *(max(1, n) for n in shape[len(blocks.block) :])),
                    fill_value=field.fill,
                    dimension_names=layout.dims(name),
                    attributes={k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in known.items()},
                )
            zarr.consolidate_metadata(self._new)
        notes = self._new / NOTES
        (notes / DONE).mkdir(exist_ok=True)
        (notes / DESCRIPTION).write_text(json.dumps(description))
        for folder, _, files in os.walk(self._new):
            for name in files:
                _sync(Path(folder) / name)
            _sync(Path(folder))
        os.rename(self._new, self.path)
        _sync(self.path.parent)

    def write(self, index: Index, arrays: dict[str, np.ndarray], worst: np.ndarray) -> None:
        """Put the variables of a block's points, the first axis of each, in their place, then note the block."""
        region = self._blocks.region(index)
        folders = set()
        for name, target in self._arrays.items():
            shape = tuple(part.stop - part.start for part in region) + target.shape[len(region) :]
            target[region] = arrays[name].reshape(shape)
            chunk = self.path / name / Path("c", *map(str, index), *["0"] * (len(shape) - len(region)))
            if chunk.exists():  # a chunk of nothing but fill values is not
                _sync(chunk)
                folders |= {chunk.parent, *chunk.parents[1 : len(shape)]}
        for folder in folders:
            _sync(folder)
        bad = np.flatnonzero(worst != Status.ok)
        note = {"points": worst.size, "failed": {str(k): int(worst[k]) for k in bad}}
        _replace(self.path / NOTES / DONE / f"{'.'.join(map(str, index))}.json", json.dumps(note))

    def _noted(self, path: Path) -> tuple[Index, np.ndarray]:
        note = json.loads(path.read_text())
        worst = np.zeros(note["points"], np.int8)
        for k, status in note["failed"].items():
            worst[int(k)] = status
        return tuple(int(k) for k in path.stem.split(".")), worst

    def dataset(self, points: str) -> "xr.Dataset":
        """The study, read when its values are asked for; what became of its points is noted in the store."""
        import xarray as xr

        # By hand: zarr would write the attributes and then, apart from them, their consolidated copy.
        metadata = json.loads((self.path / "zarr.json").read_text())
        metadata["attributes"]["points"] = points
        _replace(self.path / "zarr.json", json.dumps(metadata))
        return xr.open_zarr(self.path, chunks=None)


def _replace(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    temporary = path.with_name(f"{path.name}.tmp")
    temporary.write_text(text)
    _sync(temporary)
    os.replace(temporary, path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
