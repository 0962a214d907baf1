"""What a scan asks of whiskers, in the plane and in space.

Everything that a scan does is written once, in terms of these methods: `scan.py` follows the path and assembles the
result, `steps.py` solves for the states at the control positions, `events.py` for those at events, and `slopes.py` has
the rules for their derivatives. `plane.py` and `space.py` hold the two mechanics. They have no state: programs take
these classes as static arguments.
"""

import abc
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._path.march import sweeps_of
from jaxwhisker._path.path import Path, ScanPath, Stops

# Trees that only the mechanics look into: the dimensionless problem, what contacts with friction remember at the nodes
# of a path (None without friction), and how whiskers touch.
AnyProblem: TypeAlias = Any
Memory: TypeAlias = Any
AnyState: TypeAlias = Any


class Solutions(NamedTuple):
    """Equilibria at the steps of a scan, without derivatives. Steps that failed hold free whiskers."""

    z: Float[Array, "*steps whiskers numbers"]
    state: AnyState
    status: Int[Array, "*steps"]
    node: Int[Array, "*steps"]  # of the path, before the step


class EventSides(NamedTuple):
    """Equilibria at events, with derivatives: the control, and the arguments of `signals` before and after them."""

    control: Float[Array, " events"]  # dimensionless
    before: tuple
    after: tuple


class Mechanics(abc.ABC):
    """Whiskers in the plane, or in space. All methods are static, or of the class."""

    most_numbers: ClassVar[int]  # of a problem by which all slopes are computed at once
    block: ClassVar[int]  # number of steps that one program solves for
    result: ClassVar[type]
    events: ClassVar[type]
    follows: ClassVar[Program]  # follows a path

    @staticmethod
    @abc.abstractmethod
    def problem(scene: Any) -> AnyProblem:
        """The dimensionless problem of a scene, by a program."""

    @staticmethod
    @abc.abstractmethod
    def check(scene: Any, problem: AnyProblem) -> None:
        """Raise an error for values of a concrete scene that its constructors do not detect."""

    @classmethod
    def follow(cls, problem: AnyProblem, stops: Any, last: Any) -> ScanPath:
        """The path to all stops, given in the scene's units; right across the object if the first one is NaN."""
        return cls.follows(problem, stops, last, *sweeps_of(last))

    @staticmethod
    @abc.abstractmethod
    def detected(scene: Any, problem: AnyProblem, path: Path) -> Path:
        """The path up to the first contact that is not modelled."""

    @staticmethod
    @abc.abstractmethod
    def prepare(pool: Executor, scene: Any, problem: AnyProblem, stops: int) -> tuple[Path, Memory]:
        """Compile the programs of the path in a pool. Return the shapes of the path and of what contacts remember."""

    @classmethod
    def is_ready(cls, problem: AnyProblem, stops: int) -> bool:
        """Whether the program of the path is compiled, or being compiled."""
        return cls.follows.is_ready(problem, np.zeros(stops), np.asarray(0))

    @classmethod
    @abc.abstractmethod
    def memory(cls, problem: AnyProblem, path: Path, stops: Any) -> Memory:
        """What contacts remember at the nodes of a path, by a program that computes no more than is needed."""

    @staticmethod
    @abc.abstractmethod
    def remember(problem: AnyProblem, path: Path, stops: Stops) -> Memory:
        """What contacts remember at the nodes of a path with friction, with derivatives."""

    @staticmethod
    @abc.abstractmethod
    def remembered(memory: Memory, path: Path | None, solutions: Solutions) -> Any:
        """What the contacts of each step remember: a tree of arrays with a leading axis of steps.

        The path may be None if the memory is.
        """

    @staticmethod
    @abc.abstractmethod
    def solve(
        problem: AnyProblem,
        path: Path,
        index: Int[Array, " steps"],
        u: Float[Array, " steps"],
        known: Int[Array, " steps"],
    ) -> Solutions:
        """Solve for the equilibria at controls after nodes `index`; `known` is the status of the path there."""

    @staticmethod
    @abc.abstractmethod
    def states(
        problem: AnyProblem, u: Float[Array, " steps"], solutions: Solutions, remembered: Any
    ) -> tuple[Any, Float[Array, " steps"], Any]:
        """States in the scene's units with derivatives, largest residuals, and displacements of bases or None."""

    @staticmethod
    @abc.abstractmethod
    def checked(problem: AnyProblem, solutions: Solutions, status: Int[Array, " steps"]) -> Int[Array, " steps"]:
        """The status of steps, also of contacts that are not modelled."""

    @staticmethod
    @abc.abstractmethod
    def lengths(scene: Any, state: Any, displacement: Any, control: Float[Array, " steps"]) -> Any:
        """Lengths of the springs at some steps, by a program; there may be further columns."""

    @staticmethod
    @abc.abstractmethod
    def differences(scene: Any) -> Callable | None:
        """The function from states and control that computes all lengths with NumPy, if they are differences."""

    @staticmethod
    @abc.abstractmethod
    def event_room(whiskers: int) -> int:
        """Number of events that a scan has room for, unless it is known to have more."""

    @staticmethod
    @abc.abstractmethod
    def event_nodes(problem: AnyProblem, path: Path) -> Any:
        """The nodes of a path, with all events that happen there."""

    @staticmethod
    @abc.abstractmethod
    def at_events(
        problem: AnyProblem, path: Path, memory: Memory, at: Int[Array, " events"], filled: Bool[Array, " events"]
    ) -> EventSides:
        """Equilibria at the events of these nodes; safe placeholders where there is none."""

    @staticmethod
    @abc.abstractmethod
    def event_controls(
        problem: AnyProblem, path: Path, memory: Memory, at: Int[Array, " events"], filled: Bool[Array, " events"]
    ) -> tuple[Float[Array, " events"], Bool[Array, "events whiskers"]]:
        """Dimensionless controls of events, with derivatives, and whose contacts end there."""

    @staticmethod
    @abc.abstractmethod
    def at_nodes(memory: Memory, at: Int[Array, " events"]) -> Any:
        """What equilibria at the events of these nodes depend on, of what contacts remember.

        `NotImplemented` if events depend on it in other ways: their derivatives are left to JAX.
        """

    @staticmethod
    @abc.abstractmethod
    def signals(problem: AnyProblem, *side: Any) -> tuple[Any, Scalar, Any]:
        """State of an equilibrium in the scene's units, its largest residual, and displacements of bases or None."""
