"""Simulate stone.csv, noisy signals of a steel wire on a spring that is dragged past a stone, in SI units.

python examples/make_stone.py

The wire is 60 mm long and 0.2 mm thick (E = 210 GPa). Its spring has a stiffness of 5 N/m and a rest length of 12 mm.
The stone is an ellipse with half axes of 60 mm and 40 mm, rotated by 0.3 rad. The control is in m, forces in N, the
moment in N m. The noise is normal and independent, with a standard deviation of 1 % of each channel's peak.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw

WIRE = jw.Whisker.from_material(length=0.06, youngs_modulus=210e9, diameter=0.2e-3)
SUPPORT = jw.Support.fb(5.0, rest_length=0.012)
STONE = jw.Tilted(jw.Ellipse(0.02, 0.06, 0.04), 0.3, about=(0.0, 0.06))
CONTROL = np.linspace(0.07, -0.11, 721)  # steps of 0.25 mm
NOISE = 0.01  # of each channel's peak


def columns() -> dict[str, np.ndarray]:
    """Control and noisy signals by column name."""
    scene = jw.Scene(WIRE, STONE, SUPPORT, rod=jw.ClosedForm())
    result, rng = jw.scan(scene, CONTROL), np.random.default_rng(7)
    exact = {name: np.asarray(getattr(result, name))[:, 0] for name in ("fx", "fy", "mz")}
    noise = {name: NOISE * np.abs(v).max() * rng.standard_normal(v.size) for name, v in exact.items()}
    return {"control": CONTROL} | {name: v + noise[name] for name, v in exact.items()}


def write(path: Path) -> None:
    """Write the CSV file."""
    data = columns()
    header = "# one whisker on a spring before a stone; control in m, forces in N, moment in N m\n"
    np.savetxt(path, np.column_stack(list(data.values())), "%.6g", ",", header=header + ",".join(data), comments="")


if __name__ == "__main__":
    write(Path(__file__).parent / "stone.csv")
