"""Stability in stiff and extreme cases: status, error and Newton steps at the limits of every parameter's range.

python benchmarks/extremes.py

The error is the largest relative residual of the equations in tests/independent.py (elliptic integrals that share no
code with the package, and the balance of the network). Every case is scanned with both kinds of rods.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import write
from jaxwhisker._base import checks
from jaxwhisker._equilibrium.dimensionless import problem_of
from jaxwhisker._equilibrium.point import at_control
from jaxwhisker._equilibrium.solver import solve_point
from jaxwhisker._scan.detect import kinds_of
from jaxwhisker._scan.plane import follow_path_now, path_through, problem_now
from jaxwhisker._scan.route import across, route_of
from jaxwhisker._scan.steps import interpolate

# isort: split
# After common, which puts the oracles on the search path.
from exact import CLAMP, _Network
from independent import Mechanics, violations

RODS = {"integrated": jw.Shooting(), "closed form": jw.ClosedForm()}
STEPS = 400  # of the control, unless the case sets it
INF = float("inf")


@dataclass
class Case:
    """Numbers of a scene, from which package and reference each build their own."""

    group: str
    name: str
    springs: list[tuple] = field(default_factory=lambda: [((0, 1), 70.0, 0.2)])
    profile: tuple[str, dict] = ("parabola", {"distance": 0.2, "a": 1.0})
    length: float = 1.0
    bending_stiffness: float = 1.0
    control: np.ndarray | None = None

    def scene(self, rod: jw.AbstractRod) -> jw.Scene:
        """Scene for the package."""
        kind, values = self.profile
        make = {"parabola": jw.Parabola, "circle": jw.Circle, "ellipse": jw.Ellipse}[kind]
        support = jw.Support(tuple(jw.Spring(ends, stiffness, rest) for ends, stiffness, rest in self.springs))
        return jw.Scene(jw.Whisker(self.length, self.bending_stiffness), make(**values), support, rod)

    def mechanics(self) -> Mechanics:
        """Mechanics for the reference."""
        springs = [{"between": e, "stiffness": k, "rest_length": r} for e, k, r in self.springs]
        network = _Network(springs or [CLAMP])
        n = network.rest.size
        kind, values = self.profile
        each = {name: np.array([value]) for name, value in values.items()}
        size, stiffness = np.full((1, n), self.length), np.full((1, n), self.bending_stiffness)
        return Mechanics(kind, each, size, stiffness, network.flexibility[None], network.rest[None])


def fb(stiffness: float, rest: float = 0.2) -> list[tuple]:
    """Spring of FB."""
    return [((0, 1), stiffness, rest)]


def three(*stiffness: float) -> list[tuple]:
    """Springs of FBFBFBR."""
    ends = [((0, 1), 0.2), ((1, 2), 0.2), ((2, 3), 0.2), ((0, 2), 0.4), ((0, 3), 0.6)]
    return [(pair, c, rest) for (pair, rest), c in zip(ends, stiffness, strict=True)]


def cases() -> list[Case]:
    """All extreme cases."""
    across = np.linspace(0.8, -1.6, STEPS)
    made = [Case("stiffness c", f"{c:.0e}", fb(c)) for c in (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12, INF)]
    made += [
        Case("stiffness, mixed", "1e-6, 1e6, 1e-3, 1e3, 1", three(1e-6, 1e6, 1e-3, 1e3, 1.0)),
        Case("stiffness, mixed", "1e6, 1e-6, 1e6, 1e-6, 1e6", three(1e6, 1e-6, 1e6, 1e-6, 1e6)),
        Case("stiffness, mixed", "1e12, 1, 1e12, 1, 1e12", three(1e12, 1.0, 1e12, 1.0, 1e12)),
        Case("stiffness, mixed", "inf, 1e-6, inf, 1e6, 1", three(INF, 1e-6, INF, 1e6, 1.0)),
    ]
    made += [Case("distance q", f"{q:g}", profile=("parabola", {"distance": q, "a": 1.0}))
             for q in (1e-3, 1e-2, 0.1, 0.5, 0.9, 0.99, 0.999)]  # fmt: skip
    made += [Case("parabola a", f"{a:.0e}", profile=("parabola", {"distance": 0.2, "a": a}))
             for a in (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 1e4)]  # fmt: skip
    made += [Case("circle radius", f"{r:.0e}", profile=("circle", {"distance": 0.2, "radius": r}))
             for r in (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 1e4)]  # fmt: skip
    made += [Case("ellipse a : b", f"{a:g} : {b:g}", profile=("ellipse", {"distance": 0.2, "a": a, "b": b}))
             for a, b in ((1.0, 1e-3), (0.1, 1e-4), (10.0, 0.01), (1e-3, 1.0), (1e-4, 0.1), (0.01, 10.0))]  # fmt: skip
    made += [Case("drive step", f"{h:.0e}", control=0.7 - h * np.arange(max(4, min(2000, round(2.4 / h)))))
             for h in (1e-5, 1e-3, 0.1, 1.0)]  # fmt: skip
    chain = [((i, i + 1), 500.0, 0.05) for i in range(16)]
    home = [((0, i), 50.0, 0.05 * i) for i in range(2, 17)]
    made += [
        Case("16 whiskers", "a chain", chain, control=np.linspace(0.9, -2.4, STEPS)),
        Case("16 whiskers", "a chain with feedback", chain + home, control=np.linspace(0.9, -2.4, STEPS)),
        Case("16 whiskers", "same rest position", [((0, i), 70.0, 0.0) for i in range(1, 17)]),
        Case("grazing", "distance 1 - 1e-6", profile=("parabola", {"distance": 1 - 1e-6, "a": 1.0})),
        Case("grazing", "distance 1 - 1e-9", profile=("parabola", {"distance": 1 - 1e-9, "a": 1.0})),
        Case("grazing", "tip at the widest point", profile=("circle", {"distance": 0.2, "radius": 0.8})),
        Case("simultaneous events", "two whiskers, equal", [((0, 1), 70.0, 0.2), ((0, 2), 70.0, 0.2)]),
        Case(
            "simultaneous events",
            "two whiskers, coupled",
            [((0, 1), 70.0, 0.2), ((0, 2), 70.0, 0.2), ((1, 2), 5.0, 0.0)],
        ),
        Case("simultaneous events", "two whiskers, rigid", [((0, 1), INF, 0.2), ((0, 2), INF, 0.2)]),
    ]
    critical = float(jw.critical_stiffness(jw.Whisker(), jw.Parabola(0.1)))
    made += [Case("critical stiffness", f"1 {sign} {size:.0e}", fb(critical * (1 + float(f"{sign}{size}"))),
                  profile=("parabola", {"distance": 0.1, "a": 1.0}), control=across)
             for size in (1e-3, 1e-6, 1e-9) for sign in "+-"]  # fmt: skip
    made += [Case("rest lengths", f"{r:g}", [((0, 1), 70.0, r), ((1, 2), 70.0, r)]) for r in (0.0, 100.0)]
    made += [Case("start inside contact", f"u = {u:g}", control=np.linspace(u, -1.6, STEPS)) for u in (0.5, -0.5, -1.2)]
    made += [Case("units", f"L = {L:.0e}, EI = {EI:.0e}", [((0, 1), 70.0 * EI / L**3, 0.2 * L)],
                  ("parabola", {"distance": 0.2 * L, "a": 1.0 / L}), L, EI)
             for L, EI in ((1e-9, 1e-30), (1e-9, 1.0), (1e-3, 1e-9), (1e6, 1e-6), (1e6, 1e12))]  # fmt: skip
    return made


@jax.jit
def iterations(scene: jw.Scene, way, control, travel):
    """Newton steps at every control, starting from the interpolated path."""
    dimensionless, path = problem_of(scene), way.path
    u, travel = control / dimensionless.unit.length, travel / dimensionless.unit.length
    node_travel = jnp.where(jnp.arange(path.nodes.travel.shape[0]) < path.count, path.nodes.travel, jnp.inf)
    index = jnp.clip(jnp.searchsorted(node_travel, travel, side="right") - 1, 0, path.count - 1)

    def one(step):
        i, at = step
        guess = interpolate(path, i, at)
        state = jax.tree.map(lambda leaf: leaf[i], path.nodes.state)
        return solve_point(dimensionless, state, at_control(at, guess.z), guess).iterations

    return jax.lax.map(one, (index, u))


def measured(case: Case, kind: str) -> dict:
    """One row of the table."""
    scene = jax.tree.map(checks.as_float, case.scene(RODS[kind]))
    control = case.control
    if control is None:
        whole = follow_path_now(problem_now(scene), *map(jnp.asarray, across()))
        control = np.linspace(float(whole.start), float(whole.stop), STEPS)
    result = jw.scan(scene, control)
    status = np.asarray(result.status)
    ok = status == jw.Status.ok
    fields = {name: np.asarray(getattr(result, name))[None] for name in (*jw.State.__dataclass_fields__, "status")}
    residuals = violations(case.mechanics(), control[None], SimpleNamespace(**fields))  # pyright: ignore[reportArgumentType]
    worst = {equation: float(np.max(residual)) for equation, residual in residuals.items()}
    equation = max(worst, key=worst.__getitem__)
    route = route_of(control)
    way = path_through(problem_now(scene), kinds_of(scene), jnp.asarray(route.stops), jnp.asarray(route.last))
    newton = np.asarray(iterations(scene, way, jnp.asarray(control), jnp.asarray(route.travel)))
    kinds = [event.kind.name for event in result.events]
    failed = {jw.Status(s).name: int(np.sum(status == s)) for s in np.unique(status) if s}
    return {
        "case": case.group,
        "value": case.name,
        "rods": kind,
        "ok": f"{np.sum(ok)} of {ok.size}",
        "other status": ", ".join(f"{n} {name}" for name, n in failed.items()),
        "error": worst[equation],
        "equation": equation,
        "nodes": int(way.path.count),
        "Newton steps": f"{np.median(newton[ok]):.0f}, at most {np.max(newton[ok])}" if np.any(ok) else "",
        "events": len(kinds),
        "snaps": sum(kind.startswith("snap") for kind in kinds),
    }


def main() -> None:
    """Measure and store."""
    rows, group = [], None
    for case in cases():
        if case.group != group:
            jax.clear_caches()  # a process can map only a limited number of compiled scans
            group = case.group
        for kind in RODS:
            rows.append(measured(case, kind))
            print(*rows[-1].values(), sep=" | ", flush=True)
    write("extremes", rows)


if __name__ == "__main__":
    main()
