"""The sources that programs depend on: a list for each kind, and whether tracing runs any others."""

import ast
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._base import checks, program, sources, store
from jaxwhisker._base.program import Program
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._model.canonical import canonical
from jaxwhisker._scan import plane, space
from jaxwhisker._scan.route import across
from jaxwhisker._space.problem import problem_in_space

SOURCE = Path(plane.__file__).parents[1]
ENDS = tuple(map(np.asarray, across()))
FB = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0, 0.2))
SPACE = jw.Scene(jw.Whisker(), jw.Sphere(0.5, (0.0, 0.8, 0.1)), jw.Support.fb(70.0, 0.2))


def floats(scene):
    return jax.tree.map(checks.as_float, scene)


def described(one: Program, *args):
    """The description of a program for these arguments."""
    shape, arrays = program._split(args)
    text = store.describe([one.function, shape.arguments([...] * len(arrays))])
    assert text is not None
    return text


def packages(modules):
    return {name.split(".")[1] for name in modules if "." in name}


# Change these lists together with the code, but think twice: every program of users is compiled again after a change
# of any module that it depends on.
PATHS = {"_base", "_rod", "_model", "_equilibrium", "_path"}


def test_a_path_in_the_plane_depends_on_neither_results_nor_space_nor_figures():
    found = sources.modules(described(plane.follow_path_now, problem_of(floats(FB)), *ENDS))
    scans = {name for name in found if name.startswith("jaxwhisker._scan.")}
    assert packages(found) == {*PATHS, "_plane", "_scan"} and scans == {"jaxwhisker._scan.plane"}
    assert {"jaxwhisker._path.march", "jaxwhisker._rod.rod", "jaxwhisker._model.conic"} <= found
    assert len(found) <= 78


def test_a_path_in_space_depends_on_neither_results_nor_figures():
    found = sources.modules(described(space.follow_path_now, problem_in_space(floats(SPACE)), *ENDS))
    scans = {name for name in found if name.startswith("jaxwhisker._scan.")}
    assert packages(found) == {*PATHS, "_space", "_scan"} and scans == {"jaxwhisker._scan.space"}
    assert "jaxwhisker._model.surface" in found
    assert len(found) <= 95


def problem_program(scene):
    """The program that makes the problem of a scene, and its argument."""
    if isinstance(scene, jw.Scene):
        return plane.canonical_problem_now, canonical(floats(scene))
    return space.problem_now, floats(scene)


def test_classes_of_arguments_count():
    smooth, polygon = (
        sources.modules(described(*problem_program(jw.Scene(jw.Whisker(), profile, jw.Support.fb(70.0)))))
        for profile in (jw.Parabola(0.2), jw.Box(0.2, 0.5, 0.4))
    )
    assert polygon - smooth == {"jaxwhisker._model.polygon", "jaxwhisker._model.polygon_chain"}


def files_run(function, *args):
    """Modules of this package whose code runs while a function is traced."""
    found = set()

    def note(frame, event, _):
        if event == "call":
            found.add(frame.f_code.co_filename)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        jax.make_jaxpr(lambda *args: function(*args))(*args)  # a new function, which JAX has not cached
    finally:
        sys.setprofile(before)
    paths = [Path(name) for name in found if Path(name).is_relative_to(SOURCE)]
    return {".".join(("jaxwhisker", *path.relative_to(SOURCE).with_suffix("").parts)) for path in paths}


@pytest.mark.parametrize("scene", [FB, SPACE], ids=["plane", "space"])
def test_tracing_runs_no_code_of_other_modules(scene):
    build, module = (problem_in_space, space) if scene is SPACE else (problem_of, plane)
    problem = jax.jit(build)(floats(scene))
    for one, *args in (problem_program(scene), (module.follow_path_now, problem, *ENDS)):
        run = files_run(one.function, *args)
        assert len(run) > 10
        assert run - sources.modules(described(one, *args)) == set()


def test_a_digest_changes_with_any_of_its_sources(monkeypatch):
    description = described(*problem_program(FB))
    before = sources.digest.__wrapped__(description)
    original = sources._source

    def digest(changed):
        monkeypatch.setattr(sources, "_source", lambda name: original(name) + "#" * (name == changed))
        sources._digest.cache_clear()
        return sources.digest.__wrapped__(description)

    for module in ("jaxwhisker._model.conic", "jaxwhisker._equilibrium.touch", "jaxwhisker._base.leaves"):
        assert digest(module) != before, module
    for module in ("jaxwhisker.plot.states", "jaxwhisker._path.march", ""):
        assert digest(module) == before, module
    sources._digest.cache_clear()


def test_only_imports_that_a_named_definition_uses_count():
    whole = sources._imports("jaxwhisker._scan.plane")
    used = sources._used_by("jaxwhisker._scan.plane", "follow_path")
    assert "jaxwhisker._scan.springs" in whole - used
    assert "jaxwhisker._path.march" in used
    # Through another definition of the same module, and through an import within a function.
    assert "jaxwhisker._scan.route" in sources._used_by("jaxwhisker._scan.scan", "scan_across")
    assert "jaxwhisker._scan.space" in sources._used_by("jaxwhisker._scan.scan", "scan")


def test_imports_for_types_only_do_not_count():
    assert "jaxwhisker._model.space_scene" not in sources._imports("jaxwhisker._scan.result")


def test_threads_parse_one_after_the_other(monkeypatch):
    inside = []

    def parse(_):
        assert not inside
        inside.append(None)
        time.sleep(0.02)
        inside.pop()
        return ast.Module([], [])

    monkeypatch.setattr(sources, "ast", SimpleNamespace(parse=parse))
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(sources._tree.__wrapped__, ["jaxwhisker._scan.scan"] * 4))
