"""What a reconstruction asks of whiskers, in the plane and in space.

`reconstruct.py` does everything else: statuses, units, batches, noise, and the uncertainty of parameters. `plane.py`
and `space.py` hold the two mechanics. They have no state: programs take these classes as static arguments.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._inverse.observations import Observations
from jaxwhisker._inverse.points import AbstractReconstruction
from jaxwhisker._model.scene import Units
from jaxwhisker._scan.blocks import BLOCK

# Trees that only the mechanics look into: whiskers with their support and drive, and the placement of the drive.
AnySensor: TypeAlias = Any
AnyDrive: TypeAlias = Any


class Readings(NamedTuple):
    """The signals of all steps and their noise, in the units of the sensor; NaN where a signal is missing."""

    control: Float[Any, " steps"]
    signals: Float[Any, "steps whiskers channels"]
    # Standard deviations, or roots of covariances of the channels, (steps, whiskers, channels, channels). None: exact.
    noise: Any
    poses: Float[Array, "steps whiskers 3"] | None = None  # measured x, y and angle of the bases
    slips: Float[Array, "steps whiskers"] | None = None  # directions of slip; None without friction, and in space

    @classmethod
    def of(cls, observed: Observations) -> "Readings":
        """Readings from observations, which are exact if no noise is known."""
        unknown = np.isnan(observed.sigma)
        noise = None if unknown.all() else np.where(unknown, 1.0, observed.sigma)
        return cls(observed.control, observed.values, noise)

    @classmethod
    def traced(cls, measured: Mapping, sigma: Any, kinds: tuple[str, ...], whiskers: int) -> "Readings":
        """Readings within jit and vmap, where signals without `sigma` are exact."""
        control = jnp.asarray(measured["control"], dtype=float)
        shape = control.shape[0], whiskers
        values = jnp.stack([jnp.reshape(jnp.asarray(measured[c], dtype=float), shape) for c in kinds], axis=-1)
        if sigma is None:
            return cls(control, values, None)
        each = sigma if isinstance(sigma, Mapping) else dict.fromkeys(kinds, sigma)
        noise = [jnp.broadcast_to(jnp.asarray(each[c], dtype=float), shape) for c in kinds]
        return cls(control, values, jnp.stack(noise, axis=-1))

    def with_roots(self) -> "Readings":
        """The readings with roots of covariances in place of standard deviations."""
        given = self.noise is None or self.noise.ndim > self.signals.ndim
        return self if given else self._replace(noise=root_of(self.noise))


class Judgement(NamedTuple):
    """How signals are judged, which depends on whether they are exact."""

    free: Any  # chi-squared of signals below which there may be no contact
    handicap: Any  # of a phase with a parameter more: see Observation
    known: Any  # 1, or NaN if errors are unknown
    # Chi-squared with one and with three degrees of freedom, above which contacts do not explain signals; None if
    # whiskers have one contact at most.
    explained: Any = None


class StepSignals(NamedTuple):
    """The signals of one step, dimensionless, sorted by what they show; every field (whiskers, ...)."""

    missing: Bool[Array, " whiskers"]
    touching: Bool[Array, " whiskers"]
    measured: Float[Array, "whiskers channels"]  # 0 where missing; below the noise, they still move other bases
    noise: Array  # as in Readings
    reaction: Float[Array, "whiskers channels"]  # those that are fitted: some bent whisker's without a contact
    weight: Array  # inverse of the noise; 1 without a contact
    pose: Float[Array, "whiskers 3"] | None  # of bases, if measured; the drive's where missing
    lean: Float[Array, " whiskers"] | None  # of contact forces; None without friction, and in space


class Contacts(NamedTuple):
    """The contacts of all whiskers at one step in the scene, dimensionless; every array (whiskers, ...).

    Fields of contacts have an axis more, (whiskers, contacts), if a whisker may have several.
    """

    contact: dict[str, Array]  # fields of the result that are known where there is a contact
    base: dict[str, Array]  # those that are known where no signal is missing
    tip: Bool[Any, "whiskers *contacts"]
    ok: Bool[Array, " whiskers"]  # whether there is a contact and its state is solved
    chi2: Float[Array, " whiskers"]
    covariance: Float[Array, "whiskers *contacts numbers numbers"]  # of `InverseMechanics.numbers`
    used: Bool[Array, "whiskers contacts"] | None = None  # places of contacts; None: one, which is used


@runtime_checkable
class AnyInstrument(Protocol):
    """A dimensionless sensor."""

    @property
    def flexibility(self) -> Float[Array, "whiskers k whiskers k"] | None:
        """Displacements of bases per load on every whisker; None if no load moves the base of another whisker."""
        ...

    def peaks(self, largest: Float[Array, "whiskers channels"]) -> Array:
        """Sizes of exact signals, from the largest value of each channel; broadcast to (whiskers, channels)."""
        ...

    def unloaded(self, drive: AnyDrive) -> Float[Array, "whiskers channels"] | None:
        """Reactions of whiskers without a contact; None if they vanish."""
        ...

    def bent(self, drive: AnyDrive) -> Float[Any, "*whiskers channels"]:
        """Reactions of bent whiskers, which replace those of whiskers without a contact.

        Every derivative must be finite.
        """
        ...

    def contacts(self, drive: AnyDrive, signals: StepSignals, judgement: Judgement) -> Contacts:
        """The contacts of all whiskers at one step."""
        ...


class InverseMechanics(abc.ABC):
    """Whiskers in the plane, or in space. There are no instances."""

    result: ClassVar[type[AbstractReconstruction]]
    numbers: ClassVar[tuple[str, ...]]  # the fields of the result whose covariance is estimated
    correlated: ClassVar[bool]  # whether the noise of channels may be correlated
    shared: ClassVar[bool]  # whether one program locates the contacts of all sensors
    several: ClassVar[bool] = False  # whether whiskers may have several contacts
    block: ClassVar[int] = BLOCK  # recordings are padded to multiples of it, so that similar ones share a program

    @staticmethod
    @abc.abstractmethod
    def sensor(made: Any) -> AnySensor:
        """The sensor of a scene. A ValueError says which scenes have none."""

    @classmethod
    @abc.abstractmethod
    def read(
        cls, measured: Any, sigma: Any, sensor: AnySensor, base: Any, slip: Any
    ) -> tuple[tuple[str, ...], Readings]:
        """Names of the channels, and the readings. A ValueError says why they do not determine the contacts."""

    @staticmethod
    @abc.abstractmethod
    def parts(sensor: AnySensor) -> tuple[AnySensor, ...]:
        """Sensors whose contacts are located separately: one per whisker, or the sensor itself."""

    @staticmethod
    @abc.abstractmethod
    def dimensionless(
        sensor: AnySensor, unit: Units, kinds: tuple[str, ...], readings: Readings
    ) -> tuple[AnyInstrument, AnyDrive, Array | None, Array | None]:
        """The sensor, and placements of its drive, poses of bases and leans of contact forces at all steps."""

    @staticmethod
    def batches(located: Callable, steps: Any) -> Any:
        """A function of a batch of steps, for all steps."""
        return located(*steps)


def whitened(weight: Array, values: Float[Array, "whiskers channels"]) -> Float[Array, "whiskers channels"]:
    """Values in units of their noise."""
    return weight * values if weight.ndim == values.ndim else jnp.sum(weight * values[:, None, :], axis=-1)


def root_of(deviation: Any) -> Any:
    """Root of the covariance of channels whose noise is independent."""
    return deviation[..., None] * np.eye(deviation.shape[-1])
