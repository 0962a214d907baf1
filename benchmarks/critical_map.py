"""Critical stiffness over object distance: bracketed by 4,096 scans and compared with the exact curve.

python benchmarks/critical_map.py

FB snaps through the vertex if its spring is softer than the slope of the clamped whisker's force,
c < max dF_x/dx0 before the vertex. Four studies of 16 stiffnesses at each of 64 distances narrow the bracket
from a factor of ten to 3e-5. The exact slopes come from the elliptic integrals in tests/exact.py, which share
no code with the package.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib as mpl
import numpy as np
from scipy.optimize import minimize_scalar

import jaxwhisker as jw
from common import write

# isort: split
# After common, which puts the oracles on the search path.
from exact import clamped_branch, parabola

mpl.use("Agg")
from matplotlib import pyplot

ROOT = Path(__file__).parents[1]

PICTURE = ROOT / "docs" / "critical_map.png"
DISTANCES = np.linspace(0.05, 0.6, 64)
ROUNDS, STIFFNESSES = 4, 16
BRACKET = 0.4, 4.0  # of c q^2, the same for all distances
CONTROL = np.array([1.2, -20.0])  # from before the first touch to after the last event
TOLERANCE = 1e-4  # relative


def build(stiffness, distance):
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness, 0.0))


def snaps(stiffness: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Whether each scan snaps before it passes the vertex; failed scans count as snapping."""
    points = {"stiffness": stiffness.ravel(), "distance": distance.ravel()}
    data = jw.study(build, points=points, control=CONTROL, outputs=("events",))
    kind = data.event_kind.values
    end = (kind == jw.EventKind.vertex) | (kind >= jw.EventKind.snap_through)
    first = np.take_along_axis(kind, np.argmax(end, axis=1)[:, None], axis=1)
    return (first != jw.EventKind.vertex).reshape(stiffness.shape)


def brackets(distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffest spring with which a scan snaps before the vertex, and the next stiffer one that was tried."""
    low, high = (np.full(distance.size, end) / distance**2 for end in BRACKET)
    for _ in range(ROUNDS):
        grid = np.geomspace(low, high, STIFFNESSES + 2, axis=1)
        softer = snaps(grid[:, 1:-1], np.broadcast_to(distance[:, None], (distance.size, STIFFNESSES)))
        stiffest = (np.arange(1, STIFFNESSES + 1) * softer).max(axis=1)[:, None]
        low, high = (np.take_along_axis(grid, stiffest + k, axis=1)[:, 0] for k in (0, 1))
    return low, high


def steepest(distance: float) -> float:
    """Largest dF_x/dx0 of the clamped whisker from first touch to vertex, on either side of phase changes."""
    branch = clamped_branch(parabola(float(distance)))
    borders = [*branch.borders[branch.borders <= 1.0], 1.0]
    best = -np.inf
    for piece, low, high in zip(branch.pieces, borders, borders[1:], strict=False):

        def slope(p, piece=piece):
            _, _, dx, dforce = piece(p)
            return dforce / dx

        p = np.linspace(low, high, 201)
        k = int(np.argmax([slope(at) for at in p]))
        bounds = p[max(k - 1, 0)], p[min(k + 1, 200)]
        near = float(minimize_scalar(lambda at: -slope(at), bounds=bounds, method="bounded").x)  # pyright: ignore
        best = max(best, slope(p[k]), slope(near))
    return best


def draw(fine: np.ndarray, curve: np.ndarray, middle: np.ndarray, width: np.ndarray, difference: np.ndarray) -> None:
    """Draw the map and its difference to the exact curve."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    left.plot(fine, curve, color="black", linewidth=1, label=r"exact: max $dF_x/dx_0$ before the vertex")
    left.plot(
        DISTANCES, middle, ".", color="#0072B2", markersize=5, label="scans: softer springs snap before the vertex"
    )
    left.set_ylabel(r"critical stiffness $c\,L^3/EI$")
    right.plot(DISTANCES, np.abs(difference), ".", color="#0072B2", label="middle of the bracket, difference to exact")
    right.plot(DISTANCES, width, color="#D55E00", label="half width of the bracket")
    right.axhline(TOLERANCE, color="black", linestyle="--", linewidth=0.8, label="tolerance")
    right.set_ylabel("relative difference")
    for ax in (left, right):
        ax.set_xlabel(r"object distance $q/L$")
        ax.set_yscale("log")
        ax.grid(alpha=0.3, which="both")
        ax.legend(fontsize=9)
    figure.savefig(PICTURE, dpi=130)


def main() -> None:
    """Measure, draw and store."""
    low, high = brackets(DISTANCES)
    middle, width = (low + high) / 2, (high - low) / (high + low)
    exact = np.array([steepest(q) for q in DISTANCES])
    difference = middle / exact - 1
    print(f"largest relative difference {np.abs(difference).max():.2e}, half width {width.max():.2e}")
    fine = np.linspace(DISTANCES[0], DISTANCES[-1], 551)
    draw(fine, np.array([steepest(q) for q in fine]), middle, width, difference)
    columns = {"q": DISTANCES, "low": low, "high": high, "exact": exact, "relative difference": difference}
    write(
        "critical_map",
        [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)],
    )
    assert np.abs(difference).max() < TOLERANCE


if __name__ == "__main__":
    main()
