"""Centre lines of whiskers in space with several contacts."""

import numpy as np

import jaxwhisker as jw
import pegs

POINTS = 101
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
