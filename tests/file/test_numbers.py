"""Numbers of a file: their names, what names stand for, and other values."""

import pytest

from jaxwhisker._file.numbers import chosen, numbers_of, with_values
from jaxwhisker._file.reading import Document

TABLES = {
    "friction": 0.1,
    "contacts": 2,
    "whisker": {"length": 1, "bending_stiffness": {"kind": "Table", "s": [0.0, 1.0], "values": [1.0, 0.5]}},
    "objects": [
        {"kind": "circle", "distance": 0.2, "radius": 0.3},
        {"kind": "box", "distance": 0.3, "width": 0.1, "height": 0.2},
        {"kind": "tilted", "angle": 0.1, "profile": {"kind": "circle", "distance": 0.3, "radius": 0.1}},
    ],
    "support": {
        "springs": [{"between": [0, 1], "stiffness": 5.0, "axis": "x"}, {"between": [0, 1], "stiffness": 6.0}],
        "mount": {"x": 0.1},
    },
    "drive": {"kind": "linear_drive", "direction": [-1.0, 0.0, 0.0]},
    "rod": {"steps": 12},
    "scan": {"start": 0.3, "steps": 10},
}
DOCUMENT = Document("sensor.toml", TABLES, {})
NAMES = """
    friction length s.1 s.2 values.1 values.2 objects.1.distance objects.1.radius objects.2.distance width height angle
    profile.distance profile.radius springs.1.stiffness springs.2.stiffness x direction.1 direction.2 direction.3
"""


def test_names_are_as_short_as_they_can_be():
    assert list(numbers_of(DOCUMENT)) == NAMES.split()


def test_numbers_have_their_values():
    found = numbers_of(DOCUMENT)
    assert (found["length"].value, found["profile.radius"].value, found["values.2"].value) == (1.0, 0.1, 0.5)
    assert found["values.2"].listed and not found["springs.2.stiffness"].listed


@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("friction", "friction"),
        ("whisker.length", "length"),
        ("stiffness", "springs.1.stiffness springs.2.stiffness"),
        ("support.springs.2.stiffness", "springs.2.stiffness"),
        ("radius", "objects.1.radius profile.radius"),
        ("objects.3.profile.radius", "profile.radius"),
        ("values", "values.1 values.2"),
        ("direction", "direction.1 direction.2 direction.3"),
        ("objects.1", ""),
        ("contacts", ""),
        ("start", ""),
        ("ength", ""),
        ("", ""),
    ],
)
def test_a_name_stands_for_all_numbers_with_this_key(name, names):
    assert chosen(name, numbers_of(DOCUMENT), DOCUMENT) == names.split()


def test_other_values_leave_the_document_as_it_is():
    numbers = numbers_of(DOCUMENT)
    changed = with_values(DOCUMENT, numbers, {"springs.2.stiffness": 7.0, "direction.3": 1.0}).tables
    assert changed["support"]["springs"][1]["stiffness"] == 7.0 and changed["drive"]["direction"] == [-1.0, 0.0, 1.0]
    assert TABLES["support"]["springs"][1]["stiffness"] == 6.0
    changed["support"]["springs"][1]["stiffness"], changed["drive"]["direction"][2] = 6.0, 0.0
    assert changed == TABLES


def test_a_single_element_needs_no_position():
    document = Document("sensor.toml", {"objects": TABLES["objects"][:1]}, {})
    assert list(numbers_of(document)) == ["distance", "radius"]
    assert chosen("objects.radius", numbers_of(document), document) == ["radius"]
