"""TOML: the lines of values, in any layout, and texts that `tomllib` reads as they were meant."""

import math
import tomllib

import hypothesis.strategies as st
import pytest
from hypothesis import given

from jaxwhisker._file.toml import WIDTH, lines_of, text_of

TEXT = """\
# a comment with [brackets] and "quotes"
friction = 0.1 # 2
"two words".inner = 1
dotted . name = "[a]"

[whisker] # of one
length = 5e-2
table = { s = [0.0, 1.0], values = [
    1.0, # base
    2.0, ] }
story = \"\"\"
line = 1
[fake]
\\"\"\" still \"\"\"\"\"
end = '''
a = "b"'''

[[objects]]
kind = 'circle # not'
when = 1979-05-27 07:32:00
[objects.inner]
deep = true
[[objects]]
corners = [
    [1, 2],
    [3,
     4],
]
[[objects.parts]]
x = 1
[[objects.parts]]
x = 2
"""
LINES = {
    ("friction",): 2,
    ("two words", "inner"): 3,
    ("dotted", "name"): 4,
    ("whisker",): 6,
    ("whisker", "length"): 7,
    ("whisker", "table", "values"): 8,
    ("whisker", "table", "values", 1): 10,
    ("whisker", "story"): 11,
    ("whisker", "end"): 15,
    ("objects", 0): 18,
    ("objects", 0, "when"): 20,
    ("objects", 0, "inner"): 21,
    ("objects", 0, "inner", "deep"): 22,
    ("objects", 1): 23,
    ("objects", 1, "corners", 1): 26,
    ("objects", 1, "corners", 1, 1): 27,
    ("objects", 1, "parts", 0): 29,
    ("objects", 1, "parts", 1, "x"): 32,
}


def places(value, place=()):
    """Places of all values of a document."""
    yield place
    for key, one in value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ()):
        yield from places(one, (*place, key))


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_every_value_has_its_line(newline):
    text = TEXT.replace("\n", newline)
    found = lines_of(text)
    assert {place: found[place] for place in LINES} == LINES
    assert set(found) == set(places(tomllib.loads(text))) - {()}


KEYS = st.text("abc_-", min_size=1, max_size=3)
NUMBERS = st.floats(allow_nan=False) | st.integers(-(2**60), 2**60)
PLAIN = NUMBERS | st.booleans() | st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
VALUES = st.recursive(
    PLAIN, lambda below: st.lists(below, max_size=4) | st.dictionaries(KEYS, below, max_size=4), max_leaves=20
)


@given(st.dictionaries(KEYS, VALUES, max_size=5))
def test_texts_are_read_as_they_were_meant(document):
    text = text_of(document)
    assert repr(sorted_keys(tomllib.loads(text))) == repr(sorted_keys(document))
    assert set(lines_of(text)) == set(places(document)) - {()}


def sorted_keys(value):
    if isinstance(value, dict):
        return {key: sorted_keys(value[key]) for key in sorted(value)}
    return [sorted_keys(one) for one in value] if isinstance(value, list) else value


def test_numbers_that_are_not_finite_are_written():
    read = tomllib.loads(text_of({"a": [math.inf, -math.inf, math.nan]}))["a"]
    assert read[:2] == [math.inf, -math.inf] and math.isnan(read[2])


def test_tables_have_headers_and_long_arrays_have_a_line_for_each_element():
    text = text_of({"support": {"springs": [{"at": 1.0}, {}]}, "scan": {}, "x": 1, "many": [0.125] * WIDTH})
    assert text.startswith("x = 1\nmany = [\n    0.125,\n")
    assert text.endswith("]\n\n[[support.springs]]\nat = 1.0\n\n[[support.springs]]\n\n[scan]\n")
