"""Draw the figures of docs/when_statics_is_enough.md and print its numbers: python figures/statics_enough.py

Writes docs/statics_enough_differences.png and statics_enough_speed.png. With `--check`, repeats the numbers with half
the time step and with more shape functions, and draws nothing.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

DOCS = Path(__file__).parents[1] / "docs"

# A steel wire (100 mm, 0.5 mm) with E = 210 GPa and 7850 kg/m^3 at 0.25 m/s; its own units are L, T and EI.
LENGTH, DIAMETER, YOUNGS_MODULUS, DENSITY, SPEED = 0.1, 0.5e-3, 210e9, 7850.0, 0.25
UNIT_OF_TIME = float(LENGTH**2 * 4 / DIAMETER * np.sqrt(DENSITY / YOUNGS_MODULUS))  # L^2 sqrt(rho A / EI), s
UNIT_OF_SPEED = LENGTH / UNIT_OF_TIME
SCENE = jw.Scene(jw.Whisker(mass_per_length=1.0), jw.Parabola(0.2), jw.Support.fb(70.0))
START, STOP = 0.8, -1.9
SAMPLES = 14_000
DAMPINGS = (0.002, 0.005, 0.02, 0.1, 0.3, 1.0)  # time constants of the material, T
SPEEDS = np.geomspace(0.005, 1.0, 9)  # L/T
CHECKS = ((28_000, 12), (56_000, 12), (28_000, 16))  # time steps, shape functions
SMOOTH = (0.3, -0.9)  # drive positions between which the whisker keeps contact


def sweeps(speeds: Any, dampings: Any, steps: int, shapes: int) -> tuple[np.ndarray, ...]:
    """Sweeps with the same number of steps: moments, forces along x, phases, tip deflections, status."""

    def one(speed, damping):
        motion = jw.simulate(
            SCENE,
            jnp.array([START, STOP]),
            (START - STOP) / speed,
            steps=steps,
            every=steps // SAMPLES,
            stiffness_damping=damping,
            shapes=shapes,
        )
        return (
            motion.mz[:, 0],
            motion.fx[:, 0],
            motion.phase[:, 0],
            motion.tip_x[:, 0] - motion.base_x[:, 0],
            motion.status,
        )

    results = jax.vmap(one)(jnp.asarray(speeds), jnp.asarray(dampings))
    print(f"  lost: {int(np.sum(np.asarray(results[-1]) != jw.Status.ok))} samples")
    return tuple(np.asarray(values) for values in results)


class Statics:
    """The scan at the samples of a sweep, with its events."""

    def __init__(self):
        self.u = np.linspace(START, STOP, SAMPLES + 1)
        result = jw.scan(SCENE, self.u)
        self.mz, self.fx = np.asarray(result.mz)[:, 0], np.asarray(result.fx)[:, 0]
        self.peak = self.mz.max()
        self.touch = result.events.of(jw.EventKind.touch)[0].control
        self.fold = result.events.of(jw.EventKind.snap_off)[0].control
        self.snap = result.events.of(jw.EventKind.snap_off)[0].before


def impact(statics: Statics, count: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modes at the first touch, and the amplitudes of mz and fx that the touch excites in them, per speed.

    Before the touch, all points of the whisker move with the drive. Afterwards the statics prescribe other velocities.
    The difference is the initial velocity of a vibration, whose modes are those of the touching whisker.
    """
    step = 1e-4
    result = jw.scan(SCENE, statics.touch - step * np.array([1.0, 2.0]))
    modes = jw.modes(result, count, step=0, points=201)
    lines = jw.shapes(result, points=201)
    rate = np.stack([np.diff(lines.x, axis=0)[0, 0], np.diff(lines.y, axis=0)[0, 0]], axis=-1) / step
    difference = np.array([-1.0, 0.0]) - rate
    momentum = np.trapezoid(np.sum(np.asarray(modes.shape)[:, 0] * difference, axis=-1), dx=1 / 200, axis=1)
    omega = np.asarray(modes.omega)
    return omega, momentum * np.asarray(modes.mz)[:, 0] / omega, momentum * np.asarray(modes.fx)[:, 0] / omega


def leaving(statics: Statics, phase: np.ndarray) -> int:
    """Index of the first sample after the fold without contact."""
    return int(np.flatnonzero((statics.u < statics.fold) & (phase == jw.Phase.free))[0])


def print_differences(statics: Statics, steps: int, shapes: int) -> tuple[np.ndarray, ...]:
    """What touch and snap-off add at 0.25 m/s."""
    speed = SPEED / UNIT_OF_SPEED
    print(
        f"a. {steps} steps, {shapes} shapes: speed {speed:.4f} L/T, mz before the fold {float(statics.snap.mz[0]):.3f}"
    )
    mz, fx, phase, tip, _ = sweeps(np.full(len(DAMPINGS), speed), DAMPINGS, steps, shapes)
    time = (START - statics.u) / speed
    at_fold = (START - statics.fold) / speed
    for k, damping in enumerate(DAMPINGS):
        difference, force = mz[k] - statics.mz, fx[k] - statics.fx
        touch = (statics.u < statics.touch) & (statics.u > statics.touch - speed)
        smooth = (statics.u < SMOOTH[0]) & (statics.u > SMOOTH[1])
        left = leaving(statics, phase[k])
        after = statics.u < statics.fold
        high = np.flatnonzero(mz[k] > 0.9 * statics.snap.mz[0])
        low = int(np.flatnonzero(after & (mz[k] < 0.1 * statics.snap.mz[0]))[0])
        high = int(high[high < low][-1])
        again = np.flatnonzero(phase[k][left:] != jw.Phase.free)
        print(
            f"  tau {damping}: touch {np.abs(difference[touch]).max():.4f} in mz,"
            f" {np.abs(force[touch]).max():.4f} in fx;"
            f" in between {np.abs(difference[smooth]).max() / statics.peak:.2e} of the peak;"
            f" leaves {time[left] - at_fold:.3f} T or {statics.fold - statics.u[left]:.4f} L late;"
            f" mz falls from 90 to 10 % in {time[low] - time[high]:.3f} T or {statics.u[high] - statics.u[low]:.4f} L,"
            f" at {time[high] - at_fold:.3f} T;"
            f" lowest {mz[k][left:].min():.3f}; again in contact: {len(again)} samples"
            + (f" from {time[left + again[0]] - time[left]:.2f} T later" if len(again) else "")
        )
    return mz, fx, phase, tip, time


def swing(time: np.ndarray, tip: np.ndarray) -> float:
    """Angular frequency of a ring-down, from zeros of the deflection."""
    (at,) = np.nonzero(np.diff(np.sign(tip)))
    return float(np.pi * (len(at) - 1) / (time[at[-1]] - time[at[0]]))


def draw_differences(statics: Statics) -> None:
    """The difference from statics at the touch, its spectrum, and the snap-off."""
    speed = SPEED / UNIT_OF_SPEED
    mz, _, phase, tip, time = print_differences(statics, *CHECKS[0])
    omega, moments, forces = impact(statics)
    print(
        f"  modes at the touch {np.round(omega, 2)}: mz {np.round(moments * speed, 4)},"
        f" fx {np.round(forces * speed, 4)}"
    )
    for k in (0, 2, 3):
        late = statics.u < -1.5
        print(f"  tau {DAMPINGS[k]}: ring-down at omega {swing(time[late], tip[k][late]):.3f}")
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    since = time - (START - statics.touch) / speed
    near = (since > 0) & (since < 3)
    for k, colour in zip((0, 2, 3), COLOURS, strict=False):
        difference = mz[k] - statics.mz
        axes[0].plot(
            since[near], 100 * difference[near] / statics.peak, color=colour, linewidth=0.9, label=f"{DAMPINGS[k]:g}"
        )
        flat = difference[near] - np.polyval(np.polyfit(since[near], difference[near], 2), since[near])
        spectrum = np.abs(np.fft.rfft(flat * np.hanning(flat.size), 16 * flat.size))
        frequency = 2 * np.pi * np.fft.rfftfreq(16 * flat.size, time[1] - time[0])
        axes[1].semilogy(frequency, spectrum / flat.size, color=colour, linewidth=0.9)
        print(f"  tau {DAMPINGS[k]}: largest amplitude of the difference at omega {frequency[np.argmax(spectrum)]:.2f}")
    damped = np.exp(-DAMPINGS[2] / 2 * omega**2 * since[near, None]) * np.sin(omega * since[near, None])
    axes[0].plot(since[near], 100 * damped @ moments * speed / statics.peak, "k:", linewidth=1, label="4 modes, 0.02")
    for value in omega[:3]:
        axes[1].axvline(value, color="0.6", linewidth=0.8)
    axes[0].set(xlabel="time since the touch (T)", ylabel="mz - mz of the scan (% of the peak)", title="touch")
    axes[1].set(xlim=(0, 80), ylim=(1e-6, 3e-3), xlabel="angular frequency (1/T)", title="its spectrum; lines: modes")
    axes[0].legend(title="damping (T)", fontsize=8)
    for k, colour in zip((0, 2, 3, 4), COLOURS, strict=False):
        axes[2].plot(statics.u, mz[k], color=colour, linewidth=0.9, label=f"{DAMPINGS[k]:g}")
        left = leaving(statics, phase[k])
        axes[2].plot(statics.u[left], mz[k][left], "o", color=colour, markersize=4)
    axes[2].plot(statics.u, statics.mz, "k--", linewidth=1, label="scan")
    axes[2].set(
        xlim=(-1.25, -1.65),
        ylim=(-3, 3),
        xlabel="drive position u (L)",
        ylabel="mz (EI/L)",
        title="snap-off; dots: contact lost",
    )
    axes[2].legend(fontsize=8)
    figure.savefig(DOCS / "statics_enough_differences.png", dpi=150)
    pyplot.close(figure)


def smooth_errors(speeds: np.ndarray, dampings: Sequence[float], steps: int, shapes: int) -> np.ndarray:
    """Errors (rms of mz over its peak) of smooth motions in contact, whose largest speeds are given.

    The slowest motion without damping is the reference: its discretisation in space is the same.
    """
    middle, half = (SMOOTH[0] + SMOOTH[1]) / 2, (SMOOTH[0] - SMOOTH[1]) / 2
    before = jw.scan(SCENE, np.linspace(START, SMOOTH[0], 101))

    def one(speed, damping):
        frequency = speed / (2 * jnp.pi * half)
        drive = jw.Whisking(half, frequency, middle, jnp.pi / 2)
        return jw.simulate(
            SCENE,
            drive,
            0.5 / frequency,
            start=before,
            steps=steps // 4,
            every=steps // 4 // 500,
            stiffness_damping=damping,
            shapes=shapes,
        ).mz[:, 0]

    each = np.repeat(dampings, len(speeds))
    mz = np.asarray(jax.vmap(one)(jnp.tile(speeds, len(dampings)), jnp.asarray(each)))
    mz = mz.reshape(len(dampings), len(speeds), -1)
    return np.sqrt(np.mean((mz[:, 1:] - mz[0, 0]) ** 2, axis=-1)) / 6.46427  # the peak of the scan


def speed_errors(statics: Statics, dampings: Sequence[float], steps: int, shapes: int) -> dict[str, np.ndarray]:
    """Errors of statics over the speed: rows are dampings."""
    each = np.repeat(dampings, len(SPEEDS))
    mz, _, phase, *_ = sweeps(np.tile(SPEEDS, len(dampings)), each, steps, shapes)
    difference = (mz - statics.mz)[:, statics.u > -1.2] / statics.peak
    found = {
        "rms": np.sqrt(np.mean(difference**2, axis=1)),
        "largest": np.abs(difference).max(axis=1),
        "delay": np.array([statics.fold - statics.u[leaving(statics, row)] for row in phase]),
    }
    return {name: values.reshape(len(dampings), -1) for name, values in found.items()}


def print_speeds(statics: Statics, steps: int, shapes: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Tables of errors over speed."""
    print(f"b. {steps} steps, {shapes} shapes")
    errors = speed_errors(statics, (0.02, 0.1), steps, shapes)
    smooth = smooth_errors(SPEEDS, (0.0, 0.02), steps, shapes)
    for k, damping in enumerate((0.02, 0.1)):
        for j, speed in enumerate(SPEEDS):
            values = "  ".join(f"{name} {values[k, j]:.3e}" for name, values in errors.items())
            print(f"  tau {damping} speed {speed:.4f} L/T, {speed * UNIT_OF_SPEED:.3f} m/s: {values}")
    for damping, row in zip((0.0, 0.02), smooth, strict=True):
        print(f"  smooth, tau {damping}:", " ".join(f"{value:.2e}" for value in row))
    return errors, smooth


def draw_speeds(statics: Statics) -> None:
    """Errors of statics over the speed."""
    errors, smooth = print_speeds(statics, *CHECKS[2])
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for k, damping in enumerate((0.02, 0.1)):
        left.loglog(
            SPEEDS, errors["rms"][k], "o-", color=COLOURS[k], markersize=4, label=f"sweep, damping {damping:g}: rms"
        )
        left.loglog(SPEEDS, errors["largest"][k], "o--", color=COLOURS[k], markersize=4, label="largest")
        right.loglog(SPEEDS, errors["delay"][k], "o-", color=COLOURS[k], markersize=4, label=f"damping {damping:g}")
    left.loglog(
        SPEEDS[1:], smooth[0], "s-", color=COLOURS[2], markersize=4, label="in contact, smooth, no damping: rms"
    )
    left.loglog(SPEEDS, 0.02 * SPEEDS, color="0.6", linestyle=":", label="orders 1 and 2")
    left.loglog(SPEEDS, 0.06 * SPEEDS**2, color="0.6", linestyle=":")
    right.loglog(SPEEDS, 0.3 * SPEEDS ** (2 / 3), color="0.6", linestyle=":", label="order 2/3")
    for ax in (left, right):
        ax.axvline(SPEED / UNIT_OF_SPEED, color="0.8", linewidth=1, zorder=0)
        ax.set(xlabel="speed (L/T); grey: 0.25 m/s of the wire")
        ax.secondary_xaxis("top", functions=(lambda v: v * UNIT_OF_SPEED, lambda v: v / UNIT_OF_SPEED)).set_xlabel(
            "steel wire, 100 mm, 0.5 mm (m/s)"
        )
    left.set(ylabel="error of mz relative to its peak", ylim=(5e-7, 1))
    right.set(ylabel="delay of the snap-off (L)")
    left.legend(fontsize=7)
    right.legend(fontsize=8)
    figure.savefig(DOCS / "statics_enough_speed.png", dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Draw both figures, or only print numbers at other discretisations."""
    statics = Statics()
    if "--check" in sys.argv:
        for steps, shapes in CHECKS[1:]:
            print_differences(statics, steps, shapes)
        for steps, shapes in ((56_000, 16), (28_000, 20)):
            print_speeds(statics, steps, shapes)
        return
    draw_differences(statics)
    draw_speeds(statics)


if __name__ == "__main__":
    main()
