"""Effect of springs along all axes, taper, curvature and rotation on the signals: peaks, widths, first snap.

python benchmarks/settings.py     a few minutes on two cores
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import without, write

INF = np.inf
DISTANCE = 0.2
PARABOLA = jw.Parabola(DISTANCE)
SHIFT = 0.05  # rest length or angle of the last row of each setting
SAMPLES = 160  # stored samples of each curve in the figures


def on(whisker=None, motion=None, **springs):
    """Scene with one whisker on a spring along every axis; rest=(x, y, phi)."""
    rest = springs.pop("rest", (0.0, 0.0, 0.0))
    values = [springs.get(axis, INF) for axis in ("x", "y", "phi")]
    own = tuple(jw.Spring((0, 1), c, r, axis) for c, r, axis in zip(values, rest, ("x", "y", "phi"), strict=True))
    return jw.Scene(whisker or jw.Whisker(), PARABOLA, jw.Support(own), motion=motion or jw.Translation())


def cone(s):
    """Bending stiffness of a cone with a diameter ratio of 2:1."""
    return (1 - 0.5 * s) ** 4


WHEEL = jw.Rotation((0.0, -1.0), 1.0)  # about a pivot one length below the bases
SETTINGS = {
    "springs across (thesis)": ("x", (70.0, 100.0, 200.0, INF), {}),
    "springs along": ("y", (200.0, 500.0, 2000.0, INF), {}),
    "torsion springs": ("phi", (5.0, 10.0, 30.0, INF), {}),
    "a cone 2:1, across": ("x", (70.0, 100.0, 200.0, INF), {"whisker": jw.Whisker(1.0, cone)}),
    "curved forwards by 0.5, across": ("x", (70.0, 100.0, 200.0, INF), {"whisker": jw.Whisker(1.0, 1.0, 0.5)}),
    "curved backwards by 0.5, across": ("x", (70.0, 100.0, 200.0, INF), {"whisker": jw.Whisker(1.0, 1.0, -0.5)}),
    "rotation, across": ("x", (70.0, 100.0, 200.0, INF), {"motion": WHEEL}),
    "rotation, torsion": ("phi", (5.0, 10.0, 30.0, INF), {"motion": WHEEL}),
}


def measured(scene):
    """Peaks, full width of mz at half maximum, first snap, and the curve."""
    result = jw.scan(scene)
    assert np.all(np.asarray(result.status) == jw.Status.ok), result
    u = np.asarray(result.control)
    fx, fy, mz = (np.asarray(getattr(result, name))[:, 0] for name in ("fx", "fy", "mz"))
    over = np.flatnonzero(mz > mz.max() / 2)
    snaps = [e for e in result.events if e.kind in (jw.EventKind.snap_off, jw.EventKind.snap_through)]
    some = np.linspace(0, u.size - 1, SAMPLES).astype(int)
    return {
        "peak fx": float(np.abs(fx).max()),
        "peak fy": float(fy.max()),
        "peak mz": float(mz.max()),
        "peak mz at": float(u[mz.argmax()]),
        "width of mz": float(abs(u[over[-1]] - u[over[0]])),
        "first snap": f"{snaps[0].kind.name.replace('_', '-')} at {snaps[0].control:.3f}" if snaps else "none",
        "curve": [np.round(column[some], 4).tolist() for column in (u, fx, fy, mz)],
    }


def main() -> None:
    """Measure and store."""
    rows = []
    for setting, (axis, values, rest) in SETTINGS.items():
        for value in values:
            row = {"setting": setting, "axis": axis, "stiffness": "inf" if np.isinf(value) else value}
            rows.append(row | {"rest": 0.0} | measured(on(**{axis: value}, **rest)))
            print(without(rows[-1], "curve"), flush=True)
        shifted = tuple(SHIFT if name == axis else 0.0 for name in ("x", "y", "phi"))
        stiff = values[1]
        row = {"setting": setting, "axis": axis, "stiffness": stiff, "rest": SHIFT}
        rows.append(row | without(measured(on(**{axis: stiff}, rest=shifted, **rest)), "curve"))
    write("settings", rows)


if __name__ == "__main__":
    main()
