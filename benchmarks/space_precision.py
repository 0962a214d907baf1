"""Error against run time in space: jaxwhisker, scipy, MuJoCo and PyElastica, in single scans and batches.

python benchmarks/space_precision.py [--quick] [--batches N ...]

A clamped whisker passes a sphere beside its path, from just after the first touch to just before the release: straight,
or with a constant curvature and a roll of 60 degrees. The error is the largest error of the six reactions at
the base, relative to the largest force or moment of the scan. The reference is the plane problem at the distance of the
base from the axis of the sphere, in elliptic integrals; for the curved whisker scipy at 1e-12, after a comparison with
the reference data of the tests. In a batch every lane has another offset, and about eight lanes are compared. One scan
is a plain call of `jw.scan`; a batch is compiled as a whole. First calls include compilation. Calls of all methods take
turns. Stored rows of other batches are kept.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial

os.environ["JAXWHISKER_CACHE"] = "off"

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import RESULTS, TESTS, read, summary, write
from peers import ball_chain, cosserat_rod, shooting_in_space
from peers.scene import Circle, InSpace

# isort: split
# After common, which puts the oracles on the search path.
from exact import circle, clamped_branch

STRAIGHT, CURVED = InSpace(), InSpace(offset=0.1, curvature=0.8, roll=np.pi / 3)
NAMES = {STRAIGHT: "straight", CURVED: "curved"}
RANGE = {STRAIGHT: (-0.8, 0.8), CURVED: (-0.95, 0.55)}  # of the drive; in contact for every offset below
OFFSETS = {STRAIGHT: (0.05, 0.5), CURVED: (0.02, 0.18)}  # of a batch; the first lane has the offset of the scene
STEPS, FEW, COMPARED = 1600, 100, 25  # of this package, of other methods, and how many of each are compared
BASES = np.array([0.7, 0.3, -0.3])  # base positions of PyElastica's states
STORED = "S4 arc kappa 0.8 roll 60 C/B 0.667 offset 0.1"  # CURVED among the reference data of the tests
ACCURATE = 1e-9  # these data


def control_of(scene: InSpace, steps: int) -> np.ndarray:
    """Drive positions of a scan; those of fewer steps are among them."""
    return np.linspace(*RANGE[scene], steps, endpoint=False)


def lanes_of(scene: InSpace, batch: int) -> np.ndarray:
    """Offset of each lane."""
    return np.append(scene.offset, np.linspace(*OFFSETS[scene], batch - 1))


def exactly(scene: InSpace, base_x: np.ndarray) -> np.ndarray:
    """Exact reactions of a straight whisker, (steps, 6)."""
    branch = clamped_branch(circle(scene.height - scene.radius, scene.radius))
    apart = np.stack([base_x, 0 * base_x, np.full(base_x.size, scene.offset)], axis=1)
    distance = np.linalg.norm(apart, axis=1)
    state = branch.states(np.array([branch.parameter(x) for x in distance]))
    outwards, up = apart / distance[:, None], np.array([0.0, 1.0, 0.0])
    force = state.fx[:, None] * outwards + state.fy[:, None] * up
    return np.concatenate([force, state.mz[:, None] * np.cross(outwards, up)], axis=1)


def difference(got: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of reactions (steps, 6), relative to the largest force or moment."""
    peak = np.nanmax(np.abs(expected).reshape(-1, 2, 3), axis=(0, 2))
    return float(np.nanmax(np.abs(got - expected) / np.repeat(peak, 3)))


@cache
def reference(scene: InSpace, offset: float) -> np.ndarray:
    """Reactions at the compared steps, (COMPARED, 6)."""
    control, lane = control_of(scene, COMPARED), replace(scene, offset=offset)
    return shooting_in_space.scan(lane, control, 1e-12) if scene.curvature else exactly(lane, -control)


def check_reference() -> None:
    """Compare scipy at 1e-12 with the reference data of the tests."""
    cases = json.loads((TESTS / "data" / "space.json").read_text("utf-8"))["cases"]
    states = next(case["states"] for case in cases if case["name"] == STORED)
    stored = np.concatenate([states["force"], states["moment"]], axis=1)
    assert difference(shooting_in_space.scan(CURVED, np.array(states["u"]), 1e-12), stored) < ACCURATE


@dataclass
class Method:
    """A method at one setting and batch size; `call` returns reactions (lanes, steps, 6)."""

    name: str
    setting: str
    scene: InSpace
    batch: int
    steps: int
    call: Callable[[], np.ndarray]
    times: list[float] = field(default_factory=list)
    first: float = 0.0
    error: float = 0.0
    failed: float = 0.0

    def begin(self) -> None:
        """Call it for the first time and compare."""
        start = time.perf_counter()
        reactions = self.call()
        self.first = time.perf_counter() - start
        every = max(1, self.batch // 8)
        pairs = zip(lanes_of(self.scene, self.batch)[::every], reactions[::every], strict=True)
        compared = slice(None, None, self.steps // COMPARED)
        self.error = max(difference(got[compared], reference(self.scene, float(b))) for b, got in pairs)
        self.failed = float(np.mean(np.isnan(reactions)))

    def row(self) -> dict:
        """One row of the table; times in us per equilibrium."""
        each = {k: 1e6 * v / self.batch / self.steps for k, v in summary(self.times).items()}
        return {
            "whisker": NAMES[self.scene],
            "method": self.name,
            "setting": self.setting,
            "batch": self.batch,
            "steps": self.steps,
            "us per equilibrium": each["median"],
            "lower quartile": each["lower"],
            "upper quartile": each["upper"],
            "error": self.error,
            "failed": self.failed,
            "first call, s": self.first,
        }


def ours(scene: InSpace, rod: jw.AbstractRod, batch: int) -> Method:
    """This package with one kind of rods."""
    control = control_of(scene, STEPS)
    own = {"intrinsic_curvature": scene.curvature} if scene.curvature else {}
    whisker = jw.Whisker(torsion_ratio=scene.torsion_ratio, **own)
    support = jw.Support(mount=jw.Mount(roll=scene.roll)) if scene.curvature else jw.Support()
    sphere = jw.Sphere(scene.radius, (0.0, scene.height, 0.0))

    def scan(offset):
        drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
        result = jw.scan(jw.SpaceScene(whisker, sphere, support, rod, drive), control)
        return jnp.concatenate([result.force[:, 0], result.moment[:, 0]], axis=1)

    offsets = lanes_of(scene, batch)
    run = jax.jit(jax.vmap(scan)) if batch > 1 else lambda offsets: scan(float(offsets[0]))[None]
    setting = f"{rod.steps} steps" if isinstance(rod, jw.Shooting) else "elliptic functions"
    return Method("jaxwhisker", setting, scene, batch, STEPS, lambda: np.asarray(run(offsets)))


def plain(name: str, setting: str, scene: InSpace, steps: int, scan: Callable) -> Method:
    """A method without batches, `scan(scene, control)`."""
    return Method(name, setting, scene, 1, steps, lambda: scan(scene, control_of(scene, steps))[None])


def methods(batch: int, quick: bool):
    """Yield all methods for one batch size."""
    for scene in (STRAIGHT, CURVED):
        for steps in (4, 8) if quick else (2, 4, 8, 16) if batch == 1 else (4, 8, 16):
            yield ours(scene, jw.Shooting(steps), batch)
    yield ours(STRAIGHT, jw.ClosedForm(), batch)
    if batch > 1:
        return
    for scene in (STRAIGHT, CURVED):
        for tolerance in (1e-4, 1e-6) if quick else (1e-4, 1e-6, 1e-8, 1e-10):
            scan = partial(shooting_in_space.scan, tolerance=tolerance)
            yield plain("scipy: fsolve, solve_ivp", f"tolerance {tolerance:.0e}", scene, FEW, scan)
    for links in (10, 20) if quick else (5, 10, 20, 40):
        scan = partial(ball_chain.scan, links=links)
        yield plain("MuJoCo: chain of balls", f"{links} links", STRAIGHT, FEW, scan)


def cosserat_rows(elements: tuple[int, ...]) -> list[dict]:
    """PyElastica on a few states, run once because a state takes seconds."""
    rows = []
    for n in elements:
        start = time.perf_counter()
        got = cosserat_rod.states(Circle(distance=STRAIGHT.height - STRAIGHT.radius), BASES, n, STRAIGHT.offset)
        taken = time.perf_counter() - start
        method = Method("PyElastica", f"{n} elements", STRAIGHT, 1, BASES.size, lambda: BASES, [taken] * 2, taken)
        method.error = difference(got, exactly(STRAIGHT, BASES))
        rows.append(method.row())
    return rows


def measured(batch: int, quick: bool) -> list[dict]:
    """Rows of one batch size."""
    begun, made = time.perf_counter(), []
    for method in methods(batch, quick):
        method.begin()
        text = f"{NAMES[method.scene]}: {method.name}, {method.setting}, {batch}: {method.error:.1e}"
        print(f"{time.perf_counter() - begun:7.1f} s  {text}", flush=True)
        made.append(method)
    repeats = 3 if quick else 7
    for _ in range(repeats):
        for method in made:
            # Slow calls need fewer repetitions.
            if sum(method.times) < 30 / repeats or len(method.times) < 3:
                start = time.perf_counter()
                method.call()
                method.times.append(time.perf_counter() - start)
    return [method.row() for method in made]


def main(batches: list[int], quick: bool) -> None:
    """Measure and store."""
    check_reference()
    name = "space_precision_quick" if quick else "space_precision"
    stored = read(name)["rows"] if (RESULTS / f"{name}.json").exists() else []
    rows = [row for row in stored if row["batch"] not in batches]
    if 1 in batches:
        rows += cosserat_rows((10,) if quick else (20, 40))
    for batch in batches:
        rows += measured(batch, quick)
    rows.sort(key=lambda row: (row["whisker"] == "curved", row["method"] != "jaxwhisker", row["method"], row["batch"]))
    write(name, rows, "scipy", "mujoco", "pyelastica")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few methods; writes space_precision_quick.json")
    parser.add_argument("--batches", type=int, nargs="+", help="default: 1 256; quick: 1 32")
    options = parser.parse_args()
    main(options.batches or ([1, 32] if options.quick else [1, 256]), options.quick)
