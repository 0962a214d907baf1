"""The Dataset of a scan: the same variables and labels as those of a study, units, failures, omitted events."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._inverse.observations import read_observations
from jaxwhisker._scan.dataset import VARIABLES, layout_of, omitted_events, points_in_words
from jaxwhisker._scan.quantities import REACTIONS
from jaxwhisker._scan.state import OPTIONAL
from jaxwhisker._study.layout import field_of
from scenes import model
from several import scanned

CONTROL = np.linspace(0.72, -1.62, 118)
SAME = 1e-9  # a scan in a batch and alone, relative to the largest value


def scene(stiffness):
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(stiffness), rod=jw.ClosedForm())


@pytest.fixture(scope="module")
def result():
    return jw.scan(scene(70.0), CONTROL)


def test_is_that_of_a_study(result):
    data = result.to_xarray()
    studied = jw.study(scene, control=CONTROL, outputs="all", stiffness=[70.0]).isel(stiffness=0, drop=True)
    assert int(studied.point_status) == jw.Status.ok
    studied = studied.drop_vars("point_status")
    assert set(data.variables) == set(studied.variables)
    assert {name for name in VARIABLES if field_of(name) not in OPTIONAL} <= set(data.variables)
    assert data.sizes == studied.sizes
    for name, one in studied.variables.items():
        other = data[name]
        assert (one.dims, one.dtype, str(one.attrs)) == (other.dims, other.dtype, str(other.attrs)), name
        if one.dtype.kind == "f":
            np.testing.assert_allclose(other, one, rtol=0, atol=SAME * max(np.nanmax(np.abs(one)), 1.0), err_msg=name)
        else:
            np.testing.assert_array_equal(other, one, err_msg=name)
    assert data.attrs.keys() == studied.attrs.keys() - {"build"}
    assert all(data.attrs[name] == studied.attrs[name] for name in data.attrs if name != "date")
    measured = read_observations(data)
    np.testing.assert_array_equal(measured.control, result.control)
    for c, name in enumerate(REACTIONS):
        np.testing.assert_array_equal(measured.values[:, :, c], getattr(result, name))


def test_counts_what_failed(result):
    failed = eqx.tree_at(lambda r: r.status, result, result.status.at[40:43].set(jw.Status.lost))
    assert failed.to_xarray().attrs["points"] == "0 of 1 ok; 1 lost"


def test_points_in_words_are_sorted_by_their_number():
    status = np.array([[0, 1, 1], [2, 0, 0]])
    assert points_in_words(status) == "3 of 6 ok; 2 invalid; 1 lost"


def test_has_the_units_of_the_scene(result):
    assert result.to_xarray().fx.attrs["units"] == "EI/L^2"
    long = eqx.tree_at(lambda r: r.scene.whisker.length, result, jnp.asarray(2.0))
    data = long.to_xarray()
    units = {"fx": "N", "mz": "N m", "control": "m", "base_angle": "rad", "event_energy_before": "N m", "phase": "1"}
    assert {name: data[name].attrs["units"] for name in units} == units
    assert "SI units" in data.attrs["units_comment"] and "units_comment" not in result.to_xarray().attrs
    np.testing.assert_array_equal(data.fx, result.fx)  # in metres and newtons, without prefixes


@pytest.mark.parametrize(
    ("motion", "unit"),
    [
        (jw.Translation(+1), "L"),
        (jw.Rotation(), "rad"),
        (jw.Motion(lambda u: (-u, 0.0, 0.0), -1.0, 1.0), "1"),
    ],
    ids=["length", "angle", "number"],
)
def test_positions_have_the_unit_of_the_control(result, motion, unit):
    fields: dict[str, Any] = {name: getattr(result, name) for name in jw.Result.__dataclass_fields__}
    moved = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0), motion=motion)
    fields["scene"] = moved
    data = jw.Result(**fields).to_xarray()
    assert data.event_control.attrs["units"] == data.control.attrs["units"] == unit
    assert jw.summary(data).contact_width.attrs["units"] == unit
    assert data.base_x.attrs["units"] == "L"


def test_events_that_are_omitted_are_counted(result):
    assert "omitted_events" not in result.to_xarray().attrs
    more = eqx.tree_at(lambda r: r.events.count, result, jnp.asarray(1999))
    room = result.events.kind.size
    words = f"1 of 1 points have more than the {room} events stored, up to 1,999"
    assert more.to_xarray().attrs["omitted_events"] == words
    assert omitted_events(np.array([1, 2]), 2) == {}


def test_torsion_springs_have_angles():
    for support, comments in ((jw.Support.follicle(x=70.0, phi=10.0), True), (jw.Support.fb(70.0), False)):
        layout = layout_of(jw.Scene(jw.Whisker(), jw.Parabola(0.2), support))
        assert ("comment" in layout.attributes("spring_length", VARIABLES["spring_length"])) == comments


def test_a_clamped_whisker_has_no_springs():
    coordinates = layout_of(model("clamped")).coordinates(CONTROL, {"spring"})
    assert coordinates["spring"][1].size == coordinates["between"][1].size == 0
    assert "whisker" not in coordinates


def test_contacts_are_a_dimension_if_there_may_be_several():
    result = scanned()
    data = result.to_xarray()
    assert data.contact_force.dims == ("control", "whisker", "contact") and data.fx.dims == ("control", "whisker")
    assert data.after_phase.dims == ("event", "whisker", "contact")
    np.testing.assert_array_equal(data.contact, [1, 2])
    np.testing.assert_array_equal(data.contact_arc, result.contact_arc)
    assert float(data.event_energy_before[5]) > float(data.event_energy_after[5]) == 0.0
