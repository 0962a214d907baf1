"""A study held in memory."""

from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker.study.layout import Layout
from jaxwhisker.study.parameters import Blocks

if TYPE_CHECKING:
    import xarray as xr


class Held:
    """Arrays of a whole study, filled block by block."""

    def __init__(self, layout: Layout):
        self._layout = layout
        self._arrays = {n: np.full(layout.shape(n), f.fill, f.dtype) for n, f in layout.variables.items()}

    def write(self, blocks: Blocks, index: tuple[int, ...], arrays: dict[str, np.ndarray], worst: np.ndarray) -> None:
        """Put the variables of a block's points, the first axis of each, in their place."""
        del worst
        region = blocks.region(index)
        for name, target in self._arrays.items():
            target[region] = arrays[name].reshape(target[region].shape)

    def dataset(self) -> "xr.Dataset":
        """The study."""
        layout = self._layout
        found = {n: (layout.dims(n), array, layout.attributes(n)) for n, array in self._arrays.items()}
        return layout.frame().assign(found)
