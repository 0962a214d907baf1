"""Tables A.1 to A.4: support reactions of a clamped whisker under a given force, beside the printed values.

The force points towards -x on the unloaded whisker. The thesis lists fx, fy and the bending moment at the base, which
is -mz. Its tables also contain the values of a multi-body model (ALASKA), which are repeated here.
"""

import math
from dataclasses import dataclass, field

from jaxwhisker._model.loads import PointForce
from jaxwhisker._model.whisker import Whisker
from jaxwhisker._scan.deflect import Deflection, deflect
from jaxwhisker._scan.report import fixed

LISTED = ("Fx", "Fy", "Mz")
MISPRINT = (
    "Table A.3 prints 0.9437 for F = 1, and table A.4 prints 0.9436 for the same load. The correct value is 0.943567."
)


@dataclass(frozen=True)
class Load:
    """A force and the printed values; NaN where no printed value is recorded."""

    force: float
    position: float  # arc length from the base, in L
    thesis: tuple[float, float, float]
    multibody: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    @property
    def label(self) -> str:
        """Label of the load in a legend."""
        return f"F = {self.force:g} at {100 * self.position:.0f} %"


@dataclass(frozen=True)
class Table:
    """A table of the appendix."""

    number: str
    title: str
    follower: bool
    loads: tuple[Load, ...]
    notes: tuple[str, ...] = field(default=())


def _moment(value: float) -> tuple[float, float, float]:
    return (math.nan, math.nan, value)


TABLES = {
    table.number: table
    for table in (
        Table(
            "A.1",
            "Reactions under a follower force at the tip",
            True,
            (
                Load(1, 1.0, (0.8795, 0.4758, 0.9755), (0.9311, 0.5075, 1.0279)),
                Load(3, 1.0, (0.5139, 2.9557, 2.4313), (0.5295, 3.0606, 2.5185)),
                Load(5, 1.0, (-2.5163, 4.3207, 2.9396), (-2.6064, 4.4662, 3.0413)),
                Load(7, 1.0, (-5.9366, 3.7091, 2.7236), (-6.0587, 3.8178, 2.8300)),
                Load(10, 1.0, (-9.8894, 1.4833, 1.7224), (-9.9876, 1.4674, 1.8232)),
            ),
        ),
        Table(
            "A.2",
            "Reactions under a follower force along the whisker",
            True,
            (
                Load(1, 0.3, (0.9990, 0.0450, 0.2999), (1.0384, 0.0477, 0.3134)),
                Load(1, 0.5, (0.9922, 0.1246, 0.4992), (1.0367, 0.1320, 0.5238)),
                Load(1, 0.7, (0.9703, 0.2421, 0.6958), (1.0194, 0.2593, 0.7321)),
            ),
        ),
        Table(
            "A.3",
            "Reactions under a force of fixed direction at the tip",
            False,
            (
                Load(1, 1.0, _moment(0.9437), _moment(0.9851)),
                Load(3, 1.0, _moment(2.2367), _moment(2.3183)),
                Load(5, 1.0, _moment(3.0619), _moment(3.2040)),
                Load(7, 1.0, _moment(3.6895), _moment(3.8007)),
                Load(10, 1.0, _moment(4.4500), _moment(4.6039)),
            ),
            (MISPRINT,),
        ),
        Table(
            "A.4",
            "Reactions under a force of fixed direction along the whisker",
            False,
            (
                Load(1, 0.3, _moment(0.2998), _moment(0.3133)),
                Load(1, 0.5, _moment(0.4979), _moment(0.5223)),
                Load(1, 0.7, _moment(0.6893), _moment(0.7239)),
                Load(1, 1.0, _moment(0.9436)),
            ),
        ),
    )
}


def bend(table: Table) -> dict[str, Deflection]:
    """Deflections under every load of the table, by label."""
    whisker = Whisker()
    return {
        load.label: deflect(whisker, PointForce(load.force, position=load.position, follower=table.follower))
        for load in table.loads
    }


def listed(deflection) -> tuple[float, float, float]:
    """The values that the tables list: fx, fy and the bending moment at the base."""
    return float(deflection.fx), float(deflection.fy), -float(deflection.mz)


def table_rows(table: Table) -> list[list[str]]:
    """Header and one row per load and reaction: jaxwhisker, thesis, their difference, multi-body model."""
    rows = [["load", "reaction", "jaxwhisker", "thesis", "difference", "multi-body"]]
    for load, deflection in zip(table.loads, bend(table).values(), strict=True):
        for name, ours, theirs, body in zip(LISTED, listed(deflection), load.thesis, load.multibody, strict=True):
            rows.append([load.label, name, fixed(ours, 6), _cell(theirs), _cell(ours - theirs, "+.6f"), _cell(body)])
    return rows


def _cell(value: float, form: str = ".4f") -> str:
    return "-" if math.isnan(value) else format(value, form)
