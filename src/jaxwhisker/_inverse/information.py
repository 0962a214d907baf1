"""Fisher information: how well signals determine parameters, by channel, along the scan and by event."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control
from jaxwhisker._inverse.channels import channels_from, reactions_of
from jaxwhisker._inverse.gains import gains_from
from jaxwhisker._inverse.linearised import LinearisedScan
from jaxwhisker._inverse.observations import Observations, channel_pattern, read_observations
from jaxwhisker._inverse.parameters import build_scene, check_traceable, read_parameters, transforms_of
from jaxwhisker._inverse.residuals import UNIFORM
from jaxwhisker._inverse.statistics import Identifiability, correlation, identifiability
from jaxwhisker._inverse.unknowns import Unknowns, split, unknowns_of
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.channels import arguments_of
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE
from jaxwhisker._scan.report import table
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import default_control


class EventInformation(NamedTuple):
    """Information in the position of one event."""

    kind: EventKind
    whiskers: tuple[int, ...]  # numbered from 1
    control: float
    by_parameter: np.ndarray  # (parameters,) d control / d parameter
    sigma: float  # standard error of the control, from the jump of the signals there; infinite without a jump


@dataclass(frozen=True, eq=False, repr=False)
class Information:
    """Fisher information of signals with Gaussian noise: J^T J, where J holds the derivatives divided by the noise.

    Signals jump at a snap, which therefore lies anywhere between two steps at a distance h: its position counts as a
    value with standard error h / sqrt(12). Parameters are in their own units. The inverse bounds the covariance of
    every unbiased estimate (Cramer and Rao); a parameter that is not identifiable has no standard error.
    """

    names: tuple[str, ...]
    at: dict[str, float]
    control: np.ndarray  # (steps,)
    channels: tuple[str, ...]  # fx, fy, mz, or fx_1, fx_2, ... of several whiskers; or names from a function
    rates: np.ndarray  # (steps, channels, parameters) whitened derivatives; 0 where a step failed
    events: tuple[EventInformation, ...]
    log: np.ndarray  # (parameters,) whether `combinations` describes changes of a parameter as relative ones
    scene: AbstractScene  # of these parameters

    def of(self, *channels: str) -> "Information":
        """The information in some of the channels: `of("mz_1", "mz_2")`, or `of("mz")` for all whiskers.

        Raises:
            ValueError: if there is no such channel.
        """
        for name in channels:
            if name not in self.channels and name not in REACTIONS_IN_SPACE:
                raise ValueError(f"`channels` must be among {', '.join(self.channels)}, got {name!r}.")
        keep = [k for k, c in enumerate(self.channels) if c in channels or c.split("_")[0] in channels]
        return replace(self, channels=tuple(self.channels[k] for k in keep), rates=self.rates[:, keep])

    def known(self, *names: str) -> "Information":
        """The information about the other parameters if these are known.

        Raises:
            ValueError: if there is no such parameter, or none is left.
        """
        for name in names:
            if name not in self.names:
                raise ValueError(f"`names` must be among {', '.join(self.names)}, got {name!r}.")
        keep = [k for k, n in enumerate(self.names) if n not in names]
        if not keep:
            raise ValueError("`names` must leave at least one parameter, got all of them.")
        events = tuple(e._replace(by_parameter=e.by_parameter[keep]) for e in self.events)
        left = tuple(self.names[k] for k in keep)
        at = {name: self.at[name] for name in left}
        return replace(self, names=left, at=at, rates=self.rates[:, :, keep], events=events, log=self.log[keep])

    def __add__(self, other: "Information") -> "Information":
        """The information in two independent scans of the same sensor, one after the other.

        Raises:
            ValueError: if their parameters, the values of these, or channels differ.
        """
        checks.instance("other", other, Information, "an Information")
        if self.names == other.names and self.at != other.at:
            checks.fail("other", f"information at {self.at}", f"one at {other.at}")
        for name in ("names", "channels"):
            if getattr(self, name) != getattr(other, name):
                raise ValueError(
                    f"`other` must have the {name} {', '.join(getattr(self, name))}, got "
                    f"{', '.join(getattr(other, name))}."
                )
        control, rates = (np.concatenate([getattr(one, n) for one in (self, other)]) for n in ("control", "rates"))
        return replace(self, control=control, rates=rates, events=self.events + other.events)

    @property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives of all steps, channel by channel, and of snaps: (values, parameters)."""
        snaps = [event.by_parameter / event.sigma for event in self.events]
        return np.concatenate([self.rates.reshape(-1, len(self.names)), np.reshape(snaps, (-1, len(self.names)))])

    @property
    def matrix(self) -> np.ndarray:
        """J^T J, (parameters, parameters)."""
        return self.jacobian.T @ self.jacobian

    @property
    def by_channel(self) -> dict[str, np.ndarray]:
        """Contribution of each channel to the matrix, and that of the snaps."""
        snaps = self.jacobian[self.rates.shape[0] * self.rates.shape[1] :]
        return {name: self.rates[:, k].T @ self.rates[:, k] for k, name in enumerate(self.channels)} | {
            "snaps": snaps.T @ snaps
        }

    @property
    def density(self) -> np.ndarray:
        """Information of each step about each parameter alone, (steps, parameters): the diagonal along the scan."""
        return np.sum(self.rates**2, axis=1)

    def with_events(self, sigma: float) -> "Information":
        """The information if the positions of all events are measured as well.

        Args:
            sigma: standard error of each position, in the unit of the control; positive.

        Raises:
            ValueError: if `sigma` is not a positive number.
        """
        checks.number("sigma", sigma, positive=True)
        return replace(self, events=tuple(e._replace(sigma=min(float(sigma), e.sigma)) for e in self.events))

    @property
    def _scale(self) -> np.ndarray:
        values = np.abs(np.array(list(self.at.values())))
        return np.where(values > 0, values, 1.0)

    @property
    def _identifiability(self) -> Identifiability:
        return identifiability(self.jacobian * self._scale, self.names, self.log, self._scale)

    @property
    def covariance(self) -> np.ndarray:
        """The bound of Cramer and Rao, (parameters, parameters); NaN for parameters that are not identifiable."""
        return self._identifiability.covariance * np.outer(self._scale, self._scale)

    @property
    def standard_error(self) -> dict[str, float]:
        """Least standard error of each parameter if all are estimated together; NaN if it is not identifiable."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the estimates, (parameters, parameters)."""
        return correlation(self.covariance)

    @property
    def combinations(self) -> tuple[str, ...]:
        """Combinations of parameters that are not identifiable, in words."""
        return self._identifiability.combinations

    @property
    def rank(self) -> int:
        """Number of combinations that are identifiable."""
        return self._identifiability.rank

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest singular value of J with respect to relative changes."""
        return self._identifiability.condition

    def __str__(self) -> str:
        rows = []
        for k, (name, error) in enumerate(self.standard_error.items()):
            shown = ["-", "-"] if np.isnan(error) else [f"{error:.3g}", self._best_channel(k)]
            rows.append([name, f"{self.at[name]:.6g}", *shown])
        lines = [table(["parameter", "value", "standard error", "best channel"], rows)]
        lines += [f"not identifiable: {words}." for words in self.combinations]
        lines.append(f"rank {self.rank} of {len(self.names)}, condition {self.condition:.2g}")
        return "\n".join(lines)

    __repr__ = __str__

    def _best_channel(self, parameter: int) -> str:
        """The channel with most of the information about a parameter, and its share."""
        share = {name: matrix[parameter, parameter] for name, matrix in self.by_channel.items()}
        name = max(share, key=lambda n: share[n])
        return f"{name} ({share[name] / max(sum(share.values()), 1e-300):.0%})"


@with_own_settings
def information(
    build: Callable[..., AbstractScene],
    at: Mapping[str, float],
    *,
    sigma: Any,
    control: Control | None = None,
    channels: Sequence[str] | Callable[..., Mapping[str, Any]] | None = None,
    gains: Any = False,
    offsets: bool = False,
) -> Information:
    """Compute the Fisher information of a scene's signals about its parameters, by exact derivatives.

    Args:
        build: makes a Scene from named numbers. JAX must be able to trace it.
        at: the unknown parameters with their values.
        sigma: standard deviation of the signals' noise, independent from step to step: a number, or a mapping from
            channels to numbers.
        control: drive positions, (steps,). Default: those of `scan`. Information is proportional to the density of
            steps.
        channels: measured channels, such as "mz" (of all whiskers) or "mz_1"; or a function of the result, as in
            `identify`, with its own unknown parameters in `at`. Default: all reactions.
        gains: as in `identify`: True, or a matrix, whose entries are unknown where they are NaN. `at` may hold values
            of unknown ones, such as `gain_fx_my`; the others are those of a sensor without crosstalk: 1 for a channel
            and the signal of its name, else 0.
        offsets: whether constant offsets of the channels are unknown, too.

    Returns:
        An Information.

    Raises:
        ValueError: if an argument is wrong, or JAX cannot trace `build`.
    """
    checks.float64_mode()
    values = read_parameters("at", at)
    own = arguments_of_build(values, channels, gains)
    scene = build_scene("at", build, own)
    control = default_control(scene) if control is None else control
    measurement = measurement_of(control, scene, sigma, channels, values, gains, offsets)
    check_traceable(build, own)
    return information_at(build, {}, measurement, logs_of(build, {}, measurement))


def arguments_of_build(values: Mapping[str, float], channels: Any, gains: Any) -> dict[str, float]:
    """The parameters of `build`: those that are neither arguments of the channels' function nor gains."""
    further = arguments_of(channels) if callable(channels) else ()
    of_gains = gains is not False
    return {n: v for n, v in values.items() if n not in further and not (of_gains and n.startswith("gain_"))}


def logs_of(build: Callable, point: Mapping[str, float], measurement: "Experiment") -> np.ndarray:
    """Which parameters are described by relative changes, in the order of `measurement.at`."""
    own = {name: measurement.at[name] for name in measurement.unknowns.build}
    log = dict(zip(own, transforms_of(build, {**own, **point}).log, strict=False))
    return np.array([log.get(name, False) for name in measurement.at])


class Experiment(NamedTuple):
    """What is measured, with its noise, and what is unknown."""

    unknowns: Unknowns
    at: dict[str, float]  # the unknowns, in the order of the result
    noise: Observations  # of zero in the measured channels


def measurement_of(
    control: Control,
    scene: AbstractScene,
    sigma: Any,
    channels: Any,
    values: Mapping[str, float],
    gains: Any,
    offsets: bool,
) -> Experiment:
    """Read what is measured from the arguments of `information`.

    Raises:
        ValueError: if an argument is wrong.
    """
    checks.vector("control", control)
    checks.instance("offsets", offsets, bool, "True or False")
    signals, _ = channels_from(channels, scene, values) if callable(channels) else (reactions_of(scene), {})
    whiskers = 1 if callable(channels) else len(scene.whiskers)
    scale = gains_from(gains, signals, whiskers)
    names = scale.names if callable(channels) or channels is None else channels
    if not names:
        raise ValueError(f"`channels` must name at least one of {', '.join(scale.names)}, got an empty sequence.")
    for name in names:
        matched = channel_pattern(scale.names).fullmatch(name)
        if matched is None or not 1 <= int(matched[2] or 1) <= whiskers:
            raise ValueError(f"`channels` must be among {', '.join(scale.names)}, got {name!r}.")
    control = np.asarray(control, dtype=float)
    zero = np.zeros((control.size, whiskers))
    table = {name: zero if name in scale.names and whiskers > 1 else zero[:, 0] for name in names}
    noise = read_observations({"control": control} | table, sigma, whiskers=whiskers, kinds=scale.names)
    present = [(channel.whisker, channel.kind) for channel in noise.channels]
    own = tuple(arguments_of_build(values, channels, gains))
    scale, moved = scale.of_measured(present), present if offsets else ()
    unknowns = unknowns_of(own, signals, moved, scale, False, (), 1)
    diagonal = [float(scale.names[channel] == scale.signals[signal]) for _, channel, signal in scale.unknown]
    further = [0.0] * len(moved) + diagonal
    default = dict(zip(unknowns.all_names[len(unknowns.names) :], further, strict=True))
    if unused := set(values) - set(unknowns.all_names):
        allowed = f"unknowns ({', '.join(unknowns.all_names)})"
        raise ValueError(f"`at` must name {allowed}, got {', '.join(sorted(unused))}.")
    return Experiment(unknowns, {**values, **{n: v for n, v in default.items() if n not in values}}, noise)


def information_at(
    build: Callable, chosen: Mapping[str, float], measurement: Experiment, log: np.ndarray
) -> Information:
    """The information about some parameters, for chosen values of the others."""
    unknowns, at, noise = measurement
    route = route_of(noise.control)
    x = np.array([at[name] for name in unknowns.all_names])
    own, parts = unknowns.scene_values(x.tolist()), split(unknowns, x)
    known = {"channels": unknowns.channels, "values": parts.channels}
    scan = LinearisedScan(build, own, np.asarray(route.stops), route.last, chosen, **known)
    # Derivatives come in the order of the unknowns: by the scene's parameters first.
    order = [unknowns.all_names.index(name) for name in at]
    table, event_slopes = jax.tree.map(np.asarray, (scan.events, scan.event_slopes))
    by_events = unknowns.by_own(event_slopes)[:, order]
    snaps = np.where(np.isin(table.kind, SNAPS), table.travel, np.nan)
    # The last step before a snap is left out, as in a fit: slopes grow without bound there.
    before = (route.travel[:-1, None] <= snaps) & (route.travel[1:, None] > snaps)
    gaps = np.sum(np.where(before, np.diff(route.travel)[:, None], 0.0), axis=0)
    signals = scan.signals(noise.control, np.asarray(route.travel))
    values, by_own = unknowns.measured(x, signals.values, signals.slopes)
    lost = np.isnan(values) | np.append(before.any(axis=1), False)[:, None, None]
    rates = np.where(lost[..., None], 0.0, by_own[..., order])
    whitened = np.nan_to_num(rates / noise.sigma[..., None])
    events = tuple(
        EventInformation(
            kind=EventKind(int(table.kind[k])),
            whiskers=tuple(int(w) + 1 for w in np.flatnonzero(table.whiskers[k])),
            control=float(table.control[k]),
            by_parameter=np.nan_to_num(by_events[k]),
            sigma=float(UNIFORM * gaps[k]) if gaps[k] > 0 else np.inf,
        )
        for k in np.flatnonzero(table.kind >= 0)
    )
    return Information(
        names=tuple(at),
        at=dict(at),
        control=noise.control,
        channels=tuple(noise.names),
        rates=np.stack([whitened[:, c.whisker, c.kind] for c in noise.channels], axis=1),
        events=events,
        log=log,
        scene=build_scene("at", build, {**own, **chosen}),
    )
