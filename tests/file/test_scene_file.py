"""Scenes that are written to a file and read again: every part, every argument, every digit."""

import inspect
from typing import Any

import diffrax
import equinox as eqx
import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._file import scene_file
from jaxwhisker._file.kinds import FAMILIES, arguments_of
from jaxwhisker._file.named import same
from jaxwhisker._file.scene_file import SceneFile
from jaxwhisker._file.writing import tables_of
from jaxwhisker._model.motion import AbstractDriveMotion
from jaxwhisker._model.surface import AbstractSurface
from scene_cases import CIRCLE, SCENES, planar

PARTS = (
    *(jw.AbstractProfile, AbstractSurface, AbstractDriveMotion, jw.AbstractRod, diffrax.AbstractSolver),
    *(jw.Whisker, jw.Support, jw.Spring, jw.Mount, jw.Foundation),
)
OF_TIME = {"Whisking", "Sweep"}  # drives of `simulate`: functions of time, which do not belong to scenes
OF_FUNCTIONS = {"Motion", "PoseDrive", "Surface"}  # of more than one number, for which files have no functions


@pytest.mark.parametrize("name", SCENES)
def test_scenes_round_trip(name, tmp_path):
    path = tmp_path / "scene.toml"
    jw.save_scene(SCENES[name], path)
    again = jw.load_scene(path)
    assert type(again) is type(SCENES[name])
    assert same(again, SCENES[name])
    text = path.read_text()
    jw.save_scene(again, path)
    assert path.read_text() == text


def parts_of(tree) -> set[type]:
    """Classes of all parts of a tree."""
    found = {type(tree)}
    if isinstance(tree, tuple):
        return found.union(*map(parts_of, tree))
    fields = vars(tree).values() if isinstance(tree, eqx.Module) else ()
    return found.union(*map(parts_of, fields))


WRITTEN = set().union(*map(parts_of, SCENES.values()))


def test_scenes_of_these_tests_have_every_public_part():
    public = {name: getattr(jw, name) for name in jw.__all__ if inspect.isclass(getattr(jw, name))}
    own = {
        name
        for name, kind in public.items()
        if not name.startswith("Abstract")
        and issubclass(kind, eqx.Module)
        and (issubclass(kind, PARTS) or "__call__" in vars(kind))
    }
    assert {"Sphere", "Table", "Splitting", "Whisking"} <= own
    assert {public[name] for name in own - OF_TIME - OF_FUNCTIONS} - WRITTEN == set()
    kinds = {made for family in FAMILIES.values() for made in family}
    assert {public[name] for name in own - OF_TIME} - kinds == set()


def test_scenes_of_these_tests_have_every_argument():
    """Of every class of a part, some scene has each argument with another value than its default."""
    written: dict[type, set[str]] = {}

    def note(part) -> None:
        if isinstance(part, tuple):
            for one in part:
                note(one)
        elif isinstance(part, eqx.Module):
            for name, argument in arguments_of(type(part)).items():
                value = getattr(part, name)
                if repr(value) != repr(argument.default):
                    written.setdefault(type(part), set()).add(name)
                note(value)

    for scene in SCENES.values():
        arguments = {name: getattr(scene, name) for name in arguments_of(type(scene))}
        for name, value in arguments.items():
            if repr(value) != repr(arguments_of(type(scene))[name].default):
                written.setdefault(type(scene), set()).add(name)
            note(value.objects if isinstance(value, jw.AbstractProfile) else value)
    names = {made: set(arguments_of(made)) for family in FAMILIES.values() for made in family if made in WRITTEN}
    scenes: Any = jw.Scene, jw.SpaceScene
    names |= {made: set(arguments_of(made)) for made in scenes}
    missing = {made.__name__: sorted(own - written.get(made, set())) for made, own in names.items()}
    assert {name: own for name, own in missing.items() if own} == {}


@pytest.mark.parametrize("control", [np.linspace(0.75, -1.35, 211), [0.7, 0.1, 0.3], None])
def test_positions_round_trip(control, tmp_path):
    path = tmp_path / "scene.toml"
    jw.save_scene(planar(CIRCLE), path, control)
    assert ("positions" in path.read_text()) == isinstance(control, list)
    read = jw.load_control(path)
    assert read is None if control is None else np.array_equal(np.asarray(read), control)


def test_a_file_that_would_give_another_scene_is_not_written(tmp_path, monkeypatch):
    path = tmp_path / "scene.toml"
    other = tables_of(planar(jw.Circle(0.3, 0.6)))
    monkeypatch.setattr(scene_file, "tables_of", lambda scene: other)
    jw.save_scene(planar(jw.Circle(0.3, 0.6)), path)
    with pytest.raises(ValueError, match=r"one that a file gives again, got clamped: .* r = 0\.5"):
        jw.save_scene(planar(jw.Circle(0.3, 0.5)), path)


FILE = """
friction = 0.1

[whisker]
length = 0.05
bending_stiffness = 1e-6

[support]
kind = "fbfb"
stiffness = [60, 70]

[[objects]]
kind = "circle"
distance = 0.02
radius = 0.01

[[objects]]
kind = "circle"
distance = 0.03
radius = 0.02
position = 0.1
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(FILE)
    return SceneFile(path)


def test_scenes_are_built_with_other_numbers(file):
    built = file.build(**{"objects.2.radius": 0.04, "length": 0.06, "stiffness.1": 50.0})
    assert [float(one.radius) for one in built.profile.objects] == [0.01, 0.04]
    assert float(built.whiskers[0].length) == 0.06
    assert [float(spring.stiffness) for spring in built.support.springs] == [50.0, 70.0]
    assert same(file.build(), file.scene)


def test_scenes_are_built_with_traced_numbers(file):
    def radius(value):
        return file.build(**{"objects.2.radius": value}).profile.objects[1].radius * 3

    assert float(jax.grad(radius)(0.04)) == 3.0


def test_files_are_written_with_other_numbers(file, tmp_path):
    path = tmp_path / "changed.toml"
    values = {name: number.value for name, number in file.numbers.items()}
    file.save(path, values | {"objects.2.radius": np.float64(0.04)})
    assert path.read_text().split() == FILE.replace("radius = 0.02", "radius = 0.04").replace("1e-6", "1e-06").split()


def test_unknown_numbers_are_named(file):
    with pytest.raises(ValueError, match=r"`width` must be a number in .*: one of friction, length"):
        file.chosen("width")
