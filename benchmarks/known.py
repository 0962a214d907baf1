"""What has to be known to tell the rest from the reactions: stiffness, rest length, object distance, shape, position.

python benchmarks/known.py [--quick]     about ten minutes on two cores

The thesis's networks with c = 70 and rest lengths of 0.2 (feedback at the sum) before a parabola, a = 1, q = 0.3; noise
of 1 % of each channel's peak, 512 positions over the contact. Written are

known_subsets: what is told of the rest if some of it is known, by the information of the signals;
known_errors: how wrong the contour gets by a wrong parameter of the sensor, and whether that would be noticed;
known_buys: what feedback, more whiskers and softer springs are worth.
"""

import argparse
from functools import lru_cache
from itertools import combinations, pairwise
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import jaxwhisker as jw
from common import write
from jaxwhisker._inverse.identifiability import INVOLVED, NULL

NETWORKS = {
    "FB": ((0, 1),),
    "FBFB": ((0, 1), (1, 2)),
    "FBFBR": ((0, 1), (1, 2), (0, 2)),
    "three whiskers": ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)),
}
REST, DISTANCE, CURVATURE, STIFFNESS = 0.2, 0.3, 1.0, 70.0
SOFTNESS = (40.0, 70.0, 200.0, 1000.0)
STEPS, NOISE = 512, 0.01
KNOTS = tuple(np.linspace(-0.7, 1.0, 9).round(12).tolist())  # slopes that are met; of a contour of any shape
ALONG = np.linspace(-0.6, 1.0, 65)  # slopes at which that contour is judged
WRONG, TURNED = 0.01, np.deg2rad(1.0)  # relative error of a parameter, error of the mounts' angle
SCANS = 20  # with noise, to see by how much a reduced chi^2 varies
NOTICED = 3.0  # of its standard deviations
RESOLVED = 0.1  # of them: what a wrong parameter adds is seen from there on, the noise being the same
EXACT = 1e-6  # lengths: points from exact signals and the right sensor
SAMPLES = 40  # of the curves that are stored for the figure
GROUPS = ("stiffness", "rest length", "distance", "shape", "position")


class Before(NamedTuple):
    """Builds a network before a parabola, or before a contour of any shape."""

    model: str
    any_shape: bool = False

    def sensor(self, values, angle=None):
        """The sensor of named parameters; `angle`: of all mounts."""
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
        """All parameters."""
        ends = NETWORKS[self.model]
        values = {f"c{k + 1}": stiffness for k in range(len(ends))}
        values |= {f"l{k + 1}": REST * (b - a) for k, (a, b) in enumerate(ends)}
        values |= {"EI": 1.0, "L": 1.0, "q": DISTANCE, "x": 0.0}
        if not self.any_shape:
            return values | {"a": CURVATURE}
        like = jw.Contour.like(jw.Parabola(DISTANCE, CURVATURE), KNOTS)
        return values | {f"radius_{k}": float(np.exp(r)) for k, r in enumerate(like.log_radius)}

    def places(self, values):
        """Where the bases stand at rest, and how that follows the parameters: (whiskers, parameters)."""

        def at(x):
            flexibility = self.sensor(dict(zip(values, x, strict=True))).support.flexibility()
            assert flexibility is not None  # there are springs
            return flexibility.offset

        return np.asarray(jax.jacfwd(at)(jnp.array(list(values.values()))))


def group(name):
    """The group to which a parameter belongs."""
    if name in ("EI", "L"):
        return "whisker"
    return {"c": "stiffness", "l": "rest length", "q": "distance", "x": "position"}.get(name[0], "shape")


def signals(model, stiffness=STIFFNESS):
    """Exact signals at 512 positions over the contact, and the noise."""
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
    """The information about all parameters."""
    return jw.information(build, build.truth(stiffness), sigma=sigma, control=data["control"])


def told(information, along):
    """Standard error of combinations of parameters, (..., parameters); NaN of those that the signals do not tell."""
    scale = np.array([abs(v) or 1.0 for v in information.at.values()])
    _, singular, directions = np.linalg.svd(np.linalg.qr(information.jacobian * scale, mode="r"))
    part = (along * scale) @ directions.T
    null = singular <= NULL * singular[0]
    hidden = np.linalg.norm(part[..., null], axis=-1) > INVOLVED * np.linalg.norm(part, axis=-1)
    error = np.linalg.norm(part[..., ~null] / singular[~null], axis=-1)
    return np.where(hidden, np.nan, error)


def worst(information, kind, relative=True):
    """Largest standard error among the parameters of a group; None if it is known."""
    values = information.at
    own = [k for k, name in enumerate(values) if group(name) == kind]
    size = [abs(list(values.values())[k]) if relative else 1.0 for k in own]
    return float(np.max(told(information, np.eye(len(values))[own]) / size)) if own else None


@lru_cache
def across():
    """How the contour moves along its normal with its parameters, wherever it stands along x: (slopes, parameters)."""
    names = ["q", *(f"radius_{k}" for k in range(len(KNOTS)))]
    truth = Before("FB", True).truth()

    @jax.jit
    def normal(values):
        points = jax.vmap(jw.Contour(values[0], jnp.log(values[1:]), KNOTS).point)(jnp.asarray(ALONG))
        return points.x * jnp.sin(ALONG) - points.y * jnp.cos(ALONG)

    return names, np.asarray(jax.jacfwd(normal)(jnp.array([truth[name] for name in names])))


def contour_error(information):
    """Largest standard error of the contour along its normal between slopes of -0.6 and 1, a length."""
    names, by = across()
    rows = np.zeros((len(ALONG), len(information.names)))
    for k, name in enumerate(information.names):
        if name in names:
            rows[:, k] = by[:, names.index(name)]
    return float(np.max(told(information, rows)))


def subsets(model, information, any_shape):
    """A row for every subset of the groups that may be known; the whisker is known, but in one more row."""
    build, rows = Before(model, any_shape), []
    known_sets = [set(known) for n in range(len(GROUPS)) for known in combinations(GROUPS, n)]
    for known in [{"no whisker"}, *known_sets]:
        if any_shape and "shape" in known:
            continue  # a known shape is a known shape
        drop = [name for name in information.names if group(name) in known | {"whisker"} - {"no whisker"}]
        if known == {"no whisker"}:
            drop = []
        left = information.known(*drop) if drop else information
        names = list(left.names)
        row = {
            "scene": model,
            "shape": "any" if any_shape else "parabola",
            "known": [g for g in GROUPS if g in known] + (["whisker"] if drop else []),
            "sought": [g for g in (*GROUPS, "whisker") if any(group(name) == g for name in names)],
            "number": len(names),
            "rank": left.rank,
            "condition": left.condition if np.isfinite(left.condition) else 1e300,
            "stiffness": worst(left, "stiffness"),
            "rest length": worst(left, "rest length", relative=False),
            "distance": worst(left, "distance"),
            "shape told": None if any_shape else worst(left, "shape"),
            "contour": contour_error(left) if any_shape else None,
            "position": worst(left, "position", relative=False),
            "whisker": worst(left, "whisker"),
            "not told": list(left.combinations),
        }
        if "rest length" not in known:
            pick = [list(build.truth()).index(name) for name in names]
            places = build.places(build.truth())[:, pick]
            row["place of base 1"] = float(told(left, places[0]))
            spacing = [float(told(left, b - a)) for a, b in pairwise(places)]
            row["spacing of bases"] = max(spacing, default=None)
            row |= untold(left, places)
        rows.append(row)
    return rows


def untold(information, places):
    """How many of the combinations that are not told are a shift of everything, and springs that strain each other."""
    names = list(information.names)
    lengths = [k for k, name in enumerate(names) if group(name) == "rest length"]
    free = len(lengths) - np.linalg.matrix_rank(places[:, lengths])  # rest lengths that move no base
    shift = 0
    if "x" in names:
        by_length = np.linalg.pinv(places[:, lengths]) @ np.ones(len(places))
        along = np.zeros(len(names))
        along[lengths], along[names.index("x")] = by_length, 1.0
        seen = np.linalg.norm(information.jacobian @ along)
        shift = int(seen < NULL * np.linalg.norm(information.jacobian[:, names.index("x")]))
    return {"pre-strains": int(free), "shifts": shift}


def off(points, x):
    """By how far points lie outside of the true parabola, along its normal."""
    foot = np.array(points[0])
    for _ in range(50):
        gap = foot - points[0] + 2 * CURVATURE * foot * (DISTANCE + CURVATURE * foot**2 - points[1])
        slope = 1 + 2 * CURVATURE * (DISTANCE + CURVATURE * foot**2 - points[1]) + (2 * CURVATURE * foot) ** 2
        foot = foot - gap / slope
    angle = np.arctan(2 * CURVATURE * foot)
    away = (points[0] - foot) * np.sin(angle) - (points[1] - DISTANCE - CURVATURE * foot**2) * np.cos(angle)
    return np.where(np.isfinite(x), away, np.nan)


def errors(model, data, sigma, information, scans):
    """A row for every parameter of the sensor: what becomes of the contour if it is wrong by 1 %, or by 1 degree."""
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
        found = jw.reconstruct(data, sensor(x))
        return jnp.stack([found.x, found.y])

    # Which points a noisy scan tells; without noise all of them are exact.
    clear = jw.reconstruct(data, sensor(start), sigma=sigma).clear
    right = jw.reconstruct(data, sensor(start))
    slope = np.asarray(right.slope)
    by = np.asarray(jax.jit(jax.jacfwd(points))(start)) * step
    normal = by[0] * np.sin(slope)[..., None] - by[1] * np.cos(slope)[..., None]
    exact = off((np.asarray(right.x), np.asarray(right.y)), np.asarray(right.x))
    assert np.nanmax(np.abs(exact[clear])) < EXACT, np.nanmax(np.abs(exact[clear]))

    rng = np.random.default_rng(0)
    noisy = []
    for _ in range(scans):
        noise = {n: rng.normal(0, sigma[n], data[n].shape) for n in sigma}
        noisy.append(data | {n: data[n] + noise[n] for n in sigma})

    def misfits(known):
        """Reduced chi^2 of single points and of whiskers against each other, in every noisy scan."""
        found = [jw.reconstruct(d, known, sigma=sigma) for d in noisy]
        return np.array([[np.mean(np.asarray(r.chi2)[r.clear]), r.consistency().chi2] for r in found])

    usual, rows = misfits(sensor(start)), []
    for k, name in enumerate(names):
        wrong = start.at[k].add(step[k])
        found = jw.reconstruct(data, sensor(wrong))
        away = off((np.asarray(found.x), np.asarray(found.y)), np.asarray(found.x))
        both = clear & np.isfinite(away)
        excess = (misfits(sensor(wrong)).mean(axis=0) - usual.mean(axis=0)) / usual.std(axis=0, ddof=1)
        noticed = [float(np.sqrt(NOTICED / e)) if np.isfinite(e) and e > RESOLVED else None for e in excess]
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
            "noticed in points from": noticed[0],
            "noticed between whiskers from": noticed[1],
            "chi^2 of points": float(usual[:, 0].mean()),
            "chi^2 between whiskers": float(usual[:, 1].mean()) if np.isfinite(usual[:, 1]).all() else None,
            "excess of points": float(excess[0]),
            "excess between whiskers": float(excess[1]) if np.isfinite(excess[1]) else None,
        }
        if name != "angle":
            sought = information.known(*[n for n in values if n not in (name, "angle")])
            error = 100 * float(told(sought, np.eye(len(sought.names))[sought.names.index(name)])) / values[name]
            row["noticed in a fit from"] = NOTICED * error if np.isfinite(error) else None
        row["curves"] = []
        for w in range(slope.shape[1]):
            own = np.flatnonzero(clear[:, w])[np.linspace(0, clear[:, w].sum() - 1, SAMPLES).astype(int)]
            pair = np.asarray(right.x)[own, w], normal[own, w, k]
            row["curves"].append([np.round(v, 7).tolist() for v in pair])
        rows.append(row)
        print({key: value for key, value in row.items() if key != "curves"}, flush=True)
    return rows


def bought(model, stiffness):
    """Standard errors if the stiffnesses are sought together with the object, rest lengths and whiskers being known."""
    data, sigma, snaps = signals(model, stiffness)
    row = {"scene": model, "stiffness": stiffness, "channels": 3 * data["fx"].shape[1], "snap-throughs": int(snaps)}
    for any_shape in (False, True):
        whole = informed(Before(model, any_shape), data, sigma, stiffness)
        left = whole.known(*[n for n in whole.names if group(n) in ("rest length", "whisker", "position")])
        mark = ", any shape" if any_shape else ""
        row[f"worst stiffness{mark}"] = worst(left, "stiffness")
        row[f"first stiffness{mark}"] = float(told(left, np.eye(len(left.names))[0])) / stiffness
        row[f"q{mark}"] = worst(left, "distance")
        row["contour" if any_shape else "a"] = contour_error(left) if any_shape else worst(left, "shape")
    print(row, flush=True)
    return row


def main():
    """Write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two networks and few noisy scans")
    quick = parser.parse_args().quick
    models = list(NETWORKS)[:2] if quick else list(NETWORKS)
    told_rows, wrong_rows, bought_rows = [], [], []
    for model in models:
        data, sigma, _ = signals(model)
        known, unknown = (informed(Before(model, any_shape), data, sigma) for any_shape in (False, True))
        told_rows += subsets(model, known, False) + subsets(model, unknown, True)
        wrong_rows += errors(model, data, sigma, unknown, 10 if quick else SCANS)
        bought_rows += [bought(model, stiffness) for stiffness in SOFTNESS]
        for name, rows in (("known_subsets", told_rows), ("known_errors", wrong_rows), ("known_buys", bought_rows)):
            write(name, rows)


if __name__ == "__main__":
    main()
