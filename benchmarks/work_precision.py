"""Error against run time: jaxwhisker, stock solvers, scipy, MuJoCo and PyElastica, in single scans and batches.

python benchmarks/work_precision.py [--quick] [--batches N ...]

All methods compute FB with c = 70 and rest length 0.2 beneath the parabola with q = 0.2, or beneath a circle if the
simulator has no parabola, from just after the first touch to just before the snap-off. The error is the largest error
of fx, fy and mz over the scan, relative to the peak of each, against elliptic integrals solved to rounding. In a batch
every lane has another stiffness, and about eight lanes are compared. Calls of all methods take turns.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import diffrax
import jax.numpy as jnp
import numpy as np
from scipy.optimize.elementwise import find_root

import jaxwhisker as jw
from common import summary, write
from peers import bvp, cosserat_rod, hinge_chain, stock, thesis
from peers.scene import Circle, Scene

# isort: split
# After common, which puts the oracles on the search path.
from exact import circle, clamped_branch, exact_scan, parabola

PARABOLA, CIRCLE = Scene(), Circle()
PROFILES = {PARABOLA: parabola(PARABOLA.distance), CIRCLE: circle(CIRCLE.distance, CIRCLE.radius)}
OBJECTS = {PARABOLA: jw.Parabola(PARABOLA.distance), CIRCLE: jw.Circle(CIRCLE.distance, CIRCLE.radius)}
RANGE = {PARABOLA: (0.694, -1.3), CIRCLE: (0.775, -1.5)}  # of the drive; in contact for every stiffness below
SOFTEST, STIFFEST = 60.0, 200.0  # lanes of a batch; the first lane has the stiffness of the scene
BASES = np.array([0.8, 0.3, -0.3])  # base positions of PyElastica's states


@cache
def exactly(scene: Scene, steps: int, stiffness: float) -> np.ndarray:
    """Exact fx, fy, mz from elliptic integrals, (steps, 3)."""
    branch, control = clamped_branch(PROFILES[scene]), control_of(scene, steps)

    def drive(p):
        state = branch.states(p)
        return state.base_x - scene.rest_length + state.fx / stiffness

    table = np.linspace(0, 1, 4001) ** 2 * branch.fold
    falling = drive(table)
    behind = np.searchsorted(-falling[: np.argmin(falling) + 1], -control)
    root = find_root(lambda p, u: drive(p) - u, (table[behind - 1], table[behind]), args=(control,))
    assert np.all(root.success) and np.max(np.abs(root.f_x)) < 1e-13
    state = branch.states(root.x)
    return np.stack([state.fx, state.fy, state.mz], axis=-1)


def error(scene: Scene, stiffness: np.ndarray, signals: np.ndarray) -> float:
    """Largest error of signals (lanes, steps, 3), relative to the peaks."""
    worst = 0.0
    for c, got in zip(stiffness, signals, strict=True):
        reference = exactly(scene, signals.shape[1], float(c))
        worst = max(worst, float(np.nanmax(np.abs(got - reference) / np.max(np.abs(reference), axis=0))))
    return worst


def event_error(rod: jw.AbstractRod) -> float:
    """Largest error of an event position in the whole FB scan."""
    springs = [{"between": (0, 1), "stiffness": PARABOLA.stiffness, "rest_length": PARABOLA.rest_length}]
    reference = exact_scan(PROFILES[PARABOLA], springs, np.linspace(0.8, -1.6, 200)).events
    events = jw.scan(ours_scene(PARABOLA, rod, PARABOLA.stiffness)).events
    got = {event.kind.name: event.control for event in events}
    return max(abs(float(got[event.kind]) - event.control) for event in reference)


def lanes_of(batch: int) -> np.ndarray:
    """Stiffness of each lane."""
    return np.append(PARABOLA.stiffness, np.linspace(SOFTEST, STIFFEST, batch - 1))


def control_of(scene: Scene, steps: int) -> np.ndarray:
    """Drive positions of a scan."""
    return np.linspace(*RANGE[scene], steps)


def ours_scene(scene: Scene, rod: jw.AbstractRod, stiffness) -> jw.Scene:
    """Scene of the package."""
    return jw.Scene(jw.Whisker(), OBJECTS[scene], jw.Support.fb(stiffness, scene.rest_length), rod)


@dataclass
class Method:
    """A method at one setting and batch size; `call` returns signals (lanes, steps, 3)."""

    name: str
    setting: str
    scene: Scene
    batch: int
    steps: int
    call: Callable[[], np.ndarray]
    times: list[float] = field(default_factory=list)
    compile_time: float | None = None
    first: float = 0.0
    error: float = 0.0
    failed: float = 0.0
    events: float | None = None

    def row(self) -> dict[str, Any]:
        """One row of the table; times in us per equilibrium."""
        each = {k: 1e6 * v / self.batch / self.steps for k, v in summary(self.times).items()}
        return {
            "method": self.name,
            "setting": self.setting,
            "object": "circle" if self.scene is CIRCLE else "parabola",
            "batch": self.batch,
            "steps": self.steps,
            "us per equilibrium": each["median"],
            "lower quartile": each["lower"],
            "upper quartile": each["upper"],
            "error": self.error,
            "event error": self.events,
            "failed": self.failed,
            "compile, s": self.compile_time,
            "first call, s": self.first,
        }


def compiled(name: str, setting: str, scene: Scene, batch: int, steps: int, scan: Callable) -> Method:
    """A JAX method: compile `scan(stiffness, control)` for the batch."""
    control, stiffness = jnp.asarray(control_of(scene, steps)), jnp.asarray(lanes_of(batch))
    start = time.perf_counter()
    run = jax.jit(jax.vmap(lambda c: scan(c, control))).lower(stiffness).compile()
    taken = time.perf_counter() - start
    return Method(name, setting, scene, batch, steps, lambda: np.asarray(run(stiffness)), compile_time=taken)


def ours(setting: str, rod: jw.AbstractRod, batch: int, steps: int, scene: Scene = PARABOLA) -> Method:
    """This package with one kind of rods."""

    def scan(c, control):
        result = jw.scan(ours_scene(scene, rod, c), control)
        return jnp.stack([result.fx[:, 0], result.fy[:, 0], result.mz[:, 0]], axis=-1)

    name = "closed form" if isinstance(rod, jw.ClosedForm) else "integrated"
    method = compiled(f"jaxwhisker, {name}", setting, scene, batch, steps, scan)
    default = rod in (jw.Shooting(), jw.ClosedForm())
    method.events = event_error(rod) if default and batch == 1 and scene is PARABOLA else None
    return method


def plain(name: str, setting: str, scene: Scene, steps: int, scan: Callable) -> Method:
    """A method without batches, `scan(scene, control)`."""
    control = control_of(scene, steps)
    return Method(name, setting, scene, 1, steps, lambda: scan(scene, control)[None])


def methods(batch: int, quick: bool):
    """Yield all methods for one batch size; JAX methods are compiled when they are yielded."""
    splitting = {6: (4, 8, 16), 11: (2, 4, 8, 16)}
    fixed = [(diffrax.Dopri8(), 4), (diffrax.Dopri8(), 8), (diffrax.Tsit5(), 16)]
    adaptive = [(diffrax.Dopri8(), 1e-6), (diffrax.Dopri8(), 1e-9), (diffrax.Tsit5(), 1e-6)]
    steps, few, tolerances, links = 1600, 400, (1e-3, 1e-6, 1e-9), (10, 20, 40, 80)
    if quick:
        splitting, fixed, adaptive = {11: (4, 8)}, fixed[:1], []
        steps, few, tolerances, links = 800, 100, tolerances[:2], links[:2]
    for stages, counts in splitting.items():
        for n in counts:
            rod = jw.Shooting(n, jw.Splitting(stages))
            yield ours(f"splitting of order {6 if stages == 11 else 4}, {n} steps", rod, batch, steps)
    if not quick:
        yield ours("Dopri8, 4 steps", jw.Shooting(4, diffrax.Dopri8()), batch, steps)
    yield ours("elliptic functions", jw.ClosedForm(), batch, steps)
    for solver, n in fixed:
        scan = partial(stock_scan, solver=solver, steps=n, tolerance=1e-6)
        setting = f"{type(solver).__name__}, {n} steps"
        yield compiled("diffrax and optimistix", setting, PARABOLA, batch, few, scan)
    for solver, tolerance in adaptive:
        scan = partial(stock_scan, solver=solver, steps=None, tolerance=tolerance)
        setting = f"{type(solver).__name__}, adaptive, {tolerance:.0e}"
        yield compiled("diffrax and optimistix", setting, PARABOLA, batch, few, scan)
    if batch > 1:
        return
    yield ours("elliptic functions", jw.ClosedForm(), batch, steps, CIRCLE)
    for tolerance in tolerances:
        scan = partial(thesis.scan, rtol=tolerance)
        yield plain("scipy: fsolve, solve_ivp (thesis)", f"rtol {tolerance:.0e}", PARABOLA, few, scan)
        scan = partial(bvp.scan, tol=tolerance)
        yield plain("scipy: solve_bvp", f"tol {tolerance:.0e}", PARABOLA, few, scan)
    for n in links:
        scan = partial(hinge_chain.scan, links=n)
        yield plain("MuJoCo: hinge chain", f"{n} links", CIRCLE, few // 4, scan)


def stock_scan(c, control, **options):
    """Stock solvers at stiffness `c`."""
    return stock.scan(Scene(stiffness=c), control, **options)


def cosserat_rows(elements: tuple[int, ...]) -> list[dict]:
    """PyElastica on a few states of a clamped whisker, run once because a state takes seconds."""
    branch, rows = clamped_branch(PROFILES[CIRCLE]), []
    state = branch.states(np.array([branch.parameter(x) for x in BASES]))
    reference = np.stack([state.fx, state.fy, state.mz], axis=-1)
    for n in elements:
        start = time.perf_counter()
        got = cosserat_rod.states(CIRCLE, BASES, n)[:, [0, 1, 5]]
        taken = time.perf_counter() - start
        method = Method(
            "PyElastica", f"{n} elements", CIRCLE, 1, BASES.size, lambda: BASES, [taken, taken], first=taken
        )
        method.error = float(np.max(np.abs(got - reference) / np.max(np.abs(reference), axis=0)))
        rows.append(method.row())
    return rows


def measured(batch: int, quick: bool) -> list[dict]:
    """Rows of one batch size."""
    repeats, begun, made = 3 if quick else 5, time.perf_counter(), []
    for method in methods(batch, quick):
        start = time.perf_counter()
        signals = method.call()
        method.first = time.perf_counter() - start
        lanes = slice(None, None, max(1, method.batch // 8))
        method.error = error(method.scene, lanes_of(method.batch)[lanes], signals[lanes])
        method.failed = float(np.mean(np.isnan(signals)))
        print(f"{time.perf_counter() - begun:7.1f} s  {method.name}, {method.setting}, {method.batch}", flush=True)
        made.append(method)
    for _ in range(repeats):
        for method in made:
            # Slow calls need fewer repetitions.
            if sum(method.times) < 30 / repeats or len(method.times) < 2:
                start = time.perf_counter()
                method.call()
                method.times.append(time.perf_counter() - start)
    return [method.row() for method in made]


def main(batches: list[int], quick: bool) -> None:
    """Measure and store."""
    rows = []
    for batch in batches:
        rows += measured(batch, quick)
        jax.clear_caches()  # a process can map only a limited number of compiled programs
    write("work_precision_quick" if quick else "work_precision", rows + cosserat_rows((10,) if quick else (20, 40)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few methods; writes work_precision_quick.json")
    parser.add_argument("--batches", type=int, nargs="+", help="default: 1 32 256 1024; quick: 1 256")
    options = parser.parse_args()
    main(options.batches or ([1, 256] if options.quick else [1, 32, 256, 1024]), options.quick)
