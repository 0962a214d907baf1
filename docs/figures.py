"""Draws docs/derivatives.png: what derivatives do beside a fold."""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

STIFFNESS = 70.0
HERE = Path(__file__).parent


def scanned(stiffness, control):
    return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness, 0.2)), control)


def main() -> None:
    fold = scanned(STIFFNESS, jnp.array([0.75, -1.5])).events[-1].control
    distance = np.geomspace(0.3, 1e-8, 200)
    along = jnp.asarray(np.sort(np.concatenate([np.linspace(0.75, -1.45, 500), fold + distance]))[::-1])

    def observed(stiffness):
        result = scanned(stiffness, along)
        return result.mz[:, 0], result.events.control[result.events.count - 1]

    by_moment, by_fold = (np.asarray(d) for d in jax.jacfwd(observed)(STIFFNESS))
    left = np.asarray(along) - fold
    canvas = Figure(figsize=(7, 3), layout="constrained")
    scan, near = canvas.subplots(1, 2)
    scan.plot(along, by_moment, color=COLOURS[0], linewidth=1.2)
    scan.set(ylim=(-0.01, 0.04), xlabel="$u/L$", ylabel=r"$\partial m_z/\partial c$ in $L^2$")
    scan.axvline(fold, color="0.5", linewidth=0.8, linestyle="--")
    scan.annotate("snap-off", (fold, 0.036), xytext=(4, 0), textcoords="offset points", fontsize=8, color="0.3")
    ahead = (left > 0) & (left < 0.3)
    near.loglog(
        left[ahead], np.abs(by_moment[ahead]), color=COLOURS[0], linewidth=1.2, label=r"$|\partial m_z/\partial c|$"
    )
    root = np.abs(by_moment[ahead][-1]) * np.sqrt(left[ahead][-1] / left[ahead])
    near.loglog(left[ahead], root, color="0.5", linewidth=0.8, linestyle=":", label=r"$\propto (u-u_s)^{-1/2}$")
    near.axhline(abs(by_fold), color=COLOURS[1], linewidth=1.2, label=r"$|\partial u_s/\partial c|$")
    near.set(xlabel="$(u - u_s)/L$: way to the snap-off")
    near.legend(fontsize=8, frameon=False)
    for ax in (scan, near):
        ax.grid(alpha=0.3)
    canvas.savefig(HERE / "derivatives.png", dpi=130)
    print(f"snap-off at u = {fold:.6f}, moves by {float(by_fold):.3e} per unit of stiffness")


if __name__ == "__main__":
    main()
