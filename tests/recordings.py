"""Signals of one whisker on a spring, with and without noise, that the tests of inverse problems share."""

import numpy as np

import jaxwhisker as jw

STEPS = 256  # one block of samples, so that all fits of a scene share compiled code
NOISE = {"fx": 0.07, "fy": 0.2, "mz": 0.06}  # 1 % of the peaks
TRUTH = {"c": 55.0, "q": 0.27}
CONTROL = np.linspace(0.75, -1.35, STEPS)


def fb(c, q):
    """One whisker on a spring."""
    return jw.Scene(jw.Whisker(), jw.Parabola(q), jw.Support.fb(c))


def exact(scene, control=CONTROL):
    """Signals by the closed form: fits integrate, so that they share no errors."""
    scene = jw.Scene(scene.whisker, scene.profile, scene.support, rod=jw.ClosedForm())
    result = jw.scan(scene, control)
    return {"control": np.asarray(control)} | {n: np.asarray(getattr(result, n)) for n in NOISE}


def noisy(data, seed):
    """The same signals with noise."""
    rng = np.random.default_rng(seed)
    return {n: v + NOISE[n] * rng.standard_normal(v.shape) if n in NOISE else v for n, v in data.items()}


def reversed_order(data):
    """The same recording read backwards."""
    return {name: values[::-1] for name, values in data.items()}
