"""The Dataset of a study: which variables it has, and the kinds of its axes."""

import numpy as np
import pytest

from jaxwhisker._scan.dataset import SceneLayout
from jaxwhisker._scan.quantities import ABSENT_IN_SPACE
from jaxwhisker._scan.state import FRICTION_IN_SPACE, OPTIONAL
from jaxwhisker._study.layout import Layout, chosen, kind_of_axis, variables_of
from jaxwhisker._study.parameters import Parameters
from jaxwhisker._study.summary import SUMMARY, summary_without

SCENE = SceneLayout("a scene", 2, ("0-1", "1-2"), "angle of the drive", "angle", 1, OPTIONAL, True, {})


def layout(variables):
    parameters = Parameters({"stiffness": np.array([40.0, 70.0])}, False)
    return Layout(parameters, SCENE, "sha256:0", np.array([0.0, 0.1, 0.2]), True, variables, events=5)


def test_groups_and_names_are_in_the_order_of_the_table():
    assert chosen(("status", "reactions"), OPTIONAL) == ("fx", "fy", "mz", "status")
    assert chosen("reactions", ABSENT_IN_SPACE) == ("fx", "fy", "fz", "mx", "my", "mz")
    springs = ("base_x", "base_y", "base_z", "base_rotation", "spring_length")
    assert chosen("springs", ABSENT_IN_SPACE) == springs
    assert chosen("mz") == ("mz",)


def test_variables_along_the_control_are_left_out_if_summarised():
    variables = variables_of(("reactions", "events"), (), True)
    assert not any("control" in quantity.axes for quantity in variables.values())
    assert set(summary_without(OPTIONAL)) < set(variables) and "event_control" in variables


def test_a_summary_has_what_the_scenes_have():
    plane, space = summary_without(OPTIONAL), summary_without(ABSENT_IN_SPACE)
    assert SUMMARY.keys() - plane.keys() == {f"{way}_{n}" for way in WAYS for n in ("fz", "mx", "my")}
    assert SUMMARY.keys() - space.keys() == {"snap_work"}
    assert list(plane) == [name for name in SUMMARY if name in plane]


WAYS = ("max", "min", "control_of_max", "control_of_min")


@pytest.mark.parametrize(
    ("name", "absent", "lack"),
    [
        ("fz", OPTIONAL, "object in space"),
        ("before_base_rotation", OPTIONAL, "object in space"),
        ("friction_x", OPTIONAL, "object in space"),
        ("friction_force", OPTIONAL, "friction"),
        ("slip", (*ABSENT_IN_SPACE, *FRICTION_IN_SPACE), "friction"),
        ("after_friction_x", (*ABSENT_IN_SPACE, *FRICTION_IN_SPACE), "friction"),
        ("friction_force", ABSENT_IN_SPACE, "friction_force in space"),
        ("base_angle", ABSENT_IN_SPACE, "base_angle in space"),
        ("event_energy_before", ABSENT_IN_SPACE, "event_energy_before in space"),
    ],
)
def test_outputs_that_scenes_do_not_have_are_rejected(name, absent, lack):
    with pytest.raises(ValueError, match=rf"`outputs` must be .* but they have no {lack}: got '{name}'\."):
        variables_of(name, (), False, absent)


def test_a_rotation_has_labelled_axes():
    found = layout(variables_of("base_rotation", (), False, ABSENT_IN_SPACE))
    assert found.dims("base_rotation") == ("stiffness", "control", "whisker", "component", "director")
    assert found.shape("base_rotation") == (2, 3, 2, 3, 3)
    assert list(found.frame().director.values) == ["d1", "d2", "d3"]
    assert list(found.frame().component.values) == ["x", "y", "z"]


def test_derivatives_have_the_unit_of_the_quotient():
    variables = variables_of(("mz", "event_control", "status"), ("stiffness",), False)
    assert {name for name in variables if name.startswith("d_")} == {"d_mz_d_stiffness", "d_event_control_d_stiffness"}
    found = layout(variables)
    assert found.attributes("d_mz_d_stiffness")["units"] == "L^2"
    assert found.attributes("d_event_control_d_stiffness")["units"] == "rad L^3/EI"
    assert found.shape("d_mz_d_stiffness") == (2, 3, 2) and found.shape("event_control") == (2, 5)


def test_a_default_control_says_so():
    assert layout(variables_of("mz", (), False)).frame().control.attrs["comment"].startswith("default")
    explicit = layout(variables_of("mz", (), False))._replace(default_control=False)
    assert "comment" not in explicit.frame().control.attrs


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("stiffness", "stiffness"),
        ("stiffness_2", "stiffness"),
        ("bending_stiffness", "bending stiffness"),
        ("rest_length", "length"),
        ("distance", "length"),
        ("a", "number"),
    ],
)
def test_the_kind_of_an_axis_follows_from_its_name(name, kind):
    assert kind_of_axis(name) == kind
