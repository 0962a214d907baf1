"""Contacts in pictures of scans in space: their points, their ways, and the forces there."""

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxwhisker._base import checks
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.contact import Phase
from jaxwhisker._model.space_scene import SpaceScene
from jaxwhisker._model.surface import AbstractSurface
from jaxwhisker._scan.contacts import has_several
from jaxwhisker._scan.shapes import PADDING
from jaxwhisker._scan.state import SpaceState
from jaxwhisker._space.weight import total_weights

weights_now = Program(total_weights)


def contacts_of(state: SpaceState, size: float) -> Float[np.ndarray, "*steps contacts 3"]:
    """Contact points in a unit of length, those of one whisker after those of another; NaN where it has none."""
    points = np.stack([state.contact_x, state.contact_y, state.contact_z], axis=-1) / size
    points = np.where((np.asarray(state.phase) != Phase.free)[..., None], points, np.nan)
    return points.reshape(*state.fx.shape[:-1], -1, 3)


def ways_of(contacts: Float[np.ndarray, "steps contacts 3"], whiskers: int) -> Float[np.ndarray, "steps contacts 3"]:
    """The contacts of each whisker in an order in which each goes on from the step before, as near as it can."""
    steps, rows, _ = contacts.shape
    if rows == whiskers:
        return contacts
    each = np.full((steps, whiskers, rows // whiskers, 3), np.nan)
    for whisker, own in enumerate(np.moveaxis(contacts.reshape(each.shape), 1, 0)):
        last = own[0]
        for step, points in enumerate(own):
            apart = np.linalg.norm(points[:, None] - last, axis=-1)
            # First those that go on, the nearest first, then those that begin, or begin again, anywhere else.
            way, left = each[step, whisker], np.isfinite(points[:, 0])
            for place in np.argsort(np.where(np.isnan(apart), np.inf, apart), axis=None):
                k, onwards = np.unravel_index(place, apart.shape)
                if left[k] and np.isnan(way[onwards, 0]):
                    way[onwards], left[k] = points[k], False
            last = way
    return each.reshape(contacts.shape)


def pushes_of(scene: SpaceScene, state: SpaceState) -> Float[np.ndarray, "*steps contacts 3"]:
    """Forces of the object on the whiskers, in the order of the contacts."""
    if has_several(state):
        points = np.nan_to_num(contacts_of(state, 1.0))
        normals = _normals_now(jax.tree.map(checks.as_float, scene.surface), padded(points.reshape(-1, 3)))
        normals = np.asarray(normals)[: points.size // 3].reshape(points.shape)
        return np.asarray(state.contact_force).reshape(points.shape[:-1])[..., None] * normals
    push = -np.stack([state.fx, state.fy, state.fz], axis=-1)
    if scene.gravity is not None:
        push -= np.asarray(weights_now(*jax.tree.map(checks.as_float, (scene.whiskers, scene.gravity))))
    return push


@Program
def _normals_now(surface: AbstractSurface, points: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
    return jax.vmap(surface.normal)(points)


def padded(rows: np.ndarray) -> np.ndarray:
    """Rows, the last of which is repeated so that figures share programs."""
    return np.pad(rows, [(0, -len(rows) % PADDING), *[(0, 0)] * (rows.ndim - 1)], mode="edge")
