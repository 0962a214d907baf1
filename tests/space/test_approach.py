"""Where scans in space begin and end."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._space.approach import REACH, limits_of
from jaxwhisker._space.stance import clearance

WHOLE = jnp.asarray(jnp.nan)


@pytest.mark.parametrize(
    "body",
    [jw.Sphere(1.0, (5.0, 1.3, -1.0)), jw.Ellipsoid((3.0, 0.4, 0.4), (0.0, 1.2, 0.1)), jw.Paraboloid(0.4, 0.05, 1.0)],
)
def test_a_scan_along_a_line_begins_free_and_ends_where_no_whisker_reaches(body):
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), body, motion=jw.LinearDrive((-1.0, 0.1, 0.2))))
    start, far = limits_of(problem, WHOLE)
    assert clearance(problem, start) > 0
    assert clearance(problem, start) > clearance(problem, start + 1e-3)
    assert clearance(problem, far) > REACH
    middle = -(body.interior_point() @ np.array([1.0, -0.1, -0.2])) / np.sqrt(1.05)
    assert start < middle < far


def test_a_scan_that_begins_in_contact_is_approached_from_where_the_whisker_is_free():
    problem = dimensionless(
        jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), motion=jw.LinearDrive((-1, 0, 0)))
    )
    start, _ = limits_of(problem, jnp.asarray(-0.2))
    assert start < -0.9
    assert clearance(problem, start) > 0


def test_a_rotation_begins_and_ends_at_its_own_controls():
    drive = jw.WhiskDrive(start=0.8, stop=-0.5)
    problem = dimensionless(jw.SpaceScene(jw.Whisker(), jw.Sphere(0.3, (0.0, 0.7, 0.2)), motion=drive))
    np.testing.assert_allclose(limits_of(problem, WHOLE), [0.8, -0.5])
    np.testing.assert_allclose(limits_of(problem, jnp.asarray(0.2)), [0.8, -0.5])
    np.testing.assert_allclose(limits_of(problem, jnp.asarray(1.1)), [1.1, -0.5])
