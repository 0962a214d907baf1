"""What a scan returns: signals over the control, and the events."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.dataset import scan_dataset
from jaxwhisker._scan.energy import stored_energy
from jaxwhisker._scan.quantities import STATE
from jaxwhisker._scan.state import State

if TYPE_CHECKING:
    import xarray as xr


class Event(NamedTuple):
    """One event of a scan."""

    kind: EventKind
    whiskers: tuple[int, ...]  # numbered from 1; of a snap, those that slipped off their branch
    control: float
    before: State
    after: State  # differs from `before` at a snap

    @property
    def whisker(self) -> int | None:
        """The whisker that the event concerns, numbered from 1; None where it is none or several."""
        return self.whiskers[0] if len(self.whiskers) == 1 else None

    @property
    def state(self) -> State:
        """The state there; of a snap, the one that the whiskers come to rest in."""
        return self.after

    def __str__(self) -> str:
        named = " ".join(str(w) for w in self.whiskers)
        return f"u = {self.control:+.9f}  {self.kind.name}{f' of whisker {named}' if named else ''}"


class Events(eqx.Module):
    """The events of a scan in their order: arrays of fixed size, of which the first `count` are filled.

    Iterating over it (outside jit and vmap) yields an `Event` each.
    """

    kind: Int[Array, " events"]  # EventKind; -1 beyond count
    whiskers: Bool[Array, "events whiskers"]
    control: Float[Array, " events"]  # NaN beyond count
    travel: Float[Array, " events"]  # way of the drive since the first step; no derivatives
    before: State  # fields (events, whiskers)
    after: State
    count: Int[Array, ""]

    def __len__(self) -> int:
        if np.ndim(self.count) != 0:
            raise TypeError(f"events of a batch of shape {np.shape(self.count)}: pick one lane of the result first.")
        return min(int(self.count), self.kind.shape[0])

    def __iter__(self) -> Iterator[Event]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: int) -> Event:
        index = range(len(self))[index]
        before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[index], s) for s in (self.before, self.after))
        which = tuple(int(k) + 1 for k in np.flatnonzero(np.asarray(self.whiskers)[index]))
        return Event(EventKind(int(self.kind[index])), which, float(self.control[index]), before, after)

    def of(self, kind: EventKind, whisker: int | None = None) -> list[Event]:
        """The events of one kind, of one whisker (numbered from 1) if given."""
        return [e for e in self if e.kind == kind and (whisker is None or whisker in e.whiskers)]


class Result(State):
    """A scan: the fields of State are (steps, whiskers).

    A step whose status is not `Status.ok` holds NaN; its phase is that of a free whisker.
    """

    control: Float[Array, " steps"]  # drive position u, a length; of a rotation its angle, rad
    spring_length: Float[Array, "steps springs"]  # x_second - x_first of every spring, or y, or angle
    status: Int[Array, " steps"]  # Status.ok, or what went wrong there
    events: Events
    scene: Scene

    def to_xarray(self) -> "xr.Dataset":
        """The scan as a Dataset: dimensions `control`, `whisker`, `spring` and `event`, with units and long names.

        Its variables are those of a `study` with `outputs="all"`.

        Raises:
            ValueError: if it is a batch of scans.
            ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
        """
        check_one_scan(self)
        return scan_dataset(self.scene, arrays_of(self))

    def __str__(self) -> str:
        statuses, counts = np.unique(np.asarray(self.status), return_counts=True)
        bad = {Status(int(s)).name: int(n) for s, n in zip(statuses, counts, strict=True)}
        ok = bad.pop("ok", 0)
        lines = [
            f"{self.scene}",
            f"{ok} of {np.size(self.status)} steps ok" + "".join(f"; {n}: {s}" for s, n in bad.items()),
        ]
        return "\n".join([*lines, *map(str, self.events)])

    __repr__ = __str__


def check_one_scan(result: Any) -> Result:
    """The result, which has to be that of one scan.

    Raises:
        ValueError: if it is none, or a batch of them.
    """
    if not isinstance(result, Result):
        raise ValueError(f"`result` must be the Result of a scan, but is {result!r}.")
    if np.ndim(result.control) != 1 or np.ndim(result.fx) != 2:
        raise ValueError(
            f"`result` must be of one scan, but is a batch of shape {np.shape(result.fx)[:-2]}: pick a lane first, "
            "jax.tree.map(lambda leaf: leaf[0], result)."
        )
    return result


def arrays_of(result: Result) -> dict[str, Array]:
    """All quantities of a scan by their names in `quantities.QUANTITIES`."""
    events = result.events
    states = {"": result, "before_": events.before, "after_": events.after}
    fields = {prefix + name: getattr(state, name) for prefix, state in states.items() for name in STATE}
    return fields | {
        "control": result.control,
        "spring_length": result.spring_length,
        "status": result.status,
        "event_kind": events.kind,
        "event_control": events.control,
        "event_whisker": events.whiskers,
        "event_count": events.count,
        "event_energy_before": stored_energy(result.scene, events.before),
        "event_energy_after": stored_energy(result.scene, events.after),
    }
