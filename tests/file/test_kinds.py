"""Kinds of tables: names, keys and defaults follow from classes and their constructors."""

from typing import Any

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._file.kinds import FAMILIES, arguments_of, kind_name, kinds_of, scene_arguments

CIRCLE = '[[objects]]\nkind = "circle"\ndistance = 0.3\nradius = 0.5\n'
SPHERE = '[[objects]]\nkind = "sphere"\nradius = 0.05\ncentre = [0.0, 0.1, 0.0]\n'

# A table of each constructor, and the same part in Python.
CONSTRUCTORS = {
    "conical": (
        "length = 0.05\nyoungs_modulus = 3e9\nbase_diameter = 2e-4\ntip_diameter = 1e-5\ndensity = 1300",
        lambda: jw.Whisker.conical(0.05, 3e9, 2e-4, 1e-5, density=1300),
    ),
    "from_material": (
        "length = 0.05\nyoungs_modulus = 3e9\n"
        '[whisker.diameter]\nkind = "polynomial"\ncoefficients = [2e-4, -1e-4]\nlength = 0.05',
        lambda: jw.Whisker.from_material(0.05, 3e9, jw.Polynomial([2e-4, -1e-4], 0.05)),
    ),
    "from_points": (
        "x = [0.0, -0.001, -0.004]\ny = [0.0, 0.02, 0.04]\nerror = 1e-3\nbending_stiffness = 1e-6",
        lambda: jw.Whisker.from_points([0.0, -0.001, -0.004], [0.0, 0.02, 0.04], 1e-3, bending_stiffness=1e-6),
    ),
    "from_table": (
        "s = [0, 0.01, 0.02]\nyoungs_modulus = 3e9\ndiameter = [2e-4, 1.5e-4, 5e-5]",
        lambda: jw.Whisker.from_table([0.0, 0.01, 0.02], youngs_modulus=3e9, diameter=[2e-4, 1.5e-4, 5e-5]),
    ),
    "rat": ('row = "C"\ncolumn = 2', lambda: jw.Whisker.rat("C", 2)),
    "strip": (
        "length = 0.1\nyoungs_modulus = 2e11\nwidth = 2e-3\nthickness = 2e-4\ndensity = 8000",
        lambda: jw.Whisker.strip(0.1, 2e11, 2e-3, 2e-4, density=8000),
    ),
    "clamped": ("", jw.Support.clamped),
    "fb": ("stiffness = 70", lambda: jw.Support.fb(70)),
    "fbfb": ("stiffness = [60, 70]\nrest_length = 0.1", lambda: jw.Support.fbfb((60, 70), 0.1)),
    "fbfbr": ("stiffness = [60, inf, 70]", lambda: jw.Support.fbfbr((60, np.inf, 70))),
    "fbfbfbr": ("stiffness = 60", lambda: jw.Support.fbfbfbr(60)),
    "follicle": (
        "x = 30\nphi = 2\nmount = { angle = 0.1 }",
        lambda: jw.Support.follicle(30, phi=2, mount=jw.Mount(angle=0.1)),
    ),
    "named": ('model = "FBFB"\nstiffness = 70', lambda: jw.Support.named("FBFB", 70)),
    "simony": ("large_angles = true", lambda: jw.Support.simony(large_angles=True)),
    "hill": ("whiskers = 2\nangle = 0.2", lambda: jw.Support.hill(2, angle=0.2)),
    "berg": ("skin = 1\ndeep = 2\nfollicle = 0.004", lambda: jw.Support.berg(1, 2, 0.004)),
    "schaefer": ("skin = 1\nfollicle_end = 2\nfollicle = 0.004", lambda: jw.Support.schaefer(1, 2, 0.004)),
    "luo": (
        "superficial = 1\ndeep = 2\nsuperficial_at = 0.3\ndeep_at = 0.1\n"
        "tissue = { start = 0.1, stop = 0.2, stiffness = 5 }",
        lambda: jw.Support.luo(1, 2, 0.3, 0.1, tissue=jw.Foundation(0.1, 0.2, 5)),
    ),
}


def test_every_constructor_is_here():
    named = {kind.name for family in FAMILIES for kind in kinds_of(family).values() if not kind.is_class}
    assert named == set(CONSTRUCTORS)


@pytest.mark.parametrize("name", CONSTRUCTORS)
def test_constructors_make_the_parts(name, tmp_path):
    text, make = CONSTRUCTORS[name]
    part = "whisker" if isinstance(make(), jw.Whisker) else "support"
    other = "" if part == "whisker" else "[whisker]\n"
    path = tmp_path / "sensor.toml"
    rest, body = (SPHERE, jw.Sphere(0.05, (0.0, 0.1, 0.0))) if name == "strip" else (CIRCLE, jw.Circle(0.3, 0.5))
    path.write_text(f'{rest}{other}[{part}]\nkind = "{name.upper()}"\n{text}\n')
    scene = jw.load_scene(path)
    parts: Any = {"whisker": jw.Whisker()} | {part: make()}
    expected = jw.Scene(profile=body, **parts)
    assert jax.tree.structure(scene) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(scene), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)


def test_names_of_kinds_do_not_occur_twice():
    """Where a file may hold any of several families, a name tells one kind."""
    for argument in scene_arguments().values():
        assert len(argument.kinds) == sum(len(kinds_of(family)) for family in argument.families)
    assert kind_name(jw.LinearDrive) == "linear_drive" and kind_name(jw.Box) == "box"


def test_keys_of_a_scene_are_those_of_both_classes():
    keys = ["whisker", "objects", "support", "rod", "drive", "friction", "detect", "contacts", "gravity"]
    assert list(scene_arguments()) == keys


def test_kinds_need_no_name_where_there_is_one_or_a_default():
    found = {name: argument.usual and argument.usual.name for name, argument in scene_arguments().items()}
    assert found == {
        **dict.fromkeys(("objects", "friction", "detect", "contacts", "gravity")),
        **{"whisker": "whisker", "support": "support", "rod": "shooting", "drive": "translation"},
    }


def test_arguments_know_what_they_hold():
    parts: Any = jw.Spring, jw.Whisker
    spring, whisker = map(arguments_of, parts)
    assert not spring["between"].is_number and spring["between"].required
    assert not spring["axis"].is_number and not spring["one_sided"].is_number
    assert spring["stiffness"].is_number and not spring["stiffness"].required
    assert {"table", "polynomial"} <= set(whisker["bending_stiffness"].kinds)
    assert whisker["length"].is_number and not whisker["length"].kinds
    assert not arguments_of(jw.Shooting)["steps"].is_number and not arguments_of(jw.Cut)["profile"].is_number
    depths = {"length": 0, "breaks": 1}
    assert {name: whisker[name].dimensions for name in depths} == depths
    assert spring["between"].dimensions == 1 and arguments_of(jw.Polygon)["vertices"].dimensions == 2
    assert set(arguments_of(jw.Cut)["profile"].kinds) == set(kinds_of(jw.AbstractProfile))
