"""Which parameters have to be known: stiffness, rest length, object distance, shape or position.

python benchmarks/known.py [--quick]     about ten minutes on two cores

The thesis's networks with c = 70 and rest lengths of 0.2 (feedback: the sum) before a parabola with a = 1 and q = 0.3;
noise of 1 % of each channel's peak, 512 positions over the contact. Results:

known_subsets: standard errors of the unknown parameters for every subset of known ones, from the Fisher information;
known_errors: contour error caused by a wrong parameter of the sensor, and whether it would be detected;
known_networks: effect of feedback, more whiskers and softer springs.
"""

from functools import lru_cache
from itertools import combinations, pairwise
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import quick, write
from jaxwhisker._inverse.statistics import INVOLVED, RELATIVE_ZERO

NETWORKS = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "three whiskers": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}
REST, DISTANCE, CURVATURE, STIFFNESS = 0.2, 0.3, 1.0, 70.0
SOFTNESS = (40.0, 70.0, 200.0, 1000.0)
STEPS, NOISE = 512, 0.01
KNOTS = tuple(np.linspace(-0.7, 1.0, 9).round(12).tolist())  # touched slopes of a contour of any shape
ALONG = np.linspace(-0.6, 1.0, 65)  # slopes at which the error of that contour is evaluated
WRONG, TURNED = 0.01, np.deg2rad(1.0)  # relative error of a parameter, error of the mount angle
SCANS = 20  # noisy scans, for the scatter of the reduced chi^2
DETECTED = 3.0  # standard deviations
RESOLVED = 0.1  # standard deviations: smallest resolved increase, small because both scans share their noise
EXACT = 1e-6  # largest error in L of points from exact signals and the right sensor
SAMPLES = 40  # stored points of each curve in the figure
GROUPS = ("stiffness", "rest length", "distance", "shape", "position")


class Before(NamedTuple):
    """Build a network before a parabola, or before a contour of any shape."""

    model: str
    any_shape: bool = False

    def sensor(self, values, angle=None):
        """Sensor from named parameters; `angle` turns all mounts."""
        ends = NETWORKS[self.model]
        springs = tuple(jw.Spring(e, values[f"c{k + 1}"], values[f"l{k + 1}"]) for k, e in enumerate(ends))
        mount = None if angle is None else jw.Mount(angle=angle)
        return jw.Sensor(jw.Whisker(values["L"], values["EI"]), jw.Support(springs, mount))

    def __call__(self, **values):
        known = self.sensor(values)
        if self.any_shape:
            radii = [jnp.asarray(values[f"radius_{k}"], dtype=float) for k in range(len(KNOTS))]
            profile = jw.Contour(values["q"], jnp.log(jnp.stack(radii)), KNOTS, values["x"])
        else:
            profile = jw.Parabola(values["q"], values["a"], values["x"])
        return jw.Scene(known.whisker, profile, known.support, rod=jw.ClosedForm())

    def truth(self, stiffness=STIFFNESS):
        """True values of all parameters."""
        ends = NETWORKS[self.model]
        values = {f"c{k + 1}": stiffness for k in range(len(ends))}
        values |= {f"l{k + 1}": REST * (b - a) for k, (a, b) in enumerate(ends)}
        values |= {"EI": 1.0, "L": 1.0, "q": DISTANCE, "x": 0.0}
        if not self.any_shape:
            return values | {"a": CURVATURE}
        like = jw.Contour.like(jw.Parabola(DISTANCE, CURVATURE), KNOTS)
        return values | {f"radius_{k}": float(np.exp(r)) for k, r in enumerate(like.log_radius)}

    def places(self, values):
        """Derivative of the rest positions of the bases with respect to the parameters, (whiskers, parameters)."""

        def at(x):
            flexibility = self.sensor(dict(zip(values, x, strict=True))).support.flexibility()
            assert flexibility is not None  # there are springs
            return flexibility.offset

        return np.asarray(jax.jacfwd(at)(jnp.array(list(values.values()))))


def group(name):
    """Group of a parameter."""
    if name in ("EI", "L"):
        return "whisker"
    return {"c": "stiffness", "l": "rest length", "q": "distance", "x": "position"}.get(name[0], "shape")


def signals(model, stiffness=STIFFNESS):
    """Exact signals at 512 positions over the contact, their noise, and the number of snap-throughs."""
    build = Before(model)
    scene = build(**build.truth(stiffness))
    ends = np.asarray(jw.scan(scene).control)[[0, -1]]
    result = jw.scan(scene, np.linspace(ends[0], ends[1], STEPS))
    assert np.all(np.asarray(result.status) == jw.Status.ok), result
    data = {name: np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")}
    sigma = {name: NOISE * float(np.abs(values).max()) for name, values in data.items()}
    snaps = sum(e.kind == jw.EventKind.snap_through for e in result.events)
    return {"control": np.asarray(result.control)} | data, sigma, snaps


def informed(build, data, sigma, stiffness=STIFFNESS):
    """Fisher information about all parameters."""
    return jw.information(build, build.truth(stiffness), sigma=sigma, control=data["control"])


def standard_error(information, along):
    """Standard errors of combinations of parameters, (..., parameters); NaN if not identifiable."""
    scale = np.array([abs(v) or 1.0 for v in information.at.values()])
    _, singular, directions = np.linalg.svd(np.linalg.qr(information.jacobian * scale, mode="r"))
    part = (along * scale) @ directions.T
    null = singular <= RELATIVE_ZERO * singular[0]
    hidden = np.linalg.norm(part[..., null], axis=-1) > INVOLVED * np.linalg.norm(part, axis=-1)
    error = np.linalg.norm(part[..., ~null] / singular[~null], axis=-1)
    return np.where(hidden, np.nan, error)


def worst(information, kind, relative=True):
    """Largest standard error in a group of parameters; None if the group is known."""
    values = information.at
    own = [k for k, name in enumerate(values) if group(name) == kind]
    size = [abs(list(values.values())[k]) if relative else 1.0 for k in own]
    return float(np.max(standard_error(information, np.eye(len(values))[own]) / size)) if own else None


@lru_cache
def across():
    """Derivative of the contour along its normal with respect to its parameters except x, (slopes, parameters)."""
    names = ["q", *(f"radius_{k}" for k in range(len(KNOTS)))]
    truth = Before("FB", True).truth()

    @jax.jit
    def normal(values):
        points = jax.vmap(jw.Contour(values[0], jnp.log(values[1:]), KNOTS).point)(jnp.asarray(ALONG))
        return points.x * jnp.sin(ALONG) - points.y * jnp.cos(ALONG)

    return names, np.asarray(jax.jacfwd(normal)(jnp.array([truth[name] for name in names])))


def contour_error(information):
    """Largest standard error of the contour along its normal, for slopes from -0.6 to 1, in L."""
    names, by = across()
    rows = np.zeros((len(ALONG), len(information.names)))
    for k, name in enumerate(information.names):
        if name in names:
            rows[:, k] = by[:, names.index(name)]
    return float(np.max(standard_error(information, rows)))


def subsets(model, information, any_shape):
    """One row for every subset of known groups; the whisker is known in all rows but the first."""
    build, rows = Before(model, any_shape), []
    known_sets = [set(known) for n in range(len(GROUPS)) for known in combinations(GROUPS, n)]
    for known in [{"no whisker"}, *known_sets]:
        if any_shape and "shape" in known:
            continue  # known shapes are in the rows of the parabola
        drop = [name for name in information.names if group(name) in known | {"whisker"} - {"no whisker"}]
        if known == {"no whisker"}:
            drop = []
        left = information.known(*drop) if drop else information
        names = list(left.names)
        row = {
            "scene": model,
            "shape": "any" if any_shape else "parabola",
            "known": [g for g in GROUPS if g in known] + (["whisker"] if drop else []),
            "unknown": [g for g in (*GROUPS, "whisker") if any(group(name) == g for name in names)],
            "number": len(names),
            "rank": left.rank,
            "condition": left.condition if left.rank == len(names) else None,
            "stiffness": worst(left, "stiffness"),
            "rest length": worst(left, "rest length", relative=False),
            "distance": worst(left, "distance"),
            "curvature": None if any_shape else worst(left, "shape"),
            "contour": contour_error(left) if any_shape else None,
            "position": worst(left, "position", relative=False),
            "whisker": worst(left, "whisker"),
            "not identifiable": list(left.combinations),
        }
        if "rest length" not in known:
            pick = [list(build.truth()).index(name) for name in names]
            places = build.places(build.truth())[:, pick]
            row["position of base 1"] = float(standard_error(left, places[0]))
            spacing = [float(standard_error(left, b - a)) for a, b in pairwise(places)]
            row["spacing of bases"] = max(spacing, default=None)
            row |= null_space(left, places)
        rows.append(row)
    return rows


def null_space(information, places):
    """Numbers of unidentifiable combinations: springs that pre-strain each other, and shifts of the whole scene."""
    names = list(information.names)
    lengths = [k for k, name in enumerate(names) if group(name) == "rest length"]
    free = len(lengths) - np.linalg.matrix_rank(places[:, lengths])  # rest lengths that move no base
    shift = 0
    if "x" in names:
        by_length = np.linalg.pinv(places[:, lengths]) @ np.ones(len(places))
        along = np.zeros(len(names))
        along[lengths], along[names.index("x")] = by_length, 1.0
        effect = np.linalg.norm(information.jacobian @ along)
        shift = int(effect < RELATIVE_ZERO * np.linalg.norm(information.jacobian[:, names.index("x")]))
    return {"pre-strains": int(free), "shifts": shift}


def distance_to_parabola(estimate):
    """Distance of reconstructed points outside the true parabola along its normal; NaN where there is no point."""
    x, y = np.asarray(estimate.x), np.asarray(estimate.y)
    foot = np.array(x)
    for _ in range(50):
        height = DISTANCE + CURVATURE * foot**2 - y
        gap = foot - x + 2 * CURVATURE * foot * height
        foot = foot - gap / (1 + 2 * CURVATURE * height + (2 * CURVATURE * foot) ** 2)
    angle = np.arctan(2 * CURVATURE * foot)
    away = (x - foot) * np.sin(angle) - (y - DISTANCE - CURVATURE * foot**2) * np.cos(angle)
    return np.where(np.isfinite(x), away, np.nan)


def noisy_scans(data, sigma, count):
    """Copies of the data with noise."""
    rng = np.random.default_rng(0)
    return [data | {n: data[n] + rng.normal(0, s, data[n].shape) for n, s in sigma.items()} for _ in range(count)]


def misfits(scans, sensor, sigma):
    """Reduced chi^2 of single points and between whiskers, for every noisy scan: (scans, 2)."""
    each = [jw.reconstruct(scan, sensor, sigma=sigma) for scan in scans]
    return np.array([[np.mean(np.asarray(r.chi2)[r.clear]), r.consistency().chi2] for r in each])


def detection(usual, wrong):
    """Smallest detected error in per cent (or degrees), from the misfits with the right and with a wrong parameter."""
    excess = (wrong.mean(axis=0) - usual.mean(axis=0)) / usual.std(axis=0, ddof=1)
    threshold = [float(np.sqrt(DETECTED / e)) if np.isfinite(e) and e > RESOLVED else None for e in excess]
    mean = [float(chi2) if np.isfinite(chi2) else None for chi2 in usual.mean(axis=0)]
    return {
        "detected in points from": threshold[0],
        "detected between whiskers from": threshold[1],
        "chi^2 of points": mean[0],
        "chi^2 between whiskers": mean[1],
        "excess of points": float(excess[0]),
        "excess between whiskers": float(excess[1]) if np.isfinite(excess[1]) else None,
    }


def detected_in_fit(information, sensor_parameters, name):
    """Smallest error in per cent that a fit of contour and this parameter detects; None if it detects none."""
    unknown = information.known(*[n for n in sensor_parameters if n not in (name, "angle")])
    direction = np.eye(len(unknown.names))[unknown.names.index(name)]
    error = 100 * float(standard_error(unknown, direction)) / sensor_parameters[name]
    return DETECTED * error if np.isfinite(error) else None


def errors(model, data, sigma, information, scans):
    """One row for every parameter of the sensor: contour error if it is wrong by 1 %, or by 1 degree."""
    build = Before(model)
    values = {n: v for n, v in build.truth().items() if group(n) in ("stiffness", "rest length", "whisker")}
    values["angle"] = 0.0
    names = list(values)
    step = np.array([TURNED if n == "angle" else WRONG * v for n, v in values.items()])
    start = jnp.array(list(values.values()))

    def sensor(x):
        own = dict(zip(names, x, strict=True))
        return build.sensor(own, own["angle"])

    def points(x):
        estimate = jw.reconstruct(data, sensor(x))
        return jnp.stack([estimate.x, estimate.y])

    # Points that are clear of the noise; without noise all of them are exact.
    clear = jw.reconstruct(data, sensor(start), sigma=sigma).clear
    right = jw.reconstruct(data, sensor(start))
    assert np.nanmax(np.abs(distance_to_parabola(right)[clear])) < EXACT
    by_x, by_y = np.asarray(jax.jit(jax.jacfwd(points))(start)) * step
    slope = np.asarray(right.slope)[..., None]
    normal = by_x * np.sin(slope) - by_y * np.cos(slope)
    noisy = noisy_scans(data, sigma, scans)
    usual, rows = misfits(noisy, sensor(start), sigma), []
    for k, name in enumerate(names):
        wrong = sensor(start.at[k].add(step[k]))
        away = distance_to_parabola(jw.reconstruct(data, wrong))
        both = clear & np.isfinite(away)
        row = {
            "scene": model,
            "parameter": name,
            "wrong by": "1 deg" if name == "angle" else "1 %",
            "mean, derivative": float(np.mean(np.abs(normal[..., k][clear]))),
            "mean, full": float(np.mean(np.abs(away[both]))),
            "max, derivative": float(np.max(np.abs(normal[..., k][clear]))),
            "max, full": float(np.max(np.abs(away[both]))),
            "points compared": int(both.sum()),
            "points": int(clear.sum()),
        }
        row |= detection(usual, misfits(noisy, wrong, sigma))
        row["detected in a fit from"] = None if name == "angle" else detected_in_fit(information, values, name)
        shown = np.flatnonzero(clear[:, -1])  # the figure shows the last whisker
        shown = shown[np.linspace(0, shown.size - 1, SAMPLES).astype(int)]
        curve = np.round(np.asarray(right.x)[shown, -1], 4), np.round(normal[shown, -1, k], 7)
        rows.append(row | {"curve": [values.tolist() for values in curve]})
        print(row, flush=True)
    return rows


def network(model, stiffness):
    """Standard errors with unknown stiffnesses and object; rest lengths, position and whiskers are known."""
    data, sigma, snaps = signals(model, stiffness)
    row = {"scene": model, "stiffness": stiffness, "channels": 3 * data["fx"].shape[1], "snap-throughs": int(snaps)}
    for any_shape in (False, True):
        whole = informed(Before(model, any_shape), data, sigma, stiffness)
        left = whole.known(*[n for n in whole.names if group(n) in ("rest length", "whisker", "position")])
        mark = ", any shape" if any_shape else ""
        row[f"worst stiffness{mark}"] = worst(left, "stiffness")
        row[f"first stiffness{mark}"] = float(standard_error(left, np.eye(len(left.names))[0])) / stiffness
        row[f"q{mark}"] = worst(left, "distance")
        row["contour" if any_shape else "a"] = contour_error(left) if any_shape else worst(left, "shape")
    print(row, flush=True)
    return row


def main() -> None:
    """Measure and store."""
    short = quick(__doc__)
    models = list(NETWORKS)[:2] if short else list(NETWORKS)
    results = {"known_subsets": [], "known_errors": [], "known_networks": []}
    for model in models:
        data, sigma, _ = signals(model)
        known, unknown = (informed(Before(model, any_shape), data, sigma) for any_shape in (False, True))
        results["known_subsets"] += subsets(model, known, False) + subsets(model, unknown, True)
        results["known_errors"] += errors(model, data, sigma, unknown, 10 if short else SCANS)
        results["known_networks"] += [network(model, stiffness) for stiffness in SOFTNESS]
        for name, rows in results.items():
            write(name, rows)


if __name__ == "__main__":
    main()
