"""The state of a march: where it is, what it is doing, and the step that it tries."""

import dataclasses
from enum import IntEnum
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.point import Point
from jaxwhisker._equilibrium.stance import PerWhisker
from jaxwhisker._path.path import NO_EVENT, Node, Status


class Task(IntEnum):
    """Task of an iteration of the march (see march.py)."""

    advance = 0
    event = 1
    arrive = 2
    done = 3
    flow = 4
    kick = 5


class Target(NamedTuple):
    """An event to be solved for: the margin that vanishes, the whiskers concerned, and the expected distance."""

    number: Int[Array, ""]  # of the kind of event
    whiskers: Bool[Array, " whiskers"]  # one-hot; all False for a stop
    distance: Scalar  # along the tangent
    first: Any  # contacts of whiskers that may touch; `contact` and `phase` are two of its fields
    limit: PerWhisker | None = None  # lean or parameter at which it happens; None without friction and edges


Own = TypeVar("Own", bound="MarchState")


class MarchState(eqx.Module):
    """State of the march between two iterations; each mechanics adds what it alone knows."""

    task: Int[Array, ""]
    state: Any  # of the contacts, `phase` among them
    point: Point
    tangent: Point
    bend: Point  # change of the tangent per arc length
    step: Scalar  # length of the next step
    stance: Any  # at this point; None where it is known without computing anything
    unstable_at: Scalar  # distance ahead of a known unstable equilibrium, or infinity
    target: Target
    goal: Int[Array, ""]  # index of the stop that the drive moves to
    direction: Scalar  # +1 while the drive moves towards larger u, else -1
    travel: Scalar  # distance that the drive has travelled since the first stop; negative on the approach to it
    pending: Node  # node to be written on arrival
    flow: Any  # what follows from a loss of stability
    count: Int[Array, ""]
    status: Int[Array, ""]

    def replace(self: Own, **changes: Any) -> Own:
        """The state with other values of these fields."""
        return dataclasses.replace(self, **changes)

    def drive_rate(self, tangent: Point) -> Scalar:
        """du/ds along a tangent, positive while the drive moves towards its stop."""
        return self.direction * tangent.u

    def node(self, point: Point, tangent: Point, **remembered: Any) -> Node:
        """A plain node: the path continues as it arrives. Contacts with friction remember more."""
        travel, nobody = self.travel + jnp.abs(point.u - self.point.u), jnp.zeros_like(self.state.phase, bool)
        kind, state = jnp.asarray(NO_EVENT), self.state
        return Node(point, point.z, tangent, tangent, state, state, travel, kind, nobody, **remembered)

    def stopped(self: Own, status: Status | Int[Array, ""]) -> Own:
        """The state after the march has ended with this status."""
        return self.replace(
            task=jnp.asarray(int(Task.done)), status=jnp.asarray(int(status) if isinstance(status, Status) else status)
        )


@runtime_checkable
class Trial(Protocol):
    """The solved end of a step, and what the march asks about it; each mechanics adds what it alone asks."""

    @property
    def point(self) -> Point:
        """The end of the step."""
        ...

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it is solved for."""
        ...

    @property
    def tangent(self) -> Point:
        """The direction of the path there."""
        ...

    @property
    def guess(self) -> Point:
        """Where it was predicted."""
        ...

    @property
    def stable(self) -> Bool[Array, ""]:
        """Whether the equilibrium is stable."""
        ...

    @property
    def stance(self) -> Any:
        """Where bases or free whiskers stand."""
        ...


Cases: TypeAlias = list[tuple[Any, Any]]  # a condition, and the state if it is the first that holds
Outcome: TypeAlias = tuple[Any, Bool[Array, ""], Node]  # the next state, whether to write a node, and that node
