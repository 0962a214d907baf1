"""Reconstruction in space: sensors, and the channels from which a contact can be located.

The reactions are six, in the scene's frame or along the directors of the displaced base. Those of a contact at a point
satisfy force . moment = 0, and without friction they have three parameters in each phase. Fewer channels suffice if
they determine the contact:

- A straight round whisker has no twisting moment, and that of a curved one follows from force . moment = 0.
- The axial force and the bending moment determine the contact of a whisker whose stiffness varies along it. For others
  the axial force in tangential contact follows from the moment: it is |M|^2 / (2 EI) for a straight one.
"""

import dataclasses
from collections.abc import Mapping

import jax
import numpy as np

from jaxwhisker._base import checks
from jaxwhisker._inverse.features import TINY_NOISE, with_scatter
from jaxwhisker._inverse.inverse_rod_space import NUMBERS, UNTWISTED, SpaceSensor, space_instrument
from jaxwhisker._inverse.mechanics import InverseMechanics, Readings
from jaxwhisker._inverse.observations import OWN_REACTIONS, Observations, channels_of, named_values, read_observations
from jaxwhisker._inverse.points import SpaceReconstruction
from jaxwhisker._model.drives import placement_of
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._scan.quantities import REACTIONS_IN_SPACE

TRIPLET = ("f3", "m1", "m2")
SUFFICIENT = (REACTIONS_IN_SPACE, OWN_REACTIONS, UNTWISTED, TRIPLET)


class InverseSpace(InverseMechanics):
    """Whiskers in space."""

    result, numbers = SpaceReconstruction, NUMBERS
    correlated = shared = True

    @staticmethod
    def sensor(made):
        return space_sensor(made)

    @classmethod
    def read(cls, measured, sigma, sensor, base, slip):
        if base is not None:
            checks.fail("base", "None in space", "poses")
        if slip is not None:
            checks.fail("slip", "None in space, where the direction of the force is measured", "one")
        whiskers, traced = len(sensor.whiskers), checks.is_traced((measured, sigma))
        if traced and (not isinstance(measured, Mapping) or "control" not in measured):
            raise ValueError("`measured` must be a mapping with control and channels within jit, vmap and derivatives.")
        table = measured if traced else named_values(measured, REACTIONS_IN_SPACE)
        names = {str(name).partition("_")[0] for name in table}
        kinds = _in_one_frame(names)
        if traced:
            kinds = tuple(name for name in kinds if name in names)
            _check_sufficient(kinds, sensor)
            return kinds, Readings.traced(measured, sigma, kinds, whiskers)
        spread = np.asarray(sigma, dtype=float) if np.ndim(sigma) == 2 else None
        observed = read_observations(measured, None if spread is not None else sigma, whiskers=whiskers, kinds=kinds)
        observed = _sufficient(observed, sensor)
        observed = with_scatter(observed, _without_rounding(observed)) if sigma is None else observed
        readings = Readings.of(observed)
        if spread is not None:
            root = _root_of(spread, observed.kinds)
            readings = readings._replace(noise=np.broadcast_to(root, (*readings.signals.shape, len(root))))
        return observed.kinds, readings

    @staticmethod
    def parts(sensor):
        return (sensor,)

    @staticmethod
    def dimensionless(sensor, unit, kinds, readings):
        drive = jax.vmap(lambda u: placement_of(sensor.motion, u))(readings.control)
        drive = drive._replace(position=drive.position / unit.length)
        return space_instrument(sensor, unit, kinds), drive, None, None


def space_sensor(scene: SpaceScene) -> SpaceSensor:
    """The sensor of a scene in space.

    Raises:
        ValueError: if torsion springs connect whiskers, or these have a weight.
    """
    if scene.gravity is not None:
        checks.fail("sensor", "a scene without gravity", str(scene))
    for spring in scene.support.springs:
        if 0 not in spring.between and spring.axis.startswith("phi"):
            allowed = "a scene whose torsion springs do not connect whiskers"
            checks.fail("sensor", allowed, f"one between {spring.between}")
    whiskers = tuple(whisker.without_masses() for whisker in scene.whiskers)
    return SpaceSensor(whiskers, scene.support, scene.motion, scene.friction is not None)


def _in_one_frame(names: set[str]) -> tuple[str, ...]:
    """All channels in the frame of those with these names: the scene's, or that of the base."""
    own = names & set(OWN_REACTIONS)
    if own and names & set(REACTIONS_IN_SPACE):
        checks.fail("measured", "channels in one frame: fx to mz, or f1 to m3", ", ".join(sorted(names)))
    return OWN_REACTIONS if own else REACTIONS_IN_SPACE


def _sufficient(observed: Observations, sensor: SpaceSensor) -> Observations:
    """The channels that hold a value, which must be the same of every whisker and determine its contact."""
    present = [c for c in range(len(observed.kinds)) if observed.known[:, :, c].any()]
    values, sigma = observed.values[:, :, present], observed.sigma[:, :, present]
    kinds = tuple(observed.kinds[c] for c in present)
    _check_sufficient(kinds, sensor)
    known = np.any(np.isfinite(values), axis=0)
    lacking = [c.name for c in channels_of(len(known), kinds) if not known[c.whisker, c.kind]]
    if lacking:
        checks.fail("measured", "values of the same channels of every whisker", f"no value of {', '.join(lacking)}")
    return dataclasses.replace(observed, values=values, sigma=sigma, kinds=kinds)


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
