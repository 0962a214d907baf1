"""Fisher information: what a scene's signals know about its parameters, by channel, along the scan and by event."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._base.jit import COMPILER_OPTIONS
from jaxwhisker._base.types import Control
from jaxwhisker._inverse.identifiability import identifiability
from jaxwhisker._inverse.measured import CHANNELS, measured_of
from jaxwhisker._inverse.misfit import BETWEEN
from jaxwhisker._inverse.transforms import checked_scene, checked_values, transforms_of
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import EventKind
from jaxwhisker._scan.report import table
from jaxwhisker._scan.route import route_of
from jaxwhisker._scan.scan import TracedScan, default_control


class Rates(NamedTuple):
    """Signals and events of a scan with their derivatives by relative changes of parameters, or by their scales."""

    signals: Any  # (steps, whiskers, 3)
    by_parameter: Any  # (steps, whiskers, 3, parameters); NaN where a step failed
    kind: Any  # (events,) -1 beyond their number
    whiskers: Any  # (events, whiskers)
    control: Any  # (events,)
    control_by_parameter: Any  # (events, parameters)
    gap: Any  # (events,) between the steps before and behind an event


class EventInformation(NamedTuple):
    """What the position of one event tells."""

    kind: EventKind
    whiskers: tuple[int, ...]  # numbered from 1
    control: float
    by_parameter: np.ndarray  # (parameters,) d control / d parameter
    sigma: float  # standard error with which signals that jump there tell the control; infinite where they do not


@dataclass(frozen=True, eq=False, repr=False)
class Information:
    """The Fisher information of signals with Gaussian noise, J^T J with J the derivatives over the noise.

    Signals jump at a snap, which is thereby known to lie anywhere between two steps, h apart: it counts as a value with
    standard error h / sqrt(12). Parameters are counted in their own units. The inverse bounds the covariance of every
    unbiased estimate (Cramer and Rao); what is not told has no standard error.
    """

    names: tuple[str, ...]
    at: dict[str, float]
    control: np.ndarray  # (steps,)
    channels: tuple[str, ...]  # fx, fy, mz, or fx_1, fx_2, ... of several whiskers
    rates: np.ndarray  # (steps, channels, parameters) whitened derivatives; 0 where a step failed
    events: tuple[EventInformation, ...]
    log: np.ndarray  # (parameters,) whether changes of a parameter are counted as relative ones in words

    def of(self, *channels: str) -> "Information":
        """What some of the channels tell: `of("mz_1", "mz_2")`, or all whiskers' `of("mz")`.

        Raises:
            ValueError: if there is no such channel.
        """
        for name in channels:
            if name not in self.channels and name not in CHANNELS:
                raise ValueError(f"`channels` must be among {', '.join(self.channels)}, but one is {name!r}.")
        keep = [k for k, c in enumerate(self.channels) if c in channels or c.split("_")[0] in channels]
        return replace(self, channels=tuple(self.channels[k] for k in keep), rates=self.rates[:, keep])

    def known(self, *names: str) -> "Information":
        """What the signals tell of the other parameters, if these are known.

        Raises:
            ValueError: if there is no such parameter, or nothing is left.
        """
        for name in names:
            if name not in self.names:
                raise ValueError(f"`names` must be among {', '.join(self.names)}, but one is {name!r}.")
        keep = [k for k, n in enumerate(self.names) if n not in names]
        if not keep:
            raise ValueError("`names` must leave one parameter at least, but are all of them.")
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
        """The share of each channel in the matrix, and of the snaps."""
        snaps = self.jacobian[self.rates.shape[0] * self.rates.shape[1] :]
        return {name: self.rates[:, k].T @ self.rates[:, k] for k, name in enumerate(self.channels)} | {
            "snaps": snaps.T @ snaps
        }

    @property
    def density(self) -> np.ndarray:
        """What each step tells of each parameter alone, (steps, parameters): the matrix's diagonal along the scan."""
        return np.sum(self.rates**2, axis=1)

    def with_events(self, sigma: float) -> "Information":
        """What is told if the positions of all events are known, each with that standard error (a length).

        Raises:
            ValueError: if it is no positive number.
        """
        checks.number("sigma", sigma, positive=True)
        return replace(self, events=tuple(e._replace(sigma=min(float(sigma), e.sigma)) for e in self.events))

    @property
    def _scale(self) -> np.ndarray:
        values = np.abs(np.array(list(self.at.values())))
        return np.where(values > 0, values, 1.0)

    @property
    def _judged(self):
        return identifiability(self.jacobian * self._scale, self.names, self.log, self._scale)

    @property
    def covariance(self) -> np.ndarray:
        """The bound of Cramer and Rao, (parameters, parameters); NaN for what is not told."""
        return self._judged.covariance * np.outer(self._scale, self._scale)

    @property
    def standard_error(self) -> dict[str, float]:
        """The least standard error of each parameter, all sought together; NaN for what is not told."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> np.ndarray:
        """Of estimates."""
        errors = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(errors, errors)

    @property
    def combinations(self) -> tuple[str, ...]:
        """Combinations of parameters that the signals do not tell, in words."""
        return self._judged.combinations

    @property
    def rank(self) -> int:
        """How many combinations are told."""
        return self._judged.rank

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest singular value of J by relative changes."""
        return self._judged.condition

    def __str__(self) -> str:
        errors = self.standard_error
        rows = [
            [name, f"{self.at[name]:.6g}", "-" if np.isnan(e) else f"{e:.3g}", "-" if np.isnan(e) else self._best(k)]
            for k, (name, e) in enumerate(errors.items())
        ]
        lines = [table(["parameter", "value", "standard error", "told most by"], rows)]
        lines += [f"not told: {words}." for words in self.combinations]
        lines.append(f"rank {self.rank} of {len(self.names)}, condition {self.condition:.2g}")
        return "\n".join(lines)

    __repr__ = __str__

    def _best(self, parameter: int) -> str:
        share = {name: matrix[parameter, parameter] for name, matrix in self.by_channel.items()}
        name = max(share, key=lambda n: share[n])
        return f"{name} ({share[name] / max(sum(share.values()), 1e-300):.0%})"


def information(
    build: Callable[..., Scene],
    at: Mapping[str, float],
    *,
    sigma: Any,
    control: Control | None = None,
    channels: Sequence[str] = CHANNELS,
) -> Information:
    """The Fisher information of a scene's signals about its parameters, by exact derivatives.

    Args:
        build: makes a Scene from numbers given by name.
        at: the parameters that one wants to know, with their values.
        sigma: standard deviation of the signals' noise, independent from step to step: a number, or a mapping from
            channels to numbers.
        control: drive positions, (steps,). Default: that of a scan. Twice as many steps tell twice as much.
        channels: those that are measured.

    Raises:
        ValueError: if an argument is wrong.
    """
    checks.float64_mode()
    values = checked_values("at", at)
    scene = checked_scene("at", build, values)
    if control is None:
        control = default_control(scene)
    checks.vector("control", control)
    control = np.asarray(control, dtype=float)
    noise = noise_by_channel(len(scene.whiskers), control.size, sigma, channels)
    transforms = transforms_of(build, values, {}, {})
    found = _kernel(build, tuple(values))(values, control)
    return of_rates(found, values, control, noise, np.array([t.log for t in transforms.values()]))


class Noise(NamedTuple):
    """Of one channel of one whisker."""

    whisker: int
    channel: int
    sigma: np.ndarray  # (steps,)


def noise_by_channel(whiskers: int, steps: int, sigma: Any, channels: Sequence[str]) -> dict[str, Noise]:
    """The channels that are measured, by name, checked before anything is compiled."""
    if not channels:
        raise ValueError(f"`channels` must name at least one of {', '.join(CHANNELS)}, but is empty.")
    for name in channels:
        if name not in CHANNELS and not any(name == f"{c}_{k + 1}" for c in CHANNELS for k in range(whiskers)):
            raise ValueError(f"`channels` must be among {', '.join(CHANNELS)}, but one is {name!r}.")
    named = [(k, c, CHANNELS[c] + (f"_{k + 1}" if whiskers > 1 else "")) for k in range(whiskers) for c in range(3)]
    wanted = [(k, c, name) for k, c, name in named if name in channels or CHANNELS[c] in channels]
    some = np.zeros(steps)
    found = measured_of({"control": some} | {name: some for *_, name in wanted}, sigma, whiskers=whiskers).sigma
    return {name: Noise(k, c, found[:, k, c]) for k, c, name in wanted}


def of_rates(
    found: Rates, at: dict[str, float], control: np.ndarray, noise: dict[str, Noise], log: np.ndarray
) -> Information:
    """Information from derivatives."""
    whitened = [found.by_parameter[:, n.whisker, n.channel] / n.sigma[:, None] for n in noise.values()]
    rates = np.stack(whitened, axis=1)
    events = tuple(
        EventInformation(
            EventKind(int(kind)),
            tuple(int(k) + 1 for k in np.flatnonzero(who)),
            float(u),
            np.nan_to_num(by),
            float(BETWEEN * gap) if kind >= EventKind.snap_through and gap > 0 else np.inf,
        )
        for kind, who, u, by, gap in zip(
            found.kind, found.whiskers, found.control, found.control_by_parameter, found.gap, strict=True
        )
        if kind >= 0
    )
    return Information(tuple(at), dict(at), control, tuple(noise), np.nan_to_num(rates), events, log)


def _kernel(build: Callable[..., Scene], names: tuple[str, ...]) -> Callable[[dict, np.ndarray], Rates]:
    """Signals, events and their derivatives, compiled once for each number of steps."""
    try:
        hash(build)
    except TypeError:  # a module with arrays
        return _compiled(build, names)
    return _kept(build, names)


def _compiled(build: Callable[..., Scene], names: tuple[str, ...]) -> Callable[[dict, np.ndarray], Rates]:
    compiled: dict[tuple, Any] = {}

    def call(values: dict[str, float], control: np.ndarray) -> Rates:
        arguments = (
            jnp.array(list(values.values())),
            jnp.asarray(control),
            *map(jnp.asarray, route_of(np.asarray(control, dtype=float))[2:]),
        )
        sizes = arguments[1].size, arguments[2].size
        if sizes not in compiled:
            compiled[sizes] = jax.jit(rates_of(build, names)).lower(*arguments).compile(COMPILER_OPTIONS)
        return jax.tree.map(np.asarray, compiled[sizes](*arguments))

    return call


_kept = lru_cache(maxsize=32)(_compiled)


def rates_of(build: Callable[..., Scene], names: tuple[str, ...]) -> Callable[..., Rates]:
    """The function of (parameters, control, stops, last) that tells signals and events with their derivatives."""

    def rates(x, control, stops, last):
        def value(x):
            ways = TracedScan(build(**dict(zip(names, x, strict=True))), stops, last)
            signals, ok = ways.signals(control, travel)
            return (signals, ways.events.control), (ok, ways.events)

        travel = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(control)))])
        (signals, where), push, (ok, events) = jax.linearize(value, x, has_aux=True)
        kind, whiskers = events.kind, events.whiskers
        by, where_by = jax.vmap(push, out_axes=-1)(jnp.eye(x.size))
        # The last step before a snap is left out, as a fit does: there signals change without bound.
        snaps = jnp.where(kind >= EventKind.snap_through, events.travel, jnp.nan)
        last = (travel[:-1, None] <= snaps) & (travel[1:, None] > snaps)
        gap = jnp.sum(jnp.where(last, (travel[1:] - travel[:-1])[:, None], 0.0), axis=0)
        ok &= ~jnp.append(jnp.any(last, axis=1), False)
        by = jnp.where(ok[:, None, None, None], by, jnp.nan)
        return Rates(signals, by, kind, whiskers, where, where_by, gap)

    return rates
