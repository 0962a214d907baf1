"""Accuracy of identified parameters: from wrong guesses without noise, and from noisy signals.

python benchmarks/identify.py [--quick]

Signals come from the closed form and fits integrate rods, which share no numerical error. A control has 512 positions
with a random offset within one step.
"""

import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import quick, write

STEPS = 512
RECOVERED = 1e-6  # largest relative error of all parameters
WRONG = 3.0  # largest factor between guess and truth
NOISE = 0.01  # of each channel's peak
HIGHEST = 0.95  # largest guess of the distance in L, within reach of the whisker


def fbfbr(c1, c2, c3, q):
    """FBFBR with unknown stiffnesses and distance."""
    springs = (jw.Spring((0, 1), c1, 0.2), jw.Spring((1, 2), c2, 0.2), jw.Spring((0, 2), c3, 0.4))
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support(springs))


def three(c1, c2, c3, c4, c5):
    """FBFBFBR with five unknown stiffnesses."""
    ends, rest = ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)), (0.2, 0.2, 0.2, 0.4, 0.6)
    springs = tuple(jw.Spring(e, c, r) for e, c, r in zip(ends, (c1, c2, c3, c4, c5), rest, strict=True))
    return jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support(springs))


SCENES = {"FBFBR, c1 c2 c3 q": fbfbr, "three whiskers, c1 to c5": three}
TRUTH = {
    "FBFBR, c1 c2 c3 q": {"c1": 60.0, "c2": 80.0, "c3": 70.0, "q": 0.3},
    "three whiskers, c1 to c5": {"c1": 60.0, "c2": 80.0, "c3": 90.0, "c4": 70.0, "c5": 50.0},
}
COUNTS = {
    "FBFBR, c1 c2 c3 q": (100, 500),
    "three whiskers, c1 to c5": (30, 100),
}  # number of fits without and with noise


def signals(build, truth, rng):
    """Exact signals at 512 positions."""
    scene = build(**truth)
    scene = jw.Scene(scene.whisker, scene.profile, scene.support, rod=jw.ClosedForm())
    ends = np.asarray(jw.scan(scene).control)[[0, -1]]
    step = (ends[1] - ends[0]) / (STEPS - 2)
    control = ends[0] + step * (np.arange(STEPS) - rng.uniform())
    result = jw.scan(scene, control)
    return {"control": control} | {name: np.asarray(getattr(result, name)) for name in ("fx", "fy", "mz")}


def peaks(data) -> dict[str, float]:
    """Largest absolute value of each channel."""
    return {name: float(np.abs(data[name]).max()) for name in ("fx", "fy", "mz")}


def from_wrong_guesses(name: str, count: int, seed: int = 0) -> dict:
    """Fit exact signals from wrong guesses: how often all parameters are recovered."""
    rng, build = np.random.default_rng(seed), SCENES[name]
    errors, times, starts = [], [], []
    for _ in range(count):
        truth = {k: v * float(np.exp(rng.uniform(-0.5, 0.5))) for k, v in TRUTH[name].items()}
        data = signals(build, truth, rng)
        guess = {k: v * float(WRONG ** rng.uniform(-1, 1)) for k, v in truth.items()}
        if "q" in guess:
            guess["q"] = min(guess["q"], HIGHEST)
        begin = time.perf_counter()
        fit = jw.identify(build, guess, data)
        times.append(time.perf_counter() - begin)
        errors.append(max(abs(fit.estimates[k] / truth[k] - 1) for k in truth))
        starts.append(fit.starts)
        if errors[-1] > RECOVERED:
            print("missed", truth, guess, fit, sep="\n", flush=True)
    return {
        "scene": name,
        "fits": count,
        "recovered to 1e-6": sum(e <= RECOVERED for e in errors),
        "from the first start": sum(s == 1 for s in starts),
        "median error": float(np.median(errors)),
        "median time, s": float(np.median(times[1:])),
        "first fit, s": times[0],
    }


def from_noise(name: str, count: int, seed: int = 1) -> list[dict]:
    """Fit noisy signals: scatter relative to the Cramer-Rao bound, and coverage of the intervals."""
    rng, build, truth = np.random.default_rng(seed), SCENES[name], TRUTH[name]
    estimates = {k: [] for k in truth}
    bounds = {k: [] for k in truth}
    covered = {k: 0 for k in truth}
    bad, times = 0, []
    for _ in range(count):
        data = signals(build, truth, rng)
        sigma = {k: NOISE * v for k, v in peaks(data).items()}
        noisy = {k: v + sigma[k] * rng.standard_normal(v.shape) if k in sigma else v for k, v in data.items()}
        bound = jw.information(build, truth, sigma=sigma, control=data["control"]).standard_error
        guess = {k: v * float(1.5 ** rng.uniform(-1, 1)) for k, v in truth.items()}
        begin = time.perf_counter()
        fit = jw.identify(build, guess, noisy, sigma=sigma)
        times.append(time.perf_counter() - begin)
        if fit.status != jw.FitStatus.ok:
            print("bad", guess, fit, sep="\n", flush=True)
            bad += 1
            continue
        for k, value in truth.items():
            low, high = fit.interval[k]
            covered[k] += low <= value <= high
            estimates[k].append(fit.estimates[k])
            bounds[k].append(bound[k])
    good = count - bad
    return [
        {
            "scene": name,
            "fits": count,
            "not ok": bad,
            "parameter": k,
            "relative bound": float(np.sqrt(np.mean(np.square(bounds[k]))) / truth[k]),
            "scatter / bound": float(np.std(estimates[k]) / np.sqrt(np.mean(np.square(bounds[k])))),
            "bias / bound": float((np.mean(estimates[k]) - truth[k]) / np.mean(bounds[k])),
            "coverage of 95 % intervals": covered[k] / good,
            "median time, s": float(np.median(times)),
        }
        for k in truth
    ]


def main() -> None:
    """Measure and store."""
    short = quick(__doc__)
    guesses, noise = [], []
    for name, (wrong, noisy) in COUNTS.items():
        guesses.append(from_wrong_guesses(name, 10 if short else wrong))
        write("identify_guesses", guesses)
        noise += from_noise(name, 20 if short else noisy)
        write("identify_noise", noise)


if __name__ == "__main__":
    main()
