"""From a whisker to the section of its rod in space: signs and units."""

# pyright: reportArgumentType=false, reportCallIssue=false

import jax
import numpy as np

import jaxwhisker as jw
from jaxwhisker._space.section import space_section


def test_a_curvature_in_the_plane_is_one_about_d2_which_points_along_minus_z():
    whisker = jw.Whisker(length=2.0, bending_stiffness=3.0, intrinsic_curvature=0.4, lateral_curvature=0.3, twist=0.2)
    section = space_section(whisker, 2.0, 3.0)
    np.testing.assert_allclose(section.intrinsic(0.5), [0.6, -0.8, 0.4])  # in units of 1/L
    np.testing.assert_allclose(section.compliance(0.5), 1.0)
    np.testing.assert_allclose(section.torsion_ratio, 1 / 1.3)  # Poisson's ratio 0.3


def test_functions_of_arc_length_keep_their_units():
    bow = jw.Polynomial((0.1, 0.2), 2.0)
    section = space_section(jw.Whisker(length=2.0, intrinsic_curvature=bow, torsion_ratio=0.7), 2.0, 1.0)
    first, second, third = section.intrinsic(0.5)
    assert first == 0 and third == 0
    np.testing.assert_allclose(second, -2.0 * bow(1.0))
    np.testing.assert_allclose(section.torsion_ratio, 0.7)


def test_straight_whiskers_have_no_curvature_and_all_curved_ones_have_all():
    assert space_section(jw.Whisker(), 1.0, 1.0).curvature == (None, None, None)
    kinds = {"intrinsic_curvature": 0.4, "lateral_curvature": 0.3, "twist": 0.2}
    sections = [space_section(jw.Whisker(**{name: value}), 1.0, 1.0) for name, value in kinds.items()]
    assert len({jax.tree.structure(section) for section in sections}) == 1
    np.testing.assert_array_equal(
        [section.intrinsic(0.5) for section in sections], [[0, -0.4, 0], [0.3, 0, 0], [0, 0, 0.2]]
    )
