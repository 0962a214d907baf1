"""Studies: scans at many points of named parameters, in blocks that share one compiled function."""

import importlib
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.primitive import threads
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control
from jaxwhisker._model.scene import AbstractScene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.dataset import VARIABLES, omitted_events, points_in_words
from jaxwhisker._scan.quantities import Quantity, with_contacts
from jaxwhisker._scan.result import AbstractResult
from jaxwhisker._scan.scan import mechanics_in
from jaxwhisker._study.compute import Job, Kernel, common_control, compute_here, compute_on_cluster
from jaxwhisker._study.layout import DEFAULT, POINT_STATUS, RESERVED, Layout, chosen, variables_of
from jaxwhisker._study.parameters import BlockIndex, Blocks, Parameters, blocks_of, parameters_of
from jaxwhisker._study.store import Store, StudyInMemory
from jaxwhisker._study.structure import channels_of, fingerprint, layout_of_scenes, sampled
from jaxwhisker._study.summary import SUMMARY, derivative_name

if TYPE_CHECKING:
    import xarray as xr

OPTIONS = (
    *("control", "points", "outputs", "channels", "derivatives"),
    *("summary", "store", "client", "memory", "progress"),
)
SUMMARISED = ("reactions", "base_x", "status", "events", "event_states")  # outputs from which a summary is made


@with_own_settings
def study(
    build: Callable[..., AbstractScene],
    *,
    control: Control | None = None,
    points: Any = None,
    outputs: Sequence[str] | str = DEFAULT,
    channels: Callable[[AbstractResult], Mapping[str, Any]] | None = None,
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
        build: makes a Scene from numbers given by name. JAX traces it: numbers may differ between points, but not the
            number of whiskers or springs, nor the kind of object.
        control: drive positions, shape (steps,), the same at all points. Default: from the earliest start to the latest
            end of the default controls of `scan` at all points, in steps of 0.001 lengths of the longest whisker, or
            0.001 rad. An explicit control avoids computing these ends first.
        points: a table with one column per parameter (a mapping or a DataFrame) and one row per point, instead of axes.
        outputs: variables, or groups of them: `reactions` (fx fy mz, in space also fz mx my), `status`, `events`,
            `contact`, `springs` (base_x base_y base_angle spring_length, in space base_z and base_rotation instead of
            base_angle), `event_states`, `all`.
        channels: a function of the result of a scan that returns further variables along the control by name, as for
            `identify`: arrays (steps,), or (steps, n) for n variables name_1 to name_n. It is traced and must not use
            the result's events. For example, frequencies of vibration:
            `lambda result: {"omega": jw.modes(result, 2, points=2).omega}`.
        derivatives: parameters with respect to which every real-valued variable is differentiated, also those of a
            summary; at fixed control.
        summary: keep peaks, positions of events, widths and work (see `summary`) instead of variables along the
            control, except for `channels`. The signals of a block are dropped as soon as they are summarised, to save
            memory.
        store: path of a zarr store for the results. The same call on an unfinished store computes what is missing.
            Default: the results stay in memory.
        client: a `dask.distributed.Client` whose workers compute the blocks. Default: this machine.
        memory: bytes that this process may use; it limits the number of points per block. JAX and its compiler need
            about 1.2e9 of them.
        progress: whether to show a progress bar. Default: on a terminal.
        **axes: one-dimensional values of each parameter of `build`; those with a default are optional.

    Returns:
        A Dataset with the dimensions of the axes (or `point`), `control`, `whisker`, `spring` and `event`; every
        variable has units and a long name. With a store, values are read when they are needed. A point that cannot be
        scanned holds NaN and a status, which is never an error. `point_status` is the first status of each point that
        is not ok, `attrs["points"]` counts them and gives a reason, and `attrs["omitted_events"]` is present if a point
        has more events than are stored.

    Raises:
        ValueError: if an argument is wrong, or the store contains another study; raised before any scan.
        ImportError: if a package is missing: `pip install jaxwhisker[study]`.
    """
    checks.float64_mode()
    _check_packages(store, client)
    checks.instance("summary", summary, bool, "True or False")
    checks.number("memory", memory, positive=True, finite=False)
    parameters = parameters_of(build, points, axes, OPTIONS)
    derivatives = _checked_derivatives(derivatives, parameters)
    layout = _layout(build, parameters, control)
    names: tuple[str, ...] = ()
    if channels is not None:
        names, code = channels_of(channels, build, sampled(parameters))
        layout = layout._replace(build=f"{layout.build}, channels {code}")
    variables = variables_of(outputs, derivatives, summary, layout.scene.absent, names, layout.scene.contacts)
    _check_names(parameters, variables, names)
    layout = layout._replace(variables=variables)
    summarised = chosen(SUMMARISED, layout.scene.absent) if summary else ()
    computed = tuple(name for name in VARIABLES if name in layout.variables or name in summarised)
    visible = sys.stderr.isatty() if progress is None else progress
    with closing(StudyInMemory() if store is None else Store(store)) as target:
        resumed = target.resumed(layout)
        if visible:
            print(f"study: compiling, then {parameters.total:,} scans", file=sys.stderr)
        layout, blocks = resumed or _planned(layout, build, computed, derivatives, memory, client)
        arguments, kept = tuple(parameters.values), tuple(layout.variables)
        job = Job(build, arguments, layout.control, computed, derivatives, summary, kept, channels, names)
        kernel = Kernel(job)
        if any(VARIABLES[name].axes[:1] == ("event",) for name in computed):
            mechanics = mechanics_in(space=layout.scene.in_space, contacts=layout.scene.contacts)
            layout = layout._replace(events=mechanics.event_room(layout.scene.whiskers))
        _compute(kernel, target, layout, blocks, client, visible)
        return _finished(target, build, layout, visible)


def _check_names(parameters: Parameters, variables: dict[str, Quantity], channels: Sequence[str]) -> None:
    for name in channels:
        if name in {*RESERVED, *VARIABLES, *SUMMARY, POINT_STATUS}:
            raise ValueError(f"`channels` must not have the name of a variable of the Dataset, got `{name}`.")
    for name in parameters.values:
        if name in RESERVED or name in VARIABLES or name in variables:
            raise ValueError(
                f"The name of an axis must not be that of a variable of the Dataset, got `{name}`: rename it."
            )


def _layout(build: Callable[..., AbstractScene], parameters: Parameters, control: Any) -> Layout:
    """The layout of the Dataset without its variables; its control is empty until the default one is computed."""
    if control is not None:
        checks.vector("control", control)
    scene = layout_of_scenes(build, parameters)
    positions = np.empty(0) if control is None else np.asarray(control, dtype=float)
    return Layout(parameters, scene, fingerprint(build, sampled(parameters)), positions, control is None, {})


def _check_packages(store: Any, client: Any) -> None:
    needed = {"xarray": "study", "tqdm": "study"} | ({} if store is None else {"zarr": "study"})
    for package, extra in (needed | ({} if client is None else {"distributed": "cluster"})).items():
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise ImportError(f"`study` needs {package}: pip install jaxwhisker[{extra}]") from error
    if client is not None and not hasattr(client, "nthreads"):
        raise ValueError(f"`client` must be a dask.distributed.Client, got {client!r}.")


def _checked_derivatives(derivatives: Sequence[str] | str, parameters: Parameters) -> tuple[str, ...]:
    names = (derivatives,) if isinstance(derivatives, str) else tuple(derivatives)
    for name in names:
        if name not in parameters.values:
            raise ValueError(f"`derivatives` must be among {', '.join(parameters.values)}, got {name!r}.")
    return names


def _planned(
    layout: Layout,
    build: Callable[..., AbstractScene],
    computed: Sequence[str],
    derivatives: Sequence[str],
    memory: float,
    client: Any,
) -> tuple[Layout, Blocks]:
    """The layout with its control, and blocks that fit into memory."""
    if layout.default_control:
        layout = layout._replace(control=common_control(build, layout.parameters, layout.scene.onwards))
    fields = {name: with_contacts(name, VARIABLES[name], layout.scene.contacts) for name in computed}
    slopes = {derivative_name(name, parameter): own for name, own in fields.items() for parameter in derivatives}
    held = fields | slopes | layout.variables
    workers = threads() if client is None else 1
    return layout, blocks_of(layout.parameters.shape, layout.sizes, held.values(), memory, workers)


def _compute(
    kernel: Kernel, target: StudyInMemory | Store, layout: Layout, blocks: Blocks, client: Any, visible: bool
) -> None:
    """Compute and store all blocks that are not complete, and show the progress."""
    from tqdm import tqdm

    def points(index: BlockIndex) -> int:
        return math.prod(part.stop - part.start for part in blocks.region(index))

    done, steps = target.begin(layout, blocks), layout.control.size
    todo = [index for index in blocks.indices() if index not in done]
    if client is None:
        results = compute_here(kernel, layout.parameters, blocks, todo, target.write)
    else:
        results = compute_on_cluster(client, kernel.job, layout.parameters, blocks, todo, target.write)
    total, initial = layout.parameters.total * steps, sum(map(points, done)) * steps
    bar = tqdm(total=total, initial=initial, desc="study", unit=" equilibria", unit_scale=True, disable=not visible)
    with closing(results), bar:
        for index in results:
            bar.update(points(index) * steps)


def _finished(
    target: StudyInMemory | Store, build: Callable[..., AbstractScene], layout: Layout, visible: bool
) -> "xr.Dataset":
    """The Dataset with a description of failed points, which is printed as well."""
    data = target.dataset()
    attributes = {"points": _points_in_words(build, layout.parameters, data[POINT_STATUS].values)}
    if "event_count" in data and layout.events:
        attributes |= omitted_events(data["event_count"].values, layout.events)
    if visible or len(attributes) > 1 or bool((data[POINT_STATUS] != Status.ok).any()):
        print("; ".join(attributes.values()), file=sys.stderr)
    return target.dataset(attributes)


def _points_in_words(build: Callable[..., AbstractScene], parameters: Parameters, status: np.ndarray) -> str:
    """How many points are ok or failed, and why the first invalid one is invalid."""
    words = points_in_words(status)
    invalid = np.flatnonzero(status == Status.invalid)
    if invalid.size:
        point = parameters.one(int(invalid[0]))
        try:
            build(**point)
        except Exception as error:  # whatever `build` raises is the reason
            words += f" ({', '.join(f'{name} = {value:g}' for name, value in point.items())}: {error})"
    return words
