"""Ordinary scenes with friction: plain whiskers on springs as in experiments, one kind for each combination of parts.

Extreme random scenes hide how often an ordinary one fails. All scenes of a kind have one problem shape.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw

STEPS = 33


class Kind(NamedTuple):
    """A kind of scenes: its support with random springs, and ranges of its other numbers."""

    springs: int  # number of random stiffnesses
    stiffness: tuple[float, float]
    friction: tuple[float, float]
    distance: tuple[float, float]
    control: tuple[float, float]
    curvature: tuple[float, float] | None = None


KINDS = {
    "two whiskers": Kind(2, (10.0, 1000.0), (0.05, 0.6), (0.05, 0.6), (1.2, -5.0)),
    "weak friction": Kind(1, (70.0, 200.0), (0.01, 0.13), (0.2, 0.3), (1.2, -5.0)),
    "feedback": Kind(3, (10.0, 1000.0), (0.05, 0.6), (0.05, 0.6), (1.2, -5.0)),
    "three whiskers": Kind(5, (10.0, 1000.0), (0.05, 0.6), (0.05, 0.6), (1.2, -6.0)),
    "curved": Kind(1, (10.0, 1000.0), (0.05, 0.6), (0.1, 0.5), (1.3, -3.0), (0.02, 0.5)),
    "follicle": Kind(3, (10.0, 1000.0), (0.05, 0.6), (0.1, 0.5), (1.2, -3.0)),
    "curved follicle": Kind(3, (10.0, 1000.0), (0.05, 0.6), (0.1, 0.5), (1.3, -3.0), (0.02, 0.5)),
    "rotation": Kind(1, (10.0, 1000.0), (0.05, 0.6), (0.3, 0.6), (-1.5, 1.5)),
    "shaft spring": Kind(2, (10.0, 1000.0), (0.05, 0.6), (0.1, 0.5), (1.2, -3.0)),
}


class Drawn(NamedTuple):
    """Numbers of scenes of one kind; leading axis: scenes."""

    stiffness: Any  # (scenes, springs)
    friction: Any
    distance: Any
    curvature: Any


def drawn(kind: str, count: int, seed: int = 0) -> Drawn:
    """Random numbers: stiffnesses log-uniform, the others uniform."""
    k, rng = KINDS[kind], np.random.default_rng([seed, list(KINDS).index(kind)])
    soft, stiff = np.log(k.stiffness)
    stiffness = np.exp(rng.uniform(soft, stiff, (count, k.springs)))
    friction, distance = rng.uniform(*k.friction, count), rng.uniform(*k.distance, count)
    return Drawn(stiffness, friction, distance, rng.uniform(*(k.curvature or (0.0, 0.0)), count))


def control_of(kind: str) -> np.ndarray:
    """Drive positions: one way, right across the object."""
    return np.linspace(*KINDS[kind].control, STEPS)


def scene_of(kind: str, p: Drawn) -> jw.Scene:
    """The scene of one element of drawn numbers."""
    c, motion, support = p.stiffness, jw.Translation(), None
    whisker = jw.Whisker(intrinsic_curvature=p.curvature) if KINDS[kind].curvature else jw.Whisker()
    if kind == "two whiskers":
        support = jw.Support.fbfb([c[0], c[1]], 0.2)
    elif kind == "weak friction":
        support = jw.Support.fbfbr(c[0], 0.2)
    elif kind == "feedback":
        support = jw.Support.fbfbr([c[0], c[1], c[2]], 0.2)
    elif kind == "three whiskers":
        support = jw.Support.fbfbfbr([c[0], c[1], c[2], c[3], c[4]], 0.2)
    elif kind == "curved":
        support = jw.Support.fb(c[0], 0.0)
    elif kind in ("follicle", "curved follicle"):
        support = jw.Support.follicle(c[0], c[1], c[2])
    elif kind == "rotation":
        support, motion = jw.Support.fb(c[0], 0.0), jw.Rotation(pivot=(0.0, -0.5), radius=0.5)
    else:
        springs = jw.Spring((0, 1), c[0]), jw.Spring((0, 1), c[1], at=0.2)
        support = jw.Support(springs)
    return jw.Scene(whisker, jw.Parabola(p.distance, 1.0), support, motion=motion, friction=p.friction)


def scan_of(kind: str):
    """Function of the numbers of one scene: its scan."""
    control = control_of(kind)
    return lambda p: jw.scan(scene_of(kind, p), control)


def one_by_one(function):
    """The function of many, one after the other."""
    return lambda p: jax.lax.map(function, p)


def staged_scans(kind: str, along):
    """Compiled function: all scans of drawn numbers, as one batch (`jax.vmap`) or one after the other."""
    options = {"xla_backend_optimization_level": 1}
    many = along(scan_of(kind))
    return jax.jit(lambda p: many(jax.tree.map(jnp.asarray, p)), compiler_options=options)
