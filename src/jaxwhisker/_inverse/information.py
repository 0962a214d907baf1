"""Fisher information: how well signals determine parameters, by channel, along the scan and by event; sensor design."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control
from jaxwhisker._inverse.channels import Channels, channels_from
from jaxwhisker._inverse.least_squares import linearised_scan
from jaxwhisker._inverse.observations import Observations, channel_pattern, read_observations
from jaxwhisker._inverse.parameters import build_scene, check_traceable, read_parameters, transforms_of
from jaxwhisker._inverse.residuals import UNIFORM
from jaxwhisker._inverse.statistics import Identifiability, correlation, identifiability
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._path.path import SNAPS, EventKind
from jaxwhisker._scan.channels import arguments_of
from jaxwhisker._scan.quantities import REACTIONS, REACTIONS_IN_SPACE
from jaxwhisker._scan.report import table
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import default_control

if TYPE_CHECKING:
    import xarray as xr

DESIGN_STEPS = 512  # of the default control of a design


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
) -> Information:
    """Compute the Fisher information of a scene's signals about its parameters, by exact derivatives.

    Args:
        build: makes a Scene, in space without friction, from named numbers. JAX must be able to trace it.
        at: the unknown parameters with their values.
        sigma: standard deviation of the signals' noise, independent from step to step: a number, or a mapping from
            channels to numbers.
        control: drive positions, (steps,). Default: those of `scan`. Information is proportional to the density of
            steps.
        channels: measured channels, such as "mz" (of all whiskers) or "mz_1"; or, in the plane, a function of the
            result, as in `identify`, with its own unknown parameters in `at`. Default: all reactions.

    Returns:
        An Information.

    Raises:
        ValueError: if an argument is wrong, or JAX cannot trace `build`.
    """
    checks.float64_mode()
    values = read_parameters("at", at)
    scene = build_scene("at", build, _for_build(values, channels))
    control = default_control(scene) if control is None else control
    measured, noise = _measured(control, scene, sigma, channels, values)
    check_traceable(build, _for_build(values, channels))
    return _information_at(build, values, {}, measured, noise, _logs(build, values, {}, measured))


@with_own_settings
def design(
    build: Callable[..., AbstractScene],
    at: Mapping[str, float],
    *,
    sigma: Any,
    control: Control | None = None,
    channels: Sequence[str] | Callable[..., Mapping[str, Any]] | None = None,
    **axes: Any,
) -> "xr.Dataset":
    """Compare sensors: how well parameters can be estimated, for all combinations of design choices.

        data = jw.design(build, at=dict(a=1.0), sigma=0.02, stiffness=[20.0, 70.0, 200.0], distance=[0.2, 0.3, 0.4])
        data.relative_error.sel(parameter="a").idxmin("stiffness")

    Args:
        build: makes a Scene from named numbers: unknown parameters and design choices. JAX must be able to trace it.
        at: the unknown parameters, estimated together, with their expected values.
        sigma: standard deviation of the signals' noise, as in `information`.
        control: drive positions, (steps,), the same for all choices. Default: 512 over the range of contact of all.
        channels: measured channels, as in `information`.
        **axes: values of each design choice, one-dimensional.

    Returns:
        A Dataset over the axes: `standard_error` and `relative_error` of each parameter (NaN if it is not
        identifiable), `condition` and `rank` of the information matrix. `attrs["best"]` names the choice with the least
        geometric mean of the relative errors.

    Raises:
        ValueError: if an argument is wrong, or JAX cannot trace `build`.
        ImportError: if xarray is missing: `pip install jaxwhisker[study]`.
    """
    checks.float64_mode()
    values = read_parameters("at", at)
    grids = _grids(axes, values)
    points = [dict(zip(grids, chosen, strict=True)) for chosen in itertools.product(*grids.values())]
    scenes = [build_scene("at` and `axes", build, {**_for_build(values, channels), **point}) for point in points]
    control = _common_control(scenes) if control is None else control
    measured, noise = _measured(control, scenes[0], sigma, channels, values)
    check_traceable(build, {**_for_build(values, channels), **points[0]})
    log = _logs(build, values, points[0], measured)
    each = [_information_at(build, values, point, measured, noise, log) for point in points]
    return _dataset(values, grids, points, each)


def _for_build(values: Mapping[str, float], channels: Any) -> dict[str, float]:
    """The parameters of `build`: those that are not arguments of the channels' function."""
    own = arguments_of(channels) if callable(channels) else ()
    return {name: value for name, value in values.items() if name not in own}


def _logs(build: Callable, values: Mapping[str, float], point: Mapping[str, float], channels: Channels) -> np.ndarray:
    """Which parameters are described by relative changes, in the order of the values."""
    own = {name: value for name, value in values.items() if name not in channels.parameters}
    log = dict(zip(own, transforms_of(build, {**own, **point}).log, strict=False))
    return np.array([log.get(name, False) for name in values])


def _grids(axes: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Values of the design choices."""
    if not axes:
        raise ValueError("`axes` must be at least one parameter of `build` with its values, got none.")
    for name, choices in axes.items():
        checks.vector(name, choices)
        if name in values:
            raise ValueError(f"`{name}` must be in `at` or among the axes, got it in both.")
    return {name: np.asarray(choices, dtype=float) for name, choices in axes.items()}


def _common_control(scenes: Sequence[AbstractScene]) -> np.ndarray:
    """Drive positions over the contact of all scenes."""
    ends = np.array([default_control(scene)[[0, -1]] for scene in scenes])
    onwards = np.sign(ends[0, 1] - ends[0, 0])
    return onwards * np.linspace(np.min(onwards * ends[:, 0]), np.max(onwards * ends[:, 1]), DESIGN_STEPS)


def _dataset(values: Mapping[str, float], grids: Mapping[str, np.ndarray], points, of_points) -> "xr.Dataset":
    import xarray as xr

    size = np.abs(np.array(list(values.values())))
    error = np.array([list(one.standard_error.values()) for one in of_points])
    relative = error / np.where(size > 0, size, 1.0)
    shape, dims = tuple(grid.size for grid in grids.values()), tuple(grids)
    data = xr.Dataset(
        {
            "standard_error": ((*dims, "parameter"), error.reshape(*shape, -1)),
            "relative_error": ((*dims, "parameter"), relative.reshape(*shape, -1)),
            "condition": (dims, np.reshape([one.condition for one in of_points], shape)),
            "rank": (dims, np.reshape([one.rank for one in of_points], shape)),
        },
        {**grids, "parameter": list(values)},
    )
    mean = np.exp(np.mean(np.log(relative), axis=-1))
    if np.isfinite(mean).any():
        best = points[int(np.nanargmin(mean))]
        data.attrs["best"] = ", ".join(f"{name} = {value:g}" for name, value in best.items())
    return data


def _measured(
    control: Control, scene: AbstractScene, sigma: Any, channels: Any, values: Mapping[str, float]
) -> tuple[Channels, Observations]:
    """The channels, and observations of zero in the measured ones, with their noise."""
    checks.vector("control", control)
    if callable(channels):
        measured, _ = channels_from(channels, scene, values)
        control = np.asarray(control, dtype=float)
        table = {"control": control} | dict.fromkeys(measured.names, np.zeros_like(control))
        return measured, read_observations(table, sigma, whiskers=1, kinds=measured.names)
    whiskers, reactions = len(scene.whiskers), REACTIONS_IN_SPACE if scene.in_space else REACTIONS
    channels = reactions if channels is None else channels
    if not channels:
        raise ValueError(f"`channels` must name at least one of {', '.join(reactions)}, got an empty sequence.")
    for name in channels:
        matched = channel_pattern(reactions).fullmatch(name)
        if matched is None or not 1 <= int(matched[2] or 1) <= whiskers:
            raise ValueError(f"`channels` must be among {', '.join(reactions)}, got {name!r}.")
    control = np.asarray(control, dtype=float)
    zero = np.zeros((control.size, whiskers))
    table = {name: zero if name in reactions else zero[:, 0] for name in channels}
    table = {"control": control} | table
    return Channels(reactions), read_observations(table, sigma, whiskers=whiskers, kinds=reactions)


def _information_at(
    build: Callable,
    at: Mapping[str, float],
    chosen: Mapping[str, float],
    channels: Channels,
    noise: Observations,
    log: np.ndarray,
) -> Information:
    """The information about some parameters, for chosen values of the others."""
    route = route_of(noise.control)
    own = {name: value for name, value in at.items() if name not in channels.parameters}
    further = [at[name] for name in channels.parameters]
    stops = np.asarray(route.stops)
    known = {"channels": channels, "values": further}
    scan = linearised_scan(channels.in_space, build, own, stops, route.last, chosen, **known)
    # Derivatives come in the order of the programs: by the scene's parameters first.
    order = [[*own, *channels.parameters].index(name) for name in at]
    table, by_events = jax.tree.map(np.asarray, (scan.events, scan.event_slopes[:, order]))
    snaps = np.where(np.isin(table.kind, SNAPS), table.travel, np.nan)
    # The last step before a snap is left out, as in a fit: slopes grow without bound there.
    before = (route.travel[:-1, None] <= snaps) & (route.travel[1:, None] > snaps)
    gaps = np.sum(np.where(before, np.diff(route.travel)[:, None], 0.0), axis=0)
    signals = scan.signals(noise.control, np.asarray(route.travel))
    lost = np.isnan(signals.values) | np.append(before.any(axis=1), False)[:, None, None]
    rates = np.where(lost[..., None], 0.0, signals.slopes[..., order])
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
