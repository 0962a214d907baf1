"""What figures and films need of a run: a scan, drawn over the control, or a simulation, drawn over time."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxwhisker._base import checks
from jaxwhisker._dynamics.simulation import Simulation
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.assembly import AbstractScene
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.quantities import (
    DRAWN,
    DRAWN_IN_SPACE,
    MOTION,
    REACTIONS,
    REACTIONS_IN_SPACE,
    is_of_contacts,
)
from jaxwhisker._scan.result import AbstractResult, Event, Result, SpaceResult, check_not_batched
from jaxwhisker._scan.shapes import Shapes
from jaxwhisker._scan.state import State, state_of

PlaneRun = Result | Simulation
Run = PlaneRun | SpaceResult


def check_one_run(result: Any) -> Run:
    """Check that `result` is the result of a single scan or a single simulation, and return it.

    Raises:
        ValueError: if it is not, or if it is a batch.
    """
    checks.instance("result", result, (AbstractResult, Simulation), "the Result of a scan")
    single = "a single simulation" if isinstance(result, Simulation) else "the result of a single scan"
    check_not_batched(result, single)
    return result


def abscissa(*runs: Run) -> str:
    """Name of the quantity on the horizontal axis: "time" if all are simulations, else "control"."""
    return "time" if all(isinstance(run, Simulation) for run in runs) else "control"


def places(run: Run, over: str) -> Float[np.ndarray, " steps"]:
    """Control or time at all steps; times are known even where a simulation has failed."""
    values = np.asarray(getattr(run, over), dtype=float)
    if over == "time" and values.size > 1 and np.isfinite(values[1]):
        return values[0] + (values[1] - values[0]) * np.arange(values.size)
    return values


def values_of(run: Run, quantity: str) -> np.ndarray:
    """Values (steps, whiskers or springs) of a quantity that can be drawn, or (steps, contacts of all whiskers)."""
    if quantity != "spring_extension":
        values = np.asarray(getattr(run, quantity))
        return values if values.ndim < 3 else _values_of_contacts(run, quantity)
    # The sign of an axial spring's rest length only says on which side it is.
    rest = [abs(s.rest_length) if s.axis == "axial" else s.rest_length for s in run.scene.support.springs]
    return np.asarray(run.spring_length) - np.asarray(rest, dtype=float)


def _values_of_contacts(run: Run, quantity: str) -> np.ndarray:
    """Values (steps, contacts of all whiskers) of a quantity of several contacts; where there is none, only a force."""
    values = np.asarray(getattr(run, quantity), dtype=float)
    if quantity != "contact_force":
        values = np.where(np.asarray(run.phase) == Phase.free, np.nan, values)
    return values.reshape(values.shape[0], -1)


def contacts_of(run: Run, quantity: str) -> int:
    """Number of contacts that each whisker may have, for a quantity of contacts; 1 for others."""
    return run.phase.shape[2] if is_of_contacts(quantity) and has_several(run) else 1


def reactions_of(run: Run) -> tuple[str, ...]:
    """Names of the support reactions of a run: three in the plane, six in space."""
    return REACTIONS_IN_SPACE if isinstance(run, SpaceResult) else REACTIONS


def check_quantity(quantity: Any, *runs: Run, scene: AbstractScene | None = None) -> None:
    """Check that a quantity of these runs, or of a scene, can be drawn over the control or time."""
    spaces = [isinstance(run, SpaceResult) for run in runs] if scene is None else [scene.in_space]
    kinds = [DRAWN_IN_SPACE if in_space else DRAWN for in_space in spaces] or [DRAWN]
    allowed = tuple(name for name in kinds[0] if all(name in kind for kind in kinds))
    if runs and abscissa(*runs) == "time":
        allowed = (*DRAWN, *(name for name in MOTION if name != "time"))
    allowed = [name for name in allowed if all(getattr(run, name, ...) is not None for run in runs)]
    if quantity not in allowed:
        checks.fail("quantity", f"one of {', '.join(allowed)}", repr(quantity))


def events_of(run: Run) -> list[Event]:
    """The events of a run; those of a simulation with the samples before and after them."""
    if not isinstance(run, Simulation):
        return list(run.events)
    states, last = jax.tree.map(np.asarray, state_of(run)), np.size(run.time) - 1
    events = []
    for event in run.events:
        after = int(np.clip(np.searchsorted(places(run, "time"), event.time), min(1, last), last))
        ends = (jax.tree.map(lambda leaf, k=k: leaf[k], states) for k in (max(after - 1, 0), after))
        events.append(Event(event.kind, (event.whisker,), event.control, *ends))
    return events


def places_of_events(run: Run, over: str) -> Float[np.ndarray, " events"]:
    """Control or time of each event."""
    return np.asarray(getattr(run.events, over), dtype=float)[: len(run.events)]


def progress(run: Run) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " events"]]:
    """A quantity that never decreases, at all steps and at all events: the travel of the drive, or time."""
    if isinstance(run, Simulation):
        return places(run, "time"), places_of_events(run, "time")
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.asarray(run.control))))])
    return travel, places_of_events(run, "travel")


def states_at(run: PlaneRun, steps: int | Int[np.ndarray, " steps"]) -> State:
    """States at steps of a scan or samples of a simulation."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[steps], state_of(run))


def lines_of_motion(motion: Simulation, samples: Sequence[int] | Int[np.ndarray, " samples"], *, points: int) -> Shapes:
    """Centre lines (samples, whiskers, points) of a simulation, which follow from its shape functions."""
    index = np.asarray(samples, dtype=int)
    fields = {
        name: getattr(motion, name) for name in Simulation.__dataclass_fields__ if name not in ("events", "scene")
    }
    sampled = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), fields)
    return jax.tree.map(np.asarray, Simulation(**sampled, events=motion.events, scene=motion.scene).shapes(points))
