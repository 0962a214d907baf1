"""Foundations: springs that become many, and a clamp in the limit."""

import numpy as np

import jaxwhisker as jw
from scenes import all_ok

CONTROL = np.array([0.9, 0.6, 0.2, -0.3, -0.6, -0.9])
STRETCH, STIFFNESS = 0.2, 500.0
MOST = 6  # springs instead of a foundation
SIGNALS = ("contact_force", "base_x", "base_angle")


def scanned(support, control=CONTROL):
    result = jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.3), support), control)
    assert all_ok(result)
    return result


def on_tissue(stiffness=STIFFNESS):
    return jw.Support(foundation=jw.Foundation(0.0, STRETCH, stiffness), free=("phi",))


def on_springs(count):
    # Always as many, so that they share their programs; several at the same height if there are too many.
    heights = np.repeat((np.arange(count) + 0.5) * STRETCH / count, MOST // count)
    springs = (jw.Spring((0, 1), STIFFNESS * STRETCH / MOST, at=float(height)) for height in heights)
    return jw.Support(tuple(springs), free=("phi",))


def test_many_springs_become_a_foundation_with_the_square_of_their_distance():
    limit = scanned(on_tissue())
    coarse, fine = (scanned(on_springs(count)) for count in (3, MOST))
    for name in SIGNALS:
        errors = [np.abs(getattr(some, name) - getattr(limit, name)).max() for some in (coarse, fine)]
        assert 3.8 < errors[0] / errors[1] < 4.2, name
    # All that holds the base is the tissue above it.
    np.testing.assert_allclose(limit.fx, 0.0, atol=1e-9)
    np.testing.assert_allclose(limit.mz, 0.0, atol=1e-9)


def test_a_stiffer_foundation_comes_closer_to_a_clamp_at_its_end():
    control = CONTROL[:2]
    clamp = jw.scan(jw.Scene(jw.Whisker(1 - STRETCH), jw.Parabola(0.3 - STRETCH)), control)
    forces = (scanned(on_tissue(stiffness), control).contact_force for stiffness in (4e4, 6.4e5))
    misses = [abs(float((force - clamp.contact_force)[1, 0])) for force in forces]
    # The length over which the foundation yields falls with the fourth root of its stiffness.
    assert 1.8 < misses[0] / misses[1] < 2.3
