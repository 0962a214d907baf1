"""Tables A.1 to A.4: support reactions of a clamped whisker under a given force, beside the printed values.

The force points towards -x on the unloaded whisker. The thesis lists fx, fy and the bending moment at the base, which
is -mz. Its tables also contain the values of a multi-body model (ALASKA), which are repeated here. `tables.csv` holds
the printed values; those without a value are not recorded.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from jaxwhisker._model.loads import PointForce
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.deflect import Deflection, deflect
from jaxwhisker._scan.report import fixed

LISTED = ("Fx", "Fy", "Mz")
MISPRINT = (
    "Table A.3 prints 0.9437 for F = 1, and table A.4 prints 0.9436 for the same load. The correct value is 0.943567."
)


@dataclass(frozen=True)
class PrintedLoad:
    """A force and the printed values of LISTED; NaN where no printed value is recorded."""

    force: float
    position: float  # arc length from the base, in L
    thesis: tuple[float, ...]
    multibody: tuple[float, ...]

    @property
    def label(self) -> str:
        """Label of the load in a legend."""
        return f"F = {self.force:g} at {100 * self.position:.0f} %"


@dataclass(frozen=True)
class AppendixTable:
    """A table of the appendix."""

    title: str
    follower: bool
    loads: tuple[PrintedLoad, ...]
    notes: tuple[str, ...] = ()


def _printed(table: str) -> tuple[PrintedLoad, ...]:
    text = Path(__file__).with_name("tables.csv").read_text("utf-8")
    rows = [[float(cell or "nan") for cell in row[1:]] for row in csv.reader(text.splitlines()) if row[0] == table]
    return tuple(PrintedLoad(row[0], row[1], tuple(row[2:5]), tuple(row[5:8])) for row in rows)


TABLES = {
    "A.1": AppendixTable("Reactions under a follower force at the tip", True, _printed("A.1")),
    "A.2": AppendixTable("Reactions under a follower force along the whisker", True, _printed("A.2")),
    "A.3": AppendixTable("Reactions under a force of fixed direction at the tip", False, _printed("A.3"), (MISPRINT,)),
    "A.4": AppendixTable("Reactions under a force of fixed direction along the whisker", False, _printed("A.4")),
}


def bend(table: AppendixTable) -> dict[str, Deflection]:
    """Deflections under every load of the table, by label."""

    def one(load: PrintedLoad) -> Deflection:
        force = PointForce(load.force, position=load.position, follower=table.follower)
        return cast(Deflection, deflect(Whisker(), force))

    return {load.label: one(load) for load in table.loads}


def table_rows(table: AppendixTable) -> list[list[str]]:
    """Header and one row per load and reaction: jaxwhisker, thesis, their difference, multi-body model."""
    rows = [["load", "reaction", "jaxwhisker", "thesis", "difference", "multi-body"]]
    for load, deflection in zip(table.loads, bend(table).values(), strict=True):
        values = (float(value) for value in (deflection.fx, deflection.fy, -deflection.mz))
        for name, ours, theirs, body in zip(LISTED, values, load.thesis, load.multibody, strict=True):
            printed = [f"{theirs:.4f}", f"{ours - theirs:+.6f}", f"{body:.4f}"]
            rows.append([load.label, name, fixed(ours, 6), *("-" if "nan" in cell else cell for cell in printed)])
    return rows
