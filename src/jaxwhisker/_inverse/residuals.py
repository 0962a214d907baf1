"""Whitened residuals of a scan against observed signals, and their derivatives with respect to the unknowns.

Signals jump at snaps. Between the model's snap and the observed one, residuals carry no information, and their slopes
mislead the fit. These samples are left out at a fixed price. The last sample before an observed snap is left out, too,
at no price. Instead, the position of the snap is compared, which lies anywhere between the two samples between which
the signals jump.

Initial guesses may be far off. Therefore a first stage overlays the scans: the model's travel from first touch to last
release is stretched to the observed one, signals are compared at equal fractions of it, and the positions of touches
and releases are compared separately. That misfit is smooth and has a wide minimum, from which the fit at equal controls
starts.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.features import JUMPS, Features
from jaxwhisker._inverse.observations import Observations
from jaxwhisker._inverse.parameters import Transforms, Unknowns
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.result import Events
from jaxwhisker._scan.route import Route
from jaxwhisker._scan.scan import TracedScan

BLOCK = 512  # samples are padded to a multiple of it, so recordings of similar length share a compilation
OVERLAID_SIGMA = 0.1  # of the peak: standard deviation of overlaid signals
OVERLAID_EVENT = 0.03  # lengths: standard deviation of touches, releases and jumps of overlaid scans
OVERLAID_PRIOR = 50.0  # standard deviation of the fit's variables; all signals together weigh as much as their mean
PRIOR = 1e4  # the same in later stages: unknowns that change no signal keep their values
UNIFORM = 12**-0.5  # of the gap between two samples: standard deviation of a snap that may be anywhere in it
OUTSIDE = 8.0  # multiple of its weight that is added to a snap far outside its gap
WIDTH = 2.0  # gaps over which that grows; smoothly, because a least-squares step cannot foresee a wall
PRICE = 3.0  # standard deviations: residual of every value between the model's snap and the observed one
NO_EVENT = 1.0  # a length: residual of an observed event that the model does not have


class Samples(NamedTuple):
    """Padded observations, as the compiled residuals take them."""

    control: Any  # (samples,)
    travel: Any  # (samples,)
    values: Any  # (samples, whiskers, 3)
    weight: Any  # (samples, whiskers, 3) 1 / sigma; 0 where nothing was measured
    stops: Any  # (stops,) of the drive
    last: Any  # index of the last stop
    low: Any  # (jumps,) travel before each jump
    high: Any  # (jumps,) travel after each jump
    touch: Any  # (whiskers,) travel; NaN if it is not visible
    release: Any
    touch_weight: Any  # (whiskers,)
    release_weight: Any
    jump_weight: Any  # (jumps,) of the distance between a snap and the middle of its gap
    jump_width: Any  # (jumps,) distance over which that weight grows
    transforms: Transforms
    prior: Any  # (unknowns,)
    prior_weight: Any
    overlaid: Any  # whether scans are overlaid
    direction: Any  # sign of the change of the control from the first sample to the last


class Comparison(NamedTuple):
    """What the residuals compare with the observations."""

    signals: Any  # (samples, whiskers, 3) of the model, offsets included; NaN where a step failed
    left_out: Any  # (samples,) whether a sample is left out at a snap
    status: Any  # of the path


def samples_of(
    observations: Observations,
    landmarks: Features,
    transforms: Transforms,
    prior: np.ndarray,
    route: Route,
    *,
    overlaid: bool,
    length: float,
) -> Samples:
    """Pad observations, and weight them for the overlaid stage or the others."""
    padding = -observations.control.size % BLOCK

    def pad(values, fill=None):
        return np.concatenate([values, np.repeat(values[-1:] if fill is None else fill, padding, axis=0)])

    known = observations.known
    with np.errstate(divide="ignore", invalid="ignore"):
        each = OVERLAID_SIGMA * observations.peaks * np.sqrt(known.sum())
        weight = np.where(known, 1 / each if overlaid else 1 / observations.sigma, 0.0)
    gap = np.where(np.isfinite(landmarks.low), landmarks.high - landmarks.low, 1.0)
    control = observations.control
    return Samples(
        control=pad(control),
        travel=pad(landmarks.travel),
        values=pad(np.where(known, observations.values, 0.0)),
        weight=pad(weight, np.zeros((1, *weight.shape[1:]))),
        stops=route.stops,
        last=np.asarray(route.last),
        low=landmarks.low,
        high=landmarks.high,
        touch=landmarks.touch,
        release=landmarks.release,
        touch_weight=1 / np.hypot(OVERLAID_EVENT * length, np.nan_to_num(landmarks.touch_error)),
        release_weight=np.asarray(1 / (OVERLAID_EVENT * length)),
        jump_weight=1 / (np.full(JUMPS, OVERLAID_EVENT * length) if overlaid else UNIFORM * gap),
        jump_width=np.full(JUMPS, np.inf) if overlaid else WIDTH * gap,
        transforms=transforms,
        prior=prior,
        prior_weight=np.asarray(1 / (OVERLAID_PRIOR if overlaid else PRIOR)),
        overlaid=np.asarray(overlaid),
        direction=np.asarray(float(np.sign(control[-1] - control[0]) or -1.0)),
    )


def residuals(
    build: Callable[..., Scene], unknowns: Unknowns, y: Float[Array, " unknowns"], data: Samples
) -> tuple[Float[Array, " residuals"], Comparison]:
    """Whitened residuals of all signals, of jumps, of touches and releases, and of the prior."""
    x = data.transforms.natural(y)
    shift = x[-1] if unknowns.shift else jnp.zeros(())
    stops = jnp.where(data.overlaid, jnp.nan, data.stops + shift)
    scan = TracedScan(
        build(**dict(zip(unknowns.names, x, strict=False))), stops, jnp.where(data.overlaid, 1, data.last)
    )
    start = jax.lax.stop_gradient(scan.start)  # the overlaid scan begins where the model's does
    happened = jnp.arange(scan.events.kind.size) < scan.events.count
    at = _travel_of(scan.events, happened, data)
    ends = _contact_ends(scan.events, at, happened)
    overlay = _overlay(data, ends)

    along = overlay(data.travel)
    control = jnp.where(data.overlaid, start + data.direction * along, data.control + shift)
    signals, ok = scan.signals(control, jax.lax.stop_gradient(along))
    signals = jnp.where(ok[:, None, None], signals, 0.0) + _offset(unknowns, x, data)

    snaps = _pair_snaps(scan.events, at, happened, overlay, data)
    left_out, wrong_side = _at_snaps(snaps, along)
    of_signals = jnp.where(left_out[:, None, None], 0.0, (signals - data.values) * data.weight)
    # Without a price, a fit could improve by moving a snap to leave out bad samples.
    priced = (wrong_side & ~data.overlaid)[:, None, None] & (data.weight > 0)
    of_signals = jnp.where(priced, PRICE, of_signals)

    def of_ends(travel, exists, observed, weight):
        wanted = data.control[0] + data.direction * jnp.where(jnp.isfinite(observed), observed, 0.0)
        off = jnp.where(exists, start + data.direction * travel - wanted, NO_EVENT)
        return jnp.where(data.overlaid & jnp.isfinite(observed), off, 0.0) * weight

    everything = [
        of_signals.ravel(),
        _residuals_of_snaps(snaps, data),
        of_ends(ends.touch, ends.touches, data.touch, data.touch_weight),
        of_ends(ends.release, ends.releases, data.release, data.release_weight),
        (y - data.prior) * data.prior_weight,
    ]
    compared = Comparison(jnp.where(ok[:, None, None], signals, jnp.nan), left_out, scan.status)
    return jnp.concatenate(everything), compared


def _offset(unknowns: Unknowns, x: Float[Array, " unknowns"], data: Samples) -> Float[Array, "whiskers 3"]:
    """The constant offset of each channel."""
    offset = jnp.zeros(data.values.shape[1:])
    for k, (whisker, reaction) in enumerate(unknowns.offsets):
        offset = offset.at[whisker, reaction].set(x[len(unknowns.names) + k])
    return offset


def _travel_of(events: Events, happened: Bool[Array, " events"], data: Samples) -> Float[Array, " events"]:
    """Travel at every event; its derivative is that of the control times the direction in which the drive moves."""
    moved = jnp.where(happened, events.control - jax.lax.stop_gradient(events.control), 0.0)
    at = jnp.where(happened, events.travel, 0.0)
    step = jnp.clip(jnp.searchsorted(data.travel, at) - 1, 0, data.travel.size - 2)
    heading = jnp.sign(data.control[step + 1] - data.control[step])
    return at + jnp.where(data.overlaid | (heading == 0), data.direction, heading) * moved


class _ContactEnds(NamedTuple):
    """Travel at the first touch and the last release of every whisker, (whiskers,), and whether there is one."""

    touch: Any
    touches: Any
    release: Any
    releases: Any


def _contact_ends(events: Events, at: Float[Array, " events"], happened: Bool[Array, " events"]) -> _ContactEnds:
    touching = happened[:, None] & events.whiskers & (events.kind == EventKind.touch)[:, None]
    lost = (events.before.phase != Phase.free) & (events.after.phase == Phase.free)
    freed = happened[:, None] & lost & (events.kind >= EventKind.release)[:, None]
    touches, releases = jnp.any(touching, axis=0), jnp.any(freed, axis=0)
    touch = jnp.where(touches, at[jnp.argmax(touching, axis=0)], 0.0)
    release = jnp.where(releases, at[at.size - 1 - jnp.argmax(freed[::-1], axis=0)], 0.0)
    return _ContactEnds(touch, touches, release, releases)


def _overlay(data: Samples, ends: _ContactEnds) -> Callable[[Any], Any]:
    """The map from observed travel to the model's; it does not move an end of contact that is not visible."""
    visible_first, visible_last = jnp.any(jnp.isfinite(data.touch)), jnp.any(jnp.isfinite(data.release))
    first = jnp.where(visible_first, jnp.nanmin(data.touch), 0.0)
    last = jnp.where(visible_last, jnp.nanmax(data.release), data.travel[-1])
    model_first = jnp.min(jnp.where(ends.touches, ends.touch, jnp.inf))
    model_last = jnp.max(jnp.where(ends.releases, ends.release, -jnp.inf))
    both = jnp.isfinite(model_first) & jnp.isfinite(model_last) & (model_last > model_first) & (last > first)
    model_first = jnp.where(both & visible_first, model_first, first)
    model_last = jnp.where(both & visible_last, model_last, model_first + last - first)
    ratio = jnp.where(both, (model_last - model_first) / jnp.where(last > first, last - first, 1.0), 1.0)

    def overlay(travel):
        return jnp.where(data.overlaid, model_first + (travel - first) * ratio, travel)

    return overlay


class _Snaps(NamedTuple):
    """Travel at observed jumps and at the model's snap nearest to each, (jumps,); 0 where a jump has no snap."""

    low: Any
    high: Any
    middle: Any
    snap: Any
    jump: Any  # whether there is a jump
    paired: Any  # whether there is a snap for it


def _pair_snaps(events: Events, at, happened, overlay: Callable, data: Samples) -> _Snaps:
    is_snap = happened & (events.kind >= EventKind.snap_through)
    jump = jnp.isfinite(data.low)
    low, high = (overlay(jnp.where(jump, travel, 0.0)) for travel in (data.low, data.high))
    middle = (low + high) / 2
    apart = jnp.where(is_snap, jnp.abs(at - middle[:, None]), jnp.inf)
    nearest = jnp.argmin(apart, axis=1)
    paired = jump & jnp.isfinite(jnp.min(apart, axis=1))
    low, high, middle, snap = (jnp.where(paired, v, 0.0) for v in (low, high, middle, at[nearest]))
    return _Snaps(low, high, middle, snap, jump, paired)


def _residuals_of_snaps(snaps: _Snaps, data: Samples) -> Float[Array, " jumps"]:
    off = jnp.where(snaps.paired, snaps.snap - snaps.middle, jnp.where(snaps.jump, NO_EVENT, 0.0))
    outside = (off / data.jump_width) ** 4
    return off * (1 + OUTSIDE * outside / (1 + outside)) * data.jump_weight


def _at_snaps(
    snaps: _Snaps, along: Float[Array, " samples"]
) -> tuple[Bool[Array, " samples"], Bool[Array, " samples"]]:
    """Which samples are left out at snaps, and which of them lie between the model's snap and the observed one."""
    low, high, snap, here = jax.lax.stop_gradient((snaps.low, snaps.high, snaps.snap, along[:, None]))
    between = jnp.any((((here <= low) & (here > snap)) | ((here >= high) & (here < snap))) & snaps.paired, axis=1)
    # Slopes grow without bound towards a fold: the last sample before it says little and distorts the misfit.
    return between | jnp.any((here == low) & snaps.paired, axis=1), between
