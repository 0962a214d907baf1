"""Identification and information in space: parameters from the signals of an independent reference."""

# pyright: reportArgumentType=false

import json
from pathlib import Path

import numpy as np
import pytest

import jaxwhisker as jw

REFERENCE = 1e-6  # the reference gives ten digits
NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
CASES = json.loads((Path(__file__).parents[1] / "data" / "space_points.json").read_text("utf-8"))["cases"]


def reference(name):
    """The signals of a case of the reference, in the order of a scan."""
    (row,) = [row for row in CASES if row["name"] == name]
    states = row["states"]
    reactions = np.concatenate([states["force"], states["moment"]], axis=1)
    return {"control": np.array(states["u"])} | dict(zip(NAMES, reactions.T, strict=True))


def clamped(offset, distance):
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, distance + 1.0, 0.0)), motion=drive)


def sprung(offset, stiffness):
    springs = [jw.Spring((0, 1), c, axis=axis) for axis, c in zip("xyz", (stiffness, 300.0, 8.0), strict=True)]
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.0)), jw.Support(tuple(springs)), motion=drive)


def bent(curvature, roll):
    mount = jw.Mount(roll=roll)
    hair = jw.Whisker(intrinsic_curvature=curvature, torsion_ratio=2 / 3)
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    return jw.SpaceScene(hair, jw.Sphere(1.0, (0.0, 1.3, 0.0)), jw.Support(mount=mount), motion=drive)


@pytest.mark.parametrize(
    ("name", "build", "truth", "guess"),
    [
        ("S1 sphere offset 0.2", clamped, {"offset": 0.2, "distance": 0.3}, {"offset": 0.15, "distance": 0.35}),
        (
            "S2 sphere offset 0.2 springs (30, 300, 8)",
            sprung,
            {"offset": 0.2, "stiffness": 30.0},
            {"offset": 0.25, "stiffness": 40.0},
        ),
        (
            "S4 arc kappa 0.8 roll 60 C/B 0.667 offset 0.1",
            bent,
            {"curvature": 0.8, "roll": np.pi / 3},
            {"curvature": 0.6, "roll": 0.9},
        ),
    ],
)
def test_parameters_follow_from_the_signals_of_the_reference(name, build, truth, guess):
    fit = jw.identify(build, guess, reference(name), sigma=1e-6)
    assert fit.status == jw.FitStatus.ok, str(fit)
    for key, value in truth.items():
        assert abs(fit.estimates[key] - value) < REFERENCE * max(1.0, value), str(fit)
