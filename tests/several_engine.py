"""Stored exact states as the unknowns of the engine; all of one problem shape: a clamped whisker below a graph."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import several_laws as laws
from jaxwhisker._base import checks
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._scan.chain import problem_now
from several_cases import CASES, scene_of

STORED = 1e-8  # residuals of stored states, which have nine decimals


class Known(NamedTuple):
    """A state as unknowns."""

    u: jax.Array
    z: jax.Array
    state: ChainState


@cache
def problem(name: str = "wavy") -> ChainProblem:
    """The problem of a case."""
    return problem_now(jax.tree.map(checks.as_float, scene_of(CASES[name])))


def held(case: dict, control: float, reactions: tuple[float, float, float], contacts: list) -> laws.Held:
    """A stored state of the only whisker of a case, with contacts from its base to its tip."""
    wave = laws.wave(**{name: value for name, value in case["objects"][0].items() if name != "kind"})
    rows = []
    for _, _, _, force, arc, x, y in contacts:
        normal = wave(np.array(x), np.array(y)).normal
        phase = Phase.tip if arc == 1.0 else Phase.tangential
        rows.append(laws.Contact(int(phase), force, arc, x, y, float(np.arctan2(normal[0], -normal[1])), 0))
    return laws.Held(control, 0.0, 0.0, *reactions, tuple(rows), ())


def known(state: laws.Held) -> Known:
    """A state as unknowns, which are those of the contacts from the tip to the base."""
    rows = [(c.force, c.x, 1 - c.arc) for c in state.contacts[::-1]]
    phase = [c.phase for c in state.contacts[::-1]]
    z, empty = np.zeros((2, 3)), 2 - len(rows)
    z[: len(rows)] = np.reshape(rows, (-1, 3))
    if phase and phase[0] == Phase.tip:
        at_tip = laws.line_of(laws.Rod(), state, np.zeros(0))[1][-1]
        z[0, 2] = state.contacts[-1].slope - at_tip[2]
    # These whiskers run along the tangents of their object.
    states = ChainState(jnp.array(phase + [0] * empty), jnp.ones(2), jnp.zeros(2, int))
    return Known(jnp.asarray(state.x), jnp.asarray(z), states)


def reactions_at(values: dict, k: int | None = None) -> tuple[float, float, float]:
    """The reactions of the only whisker at a step of a case, or in the state of an event."""
    fx, fy, mz = ((values[name] if k is None else values[name][k])[0] for name in ("fx", "fy", "mz"))
    return fx, fy, mz


def of_event(event: dict, contacts: list | None = None) -> Known:
    """The state before an event of `wavy`."""
    before = event["before"]
    contacts = before["contacts"] if contacts is None else contacts
    return known(held(CASES["wavy"], event["control"], reactions_at(before), contacts))


def with_contacts(count: int, name: str = "wavy") -> Known:
    """The first stored state with this many contacts on the shaft."""
    case = CASES[name]
    for k, (control, contacts) in enumerate(zip(case["control"], case["contacts"], strict=True)):
        if len(contacts) == count and all(contact[2] == Phase.tangential for contact in contacts):
            return known(held(case, control, reactions_at(case, k), contacts))
    raise ValueError(f"no state with {count} contacts")
