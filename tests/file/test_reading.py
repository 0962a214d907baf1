"""Errors in files name the file, the line, the key, its value and what is allowed."""

import pytest

import jaxwhisker as jw
from jaxwhisker._file.reading import Document, SceneFileError

SENSOR = """\
# a sensor
friction = 0.1

[whisker]
kind = "conical"
length = 0.05
youngs_modulus = 3e9
base_diameter = 2e-4
tip_diameter = 2e-5

[whisker.intrinsic_curvature]
kind = "polynomial"
coefficients = [
    1.0,
    2.0,
]
length = 0.05

[support]
kind = "FBFB"
stiffness = 70
rest_length = 0.01

[[objects]]
kind = "circle"
distance = 0.02
radius = 0.01

[[objects]]
kind = "ellipse"
distance = 0.02
a = 0.01
b = 0.02
position = 0.2

[drive]
direction = -1

[scan]
start = 0.1
stop = -0.1
steps = 21
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def load(text):
        (tmp_path / "sensor.toml").write_text(text)
        return jw.load_scene("sensor.toml")

    return load


def test_the_file_is_read(load):
    scene = load(SENSOR)
    whisker = jw.Whisker.conical(0.05, 3e9, 2e-4, 2e-5, intrinsic_curvature=jw.Polynomial([1.0, 2.0], length=0.05))
    objects = jw.Circle(0.02, 0.01), jw.Ellipse(0.02, 0.01, 0.02, 0.2)
    expected = jw.Scene(whisker, objects, jw.Support.fbfb(70, 0.01), friction=0.1)
    assert str(scene) == str(expected)
    assert float(scene.whiskers[0].curvature_at(0.05)) == 3.0


AXES = "distance = 0.02\na = 0.01\nb = 0.02\nposition = 0.2"
WRONG = {  # what is replaced, by what, the line, and words of the message
    "value": ("radius = 0.01", "radius = -0.01", 27, ["`radius`", "positive", "-0.01", "circle"]),
    "text for a number": ("radius = 0.01", 'radius = "small"', 27, ["`radius`", "number", "'small'"]),
    "truth for a number": ("radius = 0.01", "radius = true", 27, ["`radius`", "number", "True"]),
    "time for a number": ("radius = 0.01", "radius = 1979-05-27", 27, ["`radius`", "number", "1979"]),
    "array for a number": ("radius = 0.01", "radius = [0.1, 0.2]", 27, ["`radius`", "number", "shape (2,)"]),
    "table for a number": ("radius = 0.01", "radius = { r = 0.01 }", 27, ["`radius` must not be a table", "r"]),
    "none for a number": ("radius = 0.01", 'radius = "none"', 27, ["`radius`", "number", "None"]),
    "unknown key": ("a = 0.01", "aa = 0.01", 32, ["`aa` is not a key of ellipse", "distance, a, b, position", "`a`?"]),
    "missing key": ("b = 0.02", "", 29, ["`b` is missing in ellipse"]),
    "kind": ('"ellipse"', '"elipse"', 30, ["`kind` of `objects`", "parabola, circle,", "'elipse'", "ellipse?"]),
    "kind that is a number": ('"ellipse"', "3", 30, ["`kind` of `objects`", "got 3"]),
    "missing kind": ('kind = "ellipse"', "", 29, ["`kind` is missing in `objects`", "parabola, circle"]),
    "kind of the support": ('"FBFB"', '"FBX"', 20, ["`kind` of `support`", "fbfbr", "'FBX'"]),
    "number of stiffnesses": ("stiffness = 70", "stiffness = [1, 2, 3]", 21, ["`stiffness`", "one per spring (2)"]),
    "element of an array": ("    2.0,", "    nan,", 13, ["`coefficients`", "nan at index 1", "polynomial"]),
    "function": ('"polynomial"', '"sine"', 12, ["`intrinsic_curvature`", "table, polynomial", "'sine'"]),
    "material": ("youngs_modulus = 3e9", "youngs_modulus = 0", 7, ["`youngs_modulus`", "0.0", "conical"]),
    "unknown part": ("[drive]", "[motor]", 36, ["`motor` is not a key of the scene", "drive", "scan"]),
    "name in Python": ("[drive]", "[motion]", 36, ["`motion` is not a key of the scene"]),
    "friction": ("friction = 0.1", "friction = -0.1", 2, ["`friction`", "-0.1"]),
    "part of the scene": ("friction = 0.1", "detect = 3", 2, ["`detect`", "second_contact", "3"]),
    "a profile and a surface": (
        f'"ellipse"\n{AXES}',
        '"paraboloid"\ndistance = 0.1',
        24,
        ["`objects` must be a Sphere", "tuple of these"],
    ),
    "drive": ("direction = -1", "direction = 2", 37, ["`direction`", "-1 or 1", "2"]),
    "part of a point": (
        "direction = -1", 'kind = "rotation"\npivot = [0, nan]', 38, ["`pivot[1]`", "nan", "rotation"]
    ),
    "steps": ("steps = 21", "steps = 1", 42, ["`steps`", "at least 2", "1", "scan"]),
    "syntax": ("distance = 0.02", "distance = ", 26, ["not TOML", "Invalid value"]),
    "key twice": ("b = 0.02", "a = 0.02", 33, ["not TOML", "overwrite"]),
    "end": ("steps = 21\n", "steps = [21\n", 42, ["not TOML"]),
}  # fmt: skip


@pytest.mark.unchecked
@pytest.mark.parametrize("name", WRONG)
def test_errors_name_the_line(name, load):
    old, new, line, words = WRONG[name]
    assert old in SENSOR
    with pytest.raises(SceneFileError) as caught:
        load(SENSOR.replace(old, new, 1))
    message = str(caught.value)
    assert message.startswith(f"sensor.toml, line {line}") and "\n" not in message
    assert [word for word in words if word not in message] == []


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[whisker]", ["`objects` is missing in the scene"]),
        ("whisker = 3\nobjects = 4", ["line 2", "`objects` must be a Parabola, Circle", "got 4"]),
        ("[whisker]\n[objects]", ["line 2", "`kind` is missing"]),
        ('[whisker]\n[objects]\nkind = "graph"\ng = 1', ["line 4", "`g`", "function"]),
        ('[whisker]\nlength = 1\n[objects]\nkind = "motion"', ["line 4", "`kind` of `objects`"]),
    ],
)
def test_incomplete_files_are_refused(text, words, load):
    with pytest.raises(SceneFileError) as caught:
        load(text)
    assert [word for word in ("sensor.toml", *words) if word not in str(caught.value)] == []


def test_files_that_do_not_exist_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"`path` must be the path of a TOML file, got nowhere\.toml"):
        jw.load_scene("nowhere.toml")
    with pytest.raises(ValueError, match="directory"):
        jw.load_scene(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"a = '\xe9'")
    with pytest.raises(ValueError, match="utf-8"):
        jw.load_scene(tmp_path / "latin.toml")


def test_marks_of_editors_are_skipped(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(SENSOR, "utf-8-sig")
    assert path.read_bytes()[:3] == b"\xef\xbb\xbf"
    assert jw.load_scene(path).support.whiskers == 2


def test_errors_about_places_without_a_line_name_what_contains_them():
    document = Document("sensor.toml", {}, {("a",): 3})
    assert str(document.error(("a", "b", 1), "wrong")) == "sensor.toml, line 3: wrong"
    assert str(document.error(("b",), "wrong", "box")) == "sensor.toml (box): wrong"
