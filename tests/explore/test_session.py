"""A session: ranges of sliders, values that are checked, functions that are compiled once."""

import re
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._explore import session, space_picture
from jaxwhisker._explore.session import Session, _Functions, slider_of
from pictured import unpacked


def build(stiffness, distance=0.2):
    if distance > 0.8:
        raise ValueError("`distance` must leave room.")
    if distance > 0.7:
        raise ZeroDivisionError("by nothing")
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness), rod=jw.ClosedForm())


RANGES = {"stiffness": (10, 500, 70.0), "distance": (0.1, 0.9, 0.25)}
VALUES = {"stiffness": 70.0, "distance": 0.25}


def fixed(x):
    return jw.Scene(jw.Whisker(), jw.Parabola(x))


@pytest.fixture
def unsolved(monkeypatch):
    """Sessions answer without a scan: the title, the code and the note."""
    monkeypatch.setattr(session, "picture_of", lambda scene: jnp.zeros(()))
    monkeypatch.setattr(session, "packed_picture", lambda picture, *parts: "\n".join(map(str, parts)).encode())


def test_an_answer_is_the_picture_of_the_scene(unsolved):
    title, *code = Session(build, RANGES).answer(VALUES).decode().splitlines()
    assert title == str(build(**VALUES))
    assert "# stiffness = 70.0, distance = 0.25" in code and "    profile=jw.Parabola(distance=0.25)," in code


@pytest.mark.parametrize(
    ("distance", "message"), [(0.85, "`distance` must leave room."), (0.75, "ZeroDivisionError: by nothing")]
)
def test_an_error_of_build_is_the_answer(distance, message):
    assert unpacked(Session(build, RANGES).answer(VALUES | {"distance": distance}))[0]["error"] == message


def nested(depth):
    value: Any = 1.0
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stiffness": 70.0}, "A request must hold stiffness, distance, got"),
        ({**VALUES, "radius": 1.0}, "A request must hold"),
        ({**VALUES, "stiffness": float("nan")}, "`stiffness` must be a number from 10 to 500, got nan."),
        ({**VALUES, "stiffness": 501.0}, "got 501.0."),
        ({**VALUES, "stiffness": 10**400}, "`stiffness` must be"),
        ({**VALUES, "stiffness": "70"}, "got '70'."),
        ({**VALUES, "stiffness": True}, "got True."),
        ({**VALUES, "stiffness": nested(100_000)}, "got [[[[[[[...]]]]]]]."),
        (nested(100_000), "got [[[[[[[...]]]]]]]."),
        ([70.0, 0.25], "got [70.0, 0.25]."),
        (None, "got None."),
    ],
    ids=["missing", "unknown", "nan", "outside", "huge", "text", "bool", "nested value", "nested", "list", "none"],
)
def test_other_values_are_an_error_and_the_session_goes_on(values, message, unsolved):
    sliders = Session(build, RANGES)
    error = unpacked(sliders.answer(values))[0]["error"]
    assert message in error and len(error) < 200
    assert sliders.answer(VALUES).decode().startswith(str(build(**VALUES)))


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("make", "ranges", "message"),
    [
        (
            build,
            {"stiff": (1, 2)},
            "which takes (stiffness, distance=0.2), got 'stiff'",
        ),
        (lambda x=1.0: fixed(x), {"stiff": (1, 2)}, "unexpected keyword argument 'stiff'"),
        (build, {"distance": (0.1, 0.2)}, "missing a required argument: 'stiffness'"),
        (build, {"stiffness": (500, 10)}, "`stiffness` must be a range with low < high, got (500, 10)."),
        (build, {"stiffness": (10, 10)}, "low < high"),
        (build, {"stiffness": (10, float("nan"))}, "with finite numbers, got (10, nan)."),
        (build, {"stiffness": (10, float("inf"))}, "finite numbers"),
        (build, {"stiffness": 70.0}, "`stiffness` must be (low, high) or (low, high, start)"),
        (build, {"stiffness": (10,)}, "(low, high)"),
        (build, {"stiffness": (10, 20, 15, 16)}, "(low, high)"),
        (build, {"stiffness": ("soft", "stiff")}, "(low, high)"),
        (build, {"stiffness": (10, 500, 5)}, "`stiffness` must start from 10 to 500, got 5."),
        (lambda x: None, {"x": (1, 2)}, "`build` must return a Scene or a Simulation, got None."),
        (lambda x, /: fixed(x), {"x": (1, 2)}, "`ranges` must name the parameters of `build`, which takes (x, /)"),
        (70.0, {}, "`build` must be a function that returns a Scene, got 70.0."),
        (fixed, {"x": (-1, 1, -0.5)}, "`distance` must be a positive finite number"),
    ],
)
def test_wrong_ranges_and_functions_are_rejected(make, ranges, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        jw.explore(make, **ranges)


def test_float32_is_rejected():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            jw.explore(build, stiffness=(10, 500))
    finally:
        jax.config.update("jax_enable_x64", True)


def test_wide_ranges_are_logarithmic_and_start_in_the_middle():
    ranges = {"a": (10, 500), "b": (10, 200), "c": (0, 500), "d": (-1, 500.0), "e": (np.float64(1), 21, 2)}
    sliders = [slider_of(name, given) for name, given in ranges.items()]
    assert [slider.logarithmic for slider in sliders] == [True, False, False, False, True]
    assert [slider.start for slider in sliders] == [70.71, 105.0, 250.0, 249.5, 2.0]


def test_sliders_of_scenes_in_si_show_units_with_prefixes():
    def build(stiffness, distance, c1, x):
        return jw.Scene(jw.Whisker(0.08, 6.4e-4), jw.Parabola(distance, 12.5, x), jw.Support.fb(stiffness + c1))

    ranges = {"stiffness": (10, 500), "distance": (0.004, 0.07, 0.016), "c1": (0, 1), "x": (0, 0.01)}
    sliders = Session(build, ranges, {"c1": "stiffness"}).description["sliders"]
    units = [(each["unit"]["name"], pytest.approx(each["unit"]["size"])) for each in sliders]
    assert units == [("N/m", 1.0), ("mm", 1e-3), ("N/m", 1.0), ("", 1.0)]
    assert sliders[1]["start"] == 0.016  # the values themselves are those of the scene
    assert Session(fixed, {"x": (0.1, 0.9)}).description["sliders"][0]["unit"] == {"name": "", "size": 1.0}


def past_sphere(radius, offset=0.2):
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(radius, (0.0, 1.3, offset)))


def test_a_scene_in_space_has_views_and_its_own_pictures(unsolved, monkeypatch):
    monkeypatch.setattr(space_picture, "picture_in_space", lambda scene: jnp.ones(()))
    balls = Session(past_sphere, {"radius": (0.5, 1.5), "offset": (0.0, 0.5)})
    assert (balls.description["views"]["camera"], balls.description["position"]) == ((15.0, 35.0), "drive")
    assert Session(build, RANGES).description["views"] == {}
    title, *code = balls.answer({"radius": 0.9, "offset": 0.3}).decode().splitlines()
    assert title == str(past_sphere(0.9, 0.3))
    assert "    surface=jw.Sphere(radius=0.9, centre=(0.0, 1.3, 0.3))," in code


def test_a_scene_that_leaves_the_plane_is_an_error():
    sliders = Session(lambda x: fixed(x) if x < 0.5 else past_sphere(x), {"x": (0.1, 0.9, 0.2)})
    error = unpacked(sliders.answer({"x": 0.8}))[0]["error"]
    assert error.startswith("`build` must be a function that always returns a Scene, got")


def test_exploring_the_plane_loads_nothing_of_space():
    code = (
        "import sys, jax; jax.config.update('jax_enable_x64', True); import jaxwhisker as jw; "
        "from jaxwhisker._explore.hosts import Explorer; from jaxwhisker._explore.session import Session; "
        "build = lambda x: jw.Scene(jw.Whisker(), jw.Parabola(x), rod=jw.ClosedForm()); "
        "answer = Explorer(Session(build, {'x': (0.1, 0.9)}))._session.answer({'x': 0.2}); "
        "assert b'line_x' in answer, answer[:999]; "
        "of_space = ('space', 'surface', 'quadrics', 'solids', 'drives', 'rotation', 'matplotlib'); "
        "print([name for name in sys.modules if any(part in name for part in of_space) and 'packages' not in name "
        "and name.startswith(('jaxwhisker', 'matplotlib'))])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert found.stdout.strip() == "[]"


def tapered(taper, width=1.0):
    return jw.Scene(jw.Whisker(1.0, lambda s: (1 - taper * s) ** 4), jw.Graph(lambda x: 0.2 + (x / width) ** 2))


def test_a_function_made_anew_by_the_same_code_from_the_same_values_is_reused():
    functions = _Functions()
    (first, _), (second, new) = functions.reused(tapered(0.2)), functions.reused(tapered(0.2))
    assert jax.tree.structure(first) == jax.tree.structure(second) and not new
    assert jax.tree.structure(tapered(0.2)) != jax.tree.structure(tapered(0.2))  # else reuse would be superfluous


@pytest.mark.parametrize("values", [{"taper": 0.5}, {"taper": 0.2, "width": np.array(2.0)}], ids=["number", "array"])
def test_a_function_of_other_values_is_another_function(values):
    functions = _Functions()
    assert not functions.reused(tapered(0.2))[1]  # the first picture is compiled anyway
    scene, new = functions.reused(tapered(**values))
    profile: Any = scene.profile
    assert new
    assert float(scene.whiskers[0].stiffness_at(0.4)) == (1 - values["taper"] * 0.4) ** 4
    assert float(profile.g(0.5)) == 0.2 + (0.5 / float(values.get("width", 1.0))) ** 2


def vibrating(steps=4.0, mass=1.0):
    """A small motion, which is compiled for each number of steps."""
    whisker = jw.Whisker(mass_per_length=mass)
    return jw.simulate(jw.Sensor(whisker), np.array([0.0, 0.1]), 1.0, steps=int(steps), shapes=2)


def test_the_answer_of_a_simulation_is_its_picture():
    motions = Session(vibrating, {"mass": (0.5, 2.0)})
    assert motions.description["position"] == "time"
    header, arrays = unpacked(motions.answer({"mass": 0.75}))
    np.testing.assert_array_equal(arrays["mz"], vibrating(mass=0.75).mz)
    assert header["title"] == "clamped: 1 whisker, no object" and header["note"] == ""
    assert "result = vibrating(mass=0.75)" in header["code"][0]
    assert arrays["outline_x"].size == 0 and Session(build, RANGES).description["position"] == "drive"


def test_a_motion_that_is_compiled_for_a_value_says_so():
    motions = Session(vibrating, {"steps": (2, 9, 4)})
    notes = [unpacked(motions.answer({"steps": steps}))[0]["note"] for steps in (4.0, 5.0, 5.0)]
    assert notes == ["", session.RECOMPILED_MOTION, ""]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda x: build(70.0) if x > 1 else vibrating(),
            "`build` must be a function that always returns a Simulation",
        ),
        (
            lambda x: jax.vmap(lambda mass: vibrating(mass=mass))(jnp.array([0.5, x + 1])),
            "`result` must be a single simulation, got a batch of shape (2,)",
        ),
    ],
    ids=["kind", "batch"],
)
def test_other_simulations_are_an_error(make, message):
    header, _ = unpacked(Session(make, {"x": (0, 2, 1)}).answer({"x": 2.0}))
    assert header["error"].startswith(message)


def test_a_picture_that_is_compiled_for_a_new_function_says_so(unsolved):
    sliders = Session(tapered, {"taper": (0.1, 0.9, 0.2)})
    notes = [session.RECOMPILED in sliders.answer({"taper": taper}).decode() for taper in (0.2, 0.5, 0.2)]
    assert notes == [False, True, False]
