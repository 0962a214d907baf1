"""Loads on a whisker: defaults and errors."""

# pyright: reportArgumentType=false
import numpy as np
import pytest

import jaxwhisker as jw


def test_a_force_acts_at_the_tip_towards_minus_x():
    force = jw.PointForce(2.0)
    assert (force.position, force.follower, force.direction) == (None, False, np.pi)
    assert jw.PointMoment(0.3).position is None


def test_loads_in_space_act_at_the_tip_and_keep_their_direction():
    for load in (jw.SpaceForce(1.0, 2.0, 3.0), jw.SpaceMoment(1.0, 2.0, 3.0)):
        assert (load.position, load.follower) == (None, False)
    assert jw.LineLoad(1.0, 2.0, 0.1, 0.9).z is None


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jw.PointForce(np.nan), "`force` must be a finite number, got nan"),
        (lambda: jw.PointForce(1.0, position=-0.5), "`position` must be a positive finite number, got -0.5"),
        (lambda: jw.PointForce(1.0, follower=1), "`follower` must be True or False, got 1"),
        (lambda: jw.PointForce(1.0, direction=np.inf), "`direction` must be a finite number, got inf"),
        (lambda: jw.PointMoment(np.inf), "`moment` must be a finite number, got inf"),
        (lambda: jw.PointMoment(1.0, 0.0), "`position` must be a positive finite number, got 0.0"),
        (lambda: jw.SpaceForce(1.0, 0.0, 0.0, follower="yes"), "`follower` must be True or False, got 'yes'"),
        (lambda: jw.SpaceMoment(1.0, np.nan, 0.0), "`my` must be a finite number, got nan"),
        (lambda: jw.SpaceMoment(1.0, 0.0, 0.0, -1.0), "`position` must be a positive finite number, got -1.0"),
        (lambda: jw.SpaceMoment(1.0, 0.0, 0.0, follower=None), "`follower` must be True or False, got None"),
        (lambda: jw.LineLoad(z=np.inf), "`z` must be a finite number, got inf"),
    ],
)
def test_wrong_loads(make, message):
    with pytest.raises(ValueError, match=message):
        make()
