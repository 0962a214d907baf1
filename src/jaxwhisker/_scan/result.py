"""Results of a scan, in the plane and in space: states at the positions of the control, and events."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.leaves import Deferred, deferred
from jaxwhisker._base.settings import in_double
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.scene import AbstractScene, Scene
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.dataset import counted, scan_dataset
from jaxwhisker._scan.energy import stored_energy
from jaxwhisker._scan.quantities import ENERGIES, QUANTITIES
from jaxwhisker._scan.state import SpaceState, State

if TYPE_CHECKING:
    import xarray as xr

    from jaxwhisker._model.space_scene import SpaceScene  # which scans in the plane do not load


class Event(NamedTuple):
    """One event of a scan."""

    kind: EventKind
    whiskers: tuple[int, ...]  # numbered from 1; for a snap, those that slipped off their branch
    control: float  # drive position, in the unit of the control
    before: State  # fields (whiskers,); in space, a SpaceState
    after: State  # differs from `before` at a snap

    @property
    def whisker(self) -> int | None:
        """The whisker that the event concerns, numbered from 1; None if it concerns none or several."""
        return self.whiskers[0] if len(self.whiskers) == 1 else None

    @property
    def state(self) -> Any:
        """The state at the event; for a snap, the state in which the whiskers come to rest."""
        return self.after

    @property
    def contact(self) -> int | None:
        """The contact that the event concerns, numbered from 1 from the tip on; None for a snap.

        Numbers are those after a touch, and those before any other event. Also None if the event does not concern
        exactly one whisker.
        """
        if self.whisker is None or self.kind in SNAPS:
            return None
        side, k = self.side, self.whisker - 1
        if not has_several(side):
            return 1
        if self.kind in (EventKind.touch, EventKind.release):  # of a contact without force
            return int(np.argmin(np.where(side.phase[k] != Phase.free, side.contact_force[k], np.inf))) + 1
        return int(np.argmax(self.before.phase[k] != self.after.phase[k])) + 1

    @property
    def object(self) -> int | None:
        """The object of this contact, numbered from 1 in the order of the scene's profiles; None without a contact."""
        if self.contact is None:
            return None
        numbers = getattr(self.side, "contact_object", None)
        if numbers is None:
            return 1
        return int(np.atleast_1d(numbers[self.whiskers[0] - 1])[self.contact - 1]) or None

    @property
    def side(self) -> Any:
        """The side of the event on which its contact exists."""
        return self.after if self.kind == EventKind.touch else self.before

    @property
    def place(self) -> str:
        """Object and contact in words, such as " with object 2 at contact 1"; of either only if there are several."""
        if self.contact is None:
            return ""
        to = {EventKind.touch: "with", EventKind.release: "from"}.get(self.kind, "on")
        objects = self.after.contact_object is not None
        return f" {to} object {self.object}" * objects + f" at contact {self.contact}" * has_several(self.after)

    def __str__(self) -> str:
        named = " ".join(str(w) for w in self.whiskers)
        return f"u = {self.control:+.9f}  {self.kind.name}{f' of whisker {named}' if named else ''}{self.place}"


class Events(eqx.Module):
    """The events of a scan in order: arrays of fixed size, of which the first `count` are filled.

    Iteration and indexing (outside jit and vmap) yield `Event` objects. Within `jit`, `vmap` and derivatives, a scan
    may have more events than there is room for: then `truncated` is True, the first and the last are kept, and `count`
    includes all. Otherwise there is room for all.

    Raises:
        TypeError: on iteration, indexing or `len`, if these are the events of a batch of scans.
    """

    kind: Int[Array, " events"]  # EventKind; -1 beyond count
    whiskers: Bool[Array, "events whiskers"]  # those that the event concerns
    control: Float[Array, " events"]  # drive position; NaN beyond count
    travel: Float[Array, " events"]  # distance that the drive has travelled since the first step; no derivatives
    before: State  # fields (events, whiskers)
    after: State
    count: Int[Array, ""]

    @property
    @in_double
    def truncated(self) -> Bool[Array, ""]:
        """Whether the scan has more events than there is room for; the first and the last are kept."""
        return self.count > self.kind.shape[-1]

    def __len__(self) -> int:
        if np.ndim(self.count) != 0:
            raise TypeError(
                f"The events are those of a batch of shape {np.shape(self.count)}: select one scan of the result first."
            )
        return min(int(self.count), self.kind.shape[0])

    def __iter__(self) -> Iterator[Event]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: int) -> Event:
        index = range(len(self))[index]
        before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[index], s) for s in (self.before, self.after))
        kind, whiskers, control = (np.asarray(each)[index] for each in (self.kind, self.whiskers, self.control))
        which = tuple(int(k) + 1 for k in np.flatnonzero(whiskers))
        return Event(EventKind(int(kind)), which, float(control), before, after)

    def of(self, kind: EventKind, whisker: int | None = None) -> list[Event]:
        """The events of one kind, and of one whisker (numbered from 1) if given.

        Raises:
            ValueError: if `kind` is not an EventKind, or there is no such whisker.
        """
        if not isinstance(kind, EventKind):
            raise ValueError(f"`kind` must be an EventKind, such as EventKind.touch, got {kind!r}.")
        whiskers = np.shape(self.whiskers)[-1]
        if whisker is not None and whisker not in range(1, whiskers + 1):
            raise ValueError(f"`whisker` must be a number from 1 to {whiskers}, got {whisker!r}.")
        return [e for e in self if e.kind == kind and (whisker is None or whisker in e.whiskers)]


class SpaceEvents(Events):
    """The events of a scan in space in order: arrays of fixed size, of which the first `count` are filled."""

    before: SpaceState  # fields (events, whiskers)
    after: SpaceState


class AbstractResult(eqx.Module):
    """What results of scans in the plane and in space have in common."""

    control: eqx.AbstractVar[Float[Array, " steps"]]
    status: eqx.AbstractVar[Int[Array, " steps"]]
    deferred_events: eqx.AbstractVar[Deferred]
    scene: eqx.AbstractVar[AbstractScene]

    @property
    def events(self) -> Events:
        """The events in order; they are computed when first asked for."""
        return self.deferred_events.value

    @in_double
    def to_xarray(self) -> "xr.Dataset":
        """Return the scan as a Dataset with dimensions `control`, `whisker`, `spring` and `event`, units and names.

        If a whisker may have several contacts, their variables have a last dimension `contact`, from the tip on.

        Its variables are those of a `study` with `outputs="all"`.

        Raises:
            ValueError: if it is a batch of scans.
            ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
        """
        check_not_batched(self, "the result of a single scan")
        return scan_dataset(self.scene, arrays_of(self))

    def __str__(self) -> str:
        bad = counted(self.status)
        steps = f"{bad.pop('ok', 0)} of {np.size(self.status)} steps ok" + "".join(
            f"; {n}: {s}" for s, n in bad.items()
        )
        lines = [str(self.scene), steps]
        if self.events.truncated:
            lines += [f"the first and last of {int(self.events.count)} events"]
        return "\n".join([*lines, *map(str, self.events)])

    __repr__ = __str__


class Result(AbstractResult, State):
    """A scan: the states at all steps, with shape (steps, whiskers), and the events.

    A step whose status is not `Status.ok` holds NaN; its phase is `free`.
    """

    control: Float[Array, " steps"]  # drive position u: a length; for a Rotation, an angle in rad
    spring_length: Float[Array, "steps springs"]  # x (y, angle) of the spring's second end minus that of its first
    status: Int[Array, " steps"]  # Status.ok, or the reason for failure
    deferred_events: Deferred = eqx.field(converter=deferred)
    scene: Scene


class SpaceResult(AbstractResult, SpaceState):
    """A scan in space: the states at all steps, with shape (steps, whiskers), and the events.

    A step whose status is not `Status.ok` holds NaN; its phase is `free`.
    """

    control: Float[Array, " steps"]  # drive position: a length, an angle in rad or a number, depending on the motion
    spring_length: Float[Array, "steps springs"]  # of torsion springs, angles, rad; in the frame of the drive
    status: Int[Array, " steps"]  # Status.ok, or the reason for failure
    deferred_events: Deferred = eqx.field(converter=deferred)
    scene: "SpaceScene"


def check_one_scan(result: Any) -> Result:
    """Check that `result` is the result of a single scan in the plane, and return it.

    Raises:
        ValueError: if it is not, or if it is a batch of scans.
    """
    checks.instance("result", result, Result, "the Result of a scan")
    check_not_batched(result, "the result of a single scan")
    return result


def check_not_batched(result: Any, what: str) -> None:
    """Check that a result of a scan or a simulation is not a batch.

    Raises:
        ValueError: if it is; the message says what it must be.
    """
    if np.ndim(result.control) != 1 or np.ndim(result.fx) != 2:
        raise ValueError(
            f"`result` must be {what}, got a batch of shape {np.shape(result.fx)[:-2]}: select one, such as "
            "jax.tree.map(lambda leaf: leaf[0], result)."
        )


def arrays_of(result: AbstractResult, names: Iterable[str] = tuple(QUANTITIES)) -> dict[str, Array]:
    """Quantities of a scan by their names in `quantities.QUANTITIES`; without those that the scene does not have."""
    arrays = {name: _array(result, name) for name in names}
    return {name: array for name, array in arrays.items() if array is not None}


def _array(result: AbstractResult, name: str) -> Array | None:
    when, _, field = name.partition("_")
    if when in ("before", "after"):
        return getattr(getattr(result.events, when), field, None)
    if name in ENERGIES:
        if not isinstance(result.scene, Scene):
            return None
        return stored_energy(result.scene, getattr(result.events, field.removeprefix("energy_")), result.events.control)
    if when == "event":
        return getattr(result.events, {"whisker": "whiskers"}.get(field, field))
    return getattr(result, name, None)
