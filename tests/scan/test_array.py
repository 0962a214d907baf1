"""Arrays of whiskers: tables, batches on rigid pads, networks on compliant ones, and a rat's."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import jax
import numpy as np
import pandas as pd
import pytest

import jaxwhisker as jw

SAME = 1e-12  # relative to the largest: the same operations, in another order
STIFF = 1e9  # of springs that leave a base where it is
FIRM = 200 / STIFF  # whiskers are softer than 200 EI/L^3 against a shift of their bases
MIRRORED = {"fx": 1, "fy": -1, "fz": 1, "mx": -1, "my": 1, "mz": -1, "contact_y": -1}
CONTROL = np.linspace(-0.6, 0.6, 13)
BALL = jw.Sphere(0.3, (-0.5, 0.7, 0.05))
TABLE = {
    "name": ["a", "b", "c"],
    "x": [0.0, 0.1, 0.2],
    "z": [0.0, 0.1, 0.0],
    "length": [1.0, 0.9, 1.1],
    "elevation": [0.1, 0.0, -0.1],
    "elevation_rate": [0.3, 0.2, 0.1],
    "roll_rate": [0.2, 0.0, -0.2],
    "protraction": [0.0, 0.1, 0.2],
}


def test_a_table_is_a_mapping_a_data_frame_or_a_file(tmp_path):
    pd.DataFrame(TABLE).to_csv(tmp_path / "array.csv", index=False)
    one, *others = (jw.Array(table) for table in (TABLE, pd.DataFrame(TABLE), tmp_path / "array.csv"))
    assert str(one) == "3 whiskers: a, b, c"
    for other in others:
        assert jax.tree.leaves(one) == jax.tree.leaves(other)
        assert one.names == other.names
    assert jw.Array({"length": [1.0, 2.0]}).names == ("1", "2")


def test_a_row_is_a_whisker_on_its_base_point_that_turns_about_it():
    scene = jw.Array(TABLE).scene("b", BALL, friction=0.2)
    drive = jw.WhiskDrive(0.0, 0.0, 0.2, 0.0, (0.1, 0.0, 0.1), protraction=0.1)
    expected = jw.Scene(jw.Whisker(0.9), BALL, jw.Support((), jw.Mount(0.1, z=0.1)), friction=0.2, motion=drive)
    assert jax.tree.leaves(scene) == jax.tree.leaves(expected)
    placed = scene.motion.placement(0.3)
    base = placed.position + placed.rotation @ np.array([0.1, 0.0, 0.1])
    np.testing.assert_allclose(base, [0.1, 0.0, 0.1], atol=SAME)


def test_columns_become_cones_shapes_and_springs():
    columns = {"length": [0.04], "base_diameter": [1e-4], "tip_diameter": [1e-5], "youngs_modulus": [3e9]}
    array = jw.Array(columns | {"parabola": [10.0], "twist": [3.0], "spring_x": [5.0], "spring_phi": [0.1]})
    cone, (whisker,) = jw.Whisker.conical(0.04, 3e9, 1e-4, 1e-5), array.whiskers
    for s in (0.0, 0.03):
        assert float(whisker.stiffness_at(s)) == float(cone.stiffness_at(s))
    assert float(whisker.curvature_at(0.0)) == pytest.approx(20.0)
    assert whisker.twist == 3.0
    assert [(spring.axis, spring.stiffness) for spring in array.springs[0]] == [("x", 5.0), ("phi", 0.1)]
    tapered = jw.Array({"length": [2.0], "base_stiffness": [3.0], "taper": [0.5]}).whiskers[0]
    assert float(tapered.stiffness_at(2.0)) == pytest.approx(3.0 / 16)


def test_an_array_on_a_rigid_pad_is_a_batch():
    array = jw.Array(TABLE)
    data = array.scan(BALL, CONTROL)
    assert list(data.whisker.values) == ["a", "b", "c"]
    assert data.status.dims == ("whisker", "control")
    assert np.all(data.status == jw.Status.ok)
    assert np.sum(np.any(data.phase > 0, axis=0)) >= 2
    for name in array.names:
        alone = jw.scan(array.scene(name, BALL), CONTROL)
        for signal in ("fx", "fy", "fz", "mx", "my", "mz", "contact_x"):
            value = getattr(alone, signal)[:, 0]
            np.testing.assert_allclose(data[signal].sel(whisker=name), value, atol=SAME)
        assert int(data.event_count.sel(whisker=name)) == len(alone.events)
    assert data.attrs["points"] == "3 of 3 ok"


def test_a_whisker_that_fails_leaves_the_others_alone():
    inside = dict(TABLE, x=[-0.5, 0.1, 0.2], y=[0.7, 0.0, 0.0])  # the first base is in the middle of the ball
    data = jw.Array(inside).scan(BALL, CONTROL)
    failed = np.any(data.status.values > 0, axis=1)
    assert list(failed) == [True, False, False]
    np.testing.assert_array_equal(data.fx[:, 1:], jw.Array(TABLE).scan(BALL, CONTROL).fx[:, 1:])


def test_whiskers_on_a_stiff_pad_are_those_on_a_rigid_one():
    columns = {name: values[:2] for name, values in TABLE.items() if not name.endswith("rate")}
    array, drive = jw.Array(columns), jw.LinearDrive((-1.0, 0.0, 0.0))
    springs = [jw.Spring((0, 1), STIFF, axis=axis) for axis in "xyz"] + [
        jw.Spring((1, 2), STIFF, axis=axis) for axis in "xyz"
    ]
    control = np.linspace(-0.6, 0.6, 13)
    coupled = jw.scan(array.coupled(BALL, springs, drive), control)
    alone = array.scan(BALL, control, motion=drive)
    assert np.any(alone.phase > 0)
    np.testing.assert_allclose(coupled.fx, alone.fx, atol=FIRM * np.nanmax(np.abs(alone.fx)))


def test_the_roots_of_a_rat_point_where_they_were_measured():
    array = jw.Array.rat()
    assert len(array) == 54
    for name, protraction, elevation, side in (("RC2", 69.4, -4.2, 1), ("LC2", 69.4, -4.2, -1), ("RA4", 90.6, 56, 1)):
        scene = array.scene(name, BALL)
        root = np.asarray(scene.motion.placement(0.0).rotation)[:, 1]
        theta, phi = np.radians(protraction), np.radians(elevation)
        expected = np.cos(theta) * np.cos(phi), side * np.sin(theta) * np.cos(phi), np.sin(phi)
        np.testing.assert_allclose(root, expected, atol=SAME)
        later = np.asarray(scene.motion.placement(0.2).rotation)[:, 1]
        assert later[0] < root[0]  # protraction is towards the snout
    lengths = np.array([whisker.length for whisker in array.whiskers])
    assert lengths.min() > 0.0044
    assert lengths.max() < 0.0528
    assert len(jw.Array.rat(["left"], curved=False)) == 27


def test_the_left_side_of_a_rat_is_the_mirror_image_of_the_right_one():
    rats = {side: jw.Array.rat([side]) for side in ("right", "left")}
    control = np.linspace(-0.5, 0.9, 15)
    found = {}
    for side, sign in (("right", 1), ("left", -1)):
        peg = jw.Cylinder(5e-3, (-0.025, sign * 0.025, 0.0), (0.1, 0.0, 1.0))
        found[side] = jax.vmap(lambda scene: jw.scan(scene, control))(
            jax.tree.map(lambda leaf: leaf[12:15], rats[side].scenes(peg))
        )
    assert np.any(found["right"].phase > 0)
    for name, sign in MIRRORED.items():
        right, left = (np.asarray(getattr(found[side], name)) for side in ("right", "left"))
        np.testing.assert_allclose(left, sign * right, atol=1e-9 * np.nanmax(np.abs(right)))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"x": [1.0]}, "a column `length`"),
        ({"length": [1.0], "weight": [1.0]}, "`table` must be columns among name, x, y, z"),
        ({"length": [1.0, 2.0], "x": [1.0]}, r"columns of the same length \(2, as `length`\), got 1 in `x`"),
        ({"length": [1.0], "base_diameter": [1e-3]}, "all of base_diameter, tip_diameter, youngs_modulus, or none"),
        ({"length": [1.0], "parabola": [1.0], "curvature": [1.0]}, "either parabola or curvature"),
        ({"length": ["a"]}, r"`table\['length'\]` must be numbers, got \['a'\]"),
        ({"length": [1.0], "taper": [1.5]}, "`table`, whisker 1: `taper` must be a number from 0 to 1, got 1.5"),
        ({"length": [1.0, -1.0]}, "`table`, whisker 2: `length`"),
        ({"length": [1.0, 1.0], "name": ["a", "a"]}, "names that differ from each other, got a, a"),
        (3.0, "a mapping of columns, a DataFrame or the path of a CSV file, got float"),
        ("nowhere.csv", "the path of a CSV file, got nowhere.csv, which does not exist"),
    ],
)
def test_wrong_tables_are_refused(table, words):
    with pytest.raises(ValueError, match=words):
        jw.Array(table)


def test_wrong_names_and_sides_are_refused():
    with pytest.raises(ValueError, match="`whisker` must be one of a, b, c, got 'd'"):
        jw.Array(TABLE).scene("d", BALL)
    with pytest.raises(ValueError, match='`sides` must be a list of "right" and "left", got'):
        jw.Array.rat(["up"])
