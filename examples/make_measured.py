"""Simulate measured.csv, noisy signals of two whiskers with feedback (FBFBR).

python examples/make_measured.py

Springs of stiffness 60, 80 and 70 EI/L^3, rest lengths 0.2, 0.2 and 0.4 L, a parabola y = 0.3 + x^2. Forces are in
EI/L^2, moments in EI/L, lengths in L. The noise is normal and independent, with standard deviations of 0.05 (fx), 0.1
(fy) and 0.045 (mz), about 1 % of the peaks. The signals come from the closed form; fits integrate rods.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw

STIFFNESS = (60.0, 80.0, 70.0)
NOISE = {"fx": 0.05, "fy": 0.1, "mz": 0.045}
CONTROL = np.linspace(0.65, -1.55, 441)  # steps of 0.005


def columns() -> dict[str, np.ndarray]:
    """Control and noisy signals by column name."""
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support.fbfbr(STIFFNESS), rod=jw.ClosedForm())
    result, rng = jw.scan(scene, CONTROL), np.random.default_rng(20)
    data = {"control": CONTROL}
    for k in range(2):
        for name, sigma in NOISE.items():
            exact = np.asarray(getattr(result, name))[:, k]
            data[f"{name}_{k + 1}"] = exact + sigma * rng.standard_normal(CONTROL.size)
    return data


def write(path: Path) -> None:
    """Write the CSV file."""
    data = columns()
    header = "# two whiskers with feedback before a parabola; lengths in L, forces in EI/L^2, moments in EI/L\n"
    np.savetxt(path, np.column_stack(list(data.values())), "%.6g", ",", header=header + ",".join(data), comments="")


if __name__ == "__main__":
    write(Path(__file__).parent / "measured.csv")
