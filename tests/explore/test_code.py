"""Python code of scenes: it constructs the same scene in a new process."""

from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._explore.code import code_of, code_of_scan


def square(x):
    return 0.2 + x**2


def ball(x):
    return jnp.sum((x - jnp.array([0.0, 1.2, 0.0])) ** 2) - 1.0


class Taper(eqx.Module):
    taper: float

    def __call__(self, s):
        return (1 - self.taper * s) ** 4


class Offset(eqx.Module):
    """A class that does not store the argument of its constructor."""

    doubled: float

    def __init__(self, half: float):
        self.doubled = 2 * half

    def __call__(self, x):
        return self.doubled + x**2


REACTIONS = ("fx", "fy", "fz", "mx", "my", "mz")


def constructed(code: str, **names: Any) -> jw.Scene:
    """The scene that the code constructs; `names` are user-defined."""
    namespace = {"__name__": "new", **names}
    exec(code, namespace)
    return namespace["scene"]


def assert_same(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


SCENES = [
    jw.Scene(jw.Whisker(0.05, 2e-9), jw.Circle(0.01, 0.02, 0.001), jw.Support.clamped()),
    jw.Scene(jw.Whisker(intrinsic_curvature=0.1), jw.Ellipse(0.2, 1.0, 0.5), jw.Support.fbfb((70.0, jnp.inf))),
    jw.Scene(jw.Whisker(), jw.Tilted(jw.Parabola(0.3), 0.1), jw.Support.fbfbr(70.0, (0.2, 0.3, 0.6))),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbfbr((1.0, 2.0, 3.0, 4.0, 5.0), 0.1), jw.ClosedForm()),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.follicle(70.0, 80.0, 9.0, mount=jw.Mount(angle=0.1))),
    jw.Scene((jw.Whisker(), jw.Whisker(0.9)), jw.Parabola(0.2), jw.Support.fbfb(70.0), jw.Shooting(6)),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), motion=jw.Rotation((0.0, -1.0), 0.9, -1)),
    jw.Scene(jw.Whisker(), jw.Contour.like(jw.Parabola(0.2), (-0.5, 0.0, 0.5))),
    jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support((jw.Spring((0, 1), compliance=0.0),))),
    jw.Scene(jw.Whisker.conical(0.03, 3e9, 1e-4, 3e-6), jw.Parabola(0.02, 20.0)),
    jw.Scene(jw.Whisker.rat("B", 2, intrinsic_curvature=2.0, poisson_ratio=0.4), jw.Parabola(0.02, 20.0)),
    jw.Scene(jw.Whisker(), jw.Graph(square, extent=3.0), rod=jw.Shooting(6, jw.Splitting(10))),
    jw.Scene(jw.Whisker(1.0, Taper(0.3)), jw.Parabola(0.2)),
    jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), jw.Support.follicle(x=9.0, phi_x=7.0), friction=0.3),
    jw.SpaceScene(
        jw.Whisker(
            0.05, jw.Whisker.from_material(0.05, 2e11, 1e-4).bending_stiffness, lateral_curvature=3.0, twist=0.5
        ),
        jw.Ellipsoid((0.1, 0.08, 0.06), (0.0, 0.11, 0.0)).rotated((0.3, 0.2, -0.4)).moved((0.0, 0.01, 0.0)),
        jw.Support(mount=jw.Mount(z=0.01, roll=0.2)),
        motion=jw.LinearDrive((-2.0, 0.0, -0.7)),
    ),
    jw.SpaceScene(
        jw.Whisker(lateral_curvature=0.4),
        jw.Extruded(jw.Circle(0.3, 0.9)).rotated((0.0, 0.4, 0.0), (0.1, 0.0, 0.0)),
        motion=jw.WhiskDrive(elevation=0.1, roll_rate=0.4),
    ),
    jw.SpaceScene(jw.Whisker(), jw.Surface(ball, (0.0, 1.2, 0.0)), motion=jw.RotaryDrive((1.0, 0.0, 0.0), start=-1.0)),
]


@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_the_code_of_a_scene_constructs_the_same_scene(scene):
    assert_same(constructed(code_of(scene), square=square, Taper=Taper), scene)


@pytest.mark.parametrize(("scene", "names"), [(SCENES[0], "fx fy mz"), (SCENES[-1], "fx fy fz mx my mz")], ids=str)
def test_the_code_of_a_scan_prints_all_reactions(scene, names):
    printed = []
    whole = code_of_scan(scene, "", np.array([0.5, 0.4]))
    values = {name: np.full((2, 1), k) for k, name in enumerate(REACTIONS)}
    made = {"result": SimpleNamespace(**values, control=np.array([0.5, 0.4]))}
    exec("step = 1" + whole[1], made | {"print": printed.append})
    assert printed == [
        f"u = 0.4, whisker 1: {', '.join(f'{name} = {REACTIONS.index(name)}' for name in names.split())}"
    ]


def test_defaults_and_equal_springs_are_left_out():
    code = code_of(jw.Scene(jw.Whisker(), jw.Parabola(0.5), jw.Support.fbfbr(70.0)))
    assert "whisker=jw.Whisker()," in code and "profile=jw.Parabola(distance=0.5)," in code
    assert "support=jw.Support.fbfbr(stiffness=70.0, rest_length=0.2)," in code and "rod=" not in code


def test_names_of_modules_are_imported():
    code = code_of(jw.Scene(jw.Whisker(), jw.Graph(jnp.cosh, extent=3.0)))
    assert "from jax.numpy import cosh" in code and "Define" not in code
    profile: Any = constructed(code).profile
    assert profile.g(0.0) == 1.0


def test_names_of_a_notebook_are_listed(monkeypatch):
    for value in (square, Taper):
        monkeypatch.setattr(value, "__module__", "__main__")
    scene = jw.Scene(jw.Whisker(1.0, Taper(0.3)), jw.Graph(square))
    code = code_of(scene, "taper = 0.3")
    assert "# taper = 0.3\n# Define these first: Taper, square.\n" in code
    assert_same(constructed(code, square=square, Taper=Taper), scene)


def test_functions_without_a_name_get_those_of_their_arguments():
    one, other = (lambda s: 1 + s), (lambda s: 2 + s)
    scene = jw.Scene(
        (jw.Whisker(1.0, one), jw.Whisker(1.0, other)), jw.Graph(lambda x: 0.2 + x**2), jw.Support.fbfb(1.0)
    )
    code = code_of(scene)
    assert "# Define these first: bending_stiffness, bending_stiffness_2, g.\n" in code
    profile: Any = scene.profile
    names = {"bending_stiffness": one, "bending_stiffness_2": other, "g": profile.g.function}
    assert_same(constructed(code, **names), scene)


def test_an_object_that_cannot_be_written_gets_the_name_of_its_argument():
    scene = jw.Scene(jw.Whisker(), jw.Graph(Offset(0.1)))
    profile: Any = scene.profile
    code = code_of(scene)
    assert "# Define these first: g.\n" in code
    assert_same(constructed(code, g=profile.g), scene)
