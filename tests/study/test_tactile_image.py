"""Tactile images: heights by formulas, signals of single scans, units, and wrong input."""

# pyright: reportArgumentType=false

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw

SAME = 1e-9  # a scan in a batch and alone
HEIGHT = 1e-12  # a length: rounding
REVOLVED = 2e-11  # the same of a surface of revolution, whose axis is rounded off by 1e-6 of its radius
OFFSETS, CONTROL = np.array([-0.3, 0.1, 0.7]), np.linspace(-0.9, 0.9, 13)
BALL = jw.Sphere(0.8, (0.1, 1.2, 0.0))


def along_x(offset, surface=BALL, **parts):
    """A whisker on a drive towards +x, beside the plane of the scan."""
    drive = jw.LinearDrive((1.0, 0.0, 0.0), origin=(0.0, 0.0, offset))
    return jw.Scene(jw.Whisker(), surface, motion=drive, **parts)


@pytest.fixture(scope="module")
def image():
    return jw.tactile_image(along_x, offset=OFFSETS, control=CONTROL)


@pytest.fixture
def heights(monkeypatch):
    """The heights above bases alone: nothing is scanned."""

    def no_scan(build, *, control, **axes):
        import xarray as xr

        return xr.Dataset(coords={"control": np.asarray(control)} | axes)

    monkeypatch.setattr("jaxwhisker._study.tactile_image.study", no_scan)
    return lambda build, **arguments: jw.tactile_image(build, **{"control": CONTROL} | arguments).object_height


def test_signals_are_those_of_single_scans(image):
    assert image.object_height.dims == image.fx.dims == ("offset", "control", "whisker")
    alone = jw.scan(along_x(0.1), CONTROL)
    for name in ("fx", "fz", "mx"):
        assert np.abs(image[name]).max() > 0.1
        np.testing.assert_allclose(image[name].sel(offset=0.1), getattr(alone, name), rtol=0, atol=SAME)


def test_heights_of_a_sphere(image):
    x, z = CONTROL - 0.1, OFFSETS[:, None]
    depth = 0.8**2 - x**2 - z**2
    expected = np.where(depth > 0, 1.2 - np.sqrt(np.maximum(depth, 0.0)), np.nan)
    assert 10 < np.isnan(expected).sum() < expected.size / 2
    np.testing.assert_allclose(image.object_height.isel(whisker=0), expected, rtol=0, atol=HEIGHT)


def test_units_are_lengths(image):
    assert {name: image[name].attrs["units"] for name in ("offset", "control", "object_height")} == dict.fromkeys(
        ("offset", "control", "object_height"), "L"
    )
    assert image.object_height.attrs["long_name"] == "height of the object"
    assert image.whisker.values.tolist() == [1]


def test_heights_of_other_surfaces(heights):
    x, z = CONTROL, OFFSETS[:, None]
    bowl = jw.Revolved(jw.Graph(lambda x: 0.4 + 0.3 * x**2 + 0.8 * x**4))
    square = x**2 + z**2
    found = heights(lambda offset: along_x(offset, bowl), offset=OFFSETS)[..., 0]
    np.testing.assert_allclose(found, 0.4 + 0.3 * square + 0.8 * square**2, rtol=0, atol=REVOLVED)

    rounded = jw.Surface(lambda x: jnp.sum((x - jnp.array([0.0, 1.2, 0.0])) ** 4) - 0.4, inside=(0.0, 1.2, 0.0))
    rest = 0.4 - x**4 - z**4
    expected = np.where(rest > 0, 1.2 - np.maximum(rest, 0.0) ** 0.25, np.nan)
    found = heights(lambda offset: along_x(offset, rounded), offset=OFFSETS)[..., 0]
    assert np.isnan(expected).any()
    np.testing.assert_allclose(found, expected, rtol=0, atol=HEIGHT)

    turned = jw.Paraboloid(0.2, a=2.0, b=0.5).rotated((0.0, 0.4, 0.0), about=(0.0, 0.0, 0.0))
    ahead, beside = np.cos(0.4) * x - np.sin(0.4) * z, np.sin(0.4) * x + np.cos(0.4) * z
    found = heights(lambda offset: along_x(offset, turned), offset=OFFSETS)[..., 0]
    np.testing.assert_allclose(found, 0.2 + 2.0 * ahead**2 + 0.5 * beside**2, rtol=0, atol=HEIGHT)


def test_each_whisker_has_its_own_path(heights):
    """Two bases at the rest lengths of their springs, on an oblique drive, in metres."""
    way, centre, radius = np.array([0.8, 0.0, 0.6]), np.array([0.01, 0.06, 0.0]), 0.04

    def build(offset):
        drive = jw.LinearDrive(tuple(way), origin=(0.0, 0.002, offset))
        return jw.Scene(
            jw.Whisker(0.05, 1e-5), jw.Sphere(radius, tuple(centre)), jw.Support.fbfb(1.0, 0.01), motion=drive
        )

    free = jw.scan(build(0.01), CONTROL[:1])  # 0.9 m before the object
    start = np.stack([free.base_x, free.base_y, free.base_z], axis=-1)[0]  # pyright: ignore[reportAttributeAccessIssue]
    assert not np.any(free.phase) and np.linalg.norm(start[1] - start[0]) > 0.009
    at = start + (CONTROL / 20 - CONTROL[0])[:, None, None] * way
    square = radius**2 - np.sum((at - centre)[..., [0, 2]] ** 2, axis=-1)
    expected = np.where(square > 0, centre[1] - np.sqrt(np.maximum(square, 0.0)), np.nan)
    assert 2 < np.isfinite(expected[:, 0]).sum() != np.isfinite(expected[:, 1]).sum()
    found = heights(build, offset=[0.01], control=CONTROL / 20)
    assert found.attrs["units"] == "m"
    np.testing.assert_allclose(found[0], expected, rtol=0, atol=HEIGHT)


def test_there_is_no_height_below_or_inside_the_object(heights):
    below = heights(lambda offset: along_x(offset, jw.Sphere(0.3, (0.0, -1.2, 0.0))), offset=[0.0])
    inside = heights(lambda offset: along_x(offset, jw.Sphere(0.3, (0.0, 0.0, 0.0))), offset=[0.0])
    assert np.isnan(below).all() and np.isnan(inside).all()


def test_an_invalid_offset_has_no_height():
    data = jw.tactile_image(along_x, offset=[np.nan, 0.1], control=CONTROL, progress=False)
    assert data.point_status.values.tolist() == [jw.Status.invalid, jw.Status.ok]
    assert np.isnan(data.object_height[0]).all() and np.isfinite(data.object_height[1]).any()


@pytest.mark.parametrize(
    ("build", "arguments", "words"),
    [
        (along_x, {}, "`arguments` must have the values of one parameter of `build`, .* got none"),
        (along_x, {"offset": [0.1], "radius": [0.2]}, "got offset, radius"),
        (along_x, {"offset": [0.1], "summary": True}, "`summary` must be left out"),
        (along_x, {"offset": [0.1], "points": {"offset": [0.1]}}, "`points` must be left out"),
        (lambda offset: jw.Scene(jw.Whisker(offset), jw.Parabola(0.2)), {"offset": [0.9]}, "`build` must .* in space"),
        (
            lambda offset: jw.Scene(jw.Whisker(), BALL, motion=jw.WhiskDrive(elevation=offset)),
            {"offset": [0.1]},
            "`build` must .* whose motion is a Translation or a LinearDrive, got one whose motion is whisking",
        ),
        (
            lambda offset: jw.Scene(jw.Whisker(), jw.Torus(0.3, 0.1, (0.0, 0.9, offset))),
            {"offset": [0.1]},
            "`build` must be a function that returns scenes with convex objects, got one with a torus",
        ),
    ],
)
def test_wrong_input_is_rejected(build, arguments, words):
    with pytest.raises(ValueError, match=words):
        jw.tactile_image(build, control=CONTROL, **arguments)
