"""Results in space: spring lengths, tables, Datasets, and functions that are only for the plane."""

# pyright: reportArgumentType=false, reportCallIssue=false

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.channels import example_of
from jaxwhisker._scan.quantities import QUANTITIES, STATE
from jaxwhisker._scan.state import FRICTION_IN_SPACE, OBJECTS, SpaceState, State
from jaxwhisker._study.layout import field_of

ROUNDING = 1e-12  # of a few operations on numbers of the order of 1
SOLVED = 1e-9  # equilibria: the tolerance of Newton's method, with room for stiff springs
PARSED = 1e-15  # relative: the default parser of pandas 2 is sometimes off by one in the last digit
CONTROL = np.linspace(1.2, -1.2, 25)
STIFFNESS = {"x": 60.0, "z": 40.0, "phi_x": 5.0}  # EI/L^3, EI/L


def clamped(height=1.3, z=0.2):
    return jw.SpaceScene(jw.Whisker(), jw.Sphere(1.0, (0.0, height, z)))


def sprung(z=0.2, length=1.0, bending_stiffness=1.0):
    """The same scene in all units."""
    linear, torsion = bending_stiffness / length**3, bending_stiffness / length
    stiffness: dict[str, Any] = {
        name: k * (torsion if name.startswith("phi") else linear) for name, k in STIFFNESS.items()
    }
    sphere = jw.Sphere(length, (0.0, 1.3 * length, z * length))
    return jw.SpaceScene(jw.Whisker(length, bending_stiffness), sphere, jw.Support.follicle(**stiffness))


@pytest.fixture(scope="module")
def result():
    return jw.scan(clamped(), CONTROL)


@pytest.fixture(scope="module")
def rough():
    return jw.scan(jw.Scene(jw.Whisker(), jw.Sphere(1.0, (0.0, 1.3, 0.2)), friction=0.3), CONTROL)


@pytest.fixture(scope="module")
def on_springs():
    return jw.scan(sprung(), CONTROL)


def test_spring_lengths_follow_from_bases_and_reactions(on_springs):
    assert on_springs.scene.support.springs[0].rest_length == 0.0
    across, along_z, turned = np.asarray(on_springs.spring_length).T
    np.testing.assert_allclose(across, on_springs.base_x[:, 0] - CONTROL, atol=ROUNDING)
    np.testing.assert_allclose(along_z, on_springs.base_z[:, 0], atol=ROUNDING)
    tangent = on_springs.base_rotation[:, 0, :, 2]  # (0, cos, sin) of an upright whisker turned about x
    np.testing.assert_allclose(turned, np.arctan2(tangent[:, 2], tangent[:, 1]), atol=ROUNDING)
    for name, length in zip(("fx", "fz", "mx"), (across, along_z, turned), strict=True):
        stiffness = dict(zip(("fx", "fz", "mx"), STIFFNESS.values(), strict=True))[name]
        np.testing.assert_allclose(getattr(on_springs, name)[:, 0], -stiffness * length, atol=SOLVED)
        assert np.ptp(length) > 1e-3


def test_spring_lengths_have_the_units_of_the_scene(on_springs):
    length = 0.08
    scaled = jw.scan(sprung(length=length, bending_stiffness=1e-3), length * CONTROL)
    sizes = [length, length, 1.0]
    np.testing.assert_allclose(scaled.spring_length, on_springs.spring_length * np.array(sizes), atol=SOLVED)


def test_a_clamped_whisker_has_no_springs(result):
    assert result.spring_length.shape == (CONTROL.size, 0)
    assert not any(name.startswith("spring") for name in jw.to_dataframe(result))


def test_spring_lengths_are_differentiable(on_springs):
    lengths = jax.jacfwd(lambda z: jw.scan(sprung(z), CONTROL[8:10]).spring_length)(0.2)
    step = 1e-5  # central differences: error of order step^2
    ahead, behind = (jw.scan(sprung(0.2 + way * step), CONTROL[8:10]).spring_length for way in (1, -1))
    np.testing.assert_allclose(lengths, (ahead - behind) / (2 * step), atol=1e-7)


@pytest.mark.parametrize("kind", ["result", "on_springs"])
def test_a_table_holds_every_signal(kind, request, tmp_path):
    scanned, path = request.getfixturevalue(kind), tmp_path / "scan.csv"
    table = jw.to_dataframe(scanned)
    assert list(table)[:7] == ["control", "fx_1", "fy_1", "fz_1", "mx_1", "my_1", "mz_1"]
    assert len(table) == CONTROL.size and "base_angle_1" not in table and "contact_slope_1" not in table
    for name in ("fz", "mx", "base_z", "contact_z"):
        np.testing.assert_array_equal(table[f"{name}_1"], getattr(scanned, name)[:, 0])
    np.testing.assert_array_equal(table.base_rotation_1_y_d3, scanned.base_rotation[:, 0, 1, 2])
    np.testing.assert_array_equal(table.base_rotation_1_z_d1, scanned.base_rotation[:, 0, 2, 0])
    for k, length in enumerate(np.asarray(scanned.spring_length).T):
        np.testing.assert_array_equal(table[f"spring_{k + 1}"], length)
    jw.to_csv(scanned, path)
    read = pd.read_csv(path, comment="#")
    pd.testing.assert_frame_equal(read, table, rtol=PARSED, atol=0, check_dtype=False)
    of_dataset = jw.to_dataframe(scanned.to_xarray()).reindex(columns=list(table))
    pd.testing.assert_frame_equal(of_dataset, table, check_dtype=False)


def test_the_header_of_a_file_names_the_units(on_springs, tmp_path):
    jw.to_csv(on_springs, tmp_path / "scan.csv")
    head = (tmp_path / "scan.csv").read_text().splitlines()[0]
    words = ["control (L)", "fz (EI/L^2)", "mx (EI/L)", "base_z (L)", "contact_z (L)", "spring_2 (L)", "spring_3 (rad)"]
    assert head.startswith(f"# {on_springs.scene}") and [word for word in words if word not in head] == []


def test_a_dataset_is_that_of_a_study(on_springs):
    data = on_springs.to_xarray()
    studied = jw.study(sprung, control=CONTROL, outputs="all", z=[0.2]).isel(z=0, drop=True).drop_vars("point_status")
    absent = {*(State.__dataclass_fields__.keys() - SPACE_FIELDS), *FRICTION_IN_SPACE, *OBJECTS}
    absent = {name for name in QUANTITIES if field_of(name) in absent}
    energies = {"event_energy_before", "event_energy_after"}
    assert set(data.data_vars) == set(studied.data_vars) == QUANTITIES.keys() - absent - energies - {"control"}
    assert data.sizes == studied.sizes
    for name, one in studied.variables.items():
        other = data[name]
        assert (one.dims, one.dtype, str(one.attrs)) == (other.dims, other.dtype, str(other.attrs)), name
        if one.dtype.kind == "f":
            np.testing.assert_allclose(other, one, rtol=0, atol=SOLVED, err_msg=name)
        else:
            np.testing.assert_array_equal(other, one, err_msg=name)
    np.testing.assert_array_equal(data.base_rotation, on_springs.base_rotation)
    assert data.base_rotation.sel(component="y", director="d3", whisker=1)[0] == 1.0  # upright while it is free
    assert data.spring_length.attrs["comment"].startswith("torsion springs (`between` ends in phi, phi_x or phi_y)")
    np.testing.assert_array_equal(data.between, ["0-1", "0-1 z", "0-1 phi_x"])


SPACE_FIELDS = SpaceState.__dataclass_fields__.keys()


def test_tables_and_datasets_have_the_fields_of_friction(rough):
    table, data = jw.to_dataframe(rough), rough.to_xarray()
    for name in FRICTION_IN_SPACE:
        np.testing.assert_array_equal(table[f"{name}_1"], getattr(rough, name)[:, 0])
        np.testing.assert_array_equal(data[name][:, 0], getattr(rough, name)[:, 0])
        assert f"before_{name}" in data and f"after_{name}" in data
    assert "friction_force" not in data
    assert data.slip.attrs["long_name"] == "whether the contact slips along the object"
    assert data.slip.attrs["flag_meanings"] == "sticks slips" and list(data.slip.attrs["flag_values"]) == [0, 1]


@pytest.mark.parametrize("kind", ["result", "rough"])
def test_examples_have_the_fields_of_results(kind, request):
    scanned = request.getfixturevalue(kind)
    example = example_of(scanned.scene)
    for name in SPACE_FIELDS:
        one, other = getattr(scanned, name), getattr(example, name)
        assert (one is None) == (other is None), name
        assert one is None or (one.dtype, one.shape[1:]) == (other.dtype, other.shape[1:]), name


def test_a_dataset_says_about_which_axis_moments_are(result):
    data = result.to_xarray()
    for axis in "xyz":
        for name, when in ((f"m{axis}", ""), (f"before_m{axis}", ", before the event")):
            words = data[name].attrs
            assert words["long_name"] == f"moment of the support reaction about {axis}{when}"
            assert words["units"] == "EI/L" and words["positive_means"] == f"right-handed about +{axis}"
    assert "mx, my, mz (right-handed" in data.attrs["signs"]


def test_a_result_prints_its_scene_and_events(result):
    lines = str(result).splitlines()
    assert lines[:2] == [str(result.scene), "25 of 25 steps ok"]
    assert [line.split("  ")[1] for line in lines[2:]] == [f"{event.kind} of whisker 1" for event in result.events]
    assert [event.kind for event in result.events][::3] == [jw.EventKind.touch, jw.EventKind.release]
    assert not result.events.truncated


def test_events_know_how_far_the_drive_has_travelled(result):
    count = len(result.events)
    np.testing.assert_allclose(result.events.travel[:count], CONTROL[0] - result.events.control[:count], atol=ROUNDING)


@pytest.mark.unchecked
@pytest.mark.parametrize("export", [jw.to_dataframe, lambda r: jw.to_csv(r, "never.csv"), jw.SpaceResult.to_xarray])
def test_a_batch_is_rejected(export, result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), result)
    with pytest.raises(ValueError, match=r"`result` must be the result of a single scan, got a batch of shape \(3,\)"):
        export(batch)
    assert not list(tmp_path.iterdir())


SCENE: Any = clamped()
RESULT: Any = example_of(SCENE)
MEASURED = {name: np.zeros(9) for name in ("control", "fx", "fy", "mz")}


ONE = {"stiffness": 1.0}
# Calls of all functions that are only for the plane, or only without friction in space, and the argument that the error
# names.
REFUSED = {
    "critical_stiffness": (lambda: jw.critical_stiffness(jw.Whisker(), SCENE.surface), "profile"),
    "energy_balance": (lambda: jw.energy_balance(RESULT), "result"),
    "fit_contour": (lambda: jw.fit_contour(MEASURED, SCENE), "sensor"),
    "fit_contour of a result": (lambda: jw.fit_contour(RESULT, family=jw.Sphere), "measured"),
    "fit_profile": (lambda: jw.fit_profile(RESULT, jw.Circle), "points"),
    "identify of a result": (lambda: jw.identify(in_plane, ONE, RESULT), "measured"),
    "lateral_loss": (lambda: jw.lateral_loss(RESULT), "result"),
    "lateral_stability": (lambda: jw.lateral_stability(RESULT), "result"),
    "modes": (lambda: jw.modes(SCENE), "at"),
    "modes of a result": (lambda: jw.modes(RESULT), "at"),
    "reconstruct of a result": (lambda: jw.reconstruct(RESULT, jw.Sensor(jw.Whisker())), "measured"),
    "simulate": (lambda: jw.simulate(SCENE, np.zeros(2), 1.0), "scene"),
    "simulate from a result": (lambda: jw.simulate(HEAVY, np.ones(2), 1.0, start=RESULT), "start"),
    "stored_energy": (lambda: jw.stored_energy(SCENE, RESULT), "scene"),
    "stored_energy of a state": (lambda: jw.stored_energy(HEAVY, RESULT), "state"),
    "Sensor.of": (lambda: jw.Sensor.of(SCENE), "scene"),
    "Scene that detects": (lambda: jw.Scene(jw.Whisker(), SCENE.surface, detect=()), "detect"),
    "plot.contour": (lambda: jw.plot.contour(RESULT), "result"),
    "plot.deflection": (lambda: jw.plot.deflection({"one": RESULT}), "results"),
    "plot.fit": (lambda: jw.plot.fit(RESULT), "result"),
    "plot.information": (lambda: jw.plot.information(RESULT), "result"),
    "plot.lateral_losses": (lambda: jw.plot.lateral_losses(RESULT, np.zeros(1), axs=[]), "result"),
    "plot.profile": (lambda: jw.plot.profile(SCENE.surface), "shape"),
}
# Functions that accept scans in space, or neither scenes nor results.
OTHERS = {
    "plot.spring_lengths",
    "plot.spring_extensions",
    "plot.signal",
    "plot.strain",
    "plot.shapes",
    "bending",
    "strain",
    "plot.scene",
    "plot.reactions",
    "plot.phases",
    "plot.overview",
    "plot.in_words",
    "plot.control_axis",
    "plot.contact_range",
    "plot.compare",
    "plot.axis_label",
    "shapes",
    "animate",
    "deflect",
    "design",
    "explore",
    "identify",
    "information",
    "load_control",
    "load_scene",
    "read_columns",
    "save_scene",
    "scan",
    "study",
    "summary",
    "tactile_image",
    "to_csv",
    "to_dataframe",
    "plot.same_window",
    "plot.save",
    "plot.study",
    "plot.tactile_image",
}
HEAVY = jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2))


def in_plane(stiffness):
    return jw.Scene(jw.Whisker(1.0, stiffness), jw.Parabola(0.2))


@pytest.mark.unchecked
@pytest.mark.parametrize("name", REFUSED)
def test_functions_for_the_plane_refuse_scans_in_space(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, argument = REFUSED[name]
    of_other_kind = name in ("critical_stiffness", "fit_contour of a result", "fit_profile", "plot.profile")
    with pytest.raises(ValueError, match=f"^`{argument}` must") as error:
        call()
    wanted = "because scans in space are not supported here"
    if name.startswith("Scene "):
        wanted = "None in space"
    assert of_other_kind or wanted in str(error.value)
    assert not list(tmp_path.iterdir())


def test_every_public_function_accepts_or_refuses_scans_in_space():
    public = {name for name in jw.__all__ if name[0].islower()}
    public |= {f"plot.{name}" for name in jw.plot.__all__ if name[0].islower()}
    assert public <= {name.split(" ")[0] for name in REFUSED} | OTHERS


def test_the_table_of_quantities_has_every_field_of_a_state():
    assert STATE.keys() >= SPACE_FIELDS
