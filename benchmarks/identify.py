"""How well parameters come back from signals: from wrong guesses, and from noise.

python benchmarks/identify.py [--quick]

Signals come from the closed form, fits integrate rods: no errors are shared. Controls are 512 positions that begin
anywhere within a step.
"""

import argparse
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import jaxwhisker as jw
from common import write

STEPS = 512
RECOVERED = 1e-6  # relative error of all parameters
WRONG = 3.0  # factor by which guesses are off at most
NOISE = 0.01  # of each channel's peak
HIGHEST = 0.95  # lengths: a whisker reaches no object that is further away


def fbfbr(c1, c2, c3, q):
    """Two whiskers with feedback."""
    springs = (jw.Spring((0, 1), c1, 0.2), jw.Spring((1, 2), c2, 0.2), jw.Spring((0, 2), c3, 0.4))
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support(springs))


def three(c1, c2, c3, c4, c5):
    """Three whiskers with feedback, five stiffnesses."""
    ends, rest = ((0, 1), (1, 2), (2, 3), (0, 2), (0, 3)), (0.2, 0.2, 0.2, 0.4, 0.6)
    springs = tuple(jw.Spring(e, c, r) for e, c, r in zip(ends, (c1, c2, c3, c4, c5), rest, strict=True))
    return jw.Scene(jw.Whisker(), jw.Parabola(0.3), jw.Support(springs))


SCENES = {"FBFBR, c1 c2 c3 q": fbfbr, "three whiskers, c1 to c5": three}
TRUTH = {
    "FBFBR, c1 c2 c3 q": {"c1": 60.0, "c2": 80.0, "c3": 70.0, "q": 0.3},
    "three whiskers, c1 to c5": {"c1": 60.0, "c2": 80.0, "c3": 90.0, "c4": 70.0, "c5": 50.0},
}


COUNTS = {"FBFBR, c1 c2 c3 q": (100, 500), "three whiskers, c1 to c5": (30, 100)}  # fits without and with noise


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
    return {name: float(np.abs(data[name]).max()) for name in ("fx", "fy", "mz")}


def from_wrong_guesses(name: str, count: int, seed: int = 0) -> dict:
    """Without noise: how often all parameters come back."""
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
        "without further starts": sum(s == 1 for s in starts),
        "median error": float(np.median(errors)),
        "median seconds": float(np.median(times[1:])),
        "first, s": times[0],
    }


def from_noise(name: str, count: int, seed: int = 1) -> list[dict]:
    """With noise: scatter against the bound of Cramer and Rao, and how often intervals hold the truth."""
    rng, build, truth = np.random.default_rng(seed), SCENES[name], TRUTH[name]
    found = {k: [] for k in truth}
    bounds = {k: [] for k in truth}
    held = {k: 0 for k in truth}
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
            held[k] += low <= value <= high
            found[k].append(fit.estimates[k])
            bounds[k].append(bound[k])
    good = count - bad
    return [
        {
            "scene": name,
            "fits": count,
            "not ok": bad,
            "parameter": k,
            "bound, relative": float(np.sqrt(np.mean(np.square(bounds[k]))) / truth[k]),
            "scatter / bound": float(np.std(found[k]) / np.sqrt(np.mean(np.square(bounds[k])))),
            "bias / bound": float((np.mean(found[k]) - truth[k]) / np.mean(bounds[k])),
            "held by 95 %": held[k] / good,
            "median seconds": float(np.median(times)),
        }
        for k in truth
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    guesses, noise = [], []
    for name, (wrong, noisy) in COUNTS.items():
        guesses.append(from_wrong_guesses(name, 10 if quick else wrong))
        write("identify_guesses", guesses)
        noise += from_noise(name, 20 if quick else noisy)
        write("identify_noise", noise)


if __name__ == "__main__":
    main()
