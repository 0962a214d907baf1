"""Tables of scans: column names, values, and reading them back."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.observations import read_observations
from jaxwhisker._scan.quantities import REACTIONS
from pictured import summarised, swept
from scenes import model
from several import scanned

CONTROL = np.linspace(0.72, -1.62, 118)
PARSED = 1e-15  # relative: the default parser of pandas 2 is sometimes off by one in the last digit


def scene(stiffness):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(stiffness), rod=jw.ClosedForm())


@pytest.fixture(scope="module")
def result():
    return jw.scan(scene(70.0), CONTROL)


@pytest.fixture(scope="module")
def failed(result):
    """The same scan with three failed steps."""
    lost = slice(40, 43)

    def fail(leaf):
        return leaf.at[lost].set(jnp.nan) if eqx.is_inexact_array(leaf) else leaf

    signals = [getattr(result, name) for name in ("fx", "fy", "mz", "base_x", "contact_force", "spring_length")]
    result = eqx.tree_at(
        lambda r: [r.fx, r.fy, r.mz, r.base_x, r.contact_force, r.spring_length], result, list(map(fail, signals))
    )
    return eqx.tree_at(lambda r: r.status, result, result.status.at[lost].set(jw.Status.lost))


def assert_same(measured, result):
    np.testing.assert_array_equal(measured.control, result.control)
    for c, name in enumerate(REACTIONS):
        np.testing.assert_array_equal(measured.values[:, :, c], getattr(result, name))


def test_a_table_has_one_row_per_step(result):
    table = jw.to_dataframe(result)
    assert len(table) == CONTROL.size and list(table)[:5] == ["control", "fx_1", "fy_1", "mz_1", "base_x_1"]
    assert {"base_angle_2", "contact_y_2", "spring_3", "phase_2", "status"} <= set(table) and "fx_3" not in table
    np.testing.assert_array_equal(table.mz_2, result.mz[:, 1])
    np.testing.assert_array_equal(table.spring_3, result.spring_length[:, 2])
    assert table.phase_1.dtype.kind == "i" and set(table.phase_1) == {0, 1, 2}


@pytest.mark.parametrize("kind", ["result", "failed"])
def test_a_table_is_read_back_exactly(kind, request):
    scanned = request.getfixturevalue(kind)
    assert_same(read_observations(jw.to_dataframe(scanned)), scanned)


@pytest.mark.parametrize("kind", ["result", "failed"])
def test_a_file_is_read_back_to_the_last_digit(kind, request, tmp_path):
    scanned, path = request.getfixturevalue(kind), tmp_path / "scan.csv"
    jw.to_csv(scanned, path)
    assert_same(read_observations(path), scanned)
    read = pd.read_csv(path, comment="#")
    pd.testing.assert_frame_equal(read, jw.to_dataframe(scanned), rtol=PARSED, atol=0, check_dtype=False)
    assert path.read_text().startswith(f"# {scanned.scene}")
    assert not re.search(r",-0\.0(?!\d)", path.read_text())


def test_the_table_of_a_clamped_whisker_has_no_springs(result):
    fields = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    clamped = model("clamped")
    table = jw.to_dataframe(jw.Result(**fields | {"spring_length": jnp.zeros((CONTROL.size, 0)), "scene": clamped}))
    assert not any(name.startswith("spring") for name in table)


def test_the_table_of_a_motion_has_its_times(tmp_path):
    motion, path = swept(), tmp_path / "motion.csv"
    table = jw.to_dataframe(motion)
    assert list(table)[:3] == ["time", "control", "fx_1"] and len(table) == motion.time.size
    for name, column in {"time": motion.time, "mz_1": motion.mz[:, 0], "tip_y_1": motion.tip_y[:, 0]}.items():
        np.testing.assert_array_equal(table[name], column)
    jw.to_csv(motion, path)
    assert_same(read_observations(path), motion)
    assert "; units: time (time), control (L), fx (EI/L^2)" in path.read_text().splitlines()[0]
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), motion)
    with pytest.raises(ValueError, match=r"`result` must be a single simulation, got a batch of shape \(2,\)"):
        jw.to_dataframe(batch)


def with_scene(result, scene):
    fields = {name: getattr(result, name) for name in type(result).__dataclass_fields__}
    return type(result)(**fields | {"scene": scene})


SPRINGS = jw.Support((jw.Spring((0, 1), 50.0, 0.01), jw.Spring((0, 1), 2.0, axis="phi")))
IN_SI = jw.Scene(jw.Whisker(0.08, 1e-3), jw.Parabola(0.02), SPRINGS, motion=jw.Rotation((0.0, 0.0)))
HEADERS = {
    "scan": (lambda result: result, ["control (L)", "fx (EI/L^2)", "mz (EI/L)", "base_angle (rad)", "spring_3 (L)"]),
    "scan in SI": (
        lambda result: with_scene(result, IN_SI),
        ["control (rad)", "fx (N)", "mz (N m)", "spring_1 (m)", "spring_2 (rad)"],
    ),
    "motion": (lambda _: swept(), ["time (time)", "gap (L)", "fx (EI/L^2)"]),
    "motion of unit mass": (
        lambda _: with_scene(swept(), jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2))),
        ["time (T)", "gap (L)"],
    ),
    "deflection": (lambda _: jw.deflect(jw.Whisker(), jw.PointForce(1.0)), ["s (L)", "angle (rad)", "curvature (1/L)"]),
    "deflection in SI": (
        lambda _: jw.deflect(jw.Whisker(0.08, 1e-3), jw.PointForce(1e-2)),
        ["x (m)", "curvature (1/m)", "reaction fx = 0.01", "in N and N m"],
    ),
    "summary": (lambda _: summarised(), ["stiffness (EI/L^3)", "distance (L)", "max_mz (EI/L)"]),
}


UNITS = {
    "scan": {"control": "L", "fx_2": "EI/L^2", "base_angle_1": "rad", "spring_3": "L", "status": None, "phase_1": None},
    "scan in SI": {"control": "rad", "mz_1": "N m", "contact_force_1": "N", "spring_1": "m", "spring_2": "rad"},
    "motion of unit mass": {"time": "T", "gap_1": "L"},
    "deflection in SI": {"x": "m", "curvature": "1/m", "angle": "rad"},
    "summary": {"stiffness": "EI/L^3", "max_mz_1": "EI/L", "snaps": None},
}


@pytest.mark.parametrize("kind", UNITS)
def test_a_data_frame_has_the_units_of_its_columns(kind, result):
    table = jw.to_dataframe(HEADERS[kind][0](result))
    units = table.attrs["units"]
    assert {name: units.get(name) for name in UNITS[kind]} == UNITS[kind]
    assert set(units) <= set(table) and "1" not in units.values()


@pytest.mark.parametrize("kind", HEADERS)
def test_the_header_names_the_units_of_the_columns(kind, result, tmp_path):
    make, words = HEADERS[kind]
    jw.to_csv(made := make(result), tmp_path / "table.csv")
    head, names, *rows = (tmp_path / "table.csv").read_text().splitlines()
    assert head.startswith("# ") and [word for word in words if word not in head] == []
    assert ("taken to be in SI units" in head) == kind.endswith("in SI")
    assert names.split(",") == list(jw.to_dataframe(made)) and len(rows) == len(jw.to_dataframe(made))


def test_a_deflection_has_one_row_for_each_point():
    bent = jw.deflect(jw.Whisker(), jw.PointForce(1.0))
    table = jw.to_dataframe(bent)
    assert list(table) == ["s", "x", "y", "angle", "curvature"]
    np.testing.assert_array_equal(table.x, bent.x)


def test_a_study_has_one_row_for_each_scene_and_drive_position(result, tmp_path):
    peaks = summarised()
    table = jw.to_dataframe(peaks)
    assert list(table) == ["stiffness", "distance", "max_mz_1", "max_mz_2"] and len(table) == 21
    at = table[(table.stiffness == 50.0) & (table.distance == 0.3)]
    assert at.max_mz_2.item() == peaks.max_mz.sel(stiffness=50.0, distance=0.3, whisker=2).item()
    data = result.to_xarray().expand_dims(length=[1.0, 2.0]).assign(peak=("length", [3.0, 4.0]))
    jw.to_csv(data, tmp_path / "study.csv")
    table = pd.read_csv(tmp_path / "study.csv", comment="#")
    assert list(table)[:2] == ["length", "control"] and len(table) == 2 * CONTROL.size
    assert not any(name.startswith(("event_kind", "before", "after")) for name in table)
    second = table[table.length == 2.0]
    np.testing.assert_allclose(second.mz_2, result.mz[:, 1], rtol=PARSED)
    np.testing.assert_allclose(second.spring_3, result.spring_length[:, 2], rtol=PARSED)
    np.testing.assert_array_equal(second.peak, 4.0)


@pytest.mark.unchecked
def test_tables_of_events_or_batches_are_rejected(result):
    with pytest.raises(ValueError, match="`result` must be a Dataset with variables that do not belong to events"):
        jw.to_dataframe(result.to_xarray()[["event_kind"]])
    bent = jax.vmap(lambda f: jw.deflect(jw.Whisker(), jw.PointForce(f)))(jnp.array([1.0, 2.0]))
    with pytest.raises(ValueError, match=r"`result` must be a single deflection, got a batch of shape \(2,\)"):
        jw.to_dataframe(bent)


@pytest.mark.unchecked
@pytest.mark.parametrize("export", [jw.to_dataframe, lambda r: jw.to_csv(r, "never.csv"), jw.Result.to_xarray])
def test_a_batch_is_rejected(export, result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), result)
    with pytest.raises(ValueError, match=r"`result` must be the result of a single scan, got a batch of shape \(3,\)"):
        export(batch)
    assert not list(tmp_path.iterdir())
    first = jax.tree.map(lambda leaf: leaf[0], batch)
    export(first)


@pytest.mark.unchecked
@pytest.mark.parametrize("export", [jw.to_dataframe, lambda r: jw.to_csv(r, "never.csv")])
def test_an_argument_that_is_not_a_result_is_rejected(export):
    with pytest.raises(ValueError, match="`result` must be the Result of a scan, got 3"):
        export(3)


def test_columns_of_several_contacts_have_two_numbers(tmp_path):
    result = scanned()
    table = jw.to_dataframe(result)
    assert {"fx_1", "contact_force_1_1", "contact_force_1_2", "contact_object_1_2", "phase_1_2"} <= set(table)
    assert not {"contact_force_1", "phase_1"} & set(table)
    for contact in (1, 2):
        np.testing.assert_array_equal(table[f"contact_x_1_{contact}"], result.contact_x[:, 0, contact - 1])
        np.testing.assert_array_equal(table[f"phase_1_{contact}"], result.phase[:, 0, contact - 1])
    assert table.attrs["units"]["contact_force_1_2"] == "EI/L^2"
    assert_same(read_observations(table), result)
    jw.to_csv(result, tmp_path / "scan.csv")
    assert list(pd.read_csv(tmp_path / "scan.csv", comment="#")) == list(table)
    of_dataset = jw.to_dataframe(result.to_xarray())
    np.testing.assert_array_equal(of_dataset.contact_arc_1_2, result.contact_arc[:, 0, 1])
