"""Reconstruction in space: contact points from the reactions at the base of whiskers.

The reactions are six, in the scene's frame or along the directors of the displaced base. Those of a contact at a point
satisfy force . moment = 0, and without friction they have three parameters in each phase. Fewer channels suffice if
they determine the contact:

- A straight round whisker has no twisting moment, and that of a curved one follows from force . moment = 0.
- The axial force and the bending moment determine the contact of a whisker whose stiffness varies along it. For others
  the axial force in tangential contact follows from the moment: it is |M|^2 / (2 EI) for a straight one.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxwhisker._base import checks
from jaxwhisker._base.linear_algebra import inverse
from jaxwhisker._base.program import Program
from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._inverse.features import TINY_NOISE, noise_of
from jaxwhisker._inverse.inverse_space import SpaceInstrument, SpaceSensor, in_frame, space_instrument
from jaxwhisker._inverse.observations import OWN_REACTIONS, Observations, channels_of, named_values, read_observations
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._inverse.points_in_space import SpaceReconstruction, SpaceStep, perpendicular
from jaxwhisker._model.drives import Placement, placement_of
from jaxwhisker._model.scene import Units, units_of
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._scan.blocks import BLOCK, in_blocks
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE

UNTWISTED = ("f1", "f2", "f3", "m1", "m2")
TRIPLET = ("f3", "m1", "m2")
LEVERS = (0.9, 0.6, 0.3)  # lengths: contacts from which the search for that of a triplet starts
SUFFICIENT = (REACTIONS_IN_SPACE, OWN_REACTIONS, UNTWISTED, TRIPLET)
FREE = {6: 22.458, 5: 20.515, 3: 16.266}  # 99.9 % quantiles of chi-squared: signals below may be only noise
# The same with the peaks in place of the noise, if the noise is unknown.
EXACTLY_FREE = 1e-18
# By how much chi-squared has to be smaller on the shaft if that has a parameter more (Akaike), with and without noise:
# signals of scans determine the arc to 1e-8.
HANDICAP, EXACT_HANDICAP = 2.0, 1e-14
PARALLEL = 1e-3  # squared cosine of the angle to the base's tangent of a force that hardly shows the twisting moment
PLACEHOLDER = np.array([-0.8795, 0.0, 0.4758, 0.0, -0.9755, 0.0])  # along d1, d2 and d3 of a bent whisker

Readings = tuple[Float[Array, " steps"], Float[Array, "steps whiskers channels"], Array | None]


def space_sensor(scene: SpaceScene) -> SpaceSensor:
    """The sensor of a scene in space.

    Raises:
        ValueError: if torsion springs connect whiskers.
    """
    for spring in scene.support.springs:
        if 0 not in spring.between and spring.axis.startswith("phi"):
            allowed = "a scene whose torsion springs do not connect whiskers"
            checks.fail("sensor", allowed, f"one between {spring.between}")
    whiskers = tuple(whisker.without_masses() for whisker in scene.whiskers)
    return SpaceSensor(whiskers, scene.support, scene.motion, scene.friction is not None)


def reconstruct_in_space(
    measured: Any, known: SpaceScene, sigma: Any, widened: tuple[Callable, tuple, Any, Any] | None
) -> SpaceReconstruction:
    """Locate contacts in space; see `reconstruct`.

    `widened` are a function that builds the scene, names and values of its arguments, and their covariance.
    """
    sensor = space_sensor(known)
    control, kinds, *signals = _signals(measured, sigma, sensor)
    padding = -control.size % BLOCK  # recordings of similar length share a compilation
    readings = jax.tree.map(
        lambda array: jnp.pad(array, [(0, padding)] + [(0, 0)] * (array.ndim - 1), mode="edge"), (control, *signals)
    )
    if widened is None:
        points = _contacts(jax.tree.map(checks.as_float, sensor), kinds, readings)
    else:
        build, names, values, covariance = widened
        points = _contacts_of_parameters(build, names, values, covariance, kinds, readings)
    points = jax.tree.map(lambda leaf: leaf[: control.size], points)
    length = jnp.asarray(known.whiskers[0].length, dtype=float)
    return SpaceReconstruction(**vars(points), control=control, length=length)


def _signals(measured: Any, sigma: Any, sensor: SpaceSensor):
    """Control, names of the channels, their values and a root of the covariance of their noise; None if exact."""
    whiskers = len(sensor.whiskers)
    traced = checks.is_traced((measured, sigma))
    if traced and (not isinstance(measured, Mapping) or "control" not in measured):
        raise ValueError("`measured` must be a mapping with control and channels within jit, vmap and derivatives.")
    names = {
        str(name).partition("_")[0] for name in (measured if traced else named_values(measured, REACTIONS_IN_SPACE))
    }
    kinds = OWN_REACTIONS if names & set(OWN_REACTIONS) else REACTIONS_IN_SPACE
    if kinds == OWN_REACTIONS and names & set(REACTIONS_IN_SPACE):
        checks.fail("measured", "channels in one frame: fx to mz, or f1 to m3", ", ".join(sorted(names)))
    spread = np.asarray(sigma, dtype=float) if not traced and np.ndim(sigma) == 2 else None
    if traced:
        kinds = tuple(name for name in kinds if name in names)
        _check_sufficient(kinds, sensor)
        control = jnp.asarray(measured["control"], dtype=float)
        shape = control.shape[0], whiskers
        values = jnp.stack([jnp.reshape(jnp.asarray(measured[c], dtype=float), shape) for c in kinds], axis=-1)
        if sigma is None:
            return control, kinds, values, None
        each = sigma if isinstance(sigma, Mapping) else dict.fromkeys(kinds, sigma)
        noise = jnp.stack([jnp.broadcast_to(jnp.asarray(each[c], dtype=float), shape) for c in kinds], axis=-1)
        return control, kinds, values, noise[..., None] * jnp.eye(len(kinds))
    observed = read_observations(measured, None if spread is not None else sigma, whiskers=whiskers, kinds=kinds)
    present = [c for c, name in enumerate(kinds) if observed.known[:, :, c].any()]
    kinds = tuple(kinds[c] for c in present)
    _check_sufficient(kinds, sensor)
    lacking = [c.name for c in channels_of(whiskers, kinds) if not observed.known[:, c.whisker, present[c.kind]].any()]
    if lacking:
        checks.fail("measured", "values of the same channels of every whisker", f"no value of {', '.join(lacking)}")
    if sigma is None and (noise := noise_of(_without_rounding(observed))) is not None:
        observed = observed.with_sigma(noise)
    values, noise = observed.values[:, :, present], observed.sigma[:, :, present]
    root = None if np.isnan(noise).all() else np.nan_to_num(noise, nan=1.0)[..., None] * np.eye(len(kinds))
    if spread is not None:
        root = np.broadcast_to(_root_of(spread, kinds), (*values.shape, len(kinds)))
    return jnp.asarray(observed.control), kinds, jnp.asarray(values), None if root is None else jnp.asarray(root)


def _without_rounding(observed: Observations) -> Observations:
    """Observations in which components that are only rounding are zero, such as the twist of a straight whisker."""
    largest = np.nanmax(np.abs(observed.values), axis=(0, 1), initial=0.0)
    forces = np.array([kind[0] == "f" for kind in observed.kinds])
    ratio = np.array([largest[c] / max(np.max(largest[forces == forces[c]]), 1e-300) for c in range(len(forces))])
    return dataclasses.replace(observed, values=np.where(ratio < TINY_NOISE, 0.0 * observed.values, observed.values))


def _check_sufficient(kinds: tuple[str, ...], sensor: SpaceSensor) -> None:
    """Check that channels determine a contact."""
    if kinds not in SUFFICIENT:
        allowed = (
            "hold fx, fy, fz, mx, my and mz, or along the directors of the base f1, f2, f3, m1, m2 and m3, without m3, "
            "or f3, m1 and m2; others do not tell contacts at the tip from those on the shaft"
        )
        raise ValueError(f"`measured` must {allowed}, got {', '.join(kinds) or 'none of them'}.")
    if kinds == TRIPLET and sensor.friction:
        allowed = "all components of the force for a sensor with friction, whose contacts have four parameters"
        raise ValueError(f"`measured` must hold {allowed}, got {', '.join(kinds)}.")
    if kinds == TRIPLET:
        for k, whisker in enumerate(sensor.whiskers):
            if not callable(whisker.bending_stiffness):
                raise ValueError(
                    "`measured` must hold f1 and f2 for whiskers of constant stiffness: wherever an object touches "
                    "their shaft, the axial force follows from the moment and is |M|^2 / (2 EI) for a straight one, "
                    f"got only {', '.join(kinds)} for whisker {k + 1}."
                )


def _root_of(covariance: np.ndarray, kinds: tuple[str, ...]) -> np.ndarray:
    """Lower triangular root of a covariance of the channels."""
    size = len(kinds)
    if covariance.shape == (size, size) and np.allclose(covariance, covariance.T):
        try:
            return np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            pass
    allowed = f"a symmetric positive definite covariance of {', '.join(kinds)}, ({size}, {size})"
    checks.fail("sigma", allowed, f"shape {covariance.shape}")


class _Prepared(NamedTuple):
    """What the contacts at all steps follow from."""

    known: SpaceInstrument
    unit: Units
    drive: Placement  # fields (steps, ...), dimensionless
    reaction: Float[Array, "steps whiskers channels"]  # dimensionless
    root: Float[Array, "steps whiskers channels channels"]  # of the covariance of their noise


def _prepared(sensor: SpaceSensor, kinds: tuple[str, ...], readings: Readings) -> _Prepared:
    """The sensor and its signals without dimensions: many sensors share the program that follows."""
    control, signals, root = readings
    unit = jax.tree.map(checks.as_float, units_of(sensor.whiskers[0], sensor.motion))
    forces = np.array([kind[0] == "f" for kind in kinds])
    sizes = jnp.where(forces, unit.force, unit.moment)
    reaction = signals / sizes
    if root is None:
        largest = jnp.max(jnp.nan_to_num(jnp.abs(jax.lax.stop_gradient(reaction))), axis=0)
        peaks = jnp.stack([jnp.max(largest[:, forces == kind], axis=1) for kind in forces], axis=1)
        peaks = jnp.broadcast_to(jnp.where(peaks > 0, peaks, 1.0), reaction.shape)
        root = peaks[..., None] * jnp.eye(len(kinds))
    else:
        root = root / sizes[:, None]
    drive = jax.vmap(lambda u: placement_of(sensor.motion, u))(control)
    drive = drive._replace(position=drive.position / unit.length)
    return _Prepared(space_instrument(sensor, unit, kinds != REACTIONS_IN_SPACE), unit, drive, reaction, root)


def _located(prepared: _Prepared, kinds: tuple[str, ...], noisy: Bool[Array, ""]) -> SpaceStep:
    known, unit, *each = prepared
    return jax.vmap(lambda *at: _step(known, unit, kinds, noisy, *at))(*each)


_prepared_now, _located_now = Program(_prepared), Program(_located)


def _contacts_of_parameters(build, names, values, covariance, kinds, readings) -> SpaceStep:
    """The points, with the uncertainty of the parameters added to their covariance."""

    def at(values):
        sensor = space_sensor(build(**dict(zip(names, values, strict=True))))
        points = _contacts(jax.tree.map(checks.as_float, sensor), kinds, readings)
        parts = points.x, points.y, points.z, points.arc, points.force_x, points.force_y, points.force_z
        return jnp.stack(parts, axis=-1), points

    by_values, points = jax.jacfwd(at, has_aux=True)(values)
    of_values = jnp.einsum("...ip,pq,...jq->...ij", by_values, covariance, by_values)
    of_noise = jnp.zeros(()) if readings[2] is None else points.covariance
    return dataclasses.replace(points, covariance=of_values + of_noise)


def _contacts(sensor: SpaceSensor, kinds: tuple[str, ...], readings: Readings) -> SpaceStep:
    known, unit, *each = _prepared_now(sensor, kinds, readings)
    noisy = np.asarray(readings[2] is not None)

    def block(*some):
        return _located_now(_Prepared(known, unit, *some), kinds, noisy)

    return in_blocks(block, tuple(each), BLOCK)


def _step(
    known: SpaceInstrument,
    unit: Units,
    kinds: tuple[str, ...],
    noisy: Bool[Array, ""],
    drive: Placement,
    reaction: Float[Array, "whiskers channels"],
    root: Float[Array, "whiskers channels channels"],
) -> SpaceStep:
    """Contacts of all whiskers at one step, computed without dimensions and given in the sensor's units."""
    missing = jnp.any(jnp.isnan(reaction), axis=-1)
    missing = missing | jnp.any(known.coupled & missing, axis=-1)
    bent = jnp.broadcast_to(PLACEHOLDER, (missing.size, 6))
    if not known.own:
        upright = known.directors(drive, 0 * bent)
        bent = jax.vmap(lambda directors, bent: in_frame(directors.T, bent))(upright, bent)
    places = np.array([(OWN_REACTIONS if known.own else REACTIONS_IN_SPACE).index(kind) for kind in kinds])
    root = jnp.where(missing[:, None, None], jnp.eye(len(kinds)), root)
    whiten = jax.vmap(inverse)(root)

    def white(reaction):
        return jnp.sum(whiten * reaction[:, None, :], axis=-1)

    measured = jnp.where(missing[:, None], 0.0, reaction)
    significance = jnp.sum(white(measured) ** 2, axis=-1)
    touching = ~missing & ~(significance < jnp.where(noisy, FREE[len(kinds)], EXACTLY_FREE))
    fitted = jnp.where(touching[:, None], measured, bent[:, places])
    six = jnp.zeros((missing.size, len(kinds), 6)).at[:, :, places].set(whiten)
    complete = jax.vmap(lambda values, length: _complete(kinds, values, length))
    handicap = jnp.full(missing.size, jnp.where(noisy, HANDICAP, EXACT_HANDICAP))
    found = known.locate(drive, (white(fitted), six, complete(fitted, known.length), handicap))
    ok, values = touching & found.ok, found.values
    force = jnp.where(ok[:, None], values[:, 4:7], 0.0)
    base = known.bases(drive, force)
    as_measured = known.directors(drive, complete(measured, known.length)[:, 0])
    directors = jnp.where(ok[:, None, None], values[:, 10:].reshape(-1, 3, 3), as_measured)
    sizes = jnp.concatenate([jnp.broadcast_to(unit.length, 4), jnp.broadcast_to(unit.force, 3)])
    contact = jnp.concatenate([base + values[:, :3], values[:, 3:7]], axis=1) * sizes
    contact = jnp.where(ok[:, None], contact, jnp.nan).T
    at_base = jnp.where(missing[:, None], jnp.nan, base * unit.length).T
    covariance = known.covariance(drive, found, ok) * sizes[:, None] * sizes
    cosine, score = perpendicular(measured, root, missing) if len(kinds) == 6 else [jnp.full(missing.size, jnp.nan)] * 2
    if_noisy = jnp.where(noisy, 1.0, jnp.nan)
    codes = [PointStatus.missing, PointStatus.free, PointStatus.failed]
    return SpaceStep(
        *contact,
        tangent=jnp.where(ok[:, None], values[:, 7:10], jnp.nan),
        phase=jnp.where(ok, jnp.where(found.tip, Phase.tip, Phase.tangential), Phase.free),
        base_x=at_base[0],
        base_y=at_base[1],
        base_z=at_base[2],
        base_rotation=jnp.where(missing[:, None, None], jnp.nan, directors),
        chi2=jnp.where(ok, found.chi2, jnp.nan) * if_noisy,
        significance=jnp.where(missing, jnp.nan, jnp.sqrt(jnp.where(missing, 1.0, significance))) * if_noisy,
        force_moment=cosine,
        force_moment_score=score * if_noisy,
        status=jnp.select([missing, ~touching, ~ok], codes, PointStatus.ok),
        covariance=jnp.where(ok[:, None, None], covariance, jnp.nan) * if_noisy,
    )


def _complete(kinds: tuple[str, ...], values: Float[Array, " channels"], length: Scalar) -> Float[Array, "starts 6"]:
    """All six reactions, from which the search for a contact starts."""
    if len(kinds) == 6:
        return values[None]
    if kinds == UNTWISTED:
        force, bending = values[:3], values[3:]
        sine = jnp.sum(force[:2] * bending)
        twisting = -sine * force[2] / (force[2] ** 2 + PARALLEL * jnp.sum(force**2))
        return jnp.append(values, twisting)[None]
    # As if the whisker were straight to where the object touches it.
    axial, first, second = values
    starts = [(second / at, -first / at, axial, first, second, jnp.zeros(())) for at in np.array(LEVERS) * length]
    return jnp.stack([jnp.stack(start) for start in starts])
