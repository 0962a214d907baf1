"""Distributed loads: their units, their size, where they act, and the weight of a whisker."""

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from jaxwhisker._equilibrium.line_loads import density_of, ends_of_lines, lines_of, weight_of
from jaxwhisker._model.along import LinearTaper

EXACT = 1e-13
LENGTH, STIFFNESS = 0.05, 2.4e-5
WHISKER = jw.Whisker(LENGTH, STIFFNESS)


def test_distributed_loads_are_dimensionless():
    whole, part = lines_of(
        WHISKER, (jw.PointForce(1.0), jw.LineLoad(y=-0.3), jw.LineLoad(LinearTaper(1.0, 3.0, 0.05), 0.2, 0.01, 0.04))
    )
    assert [float(v) for v in (whole.start, whole.stop)] == [0.0, 1.0]
    np.testing.assert_allclose(np.array([part.start, part.stop]), [0.2, 0.8], rtol=EXACT)
    unit = STIFFNESS / LENGTH**3
    np.testing.assert_allclose(whole.density(jnp.asarray(0.3)), [0.0, -0.3 / unit, 0.0], rtol=EXACT)
    np.testing.assert_allclose(part.density(jnp.asarray(0.7)), [2.4 / unit, 0.2 / unit, 0.0], rtol=EXACT)
    stretches = [(0.0, 0.2), (0.2, 0.5), (0.8, 0.5), (0.8, 1.0)]
    assert [float(part.between(*map(jnp.asarray, ends))) for ends in stretches] == [0.0, 1.0, 1.0, 0.0]


def test_distributed_loads_add_up_where_a_stretch_lies_on_them():
    assert density_of((), 0.0, 1.0) is None
    lines = lines_of(WHISKER, (jw.LineLoad(y=-0.3), jw.LineLoad(LinearTaper(1.0, 3.0, 0.05), 0.2, 0.01, 0.04)))
    unit, s = STIFFNESS / LENGTH**3, jnp.asarray(0.7)
    on_both, on_one = density_of(lines, 0.6, 0.8, 0.5), density_of(lines, 0.8, 1.0)
    assert on_both is not None and on_one is not None
    np.testing.assert_allclose(on_both(s), np.array([1.2, -0.05, 0.0]) / unit, rtol=EXACT)
    np.testing.assert_allclose(on_one(s), np.array([0.0, -0.3, 0.0]) / unit, rtol=EXACT)


def test_the_weight_is_that_of_the_whisker_and_its_tip():
    gravity = (3.0, -9.0)
    whisker = jw.Whisker(
        LENGTH, STIFFNESS, mass_per_length=LinearTaper(2e-3, 1e-3, LENGTH), tip_mass=4e-5, base_mass=7.0
    )
    line, *points = weight_of(whisker, gravity)
    assert isinstance(line, jw.LineLoad) and len(points) == 2
    x, y = (part(0.02) for part in (line.x, line.y))  # pyright: ignore[reportCallIssue]
    np.testing.assert_allclose([x, y], np.array(gravity) * (2e-3 - 1e-3 * 0.4), rtol=EXACT)
    total = np.zeros(3)
    for load in points:
        assert isinstance(load, jw.PointForce) and load.position is None and not load.follower
        total += np.array(float(load.force)) * np.array([np.cos(load.direction), np.sin(load.direction), 0.0])
    np.testing.assert_allclose(total, [4e-5 * 3.0, -4e-5 * 9.0, 0.0], atol=EXACT)
    assert len(weight_of(jw.Whisker(LENGTH, mass_per_length=2e-3), gravity)) == 1


def test_the_weight_in_space_has_three_components():
    whisker, gravity = jw.Whisker(LENGTH, STIFFNESS, mass_per_length=2e-3, tip_mass=4e-5), (3.0, -9.0, 0.5)
    line, tip = weight_of(whisker, gravity)
    assert isinstance(line, jw.LineLoad) and isinstance(tip, jw.SpaceForce) and tip.position is None
    for part, along in zip((line.x, line.y, line.z), gravity, strict=True):
        assert callable(part)
        np.testing.assert_allclose(part(0.02), 2e-3 * along, rtol=EXACT)
    np.testing.assert_allclose(np.array([tip.fx, tip.fy, tip.fz]), 4e-5 * np.array(gravity), rtol=EXACT)


def test_a_load_in_space_has_its_size_and_its_ends():
    load = jw.LineLoad(0.3, -0.4, start=0.01, stop=0.03, z=LinearTaper(0.0, 1.0, LENGTH))
    lines = lines_of(WHISKER, (load, jw.PointForce(1.0)))
    np.testing.assert_allclose(ends_of_lines(lines), [0.2, 0.6], rtol=EXACT)
    unit = STIFFNESS / LENGTH**3
    np.testing.assert_allclose(lines[0].density(jnp.asarray(0.5)), np.array([0.3, -0.4, 0.5]) / unit, rtol=EXACT)
    np.testing.assert_allclose(lines[0].size, 0.4 * (0.3 + 0.4 + 0.4) / unit, rtol=EXACT)
    assert ends_of_lines(()).shape == (0,)
    starts = [
        lines_of(WHISKER, (jw.LineLoad(z=1.0, start=s, stop=stop),))[0] for s, stop in ((0.0, LENGTH), (0.01, 0.06))
    ]
    assert [bool(line.inside) for line in starts] == [True, False]
