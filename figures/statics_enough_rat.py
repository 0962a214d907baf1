"""Draw the figures of rats' whiskers in docs/when_statics_is_enough.md and print its numbers.

python figures/statics_enough_rat.py writes docs/statics_enough_whisking.png and statics_enough_damping.png. With
`--check`, it repeats the numbers with half the time step and with more shape functions, and draws nothing.
"""

import sys
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
DENSITY_OF_HAIR = 1300.0
RAT = jw.Whisker.rat("C", 2, density=DENSITY_OF_HAIR)
RATIO, LIGHT = 0.14, 0.01  # damping ratios: in the middle of the published range, and a small one
FREQUENCIES = np.array([2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0])  # Hz
AMPLITUDE = float(np.deg2rad(10.0))
CYCLES, PER_CYCLE = 4, 400  # the last cycle is evaluated
PUBLISHED = {"frequency": (27.0, 260.0), "ratio": (0.11, 0.17)}  # Hartmann et al. 2003
ARRAY = [(row, column) for row in "ABCDE" for column in range(5 if row in "AB" else 6)]


def rat_damping() -> tuple[float, float]:
    """First frequency in Hz, and the stiffness damping in s that gives its mode the damping ratio."""
    first = float(jw.modes(RAT, 3).frequency[0])
    return first, RATIO / (np.pi * first)


def whisk(
    scene: jw.Scene | jw.Sensor, offset: float, start: Any, steps: int, shapes: int, ratio: float = RATIO
) -> tuple[np.ndarray, ...]:
    """Time, drive angle and moment in the last cycle, for all frequencies."""
    first, _ = rat_damping()

    def one(frequency, damping):
        drive = jw.Whisking(AMPLITUDE, frequency, offset, -jnp.pi / 2)
        motion = jw.simulate(
            scene,
            drive,
            CYCLES / frequency,
            start=start,
            steps=steps,
            every=steps // (CYCLES * PER_CYCLE),
            stiffness_damping=damping,
            shapes=shapes,
        )
        return motion.time, motion.control, motion.mz[:, 0], motion.status

    *values, status = jax.vmap(one, (0, None))(jnp.asarray(FREQUENCIES), jnp.asarray(ratio / (np.pi * first)))
    print(f"  lost: {int(np.sum(np.asarray(status) != jw.Status.ok))} samples")
    return tuple(np.asarray(value)[:, -PER_CYCLE:] for value in values)


def whisking(steps: int, shapes: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Moment at the base of a whisking whisker in air over that at its strongest contact, and errors in contact."""
    print(f"c. {steps} steps, {shapes} shapes")
    length = float(RAT.length)
    scene = jw.Scene(RAT, jw.Circle(0.6 * length, 0.1 * length, -0.1 * length), motion=jw.Rotation())
    angles = np.deg2rad(np.linspace(-12.0, 24.0, 721))
    result = jw.scan(scene, angles)
    statics = np.asarray(result.mz)[:, 0]
    time, _, mz = whisk(jw.Sensor(RAT, motion=jw.Rotation()), 0.0, None, steps, shapes)
    turn = np.exp(-2j * np.pi * FREQUENCIES[:, None] * time)
    air = np.abs(2 * np.mean(mz * turn, axis=1))
    errors = {}
    kept = float(np.deg2rad(11.0))
    for name, offset, start, ratio in (
        ("touching each cycle", 0.0, None, RATIO),
        ("always in contact", kept, result, RATIO),
        ("light damping", kept, result, LIGHT),
    ):
        _, control, mz = whisk(scene, offset, start, steps, shapes, ratio)
        reference = np.interp(control, angles, statics)
        difference = (mz - reference) / np.abs(reference).max(axis=1, keepdims=True)
        errors[name] = np.sqrt(np.mean(difference**2, axis=1))
        errors[name + ", largest"] = np.abs(difference).max(axis=1)
    print("  air, N m:", " ".join(f"{value:.4e}" for value in air))
    for name, values in errors.items():
        print(f"  {name}:", " ".join(f"{value:.3e}" for value in values))
    return air, errors


def draw_whisking() -> None:
    """Inertial moment in air, and the error of statics in contact, over the frequency."""
    first, damping = rat_damping()
    air, errors = whisking(16_000, 12)
    s = np.linspace(0.0, float(RAT.length), 2001)
    assert callable(RAT.mass_per_length)
    inertia = np.trapezoid(np.asarray(jax.vmap(RAT.mass_per_length)(jnp.asarray(s))) * s**2, s)
    rigid = AMPLITUDE * (2 * np.pi * FREQUENCIES) ** 2 * inertia
    square = (FREQUENCIES / first) ** 2
    print(
        f"  f1 {first:.2f} Hz, damping {1e3 * damping:.3f} ms, inertia {inertia:.4e} kg m^2; air / rigid", air / rigid
    )
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    left.loglog(square, 1e6 * air, "o-", color=COLOURS[0], label="simulated")
    left.loglog(square, 1e6 * rigid, "k:", label="rigid whisker")
    left.set(ylabel="moment at the base in air (µN m)")
    for k, name in enumerate(("touching each cycle", "always in contact")):
        right.loglog(square, errors[name], "o-", color=COLOURS[k], label=name + ": rms")
        right.loglog(square, errors[name + ", largest"], "o--", color=COLOURS[k], markersize=3, label="largest")
    right.loglog(square, errors["light damping"], "s-", color=COLOURS[2], label="the same with damping ratio 0.01: rms")
    right.loglog(square, square, color="0.6", linestyle=":", label="(f / f1)²")
    right.set(ylabel="error of statics relative to the peak of mz", ylim=(5e-4, 10))
    for ax in (left, right):
        ax.set(xlabel="(f / f1)²; top: f (Hz)")
        top = ax.secondary_xaxis(
            "top", functions=(lambda x: first * np.sqrt(np.maximum(x, 0)), lambda f: (f / first) ** 2)
        )
        top.set_xticks(FREQUENCIES, [f"{f:g}" for f in FREQUENCIES])
        top.minorticks_off()
        ax.legend(fontsize=8)
    figure.savefig(DOCS / "statics_enough_whisking.png", dpi=150)
    pyplot.close(figure)


def draw_damping() -> None:
    """Damping ratios of the array for three laws of damping, and the published range."""
    print("d.")
    whiskers = [jw.Whisker.rat(row, column, density=DENSITY_OF_HAIR) for row, column in ARRAY]
    frequency = np.stack([np.asarray(jw.modes(whisker, 2).frequency) for whisker in whiskers])
    low, high = PUBLISHED["frequency"]
    middle = 2 * np.pi * np.sqrt(low * high)
    target = np.sqrt(np.prod(PUBLISHED["ratio"]))
    least = target / np.sqrt((np.sqrt(high / low) + np.sqrt(low / high)) / 2)
    laws = {
        "stiffness": (0.0, 2 * target / middle),
        "mass": (2 * target * middle, 0.0),
        "both": (least * middle, least / middle),
    }
    figure, ax = pyplot.subplots(figsize=(7, 4), layout="constrained")
    ax.fill_between((low, high), *PUBLISHED["ratio"], color="0.88", label="published range, first resonances")
    at = np.geomspace(20, 1000, 200)
    for colour, (name, (mass, stiffness)) in zip(COLOURS, laws.items(), strict=False):
        ratio = [
            (mass / (2 * np.pi * f) + stiffness * 2 * np.pi * f) / 2 for f in (frequency[:, 0], frequency[:, 1], at)
        ]
        inside = (frequency[:, 0] >= low) & (frequency[:, 0] <= high)
        ax.loglog(
            at,
            ratio[2],
            color=colour,
            linewidth=0.8,
            label=f"damping proportional to {name}" if name != "both" else "sum of both",
        )
        ax.loglog(frequency[:, 0], ratio[0], "o", color=colour, markersize=4)
        ax.loglog(frequency[:, 1], ratio[1], "o", color=colour, markersize=4, markerfacecolor="none")
        print(
            f"  {name}: mass_damping {mass:.1f} / s, stiffness_damping {1e3 * stiffness:.3f} ms;"
            f" inside the range of frequencies: first modes {ratio[0][inside].min():.3f} to"
            f" {ratio[0][inside].max():.3f},"
            f" second {ratio[1][inside].min():.3f} to {ratio[1][inside].max():.3f}"
        )
    print(
        f"  f2 / f1 {(frequency[:, 1] / frequency[:, 0]).min():.3f} to {(frequency[:, 1] / frequency[:, 0]).max():.3f}"
    )
    first = frequency[:, 0]
    print(f"  f1 {first.min():.1f} to {first.max():.1f} Hz; above the range: {(first > high).sum()}")
    ax.set(xlabel="frequency (Hz); filled: first modes, open: second modes", ylabel="damping ratio", ylim=(0.01, 2))
    ax.legend(fontsize=8)
    figure.savefig(DOCS / "statics_enough_damping.png", dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Draw both figures, or only print numbers at other discretisations."""
    if "--check" in sys.argv:
        for steps, shapes in ((32_000, 12), (16_000, 16)):
            whisking(steps, shapes)
        return
    draw_whisking()
    draw_damping()


if __name__ == "__main__":
    main()
