"""The JSON schema accepts all scenes that are written, and knows keys, kinds and types."""

import copy

import jsonschema
import pytest

from jaxwhisker._file.schema import schema
from jaxwhisker._file.writing import tables_of
from scene_cases import SCENES

SCHEMA = schema()
VALIDATOR = jsonschema.Draft7Validator(SCHEMA)

GOOD = {
    "friction": 0.1,
    "contacts": 2,
    "detect": "none",
    "whisker": {"kind": "conical", "length": 1, "youngs_modulus": 1, "base_diameter": 0.1, "tip_diameter": 0},
    "objects": [
        {"kind": "circle", "distance": 0.2, "radius": 0.3},
        {"kind": "box", "distance": 1, "width": 1, "height": 2},
    ],
    "support": {"kind": "FBFB", "stiffness": [60.0, 70]},
    "drive": {"direction": 1},
    "scan": {"start": 0.5, "stop": -0.5, "steps": 11},
}


def test_the_schema_is_one():
    jsonschema.Draft7Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_are_written_are_accepted(name):
    assert [error.message for error in VALIDATOR.iter_errors(tables_of(SCENES[name]))] == []


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("friction",), "rough"),
        (("contacts",), 2.5),
        (("motor",), {}),
        (("whisker", "length"), "long"),
        (("whisker", "kind"), "cone"),
        (("whisker", "width"), 1.0),
        (("objects", 0, "radius"), "small"),
        (("objects", 0, "radius"), [0.1, 0.2]),
        (("objects", 0, "kind"), "box"),
        (("objects", 1, "kind"), None),
        (("objects", 1, "width"), None),
        (("support", "stiffness"), True),
        (("drive", "direction"), 0.5),
        (("scan", "steps"), 2.5),
        (("scan", "units"), 3),
    ],
)
def test_wrong_values_are_refused(place, value):
    assert VALIDATOR.is_valid(GOOD)
    wrong = copy.deepcopy(GOOD)
    *above, key = place
    table = wrong
    for part in above:
        table = table[part]
    if value is None:
        del table[key]
    else:
        table[key] = value
    assert not VALIDATOR.is_valid(wrong)


def test_keys_have_the_descriptions_and_defaults_of_arguments():
    circle = SCHEMA["definitions"]["circle"]
    assert circle["description"].startswith("Circle of radius r above its lowest point")
    assert circle["required"] == ["distance", "radius"]
    assert circle["properties"]["position"] == {
        **{"description": "x of the centre, a length.", "type": "number", "default": 0.0}
    }
    springs = SCHEMA["definitions"]["spring"]["properties"]
    assert springs["between"]["description"].startswith("(first, second): 0 is the drive")


def test_every_argument_is_described():
    """Only parts that files make of others have arguments without words."""
    internal = {"placed", "linear_taper", "round_section", "round_mass", "power_taper"}
    tables = {name: one for name, one in SCHEMA["definitions"].items() if "properties" in one}
    assert {"circle", "Support.fbfbr", "Whisker.conical", "scan_range"} | internal <= set(tables)
    missing = {
        (name, key)
        for name, table in tables.items()
        for key, value in table["properties"].items()
        if key != "kind" and "description" not in value
    }
    assert {name for name, _ in missing} <= internal
    assert all(
        "description" in value for value in SCHEMA["properties"].values() if value != SCHEMA["properties"]["scan"]
    )
