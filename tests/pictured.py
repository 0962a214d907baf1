"""Scans, and made-up studies, fits and reconstructions, that figures and films of the tests show."""

import json
import struct
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import jaxwhisker as jw
from jaxwhisker._explore.picture import DTYPES
from jaxwhisker._inverse.fit import FittedRecording
from jaxwhisker._inverse.information import EventInformation
from jaxwhisker._inverse.observations import Observations

CONTROL = np.linspace(0.72, -1.62, 235)
ANGLES = np.linspace(-0.45, 0.7, 116)
MIDDLE = -0.5
FILM_STEPS = 40  # frames for the steps of a scan
LENGTH, STIFFNESS = 0.05, 2.4e-5  # of a whisker in SI units: m, N m^2; EI/L^2 = 9.6 mN, EI/L = 480 mN mm


def coupled(length=1.0, bending_stiffness=1.0):
    """Two whiskers with feedback; the same scene in all units."""
    whisker = jw.Whisker(length, bending_stiffness)
    support = jw.Support.fbfbr(70.0 * bending_stiffness / length**3, 0.2 * length)
    return jw.Scene(whisker, jw.Parabola(0.2 * length, 1 / length), support, rod=jw.ClosedForm())


SCENE = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0))


def turning():
    """A base that moves along all axes, on an oblique mount, on a drive that rotates."""
    support = jw.Support.follicle(80.0, 200.0, 10.0, mount=jw.Mount(0.0, 0.1, 0.2))
    motion = jw.Rotation((0.0, -0.5), 0.3)
    return jw.Scene(jw.Whisker(), jw.Circle(0.6, 0.4), support, rod=jw.ClosedForm(), motion=motion)


def of_steps(result, steps):
    """A result with some of a scan's steps, in any order."""
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    whole = {name: fields.pop(name) for name in ("deferred_events", "scene")}
    return jw.Result(**jax.tree.map(lambda field: jnp.asarray(field)[steps], fields), **whole)


def failed(result, steps):
    """The same result with failed steps."""

    def fail(leaf):
        return leaf.at[steps].set(jnp.nan) if eqx.is_inexact_array(leaf) else leaf.at[steps].set(0)

    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    kept = {name: fields.pop(name) for name in ("control", "status", "deferred_events", "scene")}
    kept["status"] = kept["status"].at[steps].set(jw.Status.lost)
    return jw.Result(**jax.tree.map(fail, fields), **kept)


def swept(stiffness=70.0, length=1.0, bending_stiffness=1.0):
    """A simulated sweep across the object, in a unit of time of 0.5; the same motion in all units."""
    whisker = jw.Whisker(length, bending_stiffness, mass_per_length=0.25 * bending_stiffness / length**4)
    support = jw.Support.fb(stiffness * bending_stiffness / length**3, 0.2 * length)
    scene = jw.Scene(whisker, jw.Parabola(0.2 * length, 1 / length), support)
    drive = length * np.array([0.75, -1.6])
    return jw.simulate(scene, drive, 3.0, steps=300, every=3, stiffness_damping=0.05, shapes=5)


def failed_motion(motion, first):
    """The same simulation, which fails at a sample."""

    def fail(leaf):
        return leaf.at[first:].set(jnp.nan if eqx.is_inexact_array(leaf) else 0)

    fields = {name: getattr(motion, name) for name in jw.Simulation.__dataclass_fields__}
    kept = {name: fields.pop(name) for name in ("status", "events", "scene")}
    kept["status"] = kept["status"].at[first:].set(jw.Status.lost)
    return jw.Simulation(**jax.tree.map(fail, fields), **kept)


def there_and_back(result):
    """A scan whose drive reverses at its last step and passes through the same states."""
    steps = np.r_[0 : result.control.size, result.control.size - 2 : -1 : -1]
    return of_steps(result, steps)


def summarised():
    """A made-up summary of a study over stiffness and distance."""
    stiffness, distance = np.linspace(30.0, 90.0, 7), np.array([0.1, 0.2, 0.3])
    peak = 1.2 / np.sqrt(distance)[:, None] + 0.3 * np.log(stiffness / 30.0)
    data = xr.Dataset(
        {"max_mz": (("stiffness", "distance", "whisker"), np.stack([peak.T, 0.9 * peak.T], axis=2))},
        {
            "stiffness": ("stiffness", stiffness, {"long_name": "stiffness", "units": "EI/L^3"}),
            "distance": ("distance", distance, {"long_name": "distance", "units": "L"}),
            "whisker": [1, 2],
        },
    )
    data.max_mz.attrs = {"long_name": "largest mz", "units": "EI/L"}
    return data


def steepness(data):
    """A made-up steepness: 43.2 is critical at a distance of 0.2, and more at smaller distances."""
    return (8.64 / data.distance / data.stiffness).transpose("stiffness", "distance")


def some_information(scene=SCENE):
    """Made-up information on a stiffness and a distance."""
    control = np.linspace(0.7, -1.4, 64)
    rates = np.stack([np.exp(-((control + 0.5) ** 2)), np.exp(-8 * (control + 1.0) ** 2)], axis=1)[:, None, :]
    event = EventInformation(jw.EventKind.vertex, (1,), -0.5, np.zeros(2), np.inf)
    return jw.Information(
        ("c", "q"), {"c": 70.0, "q": 0.2}, control, ("mz",), rates, (event,), np.array([True, True]), scene
    )


def some_fit(result):
    """A made-up fit with small residuals."""
    values = np.stack([np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")], axis=-1)
    measured = Observations(np.asarray(result.control), values + 0.3 * np.sin(40 * values), np.ones(values.shape))
    recording = FittedRecording(measured, values, measured.values - values, {}, result.scene)
    known = {"status": jw.FitStatus.ok, "names": (), "recordings": (recording,)}
    return jw.Fit(**dict.fromkeys(jw.Fit.__dataclass_fields__) | known)  # pyright: ignore[reportArgumentType]


def some_points(length=1.0):
    """Points of a parabola, seen by a whisker of this length; the last one is lost in noise."""
    x = jnp.linspace(-0.8, 0.8, 33)[:, None]
    one, covariance = jnp.ones_like(x), jnp.zeros((*x.shape, 4, 4)).at[..., [0, 1], [0, 1]].set(4e-4)
    point = {"x": x, "y": 0.2 + x**2, "slope": jnp.arctan(2 * x), "phase": jnp.ones(x.shape, int)}
    state = {"status": jnp.zeros(x.shape, int), "significance": 100 * one.at[-1].set(0.01), "covariance": covariance}
    fields = dict.fromkeys(jw.Reconstruction.__dataclass_fields__, one) | point | state | {"control": x[:, 0]}
    fields |= {"length": jnp.asarray(length)}
    return jw.Reconstruction(**fields)  # pyright: ignore[reportArgumentType]


def unpacked(reply: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of the bytes that a page draws."""
    (length,) = struct.unpack_from("<I", reply)
    header, start, arrays = json.loads(reply[4 : 4 + length]), 4 + length, {}
    for name, dtype, shape in header["arrays"]:
        arrays[name] = np.frombuffer(reply, DTYPES[dtype], int(np.prod(shape)), start).reshape(shape)
        start += arrays[name].nbytes
    return header, arrays


def snaps(result):
    """Numbers of the events that are snaps."""
    return [k for k, event in enumerate(result.events) if event.kind >= jw.EventKind.snap_through]


def row(tree, k):
    """Row or rows of all leaves of a tree."""
    return jax.tree.map(lambda leaf: leaf[k], tree)


def ends_moved(lines):
    """Largest motion of a base or tip between consecutive lines."""
    return np.hypot(np.diff(lines.x, axis=0), np.diff(lines.y, axis=0))[..., [0, -1]].max(axis=(1, 2))


def past_ball(steps=61):
    """A scan in space: a wire on springs along x and z slides around a ball beside its path; SI units."""
    wire = jw.Whisker.from_material(length=LENGTH, youngs_modulus=2.1e11, diameter=2e-4)
    scene = jw.Scene(wire, jw.Sphere(0.04, (0.0, 0.06, 0.01)), jw.Support.follicle(x=40.0, z=20.0))
    return jw.scan(scene, np.linspace(0.039, -0.039, steps))
