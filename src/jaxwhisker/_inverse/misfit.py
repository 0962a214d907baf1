"""The misfit: residuals of a scan against measured signals, and their derivatives by what is sought.

Signals jump at snaps. A sample that lies between the model's snap and the measured one tells nothing by its size and
misleads by its slope; it is left out at a fixed price, as is the last one before a measured snap at none, and the
snap's position takes its place: it lies anywhere between the two samples between which the signals jump, not outside.

First guesses may be far off. Then scans are laid over each other: the model's way from first touch to last contact is
stretched to the measured one, signals are compared at equal shares of it, and where contact begins and ends is compared
on its own. That misfit is smooth and wide; the one at equal controls starts from its minimum.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.features import JUMPS, Features, peaks
from jaxwhisker._inverse.measured import Measured
from jaxwhisker._inverse.transforms import Transform, natural, table
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import EventKind, Status
from jaxwhisker._scan.result import Events
from jaxwhisker._scan.scan import TracedScan

BLOCK = 512  # samples are padded to a multiple of it: one compilation serves measurements of every length
WIDE = 0.1  # of the peak: standard deviation of signals laid over each other
WIDE_EVENT = 0.03  # lengths: of where contact begins, ends and jumps then
WIDE_PRIOR = 50.0  # of a parameter in log or in its scale then, in units of the mean signal's
PRIOR = 1e4  # ... later: what the data do not see at all stays where it is
BETWEEN = 12**-0.5  # of the gap between two samples: standard deviation of a snap that is anywhere in it
OUTSIDE = 8.0  # times that weight and more have snaps far outside of it,
WIDTH = 2.0  # from so many gaps on; smoothly: a least-squares step cannot foresee a wall
LEFT_OUT = 3.0  # standard deviations, as which a value counts that lies between the model's snap and the measured one
NO_EVENT = 1.0  # lengths by which an event misses that the model does not have


class Sought(NamedTuple):
    """What is sought: parameters of `build`, then constant offsets of channels, then a shift of the control."""

    names: tuple[str, ...]
    offsets: tuple[tuple[int, int], ...]  # (whisker, channel)
    shift: bool

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of everything."""
        several = len({k for k, _ in self.offsets}) > 1
        channels = [("fx", "fy", "mz")[c] + (f"_{k + 1}" if several else "") for k, c in self.offsets]
        return (*self.names, *(f"offset_{c}" for c in channels), *["shift"] * self.shift)


class Samples(NamedTuple):
    """What is compared, padded."""

    control: Any  # (samples,)
    way: Any
    values: Any  # (samples, whiskers, 3)
    weight: Any  # 1 / sigma; 0 where there is none
    stops: Any  # of the drive
    last: Any
    low: Any  # (JUMPS,) way before and behind each jump
    high: Any
    touch: Any  # (whiskers,) way; NaN where it is not seen
    release: Any
    touch_weight: Any  # (whiskers,)
    release_weight: Any
    jump_weight: Any  # (JUMPS,) of a snap's distance from the middle between two samples
    jump_width: Any
    transforms: Any  # table of the fit's variables: see transforms.py
    prior: Any  # (sought,)
    prior_weight: Any
    overlaid: Any  # whether scans are laid over each other
    onwards: Any  # the direction in which the drive sets out


class Compared(NamedTuple):
    """Beside the residuals: what they were made from."""

    signals: Any  # (samples, whiskers, 3) of the model, offsets included; NaN where a step failed
    left_out: Any  # (samples,) between the model's snap and the measured one
    status: Any  # of the path


def samples(
    measured: Measured,
    seen: Features,
    transforms: tuple[Transform, ...],
    prior: np.ndarray,
    stops: tuple,
    *,
    overlaid: bool,
    length: float,
) -> Samples:
    """The arrays that are compared."""
    size = measured.control.size
    more = -size % BLOCK

    def pad(values, fill=None):
        return np.concatenate([values, np.repeat(values[-1:] if fill is None else fill, more, axis=0)])

    known, peak = measured.known, peaks(measured)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = 1 / (WIDE * peak * np.sqrt(known.sum())) if overlaid else 1 / measured.sigma
    weight = np.where(known, weight, 0.0)
    gap = np.where(np.isfinite(seen.low), seen.high - seen.low, 1.0)
    return Samples(
        control=pad(measured.control),
        way=pad(seen.way),
        values=pad(np.where(known, measured.values, 0.0)),
        weight=pad(weight, np.zeros((1, *weight.shape[1:]))),
        stops=stops[0],
        last=np.asarray(stops[1]),
        low=seen.low,
        high=seen.high,
        touch=seen.touch,
        release=seen.release,
        touch_weight=1 / np.hypot(WIDE_EVENT * length, np.nan_to_num(seen.touch_error)),
        release_weight=np.asarray(1 / (WIDE_EVENT * length)),
        jump_weight=1 / (np.full(JUMPS, WIDE_EVENT * length) if overlaid else BETWEEN * gap),
        jump_width=np.full(JUMPS, np.inf) if overlaid else WIDTH * gap,
        transforms=table(transforms),
        prior=prior,
        prior_weight=np.asarray(1 / (WIDE_PRIOR if overlaid else PRIOR)),
        overlaid=np.asarray(overlaid),
        onwards=np.asarray(float(np.sign(measured.control[-1] - measured.control[0]) or -1.0)),
    )


def residuals(
    build: Callable[..., Scene], sought: Sought, y: Float[Array, " sought"], data: Samples
) -> tuple[Float[Array, " residuals"], Compared]:
    """Whitened residuals: of all signals, of jumps, of touches and last contacts, and of the prior."""
    x = natural(y, data.transforms)
    scene = build(**dict(zip(sought.names, x, strict=False)))
    shift = x[-1] if sought.shift else jnp.zeros(())
    n = len(sought.names)
    offset = jnp.zeros(data.values.shape[1:])
    for k, (whisker, channel) in enumerate(sought.offsets):
        offset = offset.at[whisker, channel].set(x[n + k])

    stops = jnp.where(data.overlaid, jnp.nan, data.stops + shift)
    way = TracedScan(scene, stops, jnp.where(data.overlaid, 1, data.last))
    events, onwards = way.events, data.onwards
    there = jnp.arange(events.kind.size) < events.count
    moved = jnp.where(there, events.control - jax.lax.stop_gradient(events.control), 0.0)
    at = jnp.where(there, events.travel, 0.0)
    # An event's way changes as its control does, in the direction in which the drive passes it.
    leg = jnp.clip(jnp.searchsorted(data.way, at) - 1, 0, data.way.size - 2)
    heading = jnp.sign(data.control[leg + 1] - data.control[leg])
    at = at + jnp.where(data.overlaid | (heading == 0), onwards, heading) * moved

    touch, touches, release, releases = _contacts(events, at, there)
    over = _overlay(data, touch, touches, release, releases)

    # Start of the model's way, from which the overlaid one counts.
    start = jax.lax.stop_gradient(way.start)
    along = over(data.way)
    control = jnp.where(data.overlaid, start + onwards * along, data.control + shift)
    signals, ok = way.signals(control, jax.lax.stop_gradient(along))
    signals = jnp.where(ok[:, None, None], signals, 0.0) + offset

    snap = there & (events.kind >= EventKind.snap_through)
    jump = jnp.isfinite(data.low)
    low, high = (over(jnp.where(jump, way, 0.0)) for way in (data.low, data.high))
    middle = (low + high) / 2
    apart = jnp.where(snap, jnp.abs(at - middle[:, None]), jnp.inf)
    nearest = jnp.argmin(apart, axis=1)
    paired = jump & jnp.isfinite(jnp.min(apart, axis=1))
    low, high, middle, snapped = (jnp.where(paired, v, 0.0) for v in (low, high, middle, at[nearest]))
    missed = jnp.where(paired, snapped - middle, jnp.where(jump, NO_EVENT, 0.0))
    outside = (missed / data.jump_width) ** 4
    of_jumps = missed * (1 + OUTSIDE * outside / (1 + outside)) * data.jump_weight

    low, high, snapped, here = jax.lax.stop_gradient((low, high, snapped, along[:, None]))
    between = jnp.any((((here <= low) & (here > snapped)) | ((here >= high) & (here < snapped))) & paired, axis=1)
    # Before a fold signals change without bound: the last sample there is worth little, and bends the misfit.
    left_out = between | jnp.any((here == low) & paired, axis=1)
    of_signals = jnp.where(left_out[:, None, None], 0.0, (signals - data.values) * data.weight)
    # Nothing is gained by a snap that has a sample left out.
    at_wrong_side = (between & ~data.overlaid)[:, None, None] & (data.weight > 0)
    of_signals = jnp.where(at_wrong_side, LEFT_OUT, of_signals)

    def of_events(where, seen, measured, weight):
        wanted = data.control[0] + onwards * jnp.where(jnp.isfinite(measured), measured, 0.0)
        missed = jnp.where(seen, start + onwards * where - wanted, NO_EVENT)
        return jnp.where(data.overlaid & jnp.isfinite(measured), missed, 0.0) * weight

    of_ends = [
        of_events(touch, touches, data.touch, data.touch_weight),
        of_events(release, releases, data.release, data.release_weight),
    ]
    everything = [of_signals.ravel(), of_jumps, *of_ends, (y - data.prior) * data.prior_weight]
    compared = Compared(jnp.where(ok[:, None, None], signals, jnp.nan), left_out, way.status)
    return jnp.concatenate(everything), compared


def _contacts(events: Events, at: Float[Array, " events"], there):
    """Way at every whisker's first touch and last contact, and whether there is one."""
    touching = there[:, None] & events.whiskers & (events.kind == EventKind.touch)[:, None]
    lost = (events.before.phase != Phase.free) & (events.after.phase == Phase.free)
    free = there[:, None] & lost & (events.kind >= EventKind.release)[:, None]
    touches, releases = jnp.any(touching, axis=0), jnp.any(free, axis=0)
    touch = jnp.where(touches, at[jnp.argmax(touching, axis=0)], 0.0)
    release = jnp.where(releases, at[at.size - 1 - jnp.argmax(free[::-1], axis=0)], 0.0)
    return touch, touches, release, releases


def _overlay(data: Samples, touch, touches, release, releases):
    """Takes the measured way to the model's; where contact has no beginning or no end, that end is not moved."""
    seen_first, seen_last = jnp.any(jnp.isfinite(data.touch)), jnp.any(jnp.isfinite(data.release))
    first = jnp.where(seen_first, jnp.nanmin(data.touch), 0.0)
    last = jnp.where(seen_last, jnp.nanmax(data.release), data.way[-1])
    own_first = jnp.min(jnp.where(touches, touch, jnp.inf))
    own_last = jnp.max(jnp.where(releases, release, -jnp.inf))
    some = jnp.isfinite(own_first) & jnp.isfinite(own_last) & (own_last > own_first) & (last > first)
    own_first = jnp.where(some & seen_first, own_first, first)
    own_last = jnp.where(some & seen_last, own_last, own_first + last - first)
    ratio = jnp.where(some, (own_last - own_first) / jnp.where(last > first, last - first, 1.0), 1.0)

    def over(way):
        return jnp.where(data.overlaid, own_first + (way - first) * ratio, way)

    return over


def plausible(status: Any) -> bool:
    """Whether the model's path was found to its end."""
    return int(status) == Status.ok
