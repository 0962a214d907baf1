"""Draw the figure of docs/shaft_springs.md and print its tables: python figures/shaft_springs.py

Writes docs/shaft_springs.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS, axis_label

DOCS = Path(__file__).parents[1] / "docs"
CONTROL = jnp.linspace(0.8, -1.5, 1151)
HEIGHTS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
STIFFNESSES = (70.0, 100.0, 200.0, 1000.0)
PEAKS = ("fy", "mz")
LENGTH, STIFFNESS = 0.0331, 6.3e-8  # of a rat's whisker C2: m; N m^2 at the base
PUBLISHED = {
    "Simony et al., small angles": jw.Support.simony(),
    "Simony et al., large angles": jw.Support.simony(large_angles=True),
    "Hill et al., one follicle": jw.Support.hill(),
}
EDGES = {"linewidth": 0.8, "color": "0.6", "linestyle": ":"}


def scene(height, stiffness) -> jw.Scene:
    """A whisker that slides along x, held by an axial spring at this height above its base."""
    spring = jw.Spring((0, 1), stiffness, 0.2, axis="axial", at=height)
    return jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support((spring,)))


@jax.jit
def signals(heights, stiffnesses):
    """The signals that the shaft carries at its base, without the force of the spring; (scans, steps)."""

    def one(numbers):
        result = jw.scan(scene(*numbers), CONTROL)
        return {name: getattr(result, name)[:, 0] for name in PEAKS}

    return jax.lax.map(one, (heights, stiffnesses))


def stiffness_at_skin(support: jw.Support) -> np.ndarray:
    """Stiffness of the base against (x, y, angle) in the frame of the pad, in the units of a rat's whisker C2."""

    def energy(pose):
        total, mount = 0.0, support.mounts[0]
        for spring in support.springs:
            at, angle = 0.0 if spring.at is None else spring.at, mount.angle + pose[2]
            end = pose[:2] + at * jnp.stack([-jnp.sin(angle), jnp.cos(angle)])
            rest = at * jnp.stack([-jnp.sin(mount.angle), jnp.cos(mount.angle)])
            if spring.axis == "axial":
                stretch = jnp.linalg.norm(end - jnp.asarray(spring.anchor)) - spring.rest_length
            else:
                stretch = (end - rest)["xy".index(spring.axis)]
            total += spring.stiffness * stretch**2 / 2
        return total

    length, stiffness = LENGTH, STIFFNESS
    unit = np.array([length, length, 1.0])
    return np.asarray(jax.hessian(energy)(jnp.zeros(3))) * np.outer(unit, unit) * length / stiffness


def main() -> None:
    """Draw the figure and print the tables."""
    heights, stiffnesses = map(np.ravel, np.meshgrid(HEIGHTS, STIFFNESSES, indexing="ij"))
    found = {name: np.asarray(value) for name, value in signals(jnp.array(heights), jnp.array(stiffnesses)).items()}
    shape = len(HEIGHTS), len(STIFFNESSES)
    peaks = {name: np.nanmax(values, axis=1).reshape(shape) for name, values in found.items()}
    for name, table in peaks.items():
        print(name)
        for height, row in zip(HEIGHTS, table, strict=True):
            print(f"| {height} | " + " | ".join(f"{value:.4f}" for value in row) + " |")
    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    control = np.asarray(CONTROL)
    for height, colour in zip((0.0, 0.1, 0.2), COLOURS, strict=False):
        k = HEIGHTS.index(height) * shape[1]
        axes[0].plot(control, found["mz"][k], color=colour, label=f"h = {height:g} L")
    axes[0].set(xlabel="$u/L$", ylabel=axis_label("mz"), title="spring of stiffness 70 at height h")
    axes[0].invert_xaxis()
    axes[0].legend(frameon=False)
    for k, (stiffness, colour) in enumerate(zip(STIFFNESSES, COLOURS, strict=False)):
        axes[1].plot(HEIGHTS, peaks["mz"][:, k], "o-", markersize=3, color=colour, label=f"c = {stiffness:g}")
    axes[1].axhline(peaks["mz"][0, 0], **EDGES)
    axes[1].set(xlabel="height of the spring, $h/L$", ylabel="largest " + axis_label("mz"))
    axes[1].legend(frameon=False)
    jw.plot.save(figure, DOCS / "shaft_springs.png")
    for name, support in PUBLISHED.items():
        matrix = stiffness_at_skin(support)
        numbers = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], matrix[2, 2]]
        print(f"| {name} | " + " | ".join(f"{value:,.3g}" for value in numbers) + " |")


if __name__ == "__main__":
    main()
