"""Centre lines between two states of a whisker that no equilibrium lies between: it swings free, or over."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxwhisker._scan.shapes import Shapes

DEEPEST = 3e-3  # of a line in the object, of its length: contacts and outlines are drawn no better
CURLS = np.concatenate([[0.0], *([curl, -curl] for curl in np.linspace(0.1, 6.0, 60))])


class Outline(NamedTuple):
    """The object's contour from left to right, below it (or all around, that way)."""

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]

    def depth(self, x: Float[np.ndarray, " line"], y: Float[np.ndarray, " line"]) -> float:
        """How deep a line reaches into the object, which is convex; negative if it stays outside."""
        across = np.stack([np.diff(self.y), -np.diff(self.x)])
        across /= np.maximum(np.hypot(*across), 1e-300)
        out = across[0, :, None] * (x - self.x[:-1, None]) + across[1, :, None] * (y - self.y[:-1, None])
        return float(-np.min(np.max(out, axis=0)))


def between(
    first: Shapes, second: Shapes, lengths: Float[np.ndarray, " whiskers"], share: float, outline: Outline
) -> Shapes:
    """Centre lines (whiskers, points) at a share of the way from the first to the second ones.

    Bases go straight on, the lines' directions turn evenly, and their lengths stay. A line that would reach into the
    object on its way is curled as far as it takes to pass outside, or to reach in least.
    """
    lines = []
    for k, length in enumerate(lengths):
        here, there = jax.tree.map(lambda leaf, k=k: leaf[k], (first, second))
        lines.append(_one(here, there, float(length), share, outline))
    x, y = (jnp.asarray(np.stack(coordinate)) for coordinate in zip(*lines, strict=True))
    return Shapes(x, y)


def _one(first: Shapes, second: Shapes, length: float, share: float, outline: Outline):
    (x0, y0, angle0), (x1, y1, angle1) = _directions(first), _directions(second)
    angle1 = angle1 - 2 * np.pi * np.round((angle1[0] - angle0[0]) / (2 * np.pi))  # the root takes the shorter way
    turned = (1 - share) * angle0 + share * angle1
    # To curl is to lag behind at the tip what the root is ahead.
    curl = share * (1 - share) * np.linspace(-1.0, 1.0, turned.size) * (angle0 - angle1)

    def line(curled: float):
        angle, piece = turned + curled * curl, length / turned.size
        x = np.concatenate([[0.0], np.cumsum(piece * np.cos(angle))]) + (1 - share) * x0 + share * x1
        y = np.concatenate([[0.0], np.cumsum(piece * np.sin(angle))]) + (1 - share) * y0 + share * y1
        return x, y

    tried = []
    for curled in CURLS:
        x, y = line(curled)
        tried.append((outline.depth(x, y), x, y))
        if tried[-1][0] < DEEPEST * length:
            break
    return min(tried, key=lambda found: found[0])[1:]


def _directions(line: Shapes):
    """The base, and the directions of equally long pieces of the line."""
    x, y = np.asarray(line.x), np.asarray(line.y)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    even = np.linspace(0.0, arc[-1], x.size)
    x, y = np.interp(even, arc, x), np.interp(even, arc, y)
    return x[0], y[0], np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
