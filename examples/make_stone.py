"""Make stone.csv: what a steel wire on a spring might have recorded as it was dragged past a stone, in SI units.

python examples/make_stone.py

The wire is 60 mm long and 0.2 mm thick (E = 210 GPa), its spring has 5 N/m and the rest length 12 mm; the stone is an
ellipse, half axes 60 mm and 40 mm, turned by 0.3 rad. Control in m, forces in N, moment in N m. Noise is normal,
independent from value to value, with 1 % of each channel's peak.
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
SHARE = 0.01  # of noise


def columns() -> dict[str, np.ndarray]:
    """Control and signals by name."""
    scene = jw.Scene(WIRE, STONE, SUPPORT, rod=jw.ClosedForm())
    result, rng = jw.scan(scene, CONTROL), np.random.default_rng(7)
    exact = {name: np.asarray(getattr(result, name))[:, 0] for name in ("fx", "fy", "mz")}
    noise = {name: SHARE * np.abs(v).max() * rng.standard_normal(v.size) for name, v in exact.items()}
    return {"control": CONTROL} | {name: v + noise[name] for name, v in exact.items()}


def write(path: Path) -> None:
    """Write them as CSV."""
    found = columns()
    header = "# one whisker on a spring before a stone; control in m, forces in N, moment in N m\n"
    np.savetxt(path, np.column_stack(list(found.values())), "%.6g", ",", header=header + ",".join(found), comments="")


if __name__ == "__main__":
    write(Path(__file__).parent / "stone.csv")
