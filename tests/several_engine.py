"""Stored exact states as the unknowns of the engine; all of one problem shape: a clamped whisker below a graph."""

# pyright: reportArgumentType=false

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import several_laws as laws
from jaxwhisker._base import checks
from jaxwhisker._chain.contacts import ChainState
from jaxwhisker._chain.continuation import ContinuationOfChain
from jaxwhisker._chain.gaps import Candidate
from jaxwhisker._chain.march_state import MarchOfChain, TrialOfChain
from jaxwhisker._chain.newton import ChainSolution, newton_step
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.stance import stance_of
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import Point, at_control, unit
from jaxwhisker._path.continuation import Limits
from jaxwhisker._scan.chain import problem_now
from several_cases import CASES, scene_of

STOP = -2.0  # the control that marches move to
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


def march_at(known: Known) -> MarchOfChain:
    """A march that has come to a state of `wavy`, on its way to smaller controls."""
    u, z, state = known
    march = ContinuationOfChain(problem()).start(jnp.reshape(u, 1), Limits(u, u, u))
    tangent, stance = _around(problem(), u, z, state)
    return march.replace(point=Point(z, u), state=state, tangent=tangent, stance=stance)


@jax.jit
def _around(problem, u, z, state):
    tangent, _ = unit(newton_step(problem, state, at_control(u, z), Point(z, u)).tangent, z)
    tangent = jax.tree.map(lambda leaf: -leaf, tangent)  # the control decreases
    return tangent, stance_of(problem, u, problem.rest, z, state)[0]


def candidates(phase: Phase, slack: float) -> Candidate:
    """Three candidates of the only whisker, of which the second one is of interest."""
    numbers = jnp.array([[0.0, 9.0, 9.0], [0.0, 0.3, slack], [0.0, 9.0, 9.0]])
    kinds, sides = jnp.full(3, int(phase)), jnp.array([1.0, -1.0, 1.0])
    return jax.tree.map(lambda leaf: leaf[None], Candidate(jnp.ones(3), numbers, kinds, sides, jnp.zeros(3, int)))


def trial_at(march, z, state=None, phase=Phase.tangential, slack=0.2) -> TrialOfChain:
    """The end of a step in these contacts."""
    solution = ChainSolution(Point(z, march.point.u), None, jnp.asarray(True))
    state, own = march.state if state is None else state, candidates(phase, slack)
    stop, last, stable = jnp.asarray(STOP), jnp.asarray(0), jnp.asarray(True)
    turns = jnp.ones(1)
    return TrialOfChain(solution, march.tangent, march.stance, own, march.point, state, stop, last, stable, turns)
