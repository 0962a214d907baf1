"""Error against run time of motion in time: jaxwhisker, MuJoCo, PyElastica and diffrax, on one core.

python benchmarks/motion_precision.py [--quick]

A clamped whisker, L = EI = rho A = 1. In the ring-down, it is let go from the snap-off state of the parabola q = 0.2;
the error is the largest distance of the tip from the reference up to t = 1. In the sweep, it is dragged past a circle
at 0.2 L/T; the error is the rms difference of mz over the whole motion, relative to the peak, with nothing left out.
MuJoCo's joints have dampers, i.e. damping proportional to the stiffness; PyElastica damps in proportion to the mass.
Each is compared with the reference that has the same damping: `simulate` with the most shape functions and tiny steps.
diffrax integrates the shape functions of `simulate`, without an object: it is in the ring-down only. Times are
processor times. Calls take turns. First calls of `simulate` and diffrax compile; their times are separate.
"""

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

if hasattr(os, "sched_setaffinity"):  # before JAX starts its threads
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ["JAXWHISKER_CACHE"] = "off"  # first calls compile

import diffrax
import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import TESTS, quick, summary, write
from peers import diffrax_motion, moving_chain, moving_rod
from peers.motion import RingDown, Sweep

ROD = jw.Whisker(mass_per_length=1.0)
MATERIAL, AIR = Sweep(stiffness_damping=0.02), Sweep(mass_damping=3.0)
MEAN = 5  # samples, 0.2 T, over which the second error of a sweep averages
ROUNDS, ENOUGH = 5, 10.0  # calls that have taken this long, in s, are not repeated
FINEST = 20  # shape functions of the reference
FINE_STEPS = 160, 128  # its steps between two samples of ring-down and sweep
RING_DOWN, BY_MATERIAL, BY_AIR = "ring-down", "sweep, damping of the material", "sweep, drag of the air"


def let_go() -> tuple[RingDown, jw.State]:
    """The ring-down and its initial state."""
    result = jw.scan(jw.Scene(ROD, jw.Parabola(0.2)), np.linspace(0.95, -1.4, 2351))
    (snap,) = result.events.of(jw.EventKind.snap_off)
    state = snap.before
    return RingDown((float(state.fx[0]), float(state.fy[0]), float(state.mz[0]))), state


def ring_down(motion: RingDown, state: jw.State, shapes: int, steps: int) -> np.ndarray:
    """Tip x, y at all samples by `simulate`, (samples + 1, 2)."""
    every = steps // motion.samples
    base = float(state.base_x[0])
    got = jw.simulate(jw.Sensor(ROD), base, motion.duration, start=state, steps=steps, every=every, shapes=shapes)
    return np.stack([got.tip_x[:, 0] - base, got.tip_y[:, 0]], axis=-1)


def sweep(motion: Sweep, shapes: int, steps: int) -> np.ndarray:
    """Support reactions at all samples but the first by `simulate`, (samples, 3)."""
    ((x, y, radius),) = motion.scene.circles
    got = jw.simulate(
        jw.Scene(ROD, jw.Circle(y - radius, radius, position=x)),
        np.array([motion.start, motion.stop]),
        motion.duration,
        steps=steps,
        every=steps // motion.samples,
        shapes=shapes,
        mass_damping=motion.mass_damping,
        stiffness_damping=motion.stiffness_damping,
    )
    return np.stack([got.fx[1:, 0], got.fy[1:, 0], got.mz[1:, 0]], axis=-1)


def tip_error(reference: np.ndarray, got: np.ndarray) -> dict[str, float]:
    """Largest distance of the tip."""
    return {"error": float(np.max(np.linalg.norm(got - reference, axis=-1)))}


def sweep_error(reference: np.ndarray, got: np.ndarray) -> dict[str, float]:
    """Rms differences relative to the peaks: of mz, of its means, largest of mz, and of the forces."""
    away = (got - reference) / np.max(np.abs(reference), axis=0)
    fx, fy, mz = np.sqrt(np.mean(away**2, axis=0))
    means = np.convolve(away[:, 2], np.ones(MEAN) / MEAN, "valid")
    mean, largest = np.sqrt(np.mean(means**2)), np.max(np.abs(away[:, 2]))
    values = {"error": mz, "error of means": mean, "largest": largest, "fx": fx, "fy": fy}
    return {name: float(value) for name, value in values.items()}


@dataclass
class Method:
    """A simulator at one setting."""

    case: str
    name: str
    setting: str
    call: Callable[[], np.ndarray]
    errors: dict[str, float] = field(default_factory=dict)
    first: float = 0.0
    times: list[float] = field(default_factory=list)

    def timed(self) -> tuple[np.ndarray, float]:
        """The motion and the processor time of this process in s, which other processes hardly change."""
        start = time.process_time()
        got = self.call()
        return got, time.process_time() - start

    def row(self) -> dict:
        """One row of the table."""
        seconds = summary(self.times * 2)  # a slow call is measured once
        row = {"case": self.case, "method": self.name, "setting": self.setting, "time, s": seconds["median"]}
        row |= {"lower quartile": seconds["lower"], "upper quartile": seconds["upper"]}
        compiles = self.name not in ("MuJoCo", "PyElastica") and self.case != BY_AIR  # the sweeps share programs
        row |= {"first call, s": self.first} if compiles else {}
        return row | self.errors


def methods(case: str, motion: RingDown | Sweep, state: jw.State, few: bool) -> list[Method]:
    """All simulators that can do this case, from coarse to fine."""
    made = []

    def add(name, words, call, settings):
        for setting in settings[:2] if few else settings:
            made.append(Method(case, name, words.format(*setting), partial(call, motion, *setting)))

    shapes, chain, rod = "{} shapes, {:,} steps", "{} links", "{} elements, radius {}"
    if isinstance(motion, RingDown):

        def ours(motion, *setting):
            return ring_down(motion, state, *setting)

        settings = [
            (6, 200),
            (8, 400),
            (9, 800),
            (10, 1000),
            (11, 1200),
            (12, 2000),
            (13, 3000),
            (15, 4400),
            (16, 8000),
        ]
        add("jaxwhisker", shapes, ours, settings)
        implicit = [(6, 0.1), (10, 0.1), (10, 0.01), (12, 0.01), (15, 0.01), (16, 0.01)]
        explicit = [(6, 0.001), (8, 0.001), (10, 0.001), (12, 0.001), (15, 0.001)]
        for solver, settings in ((diffrax.Kvaerno5(), implicit), (diffrax.Dopri8(), explicit)):
            call = partial(diffrax_motion.ring_down, solver=solver)
            add(f"diffrax, {type(solver).__name__}", "{} shapes, tolerance {}", call, settings)
        add("MuJoCo", chain, moving_chain.ring_down, [(10,), (20,), (40,), (80,), (160,)])
        thin = [(10, 0.04), (20, 0.02), (40, 0.01), (80, 0.005), (160, 0.0025)]
        add("PyElastica", rod, moving_rod.ring_down, thin)
        return made
    settings = [(5, 350), (6, 350), (6, 700), (8, 700), (8, 1050), (8, 1400), (10, 1400), (10, 2800), (12, 4200)]
    settings += [(12, 5600), (16, 11200)]
    add("jaxwhisker", shapes, sweep, settings)
    if motion.stiffness_damping:
        finer = [(10, 32), (20, 32), (20, 128), (20, 512), (40, 512), (40, 2048), (80, 1024)]
        add("MuJoCo", "{} links, {:,} steps per sample", moving_chain.sweep, finer)
    else:
        add("PyElastica", rod, moving_rod.sweep, [(10, 0.04), (20, 0.02), (40, 0.01), (80, 0.005)])
    return made


def checks(case: str, motion: RingDown | Sweep, state: jw.State, reference: np.ndarray) -> list[dict]:
    """Differences between the reference and other fine solutions."""
    fine, coarse = FINE_STEPS
    found: dict[str, dict] = {}
    if isinstance(motion, RingDown):
        got = ring_down(motion, state, FINEST - 2, fine * motion.samples // 2)
        found["18 shapes, half the steps"] = tip_error(reference, got)
        rough, finer = (moving_chain.ring_down(motion, links) for links in (40, 80))
        found["hinge chains of 40 and 80 links, extrapolated"] = tip_error(reference, (4 * finer - rough) / 3)
        given = json.loads((TESTS / "data" / "ringdown.json").read_text())["cases"][0]
        at = np.round(np.array(given["t"]) / motion.duration * motion.samples).astype(int)
        known = np.stack([given["tip_x_from_base"], given["tip_y"]], axis=-1)
        found["reference data of the tests"] = tip_error(reference[at], known)
    else:
        got = sweep(motion, FINEST - 2, coarse * motion.samples // 2)
        found["18 shapes, half the steps"] = sweep_error(reference, got)
    return [{"case": case, "method": "check of the reference", "setting": name} | e for name, e in found.items()]


def measured(case: str, motion: RingDown | Sweep, state: jw.State, few: bool) -> list[dict]:
    """Rows of one case."""
    if isinstance(motion, RingDown):
        reference = ring_down(motion, state, FINEST, FINE_STEPS[0] * motion.samples)
        error = tip_error
    else:
        reference = sweep(motion, FINEST, FINE_STEPS[1] * motion.samples)
        error = sweep_error
    made = methods(case, motion, state, few)
    for method in made:
        got, method.first = method.timed()
        method.errors = error(reference, got)
        print(f"{case}: {method.name}, {method.setting}: {method.errors['error']:.1e}", flush=True)
    for _ in range(2 if few else ROUNDS):
        for method in made:
            if sum(method.times) < ENOUGH:
                method.times.append(method.timed()[1])
    return [method.row() for method in made] + checks(case, motion, state, reference)


def main(few: bool) -> None:
    """Measure and store."""
    ring, state = let_go()
    cases: dict[str, RingDown | Sweep] = {RING_DOWN: ring, BY_MATERIAL: MATERIAL, BY_AIR: AIR}
    # Numba compiles in the first call.
    moving_rod.ring_down(RingDown(ring.reaction, duration=0.01, samples=2), 10, 0.04)
    moving_rod.sweep(Sweep(mass_damping=3.0, stop=0.9, samples=10), 10, 0.04)
    rows = [row for case, motion in cases.items() for row in measured(case, motion, state, few)]
    write("motion_quick" if few else "motion", rows, "mujoco", "pyelastica", "numba")


if __name__ == "__main__":
    main(quick(__doc__))
