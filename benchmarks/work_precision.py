"""Error against run time: this package beside stock solvers, scipy, MuJoCo and PyElastica; alone and in batches.

All compute FB, c = 70, rest length 0.2, beneath the parabola with q = 0.2 (or, simulators that have no parabola,
beneath a circle), from just after the first touch to just before the whisker snaps off. Error: the largest of fx, fy,
mz over the scan, relative to the peak of each, against elliptic integrals solved to rounding. In batches the lanes
differ in stiffness, and some of them are looked at. Calls of all methods are taken in turn.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
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

sys.path.append(str(Path(__file__).parents[1] / "tests" / "oracles"))
import exact

PARABOLA, CIRCLE = Scene(), Circle()
PROFILES = {PARABOLA: exact.parabola(PARABOLA.distance), CIRCLE: exact.circle(CIRCLE.distance, CIRCLE.radius)}
OBJECTS = {PARABOLA: jw.Parabola(PARABOLA.distance), CIRCLE: jw.Circle(CIRCLE.distance, CIRCLE.radius)}
RANGE = {PARABOLA: (0.694, -1.3), CIRCLE: (0.775, -1.5)}  # of the drive: in contact with every stiffness below
SOFTEST, STIFFEST = 60.0, 200.0  # of the lanes of a batch; the first has the scene's own
BASES = np.array([0.8, 0.3, -0.3])  # PyElastica's states


@cache
def exactly(scene: Scene, steps: int, stiffness: float) -> np.ndarray:
    """fx, fy, mz by elliptic integrals, solved for to rounding: (steps, 3)."""
    branch, control = exact.clamped_branch(PROFILES[scene]), control_of(scene, steps)

    def drive(p):
        state = branch.states(p)
        return state.base_x - scene.rest_length + state.fx / stiffness

    table = np.linspace(0, 1, 4001) ** 2 * branch.fold
    falling = drive(table)
    behind = np.searchsorted(-falling[: np.argmin(falling) + 1], -control)
    found = find_root(lambda p, u: drive(p) - u, (table[behind - 1], table[behind]), args=(control,))
    assert np.all(found.success) and np.max(np.abs(found.f_x)) < 1e-13
    state = branch.states(found.x)
    return np.stack([state.fx, state.fy, state.mz], axis=-1)


def error(scene: Scene, stiffness: np.ndarray, signals: np.ndarray) -> float:
    """Largest error over all lanes, (lanes, steps, 3), relative to the peaks."""
    worst = 0.0
    for c, got in zip(stiffness, signals, strict=True):
        reference = exactly(scene, signals.shape[1], float(c))
        worst = max(worst, float(np.nanmax(np.abs(got - reference) / np.max(np.abs(reference), axis=0))))
    return worst


def event_error(rod: jw.AbstractRod) -> float:
    """Largest error of an event's position, over the whole FB scan."""
    springs = [{"between": (0, 1), "stiffness": PARABOLA.stiffness, "rest_length": PARABOLA.rest_length}]
    reference = exact.exact_scan(PROFILES[PARABOLA], springs, np.linspace(0.8, -1.6, 200)).events
    found = jw.scan(ours_scene(PARABOLA, rod, PARABOLA.stiffness)).events
    got = {event.kind.name: event.control for event in found}
    return max(abs(float(got[event.kind]) - event.control) for event in reference)


def lanes_of(batch: int) -> np.ndarray:
    """Stiffness of each lane."""
    return np.append(PARABOLA.stiffness, np.linspace(SOFTEST, STIFFEST, batch - 1))


def control_of(scene: Scene, steps: int) -> np.ndarray:
    return np.linspace(*RANGE[scene], steps)


def ours_scene(scene: Scene, rod: jw.AbstractRod, stiffness) -> jw.Scene:
    return jw.Scene(jw.Whisker(), OBJECTS[scene], jw.Support.fb(stiffness, scene.rest_length), rod)


@dataclass
class Method:
    """A method at one accuracy and batch: `call` gives signals, (lanes, steps, 3)."""

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
            "error of events": self.events,
            "failed": self.failed,
            "compile, s": self.compile_time,
            "first call, s": self.first,
        }


def compiled(name: str, setting: str, scene: Scene, batch: int, steps: int, scan: Callable) -> Method:
    """A method of JAX: `scan(stiffness, control)` is compiled for the batch."""
    control, stiffness = jnp.asarray(control_of(scene, steps)), jnp.asarray(lanes_of(batch))
    start = time.perf_counter()
    run = jax.jit(jax.vmap(lambda c: scan(c, control))).lower(stiffness).compile()
    taken = time.perf_counter() - start
    return Method(name, setting, scene, batch, steps, lambda: np.asarray(run(stiffness)), compile_time=taken)


def ours(setting: str, rod: jw.AbstractRod, batch: int, steps: int, scene: Scene = PARABOLA) -> Method:
    def scan(c, control):
        result = jw.scan(ours_scene(scene, rod, c), control)
        return jnp.stack([result.fx[:, 0], result.fy[:, 0], result.mz[:, 0]], axis=-1)

    name = "closed form" if isinstance(rod, jw.ClosedForm) else "integrated"
    method = compiled(f"jaxwhisker, {name}", setting, scene, batch, steps, scan)
    default = rod in (jw.Shooting(), jw.ClosedForm())
    method.events = event_error(rod) if default and batch == 1 and scene is PARABOLA else None
    return method


def plain(name: str, setting: str, scene: Scene, steps: int, scan: Callable) -> Method:
    """A method without batches: `scan(scene, control)`."""
    control = control_of(scene, steps)
    return Method(name, setting, scene, 1, steps, lambda: scan(scene, control)[None])


def methods(batch: int, quick: bool):
    """All methods for one size of batches, made one by one: those of JAX compile on the way."""
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


def stock_scan(c, control, **how):
    return stock.scan(Scene(stiffness=c), control, **how)


def cosserat_rows(elements: tuple[int, ...]) -> list[dict]:
    """PyElastica on a few states of a clamped whisker, once: it takes seconds a state."""
    branch, rows = exact.clamped_branch(PROFILES[CIRCLE]), []
    state = branch.states(np.array([branch.parameter(x) for x in BASES]))
    reference = np.stack([state.fx, state.fy, state.mz], axis=-1)
    for n in elements:
        start = time.perf_counter()
        got = cosserat_rod.states(CIRCLE, BASES, n)
        taken = time.perf_counter() - start
        method = Method(
            "PyElastica", f"{n} elements", CIRCLE, 1, BASES.size, lambda: BASES, [taken, taken], first=taken
        )
        method.error = float(np.max(np.abs(got - reference) / np.max(np.abs(reference), axis=0)))
        rows.append(method.row())
    return rows


def measured(batch: int, quick: bool) -> list[dict]:
    """The rows of one size of batches."""
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
            # What takes long enough is measured well enough by less.
            if sum(method.times) < 30 / repeats or len(method.times) < 2:
                start = time.perf_counter()
                method.call()
                method.times.append(time.perf_counter() - start)
    return [method.row() for method in made]


def main(batches: list[int], quick: bool) -> None:
    rows = []
    for batch in batches:
        rows += measured(batch, quick)
        jax.clear_caches()  # the compiled methods of all batches together exceed what one process may map
    write("work_precision_quick" if quick else "work_precision", rows + cosserat_rows((10,) if quick else (20, 40)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few methods, results in a file of their own")
    parser.add_argument("--batches", type=int, nargs="+", help="default: 1 32 256 1024; quick: 1 256")
    options = parser.parse_args()
    main(options.batches or ([1, 256] if options.quick else [1, 32, 256, 1024]), options.quick)
