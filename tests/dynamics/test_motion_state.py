"""Shapes of moving whiskers against arcs of circles, and which contacts last."""

# pyright: reportArgumentType=false
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._dynamics.gap import Gap
from jaxwhisker._dynamics.legendre import basis
from jaxwhisker._dynamics.motion_state import LEAP, Ledger, Moving, Rod, Touching, angles_of, nodes_of, posed
from jaxwhisker._dynamics.moving import Rods, System
from jaxwhisker._model.motion import Pose

N = 5
EXACT = 1e-9  # of positions: cosine and sine of the angle are interpolated
CURVATURES, LENGTHS = np.array([0.8, -0.5]), np.array([1.0, 0.6])
BASES = np.array([[0.3, 0.1, 0.2], [-1.0, 0.4, -0.7]])


def system():
    """Two whiskers with an intrinsic curvature of 0.3 per length."""
    none: Any = jnp.zeros(2)
    rods = Rods(jnp.asarray(LENGTHS), 0.3 * jnp.tile(basis(N).points, (2, 1)), none, none, none, none, none)
    return System(rods, Pose(none, none, none), None, jw.Circle(0.3, 0.2), None, 0.0, 0.0, (), free=(), n=N)


def test_whiskers_of_constant_curvature_are_arcs_of_circles():
    q = jnp.zeros((2, N)).at[:, 0].set(CURVATURES)

    @jax.jit
    def shape(q, base):
        angle = angles_of(system(), q, base)
        return angle, nodes_of(system(), base, angle)

    angle, nodes = shape(q, jnp.asarray(BASES))
    s = np.concatenate([[0.0], basis(N).points, [1.0]])
    for k in range(2):
        start, total = np.pi / 2 + BASES[k, 2], CURVATURES[k] + 0.3
        np.testing.assert_allclose(angle[k], start + total * s[1:-1], atol=EXACT)
        way = [np.sin(start + total * s) - np.sin(start), np.cos(start) - np.cos(start + total * s)]
        np.testing.assert_allclose(nodes[k], BASES[k, :2, None] + LENGTHS[k] / total * np.array(way), atol=EXACT)
    here = posed(system(), LENGTHS[1], jnp.asarray(BASES[1]), angle[1])
    assert here.length == LENGTHS[1] and here.base.tolist() == BASES[1, :2].tolist()
    assert here.profile == jw.Circle(0.3, 0.2)


def touching(touches, arc=0.5, began=False, scale=1.0) -> Touching:
    """Contacts of two whiskers, whose directions are multiples of `scale`."""
    count, none = basis(N).points.size, jnp.zeros(2)
    directions = {"normal": 1.0, "tangent": 2.0}
    gap = Gap(
        **{name: none for name in ("distance", "foot", "end", "at_tip")},
        **{name: jnp.full((2, 2), scale * size) for name, size in directions.items()},
        across=jnp.full((2, count), 3.0 * scale),
        along=jnp.full((2, count), 4.0 * scale),
        object=None,
    )
    return Touching(none + arc, none, gap, none, none, jnp.array(touches), none.astype(int), none > -began, none, None)


def test_forces_act_along_mean_directions_unless_the_contact_begins():
    first, last = touching([True, False]), touching([True, True], scale=5.0)
    across, normal, along, tangent = first.directions(last.gap, jnp.full(2, 0.5 + 0.9 * LEAP))
    for values, size in ((normal, 1.0), (tangent, 2.0), (across, 3.0), (along, 4.0)):
        assert np.all(values[0] == 3.0 * size) and np.all(values[1] == 5.0 * size)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_contact_that_leaps_along_the_whisker_begins_elsewhere(sign):
    at = touching([True, True])
    assert at.lasts(0.5 + sign * LEAP * jnp.array([0.99, 1.01])).tolist() == [True, False]
    assert touching([False, False]).lasts(jnp.full(2, 0.5)).tolist() == [False, False]


def test_the_step_after_a_contact_begins_is_implicit():
    none: Any = jnp.zeros(())
    ledger = Ledger(*[none] * 5)

    def ahead(at):
        return float(Moving(Rod(*[none] * 6, touching=at), none, none, none, ledger, none > 0).ahead)

    assert ahead(None) == 0.5
    assert ahead(touching([True, True])) == 0.5
    assert ahead(touching([True, True], began=True)) == 1.0
