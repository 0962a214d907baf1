"""Draw the figures of docs/dynamics.md and print the numbers beside them: python figures/dynamics.py

Writes docs/dynamics_ring_down.png, dynamics_sweep.png, dynamics_convergence.png and dynamics_film.gif.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"
ROD = jw.Whisker(mass_per_length=1.0)
SCENE = jw.Scene(ROD, jw.Parabola(0.2))
SPEEDS = (0.02, 0.08, 0.32)  # L per unit of time
START, STOP = 0.95, -1.4
DAMPING = 0.02
STEP = 0.01
SHAPES = (3, 4, 5, 6, 8, 10, 12)
STEPS = (50, 100, 200, 400, 800)


def ring_down(snap: jw.Event) -> None:
    """Shapes after the snap-off, and the signals at the base."""
    motion = jw.simulate(jw.Sensor(ROD), float(snap.before.base_x[0]), 2.0, start=snap.before, steps=2000)
    lines = motion.shapes()
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for k, t in enumerate((0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)):
        at = int(1000 * t)
        left.plot(lines.x[at, 0] - motion.base_x[at, 0], lines.y[at, 0], color=pyplot.cm.viridis(k / 6), label=f"{t:g}")
    left.set(xlabel="x - base (L)", ylabel="y (L)", aspect="equal", title="shapes after the snap-off")
    left.legend(title="t", fontsize=8, loc="lower left")
    right.plot(motion.time, motion.mz[:, 0], color=COLOURS[0], linewidth=0.8)
    right.set(xlabel="t (L² √(m / EI))", ylabel="mz (EI/L)", title="moment at the base")
    figure.savefig(DOCS / "dynamics_ring_down.png", dpi=150)
    pyplot.close(figure)


def sweep(speed: float, step: float = STEP) -> jw.Simulation:
    """A sweep across the object at a constant speed."""
    duration = (START - STOP) / speed
    every = max(1, round(duration / step / 2000))
    steps = every * round(duration / step / every)
    drive = np.array([START, STOP])
    return jw.simulate(SCENE, drive, duration, steps=steps, every=every, stiffness_damping=DAMPING)


def sweeps(result: jw.Result) -> None:
    """Signals of sweeps at several speeds and of the scan, and the places where contact is lost."""
    figure, axes = pyplot.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
    motions = {speed: sweep(speed, min(STEP, 0.001 / speed)) for speed in SPEEDS}
    for ax, (title, limits) in zip(
        axes, {"sweep": (START, STOP), "touch": (0.92, 0.72), "snap-off": (-1.1, -1.4)}.items(), strict=True
    ):
        for colour, (speed, motion) in zip(COLOURS, motions.items(), strict=False):
            ax.plot(motion.control, motion.mz[:, 0], color=colour, linewidth=0.9, label=f"{speed:g} L/T")
        ax.plot(result.control, result.mz[:, 0], color="black", linestyle="--", linewidth=1, label="scan")
        inside = (result.control < limits[0]) & (result.control > limits[1])
        ax.set(xlim=limits, title=title, xlabel="drive position u (L)")
        if title != "sweep":
            values = np.asarray(result.mz)[np.asarray(inside), 0]
            margin = 0.5 * np.ptp(values)
            ax.set_ylim(values.min() - margin, values.max() + margin)
    axes[0].set_ylabel("mz (EI/L)")
    axes[0].legend(fontsize=8)
    figure.savefig(DOCS / "dynamics_sweep.png", dpi=150)
    pyplot.close(figure)
    (snap,) = result.events.of(jw.EventKind.snap_off)
    for speed, motion in motions.items():
        left = next(e for e in motion.events.of(jw.EventKind.release) if e.control < -1.2)
        reference = jw.scan(SCENE, np.asarray(motion.control))
        between = (motion.control < 0.85) & (motion.control > -1.15)
        lag = np.asarray(motion.mz - reference.mz)[np.asarray(between), 0] / np.abs(reference.mz).max()
        rms = np.sqrt(np.mean(lag**2))
        print(f"speed {speed}: contact lost {snap.control - left.control:.4f} later; mz off by {rms:.1e} of its peak")


def film(result: jw.Result) -> None:
    """A clamped whisker snaps off and rings down; its drive starts at rest, as the whisker does."""
    motion = jw.simulate(
        SCENE, lambda t: -1.15 - 0.05 * t**2, 2.5, start=result, steps=2500, every=5, stiffness_damping=DAMPING
    )
    path = DOCS / "dynamics_film.gif"
    jw.animate(motion, path, speed=0.4, fps=20, width=640)
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


class Smooth:
    """A drive that starts and stops smoothly."""

    def __call__(self, t):
        return 0.1 * (1 - jnp.cos(3 * t)) ** 3


def tip(steps: int, shapes: int, start: jw.State | None = None, base: float = 0.0) -> np.ndarray:
    """Position of the tip at the end of a motion: of a smooth drive, or of the ring-down."""
    drive = Smooth() if start is None else base
    motion = jw.simulate(
        jw.Sensor(ROD),
        drive,
        2.0 if start is None else 0.5,
        start=start,
        steps=steps,
        every=steps // 50,
        shapes=shapes,
    )
    return np.stack([motion.tip_x[:, 0], motion.tip_y[:, 0]])


def convergence(snap: jw.Event) -> None:
    """Error of the tip against the number of shape functions and of time steps."""
    base = float(snap.before.base_x[0])
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name, start, colour in (("smooth drive", None, COLOURS[0]), ("ring-down", snap.before, COLOURS[1])):
        best = tip(800, 16, start, base)
        errors = [np.abs(tip(800, n, start, base) - best).max() for n in SHAPES]
        left.semilogy(SHAPES, errors, "o-", color=colour, label=name)
        print(name, "shapes", dict(zip(SHAPES, [f"{e:.1e}" for e in errors], strict=True)))
        best = tip(6400, 8, start, base)
        errors = [np.abs(tip(n, 8, start, base) - best).max() for n in STEPS]
        right.loglog(STEPS, errors, "o-", color=colour, label=name)
        print(name, "steps", dict(zip(STEPS, [f"{e:.1e}" for e in errors], strict=True)))
    right.loglog(STEPS, 30.0 / np.array(STEPS) ** 2, color="grey", linestyle=":", label="order 2")
    left.set(xlabel="shape functions", ylabel="largest error of the tip (L)")
    right.set(xlabel="time steps")
    right.set_xticks(STEPS, [str(n) for n in STEPS])
    right.minorticks_off()
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    figure.savefig(DOCS / "dynamics_convergence.png", dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Draw all figures."""
    result = jw.scan(SCENE, np.linspace(START, STOP, 2351))
    (snap,) = result.events.of(jw.EventKind.snap_off)
    ring_down(snap)
    sweeps(result)
    convergence(snap)
    film(result)


if __name__ == "__main__":
    main()
