"""Whether friction has to be known: the effect of a wrong friction coefficient, and what reveals it.

python benchmarks/known_friction.py [--quick]     about three minutes on two cores

One whisker on a spring (FB, c = 70) before a parabola with a = 1 and q = 0.3; noise of 1 % of each channel's peak.
Results:

known_friction: errors of the contour and of fitted parameters for each assumed coefficient;
revealed_friction: standard errors from scans of equally many steps on different routes, with and without a known
coefficient.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import quick, write

TRUE = 0.3
ASSUMED = (0.3, 0.31, 0.35, 0.2, 0.0)
STEPS, NOISE = 512, 0.01
TRUTH = {"c": 70.0, "q": 0.3, "a": 1.0}


def build(c, q, a, friction):
    """One whisker on a spring before a parabola."""
    return jw.Scene(jw.Whisker(), jw.Parabola(q, a), jw.Support.fb(c), friction=friction)


def signals(control):
    """Exact signals, and their noise."""
    result = jw.scan(build(**TRUTH, friction=TRUE), control)
    assert np.all(np.asarray(result.status) == jw.Status.ok), result
    data = {name: np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")}
    return {"control": control} | data, {name: NOISE * float(np.abs(v).max()) for name, v in data.items()}


def off_parabola(points):
    """Distances of the clear points from the true parabola, in L."""
    x, y = (np.asarray(values)[points.clear] for values in (points.x, points.y))
    t = x  # Newton's method for the foot
    for _ in range(20):
        above = t**2 + TRUTH["q"] - y
        t = t - (t - x + 2 * t * above) / (1 + 2 * above + 4 * t**2)
    return np.hypot(t - x, t**2 + TRUTH["q"] - y)


def wrong(assumed, control):
    """Errors that an assumed coefficient causes."""
    data, sigma = signals(control)
    friction = assumed or None
    points = jw.reconstruct(data, jw.Sensor(jw.Whisker(), jw.Support.fb(TRUTH["c"]), friction=friction), sigma=sigma)
    off = 1e3 * off_parabola(points)
    fit = jw.identify(lambda c, q, a: build(c, q, a, friction), TRUTH, data, sigma=sigma, starts=0, near=True)
    rows = {f"{name} off by": fit.estimates[name] / value - 1 for name, value in TRUTH.items()}
    detected = fit.chi2 / fit.degrees
    return (
        {"assumed": assumed, "contour, mean": off.mean(), "contour, largest": off.max()}
        | rows
        | {"reduced chi^2 without noise": detected}
    )


def revealed(route, control):
    """Standard errors from one route of the drive."""
    _, sigma = signals(control)
    at = TRUTH | {"friction": TRUE}
    unknown = jw.information(build, at, sigma=sigma, control=control)
    known = unknown.known("friction").standard_error
    row = {"route": route, "friction": unknown.standard_error["friction"]}
    for name, value in TRUTH.items():
        row[f"{name}, friction known"] = known[name] / value
        row[f"{name}, unknown"] = unknown.standard_error[name] / value
    return row


def main() -> None:
    steps = 128 if quick("effect of a wrong friction coefficient") else STEPS
    whole = np.linspace(0.75, -1.4, steps)
    write("known_friction", [wrong(assumed, whole) for assumed in ASSUMED])
    half = steps // 2
    routes = {
        "whole scan": whole,
        "to the vertex": np.linspace(0.75, -0.6, steps),
        "beyond the vertex": np.linspace(-0.6, -1.4, steps),
        "to u = 0 and back": np.concatenate([np.linspace(0.75, 0.0, half), np.linspace(0.0, 0.75, steps - half)]),
        "to u = -0.6 and back": np.concatenate([np.linspace(0.75, -0.6, half), np.linspace(-0.6, 0.75, steps - half)]),
    }
    write("revealed_friction", [revealed(name, control) for name, control in routes.items()])


if __name__ == "__main__":
    main()
