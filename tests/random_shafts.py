"""Random scenes of a whisker with springs on its shaft, and their scans; checked by independent_shaft.py."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from independent_shaft import Held

import jaxwhisker as jw

AXES = ("axial", "x")
CONTROL = np.linspace(2.5, -3.0, 65)  # from before the first touch to beyond the object
OPTIONS = {"xla_backend_optimization_level": 1}  # more takes longer to compile than it saves


def drawn(count: int, rng: np.random.Generator) -> Held:
    """Random numbers: an axial spring above the base, one along x above or below, and one at the base.

    They disagree, and bend almost every whisker before it touches anything.
    """

    def sizes(low: float, high: float, *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), (count, *shape)))

    def some(share: float, *values: np.ndarray | float) -> np.ndarray:
        return np.where(rng.random(count) < share, *values)

    at = np.stack([rng.uniform(0.0, 0.3, count), some(0.5, rng.uniform(-0.2, 0, count), rng.uniform(0, 0.3, count))], 1)
    rest = rng.uniform(0.05, 0.4, count)
    base_rest = rest + some(0.7, rng.uniform(-0.1, 0.1, count), 0.0)
    across = some(0.5, base_rest + rng.uniform(-0.05, 0.05, count), rng.uniform(-0.3, 0.3, count))
    anchor_x = np.stack([some(0.4, rng.uniform(-0.1, 0.05, count), 0.0), np.zeros(count)], 1)
    anchor_y = at + np.stack([some(0.4, rng.uniform(-0.1, 0.1, count), 0.0), np.zeros(count)], 1)
    return Held(
        at,
        AXES,
        anchor_x,
        anchor_y,
        stiffness=sizes(5, 500, 2),
        rest_length=np.stack([rest, across], 1),
        base_stiffness=sizes(5, 300),
        base_rest=base_rest,
        distance=rng.uniform(0.2, 0.8, count),
        a=sizes(0.2, 5),
    )


def scene_of(held: Held) -> jw.Scene:
    """The scene of one element of a batch."""
    given: Any = held  # numbers, not arrays of many scenes
    springs = [jw.Spring((0, 1), given.base_stiffness, given.base_rest)]
    for k, axis in enumerate(held.axis):
        anchor, numbers = (given.anchor_x[k], given.anchor_y[k]), (given.stiffness[k], given.rest_length[k])
        springs.insert(k, jw.Spring((0, 1), *numbers, axis=axis, at=given.at[k], anchor=anchor))
    profile = jw.Parabola(given.distance, given.a)
    return jw.Scene(jw.Whisker(), profile, jw.Support(tuple(springs)), detect="second_contact")


def scans():
    """Compiled function: all scans of drawn scenes, one after the other."""

    def one(numbers):
        return jw.scan(scene_of(Held(numbers[0], AXES, *numbers[1:])), jnp.asarray(CONTROL))

    run = jax.jit(lambda numbers: jax.lax.map(one, numbers), compiler_options=OPTIONS)
    return lambda held: run(tuple(jnp.asarray(part) for name, part in held._asdict().items() if name != "axis"))
