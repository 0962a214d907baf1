"""The kernel: what is computed for every point of a study, compiled once for a block of points."""

import hashlib
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.energy import stored_energy
from jaxwhisker._scan.result import Result, State
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import scan_route
from jaxwhisker._study.fields import FIELDS, derivative_name
from jaxwhisker._study.parameters import padded
from jaxwhisker._study.summaries import summarise

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Job:
    """What a study computes at each of its points; goes to whoever computes a block."""

    build: Callable[..., Scene]
    names: tuple[str, ...]  # of the parameters
    control: Float[np.ndarray, " steps"]
    outputs: tuple[str, ...]  # fields that are computed
    derivatives: tuple[str, ...]  # parameters
    summary: bool  # summarise the signals
    kept: tuple[str, ...]  # variables that the study holds
    whiskers: int
    lanes: int  # points of a block
    key: str = ""  # names the compiled function where several processes compute


def fields_of(scene: Scene, result: Result) -> dict:
    """All that `FIELDS` names, of a scan."""
    states = {"": result, "before_": result.events.before, "after_": result.events.after}
    found = {prefix + name: getattr(s, name) for prefix, s in states.items() for name in State.__dataclass_fields__}
    events = result.events
    return found | {
        "spring_length": result.spring_length,
        "status": result.status,
        "event_kind": events.kind,
        "event_control": events.control,
        "event_whisker": events.whiskers,
        "event_count": events.count,
        "event_energy_before": stored_energy(scene, events.before),
        "event_energy_after": stored_energy(scene, events.after),
    }


def _point(job: Job) -> Callable[[dict], dict]:
    """The function of one point's parameters."""
    route = route_of(job.control)
    names = tuple(dict.fromkeys((*job.outputs, "status")))
    smooth = [name for name in names if FIELDS[name].dtype == "float64"]

    def split(values):
        scene = job.build(**values)
        found = fields_of(scene, scan_route(scene, route))
        found = {name: found[name].astype(FIELDS[name].dtype) for name in names}
        return {name: found.pop(name) for name in smooth}, found

    def point(values):
        if not job.derivatives:
            found, rest = split(values)
            return found | rest
        directions = {n: jnp.array([float(n == p) for p in job.derivatives]) for n in values}

        def towards(direction):
            return jax.jvp(split, (values,), (direction,), has_aux=True)

        # The primal does not depend on the direction: it is computed once.
        found, slopes, rest = jax.vmap(towards, out_axes=(None, 0, None))(directions)
        for name, value in found.items():
            for k, parameter in enumerate(job.derivatives):
                rest[derivative_name(name, parameter)] = jnp.where(jnp.isnan(value), jnp.nan, slopes[name][k])
        kept = {*names, *job.kept}
        return {name: value for name, value in (found | rest).items() if name in kept}

    return point


_NAME = r"""@("[^"]*"|[\w.]+)"""
_FUNCTION = re.compile(rf"^  func\.func \w+ {_NAME}(.*?)^  }}$", re.MULTILINE | re.DOTALL)


def fingerprint(module: str) -> str:
    """A hash of what a StableHLO module computes.

    Equal inner functions are one function of the module or several, named by number, as what was traced before in this
    process has it: so they go by the hash of what they compute.
    """
    bodies = dict(_FUNCTION.findall(module))

    @cache
    def named(function: str) -> str:
        if function not in bodies:
            return function
        body = re.sub(_NAME, lambda call: named(call[1]), bodies[function])
        return hashlib.sha256(body.encode()).hexdigest()

    return named("main")


class Kernel:
    """A job, ready to be compiled. Several threads may call it at once."""

    def __init__(self, job: Job):
        shapes = {name: jax.ShapeDtypeStruct((job.lanes,), float) for name in job.names}
        self._lowered = jax.jit(jax.vmap(_point(job))).lower(shapes)
        self._compiled = None
        self._lock = threading.Lock()
        self.job = job

    @property
    def events(self) -> int:
        """How many events a scan has room for; 0 if none is asked for."""
        shapes = {name: leaf.shape for name, leaf in self._lowered.out_info.items() if name in FIELDS}
        return next((s[1] for name, s in shapes.items() if FIELDS[name].dims[:1] == ("event",)), 0)

    def fingerprint(self) -> str:
        """A hash of what is computed, constants that `build` captures included."""
        return fingerprint(self._lowered.as_text())

    def compiled(self):
        """The compiled function; the first call waits for the compiler."""
        with self._lock:
            if self._compiled is None:
                self._compiled = self._lowered.compile(COMPILER_OPTIONS)
        return self._compiled

    def __call__(self, values: Arrays) -> tuple[Arrays, np.ndarray]:
        """The fields of at most `lanes` points, and the first status of each that is not ok, or ok."""
        job, points = self.job, next(iter(values.values())).size
        found = jax.tree.map(lambda leaf: np.asarray(leaf)[:points], self.compiled()(padded(values, job.lanes)))
        status = found["status"]
        first = np.argmax(status != Status.ok, axis=1)
        worst = np.take_along_axis(status, first[:, None], axis=1)[:, 0]
        if job.summary:
            found |= summarise(found, job.control, job.whiskers)
        return {name: found[name] for name in job.kept}, worst


_KERNELS: dict[str, Kernel] = {}
_COMPILING = threading.Lock()


def compute(job: Job, values: Arrays) -> tuple[Arrays, np.ndarray]:
    """Compute a block anywhere; a process compiles the job when it meets it first.

    Raises:
        RuntimeError: if the function is another one here than where the job comes from.
    """
    jax.config.update("jax_enable_x64", True)  # in a worker nobody else does
    with _COMPILING:
        if job.key not in _KERNELS:
            kernel = Kernel(job)
            if kernel.fingerprint() != job.key:
                raise RuntimeError("the versions of jax, jaxwhisker or what `build` uses differ between the processes.")
            _KERNELS[job.key] = kernel
    return _KERNELS[job.key](values)
