"""Random scenes of every kind, with log-uniform sizes, and their scans; checked by independent.py."""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from independent import Mechanics

import jaxwhisker as jw

STEPS = 64
LEG = 16  # steps between two reversals
COEFFICIENTS = 0.01, 2.0  # range of coefficients of friction
NETWORKS = {
    "clamped": (),
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "FBFBFBR": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
    "four": ((0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (1, 3)),
}
PROFILES = {"parabola": ("distance", "a"), "circle": ("distance", "radius"), "ellipse": ("distance", "a", "b")}


class Drawn(NamedTuple):
    """Parameters of scenes of one kind; leading axis: scenes."""

    profile: dict[str, np.ndarray]
    stiffness: np.ndarray  # (scenes, springs)
    rest_length: np.ndarray
    length: np.ndarray  # (scenes, whiskers)
    bending_stiffness: np.ndarray
    control: np.ndarray  # (scenes, steps)
    friction: np.ndarray | None = None  # coefficients


def drawn(network: str, profile: str, count: int, rng: np.random.Generator) -> Drawn:
    """Random parameters: lengths and bending stiffnesses from micro to kilo, others relative to the first whisker."""
    springs = NETWORKS[network]
    n = max([1, *[end for pair in springs for end in pair]])

    def sizes(low, high, *shape):
        return 10 ** rng.uniform(low, high, (count, *shape))

    length, unit = sizes(-6, 3), sizes(-9, 3)
    shape = {name: sizes(-1.5, 1.5) for name in PROFILES[profile]}
    shape["distance"] = sizes(-2, -0.02)
    for name, value in shape.items():
        shape[name] = value / length if (profile, name) == ("parabola", "a") else value * length
    ends = np.full(count, 1.0), rng.uniform(-4.0, -2.0, count)
    shift = shape["a"] / length if profile == "ellipse" else 0.0
    rest = rng.uniform(0.0, 0.5, (count, len(springs)))
    reach = np.minimum(ends[0] + shift + 2.0, 6.0), ends[1] - np.sum(rest, axis=1)
    steps = np.linspace(0, 1, STEPS)
    return Drawn(
        shape,
        sizes(-2, 6, len(springs)) * (unit / length**3)[:, None],
        rest * length[:, None],
        length[:, None] * np.append(np.ones((count, 1)), sizes(-0.2, 0.2, n - 1), axis=1),
        unit[:, None] * np.append(np.ones((count, 1)), sizes(-1, 1, n - 1), axis=1),
        length[:, None] * (reach[0][:, None] + (reach[1] - reach[0])[:, None] * steps),
    )


def reversing(network: str, profile: str, count: int, rng: np.random.Generator) -> Drawn:
    """Random parameters with coefficients of friction, log-uniform, and a drive that reverses four times."""
    p = drawn(network, profile, count, rng)
    friction = np.exp(rng.uniform(np.log(COEFFICIENTS[0]), np.log(COEFFICIENTS[1]), count))
    ends = [np.zeros(count)]
    for way in (1, -1, 1, -1, 3):
        ends.append(np.clip(ends[-1] + way * rng.uniform(0.02, 0.6, count), 0, 1))
    legs = [a + (b - a) * np.arange(1, LEG + 1)[:, None] / LEG for a, b in pairwise(ends)]
    share = np.concatenate([ends[0][None], *legs]).T
    first, last = p.control[:, :1], p.control[:, -1:]
    return p._replace(control=first + (last - first) * share, friction=friction)


def mechanics(network: str, profile: str, p: Drawn) -> Mechanics:
    """The mechanics for independent.py, with flexibility and rest positions from the energy of the springs."""
    springs = NETWORKS[network]
    count, n = p.length.shape
    stiffness, pull = np.zeros((count, n, n)), np.zeros((count, n))
    for number, ends in enumerate(springs):
        direction = np.zeros(n)
        for end, sign in zip(ends, (-1, 1), strict=True):
            if end:
                direction[end - 1] = sign
        stiffness += p.stiffness[:, number, None, None] * np.outer(direction, direction)
        pull += (p.stiffness[:, number] * p.rest_length[:, number])[:, None] * direction
    if not springs:
        return Mechanics(profile, p.profile, p.length, p.bending_stiffness, stiffness, pull)
    flexibility = np.linalg.inv(stiffness)
    offset = np.linalg.solve(stiffness, pull[..., None])[..., 0]
    return Mechanics(profile, p.profile, p.length, p.bending_stiffness, flexibility, offset)


def scene_of(network: str, profile: str, p: Drawn, rod: jw.AbstractRod) -> jw.Scene:
    """The scene of one element of drawn parameters."""
    make = {"parabola": jw.Parabola, "circle": jw.Circle, "ellipse": jw.Ellipse}[profile]
    whiskers = tuple(jw.Whisker(p.length[i], p.bending_stiffness[i]) for i in range(p.length.shape[0]))
    springs = tuple(jw.Spring(ends, p.stiffness[i], p.rest_length[i]) for i, ends in enumerate(NETWORKS[network]))
    friction = None if p.friction is None else jnp.asarray(p.friction)
    return jw.Scene(whiskers, make(**p.profile), jw.Support(springs), rod, friction=friction)


def scans(network: str, profile: str, rod: jw.AbstractRod):
    """Compiled function: all scans of drawn parameters."""

    def one(p: Drawn):
        return jw.scan(scene_of(network, profile, p, rod), p.control)

    # Optimised, unlike other programs of tests, because this computes for longer than it compiles.
    options = {"xla_backend_optimization_level": 3}
    return jax.jit(lambda p: jax.vmap(one)(jax.tree.map(jnp.asarray, p)), compiler_options=options)
