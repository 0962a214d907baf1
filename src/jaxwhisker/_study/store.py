"""Storage for the results of a study while it is computed: memory, or a zarr store from which it can be resumed.

A store is a Dataset that xarray can read at any time; values that are not computed yet are NaN, -1 or False. The
chunk of `point_status` that belongs to a block is written last, in one operation: a block whose chunk is missing is
computed again. The empty Dataset is written to study.zarr.new and renamed when it is complete, and study.zarr.lock is
locked while a process computes.
"""

import fcntl
import os
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._study.compute import Arrays
from jaxwhisker._study.layout import NOT_COMPUTED, POINT_STATUS, Layout
from jaxwhisker._study.parameters import BlockIndex, Blocks

if TYPE_CHECKING:
    import xarray as xr


class StudyInMemory:
    """A study in memory."""

    def resumed(self, layout: Layout) -> None:
        """Resume nothing: there is no earlier study."""

    def begin(self, layout: Layout, blocks: Blocks) -> set[BlockIndex]:
        """Allocate all variables; no block is complete."""
        self._layout, self._blocks = layout, blocks
        self._arrays = {n: np.full(layout.shape(n), q.fill, q.dtype) for n, q in layout.variables.items()}
        return set()

    def write(self, index: BlockIndex, arrays: Arrays) -> None:
        """Keep the variables of a block; their first axis runs over its points."""
        region = self._blocks.region(index)
        for name, target in self._arrays.items():
            target[region] = arrays[name].reshape(target[region].shape)

    def dataset(self, attributes: dict[str, str] | None = None) -> "xr.Dataset":
        """The study with additional attributes."""
        layout = self._layout
        variables = {n: (layout.dims(n), array, layout.attributes(n)) for n, array in self._arrays.items()}
        return layout.frame().assign(variables).assign_attrs(attributes or {})

    def close(self) -> None:
        """Release nothing."""


class Store:
    """A study on disk, used by one process at a time.

    Args:
        path: folder of the zarr store; it may exist already.

    Raises:
        ValueError: if `path` is not a path in an existing folder, something else than a study is there, or another
            process is using it.
    """

    def __init__(self, path: str | os.PathLike[str]):
        if not isinstance(path, str | os.PathLike) or "://" in str(path):
            raise ValueError(f"`store` must be the path of a folder, got {path!r}.")
        self.path = Path(path).absolute()
        if not self.path.parent.is_dir():
            raise ValueError(f"`store` must be in an existing folder, got {path}, and {self.path.parent} is missing.")
        if self.path.exists():
            _open(self.path)
        self._lock = self._locked()
        self._stored = _open(self.path) if self.path.exists() else None

    def _locked(self) -> int:
        while True:
            lock = os.open(self._beside("lock"), os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                raise ValueError(
                    f"`store` must not be in use, got {self.path}, in which another process is computing."
                ) from None
            if os.fstat(lock).st_nlink:
                return lock
            os.close(lock)  # its last user has just removed the file: try again

    def _beside(self, suffix: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{suffix}")

    def close(self) -> None:
        """Release the store. The operating system also does so when a process dies."""
        self._beside("lock").unlink(missing_ok=True)
        os.close(self._lock)

    def _group(self) -> Any:
        import zarr

        return zarr.open_group(self.path, mode="r+", use_consolidated=False)

    def resumed(self, layout: Layout) -> tuple[Layout, Blocks] | None:
        """The layout and blocks of the stored study, if there is one.

        Raises:
            ValueError: if it is another study.
        """
        if self._stored is None:
            return None
        if different := layout.difference(self._stored):
            raise ValueError(
                f"`store` must be that of the same study or not exist, got {self.path}, which differs: {different}."
            )
        blocks = Blocks(layout.parameters.shape, self._group()[POINT_STATUS].chunks)
        return layout._replace(control=self._stored["control"].values), blocks

    def begin(self, layout: Layout, blocks: Blocks) -> set[BlockIndex]:
        """Create the store if it does not exist, and return the blocks that are complete."""
        if self._stored is None:
            self._create(layout, blocks)
        self._blocks, group = blocks, self._group()
        self._arrays = {name: group[name] for name in layout.variables}
        status = self._arrays[POINT_STATUS][...]
        return {index for index in blocks.indices() if not np.any(status[blocks.region(index)] == NOT_COMPUTED)}

    def _create(self, layout: Layout, blocks: Blocks) -> None:
        """Write the empty Dataset, all or nothing."""
        import zarr

        new = self._beside("new")
        shutil.rmtree(new, ignore_errors=True)  # left by a process that was killed while writing it
        layout.frame().to_zarr(new, zarr_format=3, consolidated=False)
        group = zarr.open_group(new, mode="r+", use_consolidated=False)
        for name, quantity in layout.variables.items():
            shape, dims, attributes = layout.shape(name), layout.dims(name), layout.attributes(name)
            chunks = (*blocks.block, *(max(1, n) for n in shape[len(blocks.block) :]))
            attributes = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in attributes.items()}
            kind = {"dtype": quantity.dtype, "fill_value": quantity.fill, "attributes": attributes}
            group.create_array(name, shape=shape, chunks=chunks, dimension_names=dims, **kind)
        _consolidate(new)
        for path in [*new.rglob("*"), new]:
            _sync(path)
        os.rename(new, self.path)
        _sync(self.path.parent)

    def write(self, index: BlockIndex, arrays: Arrays) -> None:
        """Store the variables of a block, `point_status` last; their first axis runs over its points."""
        region = self._blocks.region(index)
        points = tuple(part.stop - part.start for part in region)
        for name in sorted(self._arrays, key=lambda name: name == POINT_STATUS):
            target = self._arrays[name]
            target[region] = arrays[name].reshape(points + target.shape[len(region) :])
            chunk = (*index, *[0] * (target.ndim - len(index)))
            _sync(self.path / name / target.metadata.encode_chunk_key(chunk))

    def dataset(self, attributes: dict[str, str] | None = None) -> "xr.Dataset":
        """The study with additional attributes, which are also stored; values are read when they are needed."""
        if attributes:
            self._group().attrs.update(attributes)
            _consolidate(self.path)
        return _open(self.path)


def _open(path: Path) -> "xr.Dataset":
    """The study in a folder.

    Raises:
        ValueError: if there is none.
    """
    import xarray as xr

    try:
        data = xr.open_zarr(path, chunks=None, consolidated=False)
    except (OSError, ValueError, KeyError):
        data = None
    if data is None or POINT_STATUS not in data or "build" not in data.attrs:
        raise ValueError(f"`store` must be that of a study or not exist, got {path}, which is something else.")
    return data


def _consolidate(path: Path) -> None:
    import zarr
    from zarr.errors import ZarrUserWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)  # it says that other libraries may not read this
        zarr.consolidate_metadata(path)


def _sync(path: Path) -> None:
    """Wait until a file or folder is on disk; zarr does not write chunks that only contain fill values."""
    if path.exists():
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
