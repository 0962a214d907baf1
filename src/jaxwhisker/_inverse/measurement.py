"""The measurement model of filters in space: signals of one state and their derivatives, from a known contact.

Each iteration linearises everything at once: the equations and the reactions, along the steps of the contacts and along
the parameters. The same matrix gives the Newton step and, by the implicit function theorem, the derivatives. Programs
this small spend most of their time on starting kernels, so that nothing is computed twice.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.linear_algebra import sign_of_determinant, solve
from jaxwhisker._base.one_kernel import in_one_kernel
from jaxwhisker._base.program import COMPILER_OPTIONS
from jaxwhisker._base.settings import with_own_settings
from jaxwhisker._base.types import Control, Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._equilibrium.point import scale_of
from jaxwhisker._inverse.parameters import check_traceable
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._path.path import Status
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.scan import mechanics_of
from jaxwhisker._scan.slopes import solved_states_now
from jaxwhisker._space.contact import AHEAD, FORCE, POINT, ROLL, UNKNOWNS, base_of, frame_of, in_drive, on_surface
from jaxwhisker._space.linear import directions_of, step_along
from jaxwhisker._space.newton import Phases, phase_by_slack
from jaxwhisker._space.problem import Contacts, SpaceProblem, of_each, problem_in_space

STEPS = 12  # of Newton's method at most; 2 or 3 suffice if the contact has moved by a hundredth of the length
LAST = 1e-8  # size of the last step, dimensionless; derivatives are those before it, and err as much
FAR = 0.5  # lengths: a solution that is further from the contact it started from may be another one


class ContactUnknowns(NamedTuple):
    """The unknowns of all contacts (see contact.py), from which a solution starts."""

    z: Contacts
    phase: Phases


class Measurement(NamedTuple):
    """The expected signals of one state, and their derivatives."""

    signals: Float[Array, "whiskers 6"]  # fx, fy, fz, mx, my, mz; zero for a free whisker; NaN unless the status is ok
    jacobian: Float[Array, "whiskers 6 parameters"]  # derivatives of the signals
    contact: ContactUnknowns  # from which the next call may start; that of this call unless the status is ok
    status: Int[Array, ""]  # Status.ok; lost: no equilibrium near the contact; unstable; invalid: of the parameters


class MeasurementModel:
    """The measurement model of a filter that estimates parameters of a scene in space, such as the place of an object.

    Calls compute the signals of one state and their derivatives with respect to the parameters. They start from the
    contact of an earlier state, and work under `jit` and `vmap`:

        model = jw.MeasurementModel(build, ("x", "y"))
        contact = model.contact([0.0, 1.1], [1.0, 0.2])  # at the end of a scan
        expected = model(estimate, 0.2, contact)
        expected.signals, expected.jacobian
        contact = expected.contact
        batch = jax.jit(jax.vmap(model, in_axes=(0, None, 0)))  # of particles

    Contacts change from the tip to the shaft and back by themselves. A whisker that would have to be pulled to touch is
    free: its signals and derivatives are zero, and it may touch again in a later call. Where it would have to be pulled
    too far, the status is `lost`, as for every state without an equilibrium near the contact. Whiskers that are free at
    the end of the scan remain so. No call looks for second contacts of curved whiskers.

    Args:
        build: makes a SpaceScene without friction from named numbers. JAX must be able to trace it.
        names: of its arguments that are parameters, in the order of the columns of the Jacobian.

    Raises:
        ValueError: if an argument is wrong; later, in calls, if the scene or the shape of the parameters is.
    """

    def __init__(self, build: Callable[..., SpaceScene], names: Sequence[str]):
        checks.float64_mode()
        self.build, self.names = build, tuple(names)
        if not self.names or isinstance(names, str) or not all(isinstance(name, str) for name in self.names):
            raise ValueError(f"`names` must be names of parameters, got {names!r}.")
        checks.arguments("names", build, self.names)
        # Jit starts a program in a third of the time that a Program takes. Options do not work below another jit.
        self._alone = jax.jit(in_one_kernel(self._measured), compiler_options=COMPILER_OPTIONS)
        self._within = jax.jit(self._measured)

    @with_own_settings
    def contact(self, parameters: Any, control: Control) -> ContactUnknowns:
        """The contacts at the end of a scan.

        Args:
            parameters: values, (parameters,).
            control: drive positions, (steps,), as in `scan`: whiskers should be free at the first one.

        Raises:
            ValueError: if the scan ends before the last position, or no whisker touches there.
        """
        checks.vector("control", control)
        values = np.asarray(parameters, dtype=float)
        check_traceable(self.build, dict(zip(self.names, values, strict=True)))
        scene, (route, _) = self._scene(values), route_through(control)
        mechanics = mechanics_of(scene)
        problem = mechanics.problem(scene)
        path = mechanics.follow(problem, route.stops, np.asarray(route.last)).path
        steps = np.asarray(route.control), np.asarray(route.travel)
        *_, found = solved_states_now(mechanics, problem, path, *steps, None)
        status, phase = Status(int(found.status[-1])), jnp.asarray(found.state[-1])
        if status != Status.ok or not np.any(phase != Phase.free):
            got = "no contact there" if status == Status.ok else f"a scan that ends before ({status.name})"
            checks.fail("control", "drive positions of which the last one is in contact", got)
        return ContactUnknowns(jnp.asarray(found.z[-1]), phase)

    @with_own_settings
    def __call__(self, parameters: Any, control: Scalar, contact: ContactUnknowns) -> Measurement:
        """Signals and derivatives at a drive position, found from a contact nearby.

        Args:
            parameters: values, (parameters,).
            control: drive position.
            contact: from `contact`, or of an earlier Measurement.
        """
        run = self._within if checks.is_traced((parameters, control, contact)) else self._alone
        return run(parameters, control, contact)

    def _scene(self, values: Any) -> SpaceScene:
        if np.shape(values) != (len(self.names),):
            checks.fail("parameters", f"of shape ({len(self.names)},)", f"shape {np.shape(values)}")
        scene = self.build(**dict(zip(self.names, values, strict=True)))
        checks.instance("build", scene, SpaceScene, "a SpaceScene", verb="return")
        if scene.friction is not None:
            checks.fail("build", "a function that returns a scene without friction", "one with friction")
        if scene.gravity is not None:
            checks.fail("build", "a function that returns a scene without gravity", "one with gravity")
        if scene.contacts > 1:
            allowed = "a function that returns a scene with one contact of each whisker"
            checks.fail("build", allowed, f"one with contacts={scene.contacts}")
        return jax.tree.map(checks.as_float, scene)

    def _measured(self, parameters: Any, control: Scalar, contact: ContactUnknowns) -> Measurement:
        x = jnp.asarray(parameters, dtype=float)

        def problem_at(x):
            return problem_in_space(self._scene(x))

        def along(dot):
            return eqx.filter_jvp(problem_at, (x,), (dot,))[1]

        problem, by_parameter = problem_at(x), jax.vmap(along, out_axes=-1)(jnp.eye(x.size))
        u = jnp.asarray(control, dtype=float) / problem.unit.control
        return _solved(problem, by_parameter, x.size, u, contact)


class _Iteration(NamedTuple):
    z: Contacts
    size: Scalar  # of the last step
    steps: Scalar
    sign: Scalar  # of the determinant of the equations, relative to that of stable states
    signals: Float[Array, "whiskers 6"]
    jacobian: Float[Array, "whiskers 6 parameters"]


def _solved(
    problem: SpaceProblem, by_parameter: SpaceProblem, parameters: int, u: Scalar, contact: ContactUnknowns
) -> Measurement:
    """The solution near a contact; `by_parameter` are derivatives, None of numbers that no parameter changes."""
    n = contact.z.shape[0]

    def goes_on(at: _Iteration):
        return (at.size >= LAST) & (at.steps < STEPS)

    def iterate(at: _Iteration):
        return _newton(problem, by_parameter, u, at, phase_by_slack(at.z, contact.phase))

    nothing = jnp.zeros((n, 6)), jnp.zeros((n, 6, parameters))
    start = _Iteration(contact.z, jnp.asarray(jnp.inf), jnp.asarray(0), jnp.zeros(()), *nothing)
    end = jax.lax.while_loop(goes_on, iterate, start)
    pulled = (contact.phase != Phase.free) & (end.z[:, FORCE] < 0)
    near = jnp.max(jnp.abs(end.z - contact.z) / scale_of(contact.z)) < FAR
    found = (end.size < LAST) & near
    if problem.springs is not None and n > 1:
        found &= ~jnp.any(pulled)  # a whisker that pulls moves the others
    stable = (end.sign > 0) | jnp.any(pulled)
    codes = [Status.invalid, Status.lost, Status.unstable]
    status = jnp.select([~problem.valid, ~found, ~stable], [int(code) for code in codes], int(Status.ok))
    ok = status == Status.ok
    signals, jacobian = (
        jnp.where(ok, jnp.where(pulled.reshape(-1, *[1] * (leaf.ndim - 1)), 0.0, leaf), jnp.nan)
        for leaf in (end.signals, end.jacobian)
    )
    phase = phase_by_slack(end.z, contact.phase)
    return Measurement(
        signals, jacobian, ContactUnknowns(jnp.where(ok, end.z, contact.z), jnp.where(ok, phase, contact.phase)), status
    )


def _newton(problem: SpaceProblem, by_parameter: SpaceProblem, u: Scalar, last: _Iteration, phase: Phases):
    """A Newton step, with signals and derivatives after it."""
    z, surface, touching = last.z, problem.surface, phase != Phase.free
    # A tangent that is zero, but an array, would cost as much as any other: of the rod, half of the time.
    varies = jax.tree.map(lambda leaf: leaf is not None, by_parameter, is_leaf=lambda leaf: leaf is None)
    numbers, constant = eqx.partition(problem, varies)
    frames = jax.vmap(lambda z: frame_of(surface, z))(z)
    curvature = jax.vmap(lambda z: surface.curvature(z[POINT]))(z)

    def directions(z, frame, curvature):
        return jnp.stack(directions_of(z, frame, curvature, rolls=problem.rolls), axis=1)

    steps = jax.vmap(directions)(z, frames, curvature)
    n, _, rows = steps.shape
    count = n * rows

    def equations(z, numbers):
        problem = eqx.combine(numbers, constant)
        drive, held = problem.drive(u), jax.lax.stop_gradient(z)

        def one(body, z, held, phase, frame, curvature):
            off, lean, stretch = on_surface(problem.surface, held)
            out = frame[:, 2]
            back = step_along(held, out, curvature, -off * out, -lean * out - stretch * held[AHEAD])
            z = z + back
            base = base_of(body, problem.surface, problem.rod, z, phase, None)
            inside = in_drive(base, drive, body.mount, z[ROLL])
            return inside.pose[:rows], inside.load[:rows], jnp.concatenate([base.force, base.moment]), z, inside.upright

        pose, load, loads, z, upright = of_each(problem, one, z, held, phase, frames, curvature)
        if problem.springs is not None:
            load = jnp.where(touching[:, None], load, 0.0)
            pose = pose - problem.springs.offset - problem.displacement(load)
        unit = jnp.repeat(jnp.stack([problem.unit.force, problem.unit.moment]), 3)
        values = jnp.ravel(pose), jnp.ravel(jnp.where(touching[:, None], -loads * unit, 0.0))
        return values, (values, z, jnp.all(upright | ~touching))

    apart = jnp.reshape(np.eye(n)[:, None, :, None] * steps[:, :, None, :], (n, UNKNOWNS, count))
    parameters = last.jacobian.shape[-1]
    along_z = jnp.concatenate([apart, jnp.zeros((n, UNKNOWNS, parameters))], axis=-1)
    along = jax.tree.map(lambda leaf: jnp.concatenate([jnp.zeros((*leaf.shape[:-1], count)), leaf], -1), by_parameter)
    _, (pose_by, signals_by), ((pose, signals), moved, upright) = jax.vmap(
        lambda *dots: jax.jvp(equations, (z, numbers), dots, has_aux=True),
        in_axes=-1,
        out_axes=(None, -1, None),
    )(along_z, along)
    row = jnp.repeat(touching, rows)[:, None]
    system = jnp.where(row, pose_by[:, :count], np.eye(count))
    right = jnp.where(row, jnp.concatenate([pose[:, None], pose_by[:, count:]], axis=1), 0.0)
    moves = -solve(system, right)
    changes = jnp.sum(signals_by[:, :count, None] * moves, axis=1)
    jacobian = jnp.reshape(signals_by[:, count:] + changes[:, 1:], (n, 6, parameters))
    step = jnp.sum(steps * jnp.reshape(moves[:, 0], (n, 1, rows)), axis=2)
    end = jnp.where(touching[:, None], moved + step, z)
    size = jnp.max(jnp.abs(end - z) / scale_of(z))
    size = jnp.where(upright, size, jnp.nan)  # beyond the base
    sign = sign_of_determinant(system)
    return _Iteration(end, size, last.steps + 1, sign, jnp.reshape(signals + changes[:, 0], (n, 6)), jacobian)
