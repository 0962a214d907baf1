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
from jaxwhisker._scan.scan import BLOCK, StagedScan

OVERLAID_SIGMA = 0.1  # of the peak: standard deviation of overlaid signals
OVERLAID_EVENT = 0.03  # lengths: standard deviation of touches, releases and jumps of overlaid scans
OVERLAID_PRIOR = 50.0  # standard deviation of the fit's variables; all signals together weigh as much as their mean
PRIOR = 1e4  # the same in later stages: unknowns that change no signal keep their values
UNIFORM = 12**-0.5  # of the gap between two samples: standard deviation of a snap that may be anywhere in it
OUTSIDE = 8.0  # multiple of its weight that is added to a snap far outside its gap
WIDER = 2.0  # gaps over which that grows; smoothly, because a least-squares step cannot foresee a wall
PRICE = 3.0  # standard deviations: residual of every value between the model's snap and the observed one
MISSING_EVENT = 1.0  # a length: residual of an observed event that the model does not have


class Samples(NamedTuple):
    """Padded observations, as the compiled residuals take them."""

    control: Any  # (samples,)
    values: Any  # (samples, whiskers, 3)
    weight: Any  # (samples, whiskers, 3) 1 / sigma; 0 where nothing was measured
    stops: Any  # (stops,) of the drive
    last: Any  # index of the last stop
    landmarks: Features
    end_weight: Any  # (2, whiskers) of the positions of touches and releases
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
    # Recordings of similar length share a compilation.
    padding = -observations.control.size % BLOCK

    def pad(values, **options):
        return np.pad(values, [(0, padding)] + [(0, 0)] * (values.ndim - 1), **options)

    known = observations.known
    with np.errstate(divide="ignore", invalid="ignore"):
        each = OVERLAID_SIGMA * observations.peaks * np.sqrt(known.sum())
        weight = np.where(known, 1 / each if overlaid else 1 / observations.sigma, 0.0)
    gap = np.where(np.isfinite(landmarks.low), landmarks.high - landmarks.low, 1.0)
    control, touch_error = observations.control, np.nan_to_num(landmarks.touch_error)
    return Samples(
        control=pad(control, mode="edge"),
        values=pad(np.where(known, observations.values, 0.0)),
        weight=pad(weight),
        stops=route.stops,
        last=np.asarray(route.last),
        landmarks=landmarks._replace(travel=pad(landmarks.travel, mode="edge")),
        end_weight=1 / np.hypot(OVERLAID_EVENT * length, [touch_error, 0 * touch_error]),
        jump_weight=1 / (np.full(JUMPS, OVERLAID_EVENT * length) if overlaid else UNIFORM * gap),
        jump_width=np.full(JUMPS, np.inf) if overlaid else WIDER * gap,
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
    scene = build(**dict(zip(unknowns.names, x, strict=False)))
    scan = StagedScan(scene, stops, jnp.where(data.overlaid, 1, data.last))
    start = jax.lax.stop_gradient(scan.start)  # the overlaid scan begins where the model's does
    happened = jnp.arange(scan.events.kind.size) < scan.events.count
    at = _travel_of(scan.events, happened, data)
    ends = _contact_ends(scan.events, at, happened)
    overlay = _overlay(data, ends)

    along = overlay(data.landmarks.travel)
    control = jnp.where(data.overlaid, start + data.direction * along, data.control + shift)
    signals, ok = scan.signals(control, jax.lax.stop_gradient(along))
    signals = jnp.where(ok[:, None, None], signals, 0.0) + _offset(unknowns, x, data)

    snaps = _pair_snaps(scan.events, at, happened, overlay, data)
    left_out, wrong_side = _at_snaps(snaps, along)
    of_signals = jnp.where(left_out[:, None, None], 0.0, (signals - data.values) * data.weight)
    # Without a price, a fit could improve by moving a snap to leave out bad samples.
    priced = (wrong_side & ~data.overlaid)[:, None, None] & (data.weight > 0)
    of_signals = jnp.where(priced, PRICE, of_signals)

    observed = jnp.stack([data.landmarks.touch, data.landmarks.release])
    wanted = data.control[0] + data.direction * jnp.nan_to_num(observed)
    off = jnp.where(ends.exists, start + data.direction * ends.travel - wanted, MISSING_EVENT)
    of_ends = jnp.where(data.overlaid & jnp.isfinite(observed), off, 0.0) * data.end_weight

    everything = [
        of_signals.ravel(),
        _residuals_of_snaps(snaps, data),
        of_ends.ravel(),
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
    step = jnp.clip(jnp.searchsorted(data.landmarks.travel, at) - 1, 0, data.landmarks.travel.size - 2)
    heading = jnp.sign(data.control[step + 1] - data.control[step])
    return at + jnp.where(data.overlaid | (heading == 0), data.direction, heading) * moved


class _ContactEnds(NamedTuple):
    """The first touch and the last release of every whisker, (2, whiskers)."""

    travel: Any
    exists: Any


def _contact_ends(events: Events, at: Float[Array, " events"], happened: Bool[Array, " events"]) -> _ContactEnds:
    touching = happened[:, None] & events.whiskers & (events.kind == EventKind.touch)[:, None]
    lost = (events.before.phase != Phase.free) & (events.after.phase == Phase.free)
    freed = happened[:, None] & lost & (events.kind >= EventKind.release)[:, None]
    event = jnp.stack([jnp.argmax(touching, axis=0), at.size - 1 - jnp.argmax(freed[::-1], axis=0)])
    exists = jnp.stack([jnp.any(touching, axis=0), jnp.any(freed, axis=0)])
    return _ContactEnds(jnp.where(exists, at[event], 0.0), exists)


def _overlay(data: Samples, ends: _ContactEnds) -> Callable[[Any], Any]:
    """The map from observed travel to the model's; it does not move an end of contact that is not visible."""
    travel, touch, release = data.landmarks.travel, data.landmarks.touch, data.landmarks.release
    visible_first, visible_last = jnp.any(jnp.isfinite(touch)), jnp.any(jnp.isfinite(release))
    first = jnp.where(visible_first, jnp.nanmin(touch), 0.0)
    last = jnp.where(visible_last, jnp.nanmax(release), travel[-1])
    model_first = jnp.min(jnp.where(ends.exists[0], ends.travel[0], jnp.inf))
    model_last = jnp.max(jnp.where(ends.exists[1], ends.travel[1], -jnp.inf))
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
    snap: Any
    jump: Any  # whether there is a jump
    paired: Any  # whether there is a snap for it


def _pair_snaps(events: Events, at, happened, overlay: Callable, data: Samples) -> _Snaps:
    is_snap = happened & (events.kind >= EventKind.snap_through)
    jump = jnp.isfinite(data.landmarks.low)
    low, high = (overlay(jnp.where(jump, travel, 0.0)) for travel in (data.landmarks.low, data.landmarks.high))
    apart = jnp.where(is_snap, jnp.abs(at - (low + high)[:, None] / 2), jnp.inf)
    nearest = jnp.argmin(apart, axis=1)
    paired = jump & jnp.isfinite(jnp.min(apart, axis=1))
    low, high, snap = (jnp.where(paired, v, 0.0) for v in (low, high, at[nearest]))
    return _Snaps(low, high, snap, jump, paired)


def _residuals_of_snaps(snaps: _Snaps, data: Samples) -> Float[Array, " jumps"]:
    middle = (snaps.low + snaps.high) / 2
    off = jnp.where(snaps.paired, snaps.snap - middle, jnp.where(snaps.jump, MISSING_EVENT, 0.0))
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
