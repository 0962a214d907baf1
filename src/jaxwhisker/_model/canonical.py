"""The canonical form of a scene: numbers in place of classes and structure, where numbers can tell the same.

Scenes that differ in these numbers only share the program that makes their problem. Arrays and constants are arranged
here, and nothing is computed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxwhisker._base import checks
from jaxwhisker._base.types import Scalar
from jaxwhisker._model.motion import AbstractMotion, Mount
from jaxwhisker._model.network import Flexibility, Linked, along_axes
from jaxwhisker._model.profile import AbstractProfile
from jaxwhisker._model.scene import Scene, moves_along_x
from jaxwhisker._model.spring import AXES
from jaxwhisker._model.support import Support
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._rod.elastica import AbstractRod


class Networks(eqx.Module):
    """A support without springs on shafts: its network along each axis, and its mounts."""

    along: dict[str, Linked]  # x alone if bases move along x only, otherwise all axes
    mounts: tuple[Mount, ...]
    on_shafts = False

    def flexibility(self, hold: Float[Array, "whiskers axes"] | None) -> Flexibility:
        """As that of the Support; nothing else holds the bases."""
        assert hold is None
        return along_axes(self.along)

    def attachments(self) -> list:
        """Nothing is attached to a shaft."""
        return []

    def valid(self) -> Bool[Array, ""]:
        """As that of the Support."""
        parts = [*self.mounts, *(spring for one in self.along.values() for spring in one.springs)]
        return jnp.all(jnp.stack([jnp.asarray(part.valid()) for part in parts]))


class CanonicalScene(eqx.Module):
    """A scene in its canonical form, without masses unless these have a weight, and without what it detects."""

    whiskers: tuple[Whisker, ...]
    profile: AbstractProfile
    support: Support | Networks  # a Support if springs are attached to shafts, or whiskers have a weight
    rod: AbstractRod
    motion: AbstractMotion  # its poses only
    onwards: Int[Array, ""] | Int[np.ndarray, ""]
    ends: tuple[Scalar, Scalar] | None
    friction: Scalar | None
    gravity: tuple[Scalar, Scalar] | None
    along_x: bool = eqx.field(static=True)  # whether bases move along x only


def canonical(scene: Scene) -> CanonicalScene:
    """The canonical form of a scene."""
    support, along_x, gravity = scene.support, moves_along_x(scene), jax.tree.map(checks.as_float, scene.gravity)
    if not support.on_shafts and gravity is None:
        mounts = () if along_x else jax.tree.map(checks.as_float, support.mounts)
        support = Networks(support.linked(("x",) if along_x else AXES), mounts)
    return CanonicalScene(
        tuple(whisker.without_masses() if gravity is None else whisker for whisker in scene.whiskers),
        scene.profile.canonical(),
        support,
        scene.rod,
        scene.motion.undirected(),
        np.asarray(scene.motion.onwards),
        jax.tree.map(checks.as_float, scene.motion.ends),
        scene.friction,
        gravity,
        along_x,
    )
