"""Studies: scans at many points of named parameters, in blocks of one compiled function."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker import _checks
from jaxwhisker._types import Control
from jaxwhisker.scene import Scene
from jaxwhisker.study.control import common_control
from jaxwhisker.study.fields import DEFAULT, variables
from jaxwhisker.study.kernel import Job, Kernel
from jaxwhisker.study.layout import Layout
from jaxwhisker.study.local import computed_here
from jaxwhisker.study.memory import Held
from jaxwhisker.study.parameters import parameters_of, split
from jaxwhisker.study.points import Points
from jaxwhisker.study.structure import structure_of

if TYPE_CHECKING:
    import xarray as xr

LANES = 128  # points of a block at most; more make nothing faster
PARTS, FEW = 16, 8  # a small study is cut into that many blocks, unless they had fewer points than that
OPTIONS = ("control", "points", "outputs", "derivatives", "summary", "store", "client", "memory", "progress")


def study(
    build: Callable[..., Scene],
    *,
    control: Control | None = None,
    points: Any = None,
    outputs: Sequence[str] | str = DEFAULT,
    derivatives: Sequence[str] | str = (),
    summary: bool = False,
    store: Any = None,
    client: Any = None,
    memory: float = 2e9,
    progress: bool | None = None,
    **axes: Any,
) -> "xr.Dataset":
    """Scan the scenes that `build` makes from named parameters, at every combination of them."""
    _checks.float64_mode()
    derivatives = (derivatives,) if isinstance(derivatives, str) else tuple(derivatives)
    parameters = parameters_of(build, points, axes, OPTIONS)
    fields = variables(outputs, derivatives, summary)
    if control is not None:
        _checks.vector("control", control)
    structure = structure_of(build, parameters)
    total = int(np.prod(parameters.shape))
    blocks = split(parameters.shape, max(-(-total // PARTS), min(FEW, total)) if total < PARTS * LANES else LANES)
    if control is None:
        control = common_control(build, parameters, blocks.lanes)
    control = np.asarray(control, dtype=float)
    names = tuple(name for name in fields)
    base = ("reactions", "status", "events", "event_states") if summary else ()
    needed = tuple(variables([*base, *_plain(outputs)], (), False))
    job = Job(
        build, tuple(parameters.values), control, needed, derivatives, summary, names, structure.whiskers, blocks.lanes
    )
    kernel = Kernel(job)
    layout = Layout(parameters, structure, control, kernel.events, fields)
    held = Held(layout)
    found = Points(build, parameters)
    for done in computed_here(kernel, parameters, blocks, blocks.indices(), held):
        found.add(blocks.numbers(done.index), done.worst)
    data = held.dataset()
    data.attrs["points"] = found.words()
    return data


def _plain(outputs: Sequence[str] | str) -> Sequence[str]:
    return (outputs,) if isinstance(outputs, str) else outputs
