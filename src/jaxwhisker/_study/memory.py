"""A study held in memory."""

from typing import TYPE_CHECKING

import numpy as np

from jaxwhisker._study.description import Description
from jaxwhisker._study.layout import Layout
from jaxwhisker._study.parameters import Blocks, Index

if TYPE_CHECKING:
    import xarray as xr


class Held:
    """Arrays of a whole study, filled block by block."""

    def check(self, description: Description) -> None:
        """There is nothing to go on with."""
        del description

    def begin(self, layout: Layout, blocks: Blocks, description: Description) -> dict[Index, np.ndarray]:
        """Make room for the study."""
        del description
        self._layout, self._blocks = layout, blocks
        self._arrays = {n: np.full(layout.shape(n), f.fill, f.dtype) for n, f in layout.variables.items()}
        return {}

    def write(self, index: Index, arrays: dict[str, np.ndarray], worst: np.ndarray) -> None:
        """Put the variables of a block's points, the first axis of each, in their place."""
        del worst
        region = self._blocks.region(index)
        for name, target in self._arrays.items():
            target[region] = arrays[name].reshape(target[region].shape)

    def dataset(self, points: str) -> "xr.Dataset":
        """The study, what became of its points being told."""
        layout = self._layout
        found = {n: (layout.dims(n), array, layout.attributes(n)) for n, array in self._arrays.items()}
        return layout.frame().assign(found).assign_attrs(points=points)

    def control(self) -> np.ndarray:
        """Not known before the study begins."""
        return self._layout.control

    def close(self) -> None:
        """Nothing to let go of."""
