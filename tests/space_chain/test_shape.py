"""Centre lines and bending of whiskers in space with several contacts."""

from typing import Any

import jax
import numpy as np
import pytest

import jaxwhisker as jw
import pegs

POINTS = 101
DIFFERENCES = 1e-5  # central differences
NEAR = 1e-8  # after spacing has been accounted for: the line is as exact as the scan


def test_a_line_runs_from_the_base_past_all_contacts_to_the_tip():
    result = pegs.scan()
    at = int(np.argmin(np.abs(np.asarray(result.control) - pegs.CONTROL)))
    lines = jw.shapes(result, at=[pegs.CONTROL], points=POINTS)
    line = np.stack([np.asarray(getattr(lines, axis))[0, 0] for axis in "xyz"], axis=-1)
    np.testing.assert_allclose(line[0], [pegs.CONTROL, 0.0, 0.0], atol=NEAR)
    np.testing.assert_allclose(np.linalg.norm(np.diff(line, axis=0), axis=1), 1 / (POINTS - 1), rtol=1e-3)
    for k in range(2):
        s, contact = (
            float(result.contact_arc[at, 0, k]),
            np.array([float(getattr(result, f"contact_{axis}")[at, 0, k]) for axis in "xyz"]),
        )
        j = int(s * (POINTS - 1))
        share = s * (POINTS - 1) - j
        chord = (1 - share) * line[j] + share * line[j + 1]
        # Between two points, a curve leaves its chord by less than the square of their distance.
        np.testing.assert_allclose(chord, contact, atol=1e-4)
    # Beyond the outermost contact, the whisker is straight.
    np.testing.assert_allclose(np.diff(line[94:], n=2, axis=0), 0.0, atol=NEAR)


def test_a_free_whisker_has_a_line():
    lines = jw.shapes(pegs.scan(), at=[0.3], points=3)
    np.testing.assert_allclose(np.asarray(lines.y)[0, 0], [0.0, 0.5, 1.0], atol=NEAR)


PLACES = np.linspace(0.0, 1.0, 33)
FINE = 401  # points of a line: second differences are then within 1e-3 of curvatures


def two_at(result):
    return np.flatnonzero(np.sum(np.asarray(result.phase)[:, 0] != 0, axis=1) == 2)


def test_at_pegs_along_z_whiskers_are_bent_as_in_the_plane():
    result = pegs.scan()
    circles = (jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, -0.55))
    plane = jw.scan(jw.Scene(jw.Whisker(), circles, contacts=2), np.asarray(result.control))
    bent, known = jw.bending(result, PLACES), jw.bending(plane, PLACES)
    ok = np.asarray(result.status) == 0
    assert two_at(result).size >= 2
    for name in ("moment", "curvature"):
        own, exact = np.asarray(getattr(bent, name))[ok], np.asarray(getattr(known, name))[ok]
        np.testing.assert_allclose(-own[..., 1], exact, atol=pegs.EXACT)
        np.testing.assert_allclose(own[..., [0, 2]], 0.0, atol=1e-12)


@pytest.mark.parametrize("part", ["moment", "curvature"])
def test_curvatures_are_those_of_the_line_and_vanish_beyond_the_contacts(part):
    result = pegs.scan(pegs.TILTED)
    lines, at = jw.shapes(result, points=FINE), np.linspace(0.0, 1.0, FINE)
    line = np.stack([np.asarray(getattr(lines, axis))[:, 0] for axis in "xyz"], axis=-1)
    bend = np.linalg.norm(np.diff(line, n=2, axis=1), axis=2) * (FINE - 1) ** 2
    bent = np.linalg.norm(np.asarray(getattr(jw.bending(result, at), part))[:, 0, :, :2], axis=2)
    steps = two_at(result)
    assert steps.size >= 3
    for step in steps:
        arcs = np.asarray(result.contact_arc)[step, 0]
        smooth = np.min(np.abs(at[1:-1, None] - arcs), axis=1) > 1 / (FINE - 1)
        np.testing.assert_allclose(bent[step, 1:-1][smooth], bend[step][smooth], atol=1e-3)
        assert np.max(bent[step]) > 3.0
        np.testing.assert_array_equal(bent[step, at > arcs[0]], 0.0)


def test_strains_have_derivatives_in_both_modes():
    """By a tilt of a peg, with two contacts."""
    at, control = np.array([0.1, 0.6]), np.array([0.3, -0.62])

    def strains(tilt) -> Any:
        result: Any = jw.scan(pegs.scene(((tilt, 0.1, 1.0), (-0.3, 0.0, 1.0))), control)
        return jw.strain(result, at, 0.01, 0.4)[1, 0]

    forwards, size = jax.jacfwd(strains)(0.2), 1e-5
    np.testing.assert_allclose(jax.jacrev(strains)(0.2), forwards, rtol=1e-9)
    differences = (np.asarray(strains(0.2 + size)) - np.asarray(strains(0.2 - size))) / (2 * size)
    assert np.min(np.abs(forwards)) > 1e-4
    np.testing.assert_allclose(forwards, differences, rtol=DIFFERENCES)
