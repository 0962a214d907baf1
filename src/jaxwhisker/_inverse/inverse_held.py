"""Inverse problem of one whisker with springs or a foundation on its shaft.

Everything happens in the drive's frame, in which the springs are at rest. The loads p on the springs between drive and
base determine the pose of the base and the reaction: pose = rest + C p, reaction = -p + (forces of the springs at the
base and below). From there the rod is integrated outwards, past all springs, to the contact. Two conditions hold there:
the moment vanishes, and the angle between whisker and object is that of the phase. Gauss-Newton with these conditions
finds the state y = (p, beyond) of each phase that is nearest to the measured reaction; `beyond` is the angle or the arc
beyond the contact, as in inverse_rod.py. The nearer state decides the phase. A tangential whisker leans against the
object from one side or the other, which makes three candidates.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.shaft_springs import past
from jaxwhisker._inverse.inverse_rod import GUESSES, LARGEST_STEP, LAST_STEP, START, value_and_jacobian
from jaxwhisker._model.motion import Pose
from jaxwhisker._rod import rod
from jaxwhisker._scan.loaded_rod import DRIVE, LoadedRod
from jaxwhisker._scan.springs import Held, at_base, walk_outwards

WALK_STEPS = 12  # of the rod between two springs
NEWTON_STEPS = 8  # for the pose of the base under the measured reaction
GAUSS_NEWTON_STEPS = 8
SOLVED = 1e-7  # largest residual of the conditions at the contact
# y and multipliers that replace those of failed fits, because every derivative must be finite.
PLACEHOLDER = np.array([0.8795, -0.4758, -0.9755, 0.1, 0.0, 0.0])


class HeldObservation(NamedTuple):
    """What the state of a whisker is estimated from; dimensionless."""

    reaction: Float[Array, "3"]  # in the scene
    weight: Float[Array, "3"]  # 1 / standard deviation
    drive: Float[Array, "3"]  # pose of the drive in the scene
    equations: LoadedRod  # of the whisker in the drive's frame; its loads are not used
    pose: Float[Array, "3"] | None  # measured pose of the base in the drive's frame; None: it follows from the springs
    lean: Scalar | None  # of the contact force: slope of the object minus angle of the force; None: no friction


class HeldEstimate(NamedTuple):
    """The state of a whisker nearest to the observation, in the scene."""

    values: Float[Array, "8"]  # contact x, y, slope, arc; pose of the base; contact force
    tip: Bool[Array, ""]
    ok: Bool[Array, ""]  # whether the iteration converged in at least one phase
    chi2: Scalar
    covariance: Float[Array, "4 4"]  # of contact x, y, slope and arc


class _Phase(NamedTuple):
    """A candidate."""

    tip: Bool[Array, ""]
    angle: Scalar  # from the object to the whisker, in tangential contact


class _State(NamedTuple):
    """A whisker with y = (p, beyond); its conditions need not hold."""

    reaction: Float[Array, "3"]  # in the scene
    conditions: Float[Array, "2"]  # moment at the contact; angle of the whisker minus that of its phase
    values: Float[Array, "8"]  # see HeldEstimate


def nearest_held_state(observed: HeldObservation) -> HeldEstimate:
    """The state nearest to the observation, in the likeliest phase."""
    constant = jax.lax.stop_gradient(observed)
    phases = _Phase(jnp.array([True, False, False]), jnp.array([0.0, 0.0, jnp.pi]))
    found, chi2, ok = jax.vmap(partial(_fit, constant), in_axes=(None, 0))(_guess(constant), phases)
    chi2 = jnp.where(ok, chi2, jnp.inf)
    best = jnp.argmin(chi2)
    second = jnp.argmin(jnp.where(phases.tip == phases.tip[best], jnp.inf, chi2))
    found = jax.lax.stop_gradient(jnp.where(ok[:, None], found, PLACEHOLDER))
    phase, other = (jax.tree.map(lambda leaf, k=k: leaf[k], phases) for k in (best, second))
    y = solution_of(_stationarity, found[best], (phase, observed))[:4]
    at, by_y = value_and_jacobian(lambda y: _state(y, phase, observed).values, y)
    value, gradient = _linearised(y, phase, observed)
    # The Gauss-Newton approximation is exact to first order in the noise.
    follows = solve(_kkt(gradient), jnp.concatenate([gradient[:3].T, jnp.zeros((2, 3))]))[:4]
    spread = jnp.sum(by_y[:4, :, None] * follows, axis=1)
    # The other phase adds its distance, with its probability.
    doubt = jnp.where(
        ok[second] & (phases.tip[second] != phase.tip), jax.nn.sigmoid((chi2[best] - chi2[second]) / 2), 0
    )
    apart = jnp.where(doubt > 0, _state(found[second, :4], other, observed).values - at, 0.0)[:4]
    covariance = jnp.sum(spread[:, None, :] * spread, axis=-1) + doubt * apart[:, None] * apart
    return HeldEstimate(at, phase.tip, jnp.any(ok), jnp.sum(value[:3] ** 2), covariance)


def _base(loads: Float[Array, "3"], observed: HeldObservation) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Pose of the base under these loads on its springs, and the reaction of everything at the base and below."""
    known = observed.equations
    if observed.pose is not None:
        return observed.pose, -loads
    moved = known.compliance * loads
    x, y, angle = pose = known.rest + moved
    assert known.held_by is not None
    springs = known.held_by.springs
    springs = springs._replace(share=jnp.where(springs.at > 0, 0.0, springs.share))
    none, state = rod.Load(*[jnp.zeros(())] * 3), (x, y, -jnp.sin(angle), jnp.cos(angle))
    each = jax.vmap(lambda spring: _components(past(none, spring, known.laws, state, DRIVE, 1.0)))(springs)
    fx, fy, about = jnp.sum(each, axis=0)
    below = jnp.stack([fx, fy, about - x * fy + y * fx])
    return pose, below + known.held * moved - loads


def _components(load: rod.Load) -> Float[Array, "3"]:
    return jnp.stack([*map(jnp.asarray, (load.force_x, load.force_y, load.moment))])


def _walked(pose: Float[Array, "3"], reaction: Float[Array, "3"], at: Float[Array, " places"], known: LoadedRod):
    """States and loads at places along the whisker, from its base pose and the reaction there."""
    assert known.held_by is not None
    held_by, places = known.held_by.with_places(at)
    start, load = at_base(Pose(*pose), tuple(reaction))
    walked = walk_outwards(known.section, start, load, Held(held_by, known.laws, DRIVE), steps=WALK_STEPS)
    return jax.tree.map(lambda leaf: leaf[places], (walked.passed, walked.loads))


def _state(y: Float[Array, "4"], phase: _Phase, observed: HeldObservation) -> _State:
    loads, beyond = y[:3], y[3]
    pose, reaction = _base(loads, observed)
    arc = 1.0 - jnp.where(phase.tip, 0.0, beyond)
    passed, load = _walked(pose, reaction, jnp.reshape(arc, 1), observed.equations)
    (x, y_, cos, sin), load = jax.tree.map(lambda leaf: leaf[0], (passed, load))
    fx, fy, about = _components(load)
    turn = observed.drive[2]
    slope = jnp.arctan2(fx, -fy) + (0.0 if observed.lean is None else observed.lean)
    angle = jnp.arctan2(sin, cos) - slope - jnp.where(phase.tip, beyond, phase.angle)
    conditions = jnp.stack([about - x * fy + y_ * fx, jnp.arctan2(jnp.sin(angle), jnp.cos(angle))])
    contact, base = (_in_scene(at, observed.drive) for at in (jnp.stack([x, y_, slope]), pose))
    force = jnp.sqrt(fx**2 + fy**2)
    contact = contact.at[2].set(jnp.arctan2(jnp.sin(contact[2]), jnp.cos(contact[2])))
    return _State(_turned(reaction, turn), conditions, jnp.concatenate([contact, jnp.stack([arc]), base, force[None]]))


def _turned(vector: Float[Array, "3"], angle: Scalar) -> Float[Array, "3"]:
    """The vector, turned counter-clockwise; its third component stays."""
    cos, sin, (x, y, rest) = jnp.cos(angle), jnp.sin(angle), vector
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, rest])


def _in_scene(pose: Float[Array, "3"], drive: Float[Array, "3"]) -> Float[Array, "3"]:
    return drive + _turned(pose, drive[2])


def _linearised(y, phase: _Phase, observed: HeldObservation):
    """Three whitened residuals of the reaction and two conditions, and their gradients (5, 4)."""

    def both(y):
        state = _state(y, phase, observed)
        return jnp.concatenate([(state.reaction - observed.reaction) * observed.weight, state.conditions])

    return value_and_jacobian(both, y)


def _kkt(gradient: Float[Array, "5 n"]) -> Float[Array, "rows rows"]:
    """The matrix of the least-squares problem with conditions (Karush, Kuhn and Tucker)."""
    gradient, conditions = gradient[:3], gradient[3:]
    normal = jnp.sum(gradient[:, :, None] * gradient[:, None, :], axis=0)
    return jnp.block([[normal, conditions.T], [conditions, jnp.zeros((2, 2))]])


def _fit(observed: HeldObservation, guess: Float[Array, "5"], phase: _Phase):
    """y of least chi-squared in one phase with its multipliers, chi-squared, and whether the iteration converged."""
    known = observed.equations
    assert known.held_by is not None
    largest = jnp.where(phase.tip, jnp.pi, jnp.minimum(0.999, 1 - known.held_by.top))
    start = jnp.append(guess[:3], jnp.where(phase.tip, guess[3], guess[4]))

    def step(_, carry):
        y = carry[0]
        value, gradient = _linearised(y, phase, observed)
        downhill = jnp.sum(gradient[:3] * value[:3, None], axis=0)
        right = -jnp.concatenate([downhill, value[3:]])
        increment = solve(_kkt(gradient), right[:, None])[3, 0]
        bounded = jnp.clip(y[3] + jnp.clip(increment, -LARGEST_STEP, LARGEST_STEP), 0.0, largest)
        right = -jnp.concatenate([downhill[:3], value[3:] + gradient[3:, 3] * (bounded - y[3])])
        solution = solve(_kkt(gradient[:, :3]), right[:, None])[:, 0]
        change = solution[:3]
        size = jnp.max(jnp.abs(jnp.append(change / (1 + jnp.abs(y[:3])), bounded - y[3])))
        return jnp.append(y[:3] + change, bounded), solution[3:], size

    carry = start, jnp.zeros(2), jnp.zeros(())
    y, multipliers, size = jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, step, carry)
    state = _state(y, phase, observed)
    chi2 = jnp.sum(((state.reaction - observed.reaction) * observed.weight) ** 2)
    found = jnp.append(y, multipliers)
    ok = (size < LAST_STEP) & (jnp.max(jnp.abs(state.conditions)) < SOLVED) & jnp.isfinite(chi2)
    return found, chi2, ok & jnp.all(jnp.isfinite(found))


def _stationarity(found: Float[Array, "6"], known: tuple[_Phase, HeldObservation]) -> Float[Array, "6"]:
    """Derivatives of half chi-squared plus multipliers times conditions, which vanish at the nearest state."""
    (phase, observed), y, multipliers = known, found[:4], found[4:]
    value, gradient = _linearised(y, phase, observed)
    downhill = jnp.sum(gradient * jnp.concatenate([value[:3], multipliers])[:, None], axis=0)
    # At the border between the phases, the fourth unknown is fixed.
    fixed = (jnp.arange(6) == 3) & ~(found[3] > 0)
    return jnp.where(fixed, found, jnp.concatenate([downhill, value[3:]]))


def base_under(observed: HeldObservation) -> Float[Array, "3"]:
    """Pose of the base in the scene under the measured reaction, whether or not that is possible."""
    return _in_scene(_base(_loads(observed), observed)[0], observed.drive)


def _loads(observed: HeldObservation) -> Float[Array, "3"]:
    """Loads on the base that give the measured reaction."""

    def newton(loads, observed):
        measured = _turned(observed.reaction, -observed.drive[2])
        value, gradient = value_and_jacobian(lambda loads: _base(loads, observed)[1], loads)
        return loads + solve(gradient, (measured - value)[:, None])[:, 0]

    constant = jax.lax.stop_gradient(observed)
    start = -_turned(constant.reaction, -constant.drive[2])
    loads = jax.lax.fori_loop(0, NEWTON_STEPS, lambda _, loads: newton(loads, constant), start)
    return newton(loads, observed)  # a step from the solution has its derivatives


def _guess(observed: HeldObservation) -> Float[Array, "5"]:
    """Loads on the base that give the measured reaction; angle at the tip; arc beyond a tangential contact."""
    known, measured, loads = observed.equations, _turned(observed.reaction, -observed.drive[2]), _loads(observed)
    pose, _ = _base(loads, observed)
    assert known.held_by is not None
    # Above all springs, the moment falls to zero.
    s = known.held_by.top + (1 - known.held_by.top) * jnp.linspace(0.0, 1.0, GUESSES + 1)
    (x, y, cos, sin), load = _walked(pose, measured, s, known)
    moment = jnp.asarray(rod.moment(x, y, load))
    moment = moment * jnp.where(moment[0] < 0, -1.0, 1.0)
    passed = ~(moment[1:] > 0)
    last = jnp.where(jnp.any(passed), jnp.argmax(passed), GUESSES - 1)
    here, there = moment[last], moment[last + 1]
    share = jnp.where(there <= 0, here / jnp.where(there <= 0, here - there, 1.0), 1.0)
    arc = s[last] + (s[last + 1] - s[last]) * jnp.clip(share, 0.0, 1.0)
    end = jnp.where(share > 0.5, last + 1, last)
    slope = jnp.arctan2(load.force_x, -load.force_y)[end] + (0.0 if observed.lean is None else observed.lean)
    angle = jnp.arctan2(sin, cos)[end] - slope
    theta = jnp.clip(jnp.arctan2(jnp.sin(angle), jnp.cos(angle)), 0.0, jnp.pi)
    return jnp.append(loads, jnp.stack([theta, jnp.maximum(1 - arc, START)]))
