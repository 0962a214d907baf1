"""Clearance: how far free whiskers stand from the object, and where they would touch it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxwhisker._base.types import Scalar
from jaxwhisker._equilibrium import touch
from jaxwhisker._equilibrium.newton import PerWhisker, Poses
from jaxwhisker._equilibrium.problem import Problem
from jaxwhisker._equilibrium.touch import Touch


class Stance(NamedTuple):
    """Bases in the scene, and where their whiskers would touch, unloaded, if they came along x."""

    x: PerWhisker
    right: Touch  # coming from the right
    left: Touch

    def first(self, side: PerWhisker) -> Touch:
        """The touch of whiskers that come from that side."""
        return jax.tree.map(lambda right, left: jnp.where(side > 0, right, left), self.right, self.left)


class InScene(NamedTuple):
    """Poses of bases in the scene; angles to the upright."""

    x: PerWhisker
    y: PerWhisker
    angle: PerWhisker


def in_scene(problem: Problem, u: Scalar, pose: Poses) -> InScene:
    """Poses seen in the frames of a control, in the scene."""
    if problem.mount is None:
        return InScene(pose[:, 0], jnp.zeros_like(pose[:, 0]), jnp.zeros_like(pose[:, 0]))
    frame, _ = problem.frames(u)
    x, y, turn = pose.T
    return InScene(
        frame.x + x * frame.cos - y * frame.sin,
        frame.y + x * frame.sin + y * frame.cos,
        jnp.arctan2(frame.sin, frame.cos) + turn,
    )


def stance(problem: Problem, u: Scalar, pose: Poses) -> Stance:
    """Where whiskers stand with their bases in these poses."""
    at = in_scene(problem, u, pose)
    if problem.mount is None:
        return Stance(at.x, problem.touch_right, problem.touch_left)

    def both(*own):
        return touch.of_both(problem.profile, *own)

    return Stance(at.x, *jax.vmap(both)(problem.length, problem.outline, at.y, at.angle))
