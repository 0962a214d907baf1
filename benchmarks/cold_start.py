"""Waiting in a new process: time to the first scan, derivative, batch, fit, picture and command.

python benchmarks/cold_start.py [--space]

Every task runs in a process of its own, with an empty folder for compiled programs and then with the folder that this
run has filled. Times of tasks that follow others in the same process do not include these. Each run also compiles a
fixed function without jaxwhisker, because the speed of the machine varies: rows hold its median time. With --space,
only scans in space are measured.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time

from common import write

RUNS = 3
PREPARED = """
import os, time
start = float(os.environ["STARTED"])
def lap(name):
    global start
    now = time.clock_gettime(time.CLOCK_MONOTONIC)
    print(f"{name}:{now - start}", flush=True)
    start = time.clock_gettime(time.CLOCK_MONOTONIC)
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp, numpy as np, jaxwhisker as jw
def scene(c=70.0, q=0.2):
    return jw.Scene(jw.Whisker(), jw.Parabola(q), getattr(jw.Support, MODEL.lower())(c))
def signals(scene):
    result = jw.scan(scene, control)
    return result.fx, result.fy, result.mz
"""
CALIBRATION = """
def chain(x):
    for k in range(150):
        x = jnp.where(x > k, jnp.sin(x) @ jnp.cos(x), x / (1 + x * x)) + jnp.cumsum(x, axis=0)
    return x
lowered = jax.jit(chain).lower(jnp.zeros((8, 8)))
lap("")
lowered.compile()
lap("calibration")
"""
SCAN = """
result = jw.scan(scene())
result.mz.block_until_ready()
lap("first scan")
control, numbers = np.asarray(result.control), jax.tree.map(jnp.asarray, scene())
jax.block_until_ready(jax.jacfwd(signals)(numbers))
lap("then jacfwd of all signals by all fields")
jax.block_until_ready(jax.grad(lambda scene: jw.scan(scene, control).events.control[1])(numbers))
lap("then grad of an event position")
"""
BATCH = """
control = np.linspace(0.8, -1.6, 2048)
jax.block_until_ready(jax.vmap(lambda c: jw.scan(scene(c), control).mz)(jnp.linspace(30.0, 200.0, 256)))
lap("first batch: vmap over 256 scans")
"""
STUDY = """
jw.study(scene, c=np.linspace(30.0, 200.0, 16), q=np.linspace(0.1, 0.4, 16), progress=False)
lap("first study of 256 scans")
"""
FIT = """
data = np.load(os.environ["DATA"])
start = time.clock_gettime(time.CLOCK_MONOTONIC)
def build(c1, c2, c3, q):
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fbfbr((c1, c2, c3)))
fit = jw.identify(build, {"c1": 80.0, "c2": 60.0, "c3": 75.0, "q": 0.25}, dict(data), starts=0)
assert fit.status == jw.FitStatus.ok, fit
lap("first fit of four parameters")
"""
RECORDING = """
result = jw.scan(scene((70.0, 70.0, 70.0)), np.linspace(0.8, -2.2, 200))
noise = np.random.default_rng(0).normal(size=(3, 200, 2))
sigma = {"fx": 0.05, "fy": 0.1, "mz": 0.045}
values = {n: np.asarray(getattr(result, n)) + s * e for (n, s), e in zip(sigma.items(), noise)}
np.savez(os.environ["DATA"], control=np.asarray(result.control), **values)
"""
SLIDERS = """
from jaxwhisker._explore.session import Session
session = Session(scene, {"c": (30.0, 200.0, 70.0)})
session.answer({"c": 70.0})
lap("sliders: first picture")
"""
SPACE = """
own = {"intrinsic_curvature": 0.8} if "curved" in MODEL else {}
springs = jw.Support.follicle(x=40.0, z=20.0).springs if "springs" in MODEL else ()
support = jw.Support(springs, jw.Mount(roll=1.0) if own else None)
friction = 0.3 if "friction" in MODEL else None
def in_space(offset):
    drive = jw.LinearDrive((-1.0, 0.0, 0.0), (0.0, 0.0, offset))
    ball = jw.Sphere(1.0, (0.0, 1.3, 0.0))
    return jw.Scene(jw.Whisker(**own), ball, support, motion=drive, friction=friction)
result = jw.scan(in_space(0.1))
result.force.block_until_ready()
lap("first scan")
control = np.asarray(result.control)
jax.block_until_ready(jax.jacfwd(lambda offset: jw.scan(in_space(offset), control).force)(0.1))
lap("then jacfwd of the force by the offset")
jax.block_until_ready(jax.vmap(lambda offset: jw.scan(in_space(offset), control).force)(jnp.linspace(0.1, 0.2, 32)))
lap("then vmap over 32 scans")
"""
TASKS = [("FB", SCAN), ("FBFBR", SCAN), ("FB", BATCH), ("FB", STUDY), ("FBFBR", FIT), ("FBFBR", SLIDERS)]
IN_SPACE = [(whisker, SPACE) for whisker in ("straight", "straight on springs", "curved", "straight with friction")]
COMMAND = "scan --model FBFBR --plot"


def settings(folder: str) -> dict[str, str]:
    """The environment of a task whose programs are kept in this folder."""
    own = {"JAXWHISKER_CACHE": f"{folder}/programs", "DATA": f"{folder}/data.npz", "TF_CPP_MIN_LOG_LEVEL": "3"}
    return os.environ | own | {"STARTED": str(time.clock_gettime(time.CLOCK_MONOTONIC))}


def laps(model: str, code: str, folder: str) -> dict[str, float]:
    """Seconds for each part of a task in a new process."""
    code = (PREPARED + code + CALIBRATION).replace("MODEL", repr(model))
    out = subprocess.run(
        [sys.executable, "-c", code], env=settings(folder), check=True, stdout=subprocess.PIPE, text=True
    )
    parts = (line.rsplit(":", 1) for line in out.stdout.splitlines())
    return {f"{model}, {name}": float(seconds) for name, seconds in parts if name}


def command(folder: str) -> float:
    """Seconds for the command that scans and draws."""
    start = time.perf_counter()
    line = [sys.executable, "-m", "jaxwhisker", *COMMAND.split(), f"{folder}/scan.png"]
    subprocess.run(line, env=settings(folder), check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def measure(name: str, tasks: list[tuple[str, str]]) -> None:
    """Measure these tasks, and for the plane the command, and store the table."""
    times: dict[str, dict[str, list[float]]] = {}
    calibration = []
    for model, code in tasks:
        for _ in range(RUNS):
            with tempfile.TemporaryDirectory() as folder:
                if code is FIT:
                    prepared = {"JAXWHISKER_CACHE": "off"}
                    line = [sys.executable, "-c", PREPARED.replace("MODEL", repr(model)) + RECORDING]
                    subprocess.run(line, env=settings(folder) | prepared, check=True, stdout=subprocess.DEVNULL)
                for kind in ("empty", "filled"):
                    for part, seconds in laps(model, code, folder).items():
                        if part.endswith("calibration"):
                            calibration.append(seconds)
                        else:
                            times.setdefault(part, {"empty": [], "filled": []})[kind].append(seconds)
        print(
            {part: {k: [round(t, 2) for t in v] for k, v in each.items()} for part, each in times.items()}, flush=True
        )
    for _ in range(RUNS if tasks is TASKS else 0):
        with tempfile.TemporaryDirectory() as folder:
            for kind in ("empty", "filled"):
                each = times.setdefault(f"jaxwhisker {COMMAND}", {"empty": [], "filled": []})
                each[kind].append(command(folder))
    calibrated = statistics.median(calibration)
    write(name, [
        {"task": task} | {f"{kind}, s": statistics.median(each[kind]) for kind in each} | {"calibration, s": calibrated}
        for task, each in times.items()
    ])  # fmt: skip


def main(only_space: bool) -> None:
    """Measure and store."""
    if not only_space:
        measure("cold_start", TASKS)
    measure("cold_start_space", IN_SPACE)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--space", action="store_true", help="only scans in space: cold_start_space.json")
    main(parser.parse_args().space)
