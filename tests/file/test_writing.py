"""What is written to a file, and what a file cannot hold."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._file.writing import tables_of
from scene_cases import CIRCLE, SPHERE, planar, spatial


def test_tables_hold_no_defaults():
    assert tables_of(planar(jw.Circle(0.3, 0.5))) == {
        "whisker": {},
        "objects": [{"kind": "circle", "distance": 0.3, "radius": 0.5}],
    }


def test_the_sign_of_zero_and_all_digits_are_written():
    numbers = {"kind": "circle", "distance": 0.1 + 0.2, "radius": 1e-7, "position": -0.0}
    assert repr(tables_of(planar(jw.Circle(0.1 + 0.2, np.float64(1e-7), jnp.asarray(-0.0))))["objects"]) == repr(
        [numbers]
    )


def test_kinds_are_written_where_there_are_several():
    tables = tables_of(spatial(SPHERE, motion=jw.LinearDrive((-1.0, 0.0, 0.0)), rod=jw.ClosedForm()))
    assert tables["drive"] == {"kind": "linear_drive", "direction": [-1.0, 0.0, 0.0]}
    assert tables["rod"] == {"kind": "closed_form"}
    assert tables_of(planar(CIRCLE, rod=jw.Shooting(12)))["rod"] == {"steps": 12}


class Square(eqx.Module):
    size: float

    def __call__(self, s):
        return self.size * (2 - s) ** 2


class Bump(jw.Circle):
    """An object of the user."""


REFUSED = {
    "graph": (planar(jw.Graph(lambda x: 0.2 + x**2)), ["`g`", "Graph", "Contour", "Polygon"]),
    "stiffness": (planar(CIRCLE, whisker=jw.Whisker(1.0, lambda s: 2 - s)), ["`bending_stiffness`", "Table", "lambda"]),
    "module": (planar(CIRCLE, whisker=jw.Whisker(1.0, Square(0.5))), ["`bending_stiffness`", "Square", "Table"]),
    "motion": (
        planar(CIRCLE, motion=jw.Motion(lambda u: (1.2 - u, 0.0, 0.0), 0.0, 2.6)),
        ["`function`", "Motion", "Translation", "Rotation"],
    ),
    "drive": (
        spatial(SPHERE, motion=jw.PoseDrive(lambda u: ((1.2 - u, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0, 2.6)),
        ["`function`", "PoseDrive", "LinearDrive"],
    ),
    "surface": (
        spatial(jw.Surface(lambda x: jnp.sum((x - jnp.array([0.0, 1.2, 0.0])) ** 2) - 1, (0.0, 1.2, 0.0))),
        ["`function`", "Surface", "Ellipsoid"],
    ),
    "object of the user": (planar(Bump(0.3, 0.5)), ["`objects`", "Bump", "Circle"]),
    "solver": (planar(CIRCLE, rod=jw.Shooting(solver=diffrax.Tsit5())), ["`solver`", "Tsit5", "Splitting"]),
    "batch": (jax.vmap(lambda q: planar(jw.Circle(q, 0.5)))(jnp.array([0.2, 0.3])), ["single scene", "shape (2,)"]),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", REFUSED)
def test_what_a_file_cannot_hold_is_refused(name, tmp_path):
    scene, words = REFUSED[name]
    path = tmp_path / "scene.toml"
    with pytest.raises(ValueError) as caught:
        jw.save_scene(scene, path)
    assert [word for word in words if word not in str(caught.value)] == []
    assert not path.exists()


@pytest.mark.unchecked
def test_only_concrete_scenes_are_written(tmp_path):
    with pytest.raises(ValueError, match="`scene` must be concrete"):
        jax.jit(lambda q: jw.save_scene(planar(jw.Circle(q, 0.5)), tmp_path / "scene.toml"))(0.3)
    with pytest.raises(ValueError, match="`scene` must be a Scene"):
        jw.save_scene(jw.Sensor(jw.Whisker()), tmp_path / "scene.toml")  # type: ignore[reportArgumentType]
