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

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._inverse.features import JUMPS, Features
from jaxwhisker._inverse.observations import Observations
from jaxwhisker._inverse.parameters import Transforms
from jaxwhisker._inverse.unknowns import Unknowns, split
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import EventKind, is_snap
from jaxwhisker._scan.blocks import BLOCK
from jaxwhisker._scan.channels import result_of
from jaxwhisker._scan.events import EventTable, event_table
from jaxwhisker._scan.plane import InThePlane
from jaxwhisker._scan.route import Route
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.steps import solved_states

OVERLAID_SIGMA = 0.1  # of the peak: standard deviation of overlaid signals
OVERLAID_EVENT = 0.03  # lengths: standard deviation of touches, releases and jumps of overlaid scans
OVERLAID_PRIOR = 50.0  # standard deviation of the fit's variables; all signals together weigh as much as their mean
PRIOR = 1e4  # the same in later stages: unknowns that change no signal keep their values
UNIFORM = 12**-0.5  # of the gap between two samples: standard deviation of a snap that may be anywhere in it
OUTSIDE = 8.0  # multiple of its weight that is added to a snap far outside its gap
WIDER = 2.0  # gaps over which that grows; smoothly, because a least-squares step cannot foresee a wall
PENALTY = 3.0  # standard deviations: residual of every value between the model's snap and the observed one
MISSING_EVENT = 1.0  # a length: residual of an observed event that the model does not have


class Samples(NamedTuple):
    """Padded observations."""

    control: Any  # (samples,)
    values: Any  # (samples, whiskers, 3), or (samples, 1, names) from a function
    weight: Any  # (samples, whiskers, 3) 1 / sigma; 0 where nothing was measured
    stops: Any  # (stops,) of the drive
    last: Any  # index of the last stop
    landmarks: Features
    end_weight: Any  # (2, whiskers) of the positions of touches and releases
    jump_weight: Any  # (jumps,) of the distance between a snap and the middle of its gap
    jump_width: Any  # (jumps,) distance over which that weight grows
    missing: Any  # length that a snap counts as off if the model has none
    overlaid: Any  # whether scans are overlaid
    direction: Any  # sign of the change of the control from the first sample to the last


class Comparison(NamedTuple):
    """What the residuals compare with the observations."""

    signals: Any  # (samples, whiskers, 3) of the model, gains and offsets included; NaN where a step failed
    left_out: Any  # (samples,) whether a sample is left out at a snap
    status: Any  # of the path
    unscaled: Any  # (samples, whiskers, 3) signals without gains and offsets


def samples_of(
    observations: Observations,
    landmarks: Features,
    route: Route,
    *,
    overlaid: bool,
    length: float,
    friction: bool = False,
) -> Samples:
    """Pad observations, and weight them for the overlaid stage or the others.

    With friction, signals also change suddenly where contacts begin to slip: what looks like a snap may be none.
    """
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
        missing=np.asarray(0.0 if friction and not overlaid else MISSING_EVENT),
        overlaid=np.asarray(overlaid),
        direction=np.asarray(float(np.sign(control[-1] - control[0]) or -1.0)),
    )


class PlacedSamples(NamedTuple):
    """Where signals are compared, and the residuals that do not depend on the signals."""

    control: Any  # (samples,) of the model
    travel: Any  # (samples,) of the model; no derivatives
    weight: Any  # (samples, whiskers, 3) of the differences between signals; 0 where a sample is left out
    price: Any  # (samples, whiskers, 3) residuals of samples between the model's snap and the observed one
    left_out: Any  # (samples,) whether a sample is left out at a snap
    of_snaps: Any  # (jumps,) residuals of snaps
    of_ends: Any  # (2, whiskers) residuals of touches and releases

    def residuals(self, signals: Any, data: Samples, xp: Any = np) -> list[Any]:
        """Residuals of the signals, of snaps, and of touches and releases, flat. Signals that are NaN count as zero."""
        of_signals = self.weight * (xp.where(xp.isnan(signals), 0.0, signals) - data.values) + self.price
        return [of_signals.ravel(), self.of_snaps, self.of_ends.ravel()]


def place(shift: Scalar, start: Scalar, events: EventTable, data: Samples) -> PlacedSamples:
    """Choose the positions of the model that correspond to the samples, and compare its events with the observed ones.

    Args:
        shift: of the control.
        start: position from which the model's travel counts in an overlaid scan.
        events: of the model.
        data: the observations.
    """
    start = jax.lax.stop_gradient(start)  # the overlaid scan begins where the model's does
    happened = events.kind >= 0
    at = _travel_of(events, happened, data)
    # Signals from a function do not say which whisker they belong to.
    ends = _contact_ends(events, at, of_each=data.landmarks.touch.shape == events.whiskers.shape[1:])
    overlay = _overlay(data, ends)
    along = overlay(data.landmarks.travel)
    control = jnp.where(data.overlaid, start + data.direction * along, data.control + shift)

    snaps = _pair_snaps(events, at, happened, overlay, data)
    left_out, wrong_side = _at_snaps(snaps, along)
    # Without a price, a fit could improve by moving a snap to leave out bad samples.
    priced = (wrong_side & ~data.overlaid)[:, None, None] & (data.weight > 0)

    observed = jnp.stack([data.landmarks.touch, data.landmarks.release])
    wanted = data.control[0] + data.direction * jnp.nan_to_num(observed)
    off = jnp.where(ends.exists, start + data.direction * ends.travel - wanted, MISSING_EVENT)
    return PlacedSamples(
        control=control,
        travel=jax.lax.stop_gradient(along),
        weight=jnp.where(left_out[:, None, None], 0.0, data.weight),
        price=jnp.where(priced, PENALTY, 0.0),
        left_out=left_out,
        of_snaps=_residuals_of_snaps(snaps, data),
        of_ends=jnp.where(data.overlaid & jnp.isfinite(observed), off, 0.0) * data.end_weight,
    )


def _placed_and_slopes(
    shift: Scalar,
    start: Scalar,
    events: EventTable,
    data: Samples,
    shift_slopes: Float[Array, " directions"],
    event_slopes: Float[Array, "events directions"],
) -> tuple[PlacedSamples, PlacedSamples]:
    """The result of `place` and its derivatives, which are None where they are zero."""

    def smooth(shift, control):
        placed = place(shift, start, events._replace(control=control), data)
        return (placed.control, placed.of_snaps, placed.of_ends), placed

    def towards(*dots):
        return jax.jvp(smooth, (shift, events.control), dots, has_aux=True)

    _, by, placed = jax.vmap(towards, in_axes=-1, out_axes=(None, -1, None))(shift_slopes, event_slopes)
    return placed, PlacedSamples(by[0], None, None, None, None, by[1], by[2])


placed_and_slopes_now = Program(_placed_and_slopes, quick=True)


def prior_weight(data: Samples) -> Any:
    """Weight of the fit's variables, which keep the values of the prior where signals say nothing."""
    return 1 / np.where(data.overlaid, OVERLAID_PRIOR, PRIOR)


def log_density(
    build: Callable[..., AbstractScene],
    unknowns: Unknowns,
    transforms: Transforms,
    y: Float[Array, " unknowns"],
    data: Sequence[Samples],
    prior: Float[np.ndarray, " unknowns"],
) -> Float[Array, ""]:
    """Logarithm of the likelihood up to a constant; traceable and differentiable."""
    x, misfit = transforms.natural(y), jnp.sum(((y - prior) * prior_weight(data[0])) ** 2)
    for samples, columns in zip(data, unknowns.columns, strict=True):
        misfit += _misfit(build, unknowns, x[columns], jax.tree.map(jnp.asarray, samples))
    return -0.5 * misfit


def _misfit(build, unknowns: Unknowns, x: Float[Array, " own"], data: Samples) -> Scalar:
    """Sum of squares of the residuals of one recording, from its own unknowns."""
    parts = split(unknowns, x)
    shift = parts.shift[0] if unknowns.shift else jnp.zeros(())
    scene = jax.tree.map(checks.as_float, build(**dict(zip(unknowns.build, parts.build, strict=True))))
    mechanics = mechanics_of(scene)
    problem = problem_of(scene) if mechanics is InThePlane else mechanics.problem(scene)
    path, start, _ = mechanics.follow(problem, data.stops + shift, data.last)
    path = mechanics.detected(scene, problem, path)
    memory = mechanics.memory(problem, path, data.stops + shift)
    placed = place(shift, start, event_table(mechanics, problem, path, memory), data)
    state, _, displacement, _ = solved_states(mechanics, problem, path, placed.control, placed.travel, memory)
    values = dict(zip(unknowns.channels.parameters, parts.channels, strict=True))
    signals = unknowns.channels.of_result(result_of(scene, state, displacement, placed.control), values)
    signals = unknowns.gains.applied(signals, parts.gains, jnp)
    for (whisker, kind), offset in zip(unknowns.offsets, parts.offsets, strict=True):
        signals = signals.at[:, whisker, kind].add(offset)
    return sum((jnp.sum(part**2) for part in placed.residuals(signals, data, jnp)), jnp.zeros(()))


def _travel_of(events: EventTable, happened: Bool[Array, " events"], data: Samples) -> Float[Array, " events"]:
    """Travel at every event; its derivative is that of the control times the direction in which the drive moves."""
    moved = jnp.where(happened, events.control - jax.lax.stop_gradient(events.control), 0.0)
    at = jnp.where(happened, events.travel, 0.0)
    step = jnp.clip(jnp.searchsorted(data.landmarks.travel, at) - 1, 0, data.landmarks.travel.size - 2)
    heading = jnp.sign(data.control[step + 1] - data.control[step])
    return at + jnp.where(data.overlaid | (heading == 0), data.direction, heading) * moved


class _ContactEnds(NamedTuple):
    """The first touch and the last release of every whisker, (2, whiskers); (2, 1) for all whiskers together."""

    travel: Any
    exists: Any


def _contact_ends(events: EventTable, at: Float[Array, " events"], *, of_each: bool) -> _ContactEnds:
    """The ends of contact of each whisker, or of all whiskers together."""
    touching, freed = events.whiskers & (events.kind == EventKind.touch)[:, None], events.freed
    if not of_each:
        touching, freed = (jnp.any(which, axis=1, keepdims=True) for which in (touching, freed))
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


def _pair_snaps(events: EventTable, at, happened, overlay: Callable, data: Samples) -> _Snaps:
    snaps = happened & is_snap(events.kind)
    jump = jnp.isfinite(data.landmarks.low)
    low, high = (overlay(jnp.where(jump, travel, 0.0)) for travel in (data.landmarks.low, data.landmarks.high))
    apart = jnp.where(snaps, jnp.abs(at - (low + high)[:, None] / 2), jnp.inf)
    nearest = jnp.argmin(apart, axis=1)
    paired = jump & jnp.isfinite(jnp.min(apart, axis=1))
    low, high, snap = (jnp.where(paired, v, 0.0) for v in (low, high, at[nearest]))
    return _Snaps(low, high, snap, jump, paired)


def _residuals_of_snaps(snaps: _Snaps, data: Samples) -> Float[Array, " jumps"]:
    middle = (snaps.low + snaps.high) / 2
    off = jnp.where(snaps.paired, snaps.snap - middle, jnp.where(snaps.jump, data.missing, 0.0))
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
