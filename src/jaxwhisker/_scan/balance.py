"""The energy balance of a scan: work of the drive, stored energy, frictional heat, and losses in snaps.

All springs act between the whiskers and the drive's frame. By the balance of the whole structure, the drive therefore
supplies the power of the sum of all support reactions, reduced to the drive's frame (X, Y, angle A):

    dW = sum_i [fx_i (dX - (y_i - Y) dA) + fy_i (dY + (x_i - X) dA) + mz_i dA],    (x_i, y_i) the base.

With springs on shafts, the forces that the drive exerts on the shafts are added. The sum is minus the load on the
whisker above all springs.

A contact that slips by dS along the object turns mu N |dS| into heat. The slip is the way of the contact along the
object minus that along the whisker, with the sign of the side from which the whisker approached. Work, heat and stored
energy are computed from different quantities, and the residual of the balance is an independent check of a scan.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._base.settings import in_double
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.motion import pose_of
from jaxwhisker._model.scene import Scene
from jaxwhisker._path.path import Status, is_snap
from jaxwhisker._scan import panels
from jaxwhisker._scan.blocks import BLOCK, in_blocks
from jaxwhisker._scan.energy import stored_energy
from jaxwhisker._scan.panels import POINTS, Panel, PanelEnds
from jaxwhisker._scan.result import Events, Result
from jaxwhisker._scan.route import route_through
from jaxwhisker._scan.scan import mechanics_of, path_along
from jaxwhisker._scan.slopes import solved_states_now
from jaxwhisker._scan.springs import held, holds, load_beyond
from jaxwhisker._scan.state import State, base_of, state_of

Table = Float[Array, "panels points integrals"]  # coefficients of the work and of the heat of each whisker
Before = tuple[Float[Array, "ends integrals"], Bool[Array, " panels"]]


class EnergyBalance(eqx.Module):
    """Energies at the steps of a scan, each counted from the first step; force times length.

    The balance is work = stored + sum of heat + loss, and `residual` is what it misses. All values are NaN from the
    first step on that failed.
    """

    control: Float[Array, "*batch steps"]  # drive position
    work: Float[Array, "*batch steps"]  # of the drive on whiskers and springs
    stored: Float[Array, "*batch steps"]  # change of the energy of whiskers and springs, see `stored_energy`
    heat: Float[Array, "*batch steps whiskers"]  # of the friction of each contact; never falls
    loss: Float[Array, "*batch steps"]  # stored energy lost in snaps, including the heat of friction within them
    residual: Float[Array, "*batch steps"]  # work - stored - sum of heat - loss


@in_double
def energy_balance(result: Result) -> EnergyBalance:
    """Work of the drive along a scan, and where it goes: stored energy, heat of friction, and losses in snaps.

    The integrals do not depend on the steps of the scan. The function scans again: it follows the path once more and
    solves for sixteen states in each panel between two nodes of the path, about as many as a default scan has steps
    (under jit or vmap, for as many as a path has room for). The residual measures the accuracy of the scan: with the
    default rods it is below 1e-8 of the largest work, with `ClosedForm` usually below 1e-11.

    Args:
        result: the Result of a scan, or of a batch of scans.

    Returns:
        EnergyBalance, with arrays of shape (steps,), or (steps, whiskers) for `heat`. NaN from the first failed step
        on, from where a state between the steps could not be solved for, and beyond the last event of a scan whose
        events are `truncated`.

    Raises:
        ValueError: if `result` is not a Result.

    `energy_balance` works under jax.jit and jax.vmap, and has derivatives in both modes. The derivative of the heat
    after a snap is accurate to about 1e-6.

    Examples:
        >>> scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), friction=0.3)
        >>> energies = jw.energy_balance(jw.scan(scene, jnp.array([0.9, -0.4, 0.9])))
        >>> print(f"{energies.work[-1]:.6f} {energies.heat[-1, 0]:.6f}")
        5.933391 5.933391
    """
    checks.instance("result", result, Result, "the Result of a scan")
    if np.ndim(result.control) == 1:
        return _balance(result)
    if checks.is_traced(result):
        return jax.vmap(energy_balance)(result)
    # One after the other, each takes as many states as it needs.
    result = jax.tree.map(np.asarray, result)
    each = [energy_balance(jax.tree.map(lambda leaf, k=k: leaf[k], result)) for k in range(result.control.shape[0])]
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *each)


def _balance(result: Result) -> EnergyBalance:
    scene = jax.tree.map(checks.as_float, result.scene)
    control = result.control if checks.is_traced(result.control) else np.asarray(result.control)
    mechanics = mechanics_of(scene)
    problem = mechanics.problem(scene)
    route, status = route_through(control)
    path = path_along(mechanics, scene, problem, route, status).path
    memory = mechanics.memory(problem, path, route.stops)
    path = path if memory is None else memory.on(path)
    ends = panels.ends_now(problem, path)
    ends = ends._replace(control=panels.with_slopes_now(ends, problem, path, result.events, route.stops))
    every = panels.panels_now(ends)
    size, count = BLOCK // POINTS, every.start.shape[0]
    if not checks.is_traced(ends.last):
        # The other panels are empty. The number of blocks may vary, their size does not.
        used = max(1, -(-int(ends.last) // size)) * size
        every = jax.tree.map(lambda leaf: leaf[:used], every)

    def integrals(*panel):
        panel = Panel(*panel)
        at, travel = points_now(panel)
        state, step_status, _, solutions = solved_states_now(mechanics, problem, path, at, travel, memory)
        return integrals_now(scene, panel, at, state, solutions.state.side, step_status)

    table, good = in_blocks(integrals, tuple(every), size)
    table, good = _padded(table, count, 0.0), _padded(good, count, 1.0)
    before = before_now(table, good)
    state, events = state_of(result), result.events

    def at_steps(control, travel, state, status):
        return at_steps_now(scene, ends, table, before, control, travel, state, status)

    steps = in_blocks(at_steps, (route.control, route.travel, state, result.status), BLOCK)
    return assembled_now(scene, events, ends.noise, jnp.asarray(control), jnp.asarray(route.travel), *steps)


def _padded(values: Array, count: int, rest: float) -> Array:
    """The values of all panels; those beyond the last block are empty."""
    missing = count - values.shape[0]
    if missing <= 0:
        return values[:count]
    padding = [(0, missing)] + [(0, 0)] * (values.ndim - 1)
    if checks.is_traced(values):
        return jnp.pad(values, padding, constant_values=rest)
    return jnp.asarray(np.pad(np.asarray(values), padding, constant_values=rest))  # compiles nothing


def _points(panel: Panel) -> tuple[Float[Array, " at"], Float[Array, " at"]]:
    """Control and travel at all points of the panels."""
    at, travel = panels.points_of(panel)
    return at.ravel(), travel.ravel()


def _power(scene: Scene, control: Float[Array, " at"], state: State) -> Float[Array, " at"]:
    """Work of the drive per control."""
    one = jnp.ones_like(control[0])
    drive, rate = jax.vmap(lambda u: jax.jvp(lambda u: pose_of(scene.motion, u), (u,), (one,)))(control)
    drive, rate = jax.tree.map(lambda leaf: leaf[:, None], (drive, rate))
    if scene.support.on_shafts:
        fx, fy, about = _exerted(scene, control, state)
        along_x, along_y = rate.x + drive.y * rate.angle, rate.y - drive.x * rate.angle
        return jnp.sum(fx * along_x + fy * along_y + about * rate.angle, axis=1)
    along_x = rate.x - (state.base_y - drive.y) * rate.angle
    along_y = rate.y + (state.base_x - drive.x) * rate.angle
    return jnp.sum(state.fx * along_x + state.fy * along_y + state.mz * rate.angle, axis=1)


def _exerted(scene: Scene, control: Float[Array, " at"], state: State) -> tuple[Float[Array, "at whiskers"], ...]:
    """Forces on each whisker by its base and all springs on its shaft, and their moment about the origin.

    The moment is that without weights, which only drives carry that do not turn.
    """
    by = holds(scene)
    assert by is not None

    def one(control, state):
        each = []
        every, _ = held(by, scene.whiskers, control, state.shaft_loads)
        for k, (whisker, own) in enumerate(zip(scene.whiskers, every, strict=True)):
            at = jax.tree.map(lambda leaf, k=k: leaf[k], state)
            load = load_beyond(whisker, base_of(at), (at.fx, at.fy, at.mz), own)
            beyond = jnp.stack([*map(jnp.asarray, (load.force_x, load.force_y, load.moment))])
            weight = own.held_by.weight
            if weight is not None and own.section is not None:
                top = jnp.maximum(own.held_by.top, 0.0)
                beyond += jnp.stack([*weight.between(own.section, jnp.zeros(()), top), jnp.zeros(())])
            each.append(beyond)
        return tuple(-jnp.stack(each).T)

    return jax.vmap(one)(control, state)


def heat_rate(mu: Scalar, normal: Array, slip: Array, slipped: Array) -> Array:
    """Heat by the law of friction; negative if a contact moves against its direction of slip."""
    return mu * normal * slip * slipped


def _integrals(
    scene: Scene,
    panel: Panel,
    control: Float[Array, " at"],
    state: State,
    side: Float[Array, "at contacts"],
    status: Int[Array, " at"],
) -> tuple[Table, Bool[Array, " panels"]]:
    """Work and heats by t, as coefficients of polynomials, and whether all states are known."""
    number, used = panel.start.shape[0], panel.used
    known = (status == Status.ok)[:, None]
    state = _where(known, state)
    work = jnp.reshape(_power(scene, control, state), (number, POINTS)) * panels.rates_of(panel)
    heat = jnp.zeros((number, POINTS, len(scene.whiskers)))
    if scene.friction is not None:
        each = number, POINTS, *state.contact_x.shape[1:]
        fields = state.contact_x, state.contact_y, state.contact_arc
        x, y, arc = (panels.slopes_at_points(leaf.reshape(each)) for leaf in fields)
        others = state.contact_slope, side, state.normal_force, state.slip
        slope, side, normal, slip = (jnp.reshape(jnp.asarray(leaf), each) for leaf in others)
        slipped = x * jnp.cos(slope) + y * jnp.sin(slope) - side * arc
        heats = heat_rate(scene.friction, normal, slip, slipped)
        heat = heats if heats.ndim == heat.ndim else jnp.sum(heats, axis=-1)  # of all contacts of a whisker
    values = jnp.concatenate([work[..., None], heat], axis=-1)
    table = jnp.where(used[:, None, None], panels.coefficients(values), 0.0)
    return table, ~used | jnp.all(known.reshape(number, POINTS), axis=1)


def _where(known: Bool[Array, "at 1"], state: State) -> State:
    """The states where they are known, else zeros."""

    def kept(leaf: Array) -> Array:
        return jnp.where(known if leaf.ndim == known.ndim else known[..., None], leaf, 0)

    return jax.tree.map(kept, state)


def _before(table: Table, good: Bool[Array, " panels"]) -> Before:
    """Integrals up to the start of each panel and to the end of the last one; whether all panels so far are known."""
    totals = jnp.cumsum(table[:, 0], axis=0)
    return jnp.concatenate([jnp.zeros_like(totals[:1]), totals]), jnp.cumsum(~good) == 0


def _at_steps(
    scene: Scene,
    ends: PanelEnds,
    table: Table,
    before: Before,
    control: Float[Array, " steps"],
    travel: Float[Array, " steps"],
    state: State,
    status: Int[Array, " steps"],
) -> tuple[Float[Array, " steps"], Float[Array, "steps whiskers"], Float[Array, " steps"], Bool[Array, " steps"]]:
    """Work, heats and stored energy at steps, and whether they are known."""
    totals, good = before
    index = jnp.clip(jnp.searchsorted(ends.travel, travel + ends.noise, side="right") - 1, 0, ends.travel.shape[0] - 2)

    every = panels.panels_of(ends)

    def one(k, control):
        t = panels.place_in(jax.tree.map(lambda leaf: leaf[k], every), control)
        return totals[k] + panels.integral_to(t, table[k])

    integrals = jax.vmap(one)(index, control)
    ok = (status == Status.ok) & good[index]
    state = _where(ok[:, None], state)
    return integrals[:, 0], integrals[:, 1:], stored_energy(scene, state, control), ok


def _assembled(
    scene: Scene,
    events: Events,
    noise: Float[Array, ""],
    control: Float[Array, " steps"],
    travel: Float[Array, " steps"],
    work: Float[Array, " steps"],
    heat: Float[Array, "steps whiskers"],
    stored: Float[Array, " steps"],
    ok: Bool[Array, " steps"],
) -> EnergyBalance:
    """The balance of all steps, with the losses in the snaps up to them."""
    filled = jnp.arange(events.kind.shape[0]) < events.count
    before, after = (_where(filled[:, None], state) for state in (events.before, events.after))
    snaps = filled & is_snap(events.kind)
    at = jnp.where(filled, events.control, control[0])
    # Where contacts stick after a snap, a further event at its place may complete the change of the state.
    at_snap = jnp.any(snaps & (jnp.abs(events.travel[:, None] - events.travel) <= noise), axis=1)
    drops = jnp.where(at_snap, stored_energy(scene, before, at) - stored_energy(scene, after, at), 0.0)
    passed = events.travel <= travel[:, None] + noise  # NaN beyond the last event
    loss = jnp.sum(jnp.where(passed, drops, 0.0), axis=1)
    # Of too many events, those in the middle are missing.
    last = events.travel[events.travel.shape[0] // 2 - 1]
    ok = jnp.cumsum(~ok | (events.truncated & (travel > last))) == 0
    stored = stored - stored[0]
    residual = work - stored - jnp.sum(heat, axis=1) - loss

    def known(values):
        return jnp.where(ok if values.ndim == 1 else ok[:, None], values, jnp.nan)

    return EnergyBalance(control, *map(known, (work, stored, heat, loss, residual)))


points_now, integrals_now, before_now = Program(_points), Program(_integrals), Program(_before)
at_steps_now, assembled_now = Program(_at_steps), Program(_assembled)
