"""Integers with names are printed as their names; signatures in `help` name types instead of spelling them out."""

import inspect

import jaxwhisker as jw
from jaxwhisker._inverse.points import PointStatus
from jaxwhisker._scan.dataset import SlipDirection


def test_statuses_and_kinds_are_printed_as_their_names():
    for value, name in (
        (jw.FitStatus.ok, "ok"),
        (jw.Status.second_contact, "second_contact"),
        (jw.EventKind.snap_off, "snap_off"),
        (jw.Phase.tip, "tip"),
        (PointStatus.missing, "missing"),
        (SlipDirection.sticks, "sticks"),
    ):
        assert str(value) == f"{value}" == name and f"{value:>16}" == name.rjust(16)
        assert repr(value) == f"<{type(value).__name__}.{name}: {int(value)}>"
        assert value == int(value)


def test_signatures_of_what_users_call_spell_out_no_array_types():
    ends = ("Result", "State", "Fit", "Shapes", "Reconstruction", "Deflection", "Balance", "Stability")
    signatures = {}
    for name in jw.__all__:
        public = getattr(jw, name)
        if name.endswith(ends) or name in ("Events", "Measurement", "Modes", "Simulation", "Bending"):
            continue  # results, which users do not make
        own = vars(public).items() if inspect.isclass(public) else ()
        makers = [key for key, value in own if isinstance(value, staticmethod | classmethod) and key != "__new__"]
        for full, made in [(name, public), *((f"{name}.{key}", getattr(public, key)) for key in makers)]:
            if callable(made):
                signatures[full] = str(inspect.signature(made))
    assert "stiffness: Scalar" in signatures["Support.fb"] and len(signatures) > 80
    assert [name for name, text in signatures.items() if "jaxtyping" in text and "-> jaxtyping" not in text] == []
