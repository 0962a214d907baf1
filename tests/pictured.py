"""Scans and made-up studies for tests of figures."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr

import jaxwhisker as jw

CONTROL = np.linspace(0.72, -1.62, 235)
ANGLES = np.linspace(-0.45, 0.7, 116)
MIDDLE = -0.5


def coupled():
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0), rod=jw.ClosedForm())


def turning():
    """A leaning whisker whose base has springs along all axes, on a rotating drive."""
    support = jw.Support.follicle(80.0, 200.0, 10.0, mount=jw.Mount(0.0, 0.1, 0.2))
    motion = jw.Rotation((0.0, -0.5), 0.3)
    return jw.Scene(jw.Whisker(), jw.Circle(0.6, 0.4), support, rod=jw.ClosedForm(), motion=motion)


def of_steps(result, steps):
    """A result with some of a scan's steps, in any order."""
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    whole = {name: fields.pop(name) for name in ("events", "scene")}
    return jw.Result(**{name: jnp.asarray(field)[steps] for name, field in fields.items()}, **whole)


def failed(result, steps):
    """The same result with failed steps."""

    def fail(leaf):
        return leaf.at[steps].set(jnp.nan) if eqx.is_inexact_array(leaf) else leaf.at[steps].set(0)

    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    kept = {name: fields.pop(name) for name in ("control", "status", "events", "scene")}
    kept["status"] = kept["status"].at[steps].set(jw.Status.lost)
    return jw.Result(**{name: fail(field) for name, field in fields.items()}, **kept)


def there_and_back(result):
    """A scan that reverses at its last step and returns through the same states."""
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
    """Steepness with a critical stiffness of 43.2 at a distance of 0.2, higher for nearer objects."""
    return (8.64 / data.distance / data.stiffness).transpose("stiffness", "distance")
