"""Error against run time of several contacts: jaxwhisker, a discrete rod, MuJoCo, Exudyn and PyElastica, on one core.

python benchmarks/several_precision.py [METHOD ...]     default: all; stored rows of other methods are kept

A clamped whisker passes two circles, one after the other. It touches both between u = -0.588 and -0.750, and jumps off
the second one at u = -1.393. The reference is the stored scan of the tests, which a chain of elastica segments and a
discrete rod have yielded independently. Errors are those of mz and fx, relative to their peaks, at the drive positions
of this scan down to 0.05 before the jump, and at those among them with two contacts. The jump is where mz falls below
half of its value there; where this is is found in a second scan with small steps, which is not timed. jaxwhisker
reports it as an event.

In a batch, every lane has another distance of the second circle; the first one is compared. Motions in time run at a
constant speed. Times are processor times on one core, which other processes hardly change; calls of all methods take
turns, and first calls, which may compile, are apart.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

if hasattr(os, "sched_setaffinity"):  # before JAX starts its threads
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ["JAXWHISKER_CACHE"] = "off"  # first calls compile

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import RESULTS, read, summary, write
from peers.motion import Sweep
from peers.scene import Circles

# isort: split
# After common, which puts the helpers of the tests on the search path.
from several_cases import CASES

STORED = CASES["two_circles"]
CONTROL = np.array(STORED["control"])  # drive positions, 0.06 apart
REFERENCE = np.stack([np.array(STORED[name])[:, 0] for name in ("fx", "fy", "mz")], axis=1)
PEAKS = np.max(np.abs(REFERENCE), axis=0)
_, SECOND_TOUCH, _, RELEASE, _, JUMP = (float(event["control"]) for event in STORED["events"])
TWO = (CONTROL < SECOND_TOUCH) & (CONTROL > RELEASE)  # from the second touch to the release
CLEAR = CONTROL > JUMP + 0.05  # compared
HALF = 1.18  # of mz at the jump
FEW, MANY = 3, 60  # steps between two stored positions; the simulators take few
BATCH = 16
DISTANCES = 0.22, 0.28  # of the second circle, in a batch
START, STOP = 0.3, -1.6  # of motions
SAMPLES = 950
OURS, MOTION, ROD, NODES = "jaxwhisker", "jaxwhisker, motion", "discrete rod", "discrete rod, contact at hinges"
CHAIN, CABLE, COSSERAT = "MuJoCo", "Exudyn", "PyElastica"
METHODS = OURS, MOTION, ROD, NODES, CHAIN, CABLE, COSSERAT
ROUNDS, ENOUGH = 5, 20.0  # calls that have taken this long, in s, are not repeated


def refined(between: int) -> np.ndarray:
    """The stored drive positions, and others between them."""
    return np.linspace(CONTROL[0], CONTROL[-1], (CONTROL.size - 1) * between + 1)


NEAR_JUMP = np.append(refined(FEW)[refined(FEW) > JUMP + 0.03], np.arange(JUMP + 0.03, JUMP - 0.03, -2e-4))
NEAR_JUMP_AT_REST = np.append(CONTROL[0], np.arange(JUMP + 0.03, JUMP - 0.03, -5e-3))  # PyElastica takes seconds


def lost_at(control: np.ndarray, mz: np.ndarray) -> float | None:
    """Drive position at which mz falls below half of its value at the jump; None if it is not known or does not."""
    late = control < JUMP + 0.05
    low = np.flatnonzero(late & (np.abs(mz) < HALF))
    if low.size == 0 or not np.isfinite(mz[low[0] - 1]):
        return None
    return float((control[low[0]] + control[low[0] - 1]) / 2)


def errors(reactions: np.ndarray) -> dict[str, float]:
    """Largest errors of mz and fx at the stored positions, relative to the peaks; failed states are left out."""
    away = np.abs(reactions - REFERENCE) / PEAKS
    found = {}
    for words, where in (("", CLEAR), (", two contacts", TWO)):
        for name, column in (("mz", 2), ("fx", 0)):
            found[name + words] = float(np.nanmax(away[where, column]))
    return found


@dataclass
class Method:
    """A method at one setting; `call` returns reactions (lanes, positions, 3), `jump` the place of the jump."""

    name: str
    setting: str
    control: np.ndarray
    call: Callable[[], np.ndarray]
    jump: Callable[[], float | None]
    batch: int = 1
    equilibria: int | None = None  # that a motion replaces
    times: list[float] = field(default_factory=list)
    found: dict = field(default_factory=dict)

    def timed(self) -> tuple[np.ndarray, float]:
        """The reactions and the processor time of this process in s."""
        start = time.process_time()
        return self.call(), time.process_time() - start

    def begin(self) -> None:
        """Call it for the first time and compare."""
        lanes, first = self.timed()
        at = [int(np.argmin(np.abs(self.control - u))) for u in CONTROL]
        jump = self.jump()
        self.found = {
            **errors(lanes[0, at]),
            "jump": None if jump is None else abs(jump - JUMP),
            "failed": float(np.mean(np.isnan(lanes[..., 2]))),
            "first call, s": first,
        }

    def row(self) -> dict:
        """One row of the table."""
        positions = self.equilibria or self.control.size
        each = {k: 1e3 * v / self.batch / positions for k, v in summary(self.times * 2).items()}
        return {
            "method": self.name,
            "setting": self.setting,
            "batch": self.batch,
            "positions": positions,
            "ms per equilibrium": each["median"],
            "lower quartile": each["lower"],
            "upper quartile": each["upper"],
            "s per scan": each["median"] * positions / 1e3,
            **self.found,
        }


def ours(steps: int, between: int, batch: int = 1) -> Method:
    """Scans of this package."""
    control = refined(between)

    def scene(distance):
        circles = jw.Circle(0.5, 0.2), jw.Circle(distance, 0.12, position=-0.55)
        return jw.Scene(jw.Whisker(), circles, rod=jw.Shooting(steps), contacts=2)

    def scan(distance):
        result = jw.scan(scene(distance), control)
        return jnp.stack([result.fx[:, 0], result.fy[:, 0], result.mz[:, 0]], axis=-1)

    own = STORED["objects"][1]["distance"]
    run = jax.jit(jax.vmap(scan)) if batch > 1 else lambda distances: scan(float(distances[0]))[None]
    lanes = np.append(own, np.linspace(*DISTANCES, batch - 1))

    def jump():
        return float(jw.scan(scene(own), control).events[-1].control)

    return Method(
        OURS, f"{steps} steps", control, lambda: np.asarray(run(lanes)), jump if batch == 1 else lambda: None, batch
    )


def moving(shapes: int, speed: float, damping: float, step: float) -> Method:
    """Motions of this package."""
    circles = jw.Circle(0.5, 0.2), jw.Circle(0.25, 0.12, position=-0.55)
    scene = jw.Scene(jw.Whisker(mass_per_length=1.0), circles, contacts=2)
    motion = Sweep(start=START, stop=STOP, speed=speed, samples=SAMPLES, scene=Circles())
    every = max(1, round(motion.duration / SAMPLES / step))
    options = {"steps": every * SAMPLES, "every": every, "shapes": shapes, "stiffness_damping": damping}
    control = np.linspace(START, STOP, SAMPLES + 1)

    def call():
        got = jw.simulate(scene, np.array([START, STOP]), motion.duration, **options)
        return np.stack([got.fx[:, 0], got.fy[:, 0], got.mz[:, 0]], axis=-1)[None]

    def jump():
        return lost_at(control, call()[0, :, 2])

    setting = f"{shapes} shapes, {speed} L/T, damping {damping} T, {options['steps']:,} steps"
    return Method(MOTION, setting, control, call, jump, equilibria=(CONTROL.size - 1) * FEW + 1)


def plain(name: str, setting: str, scan: Callable, between: int = FEW, near: np.ndarray = NEAR_JUMP) -> Method:
    """Another method, `scan(scene, control)`; the jump is sought at the positions `near`."""
    control = refined(between)
    return Method(
        name,
        setting,
        control,
        lambda: scan(Circles(), control)[None],
        lambda: lost_at(near, scan(Circles(), near)[:, 2]),
    )


def methods(name: str):
    """Yield a method at all of its settings."""
    if name == OURS:
        for steps in (2, 4, 8, 16):
            yield ours(steps, FEW)
            yield ours(steps, MANY)
        for steps in (4, 8):
            yield ours(steps, MANY, BATCH)
    elif name == MOTION:
        for setting in ((12, 0.05, 0.02, 0.01), (12, 0.02, 0.01, 0.01), (20, 0.01, 0.01, 0.01)):
            yield moving(*setting)
    elif name in (ROD, NODES):
        from peers import linked_rod

        for links in (50, 100, 200, 400):
            yield plain(name, f"{links} links", partial(linked_rod.scan, links=links, at_nodes=name == NODES))
        for links in (50, 100, 200) if name == ROD else ():
            yield plain(name, f"{links} links", partial(linked_rod.scan, links=links), MANY)
    elif name == CHAIN:
        from peers import capsule_chain

        for links in (10, 20, 40, 80):
            yield plain(name, f"{links} links", partial(capsule_chain.scan, links=links))
    elif name == CABLE:
        from peers import cable

        for elements, axial, penalty in ((8, 1e5, 1e4), (16, 1e5, 1e5), (32, 1e6, 1e5), (64, 1e6, 1e5)):
            scan = partial(cable.scan, elements=elements, axial=axial, penalty=penalty)
            yield plain(name, f"{elements} elements, penalty {penalty:.0e}", scan)
    elif name == COSSERAT:
        from peers import moving_rod

        moving_rod.states(Circles(), np.array([0.3, 0.29]), 10, 0.04)  # Numba compiles
        for elements, radius in ((10, 0.04), (20, 0.02)):
            scan = partial(moving_rod.states, elements=elements, radius=radius)
            yield plain(name, f"{elements} elements, radius {radius}", scan, 1, NEAR_JUMP_AT_REST)


def measured(names: list[str]) -> list[dict]:
    """Rows of these methods."""
    begun, made = time.perf_counter(), []
    for name in names:
        for method in methods(name):
            method.begin()
            text = " ".join(f"{key} {value:.1e}" for key, value in method.found.items() if value is not None)
            print(f"{time.perf_counter() - begun:7.1f} s  {name}, {method.setting}, {method.batch}: {text}", flush=True)
            if name == COSSERAT:  # which compiles nothing in this call
                method.times.append(method.found["first call, s"])
            made.append(method)
    for _ in range(ROUNDS):
        for method in made:
            if not method.times or sum(method.times) + method.times[-1] < ENOUGH:
                method.times.append(method.timed()[1])
    return [method.row() for method in made]


def main(names: list[str]) -> None:
    """Measure and store."""
    rows = measured(names)
    if (RESULTS / "several_precision.json").exists():
        rows += [row for row in read("several_precision")["rows"] if row["method"] not in names]
    rows.sort(key=lambda row: (METHODS.index(row["method"]), row["batch"], row["positions"]))
    write("several_precision", rows, "scipy", "mujoco", "exudyn", "pyelastica")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("methods", nargs="*", metavar="METHOD", help=f"default: all of {', '.join(METHODS)}")
    main(parser.parse_args().methods or list(METHODS))
