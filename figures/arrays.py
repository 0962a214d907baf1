"""The figure of docs/arrays.md: the right side of a rat whisks against a peg.

python figures/arrays.py writes docs/arrays_rat.png.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patches import Circle

import jaxwhisker as jw

DOCS = Path(__file__).parents[1] / "docs"
MM, UN = 1e3, 1e6
SHOWN = 0.6  # protraction of the picture, rad
RADIUS, X, Y = 5e-3, -0.025, 0.025  # of the peg, m


def main() -> None:
    """Draw the whiskers from above, and their forces over the protraction."""
    array, control = jw.Array.rat(["right"]), np.linspace(0.0, 1.0, 201)
    peg = jw.Cylinder(RADIUS, (X, Y, 0.0), (0.0, 0.0, 1.0))
    results = [jw.scan(array.scene(name, peg), control) for name in array.names]
    force = UN * np.array([np.asarray(result.contact_force[:, 0]) for result in results])
    norm = LogNorm(0.1, np.nanmax(force))
    figure, (above, over) = plt.subplots(1, 2, figsize=(11, 5.2), layout="constrained", width_ratios=(1, 1.25))
    above.add_patch(Circle((MM * X, MM * Y), MM * RADIUS, color="0.8"))
    step = int(np.argmin(np.abs(control - SHOWN)))
    for result, sizes in zip(results, force, strict=True):
        line = jw.shapes(result, [SHOWN], points=80)
        colour = plt.cm.viridis(norm(sizes[step])) if sizes[step] > 0 else "0.75"
        above.plot(MM * line.x[0, 0], MM * line.y[0, 0], color=colour, linewidth=1.6 if sizes[step] > 0 else 1.0)
    above.set(
        xlabel="$x$, mm (the snout is on the left)",
        ylabel="$y$, mm",
        aspect="equal",
        title=f"{np.degrees(SHOWN):.0f}° from rest, seen from above",
    )
    edges = np.degrees(np.append(control, 2 * control[-1] - control[-2]))
    grey = plt.get_cmap("viridis").with_extremes(bad="0.93", under="0.93")
    image = over.pcolormesh(edges, np.arange(len(array) + 1), np.where(force > 0, force, np.nan), norm=norm, cmap=grey)
    for k, result in enumerate(results):
        for event in result.events.of(jw.EventKind.touch):
            over.plot(np.degrees(event.control), k + 0.5, "|", color="black", markersize=9)
        if np.any(result.status > 0):  # where the scan ends
            over.plot(np.degrees(control[np.argmax(result.status > 0)]), k + 0.5, "x", color="tab:red", markersize=5)
    over.set(
        xlabel="protraction $u$ from rest, degrees",
        yticks=np.arange(len(array)) + 0.5,
        title="contact force and first touch (black), end of a scan (red)",
    )
    over.set_yticklabels(array.names, fontsize=7)
    over.invert_yaxis()
    figure.colorbar(image, ax=over, label="contact force, µN")
    figure.savefig(DOCS / "arrays_rat.png", dpi=110)


if __name__ == "__main__":
    main()
