"""Approach: how the drive comes to the object and leaves it, from far away or within a bounded motion.

A translation comes from far away on one side and leaves to far away on the other: nothing happens before the first
touch, nor once all whiskers are free beyond the object. A bounded motion has a first and a last control.
"""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact_state import ContactState
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.stance import Stance
from jaxwhisker._path.continuation import Limits
from jaxwhisker._path.path import Path, Status, select
from jaxwhisker._path.transitions import FIRST_STEP

MARGIN = 0.01  # of the default control before the first touch and after the last whisker is free, dimensionless
GLANCES = 64  # smallest number of steps in which free whiskers pass through a bounded motion
FAR = 1e4  # lengths that an unbounded drive travels at most; a march ends long before, unless springs are very soft
HIGHEST_FORCE = 1e3  # EI/L^2 on every whisker; forces before snap-off hardly ever reach it


class AbstractApproach(abc.ABC):
    """The parts of a scan that depend on how the drive approaches and leaves the object."""

    def __init__(self, problem: Problem):
        self.problem, self.onwards = problem, problem.onwards

    @abc.abstractmethod
    def start(self, first_stop: Scalar) -> Scalar:
        """A control, at or before the first stop, at which all whiskers are free."""

    @abc.abstractmethod
    def unloaded(self, u: Scalar) -> Stance:
        """Stance of the unloaded whiskers at a control."""

    @abc.abstractmethod
    def starts_clear(self, u: Scalar) -> Bool[Array, ""]:
        """Whether unloaded whiskers are clear of the object at this control, where a march starts."""

    @abc.abstractmethod
    def longest_step(self) -> Scalar:
        """The longest step of a march while all whiskers are free."""

    @abc.abstractmethod
    def is_over(self, state: ContactState, at: Stance) -> Bool[Array, ""]:
        """Whether nothing can happen any more if the drive moves on without reversing."""

    @abc.abstractmethod
    def limits(self) -> Limits:
        """The limits of a scan right across the object."""

    @abc.abstractmethod
    def crop(self, path: Path, whole: Bool[Array, ""], limits: Limits) -> tuple[Path, Scalar, Scalar]:
        """The path, and the first and last control at which whiskers touch on it, with a margin."""

    def _last_contact(self, path: Path, end: Scalar) -> Scalar:
        passed, event = jnp.arange(path.nodes.kind.shape[0]) < path.count, path.nodes.kind >= 0
        known = passed & (event | (path.status != Status.ok))
        way = self.onwards * path.nodes.point.u
        last = jnp.where(jnp.any(known), jnp.max(jnp.where(known, way, -jnp.inf)), self.onwards * end)
        return self.onwards * last + self.onwards * MARGIN


class FromAfar(AbstractApproach):
    """A drive that moves along x, from far away to far away."""

    def first_touch(self) -> Scalar:
        """The control at which the first whisker touches; infinite, in the direction of motion, if none ever does."""
        at = self.unloaded(jnp.asarray(0.0))
        first = select(self.onwards < 0, at.right, at.left)
        ahead = jnp.where(first.reaches, -self.onwards * (first.x - at.x), -jnp.inf)
        return -self.onwards * jnp.max(ahead)

    def start(self, first_stop):
        first = self.first_touch()
        return jnp.where(-self.onwards * (first_stop - first) > 0, first_stop, first - self.onwards * FIRST_STEP)

    def unloaded(self, u):
        # All that changes on the way is x.
        problem = self.problem
        at = problem.in_scene(u, problem.unloaded(u)[1])
        return Stance(at.x, problem.touch_right, problem.touch_left)

    def starts_clear(self, u):
        del u
        return jnp.asarray(True)

    def longest_step(self):
        return jnp.inf

    def is_over(self, state, at):
        beyond = state.free & (state.standing * self.onwards > 0)
        return jnp.all(beyond & jnp.where(self.onwards < 0, at.x < at.left.x, at.x > at.right.x))

    def limits(self):
        problem, zero = self.problem, jnp.asarray(0.0)
        unloaded = problem.in_scene(zero, problem.unloaded(zero)[1])
        middle, first = problem.profile.vertex()[0] - jnp.mean(unloaded.x), self.first_touch()
        start = jnp.where(jnp.isfinite(first), first, middle - self.onwards) - self.onwards * MARGIN
        hardest = jnp.zeros((problem.length.size, problem.axes)).at[:, 0].set(HIGHEST_FORCE)
        softness = jnp.max(problem.displacement(hardest))
        return Limits(start, middle + self.onwards, start + self.onwards * (FAR + softness))

    def crop(self, path, whole, limits):
        del whole
        return path, limits.start, self._last_contact(path, limits.end)


class Bounded(AbstractApproach):
    """A motion with a first control, at which all whiskers are free, and a last control."""

    def __init__(self, problem: Problem):
        super().__init__(problem)
        assert problem.ends is not None
        self.first, self.last = problem.ends

    def start(self, first_stop):
        start = self.first
        return jnp.where(-self.onwards * (first_stop - start) > 0, first_stop, start)

    def unloaded(self, u):
        z, pose = self.problem.unloaded(u)
        return self.problem.stance(u, pose, z)

    def starts_clear(self, u):
        return jnp.all(self.unloaded(u).clear)

    def longest_step(self):
        # A long step of such a motion, unlike one of a translation, could miss the object altogether.
        return jnp.abs(self.last - self.first) / GLANCES

    def is_over(self, state, at):
        del state, at
        return jnp.asarray(False)

    def limits(self):
        return Limits(self.first, self.last, self.last)

    def crop(self, path, whole, limits):
        passed, event = jnp.arange(path.nodes.kind.shape[0]) < path.count, path.nodes.kind >= 0
        way = self.onwards * path.nodes.point.u
        first = self.onwards * jnp.min(jnp.where(passed & event, way, jnp.inf))
        start = jnp.where(jnp.any(passed & event), first - self.onwards * MARGIN, limits.start)
        travel = path.nodes.travel - jnp.where(whole, jnp.abs(start - limits.start), 0.0)
        path = path._replace(nodes=path.nodes._replace(travel=travel))
        # Whiskers may still touch at the end of such a motion.
        touching = jnp.any(path.nodes.state.touches[path.count - 1])
        stop = self._last_contact(path, limits.end)
        return path, start, jnp.where(touching & (path.status == Status.ok), limits.far, stop)


def approach_of(problem: Problem) -> FromAfar | Bounded:
    """The approach that suits the motion of a problem's drive."""
    return FromAfar(problem) if problem.ends is None else Bounded(problem)
