"""Accuracy of reconstructed contours: without noise, and with noise of 1 % of the peaks.

python benchmarks/reconstruct.py [--quick]

Signals come from the closed form. The error of a contour is its distance from the object along the normal, in L, at
101 slopes between the outermost knots of the fit. The knots are chosen from the first signals of each scene and lie
within the touched slopes.
"""

import time

import equinox as eqx
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import interleaved, quick, write

STEPS = 500
NOISE = 0.01  # of each channel's peak
KNOTS = 11
WHISKER_MM = 20.0  # scale of the column that compares with a published learned reconstruction (0.8 +- 0.5 mm)


class Polynomial(eqx.Module):
    """Asymmetric profile y = q + x^2/2 + x^3/8 + x^4/4."""

    q: float = 0.3

    def __call__(self, x):
        return self.q + x**2 / 2 + x**3 / 8 + x**4 / 4


class Edge(eqx.Module):
    """Wedge with an edge of radius 0.05: one branch of a hyperbola."""

    q: float = 0.3
    steep: float = 1.2
    radius: float = 0.05

    def __call__(self, x):
        size = self.radius * self.steep**2
        return self.q + jnp.sqrt(size**2 + (self.steep * x) ** 2) - size


FB, FBFBR = jw.Support.fb(70.0), jw.Support.fbfbr(70.0)
SCENES = {  # object, support, repetitions
    "parabola, clamped": (jw.Parabola(0.3), jw.Support(), 100),
    "parabola, FB": (jw.Parabola(0.3), FB, 500),
    "parabola, FBFBR": (jw.Parabola(0.3), FBFBR, 100),
    "circle, radius 0.5, FB": (jw.Circle(0.3, 0.5), FB, 60),
    "ellipse 0.8 x 0.5, FB": (jw.Ellipse(0.3, 0.8, 0.5), FB, 60),
    "polynomial of degree 4, FB": (jw.Graph(Polynomial()), FB, 60),
    "edge of radius 0.05, FB": (jw.Graph(Edge()), FB, 60),
}


def signals(profile, support) -> dict[str, np.ndarray]:
    """Exact signals and contact points."""
    scene = jw.Scene(jw.Whisker(), profile, support, rod=jw.ClosedForm())
    ends = np.asarray(jw.scan(scene).control)[[0, -1]]
    control = np.linspace(ends[0], ends[1], STEPS)
    result = jw.scan(scene, control)
    names = ("fx", "fy", "mz", "contact_x", "contact_y")
    return {"control": control} | {name: np.asarray(getattr(result, name)) for name in names}


def at_slopes(profile, slopes) -> tuple[np.ndarray, np.ndarray]:
    """Points of a profile at slope angles, interpolated on a fine grid (error 1e-9)."""
    low, high = (float(end) for end in profile.ends())
    grid = np.linspace(max(low, -3.0), min(high, 3.0), 20001)
    points = jax.vmap(profile.point)(jnp.asarray(grid))
    angle = np.arctan2(np.asarray(points.sin), np.asarray(points.cos))
    return tuple(np.interp(slopes, angle, np.asarray(v)) for v in (points.x, points.y))


def of_scene(name: str, count: int) -> dict:
    """Errors and coverage over all repetitions."""
    profile, support, _ = SCENES[name]
    sensor, exact, rng = jw.Sensor(jw.Whisker(), support), signals(profile, support), np.random.default_rng(0)
    clean = {n: exact[n] for n in ("control", "fx", "fy", "mz")}
    sigma = {n: NOISE * float(np.abs(clean[n]).max()) for n in ("fx", "fy", "mz")}
    points = jw.reconstruct(clean, sensor)
    touching = np.abs(clean["mz"]) > 0
    off = np.hypot(np.asarray(points.x) - exact["contact_x"], np.asarray(points.y) - exact["contact_y"])[touching]
    knots, errors, ratios, covered, bad, times, single = KNOTS, [], [], [], 0, [], []
    for _ in range(count):
        noisy = {n: v + (sigma[n] * rng.standard_normal(v.shape) if n in sigma else 0.0) for n, v in clean.items()}
        estimate = jw.reconstruct(noisy, sensor, sigma=sigma)
        apart = np.hypot(np.asarray(estimate.x) - exact["contact_x"], np.asarray(estimate.y) - exact["contact_y"])
        single.append(float(np.mean(apart[estimate.clear])))
        begin = time.perf_counter()
        fit = jw.fit_contour(noisy, sensor, sigma=sigma, knots=knots)
        times.append(time.perf_counter() - begin)
        knots = fit.profile.slopes
        if fit.fit.status != jw.FitStatus.ok:
            bad += 1
            continue
        band = fit.band()
        x, y = at_slopes(profile, band.slope)
        across = (band.x - x) * np.sin(band.slope) - (band.y - y) * np.cos(band.slope)
        errors.append(np.abs(across))
        ratios.append(across / band.error)
        covered.append(np.mean(np.abs(across) <= 1.959964 * band.error))
    repeat = interleaved({"points": lambda: jax.block_until_ready(jw.reconstruct(noisy, sensor, sigma=sigma).x)}, 9)
    return {
        "scene": name,
        "largest point error without noise": float(np.nanmax(off)),
        "points lost": int(np.sum(~np.isfinite(off))),
        "repetitions": count,
        "not ok": bad,
        "mean error of clear points": float(np.mean(single)),
        "mean contour error": float(np.mean(errors)),
        "95th percentile of contour error": float(np.quantile(np.mean(errors, axis=1), 0.95)),
        "coverage of the 95 % band": float(np.mean(covered)),
        "rms of error / standard error": float(np.sqrt(np.mean(np.square(ratios)))),
        f"mean contour error for L = {WHISKER_MM:g} mm, mm": float(np.mean(errors) * WHISKER_MM),
        "reconstruct, ms": 1e3 * repeat["points"]["median"],
        "fit_contour, s": float(np.median(times[1:])),
    }


def main() -> None:
    """Measure and store."""
    short = quick(__doc__)
    rows = []
    for name, (*_, count) in SCENES.items():
        rows.append(of_scene(name, 5 if short else count))
        write("reconstruct", rows)


if __name__ == "__main__":
    main()
