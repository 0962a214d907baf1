"""Draw the figures that show results of examples: python figures/examples.py

Writes docs/scan.png, worked_example.png, worked_example_space.png, derivatives.png, information.png, contour.png and
film.gif.
"""

import contextlib
import re
import sys
import tempfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import jaxwhisker as jw
from jaxwhisker.plot import COLOURS

ROOT = Path(__file__).parents[1]
DOCS, EXAMPLES = ROOT / "docs", ROOT / "examples"
sys.path.append(str(EXAMPLES))

from make_measured import NOISE, STIFFNESS

FB_STIFFNESS = 70.0
DATA = EXAMPLES / "measured.csv"


def scan_fb(stiffness, control):
    """FB before a parabola."""
    return jw.scan(jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fb(stiffness, 0.2)), control)


def draw_overviews() -> None:
    """The output of `overview` for two coupled whiskers, and that of the code on the pages of worked examples."""
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0, 0.2))
    jw.plot.save(jw.plot.overview(jw.scan(scene)), DOCS / "scan.png", dpi=130)
    for name in ("worked_example", "worked_example_space"):
        names, page = {}, (DOCS / f"{name}.md").read_text("utf-8")
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for block in re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL):
                exec(block, names)
                if "figure" in names:
                    break
        jw.plot.save(names["figure"], DOCS / f"{name}.png", dpi=130)


def draw_derivatives() -> None:
    """Derivatives beside a fold: that of the moment diverges, that of the snap-off position does not."""
    fold = scan_fb(FB_STIFFNESS, jnp.array([0.75, -1.5])).events[-1].control
    distance = np.geomspace(0.3, 1e-8, 200)
    control = jnp.asarray(np.sort(np.concatenate([np.linspace(0.75, -1.45, 500), fold + distance]))[::-1])

    def moment_and_snap_off(stiffness):
        result = scan_fb(stiffness, control)
        return result.mz[:, 0], result.events.control[result.events.count - 1]

    by_moment, by_fold = (np.asarray(d) for d in jax.jacfwd(moment_and_snap_off)(FB_STIFFNESS))
    left = np.asarray(control) - fold
    figure, (scan, near) = pyplot.subplots(1, 2, figsize=(7, 3), layout="constrained")
    scan.plot(control, by_moment, color=COLOURS[0], linewidth=1.2)
    scan.set(ylim=(-0.01, 0.04), xlabel="$u/L$", ylabel=r"$\partial m_z/\partial c$ in $L^2$")
    scan.axvline(fold, color="0.5", linewidth=0.8, linestyle="--")
    scan.annotate("snap-off", (fold, 0.036), xytext=(4, 0), textcoords="offset points", fontsize=8, color="0.3")
    ahead = (left > 0) & (left < 0.3)
    moment = np.abs(by_moment[ahead])
    near.loglog(left[ahead], moment, color=COLOURS[0], linewidth=1.2, label=r"$|\partial m_z/\partial c|$")
    root = moment[-1] * np.sqrt(left[ahead][-1] / left[ahead])
    near.loglog(left[ahead], root, color="0.5", linewidth=0.8, linestyle=":", label=r"$\propto (u-u_s)^{-1/2}$")
    near.axhline(abs(by_fold), color=COLOURS[1], linewidth=1.2, label=r"$|\partial u_s/\partial c|$")
    near.set(xlabel="distance to the snap-off, $(u - u_s)/L$")
    near.legend(fontsize=8, frameon=False)
    for ax in (scan, near):
        ax.grid(alpha=0.3)
    figure.savefig(DOCS / "derivatives.png", dpi=130)
    print(f"snap-off at u = {fold:.6f}, derivative with respect to the stiffness {float(by_fold):.3e}")


def build(c1, c2, c3, q):
    """Scene of the example data."""
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fbfbr((c1, c2, c3)))


def draw_information() -> None:
    """Information about each parameter along the scan."""
    c1, c2, c3 = STIFFNESS
    figure, ax = pyplot.subplots(figsize=(5, 2.8), layout="constrained")
    jw.plot.information(jw.information(build, {"c1": c1, "c2": c2, "c3": c3, "q": 0.3}, sigma=NOISE), ax=ax).set_xlabel(
        "$u/L$"
    )
    figure.savefig(DOCS / "information.png", dpi=130)


def draw_contour() -> None:
    """Single points, and the contour that is fitted to all signals."""
    sensor = jw.Sensor(jw.Whisker(), jw.Support.fbfbr(STIFFNESS))
    points = jw.reconstruct(DATA, sensor, sigma=NOISE)
    fit = jw.fit_contour(DATA, sensor, sigma=NOISE)
    print(fit)
    figure, axs = pyplot.subplots(1, 2, figsize=(7.2, 3.4), sharex=True, sharey=True, layout="constrained")
    jw.plot.contour(points, profile=jw.Parabola(0.3), ax=axs[0])
    jw.plot.contour(fit, profile=jw.Parabola(0.3), ax=axs[1])
    axs[0].set(xlabel="$x/L$", ylabel="$y/L$", title="single points")
    axs[1].set(xlabel="$x/L$", ylabel="", title="convex contour fitted to all signals")
    for ax in axs:
        ax.title.set_fontsize(9)
        ax.legend(frameon=False, fontsize=8)
    figure.savefig(DOCS / "contour.png", dpi=130)


def draw_film() -> None:
    """Two coupled whiskers pass a parabola and snap off one after the other."""
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0, 0.2), rod=jw.ClosedForm())
    path = jw.animate(jw.scan(scene), DOCS / "film.gif", seconds=7.5, fps=20, width=760)
    assert isinstance(path, Path)
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    """Draw all figures."""
    for draw in (draw_overviews, draw_derivatives, draw_information, draw_contour, draw_film):
        draw()


if __name__ == "__main__":
    main()
