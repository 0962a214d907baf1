"""A study in a separate process, for tests that kill it: python study_child.py STORE."""

import sys
from typing import Any

import numpy as np

import jaxwhisker as jw

CONTROL = np.linspace(0.7, -1.5, 30)
AXES: dict[str, Any] = {
    "stiffness": np.append(np.linspace(60.0, 200.0, 31), -1.0),
    "distance": np.array([0.2, 0.25, 0.3, 0.35]),
}


def build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness))


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    jw.study(build, control=CONTROL, store=sys.argv[1], **AXES)
