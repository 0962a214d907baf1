"""The Dataset of a study: which variables it has, and the kinds of its axes."""

import numpy as np
import pytest

from jaxwhisker._scan.dataset import SceneLayout
from jaxwhisker._scan.state import OPTIONAL
from jaxwhisker._study.layout import Layout, chosen, kind_of_axis, variables_of
from jaxwhisker._study.parameters import Parameters
from jaxwhisker._study.summary import SUMMARY

SCENE = SceneLayout("a scene", 2, ("0-1", "1-2"), "angle of the drive", "angle", 1, OPTIONAL, True, {})


def layout(variables):
    parameters = Parameters({"stiffness": np.array([40.0, 70.0])}, False)
    return Layout(parameters, SCENE, "sha256:0", np.array([0.0, 0.1, 0.2]), True, variables, events=5)


def test_groups_and_names_are_in_the_order_of_the_table():
    assert chosen(("status", "reactions")) == ("fx", "fy", "mz", "status")
    assert chosen("mz") == ("mz",)


def test_variables_along_the_control_are_left_out_if_summarised():
    variables = variables_of(("reactions", "events"), (), True)
    assert not any("control" in quantity.axes for quantity in variables.values())
    assert set(SUMMARY) < set(variables) and "event_control" in variables


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
