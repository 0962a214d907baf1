"""Results of a simulation: states at sampled times, events, and the balance of energy."""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.settings import in_double
from jaxwhisker._dynamics.legendre import basis, weights_at
from jaxwhisker._dynamics.trace import Trace, numbers_of
from jaxwhisker._model.scene import Scene, Sensor
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.dataset import counted
from jaxwhisker._scan.shapes import Shapes
from jaxwhisker._scan.state import State


class TimedEvent(NamedTuple):
    """One event of a simulation."""

    kind: EventKind
    whisker: int  # numbered from 1
    time: float
    control: float
    contact: int | None = None  # numbered from 1, from the tip to the base; None if whiskers have one contact at most

    def __str__(self) -> str:
        at = "" if self.contact is None else f" at contact {self.contact}"
        return f"t = {self.time:.9g}, u = {self.control:+.6f}  {self.kind.name} of whisker {self.whisker}{at}"


class TimedEvents(eqx.Module):
    """The events of a simulation in order: arrays of fixed size, of which the first `count` are filled.

    Iteration and indexing (outside jit and vmap) yield `TimedEvent` objects. Kinds are touch, release (every loss of
    contact, a snap-off included), tip_to_tangential, tangential_to_tip and vertex. There may be more events than there
    is room for: `count` includes them.

    Raises:
        TypeError: on iteration, indexing or `len`, if these are the events of a batch.
    """

    kind: Int[Array, " events"]  # EventKind; -1 beyond count
    whisker: Int[Array, " events"]  # numbered from 1; 0 beyond count
    time: Float[Array, " events"]  # NaN beyond count
    control: Float[Array, " events"]  # drive position; NaN beyond count
    count: Int[Array, ""]
    contact: Int[Array, " events"] | None = None  # numbered from the tip; 0 beyond count; None with one contact

    def __len__(self) -> int:
        if np.ndim(self.count) != 0:
            raise TypeError(f"The events are those of a batch of shape {np.shape(self.count)}: select one first.")
        return min(int(self.count), self.kind.shape[0])

    def __iter__(self) -> Iterator[TimedEvent]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, index: int) -> TimedEvent:
        k = range(len(self))[index]
        kind, whisker, time, control = (
            np.asarray(each)[k] for each in (self.kind, self.whisker, self.time, self.control)
        )
        contact = None if self.contact is None else int(np.asarray(self.contact)[k])
        return TimedEvent(EventKind(int(kind)), int(whisker), float(time), float(control), contact)

    def of(self, kind: EventKind, whisker: int | None = None) -> list[TimedEvent]:
        """The events of one kind, and of one whisker (numbered from 1) if given.

        Raises:
            ValueError: if `kind` is not an EventKind.
        """
        if not isinstance(kind, EventKind):
            raise ValueError(f"`kind` must be an EventKind, such as EventKind.touch, got {kind!r}.")
        return [e for e in self if e.kind == kind and (whisker is None or e.whisker == whisker)]


class MotionEnergy(eqx.Module):
    """Energy of all whiskers and springs, and work and losses since the start: force times length.

    kinetic + bending + springs = their sum at the start + work - damping - impact - friction + contact.
    """

    kinetic: Float[Array, " samples"]
    bending: Float[Array, " samples"]
    springs: Float[Array, " samples"]
    work: Float[Array, " samples"]  # of the drive
    damping: Float[Array, " samples"]  # lost to material, air and dampers of the bases
    impact: Float[Array, " samples"]  # lost when contacts begin, and by the implicit step after it
    friction: Float[Array, " samples"]
    contact: Float[Array, " samples"]  # work of normal contact forces, zero but for the error of the method

    @property
    def total(self) -> Float[Array, " samples"]:
        """Kinetic energy plus the energies of bending and springs."""
        return self.kinetic + self.bending + self.springs


class Simulation(State):
    """A simulated motion: the states at the samples, with shape (samples, whiskers), the energy and the events.

    Poses, contact points and phases are those at the sample's time. Reactions and contact forces are means over the
    two time steps before and after it, which makes them accurate to second order; an impact is contained in them as its
    impulse divided by the time step. Contact fields of a free whisker are zero, its reactions are not. If a time step
    fails, its status says so, and all later values but time and control are NaN.
    """

    time: Float[Array, " samples"]
    control: Float[Array, " samples"]  # drive position u
    gap: Float[Array, "samples whiskers"]  # distance from the object at the closest point; infinite without
    spring_length: Float[Array, "samples springs"]
    energy: MotionEnergy
    curvature: Float[Array, "samples whiskers coefficients"]  # times the length, minus the intrinsic one: Legendre
    tip_x: Float[Array, "samples whiskers"]
    tip_y: Float[Array, "samples whiskers"]
    status: Int[Array, " samples"]
    events: TimedEvents
    scene: Scene | Sensor

    @in_double
    def shapes(self, points: int = 64) -> Shapes:
        """Centre lines of all whiskers at all samples: equidistant points from base to tip.

        Args:
            points: number of points per whisker, at least 2.

        Raises:
            ValueError: if `points` is less than 2.
        """
        checks.count("points", points, least=2)
        n = self.curvature.shape[-1]
        shapes = basis(n)
        s = jnp.linspace(0.0, 1.0, points)
        reach = jax.vmap(lambda s: weights_at(shapes, s)[1])(s)
        lengths = jnp.stack([jnp.asarray(w.length, dtype=float) for w in self.scene.whiskers])
        angle = jnp.pi / 2 + self.base_angle[..., None] + self.curvature @ shapes.angles.T
        angle = angle + jnp.stack([rest_angles(w, n) for w in self.scene.whiskers])
        x = self.base_x[..., None] + lengths[:, None] * (jnp.cos(angle) @ reach.T)
        y = self.base_y[..., None] + lengths[:, None] * (jnp.sin(angle) @ reach.T)
        return Shapes(x, y)

    def __str__(self) -> str:
        bad = counted(self.status)
        steps = f"{bad.pop('ok', 0)} of {np.size(self.status)} samples ok"
        steps += "".join(f"; {n}: {s}" for s, n in bad.items())
        lines = [str(self.scene), steps]
        if int(np.max(np.asarray(self.events.count))) > self.events.kind.shape[-1]:
            lines += [f"the first {len(self.events)} of {int(self.events.count)} events"]
        return "\n".join([*lines, *map(str, self.events)])

    __repr__ = __str__


def rest_angles(whisker, n: int) -> Float[Array, " points"]:
    """Angles of the unloaded whisker to its base at the Gauss points."""
    shapes = basis(n)
    length = jnp.asarray(whisker.length, dtype=float)
    return length * shapes.reach[1:-1] @ jax.vmap(whisker.curvature_at)(length * shapes.points)


EVENTS = 64  # room for events
KINDS = (
    EventKind.touch,
    EventKind.release,
    EventKind.tip_to_tangential,
    EventKind.tangential_to_tip,
    EventKind.vertex,
)


def events_of(
    trace: Trace, ok: Bool[Array, " times"], time: Float[Array, " times"], control, contacts: int = 1
) -> TimedEvents:
    """All events until a failure: where the trace changes, with times between two steps by linear interpolation."""
    h, before = time[1] - time[0], time[:-1, None]
    now, was = trace.touches[1:], trace.touches[:-1]
    lasts = now & was

    def crossing(values):
        first, last = values[:-1], values[1:]
        changes = (first > 0) != (last > 0)
        return changes, before + h * first / jnp.where(changes, first - last, 1.0)

    def earlier(values):  # the values one step before the step's start
        return jnp.concatenate([values[:1], values[:-2]])

    def fraction(value, decrease):
        return value / jnp.where(decrease > 0, decrease, 1.0)

    approach = earlier(trace.gap) - trace.gap[:-1]
    touch = before + h * jnp.where(approach > 0, jnp.clip(fraction(trace.gap[:-1], approach), 0.0, 1.0), 1.0)
    fading = earlier(trace.force) - trace.force[:-1]
    release = jnp.where(fading > 0, jnp.clip(fraction(trace.force[:-1], fading) - 0.5, -0.5, 1.0), 0.0)
    turns, turn_time = crossing(trace.at_tip)
    passes, pass_time = crossing(trace.slope)
    found = jnp.stack(
        [
            now & ~was,
            was & ~now,
            lasts & turns & (trace.at_tip[1:] < 0),
            lasts & turns & (trace.at_tip[1:] > 0),
            lasts & passes,
        ],
        axis=1,
    )
    found &= ok[1:, None, None]
    if contacts > 1:  # a contact on a concave object passes a lowest point on the way into each of its valleys
        found &= (jnp.arange(len(KINDS)) != KINDS.index(EventKind.vertex))[:, None]
    times = jnp.stack([touch, before + h * release, turn_time, turn_time, pass_time], axis=1)
    (at,) = jnp.nonzero(jnp.ravel(found), size=EVENTS, fill_value=found.size)
    ahead = at < found.size
    step, kind, whisker = jnp.unravel_index(jnp.minimum(at, found.size - 1), found.shape)
    when = jnp.where(ahead, jnp.ravel(times)[jnp.minimum(at, found.size - 1)], jnp.inf)
    order = jnp.argsort(jax.lax.stop_gradient(when))
    when, kind, whisker, ahead = (values[order] for values in (when, kind, whisker, ahead))
    safe = jnp.where(ahead, when, time[0])
    number = None
    if contacts > 1:
        column, step, numbers = whisker, step[order], numbers_of(trace, contacts)
        whisker = column // contacts
        # After a touch, and before everything else.
        number = jnp.where(kind == KINDS.index(EventKind.touch), numbers[step + 1, column], numbers[step, column])
        number = jnp.where(ahead, number, 0)
    return TimedEvents(
        jnp.where(ahead, jnp.array([int(kind) for kind in KINDS])[kind], -1),
        jnp.where(ahead, whisker + 1, 0),
        jnp.where(ahead, safe, jnp.nan),
        jnp.where(ahead, jax.vmap(control)(safe), jnp.nan),
        jnp.sum(found),
        number,
    )
