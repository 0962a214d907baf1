"""Printed tables of scans: numbers, units of scenes in SI units, events that do not fit, CSV files."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwhisker as jw
from handmade import SI, handmade_scan
from jaxwhisker._dynamics.simulation import TimedEvents
from jaxwhisker._scan import report
from several import scanned

DIMENSIONLESS = 1.0, 1.0


@pytest.mark.parametrize(
    ("whisker", "units", "heading", "values"),
    [
        (DIMENSIONLESS, "auto", "control (L) base_x (L) fx (EI/L^2) mz (EI/L)", ["0.700000", "0.30000", "-2.00000"]),
        (SI, "auto", "control (mm) base_x (mm) fx (mN) mz (mN mm)", ["35.00000", "15.0000", "-19.20000"]),
        (SI, "SI", "control (mm) base_x (mm) fx (mN) mz (mN mm)", ["35.00000", "15.0000", "-19.20000"]),
        (SI, "dimensionless", "control (L) base_x (L) fx (EI/L^2) mz (EI/L)", ["0.700000", "0.30000", "-2.00000"]),
        (DIMENSIONLESS, "SI", "control (m) base_x (m) fx (N) mz (N m)", ["0.700000", "0.30000", "-2.00000"]),
    ],
)
def test_events_have_units(whisker, units, heading, values):
    header, _, row = report.event_table(handmade_scan(*whisker), units).splitlines()
    assert all(words in header for words in heading.replace(") ", ")|").split("|"))
    assert row.split()[:3] == [values[0], "touch", "1"]
    assert row.split()[3:5] == values[1:]


def test_peaks_have_units_and_no_position_where_they_are_zero():
    _, _, fx, fy, mz = (line.split() for line in report.peak_table(handmade_scan(*SI)).splitlines())
    assert fx == ["1", "fx", "(mN)", "-19.20000", "25.00000", "0.00000", "-"]
    assert fy == ["1", "fy", "(mN)", "0.00000", "-", "0.00000", "-"]
    assert mz == ["1", "mz", "(mN", "mm)", "240.000", "50.00000", "240.000", "50.00000"]


def test_a_peak_of_rounding_errors_has_no_position():
    result = handmade_scan(*SI)
    noisy = dataclasses.replace(result, fx=result.fx + 1e-15 * jnp.max(jnp.abs(result.fx)))
    assert report.peak_table(noisy) == report.peak_table(result)


def test_events_that_do_not_fit_are_counted():
    assert "Only 1 of 1,999 events fit into the result, the first and the last." in report.event_table(
        handmade_scan(count=1999)
    )
    assert "Only" not in report.event_table(handmade_scan())
    assert report.event_table(handmade_scan(touching=False)) == "No events."


def test_a_scan_touches_if_any_whisker_has_contact():
    assert report.touches_object(handmade_scan())
    assert not report.touches_object(handmade_scan(touching=False))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1.25, 1, "1.2"), (-1e-9, 5, "0.00000"), (-0.4, 0, "0"), (np.nan, 3, "nan"), (1234.5678, 2, "1234.57")],
)
def test_numbers_have_fixed_decimals_and_no_negative_zero(value, digits, text):
    assert report.fixed(value, digits) == text


@pytest.mark.parametrize("factor", [1e-30, 1e30])
def test_extreme_scenes_are_printed_in_powers_of_ten(factor):
    *_, row = report.event_table(handmade_scan(1.0, factor)).splitlines()
    assert float(row.split()[4]) == pytest.approx(-2 * factor / (1e-12 if factor < 1 else 1e9))


def test_columns_and_rows_become_csv(tmp_path):
    report.write_columns({"a": np.array([1, 2]), "b": np.array([-0.0, 0.25])}, tmp_path / "a.csv", "two columns")
    assert (tmp_path / "a.csv").read_text() == "# two columns\na,b\n1,0.0\n2,0.25\n"
    report.write_rows([["x", "y"], ["1", "-"]], tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text() == "x,y\n1,\n"


def test_events_of_a_motion_have_times_with_units():
    touch, first = jnp.array([int(jw.EventKind.touch)]), jnp.array([1])
    events = TimedEvents(touch, first, jnp.array([0.03]), jnp.array([0.035]), jnp.asarray(70))
    # T = 20 ms
    whisker = jw.Whisker(*SI, mass_per_length=SI[1] / SI[0] ** 4 * 0.02**2)
    motion = SimpleNamespace(scene=jw.Scene(whisker, jw.Parabola(0.01, 20.0)), events=events)
    for units, heading, expected in (
        ("SI", ["time", "(ms)", "control", "(mm)"], ["30.0000", "35.00000"]),
        ("dimensionless", ["time", "(T)", "control", "(L)"], ["1.50000", "0.700000"]),
    ):
        header, _, row, missing = report.timed_event_table(motion, units).splitlines()
        assert header.split() == [*heading, "event", "whisker"] and row.split() == [*expected, "touch", "1"]
        assert missing == "Only 1 of 70 events fit into the result, the first and the last."


def test_events_of_several_contacts_name_contact_and_object():
    header, _, *rows = report.event_table(scanned()).splitlines()
    assert header.split()[2:5] == ["event", "whisker", "contact"]
    assert [row.split()[1:5] for row in rows[1:3]] == [["touch", "1", "2", "2"], ["tangential_to_tip", "1", "1", "1"]]
    snaps = [row.split()[1:6] for row in rows[-2:]]
    assert snaps == [["snap_off", "1", "-", "-", when] for when in ("before", "after")]
