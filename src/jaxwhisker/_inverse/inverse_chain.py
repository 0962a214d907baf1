"""Contacts of whiskers before known objects, from the reactions at their bases.

The states of a whisker with certain contacts are those of the chain of segments in _chain/contacts.py: three numbers of
each contact, and two more of a contact with something unknown, which is taken for a spot, an object without size at an
unknown place, whose parameter is the slope. Each contact has three equations. The states that satisfy them are compared
with the measured reaction by least squares, for every combination of contacts that may explain it (chain_guesses.py).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base.implicit import solution_of
from jaxwhisker._base.linear_algebra import solve
from jaxwhisker._base.types import Scalar
from jaxwhisker._chain.contacts import ChainState, chain_of, equations, last_contact, objects_of_body
from jaxwhisker._chain.gaps import nearest, outline_of
from jaxwhisker._chain.problem import ChainProblem
from jaxwhisker._chain.shaft import BaseAt, shaft_of
from jaxwhisker._equilibrium.contact import FORCE, SLACK, Phase, WhiskerAtObject, of_each
from jaxwhisker._inverse.chain_guesses import Hypothesis, guesses_of
from jaxwhisker._inverse.inverse_rod import BENT, keeps_integral
from jaxwhisker._inverse.mechanics import Contacts, Judgement, StepSignals
from jaxwhisker._inverse.nearest import rotated, value_and_jacobian
from jaxwhisker._inverse.spot import with_spot
from jaxwhisker._model.motion import Frame, Pose, mounted

STEPS = 14  # of Gauss-Newton
LAST_STEP = 1e-6  # largest last step of a converged iteration
LARGEST_STEP = 0.3  # of lengths, rad and parameters; of forces, relative to 1 + force
SOLVED, NEAR = 1e-8, 1e-3  # largest residuals of the equations, of states and of those that are not quite solved
ADMISSIBLE = 1e-9  # by which a slack may be negative
LEAST_FORCE = 1e-7  # EI/L^2, of a contact
DEEP = 1e-6  # lengths that a shaft may be inside a known object
APART = 1e-4  # lengths between places that are not the same
FAR_APART = 4.0  # standard errors between places that are not the same


class ChainObservation(NamedTuple):
    """What the contacts of a whisker are estimated from; dimensionless."""

    body: WhiskerAtObject  # in the frame of its base without loads, or of the measured base, before the known objects
    reaction: Float[Array, "3"]  # in the scene
    weight: Float[Array, "3"]  # 1 / standard deviation
    pose: Float[Array, "3"]  # of the base in the frame under the measured reactions of all whiskers
    measured: Float[Array, "3"]  # load on the base in the frame, under which it has this pose
    flexibility: Float[Array, "3 3"]  # displacement of the base per load on it, in the frame

    def at(self, y: Float[Array, " n"]) -> tuple[WhiskerAtObject, Float[Array, "contacts 3"]]:
        """The whisker before the objects and the spot, and its contacts."""
        body = self.body._replace(profile=with_spot(objects_of_body(self.body), y[-2], y[-1]))
        return body, jnp.reshape(y[:-2], (-1, 3))

    def balance(self, y: Float[Array, " n"], state: ChainState) -> "Balance":
        """Reaction and residuals of the equations, with these numbers of the contacts and this place of the spot."""
        body, z = self.at(y)
        at = equations(body, z, state)
        wanted = self.pose + jnp.sum(self.flexibility * (at.load - self.measured), axis=1)
        own = at.own - jnp.where(last_contact(state.touches)[:, None], wanted, 0.0)
        base = at.base
        reaction = -jnp.stack([jnp.asarray(base.force_x), jnp.asarray(base.force_y), jnp.asarray(base.bend)])
        return Balance(reaction, jnp.ravel(own))

    def displaced(self, reaction: Float[Array, "3"]) -> Float[Array, "3"]:
        """Pose of the base in its frame under this reaction, and the measured ones of other whiskers."""
        load = rotated(-reaction, -_angle(self.body))
        return self.pose + jnp.sum(self.flexibility * (load - self.measured), axis=1)

    def base(self, pose: Float[Array, "3"]) -> Pose:
        """A pose of the base in the scene."""
        frame = self.body.frame
        assert frame is not None
        x, y, turn = pose
        x, y = x * frame.cos - y * frame.sin, x * frame.sin + y * frame.cos
        return Pose(frame.x + x, frame.y + y, _angle(self.body) + turn)


class Balance(NamedTuple):
    """The equations of a whisker."""

    reaction: Float[Array, "3"]
    conditions: Float[Array, " conditions"]


class Fitted(NamedTuple):
    """A fit of one hypothesis."""

    found: Float[Array, " size"]  # y and multipliers
    chi2: Scalar
    # Whether contacts push and are in order, also if the fit creeps along states that differ little, or if the shaft is
    # inside a known object, which noise may explain.
    near: Bool[Array, ""]
    ok: Bool[Array, ""]  # whether no law of contact is violated, and it has converged


def fit(observed: ChainObservation, own: Hypothesis) -> Fitted:
    """The contacts nearest to the observation, from a guess."""
    n, count = own.y.size, own.y.size - 2

    def step(_, carry):
        y = carry[0]
        at = _linearised(y, own, observed)
        solution = solve(at.matrix, -at.right[:, None])[:, 0]
        scale = jnp.ones(n).at[FORCE:count:3].set(1 + jnp.abs(y[FORCE:count:3]))
        size = jnp.max(jnp.abs(solution[:n]) / scale)
        shorter = jnp.minimum(1.0, LARGEST_STEP / size)
        return y + shorter * solution[:n], solution[n:], size

    y, multipliers, size = jax.lax.fori_loop(0, STEPS, step, (own.y, jnp.zeros(count), jnp.asarray(jnp.inf)))
    at = observed.balance(y, own.state)
    chi2 = jnp.sum(((at.reaction - observed.reaction) * observed.weight) ** 2)
    found, missed = jnp.append(y, multipliers), jnp.max(jnp.abs(at.conditions))
    near = _pushes(observed, y, own) & (missed < NEAR) & jnp.all(jnp.isfinite(found))
    outside = _depth(observed, y, own, observed.base(observed.displaced(at.reaction))) < DEEP
    return Fitted(found, chi2, near, near & outside & (size < LAST_STEP) & (missed < SOLVED))


def _angle(body: WhiskerAtObject) -> Float[Array, ""]:
    assert body.frame is not None
    return jnp.arctan2(body.frame.sin, body.frame.cos)


class LinearisedFit(NamedTuple):
    """The least-squares problem with conditions, linearised."""

    right: Float[Array, " size"]  # derivatives of half chi-squared, and the conditions
    matrix: Float[Array, "size size"]  # of their changes with y and the multipliers (Karush, Kuhn and Tucker)
    by_signals: Float[Array, "n 3"]  # minus the derivatives of `right` with respect to the reaction


def _linearised(y: Float[Array, " n"], own: Hypothesis, observed: ChainObservation) -> LinearisedFit:
    at, by_y = value_and_jacobian(lambda y: observed.balance(y, own.state), y)
    # Numbers that are fixed do not change.
    gradient = jnp.where(own.fixed, 0.0, by_y.reaction * observed.weight[:, None])
    conditions = jnp.where(own.fixed, 0.0, by_y.conditions)
    downhill = jnp.sum(gradient * ((at.reaction - observed.reaction) * observed.weight)[:, None], axis=0)
    normal = jnp.sum(gradient[:, :, None] * gradient[:, None, :], axis=0) + jnp.diag(own.fixed.astype(float))
    zero = jnp.zeros((at.conditions.size,) * 2)
    matrix = jnp.block([[normal, conditions.T], [conditions, zero]])
    return LinearisedFit(jnp.append(downhill, at.conditions), matrix, (gradient * observed.weight[:, None]).T)


def _stationarity(found: Float[Array, " size"], known: tuple[Hypothesis, ChainObservation]) -> Float[Array, " size"]:
    """Derivatives of half chi-squared plus multipliers times conditions, which vanish at the nearest contacts."""
    own, observed = known
    n = own.y.size
    y = found[:n]
    at, by_y = value_and_jacobian(lambda y: observed.balance(y, own.state), y)
    weighted = (at.reaction - observed.reaction) * observed.weight**2
    downhill = jnp.sum(by_y.reaction * weighted[:, None], axis=0)
    downhill += jnp.sum(by_y.conditions * found[n:, None], axis=0)
    # Multipliers of contacts with known objects only have no meaning: all numbers follow from the conditions.
    return jnp.append(jnp.where(own.fixed, y - jax.lax.stop_gradient(y), downhill), at.conditions)


def _pushes(observed: ChainObservation, y: Float[Array, " n"], own: Hypothesis) -> Bool[Array, ""]:
    """Whether forces push, and contacts are in order on the whisker."""
    body, z = observed.at(y)
    state, length = own.state, body.length
    used, tip = state.touches, state.phase == Phase.tip
    slack = jnp.where(used, jnp.where(tip, 0.0, z[:, SLACK]), length)
    pushes = jnp.all(~used | (z[:, FORCE] > LEAST_FORCE)) & ~equations(body, z, state).backwards
    ordered = jnp.all(jnp.diff(jnp.append(slack, length)) > -ADMISSIBLE) & (slack[0] > -ADMISSIBLE)
    return pushes & ordered & jnp.all(~tip | ((z[:, SLACK] < ADMISSIBLE) & (z[:, SLACK] > -np.pi)))


def _depth(observed: ChainObservation, y: Float[Array, " n"], own: Hypothesis, base: Pose) -> Scalar:
    """How deep the shaft is inside the known objects."""
    body, z = observed.at(y)
    at = BaseAt(base.x, base.y, -jnp.sin(base.angle), jnp.cos(base.angle))
    shaft = shaft_of(body, chain_of(body, z, own.state), own.state, at)
    known = objects_of_body(observed.body).objects
    depths = [depth_in(one, base.x, base.y, 1.5 * body.length, shaft.x, shaft.y) for one in known]
    return jnp.max(jnp.stack(depths))


def depth_in(one: Any, x: Scalar, y: Scalar, reach: Scalar, to_x: Array, to_y: Array) -> Scalar:
    """The largest depth of any of these points in an object; they are within reach of (x, y)."""
    outline = outline_of(one, x, y, reach)

    def depth(x, y):
        return -one.point(nearest(one, outline, x, y)).off(x, y)

    return jnp.max(jax.vmap(depth)(jnp.ravel(to_x), jnp.ravel(to_y)))


class Best(NamedTuple):
    """The hypothesis that explains the signals of a whisker, and its fit."""

    own: Hypothesis
    fitted: Fitted
    explains: Bool[Array, ""]


def best_of(observed: ChainObservation, judgement: Judgement) -> Best:
    """The hypothesis that explains the signals of a whisker, if they decide between all that do.

    Contacts with known objects only come first: signals have three degrees of freedom to reject them. All hypotheses
    with something unknown must agree.
    """
    constant = jax.lax.stop_gradient(observed)
    each = guesses_of(constant.body, constant.base(constant.pose), constant.reaction)
    fits = jax.vmap(lambda own: fit(constant, own))(each)
    one, three = judgement.explained
    near = fits.near & (fits.chi2 < jnp.where(each.unknown, one, three))
    good = near & fits.ok
    rivals = good & ~(each.unknown & jnp.any(good & ~each.unknown))
    # Where a second contact with a known object may be, it is: without it, the shaft would be inside.
    handicap = jnp.where(each.unknown, 0.0, -judgement.handicap * jnp.sum(each.state.touches, axis=1))
    best = jnp.argmin(jnp.where(rivals, fits.chi2 + handicap, jnp.inf))
    own, fitted = jax.tree.map(lambda leaf: leaf[best], (each, fits))
    places = fits.found[:, own.y.size - 2 : own.y.size]
    apart = jnp.max(jnp.abs(places - places[best]), axis=1)
    spread = _spread(constant, own, fitted.found) * jnp.where(jnp.isnan(judgement.known), 0.0, 1.0)
    apart = apart > APART + FAR_APART * spread
    # Contacts with other objects, or in another order, are others even if one of them is at the same place.
    apart |= jnp.any((each.state.touches != own.state.touches) | (each.state.piece != own.state.piece), axis=1)
    other = near & own.unknown & each.unknown & apart
    on_shaft = own.unknown & ~jnp.any(own.state.phase == Phase.tip)
    section = observed.body.section
    assert not isinstance(section, tuple)  # of one whisker
    undetermined = on_shaft & keeps_integral(section)
    return Best(own, fitted, rivals[best] & ~jnp.any(other) & ~undetermined)


def _spread(observed: ChainObservation, own: Hypothesis, found) -> Scalar:
    """Standard error of the place of the spot."""
    n = own.y.size
    at = _linearised(found[:n], own, observed)
    noise = at.by_signals / observed.weight
    changes = solve(at.matrix, jnp.pad(noise, ((0, len(at.matrix) - n), (0, 0))))[n - 2 : n]
    return jnp.sqrt(jnp.sum(changes**2))


class LocatedContacts(NamedTuple):
    """The contacts of a whisker in the scene."""

    numbers: Float[Array, "contacts 4"]  # x, y, slope and arc
    by_signals: Float[Array, "contacts 4 whiskers 3"]  # derivatives with respect to the reactions of all whiskers
    force: Float[Array, " contacts"]
    base: Float[Array, "3"]  # under the measured reaction, where the contacts are not known
    chi2: Scalar


def _located(
    observed: ChainObservation, best: Best, ok: Bool[Array, ""], own: Float[Array, " whiskers"], by_others: Array
) -> LocatedContacts:
    """The contacts of the best hypothesis; finite values and derivatives if nothing explains the signals.

    `own` is 1 for this whisker, and `by_others` are derivatives of its pose with respect to all reactions.
    """
    hypothesis, found = _placeholder(observed)
    hypothesis = jax.tree.map(lambda a, b: jnp.where(ok, a, b), best.own, hypothesis)
    found = jnp.where(ok, jax.lax.stop_gradient(best.fitted.found), found)
    y = solution_of(_stationarity, found, (hypothesis, observed))[: hypothesis.y.size]

    def numbers_of(y):
        body, z = observed.at(y)
        chain = chain_of(body, z, hypothesis.state)
        slope = jnp.arctan2(chain.contact.sin, chain.contact.cos)
        return jnp.stack([chain.contact.x, chain.contact.y, slope, body.length - chain.beyond], axis=1)

    numbers, by_y = value_and_jacobian(numbers_of, y)
    follows = jnp.sum(by_y[..., None] * _follows(observed, hypothesis, y, own, by_others), axis=2)
    at = observed.balance(y, hypothesis.state)
    chi2 = jnp.sum(((at.reaction - observed.reaction) * observed.weight) ** 2)
    base = observed.base(jnp.where(ok, observed.displaced(at.reaction), observed.pose))
    force = y[FORCE : y.size - 2 : 3]
    return LocatedContacts(numbers, jnp.reshape(follows, (*numbers.shape, -1, 3)), force, jnp.stack([*base]), chi2)


def _follows(observed: ChainObservation, own: Hypothesis, y, is_own, by_others) -> Float[Array, "n reactions"]:
    """Changes of all numbers with the reactions of all whiskers; Gauss-Newton is exact to first order in the noise."""
    at = _linearised(y, own, observed)
    of_signals = jnp.reshape(at.by_signals[:, None, :] * is_own[:, None], (y.size, -1))
    last = last_contact(own.state.touches)[:, None, None]
    of_poses = jnp.where(last, jnp.reshape(by_others, (3, -1)), 0.0)
    right = jnp.concatenate([of_signals, jnp.reshape(of_poses, (-1, of_signals.shape[1]))])
    return solve(at.matrix, right)[: y.size]


def _placeholder(observed: ChainObservation) -> tuple[Hypothesis, Float[Array, " size"]]:
    """A contact with a spot, whose equations are regular."""
    base, rows = observed.base(observed.pose), 2
    y = jnp.stack([1.0, 0.5, 0.1, 0.0, 0.0, 0.0, base.x - 0.4 * observed.body.length, base.y + 0.8])
    first = np.arange(rows) == 0
    piece = jnp.where(first, len(objects_of_body(observed.body).objects), 0)
    state = ChainState(jnp.where(first, int(Phase.tangential), int(Phase.free)), jnp.ones(rows), piece)
    fixed = jnp.zeros(y.size, bool)
    return Hypothesis(y, state, fixed, jnp.asarray(True)), jnp.append(y, jnp.zeros(y.size - 2))


class KnownObjects(NamedTuple):
    """A dimensionless sensor before known objects."""

    problem: ChainProblem

    @property
    def flexibility(self) -> Float[Array, "whiskers 3 whiskers 3"]:
        """Displacements of bases per load on every whisker, in their frames."""
        n = self.problem.length.shape[0]
        return jnp.reshape(self.problem.flexibility.matrix, (n, 3, n, 3))

    def peaks(self, largest: Float[Array, "whiskers 3"]) -> Float[Array, "whiskers 3"]:
        """The size of each channel."""
        return largest

    def unloaded(self, drive: Float[Array, "3"]) -> None:
        """Without a contact, reactions vanish."""

    def bent(self, drive: Float[Array, "3"]) -> Float[np.ndarray, "3"]:
        """Reaction of a bent whisker."""
        return BENT

    def contacts(self, drive: Float[Array, "3"], signals: StepSignals, judgement: Judgement) -> Contacts:
        """The contacts of all whiskers at one step."""
        bodies, each = self._observations(drive, signals)
        constant, known = jax.lax.stop_gradient((bodies, each))
        best = of_each(constant, lambda body, *own: best_of(ChainObservation(body, *own), judgement), *known)
        ok = signals.touching & best.explains
        own = jnp.eye(ok.size)
        by_measured = jax.jacfwd(lambda measured: self._poses(drive, measured, signals)[1])(signals.measured)
        by_others = jnp.where(own[:, None, :, None] > 0, 0.0, by_measured)
        found = of_each(
            bodies,
            lambda body, *own: _located(ChainObservation(body, *own[:5]), *own[5:]),
            *each,
            best,
            ok,
            own,
            by_others,
        )
        noise = jnp.where(ok[:, None], signals.noise, 0.0)
        spread = jnp.reshape(found.by_signals * noise, (*found.by_signals.shape[:3], -1))
        covariance = jnp.sum(spread[..., :, None, :] * spread[..., None, :, :], axis=-1)
        state = best.own.state
        used = state.touches
        numbers = dict(zip(("x", "y", "slope", "arc"), jnp.moveaxis(found.numbers, -1, 0), strict=True))
        contact = {name: jnp.where(used, value, jnp.nan) for name, value in (numbers | {"force": found.force}).items()}
        base: dict[str, Array] = dict(zip(("base_x", "base_y", "base_angle"), found.base.T, strict=True))
        covariance = jnp.where(used[:, :, None, None], covariance, jnp.nan)
        contact["object"] = self._object(state)
        return Contacts(contact, base, state.phase == Phase.tip, ok, found.chi2, covariance, used)

    def _object(self, state: ChainState) -> Int[Array, "whiskers contacts"]:
        """Numbers of known objects, from 1; 0 for the spot and for places that are not used."""
        known = len(self.problem.profile.objects)
        return jnp.where(state.touches & (state.piece < known), state.piece + 1, 0)

    def _poses(
        self, drive: Float[Array, "3"], measured: Float[Array, "whiskers 3"], signals: StepSignals
    ) -> tuple[Frame, Float[Array, "whiskers 3"], Float[Array, "whiskers 3"]]:
        """Frames of all bases, their poses in them under the measured reactions, and the loads on them."""
        rest = self.problem.rest
        if signals.pose is None:
            frames = jax.vmap(lambda mount: mounted(Pose(*drive), mount))(self.problem.mount)
        else:
            x, y, angle = signals.pose.T
            frames, rest = Frame(x, y, jnp.cos(angle), jnp.sin(angle)), jnp.zeros_like(rest)
        loads = jax.vmap(rotated)(-measured, -jnp.arctan2(frames.sin, frames.cos))
        return frames, rest + jnp.sum(self._yields(signals) * loads, axis=(2, 3)), loads

    def _yields(self, signals: StepSignals) -> Float[Array, "whiskers 3 whiskers 3"]:
        return self.flexibility if signals.pose is None else jnp.zeros_like(self.flexibility)

    def _observations(self, drive: Float[Array, "3"], signals: StepSignals) -> tuple[WhiskerAtObject, tuple]:
        """All whiskers before the known objects, and the other fields of their observations."""
        problem, flexibility = self.problem, self._yields(signals)
        frames, poses, loads = self._poses(drive, signals.measured, signals)
        own = jnp.stack([flexibility[k, :, k] for k in range(len(loads))])
        still = jax.tree.map(jnp.zeros_like, frames)
        whiskers = problem.length, problem.bending_stiffness, problem.profile, problem.rod, problem.section
        reaction = jnp.where(signals.touching[:, None], signals.measured, signals.reaction)
        return WhiskerAtObject(*whiskers, frames, still), (reaction, signals.weight, poses, loads, own)
