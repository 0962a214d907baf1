"""The mechanics of the plane: paths of scenes that are invalid, and contacts that end a path."""

import numpy as np
import pytest

import jaxwhisker as jw
from engine import dimensionless
from jaxwhisker._scan.detect import kinds_of
from jaxwhisker._scan.plane import InThePlane, check_valid, path_through

STOPS, LAST = np.array([1.9, -2.7]), np.asarray(1)
# A curved whisker that passes into the parabola unless second contacts are detected.
DEEP = jw.Scene(
    jw.Whisker(intrinsic_curvature=0.992381450543045),
    jw.Parabola(0.11704241159057474, 1.044896713171311),
    jw.Support.fb(129.65262162807937, 0.2),
)


def test_a_path_ends_where_a_second_contact_begins():
    problem, kinds = dimensionless(DEEP), kinds_of(DEEP)
    assert kinds == ("second_contact",)
    whole = InThePlane.follow(problem, STOPS, LAST)
    cut = InThePlane.detected(DEEP, problem, whole.path)
    assert whole.path.status == jw.Status.ok and cut.status == jw.Status.second_contact
    assert int(cut.count) < int(whole.path.count)
    assert path_through(problem, kinds, STOPS, LAST).path.count == cut.count
    assert path_through(problem, (), STOPS, LAST).path.count == whole.path.count


def test_invalid_scenes_are_refused_by_the_argument_that_is_wrong():
    low = jw.Scene(jw.Whisker(), jw.Polygon([(-0.4, 0.6), (0.1, -0.2), (0.5, 0.6)]))
    with pytest.raises(ValueError, match="`profile` must be strictly convex with its lowest point above the bases"):
        check_valid(low, dimensionless(low))
    check_valid(DEEP, dimensionless(DEEP))
