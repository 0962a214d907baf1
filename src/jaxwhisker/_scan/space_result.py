"""States, events and results of scans in space."""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.leaves import Deferred, deferred
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.dataset import counted


class SpaceState(eqx.Module):
    """Whiskers in equilibrium in space, in the scene's frame and units; in a result with a leading axis of steps.

    The reactions and all contact fields of a free whisker are zero.
    """

    fx: Float[Array, "*steps whiskers"]  # support reaction on the whisker: force along +x
    fy: Float[Array, "*steps whiskers"]
    fz: Float[Array, "*steps whiskers"]
    mx: Float[Array, "*steps whiskers"]  # moment about the displaced base, right-handed about +x
    my: Float[Array, "*steps whiskers"]
    mz: Float[Array, "*steps whiskers"]
    base_x: Float[Array, "*steps whiskers"]  # position of the base, a length
    base_y: Float[Array, "*steps whiskers"]
    base_z: Float[Array, "*steps whiskers"]
    base_rotation: Float[Array, "*steps whiskers 3 3"]  # columns: d1, d2 and the tangent d3 at the base
    contact_force: Float[Array, "*steps whiskers"]  # f >= 0, a force
    contact_arc: Float[Array, "*steps whiskers"]  # arc length from base to contact
    contact_x: Float[Array, "*steps whiskers"]  # contact point, a length
    contact_y: Float[Array, "*steps whiskers"]
    contact_z: Float[Array, "*steps whiskers"]
    phase: Int[Array, "*steps whiskers"]  # Phase.free, .tip, .tangential

    @property
    def force(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, force (fx, fy, fz)."""
        return jnp.stack([self.fx, self.fy, self.fz], axis=-1)

    @property
    def moment(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, moment (mx, my, mz)."""
        return jnp.stack([self.mx, self.my, self.mz], axis=-1)

    @property
    def own_force(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, force along d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.force[..., :, None], axis=-2)

    @property
    def own_moment(self) -> Float[Array, "*steps whiskers 3"]:
        """Support reaction, moment about d1, d2 and d3 of each whisker's base."""
        return jnp.sum(self.base_rotation * self.moment[..., :, None], axis=-2)


class SpaceEvent(NamedTuple):
    """One event of a scan in space."""

    kind: EventKind
    whiskers: tuple[int, ...]  # numbered from 1
    control: float
    before: SpaceState  # fields (whiskers,)
    after: SpaceState

    @property
    def state(self) -> SpaceState:
        """The state at the event."""
        return self.after

    def __str__(self) -> str:
        named = " ".join(str(w) for w in self.whiskers)
        return f"u = {self.control:+.9f}  {self.kind.name}{f' of whisker {named}' if named else ''}"


class SpaceEvents(eqx.Module):
    """The events of a scan in order: arrays of fixed size, of which the first `count` are filled."""

    kind: Int[Array, " events"]  # EventKind; -1 beyond count
    whiskers: Bool[Array, "events whiskers"]
    control: Float[Array, " events"]  # drive position; NaN beyond count
    before: SpaceState
    after: SpaceState
    count: Int[Array, ""]

    def __len__(self) -> int:
        if np.ndim(self.count) != 0:
            raise TypeError(
                f"The events are those of a batch of shape {np.shape(self.count)}: select one scan of the result first."
            )
        return min(int(self.count), self.kind.shape[0])

    def __iter__(self) -> Iterator[SpaceEvent]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: int) -> SpaceEvent:
        index = range(len(self))[index]
        before, after = (jax.tree.map(lambda leaf: np.asarray(leaf)[index], s) for s in (self.before, self.after))
        kind, whiskers, control = (np.asarray(each)[index] for each in (self.kind, self.whiskers, self.control))
        which = tuple(int(k) + 1 for k in np.flatnonzero(whiskers))
        return SpaceEvent(EventKind(int(kind)), which, float(control), before, after)

    def of(self, kind: EventKind) -> list[SpaceEvent]:
        """The events of one kind."""
        return [event for event in self if event.kind == kind]


class SpaceResult(SpaceState):
    """A scan in space: the states at all steps, with shape (steps, whiskers), and the events.

    A step whose status is not `Status.ok` holds NaN; its phase is `free`.
    """

    control: Float[Array, " steps"]
    status: Int[Array, " steps"]  # Status.ok, or the reason for failure
    deferred_events: Deferred = eqx.field(converter=deferred)
    scene: SpaceScene

    @property
    def events(self) -> SpaceEvents:
        """The events in order; they are computed when first asked for."""
        return self.deferred_events.value

    def __str__(self) -> str:
        bad = counted(self.status)
        steps = f"{bad.pop('ok', 0)} of {np.size(self.status)} steps ok" + "".join(
            f"; {n}: {s}" for s, n in bad.items()
        )
        return "\n".join([str(self.scene), steps, *map(str, self.events)])

    __repr__ = __str__
