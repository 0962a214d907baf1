"""Clearance: nearest points and gaps in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base.interpolation import between
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium import clearance
from jaxwhisker._equilibrium.clearance import DEPTH, NEAREST_ERROR
from jaxwhisker._equilibrium.second_contact import meets
from jaxwhisker._equilibrium.shaft import cells_of
from shafts import shaft

ROUNDING = 1e-12
GAP = 2e-7  # error of the least gap: that of the cubics of a shaft

CENTRE, RADIUS = np.array([0.1, 0.9]), 0.5
CIRCLE = jw.Circle(CENTRE[1] - RADIUS, RADIUS, CENTRE[0])
PARABOLA = jw.Parabola(0.2, 1.3, -0.1)

nearest = Program(clearance.nearest)


def test_the_nearest_points_of_a_circle_lie_towards_its_centre():
    random = np.random.default_rng(3)
    towards, distance = random.uniform(-1.5, 1.5, 12), random.uniform(0.3, 2.0, 12)
    x, y = CENTRE[:, None] + distance * np.array([np.sin(towards), -np.cos(towards)])
    wanted = np.arange(12) != 5
    feet = nearest(CIRCLE, jnp.asarray(0.4), jnp.asarray(x), jnp.asarray(y), jnp.asarray(wanted))
    # The parameter of a circle is its slope angle.
    np.testing.assert_allclose(feet[wanted], towards[wanted], atol=2 * NEAREST_ERROR / RADIUS)
    assert feet[5] == 0.4


def test_the_nearest_points_of_a_parabola_are_roots_of_a_cubic():
    random = np.random.default_rng(4)
    x, y = random.uniform(-1.5, 1.5, 12), random.uniform(-1.0, 0.2, 12)  # below, where each has one nearest point
    every = jnp.ones(12, bool)
    feet = nearest(PARABOLA, jnp.asarray(0.2), jnp.asarray(x), jnp.asarray(y), every)
    for px, py, foot in zip(x + 0.1, y - 0.2, feet, strict=True):
        roots = np.roots([2 * 1.3**2, 0.0, 1 - 2 * 1.3 * py, -px])
        (root,) = roots[np.abs(roots.imag) < 1e-9].real
        np.testing.assert_allclose(np.tan(foot) / 2.6, root, atol=NEAREST_ERROR)


@Program
def least_gap(profile, own):
    return clearance.least_gap(profile, cells_of(own), own.parameter), meets(
        profile, own, jnp.asarray(True), own.parameter
    )


def on_circle(angle, curvature, to_base, to_tip):
    """A shaft that touches the circle tangentially."""
    x, y = CENTRE + RADIUS * np.array([np.sin(angle), -np.cos(angle)])
    return shaft(x, y, angle, curvature, to_base, to_tip, angle)


def test_a_shaft_that_is_less_curved_than_the_object_meets_it_once():
    for curvature in (0.0, -1.0, 1.9):
        gap, again = least_gap(CIRCLE, on_circle(0.6, curvature, 0.8, 0.4))
        assert not again and gap > -ROUNDING


@pytest.mark.parametrize("lengths", [(0.5, 0.02), (0.02, 0.5)])
def test_a_shaft_that_is_more_curved_than_the_object_dips_into_it(lengths):
    own = on_circle(0.6, 2.005, *lengths)
    gap, again = least_gap(CIRCLE, own)
    # On the arc of the shaft, the distance from the object's centre falls steadily.
    part = own.to_base if lengths[0] > lengths[1] else own.to_tip
    depth = np.hypot(part.x[-1] - CENTRE[0], part.y[-1] - CENTRE[1]) - RADIUS
    assert again and depth < -2 * DEPTH
    np.testing.assert_allclose(gap, depth, atol=GAP)


@Program
def least_gap_of_lines(profile, depths):
    def least(depth):
        # A straight line, whose only points inside are around its middle, passes the centre at this depth.
        half = jnp.sqrt(RADIUS**2 - (RADIUS - depth) ** 2)
        x = CENTRE[0] + jnp.array([-4.5, -1.5, 1.4, 4.5]) * half
        points = jnp.stack([x, jnp.full(4, CENTRE[1] - RADIUS + depth)], axis=1)
        along = jnp.tile(jnp.array([1.0, 0.0]), (4, 1))
        cells = between(points, along, jnp.diff(x)[:, None])
        return clearance.least_gap(profile, cells, jnp.asarray(0.0)), clearance.least_gap(
            profile, cells, jnp.asarray(profile.lowest(), dtype=float), jnp.asarray(False)
        )

    return jax.vmap(least)(depths)


def test_a_dip_between_two_points_is_not_overlooked():
    depths = DEPTH * np.array([0.7, 1.3, 50.0])
    for gaps in least_gap_of_lines(CIRCLE, jnp.asarray(depths)):  # with and without a contact
        assert gaps[0] > -DEPTH
        np.testing.assert_allclose(gaps[1:], -depths[1:], atol=GAP)


def test_points_beyond_a_flat_object_are_not_inside():
    # Seen from above an ellipse, its lower side is a place of least distance as well.
    flat = jw.Ellipse(0.3, 0.4, 0.02)
    x, y = jnp.linspace(-0.3, 0.3, 12), jnp.full(12, 0.38)
    feet = nearest(flat, flat.lowest(), x, y, jnp.ones(12, bool))
    assert np.all(np.asarray(jax.vmap(flat.point)(feet).y) > 0.32)
