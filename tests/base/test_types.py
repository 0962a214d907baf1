"""Integers with names are printed as their names."""

import jaxwhisker as jw
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._scan.dataset import Slip


def test_statuses_and_kinds_are_printed_as_their_names():
    for value, name in (
        (jw.FitStatus.ok, "ok"),
        (jw.Status.second_contact, "second_contact"),
        (jw.EventKind.snap_off, "snap_off"),
        (jw.Phase.tip, "tip"),
        (PointStatus.missing, "missing"),
        (Slip.sticks, "sticks"),
    ):
        assert str(value) == f"{value}" == name and f"{value:>16}" == name.rjust(16)
        assert repr(value) == f"<{type(value).__name__}.{name}: {int(value)}>"
        assert value == int(value)
