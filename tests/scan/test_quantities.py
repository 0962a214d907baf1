"""The table of quantities: complete, and with the right units and labels."""

import dataclasses

import numpy as np
import pytest

import jaxwhisker as jw
from jaxwhisker._scan.quantities import (
    CONTROL,
    DERIVED,
    DIRECTORS,
    DRAWN,
    KINDS,
    QUANTITIES,
    REACTIONS,
    REACTIONS_IN_SPACE,
    STATE,
    UnitSystem,
    control_kind,
    control_name,
    dimensionless_label,
    in_si,
    kind_of,
    unit_in_words,
    with_prefix,
)
from jaxwhisker._scan.result import Result, SpaceResult
from jaxwhisker._scan.state import IN_SPACE, SpaceState, State

ROUNDING = 1e-14

LENGTH, BENDING_STIFFNESS = 0.05, 2.4e-5  # m, N m^2: of an artificial whisker
PLAIN = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(70.0))
SI = jw.Scene(jw.Whisker(LENGTH, BENDING_STIFFNESS), jw.Parabola(0.01, 20.0), jw.Support.fb(13.0, 0.01))
ROTATING = jw.Scene(jw.Whisker(), jw.Parabola(0.2), motion=jw.Rotation((0.0, -0.5), 0.5))
MOVING = jw.Scene(jw.Whisker(), jw.Parabola(0.2), motion=jw.Motion(lambda u: (1 - u, 0.0, 0.0), 0.0, 2.0))


def in_space(motion):
    return jw.Scene(jw.Whisker(LENGTH, BENDING_STIFFNESS), jw.Sphere(0.05, (0.0, 0.065, 0.01)), motion=motion)


def test_every_field_of_a_result_is_in_the_table():
    fields = {field.name for field in dataclasses.fields(State)} - {"shaft_loads"}  # one per spring between shafts
    in_space = {field.name for field in dataclasses.fields(SpaceState)}
    assert set(STATE) == fields | in_space and set(IN_SPACE) == in_space - fields
    for kind, own in ((Result, fields), (SpaceResult, in_space)):
        others = {field.name for field in dataclasses.fields(kind)} - own - {"shaft_loads"}
        assert others - set(QUANTITIES) == {"deferred_events", "scene"}
        assert {f"{when}_{name}" for when in ("before", "after") for name in own} <= set(QUANTITIES)
    assert set(REACTIONS) < fields and set(REACTIONS_IN_SPACE) < in_space
    assert set(DRAWN) <= set(QUANTITIES | DERIVED) - set(IN_SPACE) and "phase" not in DRAWN


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_is_well_formed(name):
    quantity = QUANTITIES[name]
    assert quantity.kind in (*KINDS, CONTROL)
    assert quantity.description and quantity.description[0].islower()
    assert set(quantity.axes) <= {"control", "whisker", "spring", "event", *DIRECTORS}
    assert np.asarray(quantity.fill, dtype=quantity.dtype).dtype == quantity.dtype
    if name.startswith("event_") or name.startswith(("before_", "after_")):
        assert "control" not in quantity.axes


def test_values_where_nothing_is_known():
    assert np.isnan(QUANTITIES["fx"].fill)
    assert QUANTITIES["event_kind"].fill == -1
    assert QUANTITIES["event_whisker"].fill is False


@pytest.mark.parametrize(
    ("scene", "kind", "name"),
    [
        (PLAIN, "length", "drive position"),
        (ROTATING, "angle", "angle of the drive"),
        (MOVING, "number", "control"),
        (in_space(jw.Translation()), "length", "drive position"),
        (in_space(jw.LinearDrive((-3.0, 0.0, 4.0))), "length", "drive position"),
        (in_space(jw.RotaryDrive((1.0, 0.0, 0.0))), "angle", "angle of the drive"),
        (in_space(jw.WhiskDrive(elevation=0.1)), "angle", "angle of the drive"),
        (in_space(jw.PoseDrive(lambda u: ((-u, 0.0, 0.0), (0.0, 0.0, u)), 0.0, 2.0)), "number", "control"),
    ],
    ids=["translation", "rotation", "motion", "in space", "linear", "rotary", "whisking", "user-defined"],
)
def test_the_control_is_what_the_motion_has(scene, kind, name):
    assert control_kind(scene) == kind_of("control", scene) == kind_of("event_control", scene) == kind
    assert control_name(scene) == name
    assert kind_of("fx", scene) == "force"


def test_a_scene_in_space_has_si_units():
    units = UnitSystem(in_space(jw.LinearDrive((1.0, 0.0, 0.0))))
    names = {"control": "mm", "fz": "mN", "mx": "mN mm", "base_z": "mm", "contact_z": "mm", "base_rotation": ""}
    assert {name: units.unit(name).name for name in names} == names
    assert units.label("my") == "$m_y$ (mN mm)"
    support = jw.Support.follicle(z=13.0, phi_x=1e-3)
    units = UnitSystem(jw.Scene(SI.whisker, jw.Sphere(0.05, (0.0, 0.065, 0.01)), support))
    np.testing.assert_allclose(units.shown("spring_length", np.array([[0.01, 0.3]])), [[10.0, 0.3]], rtol=ROUNDING)


def test_a_dimensionless_scene():
    units = UnitSystem(PLAIN)
    assert units.dimensionless
    labels = {"control": "$u/L$", "fx": r"$f_x\,L^2/EI$", "mz": r"$m_z\,L/EI$", "contact_slope": r"$\alpha$ (rad)"}
    assert {name: units.label(name) for name in labels} == labels
    assert units.unit("fx") == ("", 1.0)
    assert units.unit("phase") == ("", 1.0)


def test_a_scene_in_si_units():
    units = UnitSystem(SI)
    assert not units.dimensionless
    # 0.05 m are shown in mm; EI / L^2 = 9.6 mN.
    expected = {
        "control": ("mm", 1e-3),
        "fx": ("mN", 1e-3),
        "mz": ("mN mm", 1e-6),
        "event_energy_after": ("mN mm", 1e-6),
    }
    for name, (unit, size) in expected.items():
        assert units.unit(name).name == unit
        np.testing.assert_allclose(units.unit(name).size, size, rtol=ROUNDING)
    assert units.of_kind("stiffness").name == "N/m"
    np.testing.assert_allclose(units.of_kind("stiffness").size, 1.0, rtol=ROUNDING)
    assert (units.of_kind("curvature").name, dimensionless_label("k", "curvature")) == ("1/mm", r"$k\,L$")
    assert UnitSystem(jw.Scene(jw.Whisker(0.033, 2e-8), jw.Parabola(0.01))).of_kind("stiffness").name == "mN/m"
    assert units.of_kind("bending stiffness").name == "mN mm^2"
    assert (units.label("control"), units.label("mz")) == ("$u$ (mm)", "$m_z$ (mN mm)")
    np.testing.assert_allclose(units.shown("base_x", [0.012]), [12.0], rtol=ROUNDING)
    # On request the same scene is shown in L and EI.
    scaled = UnitSystem(SI, "dimensionless")
    assert scaled.label("fy") == r"$f_y\,L^2/EI$"
    np.testing.assert_allclose(scaled.shown("fy", [BENDING_STIFFNESS / LENGTH**2]), 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(scaled.shown("mz", [BENDING_STIFFNESS / LENGTH]), 1.0, rtol=ROUNDING)


def test_angles_have_no_prefix_and_controls_that_are_no_lengths_have_names():
    assert UnitSystem(ROTATING).label("control") == "angle of the drive (rad)"
    assert UnitSystem(ROTATING).unit("event_control") == ("rad", 1.0)
    assert UnitSystem(MOVING).label("control") == "control"
    assert UnitSystem(MOVING).unit("control") == ("", 1.0)


def test_lengths_of_torsion_springs_are_angles():
    support = jw.Support((jw.Spring((0, 1), 13.0), jw.Spring((0, 1), 1e-3, 0.0, "phi")))
    units = UnitSystem(jw.Scene(SI.whisker, SI.profile, support))
    shown = units.shown("spring_length", np.array([[0.01, 0.3], [0.02, 0.4]]))
    np.testing.assert_allclose(shown, [[10.0, 0.3], [20.0, 0.4]], rtol=ROUNDING)


def test_units_are_one_of_three():
    with pytest.raises(ValueError, match=r"`units` must be one of auto, SI, dimensionless, got 'mm'\."):
        UnitSystem(PLAIN, "mm")
    assert UnitSystem(PLAIN, "SI").unit("control") == ("m", 1.0)


@pytest.mark.parametrize(
    ("size", "unit"),
    [(1e-20, "pN"), (1e-12, "pN"), (0.9e-3, "µN"), (1e-3, "mN"), (0.999, "mN"), (1.0, "N"), (999.0, "N"), (1e3, "kN")],
)
def test_prefixes_leave_one_to_three_digits(size, unit):
    assert with_prefix("N", size).name == unit


@pytest.mark.parametrize(
    ("words", "unit"),
    [
        ("N", ("mN", 1e-3)),
        ("N m", ("mN mm", 1e-6)),
        ("N/m", ("N/m", 1.0)),
        ("N m^2", ("mN mm^2", 1e-9)),
        ("1/m", ("1/mm", 1e3)),
        ("m/N^2", ("mm/mN^2", 1e3)),
        ("rad/m", ("rad/mm", 1e3)),
        ("N/rad", ("mN/rad", 1e-3)),
        ("1", ("1", 1.0)),
        # Datasets of earlier versions
        ("force length", ("mN mm", 1e-6)),
        ("rad/length", ("rad/mm", 1e3)),
        # units that are shown already, or that a user has given
        ("mN mm", ("mN mm", 1.0)),
        ("kN/m", ("kN/m", 1.0)),
        ("m/s", ("m/s", 1.0)),
    ],
)
def test_units_in_words_get_prefixes(words, unit):
    found = in_si(words, 9.6e-3, 0.05)
    assert found.name == unit[0] and found.size == pytest.approx(unit[1])


def test_prefixes_end_at_giga():
    assert with_prefix("m", 1e20) == ("Gm", 1e9)


@pytest.mark.parametrize(
    ("kind", "per", "scaled", "own"),
    [
        ("force", "number", "EI/L^2", "N"),
        ("moment", "number", "EI/L", "N m"),
        ("energy", "length", "EI/L^2", "N"),
        ("stiffness", "number", "EI/L^3", "N/m"),
        ("bending stiffness", "number", "EI", "N m^2"),
        ("curvature", "number", "1/L", "1/m"),
        ("length", "stiffness", "L^4/EI", "m^2/N"),
        ("angle", "length", "rad/L", "rad/m"),
        ("force", "angle", "EI/L^2 rad", "N/rad"),
        ("time", "number", "T", "s"),
        ("number", "number", "1", "1"),
        ("angle", "angle", "1", "1"),
    ],
)
def test_units_in_words(kind, per, scaled, own):
    words = unit_in_words(kind, True, per), unit_in_words(kind, False, per)
    # The order of factors carries no meaning.
    same = [[set(part.split()) for part in text.split("/")] for text in words]
    assert same == [[set(part.split()) for part in text.split("/")] for text in (scaled, own)]


def test_the_unit_of_the_first_whisker_counts():
    whiskers = jw.Whisker(), jw.Whisker(0.5, 3.0)
    scene = jw.Scene(whiskers, jw.Parabola(0.2), jw.Support.fbfb(70.0))
    assert UnitSystem(scene).dimensionless
    # Of a tapered whisker the stiffness at the base counts.
    for base, dimensionless in ((1.0, True), (2.0, False)):
        tapered = jw.Whisker(1.0, lambda s, base=base: base * (1 - 0.5 * s))
        assert UnitSystem(jw.Scene(tapered, jw.Parabola(0.2))).dimensionless == dimensionless
