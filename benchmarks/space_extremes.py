"""Extreme cases in space: status, violated laws and stability at the limits of every parameter's range.

python benchmarks/space_extremes.py

Every scene is scanned right across. The laws and the second variation are those of tests/space_laws.py, which share no
code with the package; they are checked at some states marked ok. Violations are relative to the size of what is
compared, which matters where soft springs yield by many lengths or tiny objects are hit.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from scipy.spatial.transform import Rotation

import jaxwhisker as jw
from common import write

# isort: split
# After common, which puts the tests on the search path.
from random_space import Cone
from space_laws import UPRIGHT, Plain, State, Surface, stability, state_of, violations

CHECKED, ELEMENTS = 12, 30  # states of each case, and elements of a rod for its second variation
SOFT = 1e-3  # contact force below which the sign of the second variation is rounding
UNSTABLE = -1e-6  # of the second variation; zero at a fold
INF = float("inf")


@dataclass
class Case:
    """Numbers of a scene, from which package and laws each build their own. A taper of 1 is a tip of no thickness."""

    group: str
    name: str
    radii: tuple[float, float, float] = (1.0, 1.0, 1.0)  # half axes; a sphere if they are equal
    centre: tuple[float, float, float] = (0.0, 1.3, 0.0)
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset: float = 0.2  # of the base, along z
    taper: float = 0.0
    curvature: float = 0.0
    twist: float = 0.0
    torsion_ratio: float = 2 / 3
    roll: float = 0.0
    springs: tuple[float, float, float] = (INF, INF, INF)
    tilting: tuple[float, float, float] = (INF, INF, INF)

    def scene(self) -> jw.SpaceScene:
        """Scene for the package."""
        own: dict[str, Any] = {"bending_stiffness": Cone(self.taper)} if self.taper else {}
        own |= {"intrinsic_curvature": self.curvature, "twist": self.twist} if self.curvature else {}
        ellipsoid = jw.Ellipsoid(self.radii, self.centre).rotated(self.turned)
        surface = jw.Sphere(self.radii[0], self.centre) if len(set(self.radii)) == 1 else ellipsoid
        stiffness = [*zip("xyz", self.springs, strict=True)]
        stiffness += zip(("phi_x", "phi_y", "phi"), self.tilting, strict=True)
        springs = tuple(jw.Spring((0, 1), c, axis=axis) for axis, c in stiffness if np.isfinite(c))
        mount = jw.Mount(roll=self.roll) if self.roll else None
        drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, self.offset))
        whisker = jw.Whisker(torsion_ratio=self.torsion_ratio, **own)
        return jw.SpaceScene(whisker, surface, jw.Support(springs, mount), motion=drive)

    def plain(self) -> Plain:
        """Numbers for the laws."""
        turn, middle = Rotation.from_rotvec(self.turned).as_matrix(), self.radii[1]
        matrix = turn @ np.diag(middle / np.array(self.radii) ** 2) @ turn.T
        mount = UPRIGHT @ Rotation.from_rotvec([0.0, 0.0, self.roll]).as_matrix()
        return Plain(
            Surface(np.array(self.centre), matrix, np.zeros(3), middle / 2),
            lambda u: (np.array([-u, 0.0, self.offset]), np.eye(3), mount),
            stiffness=lambda s: (1 - self.taper * s) ** 4,
            torsion_ratio=self.torsion_ratio,
            curvature=lambda s: np.array([0.0, -self.curvature, self.twist if self.curvature else 0.0]),
            springs=np.array(self.springs),
            tilting=np.array(self.tilting),
        )


def bent(group: str, name: str, **numbers) -> Case:
    """A curved whisker with a roll of 60 degrees past the sphere."""
    return replace(Case(group, name, curvature=0.8, roll=np.pi / 3, offset=0.1), **numbers)


def cases() -> list[Case]:
    """All extreme cases."""
    decades = 1e-2, 1.0, 1e2, 1e4, 1e6, 1e9
    mixed = (1e-2, 1e9, 1.0), (1e9, 1e-2, 1e9), (1e9, 1e9, 1e-2), (1.0, 1e6, 1e-2)
    made = [Case("springs x, y, z", f"{c:.0e}", springs=(c, c, c)) for c in decades]
    made += [Case("springs x, y, z", "{:.0e}, {:.0e}, {:.0e}".format(*c), springs=c) for c in mixed]
    made += [Case("tilting springs", f"{c:.0e}", tilting=(c, c, c)) for c in decades]
    made += [Case("tilting springs", "{:.0e}, {:.0e}, {:.0e}".format(*c), tilting=c) for c in mixed]
    tapers = 0.5, 0.8, 0.9, 0.95, 0.98, 0.99
    made += [Case("cone, taper", f"{taper:g}", taper=taper) for taper in tapers]
    made += [bent("curved cone, taper", f"{taper:g}", taper=taper) for taper in tapers]
    made += [
        Case("sphere radius", f"{r:.0e}", (r, r, r), (0.0, 0.3 + r, 0.0), offset=0.2 * min(r, 1.0))
        for r in (1e-4, 1e-3, 1e-2, 0.1, 10.0, 1e2, 1e4)
    ]
    made += [
        Case("sphere radius 0.001, offset", f"{b:g} radii", (1e-3, 1e-3, 1e-3), (0.0, 0.5, 0.0), offset=1e-3 * b)
        for b in (0.0, 1e-3, 0.5, 0.9, 0.99)
    ]
    made += [
        Case("nearly head-on, overlap", f"{d:.0e}", centre=(0.0, 2 - d, 0.0), offset=0.3 * d**0.5)
        for d in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
    ]
    made += [Case("offset", f"{b:.0e}", offset=b) for b in (1e-3, 1e-6, 1e-9, 1e-12, 0.0)]
    made += [bent("curved, offset", f"{b:.0e}", offset=b) for b in (1e-3, 1e-9, 0.0)]
    slender = ((2.0, 0.02, 0.02), (0.02, 0.02, 2.0), (0.02, 0.6, 0.02), (0.2, 0.002, 0.2), (10.0, 0.01, 0.1))
    made += [
        Case("ellipsoid", f"{a:g} : {b:g} : {c:g}", (a, b, c), (0.0, 0.4 + b, 0.0), offset=0.3 * min(c, 0.5))
        for a, b, c in slender
    ]
    made += [
        Case("ellipsoid, turned", f"{a:g} : {b:g} : {c:g}", (a, b, c), (0.0, 0.9, 0.0), (0.3, 0.2, -0.4), 0.2 * c)
        for a, b, c in ((1.0, 0.05, 0.05), (0.05, 0.05, 1.0), (0.4, 0.01, 0.4), (0.05, 0.6, 0.05))
    ]
    made += [bent("torsion ratio", f"{c:.0e}", torsion_ratio=c) for c in (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3)]
    made += [bent("curvature", f"{k:g}", curvature=k) for k in (1e-9, 1e-4, 0.1, 1.5, -0.8, -1.5)]
    made += [bent("twist", f"{k:g}", twist=k) for k in (1e-9, 1.0, 5.0, 20.0)]
    return made


def relative(plain: Plain, state: State) -> dict[str, float]:
    """Violations of the laws, relative to the size of what is compared."""
    found = violations(plain, state)
    moved = 1 + np.max(np.abs(state.base - plain.placement(state.control)[0]))
    return {law: float(value) / (moved if law in ("springs", "contact") else 1.0) for law, value in found.items()}


def measured(case: Case) -> dict:
    """One row of the table."""
    result, plain = jw.scan(case.scene()), case.plain()
    control, status, phase = (np.asarray(value) for value in (result.control, result.status, result.phase[:, 0]))
    ok = np.flatnonzero((status == jw.Status.ok) & (phase > 0))
    worst, least, unstable = {"": 0.0}, INF, 0
    for k in ok[np.unique(np.linspace(0, ok.size - 1, CHECKED).astype(int))] if ok.size else ():
        fields = {name: getattr(result, name) for name in jw.SpaceState.__dataclass_fields__}
        fields = {name: np.asarray(value)[k] for name, value in fields.items() if value is not None}
        state = state_of(SimpleNamespace(**fields), float(control[k]))
        found = relative(plain, state)
        law = max(found, key=found.__getitem__)
        worst = max(worst, {law: found[law]}, key=lambda one: max(one.values()))
        stiff = [np.all(np.isfinite(c)) or not np.any(np.isfinite(c)) for c in (case.springs, case.tilting)]
        if state.contact_force > SOFT and all(stiff):
            stable = stability(plain, state, ELEMENTS)
            least, unstable = min(least, stable), unstable + (stable < UNSTABLE)
    kinds = [event.kind.name for event in result.events]
    failed = {jw.Status(s).name: int(np.sum(status == s)) for s in np.unique(status) if s}
    law, violation = next(iter(worst.items()))
    return {
        "case": case.group,
        "value": case.name,
        "ok": f"{np.sum(status == jw.Status.ok)} of {status.size}",
        "other status": ", ".join(f"{n} {name}" for name, n in failed.items()),
        "violation": violation,
        "law": law,
        "least stability": None if least == INF else least,
        "unstable": unstable or None,
        "events": ", ".join(kinds),
    }


def main() -> None:
    """Measure and store."""
    rows = []
    for case in cases():
        rows.append(measured(case))
        print(*rows[-1].values(), sep=" | ", flush=True)
    write("space_extremes", rows, "scipy")


if __name__ == "__main__":
    main()
