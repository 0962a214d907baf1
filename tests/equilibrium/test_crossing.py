"""Shafts that cross as their polylines do."""

import jax
import numpy as np

from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import crossing
from shafts import points, shaft

LANES = 40  # in which shafts are compared: one program for all


@Program
def in_either_order(one, others):
    return jax.vmap(lambda other: (crossing.cross(one, other), crossing.cross(other, one)))(others)


def cross(one, others):
    """Whether a shaft crosses each of the others, which does not depend on the order."""
    lanes = jax.tree.map(lambda *leaves: np.resize(np.stack(leaves), (LANES, *leaves[0].shape)), *others)
    found, swapped = in_either_order(one, lanes)
    np.testing.assert_array_equal(found, swapped)
    return found[: len(others)].tolist()


def polyline(own, curvature):
    """Many points of a shaft of constant curvature, from base to tip."""
    phi = np.arctan2(own.to_base.sin[0], own.to_base.cos[0])
    base, tip = np.sum(own.to_base.cell), np.sum(own.to_tip.cell)
    at = own.to_base.x[0], own.to_base.y[0], phi, curvature
    return np.stack(points(*at, np.linspace(base, tip, 400))[:2], axis=1)


def polylines_cross(a, b):
    """Whether two polylines cross: whether each of two chords separates the ends of the other."""

    def sides(at, along, ends):
        return along[:, None, 0] * (ends - at[:, None])[..., 1] - along[:, None, 1] * (ends - at[:, None])[..., 0]

    first = sides(a[:-1], np.diff(a, axis=0), b[None])
    second = sides(b[:-1], np.diff(b, axis=0), a[None])
    return np.any((first[:, 1:] * first[:, :-1] < 0) & (second[:, 1:] * second[:, :-1] < 0).T)


def test_shafts_cross_as_their_polylines_do():
    random = np.random.default_rng(5)
    one = shaft(0.0, 0.5, 1.7, -1.1, 0.6, 0.4)
    numbers = random.uniform([-0.6, 0.0, 0.8, -1.5, 0.4, 0.0], [0.6, 0.8, 2.4, 1.5, 0.8, 0.5], (LANES, 6))
    others = [shaft(*row) for row in numbers]
    own = polyline(one, -1.1)
    expected = [polylines_cross(own, polyline(other, row[3])) for other, row in zip(others, numbers, strict=True)]
    assert LANES / 4 < np.sum(expected) < 3 * LANES / 4
    assert cross(one, others) == expected


def test_shafts_cross_only_where_both_are():
    upright = shaft(0.0, 0.5, np.pi / 2, 0.0, 0.5, 0.4)
    near = 1e-6
    # The left ends of level shafts, 0.5 long, and their heights.
    places = [(near - 0.5, 0.3), (-near - 0.5, 0.3), (-near, 0.3), (near, 0.3)]
    places += [(-0.2, 0.9 - near), (-0.2, 0.9 + near), (-0.2, near), (-0.2, -near)]
    others = [shaft(x + 0.25, y, 0.0, 0.0, 0.25, 0.25) for x, y in places]
    assert cross(upright, others) == [True, False] * 4


def test_a_shaft_with_its_contact_at_the_tip_ends_there():
    tip = shaft(0.0, 0.9, np.pi / 2, 0.0, 0.9, 0.0)
    others = [shaft(0.0, y, 0.0, 0.0, 0.25, 0.25) for y in (0.9 - 1e-6, 0.9 + 1e-6, 1e-6, -1e-6)]
    assert cross(tip, others) == [True, False, True, False]
