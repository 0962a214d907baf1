"""Studies: scans at many points of named parameters, in blocks of one compiled function."""

import importlib
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.types import Control
from jaxwhisker._model.scene import Scene
from jaxwhisker._study.cluster import computed_there
from jaxwhisker._study.control import common_control
from jaxwhisker._study.description import described
from jaxwhisker._study.fields import DEFAULT, FIELDS, chosen, variables
from jaxwhisker._study.kernel import Job, Kernel
from jaxwhisker._study.layout import Layout
from jaxwhisker._study.local import computed_here, threads
from jaxwhisker._study.memory import Held
from jaxwhisker._study.parameters import Blocks, parameters_of
from jaxwhisker._study.plan import blocks_of
from jaxwhisker._study.points import Points
from jaxwhisker._study.progress import bar
from jaxwhisker._study.store import Store
from jaxwhisker._study.structure import structure_of

if TYPE_CHECKING:
    import xarray as xr

OPTIONS = ("control", "points", "outputs", "derivatives", "summary", "store", "client", "memory", "progress")
SUMMARISED = ("reactions", "base_x", "status", "events", "event_states")  # what a summary is made from


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
    """Scan the scenes that `build` makes from named parameters, at every combination of the axes' values.

        def build(stiffness, distance):
            return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fbfbr(stiffness))

        data = jw.study(build, stiffness=np.linspace(30, 200, 64), distance=np.linspace(0.1, 0.4, 16))

    Args:
        build: makes a Scene from numbers given by name. It is traced: numbers may differ from point to point, not the
            number of whiskers or springs, nor the kind of object.
        control: drive positions, shape (steps,), the same at all points. Default: from before the first touch to after
            the last contact of all points in steps of 0.001 whisker lengths; giving it saves a pass over all points.
        points: a table, one column per parameter (a mapping or a DataFrame), instead of axes: one point per row.
        outputs: variables, or groups of them: `reactions` (fx fy mz), `status`, `events`, `contact`, `springs`
            (base_x base_y base_angle spring_length), `event_states`, `all`.
        derivatives: parameters by which every real variable is differentiated, at fixed control.
        summary: keep peaks, positions of events, widths and work (see `summary`) instead of what runs along the
            control, chunk by chunk: small, whatever the size of the study.
        store: path of a zarr store that holds the results, computed so far or finished: the same call goes on with what
            is missing. Default: memory.
        client: a `dask.distributed.Client`, on whose workers the blocks are computed. Default: this machine.
        memory: bytes that this process may take if results go to a store. About 1.2e9 go to jax and its compiler; what
            is left decides how many points a block has at most.
        progress: whether to show a progress bar. Default: on a terminal.
        **axes: values of each parameter of `build`, one-dimensional; those with defaults may be left out.

    Returns:
        A Dataset: dimensions of the axes (or `point`), `control`, `whisker`, `spring`, `event`, units and long names
        with every variable. From a store it is read when values are asked for. `attrs["points"]` counts the points all
        of whose steps are ok and tells what is wrong with the others, which hold NaN and a status.

    Raises:
        ValueError: if an argument is wrong, or the store holds another study; before anything is computed.
        ImportError: if a package is missing: `pip install jaxwhisker[study]`.
    """
    checks.float64_mode()
    _need("study", "xarray", "tqdm", *["zarr"] * (store is not None))
    parameters = parameters_of(build, points, axes, OPTIONS)
    derivatives = (derivatives,) if isinstance(derivatives, str) else tuple(derivatives)
    for name in derivatives:
        if name not in parameters.values:
            raise ValueError(f"`derivatives` must be among {', '.join(parameters.values)}, but one is {name!r}.")
    fields = variables(outputs, derivatives, summary)
    _check_names(parameters.values, fields)
    if control is not None:
        checks.vector("control", control)
        control = np.asarray(control, dtype=float)
    checks.number("memory", memory, positive=True, finite=False)
    if client is not None:
        _need("cluster", "distributed")
        if not hasattr(client, "nthreads"):
            raise ValueError(f"`client` must be a dask.distributed.Client, but is {client!r}.")
    structure = structure_of(build, parameters)

    with closing(Held() if store is None else Store(store)) as target:
        description = described(parameters, control, list(fields))
        known = target.check(description)
        if known is None:
            control = common_control(build, parameters) if control is None else control
        else:
            control = target.control()
        computed = tuple(n for n in FIELDS if n in fields or (summary and n in chosen(SUMMARISED)))
        layout = Layout(parameters, structure, control, 0, fields)
        if known is None:
            needed = [FIELDS[name] for name in computed] + [fields[name] for name in fields if name not in FIELDS]
            workers = threads() if client is None else 1
            blocks = blocks_of(parameters.shape, layout.sizes, needed, memory, workers)
        else:
            blocks = Blocks(parameters.shape, tuple(known["block"]))
        job = Job(
            build=build,
            names=tuple(parameters.values),
            control=control,
            outputs=computed,
            derivatives=derivatives,
            summary=summary,
            kept=tuple(fields),
            whiskers=structure.whiskers,
            lanes=blocks.lanes,
        )
        kernel = Kernel(job)
        description |= {"block": list(blocks.block), "build": kernel.fingerprint()}
        done = target.begin(layout._replace(events=kernel.events), blocks, description)
        found = Points(build, parameters)
        for index, worst in done.items():
            found.add(blocks.numbers(index), worst)
        todo = [index for index in blocks.indices() if index not in done]
        if client is None:
            results = computed_here(kernel, parameters, blocks, todo, target.write)
        else:
            keyed = replace(job, key=description["build"])
            results = computed_there(client, keyed, parameters, blocks, todo, target.write)
        with closing(results), bar(found.total, control.size, found.seen, progress) as shown:
            for index, worst in results:
                found.add(blocks.numbers(index), worst)
                shown.update(worst.size * control.size)
            visible = not shown.disable
        words = found.words()
        if visible or not found.all_ok:
            print(words, file=sys.stderr)
        return target.dataset(words)


def _need(extra: str, *packages: str) -> None:
    for package in packages:
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise ImportError(f"`study` needs {package}: pip install jaxwhisker[{extra}]") from error


def _check_names(names, fields) -> None:
    taken = {"control", "whisker", "spring", "event", "point", "between", *FIELDS, *fields}
    for name in names:
        if name in taken:
            raise ValueError(f"`{name}` must not be the name of an axis: the Dataset has that for its own. Rename it.")
