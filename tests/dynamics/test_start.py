"""The state from which a simulation starts must be one of its scene."""

# pyright: reportArgumentType=false
import jax
import numpy as np
import pytest

import jaxwhisker as jw
from scenes import model

# Those of `test_simulate.py`, whose program this file shares.
STEPS, DAMPING = 1200, 0.02


@pytest.mark.parametrize(
    ("change", "off"),
    [
        ({"drive": 0.3}, 1.2),  # the spring is longer by 0.2: 70 * 0.2^2 / 2 is 1.4
        ({"distance": 0.25}, 0.03),
        ({"stiffness": 10.0}, 0.2),
        ({"bending_stiffness": 2.0}, 0.1),
    ],
)
def test_start_of_another_scene(change, off):
    start = jw.scan(model("FB"), np.array([0.5, 0.1]))
    given = {"drive": 0.1, "distance": 0.2, "stiffness": 70.0, "bending_stiffness": 1.0} | change

    def run(distance):
        whisker = jw.Whisker(1.0, given["bending_stiffness"], mass_per_length=1.0)
        scene = jw.Scene(whisker, jw.Parabola(distance), jw.Support.fb(given["stiffness"], rest_length=0.2))
        drive = np.full(2, given["drive"])
        return jw.simulate(scene, drive, 3.0, start=start, steps=STEPS, every=10, stiffness_damping=DAMPING)

    with pytest.raises(ValueError, match=r"`start` must be a state of these whiskers .*, got one that is off by") as e:
        run(given["distance"])
    assert float(str(e.value).split("off by ")[1].split()[0]) > off
    traced = jax.vmap(run)(np.full(2, given["distance"]))
    np.testing.assert_array_equal(traced.status, jw.Status.invalid)
